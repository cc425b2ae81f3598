"""Energy-to-go: energy [J] from every position to a goal, over all homotopy classes of paths round the obstacles.

The cells of the free space (:mod:`autopilot.core.free_space`, shared with upload checks and routes) are linked to
their neighbours, on the base grid to 32 of them (directions about 11 degrees apart), by directed edges. The cost of an
edge is its length times the minimum energy per metre in the current there, with the heading along the velocity through
the water. Dijkstra from the goal over the reversed edges solves the static Hamilton-Jacobi-Bellman equation of a
vehicle without inertia, up to the discretisation of directions (0.5 %). Heading, acceleration and depth are left to
the trajectory (:mod:`autopilot.control.energy.trajectory`).
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from autopilot.control.constraints.obstacles import Features
from autopilot.control.energy.energy_tuning import FIELD
from autopilot.control.energy.flow import FlowField
from autopilot.control.energy.power import SpeedTable, energy_per_metre
from autopilot.control.path.shortest import lengths_from
from autopilot.core.frames import FloatArray
from autopilot.core.free_space import FreeSpace
from autopilot.core.geometry import lengths_m, points_at

OFFSETS = tuple(
    (di, dj)
    for di in range(4)
    for dj in range(-3, 4)
    if math.gcd(di, dj) == 1 and 3 <= abs(di) + abs(dj) <= 5 and (di, dj) > (0, 0)
)
"""Knight's and longer moves, each one way: with those to the neighbours and back 32 directions."""

LONGEST_MOVE = math.hypot(3, 2)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FieldPath:
    points_ned_m: FloatArray
    """(m, 2) from the start to the goal"""
    energy_j: float


class EnergyField:
    """One free space and flow; :meth:`to` makes the field of a goal."""

    def __init__(self, space: FreeSpace, flow: FlowField, table: SpeedTable) -> None:
        self.space = space
        self.places_ned_m = space.places_ned_m
        """(n, 2)"""
        self.cell_m = space.base_cell_m
        pairs = np.concatenate([space.links, space.moves(OFFSETS)])
        a, b = pairs.T
        step = self.places_ned_m[b] - self.places_ned_m[a]
        length = np.maximum(np.hypot(step[:, 0], step[:, 1]), 1e-9)
        current = flow.current(0.5 * (self.places_ned_m[a] + self.places_ned_m[b]))[:, :2]
        along = (current * step).sum(axis=1) / length
        across = (current[:, 0] * step[:, 1] - current[:, 1] * step[:, 0]) / length
        there, back = energy_per_metre(table, along, across), energy_per_metre(table, -along, -across)
        cost = np.concatenate([length * there, length * back])
        a, b = np.concatenate([pairs, pairs[:, ::-1]]).T
        passable = np.isfinite(cost)
        self._edges = a[passable], b[passable], cost[passable]

    def nearest(self, place_ned_m: FloatArray) -> int | None:
        """The place by which a point (2,) comes into the field, None if none is near."""
        found = self.space.place_near(place_ned_m)
        if found is None:
            return None
        node, away_m = found
        return node if away_m <= FIELD.snap_m + float(self.space.cell_m[node]) else None

    def crossing(self, a: FloatArray, b: FloatArray) -> NDArray[np.bool_]:
        """(m,) which edges go through the line from ``a`` to ``b`` (2,)."""
        begin, end = (self.places_ned_m[nodes] for nodes in self._edges[:2])
        sides = [_side(a, b, begin) * _side(a, b, end) <= 0.0, _side(begin, end, a) * _side(begin, end, b) <= 0.0]
        return sides[0] & sides[1]

    def to(self, goal_ned_m: FloatArray, closed: NDArray[np.bool_] | None = None) -> "EnergyToGo | None":
        """The field of a goal (2,); ``closed`` (m,) takes edges away. None if the goal is nowhere near free ground."""
        node = self.nearest(goal_ned_m)
        if node is None:
            return None
        a, b, cost = self._edges
        if closed is not None:
            a, b, cost = a[~closed], b[~closed], cost[~closed]
        energy, following = lengths_from(node, b, a, cost, len(self.places_ned_m))
        return EnergyToGo(self, np.asarray(goal_ned_m, dtype=float), energy, following)


