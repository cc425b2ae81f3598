"""Is there a way from one waypoint to the next? A flood fill over a grid of the free space.

A cell counts as free when the vehicle may stand *somewhere* in it: a place is looked for, uphill in the clearance. So
doors count from the width on that the route planner finds, to a few millimetres, as long as the cells are smaller than
what the vehicle keeps (a workspace of up to some 60 m).
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from autopilot.core.frames import FloatArray
from autopilot.core.geometry import Fence
from mission.fence import fence_clearance_m
from mission.shapes import bounding_box

MIN_CELL_M = 0.025
"""Finer than what 1e-7 degrees can draw is of no use."""
SLOPE_M = 2.5e-4
TOLERANCE_M = 5e-4
UPHILL_STEPS = 3
MAX_CELLS = 40_000
"""Keeps the check at some 10 ms for a handful of shapes; more edges mean fewer cells."""
MAX_CELL_EDGES = 4_000_000
"""Bound on cells times polygon edges."""


def free_regions(fence: Fence, points_ned_m: FloatArray, radius_m: float) -> tuple[int, ...] | None:
    """The connected region of free space that each point (n, 2) stands in or is nearest to; None when nothing is free.

    ``radius_m``: what the vehicle's centre keeps from every boundary.
    """
    low, high = _area(fence, points_ned_m, radius_m)
    if np.any(high <= low):
        return None
    edges = sum(_edge_count(s) for s in (*fence.inclusions, *fence.exclusions))
    cells = min(MAX_CELLS, MAX_CELL_EDGES // max(1, edges))
    size = high - low
    cell_m = max(MIN_CELL_M, float(np.sqrt(size[0] * size[1] / cells)), float(np.max(size)) / cells)
    shape = np.maximum(1, np.ceil(size / cell_m).astype(int))
    north = low[0] + (np.arange(shape[0]) + 0.5) * cell_m
    east = low[1] + (np.arange(shape[1]) + 0.5) * cell_m
    centers = np.stack(np.meshgrid(north, east, indexing="ij"), axis=-1).reshape(-1, 2)
    half_diagonal = cell_m * float(np.sqrt(0.5))
    clearance = fence_clearance_m(fence, centers)
    free = clearance >= radius_m
    maybe = np.flatnonzero(~free & (clearance >= radius_m - half_diagonal))
    free[maybe] = _has_room(fence, centers[maybe], clearance[maybe], radius_m, 0.5 * cell_m)
    free = free.reshape(shape[0], shape[1])
    labels = np.asarray(ndimage.label(free, structure=np.ones((3, 3)))[0])
    if not free.any():
        return None
    index = np.clip(((points_ned_m - low) / cell_m).astype(int), 0, shape - 1)
    nearest = ndimage.distance_transform_edt(~free, return_distances=False, return_indices=True)
    return tuple(int(labels[tuple(nearest[:, i, j])]) for i, j in index)


def _has_room(
    fence: Fence, centers: FloatArray, clearance_m: FloatArray, radius_m: float, half_m: float
) -> NDArray[np.bool_]:
    """Which cells (n,) have a place that keeps the radius: a few steps uphill from their centers (n, 2)."""
    if not len(centers):
        return np.zeros(0, dtype=bool)
    place, room, best = centers, clearance_m, clearance_m
    for _ in range(UPHILL_STEPS):
        slope = np.stack(
            [
                fence_clearance_m(fence, place + offset) - fence_clearance_m(fence, place - offset)
                for offset in (np.array([SLOPE_M, 0.0]), np.array([0.0, SLOPE_M]))
            ],
            axis=1,
        ) / (2.0 * SLOPE_M)
        # A quarter of a millimetre beyond, for the slope is only that of the nearest boundary.
        place = np.clip(place + slope * (radius_m + SLOPE_M - room)[:, None], centers - half_m, centers + half_m)
        room = fence_clearance_m(fence, place)
        best = np.maximum(best, room)
    found: NDArray[np.bool_] = best >= radius_m - TOLERANCE_M
    return found


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


def _edge_count(shape: object) -> int:
    vertices: Sequence[object] | FloatArray = getattr(shape, "vertices_ned_m", (None,))
    return len(vertices)
