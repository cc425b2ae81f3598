"""The fence as the controller needs it: clearances, nearest features, half-planes per stage.

Every boundary is broken into circles and segments. A feature constrains the vehicle's centre by the half-plane that
touches it at the point nearest to a predicted position. From the free side the half-plane keeps the centre a radius
away; from the wrong side (inside an obstacle, outside the workspace) its sign turns, so that it pushes back the
shortest way.
"""

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from autopilot.core.frames import FloatArray
from autopilot.core.geometry import Circle, Fence, Polygon

ComplexArray: TypeAlias = NDArray[np.complex128]

FAR_M = 1e6
"""Stands for "no boundary anywhere near"."""

RECOVERY_M_S = 0.2
"""How fast the vehicle is asked to come back from where it must not be."""

MANY_FEATURES = 16
NEAR_M = 1.0
"""Of more features than that, circles are left out that no predicted position comes this near."""

POINTS_TOGETHER = 64
"""Points that are looked at together when far circles are left out: a tile of 8 x 8 cells, a few metres of a line."""

TINY_M = 1e-9


class Features:
    """Circles and segments of a fence, as complex numbers north + i east.

    All are segments from ``a`` along ``ab`` with a radius; a circle is a segment without length. The segments of a
    polygon are contiguous, circles come last.
    """

    def __init__(self, fence: Fence) -> None:
        a: list[complex] = []
        ab: list[complex] = []
        side: list[float] = []
        radius: list[float] = []
        free_left: list[float] = []
        circles: list[tuple[Circle, float]] = []
        self._polygons: list[tuple[slice, bool, bool]] = []
        for shapes, inside in ((fence.inclusions, True), (fence.exclusions, False)):
            for shape in shapes:
                if isinstance(shape, Circle):
                    circles.append((shape, -1.0 if inside else 1.0))
                    continue
                corners = _counter_clockwise(shape)
                self._polygons.append((slice(len(a), len(a) + len(corners)), inside, _is_convex(corners)))
                a += corners.tolist()
                ab += (np.roll(corners, -1) - corners).tolist()
                side += [1.0] * len(corners)
                radius += [0.0] * len(corners)
                free_left += [1.0 if inside else -1.0] * len(corners)
        self._segments = len(a)
        for circle, keep in circles:
            a.append(complex(float(circle.center_ned_m[0]), float(circle.center_ned_m[1])))
            ab.append(0j)
            side.append(keep)
            radius.append(float(circle.radius_m))
            free_left.append(1.0)
        self.count = len(a)
        """Number of features."""
        self._a, self._ab = np.array(a, dtype=complex), np.array(ab, dtype=complex)
        self._b = self._a + self._ab
        for part, _, _ in self._polygons:
            self._b[part] = np.roll(self._a[part], -1)
        self._side = np.array(side)
        """+1 keep away from it, -1 keep inside it (circles)."""
        self._signed_radius = self._side * np.array(radius)
        length = np.maximum(np.abs(self._ab), TINY_M)
        self._along = np.conj(self._ab) / length**2
        """Re(this * (p - a)) is the share of the segment at which p projects."""
        normal = 1j * self._ab / length * np.array(free_left)
        self._normal = np.where(np.abs(normal) > 0.5, normal, 1.0)
        """Unit normals towards the free side, north for circles: the way out from a point on the line or centre."""

    def _within(self, points: ComplexArray, reach_m: float) -> NDArray[np.intp]:
        """Indices of the features that matter within ``reach_m`` of the points: all but the circles farther away."""
        first = points[0]
        reach_m += float(np.abs(points - first).max())
        circles = slice(self._segments, None)
        near = np.abs(self._a[circles] - first) - self._signed_radius[circles] < reach_m
        near |= self._side[circles] < 0.0
        return np.concatenate([np.arange(self._segments), self._segments + np.flatnonzero(near)])

    def nearest(
        self, points: ComplexArray, keep: NDArray[np.intp] | slice = slice(None)
    ) -> tuple[FloatArray, ComplexArray, FloatArray]:
        """Per point (m,) and feature: signed distance (m, F), unit normal (m, F), offset of the boundary (m, F).

        ``keep`` selects features. Their constraint is ``normal . p >= offset + radius``; distance is positive where
        free.
        Features that say nothing at that point (shared ends, far walls seen from outside) have distance FAR_M.
        """
        column = points[:, None]
        ray = column - self._a[keep]
        share = (ray * self._along[keep]).real
        gap = ray - np.minimum(np.maximum(share, 0.0), 1.0) * self._ab[keep]
        rho = np.abs(gap)
        side, signed_radius = self._side[keep], self._signed_radius[keep]
        if rho.min(initial=FAR_M) < TINY_M:
            gap = np.where(rho < TINY_M, self._normal[keep] * (TINY_M * side), gap)
            rho = np.abs(gap)
        normal = gap * (side / rho)
        offset = (np.conj(normal) * (column - gap)).real + signed_radius
        distance = rho * side - signed_radius
        distance[share >= 1.0] = FAR_M
        for part, inside, convex in self._polygons:
            bad = self._forbidden(part, inside, convex, column, ray)
            if bad is not None:
                # On the wrong side only the nearest edge counts, and it pushes the other way.
                rows = np.flatnonzero(bad)
                columns = part.start + rho[rows, part].argmin(axis=1)
                distance[rows, part] = FAR_M
                distance[rows, columns] = -rho[rows, columns]
                turned = np.where(rho[rows, columns] <= 2.0 * TINY_M, 1.0, -1.0)
                normal[rows, columns] *= turned
                offset[rows, columns] *= turned
        return distance, normal, offset

    def _forbidden(
        self, part: slice, inside: bool, convex: bool, points: ComplexArray, ray: ComplexArray
    ) -> NDArray[np.bool_] | None:
        """Which points (m,) are on the wrong side of one polygon; None if none is."""
        ray = ray[:, part]
        if convex:
            side = (ray * np.conj(self._normal[part])).real
            if inside:
                worst = side.min(axis=1)
                return worst < 0.0 if worst.min() < 0.0 else None
            best = side.max(axis=1)
            return best < 0.0 if best.min() < 0.0 else None
        # Even-odd rule on the ray towards north; corners are compared as they are, so that neighbours agree on them.
        ab, east = self._ab[part], points.imag
        crosses = (self._a[part].imag > east) != (self._b[part].imag > east)
        with np.errstate(divide="ignore", invalid="ignore"):
            north_of_point = ray.imag / ab.imag * ab.real > ray.real
        contains = (crosses & north_of_point).sum(axis=1) % 2 == 1
        bad: NDArray[np.bool_] = contains != inside
        return bad if bad.any() else None

    def clearance_m(self, points_ned_m: FloatArray) -> FloatArray:
        """Distance (m,) of points (m, 2) to the nearest boundary, negative where forbidden; FAR_M without a fence.

        A point in forbidden ground of one shape may be in free ground of others: the worst of all decides.
        """
        if self.count == 0:
            return np.full(len(points_ned_m), FAR_M)
        distance, _, _ = self.nearest(_complex(points_ned_m))
        result: FloatArray = distance.min(axis=1)
        return result

    def clearance_up_to_m(self, points_ned_m: FloatArray, cap_m: float) -> FloatArray:
        """:meth:`clearance_m` or ``cap_m``, whichever is less. Quick for many features when neighbours in the array
        (m, 2) are neighbours in the plane: circles are looked at only where they are near."""
        if self.count <= MANY_FEATURES:
            return np.minimum(self.clearance_m(points_ned_m), cap_m)
        points = _complex(points_ned_m)
        result = np.full(len(points), cap_m)
        for begin in range(0, len(points), POINTS_TOGETHER):
            part = slice(begin, begin + POINTS_TOGETHER)
            keep = self._within(points[part], cap_m)
            if len(keep):
                distance, _, _ = self.nearest(points[part], keep)
                result[part] = np.minimum(distance.min(axis=1), cap_m)
        return result

    def push_out(self, points_ned_m: FloatArray, radius_m: float) -> FloatArray:
        """Steps (m, 2) that bring each point to ``radius_m`` from its nearest boundary; zero where farther away."""
        distance, normal, _ = self.nearest(_complex(points_ned_m))
        nearest = distance.argmin(axis=1)[:, None]
        lack = np.maximum(radius_m - np.take_along_axis(distance, nearest, axis=1), 0.0)
        steps: FloatArray = (lack * np.take_along_axis(normal, nearest, axis=1)).view(float)
        return steps

    def half_planes(
        self,
        points_ned_m: FloatArray,
        t_s: FloatArray,
        radius_m: FloatArray | float,
        slots: int,
        normals: FloatArray,
        offsets: FloatArray,
    ) -> float:
        """Fill ``normals`` (m, slots, 2) and ``offsets`` (m, slots) with the nearest features at predicted points.

        ``points_ned_m`` (m + 1, 2) begins with the present position, ``t_s`` (m + 1,) are their times. ``radius_m``,
        a number or (m,), is what predicted positions keep from a boundary (the present one as the first). A boundary
        that is violated now is asked for at RECOVERY_M_S and not at once, so that other limits are kept on the way
        back. Unused slots get a zero normal and offset -1, which is always satisfied. Returns the smallest clearance
        beyond ``radius_m`` over all points (of many features, those within NEAR_M are looked at).
        """
        if self.count == 0:
            normals[:], offsets[:] = 0.0, -1.0
            return FAR_M
        points = _complex(points_ned_m)
        radius_m = np.broadcast_to(np.asarray(radius_m, dtype=float), len(points) - 1)
        keep: NDArray[np.intp] | slice = slice(None)
        if self.count > MANY_FEATURES:
            keep = self._within(points, float(radius_m.max()) + NEAR_M)
            if len(keep) == 0:
                normals[:], offsets[:] = 0.0, -1.0
                return NEAR_M
        distance, normal, offset = self.nearest(points, keep)
        now_m = float(radius_m[0])
        margin = min(float(distance[0].min()) - now_m, float((distance[1:].min(axis=1) - radius_m).min()))
        if margin < 0.0 and distance[0].min() < now_m:
            offset -= np.maximum(now_m - distance[0] - RECOVERY_M_S * t_s[:, None], 0.0)
        distance, normal, offset = distance[1:], normal[1:], offset[1:]
        used = min(distance.shape[1], slots)
        if distance.shape[1] > slots:
            pick = np.argpartition(distance, slots - 1, axis=1)[:, :slots]
            distance = np.take_along_axis(distance, pick, axis=1)
            normal = np.take_along_axis(normal, pick, axis=1)
            offset = np.take_along_axis(offset, pick, axis=1)
        else:
            normals[:, used:], offsets[:, used:] = 0.0, -1.0
        slots_of_normals = normals.view(np.complex128)[..., 0]
        slots_of_normals[:, :used] = normal
        offsets[:, :used] = offset + radius_m[:, None]
        if distance.max() >= FAR_M:
            silent = distance >= FAR_M
            slots_of_normals[:, :used][silent] = 0.0
            offsets[:, :used][silent] = -1.0
        return margin


