"""The fence as the controller needs it: clearances, nearest features, half-planes per stage.

Every boundary is broken into circles and segments. A feature constrains the vehicle's centre by the half-plane that
touches it at the point nearest to a predicted position. From the free side the half-plane keeps the centre a radius
away; from the wrong side (inside an obstacle, outside the workspace) its sign turns, so that it pushes back the shortest way.
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

TINY_M = 1e-9


class Features:
    """Circles and segments of a fence, as arrays of complex numbers north + i east. Segments of a polygon are contiguous."""

    def __init__(self, fence: Fence) -> None:
        circles: list[tuple[complex, float, float]] = []
        polygons: list[tuple[ComplexArray, bool]] = []
        for shapes, inside in ((fence.inclusions, True), (fence.exclusions, False)):
            for shape in shapes:
                if isinstance(shape, Circle):
                    center = complex(float(shape.center_ned_m[0]), float(shape.center_ned_m[1]))
                    circles.append((center, float(shape.radius_m), -1.0 if inside else 1.0))
                else:
                    polygons.append((_counter_clockwise(shape), inside))
        self._center = np.array([c for c, _, _ in circles], dtype=complex)
        self._sign = np.array([sign for _, _, sign in circles])
        """+1 keep outside, -1 keep inside."""
        self._signed_radius = np.array([sign * radius for _, radius, sign in circles])
        corners = [v for v, _ in polygons]
        self._a = np.concatenate(corners) if corners else np.zeros(0, dtype=complex)
        ends = np.concatenate([np.roll(v, -1) for v in corners]) if corners else self._a
        self._ab = ends - self._a
        length = np.maximum(np.abs(self._ab), TINY_M)
        self._along = np.conj(self._ab) / length**2
        """Re(this * (p - a)) is the share of the segment at which p projects."""
        free_side = np.array([1.0 if inside else -1.0 for v, inside in polygons for _ in range(len(v))])
        self._normal = 1j * self._ab / length * free_side
        """Unit normals of the segments towards the free side."""
        self._polygons: list[tuple[slice, bool, bool]] = []
        first = 0
        for v, inside in polygons:
            self._polygons.append((slice(first, first + len(v)), inside, _is_convex(v)))
            first += len(v)
        self.count = len(self._center) + len(self._a)
        """Number of features."""

    def nearest(self, points: ComplexArray) -> tuple[FloatArray, ComplexArray, FloatArray]:
        """Per point (m,) and feature: signed distance (m, F), unit normal (m, F), offset of the boundary (m, F).

        The constraint of a feature is ``normal . p >= offset + radius``. Distance is positive on the free side. Features
        that say nothing at that point (ends shared with a neighbour, far walls seen from outside) have distance FAR_M.
        """
        column = points[:, None]
        if not len(self._a):
            return self._circles(column)
        if not len(self._center):
            return self._segments(column)
        parts = zip(self._circles(column), self._segments(column), strict=True)
        distance, normal, offset = (np.concatenate(pair, axis=1) for pair in parts)
        return distance, normal, offset

    def _circles(self, points: ComplexArray) -> tuple[FloatArray, ComplexArray, FloatArray]:
        ray = points - self._center
        rho = np.abs(ray)
        if rho.min() < TINY_M:
            ray = np.where(rho < TINY_M, TINY_M, ray)
            rho = np.abs(ray)
        normal = ray * (self._sign / rho)
        distance = self._sign * rho - self._signed_radius
        offset = (np.conj(normal) * self._center).real + self._signed_radius
        return distance, normal, offset

    def _segments(self, points: ComplexArray) -> tuple[FloatArray, ComplexArray, FloatArray]:
        ray = points - self._a
        share = (ray * self._along).real
        gap = ray - np.minimum(np.maximum(share, 0.0), 1.0) * self._ab
        rho = np.abs(gap)
        if rho.min() < TINY_M:
            gap = np.where(rho < TINY_M, self._normal * TINY_M, gap)
            rho = np.abs(gap)
        normal = gap / rho
        offset = (np.conj(normal) * (points - gap)).real
        distance = np.where(share >= 1.0, FAR_M, rho)
        for part, inside, convex in self._polygons:
            bad = self._forbidden(part, inside, convex, ray)
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

    def _forbidden(self, part: slice, inside: bool, convex: bool, ray: ComplexArray) -> NDArray[np.bool_] | None:
        """Which points (m,) are on the wrong side of one polygon; None if none is."""
        ray = ray[:, part]
        if convex:
            side = (ray * np.conj(self._normal[part])).real
            if inside:
                worst = side.min(axis=1)
                return worst < 0.0 if worst.min() < 0.0 else None
            best = side.max(axis=1)
            return best < 0.0 if best.min() < 0.0 else None
        # Even-odd rule on the ray towards north.
        ab = self._ab[part]
        crosses = (ray.imag < 0.0) != (ray.imag < ab.imag)
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

    def half_planes(
        self, points_ned_m: FloatArray, radius_m: float, slots: int, normals: FloatArray, offsets: FloatArray
    ) -> float:
        """Fill ``normals`` (m, slots, 2) and ``offsets`` (m, slots) with the nearest features at each point (m, 2).

        Unused slots get a zero normal and offset -1, which is always satisfied. Returns the smallest clearance beyond
        ``radius_m`` over all points.
        """
        if self.count == 0:
            normals[:], offsets[:] = 0.0, -1.0
            return FAR_M
        distance, normal, offset = self.nearest(_complex(points_ned_m))
        used = min(self.count, slots)
        if self.count > slots:
            pick = np.argpartition(distance, slots - 1, axis=1)[:, :slots]
            distance, normal, offset = (np.take_along_axis(v, pick, axis=1) for v in (distance, normal, offset))
        else:
            normals[:, used:], offsets[:, used:] = 0.0, -1.0
        slots_of_normals = normals.view(complex)[..., 0]
        slots_of_normals[:, :used] = normal
        offsets[:, :used] = offset + radius_m
        if distance.max() >= FAR_M:
            silent = distance >= FAR_M
            slots_of_normals[:, :used][silent] = 0.0
            offsets[:, :used][silent] = -1.0
        return float(distance.min()) - radius_m


def clearance_m(fence: Fence, points_ned_m: Sequence[Sequence[float]] | FloatArray) -> FloatArray:
    """Signed clearance (m,) of points (m, 2) to the fence, for checks that need no speed."""
    return Features(fence).clearance_m(np.asarray(points_ned_m, dtype=float).reshape(-1, 2))


def _complex(points_ned_m: FloatArray) -> ComplexArray:
    """(m, 2) as north + i east."""
    result: ComplexArray = np.ascontiguousarray(points_ned_m).view(complex)[:, 0]
    return result


def _counter_clockwise(polygon: Polygon) -> ComplexArray:
    """Corners in the order that has the inside at +90 degrees from every edge."""
    v = _complex(np.array(polygon.vertices_ned_m, dtype=float).reshape(-1, 2))
    return v if float((np.conj(v) * np.roll(v, -1)).imag.sum()) > 0.0 else v[::-1].copy()


def _is_convex(v: ComplexArray) -> bool:
    edge = np.roll(v, -1) - v
    return bool(((np.conj(edge) * np.roll(edge, -1)).imag >= -TINY_M).all())
