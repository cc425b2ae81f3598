"""Free space of a random world on a fine grid, and time-optimal paths in its current.

Independent of the checks and planners of the service: shapes are rasterised, clearance is the distance transform,
paths come from Dijkstra's algorithm on cells.
"""

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias, cast

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import dijkstra

from autopilot.campaign.worlds.world_shapes import Disc, Point, WorldLayout
from autopilot.core.frames import FloatArray

BoolArray: TypeAlias = NDArray[np.bool_]
Flow: TypeAlias = Callable[[FloatArray], FloatArray]
"""Places (n, 2) -> water velocity (phases, n, 2): the same places at several times."""

MOST_PIXELS = 4_000_000
FINEST_M = 0.02
_SUBPIXEL_BITS = 6
OPEN_MARGIN_M = 8.0
"""Ground round everything in open water."""
PATH_CELL_M = 0.16
"""Cells of ways: less than the walls are thick once the vehicle's radius is added on both sides."""
PATH_MARGIN_M = 12.0
"""Paths are searched within this distance of the points that they connect."""
PATH_CELLS = 160_000
KEPT_GRAPHS = 3


@dataclass(frozen=True, slots=True)
class QuickestPath:
    time_s: float
    """inf = there is none."""
    length_m: float


NO_PATH = QuickestPath(math.inf, math.inf)


