"""Mission items as typed steps, in local metres (NED) and radians.

:func:`autopilot.mission.item_types.parse_step` makes them from items.
"""

from collections.abc import Container, Iterable, Iterator, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import TypeAlias

from autopilot.core.frames import FloatArray


class Command(IntEnum):
    """MAV_CMD numbers that plans may hold (common.xml)."""

    NAV_WAYPOINT = 16
    NAV_LOITER_UNLIM = 17
    NAV_LOITER_TURNS = 18
    NAV_LOITER_TIME = 19
    NAV_RETURN_TO_LAUNCH = 20
    NAV_LAND = 21
    NAV_TAKEOFF = 22
    NAV_DELAY = 93
    CONDITION_DELAY = 112
    CONDITION_DISTANCE = 114
    CONDITION_YAW = 115
    DO_JUMP = 177
    DO_CHANGE_SPEED = 178
    DO_SET_HOME = 179
    DO_SET_RELAY = 181
    DO_REPEAT_RELAY = 182
    DO_SET_SERVO = 183
    DO_REPEAT_SERVO = 184
    DO_SET_ACTUATOR = 187
    DO_SET_ROI_LOCATION = 195
    DO_SET_ROI_NONE = 197
    DO_SET_ROI = 201
    DO_DIGICAM_CONFIGURE = 202
    DO_DIGICAM_CONTROL = 203
    DO_MOUNT_CONFIGURE = 204
    DO_MOUNT_CONTROL = 205
    DO_SET_CAM_TRIGG_DIST = 206
    DO_FENCE_ENABLE = 207
    DO_GRIPPER = 211
    DO_SET_CAM_TRIGG_INTERVAL = 214
    SET_CAMERA_MODE = 530
    SET_CAMERA_ZOOM = 531
    SET_CAMERA_FOCUS = 532
    DO_GIMBAL_MANAGER_PITCHYAW = 1000
    IMAGE_START_CAPTURE = 2000
    IMAGE_STOP_CAPTURE = 2001
    VIDEO_START_CAPTURE = 2500
    VIDEO_STOP_CAPTURE = 2501
    CONDITION_GATE = 4501
    FENCE_RETURN_POINT = 5000
    FENCE_POLYGON_VERTEX_INCLUSION = 5001
    FENCE_POLYGON_VERTEX_EXCLUSION = 5002
    FENCE_CIRCLE_INCLUSION = 5003
    FENCE_CIRCLE_EXCLUSION = 5004
    RALLY_POINT = 5100


class MavFrame(IntEnum):
    """MAV_FRAME numbers that plans may use (common.xml)."""

    GLOBAL = 0
    LOCAL_NED = 1
    MISSION = 2
    GLOBAL_RELATIVE_ALT = 3
    GLOBAL_INT = 5
    GLOBAL_RELATIVE_ALT_INT = 6


