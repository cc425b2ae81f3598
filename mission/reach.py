"""Connectivity of consecutive waypoints in the planners' free space (:mod:`autopilot.core.free_space`)."""

import math
from collections.abc import Callable

import numpy as np

from autopilot.core.frames import FloatArray
from autopilot.core.free_space import Area, FreeSpace, workspace_of
from autopilot.core.geometry import Fence
from autopilot.core.shapes import bounding_box
from autopilot.mission.clearance import Clearance
from autopilot.mission.fence import fence_clearance_m

WIDEST_GRID = 24
"""Sample points per axis in the search for the widest part of a workspace."""


class FreeRegions:
    """Connected regions of the free space of a fence. Immutable, so that a verdict may be asked later."""

    def __init__(
        self,
        fence: Fence,
        points_ned_m: FloatArray,
        radius_m: float,
        check_cancel: Callable[[], None] = lambda: None,
    ) -> None:
        """``points_ned_m`` (n, 2): places of a mission; ``radius_m``: distance that the vehicle's centre keeps from
        every boundary.
        """
        space = _free_space(fence, points_ned_m, radius_m, check_cancel)
        self._space = space if space is not None and len(space.places_ned_m) else None
        self.of_points: tuple[int, ...] = (-1,) * len(points_ned_m)
        """Region that contains each point or is nearest to it; -1 when nothing is free."""
        self._region = np.zeros(0, dtype=np.intp)
        if self._space is not None:
            self._region = self._space.regions()
            self.of_points = tuple(self._region[self._space.places_near(points_ned_m)].tolist())

    def of(self, point_ned_m: FloatArray) -> int:
        """The same of another point (2,)."""
        near = None if self._space is None else self._space.place_near(point_ned_m)
        return -1 if near is None else int(self._region[near[0]])


def has_free_space(fence: Fence, radius_m: float, check_cancel: Callable[[], None] = lambda: None) -> bool:
    """Whether any point in the workspace of a fence is ``radius_m`` from every boundary."""
    if widest_m(fence) >= radius_m:
        return True  # visible in the samples; a narrow part has to be searched
    space = _free_space(fence, np.zeros((0, 2)), radius_m, check_cancel)
    return space is not None and len(space.places_ned_m) > 0


def widest_m(fence: Fence) -> float:
    """Largest clearance on a grid over the workspace; inf in open water."""
    if not fence.inclusions:
        return math.inf
    boxes = [bounding_box(shape) for shape in fence.inclusions]
    low, high = np.min([b[0] for b in boxes], axis=0), np.max([b[1] for b in boxes], axis=0)
    axes = [np.linspace(low[i], high[i], WIDEST_GRID) for i in range(2)]
    grid = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    return float(fence_clearance_m(fence, grid).max())


def _free_space(
    fence: Fence, points_ned_m: FloatArray, radius_m: float, check_cancel: Callable[[], None]
) -> FreeSpace | None:
    """Free space of a workspace, or in open water of a box around everything with a path around it; None without
    any.
    """
    area = workspace_of(fence)
    if area is None:
        boxes = [bounding_box(s) for s in fence.exclusions]
        everything = np.concatenate([points_ned_m, *(np.array(b) for b in boxes)])
        margin = 4.0 * radius_m
        area = Area(low_m=everything.min(axis=0) - margin, high_m=everything.max(axis=0) + margin)
    if np.any(area.high_m <= area.low_m):
        return None
    return FreeSpace(Clearance.of(fence), area, radius_m, check_cancel=check_cancel)
