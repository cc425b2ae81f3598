"""Path of a mission beyond a waypoint that is passed without a stop, for controllers that plan ahead."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import get_args

from autopilot.mission.items import (
    ChangeSpeed,
    GoTo,
    Jump,
    LoiterTurns,
    NoOp,
    Order,
    Passage,
    SetHeading,
    SetHome,
    Step,
    Surface,
)

LONGEST_WALK = 64
"""Maximum number of steps examined: bounds plans of empty jumps."""


PASSED = (ChangeSpeed, SetHome, Order, NoOp, *get_args(Passage))
"""Steps without effect on the path to the next waypoint."""


def passes_on(step: Step) -> bool:
    """Whether the mission continues from a step as soon as its region is entered."""
    return isinstance(step, GoTo) and step.hold_s == 0.0 and step.autocontinue


def walk(steps: Sequence[Step], cursor: int, jumps_done: Mapping[int, int]) -> Iterator[int]:
    """Steps in the order of execution after step ``cursor``, with the remaining jumps. Bounded, because a mission
    may loop for ever.
    """
    done = dict(jumps_done)
    cursor += 1
    for _ in range(LONGEST_WALK):
        if cursor >= len(steps):
            return
        step = steps[cursor]
        if isinstance(step, Jump):
            taken = done.get(cursor, 0)
            go = step.count is None or taken < step.count
            done[cursor] = taken + 1
            cursor = step.target_seq if go else cursor + 1
        else:
            yield cursor
            cursor += 1


def next_waypoint(
    steps: Sequence[Step],
    cursor: int,
    jumps_done: Mapping[int, int],
    default_yaw_rad: float | None,
    visit: Callable[[GoTo, float | None], None],
    count: int,
) -> None:
    """Call ``visit`` with the next ``count`` waypoints (and the heading of those that leave it free) after step
    ``cursor``. The walk ends at a waypoint that is not passed without a stop (it is still visited) and before any other
    step that takes time or whose effect is not known yet."""
    if not passes_on(steps[cursor]):
        return
    for index in walk(steps, cursor, jumps_done):
        step = steps[index]
        if isinstance(step, SetHeading) and not step.relative:
            default_yaw_rad = step.yaw_rad
        elif isinstance(step, GoTo) and step.pos_ned_m is not None:
            visit(step, default_yaw_rad)
            count -= 1
            if count == 0 or not passes_on(step):
                return
        elif not isinstance(step, PASSED):
            return


def next_place(steps: Sequence[Step], cursor: int, jumps_done: Mapping[int, int]) -> int | None:
    """The next step after ``cursor`` with a position, None without one (or not within the longest walk)."""
    for index in walk(steps, cursor, jumps_done):
        step = steps[index]
        if isinstance(step, GoTo | Surface) and step.pos_ned_m is not None:
            return index
        if isinstance(step, LoiterTurns) and step.centre_ned_m is not None:
            return index
    return None
