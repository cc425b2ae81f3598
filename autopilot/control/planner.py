"""Shortest free path round the inflated fence, so that the NMPC does not end in a pocket.

A grid over the workspace, its geodesic distance from the goal (Dijkstra, 16 neighbours), descent from the vehicle, and
line-of-sight short cuts. The grid belongs to a fence, the distance field to a goal; both are made only when that
changes, and not at all while the straight line is free. What is kept saves time and changes no answer: a path is a
function of fence, radius, start and goal.

:meth:`Planner.path` takes up to half a second and is for a desk; everything else fits into a control step.
"""

import math
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from autopilot.control.obstacles import Features
from autopilot.control.shortest import lengths_from
from autopilot.core.desk import Cancel
from autopilot.core.frames import FloatArray
from autopilot.core.geometry import Circle, Fence

PLANNING_EXTRA_M = 0.04
"""Kept beyond the controller's own radius, so that the path lies where the controller can follow it with a margin, and
a passage that is open by centimetres only is not chosen."""

FINEST_CELL_M = 0.05
TIGHT_CELL_M = 0.02
"""Cell of the second look, which finds passages that are open by centimetres when there is no other way."""

SETTLED_M = 5e-4
"""A place that keeps the radius but for this much is free: doors that are open by a millimetre are found."""

CHORD_LOSS_M = 2e-3
"""By how much the line between two such places may cut a corner."""

MAX_CELLS = 40_000
TILE_CELLS = 8
"""Side of the tiles in which cells are looked at together."""

OPEN_WATER_BORDER_M = 3.0
"""Without a workspace the grid covers start, goal and obstacles and this much beyond ..."""

OPEN_WATER_STEP_M = 2.0
"""... up to the next multiple of this: a start that has moved a little has the same grid."""

LOOK_BACK_M = 10.0
"""So much of a path that was made for another fence is looked at before it is gone on with."""

GOAL_SNAP_M = 0.3
"""A goal this near to free ground is approached as far as the constraints allow."""

ENDPOINT_RELIEF_M = 0.25
"""Near its ends a straight line may be as near to a boundary as the end itself."""

BAND_STEP_M = 0.1
MAX_BAND_POINTS = 60
BAND_ITERATIONS = 25
"""Enough to round a corner over half a metre."""

SETTLE_ITERATIONS = 3
"""Steps by which a place finds the middle of a door: each brings it away from the nearer side."""

Edges: TypeAlias = tuple[NDArray[np.intp], NDArray[np.intp], FloatArray]
"""From, to, length [m]."""

_OFFSETS = ((0, 1), (1, 0), (1, 1), (1, -1), (1, 2), (2, 1), (1, -2), (2, -1))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Grid:
    """Free cells of the workspace and their connections."""

    origin_m: FloatArray
    high_m: FloatArray
    cell_m: float
    position_m: FloatArray
    """(nodes, 2)"""
    edges: Edges


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Field:
    """Distance to one goal."""

    goal_m: FloatArray
    distance_m: FloatArray
    next_node: NDArray[np.int32]
    """(nodes,) the next node towards the goal."""


class Planner:
    """Paths in one fence with one radius: comfortable ones if there are any, else tight ones."""

    def __init__(self, fence: Fence, radius_m: float) -> None:
        self.features = Features(fence)
        self._looks = (
            _Look(fence, self.features, radius_m, PLANNING_EXTRA_M, FINEST_CELL_M, squeeze=False),
            _Look(fence, self.features, radius_m, 0.0, TIGHT_CELL_M, squeeze=True),
        )

    def path(self, start_ned_m: FloatArray, goal_ned_m: FloatArray, cancel: Cancel | None = None) -> FloatArray | None:
        """Corner points (m, 2) of a free path, first row the start, last the goal; None if there is no way.

        Ends with WithdrawnError once ``cancel`` is requested.
        """
        start, goal = np.asarray(start_ned_m[:2], dtype=float), np.asarray(goal_ned_m[:2], dtype=float)
        for look in self._looks:
            path = look.path(start, goal, cancel or Cancel())
            if path is not None:
                return path
        return None

    def sees(self, start_ned_m: FloatArray, goal_ned_m: FloatArray) -> bool:
        """Whether the straight line is such a path (and a comfortable one)."""
        start, goal = np.asarray(start_ned_m[:2], dtype=float), np.asarray(goal_ned_m[:2], dtype=float)
        return self._looks[0].sees(start, goal)

    def free(self, path_ned_m: FloatArray) -> bool:
        """Whether a path (m, 2) that was made for another fence can be gone on with for the next metres."""
        return self._looks[1].free(path_ned_m)