AMSL_FRAMES = frozenset({MavFrame.GLOBAL, MavFrame.GLOBAL_INT})
RELATIVE_FRAMES = frozenset({MavFrame.GLOBAL_RELATIVE_ALT, MavFrame.GLOBAL_RELATIVE_ALT_INT})
GLOBAL_FRAMES = AMSL_FRAMES | RELATIVE_FRAMES
TERRAIN_FRAMES = frozenset({10, 11})


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Numbered:
    """Base class of the steps."""

    seq: int
    """Number of its item."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class GoTo(Numbered):
    """Go to a point and stay for a while (NAV_WAYPOINT, NAV_LOITER_TIME, NAV_LOITER_UNLIM, NAV_TAKEOFF)."""

    pos_ned_m: FloatArray | None
    """(3,), None = where the vehicle is then."""
    yaw_rad: float | None
    """None = free heading."""
    hold_s: float | None
    """Time inside the acceptance region, None = unlimited."""
    accept_radius_m: float | None
    """None = the parameter's default."""
    autocontinue: bool
    dives: bool = False
    """NAV_TAKEOFF: down (or up) to a depth where the vehicle is then."""
    dive_m: float | None = None
    """That depth, None = TKOFF_DEPTH."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Surface(Numbered):
    """Go up and end the mission there (NAV_LAND)."""

    pos_ned_m: FloatArray | None
    """(3,) where to go up (depth unused), None = where the vehicle is then."""
    yaw_rad: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class ReturnHome(Numbered):
    """Go home and end the mission there (NAV_RETURN_TO_LAUNCH)."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LoiterTurns(Numbered):
    """Circle around a position (NAV_LOITER_TURNS)."""

    centre_ned_m: FloatArray | None
    """(3,), None = where the vehicle is then."""
    radius_m: float | None
    """None = CIRCLE_RADIUS."""
    clockwise: bool
    turns: float
    autocontinue: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Near(Numbered):
    """Condition met within a distance of the next position (CONDITION_DISTANCE)."""

    distance_m: float


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Gate(Numbered):
    """Condition met when a plane across the path to the next position is passed (CONDITION_GATE)."""

    pos_ned_m: FloatArray
    """(3,) in the plane."""
    upright: bool
    """True = the depth does not count."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Wait(Numbered):
    """Stay at the present goal for a time (NAV_DELAY, CONDITION_DELAY)."""

    duration_s: float
    reported: bool
    """Whether its end is a MISSION_ITEM_REACHED (NAV commands only)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Jump(Numbered):
    """Continue at another item, a number of times (DO_JUMP)."""

    target_seq: int
    count: int | None
    """Times that the jump is taken, None = always."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ChangeSpeed(Numbered):
    """Cruise speed from here on (DO_CHANGE_SPEED)."""

    speed_m_s: float | None
    """None = back to the parameter's default."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SetHeading(Numbered):
    """Heading of goals that leave it free, from here on (CONDITION_YAW)."""

    yaw_rad: float
    relative: bool
    """True = to be added to the vehicle's heading at that moment."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SetHome(Numbered):
    """New home (DO_SET_HOME)."""

    pos_ned_m: FloatArray | None
    """(3,), None = where the vehicle is then."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class RegionOfInterest(Numbered):
    """Point that the vehicle faces from here on (DO_SET_ROI...)."""

    place_ned_m: FloatArray | None
    """(2,), None = nothing any more."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NoOp(Numbered):
    """Requests the present state (DO_FENCE_ENABLE 1), or nothing (home before a mission)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Order(Numbered):
    """Command to the payload, executed without stopping (SequencerOutput.orders); base class."""


Travel: TypeAlias = GoTo | Surface | ReturnHome
"""Steps that go to a place."""
Passage: TypeAlias = Near | Gate
"""Steps that end on the path to a later position."""
Timed: TypeAlias = Travel | LoiterTurns | Passage | Wait
"""Steps that take time; all others are done in passing."""
Instant: TypeAlias = Jump | ChangeSpeed | SetHeading | SetHome | RegionOfInterest | NoOp | Order
Step: TypeAlias = Timed | Instant


def flown_order(
    steps: Sequence[Step], most: int, cursor: int = 0, jumps_done: Iterable[tuple[int, int]] = ()
) -> Iterator[Step]:
    """Steps but jumps as they are flown from ``cursor`` on, ``most`` at the most, jumps among them counted.

    ``jumps_done``: (step of a jump, how often it was made). Jumps back without an end are not made.
    """
    done = dict(jumps_done)
    for _ in range(most):
        if not 0 <= cursor < len(steps):
            return
        step = steps[cursor]
        made = done.get(cursor, 0)
        if isinstance(step, Jump) and (step.target_seq > cursor if step.count is None else made < step.count):
            done[cursor] = made + 1
            cursor = step.target_seq
            continue
        if not isinstance(step, Jump):
            yield step
        cursor += 1


def next_of(steps: Sequence[Step], cursor: int, wanted: Container[int]) -> int | None:
    """The first of the items ``wanted`` that is flown from ``cursor`` on, None without any. Jumps with a count are
    not made."""
    for _ in range(len(steps)):
        if cursor in wanted or not 0 <= cursor < len(steps):
            break
        step = steps[cursor]
        cursor = step.target_seq if isinstance(step, Jump) and step.count is None else cursor + 1
    return cursor if cursor in wanted else None


def legs(steps: Sequence[Step], places: Container[int]) -> list[tuple[int, int]]:
    """Pairs of the items ``places`` that may be flown one after the other; a jump with a count is made or not."""
    found, seen, ahead = set[tuple[int, int]](), set[tuple[int, int]](), [(0, -1)]
    while ahead:
        cursor, last = ahead.pop()
        if (cursor, last) in seen or not 0 <= cursor < len(steps):
            continue
        seen.add((cursor, last))
        step = steps[cursor]
        if cursor in places:
            found |= {(last, cursor)} if last >= 0 else set()
            last = cursor
        if isinstance(step, Jump) and step.count != 0:
            ahead.append((step.target_seq, last))
        if not (isinstance(step, ReturnHome | Surface) or (isinstance(step, Jump) and step.count is None)):
            ahead.append((cursor + 1, last))
    return sorted(found)
