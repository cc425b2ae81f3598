"""Plane geometry of fence shapes: inside, clearance, gaps. Arrays of points are (n, 2) north, east [m]."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from autopilot.core.frames import FloatArray
from autopilot.core.geometry import Circle, Polygon, Shape

BoolArray = NDArray[np.bool_]

PAIRS = 100_000
"""Pairs of edges, or of places and edges, that are computed at once: some megabytes."""
_TINY = 1e-300


def signed_area_m2(vertices: FloatArray) -> float:
    """Shoelace area of a polygon (n, 2), positive when it runs north to east (clockwise on a map)."""
    x, y = vertices[:, 0] - vertices[0, 0], vertices[:, 1] - vertices[0, 1]
    return 0.5 * float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


@dataclass(frozen=True, slots=True, eq=False)
class EdgeArrays:
    """Edges of polygons, (m,) each."""

    start_n: FloatArray
    start_e: FloatArray
    end_n: FloatArray
    end_e: FloatArray

    @classmethod
    def of(cls, polygons: Sequence[FloatArray]) -> "EdgeArrays":
        """All edges of polygons (k, 2) one after the other."""
        if not polygons:
            nothing = np.zeros(0)
            return cls(nothing, nothing, nothing, nothing)
        starts = np.concatenate(polygons)
        ends = np.concatenate([np.roll(vertices, -1, axis=0) for vertices in polygons])
        return cls(starts[:, 0], starts[:, 1], ends[:, 0], ends[:, 1])

    def offsets(self, places: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(n, m) from the nearest point of each edge to each place: north, east."""
        rel_n = places[:, :1] - self.start_n
        rel_e = places[:, 1:] - self.start_e
        along_n, along_e = self.end_n - self.start_n, self.end_e - self.start_e
        length_sq = np.maximum(along_n**2 + along_e**2, _TINY)
        fraction = np.clip((rel_n * along_n + rel_e * along_e) / length_sq, 0.0, 1.0)
        return rel_n - fraction * along_n, rel_e - fraction * along_e

    def crossed(self, places: FloatArray) -> BoolArray:
        """(n, m) whether the ray from each place to the north crosses each edge (even-odd rule)."""
        # Coordinates are compared, not differences: a corner has to be on the same side for both of its edges.
        north, east = places[:, :1], places[:, 1:]
        spans = (self.start_e > east) != (self.end_e > east)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            slant = (self.end_n - self.start_n) / (self.end_e - self.start_e)
            hit = north < self.start_n + (east - self.start_e) * slant
        result: BoolArray = spans & hit
        return result


def inside_polygon(vertices: FloatArray, points: FloatArray) -> BoolArray:
    """(n,) whether each point lies inside (even-odd rule; on the boundary either answer)."""
    return _enclosed(EdgeArrays.of([vertices]), points)


def is_inside(corners: Sequence[tuple[float, float]], north: float, east: float) -> bool:
    """Whether one point is inside, in plain floats: ten times as fast."""
    inside = False
    a_north, a_east = corners[-1]
    for b_north, b_east in corners:
        if (a_east > east) != (b_east > east):
            inside ^= north < a_north + (east - a_east) * (b_north - a_north) / (b_east - a_east)
        a_north, a_east = b_north, b_east
    return inside


def segment_distance_m(starts: FloatArray, ends: FloatArray, points: FloatArray) -> FloatArray:
    """(n, m) distance of n points to m segments (m, 2) -> (m, 2)."""
    along = ends - starts
    rel = points[:, None, :] - starts[None, :, :]
    length_sq = np.maximum(np.sum(along * along, axis=1), 1e-300)
    fraction = np.clip(np.einsum("nmk,mk->nm", rel, along) / length_sq, 0.0, 1.0)
    off = rel - fraction[:, :, None] * along[None, :, :]
    distance: FloatArray = np.hypot(off[:, :, 0], off[:, :, 1])
    return distance


def clearance_m(shape: Shape, points: FloatArray) -> FloatArray:
    """(n,) signed distance to a shape: positive outside, negative inside."""
    return signed_m(shape, points, np.inf)[0]


def signed_m(shape: Shape, places: FloatArray, reach_m: float) -> tuple[FloatArray, FloatArray]:
    """(n,) distance to a shape, negative inside, at least ``reach_m`` where it is more; (n, 2) its slope."""
    if isinstance(shape, Circle):
        off = places - shape.center_ned_m
        length = np.hypot(off[:, 0], off[:, 1])
        return length - shape.radius_m, off / np.maximum(length, _TINY)[:, None]
    edges = EdgeArrays.of([np.asarray(shape.vertices_ned_m)])
    distance, north, east = np.full(len(places), reach_m), np.zeros(len(places)), np.zeros(len(places))
    for at, some in _blocks(edges, places, reach_m):
        off_n, off_e = some.offsets(places[at])
        square = off_n * off_n + off_e * off_e
        pick = np.argmin(square, axis=1)
        rows = np.arange(len(pick))
        found = np.sqrt(square[rows, pick])
        less = found < distance[at]
        to = at[less]
        distance[to], north[to], east[to] = found[less], off_n[rows, pick][less], off_e[rows, pick][less]
    sign = np.where(_enclosed(edges, places), -1.0, 1.0)
    slope = np.stack((north, east), axis=1) * (sign / np.maximum(distance, _TINY))[:, None]
    return sign * distance, slope


def _enclosed(edges: EdgeArrays, places: FloatArray) -> BoolArray:
    """(n,) whether each place lies inside of the polygon that the edges are."""
    odd = np.zeros(len(places), dtype=bool)
    for at, some in _blocks(edges, places, None):
        odd[at] ^= np.logical_xor.reduce(some.crossed(places[at]), axis=1)
    return odd


def _blocks(
    edges: EdgeArrays, places: FloatArray, reach_m: float | None
) -> Iterator[tuple[NDArray[np.intp], EdgeArrays]]:
    """Places and edges in portions; with a reach, edges of large shapes only with the places near them."""
    count, everywhere = len(edges.start_n), np.arange(len(places))
    if count * len(places) <= 2 * PAIRS:
        yield everywhere, edges
        return
    for k in range(count):
        one = EdgeArrays(*(a[k : k + 1] for a in (edges.start_n, edges.start_e, edges.end_n, edges.end_e)))
        if reach_m is None:
            low, high = np.sort((one.start_e[0], one.end_e[0]))
            near = (places[:, 1] >= low) & (places[:, 1] <= high)
        else:
            near = np.ones(len(places), dtype=bool)
            for axis, start, end in ((0, one.start_n[0], one.end_n[0]), (1, one.start_e[0], one.end_e[0])):
                low, high = np.sort((start, end))
                near &= (places[:, axis] >= low - reach_m) & (places[:, axis] <= high + reach_m)
        at = everywhere[near]
        if len(at):
            yield at, one


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
    fraction = float(
        np.clip(np.dot(point - vertices[best], along) / max(float(np.dot(along, along)), 1e-300), 0.0, 1.0)
    )
    nearest: FloatArray = vertices[best] + fraction * along
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
