"""Energy-to-go: how many joules it takes from anywhere to a goal, over all ways round the obstacles.

A grid over the area; every free cell is joined to 32 neighbours (directions about 11 degrees apart) by directed edges
that cost their length times the least energy per metre that the current there allows (the vehicle points along its way
through the water). Dijkstra from the goal over the reversed edges then is the static Hamilton-Jacobi-Bellman equation
of a vehicle without inertia, to within the angles of the edges (0.5 %). Heading, acceleration and depth are left to the
trajectory (:mod:`autopilot.control.energy.trajectory`).
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from autopilot.control.energy.flow import Area, Flow
from autopilot.control.energy.power import SpeedTable, energy_per_metre
from autopilot.control.obstacles import Features
from autopilot.control.shortest import lengths_from
from autopilot.core.frames import FloatArray

MAX_CELLS = 6000
FINEST_CELL_M = 0.05

OFFSETS = tuple(
    (di, dj) for di in range(-3, 4) for dj in range(-3, 4) if math.gcd(di, dj) == 1 and abs(di) + abs(dj) <= 5
)
"""King's, knight's and longer moves: 32 directions."""

LONGEST_MOVE = math.hypot(3, 2)

SNAP_CELLS = 8.0
"""A start or goal this many cells from free ground still finds it."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Way:
    """A way to the goal."""

    points_ned_m: FloatArray
    """(m, 2) from the start to the goal"""
    energy_j: float


class EnergyField:
    """The grid of one area, fence radius and flow; :meth:`to` makes the field of a goal."""

    def __init__(self, features: Features, radius_m: float, area: Area, flow: Flow, table: SpeedTable) -> None:
        size = np.maximum(area.high_m - area.low_m, 1e-3)
        self.cell_m = max(FINEST_CELL_M, math.sqrt(float(size[0] * size[1]) / MAX_CELLS))
        shape = tuple(int(length / self.cell_m) + 1 for length in size)
        axes = [low + self.cell_m * (np.arange(count) + 0.5) for low, count in zip(area.low_m, shape, strict=True)]
        centers = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
        needed = math.hypot(radius_m, 0.5 * LONGEST_MOVE * self.cell_m) if features.count else 0.0
        free = np.ones(len(centers), dtype=bool)
        if features.count:
            free = features.clearance_up_to_m(centers, needed) >= needed
        self._node_of_cell = np.full(shape, -1)
        self._node_of_cell.ravel()[free] = np.arange(int(free.sum()))
        self.places_ned_m: FloatArray = centers[free]
        """(n, 2) of the free cells."""
        self._origin = area.low_m
        self._edges = self._connect(flow, table)

    def _connect(self, flow: Flow, table: SpeedTable) -> tuple[NDArray[np.intp], NDArray[np.intp], FloatArray]:
        """Edges (from, to, energy) between free cells."""
        node = self._node_of_cell
        reach = 3
        padded = np.pad(node, reach, constant_values=-1)
        height, width = node.shape
        begin, end = [], []
        for di, dj in OFFSETS:
            other = padded[reach + di : reach + di + height, reach + dj : reach + dj + width]
            both = (node >= 0) & (other >= 0)
            begin.append(node[both])
            end.append(other[both])
        a, b = np.concatenate(begin), np.concatenate(end)
        way = self.places_ned_m[b] - self.places_ned_m[a]
        length = np.hypot(way[:, 0], way[:, 1])
        current = flow.current(0.5 * (self.places_ned_m[a] + self.places_ned_m[b]))[:, :2]
        along = (current * way).sum(axis=1) / length
        across = (current[:, 0] * way[:, 1] - current[:, 1] * way[:, 0]) / length
        cost = length * energy_per_metre(table, along, across)
        passable = np.isfinite(cost)
        return a[passable], b[passable], cost[passable]

    def nearest(self, place_ned_m: FloatArray) -> int | None:
        """The free cell nearest to a place (2,), None if none is near."""
        if len(self.places_ned_m) == 0:
            return None
        separation = np.hypot(*(self.places_ned_m - place_ned_m).T)
        node = int(separation.argmin())
        return node if separation[node] <= SNAP_CELLS * self.cell_m else None

    def to(self, goal_ned_m: FloatArray, closed: NDArray[np.bool_] | None = None) -> "EnergyToGo | None":
        """The field of a goal (2,); ``closed`` (n,) takes cells away. None if the goal is nowhere near free ground."""
        node = self.nearest(goal_ned_m)
        if node is None:
            return None
        a, b, cost = self._edges
        if closed is not None:
            open_ = ~(closed[a] | closed[b])
            a, b, cost = a[open_], b[open_], cost[open_]
        energy, following = lengths_from(node, b, a, cost, len(self.places_ned_m))
        return EnergyToGo(self, np.asarray(goal_ned_m, dtype=float), energy, following)


