"""Plane geometry of fence shapes: inside, clearance, gaps. Arrays of points are (n, 2) north, east [m]."""

import numpy as np
from numpy.typing import NDArray

from autopilot.core.frames import FloatArray
from autopilot.core.geometry import Circle, Polygon, Shape

BoolArray = NDArray[np.bool_]

PAIRS = 100_000
"""Pairs of edges, or of places and edges, that are computed at once: some megabytes."""


def signed_area_m2(vertices: FloatArray) -> float:
    """Shoelace area of a polygon (n, 2), positive when it runs north to east (clockwise on a map)."""
    x, y = vertices[:, 0] - vertices[0, 0], vertices[:, 1] - vertices[0, 1]
    return 0.5 * float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


def inside_polygon(vertices: FloatArray, points: FloatArray) -> BoolArray:
    """(n,) whether each point lies inside (even-odd rule; on the boundary either answer)."""
    inside = np.zeros(len(points), dtype=bool)
    px, py = points[:, 0], points[:, 1]
    ax, ay = vertices[-1]
    for bx, by in vertices:
        spans = (ay > py) != (by > py)
        if spans.any():
            with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
                inside ^= spans & (px < ax + (py - ay) * (bx - ax) / (by - ay))
        ax, ay = bx, by
    return inside


def segment_distance_m(starts: FloatArray, ends: FloatArray, points: FloatArray) -> FloatArray:
    """(n, m) distance of n points to m segments (m, 2) -> (m, 2)."""
    along = ends - starts
    rel = points[:, None, :] - starts[None, :, :]
    length_sq = np.maximum(np.sum(along * along, axis=1), 1e-300)
    share = np.clip(np.einsum("nmk,mk->nm", rel, along) / length_sq, 0.0, 1.0)
    off = rel - share[:, :, None] * along[None, :, :]
    distance: FloatArray = np.hypot(off[:, :, 0], off[:, :, 1])
    return distance


def polygon_distance_m(vertices: FloatArray, points: FloatArray) -> FloatArray:
    """(n,) distance to the boundary of a polygon (never negative)."""
    best = np.full(len(points), np.inf)
    for start, end in zip(vertices, np.roll(vertices, -1, axis=0), strict=True):
        best = np.minimum(best, segment_distance_m(start[None, :], end[None, :], points)[:, 0])
    return best


def clearance_m(shape: Shape, points: FloatArray) -> FloatArray:
    """(n,) signed distance to a shape: positive outside, negative inside."""
    if isinstance(shape, Circle):
        off = points - shape.center_ned_m
        outside: FloatArray = np.hypot(off[:, 0], off[:, 1]) - shape.radius_m
        return outside
    distance = polygon_distance_m(shape.vertices_ned_m, points)
    return np.where(inside_polygon(shape.vertices_ned_m, points), -distance, distance)


def boundary_point(shape: Shape) -> FloatArray:
    """(2,) some point of the boundary."""
    if isinstance(shape, Circle):
        point: FloatArray = shape.center_ned_m + np.array([shape.radius_m, 0.0])
    else:
        point = np.asarray(shape.vertices_ned_m[0], dtype=np.float64)
    return point


