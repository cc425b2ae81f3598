"""Gaps of a fence that are narrower than the vehicle: between two obstacles, or an obstacle and the workspace's edge.

The controller keeps the vehicle's ball out of every shape, so such a gap looks open on the map and is impassable.
Shapes that touch or overlap are one obstacle; space between parts of one obstacle is a pocket and not a gap.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from heapq import merge

import numpy as np
from numpy.typing import NDArray

from autopilot.core.frames import FloatArray
from autopilot.core.geometry import Circle
from autopilot.core.shapes import boundary_gap_m, boundary_point, bounding_box, clearance_m
from autopilot.mission.fence import FenceShape

TOUCH_M = 0.02
"""Boundaries nearer than this touch: each coordinate is rounded to 1e-7 degrees, 11 mm."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class NarrowPassage:
    first: FenceShape
    second: FenceShape
    width_m: float
    middle_ned_m: FloatArray
    """(2,)"""


def narrow_gaps(
    shapes: Sequence[FenceShape],
    width_m: float,
    check_cancel: Callable[[], None] = lambda: None,
    *,
    pockets: bool = False,
) -> Iterator[NarrowPassage]:
    """Gaps narrower than ``width_m`` between shapes, in the order of the plan; a generator, so that the first few are
    cheap. ``check_cancel`` is called between the steps (it may raise, to end the work). ``pockets``: also between
    shapes that are joined, by each other or by a third.
    """
    obstacle = _Union(len(shapes))
    pairs = _near_pairs(shapes, width_m)
    pillar = np.array([isinstance(s.shape, Circle) and not s.inclusion for s in shapes], dtype=bool)
    both = pillar[pairs[:, 0]] & pillar[pairs[:, 1]]
    pillars = _pillar_pairs(shapes, pairs[both], width_m)
    for i, j in pillars.touching.tolist():
        obstacle.join(i, j)
    found: list[tuple[int, int, float, FloatArray]] = []
    for i, j in pairs[~both].tolist():
        if not pockets and obstacle.of(i) == obstacle.of(j):
            continue
        check_cancel()
        relation = _relate(shapes[i], shapes[j])
        if relation is None:
            continue
        gap, middle = relation
        if gap <= TOUCH_M:
            obstacle.join(i, j)
        elif gap < width_m:
            found.append((i, j, gap, middle))
    boxes = [bounding_box(s.shape) for s in shapes]
    low, high = (np.array([box[k] for box in boxes]).reshape(-1, 2) for k in range(2))
    always = np.array([s.inclusion for s in shapes], dtype=bool)
    for i, j, gap, middle in merge(found, pillars.gaps(), key=lambda each: each[:2]):
        if not pockets and obstacle.of(i) == obstacle.of(j):
            continue
        check_cancel()
        others = np.flatnonzero(always | np.all((low <= middle) & (middle <= high), axis=1)).tolist()
        if _is_open([shapes[k] for k in others if k not in (i, j)], middle):
            yield NarrowPassage(first=shapes[i], second=shapes[j], width_m=gap, middle_ned_m=middle)


@dataclass(frozen=True, slots=True, eq=False)
class _PillarPairs:
    touching: NDArray[np.intp]
    """(n, 2)"""
    near: NDArray[np.intp]
    """(m, 2) with a gap between them, in the order of the plan."""
    gap_m: FloatArray
    middle_ned_m: FloatArray
    """(m, 2)"""

    def gaps(self) -> Iterator[tuple[int, int, float, FloatArray]]:
        for (i, j), gap, middle in zip(self.near, self.gap_m, self.middle_ned_m, strict=True):
            yield int(i), int(j), float(gap), middle


