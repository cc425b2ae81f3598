"""Vectorised distances of many points to many small shapes within a given range.

Points are sorted into strips of the plane and by north within each, so that those in the box around a shape are
found by bisection, for all shapes at once.
"""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from autopilot.core.frames import FloatArray
from autopilot.core.geometry import Circle, Shape
from autopilot.core.shapes import PAIRS, EdgeArrays, bounding_box

IntArray = NDArray[np.intp]

Found = tuple[IntArray, IntArray, FloatArray, FloatArray]
"""Place, shape, signed distance, slope (.., 2) of pairs."""

STRIPS = 512
"""At most."""
TINY = 1e-300


class SmallShapes:
    """Circles and polygons of a few corners each, prepared once."""

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
