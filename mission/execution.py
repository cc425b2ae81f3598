"""What is remembered of a mission that runs, and what it gives on each tick."""

from dataclasses import dataclass, field
from enum import StrEnum

from autopilot.core.frames import FloatArray
from autopilot.core.messages import Goal, MissionProgress, ProgressState
from autopilot.mission.circling import LoiterCircle
from autopilot.mission.items import Order


class Action(StrEnum):
    """What the mission asks of the vehicle's mode logic, on the one tick on which it does."""

    SURFACE = "surface"
    """NAV_LAND has come up to the top of the depth band: surface and disarm."""
    HOLD = "hold"
    """The mission is complete; the goal stays where it is."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SequencerOutput:
    """Result of one tick."""

    goal: Goal | None
    """None while no mission runs and while the estimate is not finite."""
    progress: MissionProgress
    reached: tuple[int, ...] = ()
    """Items reached on this tick (NAV commands only)."""
    action: Action | None = None
    home_ned_m: FloatArray | None = None
    """(3,) new home, on the tick on which a DO_SET_HOME ran."""
    orders: tuple[Order, ...] = ()
    """For the equipment, in the order in which the mission came by them on this tick."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Position:
    """Where a mission stands: all that it takes to go on with it after a restart."""

    cursor: int
    """Step that runs next."""
    reached_seq: int
    lap: int
    jumps_done: tuple[tuple[int, int], ...]
    """(step of a jump, how often it was made)."""
    speed_m_s: float | None
    default_yaw_rad: float | None
    facing_ned_m: tuple[float, float] | None = None


@dataclass(slots=True, eq=False, kw_only=True)
class RunMemory:
    """What is remembered of one run of the mission."""

    cursor: int
    """Step that runs now."""
    state: ProgressState
    entered: bool = False
    """Whether the goal of the present step has been set."""
    goal: Goal | None = None
    pause_goal: Goal | None = None
    default_yaw_rad: float | None = None
    """Heading of goals that leave it free (CONDITION_YAW)."""
    speed_m_s: float | None = None
    """None = SPD_CRUISE."""
    facing_ned_m: FloatArray | None = None
    """(2,) what the vehicle looks at, None = nothing."""
    circle: LoiterCircle | None = None
    """Of NAV_LOITER_TURNS, while it runs."""
    leg_from_ned_m: FloatArray | None = None
    """(3,) where the way to the present goal begins."""
    given_up_seq: int = -1
    """An item to pass over: it was given up on the way, before its turn."""
    inside_since_us: int | None = None
    waited_us: int = 0
    """How long the present wait has run, pauses left out."""
    clock_us: int | None = None
    """The last tick of that wait, None = it (or its pause) has just begun or ended."""
    rising: bool = False
    """NAV_LAND: above its place and on the way up."""
    jumps_done: dict[int, int] = field(default_factory=dict)
    flown: int = 0
    """Steps that took time so far."""
    flown_at_jump: dict[int, int] = field(default_factory=dict)
    """That number when a jump (by its step) was last made."""
    reached_seq: int = -1
    lap: int = 0
    skipped: int = 0
    """Items given up."""
    ending: bool = False
    """The last item has been given up: complete with the next tick."""
