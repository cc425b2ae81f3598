"""Vectorised clearance of many points from a fence of many shapes.

:class:`Clearance` is exact and meant for some hundred points (waypoints, the vehicle). For the thousands of points
of a grid, :meth:`Clearance.near` evaluates shapes only within a given distance. Points are (n, 2) north, east [m];
clearance is positive in the permitted area and negative in the forbidden one.
"""

from collections.abc import Sequence

import numpy as np

from autopilot.core.frames import FloatArray
from autopilot.core.geometry import Circle, Fence, Shape
from autopilot.core.shapes import PAIRS, BoolArray, EdgeArrays, bounding_box, signed_m
from autopilot.mission.small_shapes import SmallShapes

FEW = 8
"""Up to so many shapes are evaluated one by one, more of them together."""
SMALL = 32
"""A shape with more corners is evaluated by itself."""


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