def crossing_edges(vertices: FloatArray) -> tuple[int, int] | None:
    """Numbers of two edges of a polygon that cross or touch without being neighbours, or fold back; None = simple."""
    starts, ends = vertices, np.roll(vertices, -1, axis=0)
    n = len(vertices)
    along = ends - starts
    after = np.roll(along, -1, axis=0)
    turn = along[:, 0] * after[:, 1] - along[:, 1] * after[:, 0]
    folds = (np.abs(turn) <= 1e-12) & (np.sum(along * after, axis=1) <= 0.0)
    if folds.any():
        first = int(np.argmax(folds))
        return first, (first + 1) % n
    block = max(1, PAIRS // n)
    for first in range(0, n - 2, block):
        rows = np.arange(first, min(first + block, n - 2))
        apart = np.arange(n)[None, :] >= rows[:, None] + 2
        apart &= (rows[:, None] > 0) | (np.arange(n)[None, :] < n - 1)
        hit = apart & _segments_meet(starts[rows, None], ends[rows, None], starts[None], ends[None])
        if hit.any():
            row, column = np.argwhere(hit)[0]
            return first + int(row), int(column)
    return None


def _side(a: FloatArray, b: FloatArray, p: FloatArray) -> FloatArray:
    """Sign of the side of the line a -> b on which p lies; shapes broadcast over the last axis of 2."""
    value = (b[..., 0] - a[..., 0]) * (p[..., 1] - a[..., 1]) - (b[..., 1] - a[..., 1]) * (p[..., 0] - a[..., 0])
    return np.asarray(np.sign(value), dtype=np.float64)


def _between(a: FloatArray, b: FloatArray, p: FloatArray) -> BoolArray:
    """Whether p lies in the bounding box of the segment a -> b."""
    low, high = np.minimum(a, b), np.maximum(a, b)
    return np.asarray(np.all((low <= p) & (p <= high), axis=-1), dtype=np.bool_)


def _segments_meet(a: FloatArray, b: FloatArray, c: FloatArray, d: FloatArray) -> BoolArray:
    """Whether segment a -> b meets each of the segments c -> d (m, 2), touching included."""
    s1, s2, s3, s4 = _side(c, d, a), _side(c, d, b), _side(a, b, c), _side(a, b, d)
    meets = (s1 * s2 < 0.0) & (s3 * s4 < 0.0)
    meets |= (s1 == 0.0) & _between(c, d, a)
    meets |= (s2 == 0.0) & _between(c, d, b)
    meets |= (s3 == 0.0) & _between(a, b, c)
    meets |= (s4 == 0.0) & _between(a, b, d)
    return np.asarray(meets, dtype=np.bool_)


def boundary_gap_m(a: Shape, b: Shape) -> tuple[float, FloatArray]:
    """Distance between the boundaries of two shapes (0 = they meet) and (2,) the middle of the shortest link."""
    if isinstance(a, Circle) and isinstance(b, Circle):
        return _circle_gap(a, b)
    if isinstance(a, Circle):
        assert isinstance(b, Polygon)
        return _circle_polygon_gap(a, b.vertices_ned_m)
    if isinstance(b, Circle):
        return _circle_polygon_gap(b, a.vertices_ned_m)
    return _polygon_gap(a.vertices_ned_m, b.vertices_ned_m)


def _circle_gap(a: Circle, b: Circle) -> tuple[float, FloatArray]:
    off = b.center_ned_m - a.center_ned_m
    distance = float(np.hypot(off[0], off[1]))
    unit = off / distance if distance > 0.0 else np.array([1.0, 0.0])
    apart = distance - a.radius_m - b.radius_m
    if apart > 0.0:
        return apart, a.center_ned_m + unit * (a.radius_m + 0.5 * apart)
    nested = abs(a.radius_m - b.radius_m) - distance
    if nested <= 0.0:
        return 0.0, a.center_ned_m + unit * a.radius_m
    inner, toward = (b, unit) if a.radius_m > b.radius_m else (a, -unit)
    return nested, inner.center_ned_m + toward * (inner.radius_m + 0.5 * nested)


def _nearest_on_edges(vertices: FloatArray, point: FloatArray) -> FloatArray:
    """(2,) the boundary point of a polygon that is nearest to a point (2,)."""
    ends = np.roll(vertices, -1, axis=0)
    best = int(np.argmin(segment_distance_m(vertices, ends, point[None, :])[0]))
    along = ends[best] - vertices[best]
    share = float(np.clip(np.dot(point - vertices[best], along) / max(float(np.dot(along, along)), 1e-300), 0.0, 1.0))
    nearest: FloatArray = vertices[best] + share * along
    return nearest


def _circle_polygon_gap(circle: Circle, vertices: FloatArray) -> tuple[float, FloatArray]:
    near = _nearest_on_edges(vertices, circle.center_ned_m)
    off = near - circle.center_ned_m
    distance = float(np.hypot(off[0], off[1]))
    if distance > circle.radius_m:
        return distance - circle.radius_m, near - off / distance * 0.5 * (distance - circle.radius_m)
    to_vertices = vertices - circle.center_ned_m
    spans = np.hypot(to_vertices[:, 0], to_vertices[:, 1])
    far = int(np.argmax(spans))
    if spans[far] >= circle.radius_m:
        return 0.0, near
    gap = circle.radius_m - float(spans[far])
    return gap, vertices[far] * 1.0


def _polygon_gap(a: FloatArray, b: FloatArray) -> tuple[float, FloatArray]:
    a_ends, b_ends = np.roll(a, -1, axis=0), np.roll(b, -1, axis=0)
    block = max(1, PAIRS // len(b))
    for first in range(0, len(a), block):
        part = slice(first, first + block)
        meets = _segments_meet(a[part, None], a_ends[part, None], b[None], b_ends[None]).any(axis=1)
        if meets.any():
            return 0.0, a[first + int(np.argmax(meets))]
    best, middle = np.inf, a[0]
    for points, other in ((a, b), (b, a)):
        distance = segment_distance_m(other, np.roll(other, -1, axis=0), points)
        row = int(np.argmin(np.min(distance, axis=1)))
        if float(np.min(distance[row])) < best:
            best = float(np.min(distance[row]))
            middle = 0.5 * (points[row] + _nearest_on_edges(other, points[row]))
    return best, middle


def bounding_box(shape: Shape) -> tuple[FloatArray, FloatArray]:
    """Corners (2,) with the smallest and the largest north and east."""
    if isinstance(shape, Circle):
        return shape.center_ned_m - shape.radius_m, shape.center_ned_m + shape.radius_m
    return np.min(shape.vertices_ned_m, axis=0), np.max(shape.vertices_ned_m, axis=0)