class _Look:
    """Paths that keep ``extra_m`` beyond a radius."""

    def __init__(
        self, fence: Fence, features: Features, radius_m: float, extra_m: float, cell_m: float, *, squeeze: bool
    ) -> None:
        """``squeeze``: cells count in which the vehicle can stand anywhere, not only in the middle."""
        self.fence = fence
        self.features = features
        self.radius_m = radius_m + extra_m
        self._slack_m = 0.5 * extra_m
        self._cell_m, self._squeeze = cell_m, squeeze
        self._allowed_m = self.radius_m - (CHORD_LOSS_M if squeeze else 0.0)
        """What a straight line has to keep."""
        self._grid: _Grid | None = None
        self._field: _Field | None = None

    def path(self, start: FloatArray, goal: FloatArray, cancel: Cancel) -> FloatArray | None:
        """:meth:`Planner.path` of points (2,)."""
        if self.sees(start, goal):
            return np.stack([start, goal])
        cancel.check()
        grid = self._grid_for(start, goal)
        if len(grid.position_m) == 0:
            return None
        cancel.check()
        field = self._field_for(grid, goal)
        if field is None:
            return None
        cancel.check()
        node = int(((grid.position_m - start) ** 2).sum(axis=1).argmin())
        if not math.isfinite(field.distance_m[node]):
            return None
        nodes = [node]
        while field.next_node[nodes[-1]] >= 0:
            nodes.append(int(field.next_node[nodes[-1]]))
        points = np.concatenate([start[None], grid.position_m[nodes], goal[None]])
        path = self._shortcut(points)
        band = self._relax(path)
        # A long path in a small band has points too far apart to be kept off small obstacles.
        return band if self._keeps_clear(band) else path

    def sees(self, a: FloatArray, b: FloatArray) -> bool:
        """True if the straight line from a to b (2,) keeps the planning radius, apart from what its ends force."""
        if self.features.count == 0:
            return True
        length = math.hypot(*(b - a))
        steps = max(2, math.ceil(length / min(FINEST_CELL_M, self.radius_m / 4.0)))
        steps = min(steps, 4000)
        share = np.linspace(0.0, 1.0, steps + 1)
        clearance = self.features.clearance_up_to_m(a + share[:, None] * (b - a), 2.0 * self.radius_m)
        need = np.full(steps + 1, self._allowed_m)
        for end, along in ((0, share), (-1, 1.0 - share)):
            relief = along * length < ENDPOINT_RELIEF_M
            need[relief] = np.minimum(need[relief], clearance[end] - 1e-3)
        if clearance[0] < 0.0 or clearance[-1] < 0.0:
            return False
        return bool((clearance >= need).all())

    def free(self, path: FloatArray) -> bool:
        """:meth:`Planner.free`."""
        if self.features.count == 0:
            return True
        s = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(path, axis=0).T))))
        at = np.arange(0.0, min(float(s[-1]), LOOK_BACK_M) + FINEST_CELL_M, FINEST_CELL_M)
        points = np.stack([np.interp(at, s, path[:, 0]), np.interp(at, s, path[:, 1])], axis=1)
        clearance = self.features.clearance_up_to_m(points, 2.0 * self.radius_m)
        # Where the vehicle is it may be nearer.
        need = np.where(at < ENDPOINT_RELIEF_M, min(self._allowed_m, float(clearance[0]) - 1e-3), self._allowed_m)
        return bool(clearance[0] >= 0.0 and (clearance >= need).all())

    def _shortcut(self, points: FloatArray) -> FloatArray:
        kept, i = [0], 0
        while i < len(points) - 1:
            low, high = i + 1, len(points) - 1
            if self.sees(points[i], points[high]):
                low = high
            while high - low > 1:
                middle = (low + high) // 2
                if self.sees(points[i], points[middle]):
                    low = middle
                else:
                    high = middle
            i = low
            kept.append(i)
        return points[kept]

    def _relax(self, points: FloatArray) -> FloatArray:
        """The path as an elastic band: corners become bends that lie against the inflated fence."""
        length = np.hypot(*np.diff(points, axis=0).T)
        s = np.concatenate(([0.0], np.cumsum(length)))
        count = min(max(int(s[-1] / BAND_STEP_M), 2), MAX_BAND_POINTS)
        at = np.linspace(0.0, s[-1], count + 1)
        band = np.stack([np.interp(at, s, points[:, 0]), np.interp(at, s, points[:, 1])], axis=1)
        for _ in range(BAND_ITERATIONS):
            band[1:-1] += 0.5 * (0.5 * (band[:-2] + band[2:]) - band[1:-1])
            band[1:-1] += self.features.push_out(band[1:-1], self.radius_m)
        return band

    def _keeps_clear(self, band: FloatArray) -> bool:
        share = np.linspace(0.0, 1.0, 8, endpoint=False)[:, None, None]
        between = (band[:-1] + share * np.diff(band, axis=0)).reshape(-1, 2)
        needed = float(self.features.clearance_up_to_m(band, self.radius_m).min()) - self._slack_m
        return bool((self.features.clearance_up_to_m(between, self.radius_m) >= needed).all())

    def _grid_for(self, start: FloatArray, goal: FloatArray) -> _Grid:
        low, high = self._bounds(start, goal)
        grid = self._grid
        if grid is not None and bool((grid.origin_m == low).all() and (grid.high_m == high).all()):
            return grid
        size = high - low
        cell = max(self._cell_m, math.sqrt(float(size[0] * size[1]) / MAX_CELLS))
        shape = (int(size[0] / cell) + 1, int(size[1] / cell) + 1)
        x = low[0] + cell * (np.arange(shape[0]) + 0.5)
        y = low[1] + cell * (np.arange(shape[1]) + 0.5)
        centers = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
        # Between two cells that far from a corner, the longest edge (a knight's move) keeps the radius.
        needed = math.hypot(self.radius_m, 0.5 * math.sqrt(5.0) * cell)
        by_tile = _tile_order(shape)
        clearance = np.empty(len(centers))
        clearance[by_tile] = self.features.clearance_up_to_m(centers[by_tile], needed)
        free = clearance >= needed
        tight = np.zeros(len(centers), dtype=bool)
        if self._squeeze:
            tight = self._settle(centers, by_tile[self._settleable(clearance, cell, needed)[by_tile]], cell)
            free |= tight
        node_of_cell = np.full(len(centers), -1)
        node_of_cell[free] = np.arange(int(free.sum()))
        edges = _connect(node_of_cell.reshape(shape), cell)
        if tight.any():
            edges = self._keep_clear(edges, centers[free], tight[free], cell)
        self._grid = _Grid(
            origin_m=low,
            high_m=high,
            cell_m=cell,
            position_m=centers[free],
            edges=edges,
        )
        self._field = None
        return self._grid

    def _settleable(self, clearance: FloatArray, cell_m: float, needed_m: float) -> NDArray[np.bool_]:
        """Cells that are not free in their middle, but may be somewhere else."""
        return (clearance < needed_m) & (clearance >= self.radius_m - math.sqrt(0.5) * cell_m)

    def _settle(self, centers: FloatArray, cells: NDArray[np.intp], cell_m: float) -> NDArray[np.bool_]:
        """Move the places of cells (indices) within them to where the radius is kept. True where that is possible."""
        middle = centers[cells]
        place = middle.copy()
        for _ in range(SETTLE_ITERATIONS):
            step = self.features.push_out(place, self.radius_m)
            place = np.clip(place + step, middle - 0.5 * cell_m, middle + 0.5 * cell_m)
        settled = self.features.clearance_up_to_m(place, self.radius_m) >= self.radius_m - SETTLED_M
        centers[cells[settled]] = place[settled]
        result = np.zeros(len(centers), dtype=bool)
        result[cells[settled]] = True
        return result

    def _keep_clear(self, edges: Edges, places: FloatArray, tight: NDArray[np.bool_], cell_m: float) -> Edges:
        """The edges without long moves and without cut corners between places of tight cells."""
        begin, end, length = edges
        doubtful = tight[begin] | tight[end]
        keep = ~doubtful
        look = np.flatnonzero(doubtful & (length < 1.5 * cell_m))
        a, b = places[begin[look]], places[end[look]]
        share = np.array([0.25, 0.5, 0.75])[:, None]
        between = (a[:, None] + share * (b - a)[:, None]).reshape(-1, 2)
        clear = self.features.clearance_up_to_m(between, self.radius_m).reshape(-1, 3).min(axis=1)
        keep[look] = clear >= self.radius_m - CHORD_LOSS_M
        return begin[keep], end[keep], length[keep]

    def _bounds(self, start: FloatArray, goal: FloatArray) -> tuple[FloatArray, FloatArray]:
        shapes = self.fence.inclusions
        corners = [] if shapes else [start[None], goal[None]]
        for shape in shapes or self.fence.exclusions:
            if isinstance(shape, Circle):
                c = np.asarray(shape.center_ned_m, dtype=float)
                corners.append(np.stack([c - shape.radius_m, c + shape.radius_m]))
            else:
                corners.append(np.asarray(shape.vertices_ned_m, dtype=float))
        points = np.concatenate(corners)
        low, high = points.min(axis=0), points.max(axis=0)
        if shapes:
            return low, high
        step = OPEN_WATER_STEP_M
        return (
            step * np.floor((low - OPEN_WATER_BORDER_M) / step),
            step * np.ceil((high + OPEN_WATER_BORDER_M) / step),
        )

    def _field_for(self, grid: _Grid, goal: FloatArray) -> _Field | None:
        if self._field is not None and np.array_equal(self._field.goal_m, goal):
            return self._field
        separation = np.sqrt(((grid.position_m - goal) ** 2).sum(axis=1))
        node = int(separation.argmin())
        if separation[node] > GOAL_SNAP_M + grid.cell_m:
            return None
        distance, previous = lengths_from(node, *grid.edges, len(grid.position_m))
        self._field = _Field(goal_m=goal.copy(), distance_m=distance, next_node=previous)
        return self._field