def _side(a: FloatArray, b: FloatArray, point: FloatArray) -> FloatArray:
    """On which side of the line from ``a`` to ``b`` a point is (> 0 on the right); arrays of places or one place."""
    edge, ray = b - a, point - a
    return edge[..., 0] * ray[..., 1] - edge[..., 1] * ray[..., 0]


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

    def path(self, start_ned_m: FloatArray) -> FieldPath | None:
        """The minimum-energy path from a position (2,), None if there is none."""
        node = self._field.nearest(start_ned_m)
        if node is None or not math.isfinite(self.energy_j[node]):
            return None
        nodes = [node]
        while self._next[nodes[-1]] >= 0:
            nodes.append(int(self._next[nodes[-1]]))
        nodes = self._without_jogs(start_ned_m, nodes)
        nodes = self._without_jogs(self._goal, nodes[::-1])[::-1]
        points = np.concatenate([start_ned_m[None], self._field.places_ned_m[nodes], self._goal[None]])
        return FieldPath(points_ned_m=points, energy_j=float(self.energy_j[node]))

    def _without_jogs(self, end_ned_m: FloatArray, nodes: list[int]) -> list[int]:
        """Nodes without the first few, if the end (2,) of the path has a free line to the next: the nearest cell may
        lie aside.
        """
        some = np.array(nodes[1 : 1 + FIELD.jog_nodes], dtype=np.intp)
        sees = self._field.space.in_sight(end_ned_m, some)
        skipped = len(some) if sees.all() else int(sees.argmin())
        return nodes[min(skipped, len(nodes) - 1) :]

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


def alternative_paths(
    field: EnergyField, to_go: EnergyToGo, path: FieldPath, features: Features, limit: int
) -> list[FieldPath]:
    """Alternative paths: those left after closing a gap that ``path`` uses (other homotopy classes).

    A gap is closed by a line from the nearest boundary through the narrowest point of the path to the next boundary;
    up to ``limit`` of the narrowest points, usually a metre apart, are tried.
    """
    if features.count == 0:
        return []
    steps = np.linspace(0.0, 1.0, 80)
    s = lengths_m(path.points_ned_m)
    at = points_at(path.points_ned_m, s, steps * s[-1])
    clearance = features.clearance_m(at)
    inner = np.flatnonzero((steps > 0.1) & (steps < 0.9) & (clearance < FIELD.gap_reach_m))
    paths: list[FieldPath] = []
    tried: list[FloatArray] = []
    for i in inner[np.argsort(clearance[inner])]:
        if len(tried) >= limit:
            break
        if any(np.hypot(*(at[i] - t)) < FIELD.gap_apart_m for t in tried):
            continue
        tried.append(at[i])
        wall = _wall(features, at[i], at[min(i + 1, len(at) - 1)] - at[max(i - 1, 0)])
        around = field.to(path.points_ned_m[-1], field.crossing(*wall))
        other = None if around is None else around.path(path.points_ned_m[0])
        if other is not None and not any(_same_side(other, known, field.space.radius_m) for known in paths):
            paths.append(other)
    return paths


def _same_side(path: FieldPath, other: FieldPath, radius_m: float) -> bool:
    """Whether two paths are near each other all along. On both sides of an obstacle they are two radii apart."""
    paths = [one.points_ned_m for one in (path, other)]
    lengths = [lengths_m(points) for points in paths]
    fractions = np.linspace(0.0, 1.0, 2 + int(max(s[-1] for s in lengths) / radius_m))
    at = [points_at(points, s, fractions * s[-1]) for points, s in zip(paths, lengths, strict=True)]
    return bool(np.hypot(*(at[0] - at[1]).T).max() < radius_m)


def _wall(features: Features, place: FloatArray, tangent: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The line across a path at a point, to the boundaries on both sides or to WALL_REACH_M."""
    t = tangent / max(float(np.hypot(*tangent)), 1e-9)
    across = np.array([-t[1], t[0]])
    steps = np.linspace(0.0, FIELD.wall_reach_m, FIELD.wall_points)[:, None]
    ends = []
    for sign in (-1.0, 1.0):
        line = place + sign * steps * across
        free = features.clearance_m(line) > 0.0
        ends.append(line[-1] if free.all() else line[int(free.argmin())])
    return ends[0], ends[1]
