"""Clearance of many places from a fence of many shapes, without a loop over edges.

:class:`Room` is exact and meant for some hundred places (waypoints, the vehicle). For the thousands of places of a
grid, :meth:`Room.near` only looks at shapes where they are nearer than a distance that matters. Places are (n, 2)
north, east [m]; clearance is positive where the vehicle may be and negative in what the fence forbids.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from autopilot.core.frames import FloatArray
from autopilot.core.geometry import Circle, Fence, Shape
from mission.shapes import PAIRS, bounding_box

BoolArray = NDArray[np.bool_]

_TINY = 1e-300


@dataclass(frozen=True, slots=True, eq=False)
class _Edges:
    """Edges of polygons, (m,) each."""

    start_n: FloatArray
    start_e: FloatArray
    end_n: FloatArray
    end_e: FloatArray

    @classmethod
    def of(cls, polygons: Sequence[FloatArray]) -> "_Edges":
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
        share = np.clip((rel_n * along_n + rel_e * along_e) / length_sq, 0.0, 1.0)
        return rel_n - share * along_n, rel_e - share * along_e

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


class Room:
    """The free space of a fence, prepared once."""

    def __init__(self, shapes: Sequence[tuple[Shape, bool]]) -> None:
        """``shapes``: each with whether it is an inclusion."""
        self._shapes = tuple(shapes)
        self._round = [k for k, (shape, _) in enumerate(shapes) if isinstance(shape, Circle)]
        self._many = [k for k, (shape, _) in enumerate(shapes) if not isinstance(shape, Circle)]
        circles = [shape for shape, _ in shapes if isinstance(shape, Circle)]
        self._centers = np.array([c.center_ned_m for c in circles]).reshape(-1, 2)
        self._radii = np.array([c.radius_m for c in circles])
        polygons = [np.asarray(s.vertices_ned_m) for s, _ in shapes if not isinstance(s, Circle)]
        self._edges = _Edges.of(polygons)
        self._first = np.cumsum([0] + [len(p) for p in polygons[:-1]]) if polygons else np.zeros(0, dtype=int)
        self._sign = np.array([-1.0 if inclusion else 1.0 for _, inclusion in shapes])

    @classmethod
    def of(cls, fence: Fence) -> "Room":
        """The room of a workspace; its inclusions come first."""
        return cls([*((s, True) for s in fence.inclusions), *((s, False) for s in fence.exclusions)])

    def of_shapes_m(self, places: FloatArray) -> FloatArray:
        """(n, shapes) clearance of each place from each shape, in the order given."""
        chunk = max(1, PAIRS // max(1, len(self._edges.start_n) + len(self._radii)))
        parts = [self._some(places[at : at + chunk]) for at in range(0, len(places), chunk)]
        return np.concatenate(parts) if parts else np.zeros((0, len(self._shapes)))

    def clearance_m(self, places: FloatArray) -> FloatArray:
        """(n,) clearance of each place: inf in open water."""
        if not self._shapes:
            return np.full(len(places), np.inf)
        clearance: FloatArray = self.of_shapes_m(places).min(axis=1)
        return clearance

    def _some(self, places: FloatArray) -> FloatArray:
        result = np.empty((len(places), len(self._shapes)))
        if self._round:
            off = places[:, None, :] - self._centers
            result[:, self._round] = np.hypot(off[:, :, 0], off[:, :, 1]) - self._radii
        if self._many:
            north, east = self._edges.offsets(places)
            distance = np.sqrt(np.minimum.reduceat(north * north + east * east, self._first, axis=1))
            crossings = np.add.reduceat(self._edges.crossed(places).astype(np.int32), self._first, axis=1)
            result[:, self._many] = np.where(crossings % 2 == 1, -distance, distance)
        signed: FloatArray = result * self._sign
        return signed

    def near(self, places: FloatArray, reach_m: float) -> tuple[FloatArray, FloatArray]:
        """(n,) clearance cut off at +-``reach_m``, and (n, 2) its slope (zero where it is cut off)."""
        best, slope = np.full(len(places), reach_m), np.zeros((len(places), 2))
        order = np.argsort(places[:, 0], kind="stable")
        north = places[order, 0]
        for shape, inclusion in self._shapes:
            low, high = bounding_box(shape)
            first, last = np.searchsorted(north, (low[0] - reach_m, high[0] + reach_m))
            slab = order[first:last]
            beside = places[slab, 1]
            at = slab[(beside >= low[1] - reach_m) & (beside <= high[1] + reach_m)]
            if inclusion:
                away = np.ones(len(places), dtype=bool)
                away[at] = False
                best[away], slope[away] = -reach_m, 0.0
            signed, uphill = _signed(shape, places[at], reach_m)
            if inclusion:
                signed, uphill = -signed, -uphill
            less = signed < best[at]
            best[at[less]], slope[at[less]] = signed[less], uphill[less]
        cut = np.abs(best) >= reach_m
        slope[cut] = 0.0
        return np.clip(best, -reach_m, reach_m), slope


def _signed(shape: Shape, places: FloatArray, reach_m: float) -> tuple[FloatArray, FloatArray]:
    """(n,) distance to a shape, negative inside, at least ``reach_m`` where it is more; (n, 2) its slope."""
    if isinstance(shape, Circle):
        off = places - shape.center_ned_m
        length = np.hypot(off[:, 0], off[:, 1])
        return length - shape.radius_m, off / np.maximum(length, _TINY)[:, None]
    edges = _Edges.of([np.asarray(shape.vertices_ned_m)])
    distance, north, east = np.full(len(places), reach_m), np.zeros(len(places)), np.zeros(len(places))
    odd = np.zeros(len(places), dtype=bool)
    for at, some in _blocks(edges, places, reach_m):
        off_n, off_e = some.offsets(places[at])
        square = off_n * off_n + off_e * off_e
        pick = np.argmin(square, axis=1)
        rows = np.arange(len(pick))
        found = np.sqrt(square[rows, pick])
        less = found < distance[at]
        to = at[less]
        distance[to], north[to], east[to] = found[less], off_n[rows, pick][less], off_e[rows, pick][less]
    for at, some in _blocks(edges, places, None):
        odd[at] ^= np.logical_xor.reduce(some.crossed(places[at]), axis=1)
    sign = np.where(odd, -1.0, 1.0)
    slope = np.stack((north, east), axis=1) * (sign / np.maximum(distance, _TINY))[:, None]
    return sign * distance, slope


def _blocks(edges: _Edges, places: FloatArray, reach_m: float | None) -> Iterator[tuple[NDArray[np.intp], _Edges]]:
    """Places and edges in portions; with a reach, edges of large shapes only with the places near them."""
    count, everywhere = len(edges.start_n), np.arange(len(places))
    if count * len(places) <= 2 * PAIRS:
        yield everywhere, edges
        return
    for k in range(count):
        one = _Edges(*(a[k : k + 1] for a in (edges.start_n, edges.start_e, edges.end_n, edges.end_e)))
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