def _pillar_pairs(shapes: Sequence[FenceShape], pairs: NDArray[np.intp], width_m: float) -> _PillarPairs:
    """Gaps between circles, all at once."""
    circles = [s.shape if isinstance(s.shape, Circle) else None for s in shapes]
    center = np.array([(0.0, 0.0) if c is None else c.center_ned_m for c in circles]).reshape(-1, 2)
    radius = np.array([0.0 if c is None else c.radius_m for c in circles])
    first, second = pairs[:, 0], pairs[:, 1]
    off = center[second] - center[first]
    distance = np.hypot(off[:, 0], off[:, 1])
    gap = distance - radius[first] - radius[second]
    near = (gap > TOUCH_M) & (gap < width_m)
    fraction = (radius[first] + 0.5 * gap)[near] / distance[near]
    middle = center[first[near]] + off[near] * fraction[:, None]
    return _PillarPairs(pairs[gap <= TOUCH_M], pairs[near], gap[near], middle)


class _Union:
    """Union-find of shapes that overlap."""

    def __init__(self, count: int) -> None:
        self._parent = list(range(count))

    def of(self, k: int) -> int:
        """Representative shape of the obstacle that shape ``k`` is part of."""
        while self._parent[k] != k:
            self._parent[k] = self._parent[self._parent[k]]
            k = self._parent[k]
        return k

    def join(self, i: int, j: int) -> None:
        self._parent[self.of(j)] = self.of(i)


def _near_pairs(shapes: Sequence[FenceShape], width_m: float) -> NDArray[np.intp]:
    """(n, 2) pairs i < j that may have a narrow gap: not two inclusions; boxes (of circles: rims) near enough, and near
    to the edge of the workspace where that is one of the two."""
    if not shapes:
        return np.zeros((0, 2), dtype=np.intp)
    boxes = [bounding_box(s.shape) for s in shapes]
    low, high = np.array([b[0] for b in boxes]), np.array([b[1] for b in boxes])
    apart = np.maximum(low[:, None, :] - high[None, :, :], low[None, :, :] - high[:, None, :])
    near = np.all(apart < width_m, axis=2)
    inclusion = np.array([s.inclusion for s in shapes])
    near &= ~(inclusion[:, None] & inclusion[None, :])
    round_ = np.array([isinstance(s.shape, Circle) for s in shapes])
    center = 0.5 * (low + high)
    radius = 0.5 * (high[:, 0] - low[:, 0])
    off = center[:, None, :] - center[None, :, :]
    rims = np.hypot(off[:, :, 0], off[:, :, 1]) - radius[:, None] - radius[None, :]
    near &= ~(round_[:, None] & round_[None, :] & (rims >= width_m))
    reach_m = width_m + np.hypot(*(0.5 * (high - low)).T)
    for k in np.flatnonzero(inclusion).tolist():
        beside = np.flatnonzero(near[k] | near[:, k])
        rim_m = np.abs(clearance_m(shapes[k].shape, center[beside]))
        far = beside[rim_m >= reach_m[beside]]
        near[k, far] = near[far, k] = False
    return np.argwhere(np.triu(near, 1))


def _relate(a: FenceShape, b: FenceShape) -> tuple[float, FloatArray] | None:
    """Width and middle of the gap between two shapes (0 = one obstacle), None without a gap."""
    gap, middle = boundary_gap_m(a.shape, b.shape)
    if a.inclusion or b.inclusion:
        workspace, obstacle = (a, b) if a.inclusion else (b, a)
        outside = clearance_m(workspace.shape, boundary_point(obstacle.shape)[None, :])[0] > 0.0
        return None if gap > TOUCH_M and outside else (gap, middle)
    a_in_b = clearance_m(b.shape, boundary_point(a.shape)[None, :])[0] < 0.0
    b_in_a = clearance_m(a.shape, boundary_point(b.shape)[None, :])[0] < 0.0
    return (0.0, middle) if a_in_b or b_in_a else (gap, middle)


def _is_open(others: Sequence[FenceShape], middle: FloatArray) -> bool:
    """Whether the middle of a gap is inside the workspace and not covered by another obstacle."""
    for other in others:
        outside = clearance_m(other.shape, middle[None, :])[0] > 0.0
        if outside == other.inclusion:
            return False
    return True