def clearance_m(fence: Fence, points_ned_m: Sequence[Sequence[float]] | FloatArray) -> FloatArray:
    """Signed clearance (m,) of points (m, 2) to the fence, for checks that need no speed."""
    return Features(fence).clearance_m(np.asarray(points_ned_m, dtype=float).reshape(-1, 2))


def fence_key(fence: Fence) -> tuple[object, ...]:
    """The horizontal content of a fence, to tell a new one from the same one built again."""
    parts: list[object] = []
    for shapes in (fence.inclusions, fence.exclusions):
        parts.append(len(shapes))
        for shape in shapes:
            if isinstance(shape, Circle):
                parts.append((np.asarray(shape.center_ned_m, dtype=float).tobytes(), float(shape.radius_m)))
            else:
                parts.append(np.asarray(shape.vertices_ned_m, dtype=float).tobytes())
    return tuple(parts)


def _complex(points_ned_m: FloatArray) -> ComplexArray:
    """(m, 2) as north + i east."""
    return np.ascontiguousarray(points_ned_m).view(np.complex128)[:, 0]


def _counter_clockwise(polygon: Polygon) -> ComplexArray:
    """Corners in the order that has the inside at +90 degrees from every edge."""
    v = _complex(np.array(polygon.vertices_ned_m, dtype=float).reshape(-1, 2))
    return v if float((np.conj(v) * np.roll(v, -1)).imag.sum()) > 0.0 else v[::-1].copy()


def _is_convex(v: ComplexArray) -> bool:
    edge = np.roll(v, -1) - v
    return bool(((np.conj(edge) * np.roll(edge, -1)).imag >= -TINY_M).all())
