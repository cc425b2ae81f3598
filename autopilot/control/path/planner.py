"""Shortest free path in the workspace, so that the NMPC does not stop in a local minimum.

Graph of the free space (:mod:`autopilot.core.free_space`), geodesic distance from the goal (Dijkstra, 16 directions),
descent from the vehicle, line-of-sight shortcuts. The graph belongs to a fence, the distance field to a goal; both are
computed only when that changes, and not at all while the straight line is free. The caches save time and do not
change results: a path is a function of fence, radius, start and goal.

:meth:`Planner.path` takes up to half a second and runs on a background worker; everything else fits into a control
step.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from autopilot.control.constraints.obstacles import Features
from autopilot.control.path.path_tuning import PLANNER
from autopilot.control.path.shortest import lengths_from
from autopilot.core.background import Cancel
from autopilot.core.frames import FloatArray
from autopilot.core.free_space import CHORD_LOSS_M, Area, FreeSpace, workspace_of
from autopilot.core.geometry import Fence, lengths_m, points_at
from autopilot.core.shapes import bounding_box


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Graph:
    """The free space of an area and the moves in it."""

    area: Area
    space: FreeSpace
    begin: NDArray[np.intp]
    end: NDArray[np.intp]
    length_m: FloatArray


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _DistanceField:
    """Geodesic distance to one goal [m]."""

    goal_m: FloatArray
    distance_m: FloatArray
    next_node: NDArray[np.int32]
    """(nodes,) the next node towards the goal."""


class Planner:
    """Shortest paths in one fence for one radius: with the preferred clearance if possible, else with the radius only.

    Parameters
    ----------
    fence
        The workspace, not inflated.
    radius_m
        Required clearance of the path [m]: body radius plus margins.
    """

    def __init__(self, fence: Fence, radius_m: float) -> None:
        self.features = Features(fence)
        self._finders = (
            _PathFinder(fence, self.features, radius_m, PLANNER.planning_extra_m),
            _PathFinder(fence, self.features, radius_m, 0.0),
        )

    def path(self, start_ned_m: FloatArray, goal_ned_m: FloatArray, cancel: Cancel | None = None) -> FloatArray | None:
        """A free path from start to goal.

        Parameters
        ----------
        start_ned_m, goal_ned_m
            (2,) or (3,) positions [m]; only north and east are used.
        cancel
            Cancellation flag, checked between the steps of the search.

        Returns
        -------
        (m, 2) array or None
            Corner points, first row the start, last the goal; None if there is no path.

        Raises
        ------
        WithdrawnError
            ``cancel`` was requested.
        """
        start, goal = np.asarray(start_ned_m[:2], dtype=float), np.asarray(goal_ned_m[:2], dtype=float)
        for finder in self._finders:
            path = finder.path(start, goal, cancel or Cancel())
            if path is not None:
                return path
        return None

    def sees(self, start_ned_m: FloatArray, goal_ned_m: FloatArray) -> bool:
        """Whether the straight line is such a path, with the preferred clearance."""
        start, goal = np.asarray(start_ned_m[:2], dtype=float), np.asarray(goal_ned_m[:2], dtype=float)
        return self._finders[0].sees(start, goal)

    def free(self, path_ned_m: FloatArray) -> bool:
        """Whether the next metres of a path (m, 2) [m, NED] that was planned for another fence are still free."""
        return self._finders[1].free(path_ned_m)


class _PathFinder:
    """Paths with a clearance of radius plus ``extra_m`` [m]."""

    def __init__(self, fence: Fence, features: Features, radius_m: float, extra_m: float) -> None:
        self.fence = fence
        self.features = features
        self.radius_m = radius_m + extra_m
        self._slack_m = 0.5 * extra_m
        self._allowed_m = self.radius_m - CHORD_LOSS_M
        """Required clearance of a straight line."""
        self._graph: _Graph | None = None
        self._field: _DistanceField | None = None

    def path(self, start: FloatArray, goal: FloatArray, cancel: Cancel) -> FloatArray | None:
        """:meth:`Planner.path` of points (2,)."""
        if self.sees(start, goal):
            return np.stack([start, goal])
        cancel.check()
        graph = self._graph_for(start, goal)
        near = None if graph is None else graph.space.place_near(start)
        if graph is None or near is None:
            return None
        cancel.check()
        field = self._field_for(graph, goal)
        if field is None:
            return None
        cancel.check()
        node = near[0]
        if not math.isfinite(field.distance_m[node]):
            return None
        nodes = [node]
        while field.next_node[nodes[-1]] >= 0:
            nodes.append(int(field.next_node[nodes[-1]]))
        points = np.concatenate([start[None], graph.space.places_ned_m[nodes], goal[None]])
        path = self._shortcut(points)
        band = self._relax(path)
        # A long path in a small band has points too far apart to be kept off small obstacles.
        return band if self._keeps_clear(band) else path

    def sees(self, a: FloatArray, b: FloatArray) -> bool:
        """True if the straight line from a to b (2,) [m] keeps the planning radius; near its ends, the clearance of
        the ends.
        """
        if self.features.count == 0:
            return True
        length = math.hypot(*(b - a))
        steps = max(2, math.ceil(length / min(PLANNER.check_step_m, self.radius_m / 4.0)))
        steps = min(steps, 4000)
        fraction = np.linspace(0.0, 1.0, steps + 1)
        clearance = self.features.clearance_up_to_m(a + fraction[:, None] * (b - a), 2.0 * self.radius_m)
        need = np.full(steps + 1, self._allowed_m)
        for end, along in ((0, fraction), (-1, 1.0 - fraction)):
            relief = along * length < PLANNER.endpoint_relief_m
            need[relief] = np.minimum(need[relief], clearance[end] - 1e-3)
        if clearance[0] < 0.0 or clearance[-1] < 0.0:
            return False
        return bool((clearance >= need).all())

    def free(self, path: FloatArray) -> bool:
        """:meth:`Planner.free`."""
        if self.features.count == 0:
            return True
        s = lengths_m(path)
        at = np.arange(0.0, min(float(s[-1]), PLANNER.check_length_m) + PLANNER.check_step_m, PLANNER.check_step_m)
        points = points_at(path, s, at)
        clearance = self.features.clearance_up_to_m(points, 2.0 * self.radius_m)
        # Where the vehicle is it may be nearer.
        need = np.where(
            at < PLANNER.endpoint_relief_m, min(self._allowed_m, float(clearance[0]) - 1e-3), self._allowed_m
        )
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
        count = min(max(int(s[-1] / PLANNER.band_step_m), 2), PLANNER.max_band_points)
        at = np.linspace(0.0, s[-1], count + 1)
        band = np.stack([np.interp(at, s, points[:, 0]), np.interp(at, s, points[:, 1])], axis=1)
        for _ in range(PLANNER.band_iterations):
            band[1:-1] += 0.5 * (0.5 * (band[:-2] + band[2:]) - band[1:-1])
            band[1:-1] += self.features.push_out(band[1:-1], self.radius_m)
        return band

    def _keeps_clear(self, band: FloatArray) -> bool:
        fraction = np.linspace(0.0, 1.0, 8, endpoint=False)[:, None, None]
        between = (band[:-1] + fraction * np.diff(band, axis=0)).reshape(-1, 2)
        needed = float(self.features.clearance_up_to_m(band, self.radius_m).min()) - self._slack_m
        return bool((self.features.clearance_up_to_m(between, self.radius_m) >= needed).all())

    def _graph_for(self, start: FloatArray, goal: FloatArray) -> _Graph | None:
        """The graph of the area of possible paths, None if the area is empty."""
        area, graph = self._area(start, goal), self._graph
        if bool((area.high_m <= area.low_m).any()):
            return None
        if graph is not None and bool(
            (graph.area.low_m == area.low_m).all() and (graph.area.high_m == area.high_m).all()
        ):
            return graph
        space = FreeSpace(self.features, area, self.radius_m, long_moves=math.sqrt(5.0))
        pairs = np.concatenate([space.links, space.moves(PLANNER.knight)])
        length = space.lengths_m(pairs)
        self._graph = _Graph(
            area=area,
            space=space,
            begin=np.concatenate([pairs[:, 0], pairs[:, 1]]),
            end=np.concatenate([pairs[:, 1], pairs[:, 0]]),
            length_m=np.concatenate([length, length]),
        )
        self._field = None
        return self._graph

    def _area(self, start: FloatArray, goal: FloatArray) -> Area:
        workspace = workspace_of(self.fence)
        if workspace is not None:
            return workspace
        points = np.concatenate([start[None], goal[None], *(np.stack(bounding_box(s)) for s in self.fence.exclusions)])
        low, high, step = points.min(axis=0), points.max(axis=0), PLANNER.open_water_step_m
        return Area(
            low_m=step * np.floor((low - PLANNER.open_water_border_m) / step),
            high_m=step * np.ceil((high + PLANNER.open_water_border_m) / step),
        )

    def _field_for(self, graph: _Graph, goal: FloatArray) -> _DistanceField | None:
        if self._field is not None and np.array_equal(self._field.goal_m, goal):
            return self._field
        near = graph.space.place_near(goal)
        clearance = float(self.features.clearance_m(goal[None])[0])
        if near is None or clearance < self.radius_m - PLANNER.goal_snap_m - PLANNER.check_step_m:
            return None
        node, away_m = near
        if away_m > PLANNER.goal_snap_m + float(graph.space.cell_m[node]):
            return None
        count = len(graph.space.places_ned_m)
        distance, previous = lengths_from(node, graph.begin, graph.end, graph.length_m, count)
        self._field = _DistanceField(goal_m=goal.copy(), distance_m=distance, next_node=previous)
        return self._field
