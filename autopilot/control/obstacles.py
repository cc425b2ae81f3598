"""The fence as the controller needs it: clearances, nearest features, half-planes per stage.

Every boundary is broken into circles and segments. A feature constrains the vehicle's centre by the half-plane that
touches it at the point nearest to a predicted position. From the free side the half-plane keeps the centre a radius away;
from the wrong side (inside an obstacle, outside the workspace) its sign turns, so that it pushes back the shortest way.
"""

from collections.abc import Sequence

import numpy as np

from autopilot.core.frames import FloatArray
from autopilot.core.geometry import Circle, Fence, Polygon

FAR_M = 1e6
"""Stands for "no boundary anywhere near"."""

TINY_M = 1e-9


class Features:
    """Circles and segments of a fence, as arrays. Segments of polygon j are contiguous."""

    def __init__(self, fence: Fence) -> None:
        circles: list[tuple[float, float, float, float]] = []
        polygons: list[tuple[FloatArray, bool]] = []
        for shapes, inside in ((fence.inclusions, True), (fence.exclusions, False)):
            for shape in shapes:
                if isinstance(shape, Circle):
                    c = shape.center_ned_m
                    circles.append((float(c[0]), float(c[1]), float(shape.radius_m), -1.0 if inside else 1.0))
                else:
                    polygons.append((_counter_clockwise(shape), inside))
        table = np.array(circles, dtype=float).reshape(-1, 4)
        self.center = table[:, :2].copy()
        self.radius = table[:, 2].copy()
        self.sign = table[:, 3].copy()
        """+1 keep outside, -1 keep inside."""
        starts = [v for v, _ in polygons]
        self.a = np.concatenate(starts) if starts else np.zeros((0, 2))
        ends = [np.roll(v, -1, axis=0) for v in starts]
        self.ab = (np.concatenate(ends) if ends else np.zeros((0, 2))) - self.a
        self.length2 = np.maximum((self.ab**2).sum(axis=1), TINY_M**2)
        self.slices: list[slice] = []
        first = 0
        for v in starts:
            self.slices.append(slice(first, first + len(v)))
            first += len(v)
        self.inside = [inside for _, inside in polygons]
        free_side = [1.0 if inside else -1.0 for v, inside in polygons for _ in range(len(v))]
        length = np.sqrt(self.length2)
        left = np.stack([-self.ab[:, 1], self.ab[:, 0]], axis=1) / length[:, None]
        self.normal = left * np.array(free_side).reshape(-1, 1)
        """Unit normals of the segments towards the free side."""
        self.ax, self.ay = self.a[:, 0].copy(), self.a[:, 1].copy()
        self.abx, self.aby = self.ab[:, 0].copy(), self.ab[:, 1].copy()
        self.bx, self.by = self.ax + self.abx, self.ay + self.aby

    @property
    def count(self) -> int:
        """Number of features."""
        return len(self.radius) + len(self.ax)

    def _contains(self, part: slice, px: FloatArray, py: FloatArray) -> FloatArray:
        """Even-odd rule: which points (m,) lie inside the polygon."""
        ay, by = self.ay[part], self.by[part]
        crosses = (ay > py[:, None]) != (by > py[:, None])
        with np.errstate(divide="ignore", invalid="ignore"):
            x_at = self.ax[part] + (py[:, None] - ay) / (by - ay) * self.abx[part]
        result: FloatArray = (crosses & (px[:, None] < x_at)).sum(axis=1) % 2 == 1
        return result

    def nearest(self, points_ned_m: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Per point (m, 2) and feature: signed distance (m, F), unit normal (m, F, 2), offset of the boundary (m, F).

        The constraint of a feature is ``normal . p >= offset + radius``. Distance is positive on the free side. Features
        that say nothing at that point (ends shared with a neighbour, far walls seen from outside) have distance FAR_M.
        """
        px, py = points_ned_m[:, 0].copy(), points_ned_m[:, 1].copy()
        m, n_circles = len(px), len(self.radius)
        distance = np.empty((m, self.count))
        normal = np.empty((m, self.count, 2))
        offset = np.empty((m, self.count))
        if n_circles:
            dx = px[:, None] - self.center[:, 0]
            dy = py[:, None] - self.center[:, 1]
            rho = np.sqrt(dx * dx + dy * dy)
            scale = self.sign / np.maximum(rho, TINY_M)
            nx, ny = dx * scale, dy * scale
            if rho.min() <= TINY_M:
                nx[rho <= TINY_M], ny[rho <= TINY_M] = 1.0, 0.0
            distance[:, :n_circles] = self.sign * (rho - self.radius)
            normal[:, :n_circles, 0], normal[:, :n_circles, 1] = nx, ny
            offset[:, :n_circles] = nx * self.center[:, 0] + ny * self.center[:, 1] + self.sign * self.radius
        if len(self.ax):
            self._segments(px, py, distance[:, n_circles:], normal[:, n_circles:], offset[:, n_circles:])
        return distance, normal, offset

    def _segments(
        self, px: FloatArray, py: FloatArray, distance: FloatArray, normal: FloatArray, offset: FloatArray
    ) -> None:
        rx, ry = px[:, None] - self.ax, py[:, None] - self.ay
        share = (rx * self.abx + ry * self.aby) / self.length2
        along = np.minimum(np.maximum(share, 0.0), 1.0)
        dx, dy = rx - along * self.abx, ry - along * self.aby
        rho = np.sqrt(dx * dx + dy * dy)
        inverse = 1.0 / np.maximum(rho, TINY_M)
        nx, ny = dx * inverse, dy * inverse
        on_line = rho < TINY_M
        if on_line.any():
            nx, ny = np.where(on_line, self.normal[:, 0], nx), np.where(on_line, self.normal[:, 1], ny)
        signed = np.where(share >= 1.0, FAR_M, rho)
        for part, inside in zip(self.slices, self.inside, strict=True):
            bad = self._contains(part, px, py) != inside
            if bad.any():
                self._turn_round(part, np.flatnonzero(bad), rho, signed, nx, ny, on_line)
        distance[:], normal[..., 0], normal[..., 1] = signed, nx, ny
        offset[:] = nx * (px[:, None] - dx) + ny * (py[:, None] - dy)

    def _turn_round(
        self,
        part: slice,
        rows: FloatArray,
        rho: FloatArray,
        signed: FloatArray,
        nx: FloatArray,
        ny: FloatArray,
        on_line: FloatArray,
    ) -> None:
        """On the wrong side of a polygon only its nearest edge counts, and it pushes the other way."""
        columns = part.start + rho[rows, part].argmin(axis=1)
        signed[rows, part] = FAR_M
        signed[rows, columns] = -rho[rows, columns]
        flip = np.where(on_line[rows, columns], 1.0, -1.0)
        nx[rows, columns] *= flip
        ny[rows, columns] *= flip

    def clearance_m(self, points_ned_m: FloatArray) -> FloatArray:
        """Distance (m,) of points (m, 2) to the nearest boundary, negative in forbidden places; FAR_M without a fence."""
        if self.count == 0:
            return np.full(len(points_ned_m), FAR_M)
        distance, _, _ = self.nearest(points_ned_m)
        # A point in forbidden ground of one shape may be in free ground of others: the worst of all decides.
        result: FloatArray = distance.min(axis=1)
        return result

    def half_planes(
        self, points_ned_m: FloatArray, radius_m: float, slots: int, normals: FloatArray, offsets: FloatArray
    ) -> float:
        """Fill ``normals`` (m, slots, 2) and ``offsets`` (m, slots) with the nearest features at each point (m, 2).

        Unused slots get a zero normal and offset -1, which is always satisfied. Returns the smallest clearance beyond
        ``radius_m`` over all points.
        """
        count = self.count
        if count == 0:
            normals[:], offsets[:] = 0.0, -1.0
            return FAR_M
        distance, normal, offset = self.nearest(points_ned_m)
        if count > slots:
            pick = np.argpartition(distance, slots - 1, axis=1)[:, :slots]
            rows = np.arange(len(points_ned_m))[:, None]
            normal, offset, near = normal[rows, pick], offset[rows, pick], distance[rows, pick]
            used = slots
        else:
            near, used = distance, count
            normals[:, used:], offsets[:, used:] = 0.0, -1.0
        normals[:, :used] = normal
        offsets[:, :used] = offset + radius_m
        far = near >= FAR_M
        if far.any():
            normals[:, :used][far] = 0.0
            offsets[:, :used][far] = -1.0
        return float(near.min()) - radius_m


def clearance_m(fence: Fence, points_ned_m: Sequence[Sequence[float]] | FloatArray) -> FloatArray:
    """Signed clearance (m,) of points (m, 2) to the fence, for checks that need no speed."""
    return Features(fence).clearance_m(np.asarray(points_ned_m, dtype=float).reshape(-1, 2))


def _area2(v: FloatArray) -> float:
    w = np.roll(v, -1, axis=0)
    return float((v[:, 0] * w[:, 1] - w[:, 0] * v[:, 1]).sum())


def _counter_clockwise(polygon: Polygon) -> FloatArray:
    """Vertices such that the inside is to the left in the (north, east) plane's own orientation."""
    v = np.array(polygon.vertices_ned_m, dtype=float).reshape(-1, 2)
    return v if _area2(v) > 0.0 else v[::-1].copy()