def _tile_order(shape: tuple[int, int]) -> NDArray[np.intp]:
    """Numbers of all cells (rows * columns,), tile by tile of 8 x 8, so that neighbours stand together."""
    row, column = np.divmod(np.arange(shape[0] * shape[1]), shape[1])
    return np.lexsort((column, row, column // TILE_CELLS, row // TILE_CELLS))


def _connect(node: NDArray[np.intp], cell_m: float) -> Edges:
    """Edges between free cells (king's and knight's moves; a knight's move needs both cells that it passes)."""
    rows, columns, lengths = [], [], []
    padded = np.pad(node, 2, constant_values=-1)
    height, width = node.shape

    def shifted(di: int, dj: int) -> NDArray[np.intp]:
        return padded[2 + di : 2 + di + height, 2 + dj : 2 + dj + width]

    for di, dj in _OFFSETS:
        other = shifted(di, dj)
        open_ = (node >= 0) & (other >= 0)
        if abs(di) + abs(dj) > 1:
            step_i, step_j = (di + 1) // 2, (abs(dj) + 1) // 2 * (1 if dj > 0 else -1)
            if abs(di) == abs(dj):
                passed = ((di, 0), (0, dj))
            elif abs(di) > abs(dj):
                passed = ((step_i, 0), (step_i, step_j))
            else:
                passed = ((0, step_j), (step_i, step_j))
            for pi, pj in passed:
                open_ &= shifted(pi, pj) >= 0
        a, b = node[open_], other[open_]
        rows += [a, b]
        columns += [b, a]
        lengths.append(np.full(2 * len(a), cell_m * math.hypot(di, dj)))
    return np.concatenate(rows), np.concatenate(columns), np.concatenate(lengths)
