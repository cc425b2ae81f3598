"""Vectorised clearance of many points from a fence of many shapes.

:class:`Clearance` is exact and meant for some hundred points (waypoints, the vehicle). For the thousands of points
of a grid, :meth:`Clearance.near` evaluates shapes only within a given distance. Points are (n, 2) north, east [m];
clearance is positive in the permitted area and negative in the forbidden one.
"""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from autopilot.core.frames import FloatArray
from autopilot.core.geometry import Circle, Fence, Shape
from autopilot.core.shapes import PAIRS, BoolArray, EdgeArrays, bounding_box, signed_m

FEW = 8
"""Up to so many shapes are evaluated one by one, more of them together."""
SMALL = 32
"""A shape with more corners is evaluated by itself."""
IntArray = NDArray[np.intp]

Found = tuple[IntArray, IntArray, FloatArray, FloatArray]
"""Place, shape, signed distance, slope (.., 2) of pairs."""

STRIPS = 512
"""At most."""
TINY = 1e-300


class SmallShapes:
    """Distances of many points to many circles and polygons of a few corners each, prepared once.

    Points are sorted into strips of the plane and by north within each, so that those in the box around a shape are
    found by bisection, for all shapes at once."""

    def __init__(self, shapes: Sequence[Shape]) -> None:
        boxes = [bounding_box(shape) for shape in shapes]
        self._low, self._high = (np.array([box[k] for box in boxes]).reshape(-1, 2) for k in range(2))
        self._round = np.array([isinstance(shape, Circle) for shape in shapes], dtype=bool)
        self._center = 0.5 * (self._low + self._high)
        self._radius = np.zeros(len(shapes))
        for k, shape in enumerate(shapes):
            if isinstance(shape, Circle):
                self._center[k], self._radius[k] = shape.center_ned_m, shape.radius_m
        corners = [np.zeros((0, 2)) if isinstance(s, Circle) else np.asarray(s.vertices_ned_m) for s in shapes]
        self._edges = EdgeArrays.of(corners)
        self._corners = np.array([len(c) for c in corners])
        self._first = np.concatenate([[0], np.cumsum(self._corners)])[:-1]

    def near(self, places: FloatArray, reach_m: float) -> tuple[IntArray, FloatArray, FloatArray]:
        """Which of the points (n, 2) are nearer than ``reach_m`` to a shape or in one, their signed distances to
        the nearest, and its gradient (k, 2).
        """
        found = [
            part
            for place, shape in self._pairs(places, reach_m)
            for part in (self._circles(places, place, shape), self._polygons(places, place, shape))
        ]
        if not found:
            return np.zeros(0, dtype=np.intp), np.zeros(0), np.zeros((0, 2))
        place, shape, signed, slope = (np.concatenate(column) for column in zip(*found, strict=True))
        close = np.flatnonzero(signed < reach_m)
        order = close[np.lexsort((shape[close], signed[close], place[close]))]
        nearest = order[np.concatenate([[True], np.diff(place[order]) > 0])[: len(order)]]
        return place[nearest], signed[nearest], slope[nearest]

    def _pairs(self, places: FloatArray, reach_m: float) -> Iterator[tuple[IntArray, IntArray]]:
        """Pairs (m,) of points and shapes whose boxes, widened by the reach, contain them; in portions."""
        if not len(places):
            return
        low, high = self._low - reach_m, self._high + reach_m
        begin, end = places.min(axis=0), places.max(axis=0)
        wide_m = max(float((high - low)[:, 1].mean()), float(end[1] - begin[1]) / STRIPS, 1e-9)
        tall_m = float(end[0] - begin[0]) + 1.0
        strip = np.floor((places[:, 1] - begin[1]) / wide_m)
        key = strip * tall_m + (places[:, 0] - begin[0])
        order = np.argsort(key, kind="stable")
        key = key[order]
        last = int(strip.max())
        span = np.floor((np.stack([low[:, 1], high[:, 1]]) - begin[1]) / wide_m)
        strips = np.clip(span, -1, last + 1).astype(np.intp)
        from_, to = np.maximum(strips[0], 0), np.minimum(strips[1], last)
        shape, within = _runs(np.maximum(to - from_ + 1, 0))
        base = (from_[shape] + within) * tall_m
        bounds = np.clip(np.stack([low[shape, 0], high[shape, 0]]) - begin[0], [[-0.25], [-0.25]], tall_m - 0.5)
        first = np.searchsorted(key, base + bounds[0], side="left")
        count = np.searchsorted(key, base + bounds[1], side="right") - first
        portion = np.cumsum(count) // PAIRS
        for number in np.unique(portion):
            some = portion == number
            run, offset = _runs(count[some])
            place, which = order[first[some][run] + offset], shape[some][run]
            east = places[place, 1]
            inside = (east >= low[which, 1]) & (east <= high[which, 1])
            yield place[inside], which[inside]

    def _circles(self, places: FloatArray, place: IntArray, shape: IntArray) -> Found:
        """Of pairs with circles: point, shape, signed distance, gradient."""
        mine = self._round[shape]
        place, shape = place[mine], shape[mine]
        off = places[place] - self._center[shape]
        length = np.hypot(off[:, 0], off[:, 1])
        return place, shape, length - self._radius[shape], off / np.maximum(length, TINY)[:, None]

    def _polygons(self, places: FloatArray, place: IntArray, shape: IntArray) -> Found:
        """The same of pairs with polygons."""
        mine = ~self._round[shape]
        place, shape = place[mine], shape[mine]
        if not len(place):
            return place, shape, np.zeros(0), np.zeros((0, 2))
        pair, corner = _runs(self._corners[shape])
        at = self._first[shape][pair] + corner
        every = self._edges
        edges = EdgeArrays(
            every.start_n[at, None], every.start_e[at, None], every.end_n[at, None], every.end_e[at, None]
        )
        points = places[place][pair]
        off_n, off_e = (a[:, 0] for a in edges.offsets(points))
        square = off_n * off_n + off_e * off_e
        starts = np.flatnonzero(corner == 0)
        least = np.lexsort((square, pair))[starts]
        odd = np.add.reduceat(edges.crossed(points)[:, 0].astype(np.intp), starts) % 2 == 1
        distance, sign = np.sqrt(square[least]), np.where(odd, -1.0, 1.0)
        slope = np.stack((off_n[least], off_e[least]), axis=1) * (sign / np.maximum(distance, TINY))[:, None]
        return place, shape, sign * distance, slope


