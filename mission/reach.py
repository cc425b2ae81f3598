"""Is there a way from one waypoint to the next? A flood fill over a grid of the free space.

A cell counts as free when the vehicle may stand *somewhere* in it: a place is looked for, uphill in the clearance. So
doors count from the width on that the route planner finds, to a few millimetres, as long as the cells are smaller than
what the vehicle keeps (a workspace of up to some 60 m).
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from autopilot.core.frames import FloatArray
from autopilot.core.geometry import Fence
from mission.fence import fence_clearance_m
from mission.room import Room
from mission.shapes import bounding_box

MIN_CELL_M = 0.025
"""Finer than what 1e-7 degrees can draw is of no use."""
BEYOND_M = 2.5e-4
TOLERANCE_M = 5e-4
UPHILL_STEPS = 3
MAX_CELLS = 40_000
"""Some 40 ms for fifty polygons."""
WIDEST_GRID = 24
"""Places per axis at which the widest part of a workspace is looked for."""


def free_regions(fence: Fence, points_ned_m: FloatArray, radius_m: float) -> tuple[int, ...] | None:
    """The connected region of free space that each point (n, 2) stands in or is nearest to; None when nothing is free.

    ``radius_m``: what the vehicle's centre keeps from every boundary.
    """
    grid = _free_cells(fence, points_ned_m, radius_m)
    if grid is None or not grid.free.any():
        return None
    labels = np.asarray(ndimage.label(grid.free, structure=np.ones((3, 3)))[0])
    index = np.clip(((points_ned_m - grid.low) / grid.cell_m).astype(int), 0, np.array(grid.free.shape) - 1)
    if not grid.free[tuple(index.T)].all():
        nearest = ndimage.distance_transform_edt(~grid.free, return_distances=False, return_indices=True)
        index = nearest[:, index[:, 0], index[:, 1]].T
    return tuple(int(label) for label in labels[tuple(index.T)])


def has_room(fence: Fence, radius_m: float) -> bool:
    """Whether there is any place in the workspace of a fence that keeps ``radius_m`` from every boundary."""
    grid = _free_cells(fence, np.zeros((0, 2)), radius_m)
    return grid is not None and bool(grid.free.any())


def widest_m(fence: Fence) -> float:
    """Largest clearance on a grid over the workspace; inf in open water."""
    if not fence.inclusions:
        return math.inf
    boxes = [bounding_box(shape) for shape in fence.inclusions]
    low, high = np.min([b[0] for b in boxes], axis=0), np.max([b[1] for b in boxes], axis=0)
    axes = [np.linspace(low[i], high[i], WIDEST_GRID) for i in range(2)]
    grid = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    return float(fence_clearance_m(fence, grid).max())


@dataclass(frozen=True, slots=True, eq=False)
class _Grid:
    """Free space in cells."""

    free: NDArray[np.bool_]
    """(north, east)"""
    low: FloatArray
    """(2,) the corner where it begins."""
    cell_m: float


def _free_cells(fence: Fence, points_ned_m: FloatArray, radius_m: float) -> _Grid | None:
    """Which cells of the area have a place that keeps the radius; None when there is no area."""
    low, high = _area(fence, points_ned_m, radius_m)
    if np.any(high <= low):
        return None
    size = high - low
    cell_m = max(MIN_CELL_M, float(np.sqrt(size[0] * size[1] / MAX_CELLS)), float(np.max(size)) / MAX_CELLS)
    shape = np.maximum(1, np.ceil(size / cell_m).astype(int))
    north = low[0] + (np.arange(shape[0]) + 0.5) * cell_m
    east = low[1] + (np.arange(shape[1]) + 0.5) * cell_m
    centers = np.stack(np.meshgrid(north, east, indexing="ij"), axis=-1).reshape(-1, 2)
    half_diagonal = cell_m * float(np.sqrt(0.5))
    room, reach_m = Room.of(fence), radius_m + 2.0 * half_diagonal
    clearance, slope = room.near(centers, reach_m)
    free = clearance >= radius_m
    maybe = np.flatnonzero(~free & (clearance >= radius_m - half_diagonal))
    place, have, best = centers[maybe], clearance[maybe], clearance[maybe]
    slope = slope[maybe]
    for _ in range(UPHILL_STEPS if len(maybe) else 0):
        # A quarter of a millimetre beyond, for the slope is only that of the nearest boundary.
        uphill = place + slope * (radius_m + BEYOND_M - have)[:, None]
        place = np.clip(uphill, centers[maybe] - 0.5 * cell_m, centers[maybe] + 0.5 * cell_m)
        have, slope = room.near(place, reach_m)
        best = np.maximum(best, have)
    free[maybe] = best >= radius_m - TOLERANCE_M
    return _Grid(free.reshape(shape[0], shape[1]), low, cell_m)


def _area(fence: Fence, points_ned_m: FloatArray, radius_m: float) -> tuple[FloatArray, FloatArray]:
    """The rectangle to search: the workspace, or in open water everything and a way round it."""
    if fence.inclusions:
        boxes = [bounding_box(s) for s in fence.inclusions]
        return np.max([b[0] for b in boxes], axis=0), np.min([b[1] for b in boxes], axis=0)
    boxes = [bounding_box(s) for s in fence.exclusions]
    corners = [points_ned_m, *(np.array(b) for b in boxes)]
    everything = np.concatenate([c.reshape(-1, 2) for c in corners])
    margin = 4.0 * radius_m
    return np.min(everything, axis=0) - margin, np.max(everything, axis=0) + margin