class EnergyToGo:
    """Joules to one goal from every free cell."""

    def __init__(
        self, field: EnergyField, goal_ned_m: FloatArray, energy_j: FloatArray, next_node: NDArray[np.int32]
    ) -> None:
        self._field = field
        self._goal = goal_ned_m
        self.energy_j = energy_j
        """(n,) inf where there is no way."""
        self._next = next_node

    def way(self, start_ned_m: FloatArray) -> Way | None:
        """The cheapest way from a place (2,), None if there is none."""
        node = self._field.nearest(start_ned_m)
        if node is None or not math.isfinite(self.energy_j[node]):
            return None
        nodes = [node]
        while self._next[nodes[-1]] >= 0:
            nodes.append(int(self._next[nodes[-1]]))
        points = np.concatenate([start_ned_m[None], self._field.places_ned_m[nodes], self._goal[None]])
        return Way(points_ned_m=points, energy_j=float(self.energy_j[node]))

    def slope(self, place_ned_m: FloatArray, reach_m: float) -> FloatArray:
        """(2,) slope [J/m] of the energy to go round a place: a plane fitted to the cells within ``reach_m``."""
        away = self._field.places_ned_m - place_ned_m
        near = (np.hypot(*away.T) <= max(reach_m, 2.5 * self._field.cell_m)) & np.isfinite(self.energy_j)
        if near.sum() < 6:
            return np.zeros(2)
        rows = np.column_stack([away[near], np.ones(int(near.sum()))])
        if np.linalg.matrix_rank(rows, tol=1e-6) < 3:
            return np.zeros(2)
        fit: FloatArray = np.linalg.lstsq(rows, self.energy_j[near], rcond=None)[0][:2]
        return fit


def other_ways(field: EnergyField, to_go: EnergyToGo, way: Way, features: Features, limit: int) -> list[Way]:
    """Ways that pass boundaries near ``way`` on their other side: what is left when the gap that it uses is closed.

    A gap is closed by a line from the nearest boundary through the narrowest place of the way and on to the next
    boundary; up to ``limit`` of the narrowest places, most of a metre apart, are tried.
    """
    if features.count == 0:
        return []
    steps = np.linspace(0.0, 1.0, 80)
    s = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(way.points_ned_m, axis=0).T))))
    at = np.stack([np.interp(steps * s[-1], s, way.points_ned_m[:, i]) for i in range(2)], axis=1)
    clearance = features.clearance_m(at)
    inner = np.flatnonzero((steps > 0.1) & (steps < 0.9) & (clearance < GAP_REACH_M))
    ways: list[Way] = []
    tried: list[FloatArray] = []
    for i in inner[np.argsort(clearance[inner])]:
        if len(tried) >= limit:
            break
        if any(np.hypot(*(at[i] - t)) < GAP_APART_M for t in tried):
            continue
        tried.append(at[i])
        closed = _wall(field, at[i], at[min(i + 1, len(at) - 1)] - at[max(i - 1, 0)])
        around = field.to(way.points_ned_m[-1], closed)
        other = None if around is None else around.way(way.points_ned_m[0])
        if other is not None:
            ways.append(other)
    return ways


GAP_REACH_M = 1.5
"""A way this far from everything has no side."""

GAP_APART_M = 0.8


def _wall(field: EnergyField, place: FloatArray, tangent: FloatArray) -> NDArray[np.bool_]:
    """Free cells of the connected line across the way at a place: three cells thick, so that no move jumps it."""
    t = tangent / max(float(np.hypot(*tangent)), 1e-9)
    away = field.places_ned_m - place
    along = away @ t
    across = away @ np.array([-t[1], t[0]])
    line = np.abs(along) <= 2.0 * field.cell_m
    if not line.any():
        return line
    order = np.argsort(across[line])
    ordered = across[line][order]
    gaps = np.diff(ordered) > 1.6 * field.cell_m
    group = np.concatenate(([0], np.cumsum(gaps)))
    here = group[int(np.abs(ordered).argmin())]
    low, high = ordered[group == here][[0, -1]]
    wall: NDArray[np.bool_] = line & (across >= low - 1e-9) & (across <= high + 1e-9)
    return wall