def _runs(count: IntArray) -> tuple[IntArray, IntArray]:
    """Numbers 0, 1, ... each repeated ``count`` times, and the index within each run."""
    number = np.repeat(np.arange(len(count)), count)
    return number, np.arange(len(number)) - np.repeat(np.cumsum(count) - count, count)


class Clearance:
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
        self._edges = EdgeArrays.of(polygons)
        self._first = np.cumsum([0] + [len(p) for p in polygons[:-1]]) if polygons else np.zeros(0, dtype=int)
        self._sign = np.array([-1.0 if inclusion else 1.0 for _, inclusion in shapes])
        boxes = [bounding_box(shape) for shape, _ in shapes]
        self._low = np.array([low for low, _ in boxes]).reshape(-1, 2)
        self._high = np.array([high for _, high in boxes]).reshape(-1, 2)
        small = [k for k, (s, inclusion) in enumerate(shapes) if not inclusion and _corners(s) <= SMALL]
        self._alone = np.ones(len(shapes), dtype=bool)
        self._small: SmallShapes | None = None
        if len(small) > FEW:
            self._alone[small] = False
            self._small = SmallShapes([shapes[k][0] for k in small])

    @classmethod
    def of(cls, fence: Fence) -> "Clearance":
        """Clearance of a workspace; its inclusions come first."""
        return cls([*((s, True) for s in fence.inclusions), *((s, False) for s in fence.exclusions)])

    def of_shapes_m(self, places: FloatArray) -> FloatArray:
        """(n, shapes) clearance of each point from each shape, in the order given."""
        chunk = max(1, PAIRS // max(1, len(self._edges.start_n) + len(self._radii)))
        parts = [self._some(places[at : at + chunk]) for at in range(0, len(places), chunk)]
        return np.concatenate(parts) if parts else np.zeros((0, len(self._shapes)))

    def clearance_m(self, places: FloatArray) -> FloatArray:
        """(n,) clearance of each point: inf in open water."""
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
        """(n,) clearance clipped to +-``reach_m``, and (n, 2) its gradient (zero where it is clipped)."""
        best, slope = np.full(len(places), reach_m), np.zeros((len(places), 2))
        beside = self._beside(places, reach_m)
        if not beside[self._sign < 0.0].all():
            return np.full(len(places), -reach_m), slope
        order = np.argsort(places[:, 0], kind="stable")
        north = places[order, 0]
        if self._small is not None and (beside & ~self._alone).any():
            at, signed, uphill = self._small.near(places, reach_m)
            best[at], slope[at] = signed, uphill
        for k in np.flatnonzero(beside & self._alone):
            (shape, inclusion), low, high = self._shapes[k], self._low[k], self._high[k]
            first, last = np.searchsorted(north, (low[0] - reach_m, high[0] + reach_m))
            slab = order[first:last]
            east = places[slab, 1]
            at = slab[(east >= low[1] - reach_m) & (east <= high[1] + reach_m)]
            if inclusion:
                away = np.ones(len(places), dtype=bool)
                away[at] = False
                best[away], slope[away] = -reach_m, 0.0
            signed, uphill = signed_m(shape, places[at], reach_m)
            if inclusion:
                signed, uphill = -signed, -uphill
            less = signed < best[at]
            best[at[less]], slope[at[less]] = signed[less], uphill[less]
        cut = np.abs(best) >= reach_m
        slope[cut] = 0.0
        return np.clip(best, -reach_m, reach_m), slope

    def _beside(self, places: FloatArray, reach_m: float) -> BoolArray:
        """(shapes,) whether any of the points can be that near to a shape, by their bounding box."""
        if not len(places):
            return np.zeros(len(self._shapes), dtype=bool)
        near_low, near_high = self._low - reach_m <= places.max(axis=0), self._high + reach_m >= places.min(axis=0)
        beside: BoolArray = (near_low & near_high).all(axis=1)
        return beside


def _corners(shape: Shape) -> int:
    return 1 if isinstance(shape, Circle) else len(shape.vertices_ned_m)
