"""Half-planes and clearance of a predicted path among boundaries and moving obstacles.

Between two nodes the prediction is a chord. For boundaries that are convex towards the free space (circles, corners,
moving obstacles) the distance is taken to the *chord*, and the half-plane at the nearest point constrains both of its
ends: a half-plane that holds at both ends holds in between. The nearest point of a straight edge is always at a node
or at a corner. Where a chord crosses a boundary (a wall of no thickness), later nodes are constrained to the last
feasible position.
"""

from dataclasses import dataclass

import numpy as np

from autopilot.control.constraints.constraints_tuning import FEATURES
from autopilot.control.constraints.features import BoolArray, Boundaries, ComplexArray, as_complex, unit_rays
from autopilot.core.frames import FloatArray

RECOVERY_M_S = 0.2
"""Speed at which a violated boundary is recovered."""

NEAR_M = 1.0
"""With many features, those farther from the prediction than this are left out."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Movers:
    """K circular obstacles with constant predicted velocity, as complex numbers north + i east."""

    center: ComplexArray
    """(K,) now"""
    velocity_m_s: ComplexArray
    """(K,)"""
    radius_m: FloatArray
    """(K,) now, uncertainty included"""
    growth_m_s: FloatArray
    """(K,) of the radius"""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Met:
    """Round things as chords meet them; (m - 1, C)."""

    at: FloatArray
    """Share of the chord at which it is nearest."""
    distance: FloatArray
    """From the rim, signed."""
    normal: ComplexArray
    leaves: BoolArray
    """The chord begins inside."""


class Path:
    """A predicted path among features and movers."""

    def __init__(
        self,
        features: Boundaries,
        points_ned_m: FloatArray,
        t_s: FloatArray,
        radius_m: FloatArray | float,
        movers: Movers | None,
    ) -> None:
        self._features = features
        self._points = as_complex(points_ned_m)
        self._t_s = t_s
        nodes = len(self._points)
        self._radius_m: FloatArray = np.full(nodes - 1, radius_m) if np.ndim(radius_m) == 0 else np.asarray(radius_m)
        self._keep = features.everything
        if features.many:
            self._keep = features.within(self._points, float(self._radius_m.max()) + NEAR_M)
        rounds, kept = features.rounds, self._keep[1]
        self._center, self._rim = rounds.center[kept][None], rounds.radius[kept][None]
        self._side, self._polygon = rounds.side[kept], rounds.polygon[kept]
        if movers is not None:
            moved = movers.center + t_s[:, None] * movers.velocity_m_s
            grown = movers.radius_m + t_s[:, None] * movers.growth_m_s
            self._center = np.concatenate([np.repeat(self._center, nodes, axis=0), moved], axis=1)
            self._rim = np.concatenate([np.repeat(self._rim, nodes, axis=0), grown], axis=1)
            self._side = np.concatenate([self._side, np.ones(moved.shape[1])])
            self._polygon = np.concatenate([self._polygon, np.full(moved.shape[1], -1)])
        self._see()
        self._crossing = self._first_crossing()

    def _see(self) -> None:
        self._seen = self._features.visible_edges(self._points, self._keep[0])
        self._rays = self._points[:, None] - self._center
        self._now = (np.abs(self._rays[0]) - self._rim[0]) * self._side
        self._met = self._meet()

    def _meet(self) -> _Met:
        rays, rim, points = self._rays, self._rim, self._points
        step = rays[1:] - rays[:-1] if len(self._center) > 1 else (points[1:] - points[:-1])[:, None]
        length2 = np.maximum(step.real**2 + step.imag**2, FEATURES.tiny_m**2)
        at = np.minimum(np.maximum((step.conj() * rays[:-1]).real / -length2, 0.0), 1.0)
        at[:, self._side < 0.0] = 1.0  # a convex inclusion: nodes inside are enough
        leaves = np.abs(rays[:-1]) < rim[: len(rays) - 1]
        if leaves.any():
            at[leaves] = 1.0  # out of an obstacle there is no chord that keeps clear of it
        gap = rays[:-1] + at * step
        rho = np.abs(gap)
        met_rim = rim if len(rim) == 1 else rim[:-1] + at * (rim[1:] - rim[:-1])
        return _Met(
            at=at, distance=(rho - met_rim) * self._side, normal=unit_rays(gap, rho) * self._side, leaves=leaves
        )

    def margin_m(self) -> float:
        """Smallest clearance beyond the body radius [m]."""
        seen, met, radius = self._seen.distance, self._met.distance, self._radius_m
        margin = float(min(seen[0].min(initial=FEATURES.far_m), self._now.min(initial=FEATURES.far_m))) - float(
            radius[0]
        )
        for distance in (seen[1:], met):
            if distance.shape[1]:
                margin = min(margin, float((distance.min(axis=1) - radius).min()))
        if self._crossing is not None:
            margin = min(margin, -float(radius[0]))
        return min(margin, NEAR_M) if self._features.many else margin

    def _first_crossing(self) -> int | None:
        """The first chord that goes through an edge from free ground."""
        seen, points = self._seen, self._points
        if not seen.rho.shape[1] or seen.line.min() > 0.0:
            return None
        step = (points[1:] - points[:-1])[:, None]
        front = seen.line > -FEATURES.tiny_m
        maybe = front[:-1] != front[1:]
        maybe &= seen.rho[:-1] <= np.abs(step)
        if not maybe.any():
            return None
        edges = self._features.edges
        a, ab = edges.a[self._keep[0]], edges.ab[self._keep[0]]
        begin = (step.conj() * (a - points[:-1, None])).imag
        end = begin + (step.conj() * ab).imag
        through = np.flatnonzero((maybe & ((begin > 0.0) != (end > 0.0))).any(axis=1))
        if seen.bad is not None:
            # From a forbidden area the shortest way out is through an edge.
            through = through[~seen.bad[through].any(axis=1)]
        return int(through[0]) if len(through) else None

    def end_at_walls(self) -> None:
        """Nodes after a chord that goes through a wall are put where it began."""
        if self._crossing is not None:
            self._points = self._points.copy()
            self._points[self._crossing + 1 :] = self._points[self._crossing]
            self._see()

    def fill(self, slots: int, normals: ComplexArray, offsets: FloatArray) -> None:
        """Half-planes of the nearest features: ``normals`` (m, slots), ``offsets`` (m, slots)."""
        seen, met = self._seen, self._met
        # Corners are handled by chords; an edge whose end a node is beyond adds nothing.
        distance_e = np.where(seen.fraction[1:] <= 0.0, FEATURES.far_m, seen.distance[1:])
        distance_r = met.distance
        if seen.bad is not None:
            distance_e = np.where(seen.bad[1:], seen.distance[1:], distance_e)
            distance_r = distance_r.copy()
            self._silence_corners(seen.bad, distance_r)
        distance, normal, offset = distance_e, seen.normal[1:], seen.offset[1:]
        if distance_r.shape[1]:
            # A node is bound by the chord that ends there, and by the one that begins there.
            following = np.minimum(np.arange(1, len(distance_r) + 1), len(distance_r) - 1)
            again = distance_r[following]
            again[:-1][((met.at[1:] == 0.0) & (met.at[:-1] == 1.0)) | met.leaves[1:]] = FEATURES.far_m
            again[-1], again[:, self._side < 0.0] = FEATURES.far_m, FEATURES.far_m
            distance = np.concatenate([distance, distance_r, again], axis=1)
            normal_r = np.concatenate([met.normal, met.normal[following]], axis=1)
            normal = np.concatenate([normal, normal_r], axis=1)
            center = self._center[-len(distance_r) :]
            rim = self._rim[-len(distance_r) :] * self._side
            twice = np.concatenate([center, center], axis=1)
            bound = (normal_r.conj() * twice).real + np.concatenate([rim, rim], axis=1)
            offset = np.concatenate([offset, bound], axis=1)
        offset = self._recovering(offset) + self._radius_m[:, None]
        if distance.shape[1] > slots:
            pick = np.argpartition(distance, slots - 1, axis=1)[:, :slots]
            rows = np.arange(len(pick))[:, None]
            distance, normal, offset = distance[rows, pick], normal[rows, pick], offset[rows, pick]
        says, used = distance < FEATURES.far_m, distance.shape[1]
        np.copyto(normals[:, :used], normal, where=says)
        np.copyto(offsets[:, :used], offset, where=says)

    def _silence_corners(self, bad: BoolArray, distance_r: FloatArray) -> None:
        """Disable the corners of polygons that contain the point."""
        polygon = self._features.edges.polygon[self._keep[0]]
        rows, columns = np.nonzero(bad)
        for row, number in {(int(r), int(polygon[c])) for r, c in zip(rows, columns, strict=True)}:
            distance_r[max(row - 1, 0) : row + 1, self._polygon == number] = FEATURES.far_m

    def _recovering(self, offset: FloatArray) -> FloatArray:
        """Boundaries (m, F) that are violated now are asked for gradually."""
        now = self._seen.distance[0]
        if offset.shape[1] > len(now):
            now = np.concatenate([now, self._now, self._now])
        lack = self._radius_m[0] - now
        if lack.max(initial=0.0) <= 0.0:
            return offset
        result: FloatArray = offset - np.maximum(lack - RECOVERY_M_S * self._t_s[1:, None], 0.0)
        return result