class DistanceMap:
    """Clearance everywhere, to within a pixel."""

    def __init__(
        self, layout: WorldLayout, places: list[Point], *, finest_m: float = FINEST_M, most_pixels: int = MOST_PIXELS
    ) -> None:
        """``places``: points that the grid has to contain beside the layout (by default it is as large as the
        outline).
        """
        low, high = _extent(layout, places)
        area = float(np.prod(high - low))
        self.pixel_m = max(finest_m, math.sqrt(area / most_pixels))
        self.low = low - self.pixel_m
        shape = np.ceil((high - low) / self.pixel_m).astype(int) + 3
        self.distance_m = self._clearance(layout, (int(shape[0]), int(shape[1])))
        """(north, east) distance of each pixel's centre from what is forbidden, 0 in it."""

    def _clearance(self, layout: WorldLayout, shape: tuple[int, int]) -> NDArray[np.float32]:
        free = np.zeros(shape, dtype=np.uint8)
        if layout.outline_m is None:
            free[:] = 1
        else:
            self._fill(free, np.array(layout.outline_m), 1)
        for solid in layout.solids:
            if isinstance(solid, Disc):
                north, east = self._scaled(np.array([solid.center_m]))[0]
                radius = round(solid.radius_m / self.pixel_m * 2**_SUBPIXEL_BITS)
                cv2.circle(free, (int(east), int(north)), radius, 0, -1, cv2.LINE_8, _SUBPIXEL_BITS)
            else:
                self._fill(free, np.array(solid.corners_m), 0)
        pixels = cv2.distanceTransform(free, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
        result: NDArray[np.float32] = np.maximum(pixels - np.float32(0.5), np.float32(0.0)) * np.float32(self.pixel_m)
        return result

    def _scaled(self, places: FloatArray) -> NDArray[np.int32]:
        """(n, 2) north, east in subpixels; a pixel's centre is its whole number."""
        pixels: NDArray[np.int32] = np.round(self._at(places) * 2**_SUBPIXEL_BITS).astype(np.int32)
        return pixels

    def _at(self, places: FloatArray) -> FloatArray:
        return (places - self.low) / self.pixel_m - 0.5

    def _fill(self, picture: NDArray[np.uint8], corners: FloatArray, value: int) -> None:
        cv2.fillPoly(picture, [self._scaled(corners)[:, ::-1].copy()], value, cv2.LINE_8, _SUBPIXEL_BITS)

    def clearance_m(self, place: Point) -> float:
        """At the pixel of a point."""
        north, east = self._index(place)
        return float(self.distance_m[north, east])

    def _index(self, place: Point) -> tuple[int, int]:
        at = np.round(self._at(np.array(place))).astype(int)
        limit = np.array(self.distance_m.shape) - 1
        north, east = np.clip(at, 0, limit)
        return int(north), int(east)

    def regions(self, keep_m: float) -> NDArray[np.int32]:
        """Number of the connected region of each pixel, 0 where less than ``keep_m`` is left."""
        mask = (self.distance_m >= keep_m).astype(np.uint8)
        return np.asarray(cv2.connectedComponents(mask, connectivity=8)[1], dtype=np.int32)

    def regions_near(self, regions: NDArray[np.int32], place: Point, reach_m: float) -> set[int]:
        """Regions within ``reach_m`` of a point."""
        north, east = self._index(place)
        r = max(1, math.ceil(reach_m / self.pixel_m))
        window = regions[max(0, north - r) : north + r + 1, max(0, east - r) : east + r + 1]
        return {int(number) for number in np.unique(window)} - {0}

    def paths(self, keep_m: float, places: list[Point]) -> "QuickestPaths":
        """Cells near these points with clearance ``keep_m``."""
        points = np.array(places)
        low = np.maximum(points.min(axis=0) - PATH_MARGIN_M, self.low)
        high = np.minimum(points.max(axis=0) + PATH_MARGIN_M, self.low + self.pixel_m * np.array(self.distance_m.shape))
        first = np.maximum(np.floor((low - self.low) / self.pixel_m).astype(int), 0)
        last = np.minimum(np.ceil((high - self.low) / self.pixel_m).astype(int), np.array(self.distance_m.shape))
        free = self.distance_m[first[0] : last[0], first[1] : last[1]] >= keep_m
        cell_m = max(PATH_CELL_M, math.sqrt(float(np.prod(high - low)) / PATH_CELLS))
        block = max(1, math.floor(cell_m / self.pixel_m))
        return QuickestPaths(_any_of(free, block), self.low + first * self.pixel_m, block * self.pixel_m)


class QuickestPaths:
    def __init__(self, free: BoolArray, low: FloatArray, cell_m: float) -> None:
        self._low, self._cell_m = low, cell_m
        self._number: NDArray[np.int64] = np.full(free.shape, -1, dtype=np.int64)
        self._number[free] = np.arange(int(free.sum()))
        self._places = low + (np.argwhere(free) + 0.5) * cell_m
        self._graphs: dict[tuple[Flow, float, float, bool], sparse.csr_matrix] = {}

    def quickest(
        self, start: Point, goal: Point, reach_m: float, flow: Flow, *, water_m_s: float, ground_m_s: float, worst: bool
    ) -> QuickestPath:
        """Time-optimal path from a point to within ``reach_m`` of another, at ``water_m_s`` through the water and
        at most ``ground_m_s`` over ground, in the worst (or the best) of the phases of the flow.
        """
        path = self._path(start, goal, reach_m, self._graph_of(flow, water_m_s, ground_m_s, worst=worst))
        return NO_PATH if path is None else QuickestPath(path[1], self._length(path[0]))

    def shortest(
        self, start: Point, goal: Point, reach_m: float, flow: Flow, *, water_m_s: float, ground_m_s: float
    ) -> QuickestPath:
        """The same along the shortest path over ground, in the worst of the phases of the flow."""
        path = self._path(start, goal, reach_m, self._graph_of(still, ground_m_s, ground_m_s, worst=True))
        if path is None:
            return NO_PATH
        cells = path[0]
        graph = self._graph_of(flow, water_m_s, ground_m_s, worst=True)
        times = [float(graph[a, b]) for a, b in itertools.pairwise(cells)]
        # Edges not in the graph are no paths, and read 0.
        return QuickestPath(sum(times) if all(times) else math.inf, self._length(cells))

    def _path(
        self, start: Point, goal: Point, reach_m: float, graph: sparse.csr_matrix
    ) -> tuple[list[int], float] | None:
        """Cells of the path and its time, None without one."""
        if not len(self._places):
            return None
        away = np.hypot(*(self._places - np.array(start)).T)
        source = int(np.argmin(away))
        near = np.hypot(*(self._places - np.array(goal)).T)
        ends = np.flatnonzero(near <= max(reach_m, 1.5 * self._cell_m))
        if away[source] > 1.0 or not len(ends):
            return None
        times, before = cast(Any, dijkstra)(graph, indices=source, return_predecessors=True)
        end = int(ends[np.argmin(times[ends])])
        if not math.isfinite(times[end]):
            return None
        cells = [end]
        while before[cells[-1]] >= 0:
            cells.append(int(before[cells[-1]]))
        return cells[::-1], float(times[end])

    def _length(self, cells: list[int]) -> float:
        return sum(math.dist(self._places[a], self._places[b]) for a, b in itertools.pairwise(cells))

    def _graph_of(self, flow: Flow, water_m_s: float, ground_m_s: float, *, worst: bool) -> sparse.csr_matrix:
        """The graph of these speeds; the last ones are kept."""
        key = (flow, water_m_s, ground_m_s, worst)
        if key not in self._graphs:
            while len(self._graphs) >= KEPT_GRAPHS:
                del self._graphs[next(iter(self._graphs))]
            self._graphs[key] = self._edges(flow, water_m_s, ground_m_s, worst=worst)
        return self._graphs[key]

    def _edges(self, flow: Flow, water_m_s: float, ground_m_s: float, *, worst: bool) -> sparse.csr_matrix:
        current = flow(self._places)
        edges = [self._direction(step, current, water_m_s, ground_m_s, worst=worst) for step in _STEPS]
        rows, columns, times = (np.concatenate([edge[part] for edge in edges]) for part in range(3))
        count = len(self._places)
        return sparse.csr_matrix((times, (rows, columns)), shape=(count, count))

    def _direction(
        self, step: tuple[int, int], current: FloatArray, water_m_s: float, ground_m_s: float, *, worst: bool
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], FloatArray]:
        """Edges of one direction (from, to, time): ground speed from water speed and the current's parts."""
        target = self._moved(step)
        both = (self._number >= 0) & (target >= 0)
        if 2 in (abs(step[0]), abs(step[1])):
            # A knight's move needs the two cells between.
            half = (round(math.copysign(abs(step[0]) // 2, step[0])), round(math.copysign(abs(step[1]) // 2, step[1])))
            rest = (step[0] - half[0], step[1] - half[1])
            both &= (self._moved(half) >= 0) & (self._moved(rest) >= 0)
        at, to = self._number[both], target[both]
        size = math.hypot(*step)
        unit = np.array(step) / size
        along = current[:, at] @ unit
        across = current[:, at, 0] * unit[1] - current[:, at, 1] * unit[0]
        speed = along + np.sqrt(np.maximum(water_m_s**2 - across**2, 0.0))
        speed = np.where(np.abs(across) < water_m_s, speed, 0.0)
        speed = np.minimum(speed.min(axis=0) if worst else speed.max(axis=0), ground_m_s)
        moves = speed > SLOWEST_M_S
        return at[moves], to[moves], self._cell_m * size / speed[moves]

    def _moved(self, step: tuple[int, int]) -> NDArray[np.int64]:
        """Number of the cell one step further, seen from each cell; -1 where nothing is free."""
        rows, columns = self._number.shape
        padded = np.pad(self._number, 2, constant_values=-1)
        return padded[2 + step[0] : 2 + step[0] + rows, 2 + step[1] : 2 + step[1] + columns]


_STEPS = tuple(
    (north, east)
    for north in range(-2, 3)
    for east in range(-2, 3)
    if (north, east) != (0, 0) and math.gcd(north, east) == 1
)


def still(places: FloatArray) -> FloatArray:
    return np.zeros((1, len(places), 2))


SLOWEST_M_S = 0.02
"""Slower than this over ground counts as impassable."""


def _any_of(free: BoolArray, block: int) -> BoolArray:
    """Cells of block x block pixels in which any is free."""
    rows, columns = (-(-size // block) for size in free.shape)
    padded = np.zeros((rows * block, columns * block), dtype=bool)
    padded[: free.shape[0], : free.shape[1]] = free
    return np.asarray(padded.reshape(rows, block, columns, block).any(axis=(1, 3)), dtype=np.bool_)


def _extent(layout: WorldLayout, places: list[Point]) -> tuple[FloatArray, FloatArray]:
    if layout.outline_m is not None:
        corners = np.array(layout.outline_m)
        return corners.min(axis=0), corners.max(axis=0)
    points = [np.array(places)]
    for solid in layout.solids:
        if isinstance(solid, Disc):
            points.append(np.array(solid.center_m) + solid.radius_m * np.array([(1.0, 1.0), (-1.0, -1.0)]))
        else:
            points.append(np.array(solid.corners_m))
    everything = np.concatenate(points)
    return everything.min(axis=0) - OPEN_MARGIN_M, everything.max(axis=0) + OPEN_MARGIN_M
