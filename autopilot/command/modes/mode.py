"""Interface of a flight mode, and the dependencies that modes share."""

from dataclasses import dataclass
from typing import ClassVar

from autopilot.command.announcements import Announcements
from autopilot.command.mission_run import MissionRun
from autopilot.command.vehicle_status import VehicleStatus
from autopilot.control.thrust.by_hand import ByHand
from autopilot.core.messages import Goal, NavState
from autopilot.core.params import ParamSet
from autopilot.core.vehicle import Vehicle
from autopilot.mavlink.api import CommandReply, CommandResult, FlightMode, Sticks
from autopilot.mavlink.flight_modes import POSITIONLESS
from autopilot.mission.goals import Goals
from autopilot.mission.items import Order
from autopilot.mission.store import Plans

RELEASED = Sticks()
"""No pilot."""

GOAL_UPDATE_US = 50_000
"""Interval at which a goal that moves with heading and current is updated: once a control step."""


def denied(reason: str) -> CommandReply:
    return CommandReply(result=CommandResult.DENIED, reason=reason)


def no_position(mode: FlightMode) -> CommandReply:
    return denied(f"{mode.name} denied: no position, use STABILIZE")


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ModeContext:
    vehicle: Vehicle
    params: ParamSet
    plans: Plans
    goals: Goals
    mission: MissionRun
    operator: Announcements


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ModeStep:
    """Result of a mode on one tick."""

    goal: Goal | None = None
    """None = the one that there is."""
    enter: FlightMode | None = None
    """The mode that begins here instead,"""
    settle: bool = False
    """or HOLD with the goal that there is,"""
    choose: FlightMode | None = None
    """or one that is reported as if the operator had chosen it,"""
    disarm: bool = False
    """or nothing more: it is complete."""
    reached: tuple[int, ...] = ()
    """Mission items."""
    orders: tuple[Order, ...] = ()
    """Of mission items passed, for what the vehicle carries."""


GO_ON = ModeStep()


class FlightModeBehaviour:
    """One flight mode; one instance per vehicle. The base class holds position; subclasses override."""

    name: ClassVar[FlightMode]
    steered: ClassVar[bool] = False
    """Piloted: entering or leaving it changes the goal at once."""
    changes_depth: ClassVar[bool] = True
    """A command may send the vehicle to another depth out of it."""

    def __init__(self, tools: ModeContext) -> None:
        self._vehicle = tools.vehicle
        self._params = tools.params
        self._plans = tools.plans
        self._goals = tools.goals
        self._mission = tools.mission
        self._operator = tools.operator

    @property
    def needs_position(self) -> bool:
        return self.name not in POSITIONLESS

    def refusal(self, status: VehicleStatus | None, *, armed: bool) -> CommandReply | None:
        """Why it cannot be entered, None if it can. ``status`` is None before the first tick."""
        if self.steered and self.needs_position and armed and status is not None and status.estimate is None:
            return no_position(self.name)
        return None

    def prepare(self, nav: NavState | None, *, armed: bool) -> str:
        """Prepare for selection without arguments. Returns the reason of a refusal, else ""."""
        return ""

    def enter(self, nav: NavState | None) -> None: ...

    def leave(self) -> None:
        """Another one begins, or a failsafe acts."""

    def place(self, nav: NavState) -> Goal:
        """Initial goal, until a step changes it."""
        return self._goals.hold(nav)

    def step(self, status: VehicleStatus, nav: NavState) -> ModeStep:
        return GO_ON

    def watch(self, status: VehicleStatus, goal: Goal, nav: NavState) -> ModeStep:
        """After the goal of the tick is known: does it end?"""
        self._mission.forget_progress()
        return GO_ON

    def by_hand(self, status: VehicleStatus) -> ByHand | None:
        """Pilot command without a position, None = the mode needs one."""
        return None

    def position_came_or_went(self) -> None:
        """The position has become available or has been lost."""

    def go_to_depth(self, depth_m: float) -> str | None:
        """Change depth within the mode. Returns the reason of a refusal, else ""; None = not supported by the mode."""
        return None

    def _watch_progress(self, status: VehicleStatus, goal: Goal, nav: NavState, *, flies: bool) -> ModeStep:
        """A goal that is travelled to, ``flies``: an item of the mission, else home."""
        stuck = self._mission.watch_progress(status, goal, nav, flies=flies)
        return ModeStep(enter=FlightMode.HOLD) if stuck else GO_ON
