"""Gaps of a fence that are narrower than the vehicle: between two obstacles, or an obstacle and the workspace's edge.

The controller keeps the vehicle's ball out of every shape, so such a gap looks open on the map and never is. Shapes
that touch or overlap are one obstacle; what lies between parts of one obstacle is a pocket and not a gap.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from autopilot.core.frames import FloatArray
from autopilot.core.geometry import Circle
from mission.fence import FenceShape
from mission.shapes import boundary_gap_m, boundary_point, bounding_box, clearance_m

TOUCH_M = 0.02
"""Boundaries nearer than this touch: each coordinate is rounded to 1e-7 degrees, 11 mm."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Gap:
    """A narrow place between two shapes."""

    first: FenceShape
    second: FenceShape
    width_m: float
    middle_ned_m: FloatArray
    """(2,)"""


def narrow_gaps(shapes: Sequence[FenceShape], width_m: float, look: Callable[[], None] = lambda: None) -> Iterator[Gap]:
    """Gaps narrower than ``width_m`` between shapes that are not joined, in the order of the plan.

    ``look`` is called between the steps (it may raise, to end the work).
    """
    obstacle = _Union(len(shapes))
    found: list[tuple[int, int, float, FloatArray]] = []
    for i, j in _near_pairs(shapes, width_m):
        if obstacle.of(i) == obstacle.of(j):
            continue
        look()
        relation = _relate(shapes[i], shapes[j])
        if relation is None:
            continue
        gap, middle = relation
        if gap <= TOUCH_M:
            obstacle.join(i, j)
        elif gap < width_m:
            found.append((i, j, gap, middle))
    boxes = [bounding_box(s.shape) for s in shapes]
    for i, j, gap, middle in found:
        if obstacle.of(i) != obstacle.of(j) and _is_open(shapes, boxes, i, j, middle):
            yield Gap(first=shapes[i], second=shapes[j], width_m=gap, middle_ned_m=middle)


class _Union:
    """Which shapes are one obstacle."""

    def __init__(self, count: int) -> None:
        self._parent = list(range(count))

    def of(self, k: int) -> int:
        """The shape that stands for the obstacle that shape ``k`` is part of."""
        while self._parent[k] != k:
            self._parent[k] = self._parent[self._parent[k]]
            k = self._parent[k]
        return k

    def join(self, i: int, j: int) -> None:
        """Two shapes touch."""
        self._parent[self.of(j)] = self.of(i)


def _near_pairs(shapes: Sequence[FenceShape], width_m: float) -> list[tuple[int, int]]:
    """Pairs i < j that may have a narrow gap: not two inclusions, and bounding boxes (circles: rims) near enough."""
    if not shapes:
        return []
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
    rows, columns = np.nonzero(np.triu(near, 1))
    return list(zip(rows.tolist(), columns.tolist(), strict=True))


def _relate(a: FenceShape, b: FenceShape) -> tuple[float, FloatArray] | None:
    """Width and middle of what is between two shapes (0 = one obstacle), None when there is nothing to pass through."""
    gap, middle = boundary_gap_m(a.shape, b.shape)
    if a.inclusion or b.inclusion:
        workspace, obstacle = (a, b) if a.inclusion else (b, a)
        outside = clearance_m(workspace.shape, boundary_point(obstacle.shape)[None, :])[0] > 0.0
        return None if gap > TOUCH_M and outside else (gap, middle)
    a_in_b = clearance_m(b.shape, boundary_point(a.shape)[None, :])[0] < 0.0
    b_in_a = clearance_m(a.shape, boundary_point(b.shape)[None, :])[0] < 0.0
    return (0.0, middle) if a_in_b or b_in_a else (gap, middle)


def _is_open(
    shapes: Sequence[FenceShape],
    boxes: Sequence[tuple[FloatArray, FloatArray]],
    i: int,
    j: int,
    middle: FloatArray,
) -> bool:
    """Whether the middle of a gap is inside the workspace and not covered by a third obstacle."""
    for k, other in enumerate(shapes):
        low, high = boxes[k]
        boxed = low[0] <= middle[0] <= high[0] and low[1] <= middle[1] <= high[1]
        if k in (i, j) or (not boxed and not other.inclusion):
            continue
        outside = clearance_m(other.shape, middle[None, :])[0] > 0.0
        if outside == other.inclusion:
            return False
    return True
