"""Automatic modes: hold, mission, return, surface, dive."""

from dataclasses import replace

import numpy as np

from autopilot.command.arming import CHECKING
from autopilot.command.modes.mode import GO_ON, FlightModeBehaviour, ModeContext, ModeStep, denied
from autopilot.command.vehicle_status import VehicleStatus
from autopilot.core import operator_messages as notices
from autopilot.core.messages import Goal, NavState
from autopilot.core.plan import PlanKind
from autopilot.mavlink.api import CommandReply, CommandResult, FlightMode
from autopilot.mission.sequencer import Action, is_inside

DIVED_M = 0.1
"""TAKEOFF is over within this distance of its depth."""

SURFACED_M = 0.05
"""The vehicle counts as surfaced within this distance of where it floats."""


class HoldMode(FlightModeBehaviour):
    """Station keeping, and go-to."""

    name = FlightMode.HOLD


class MissionMode(FlightModeBehaviour):
    """The items of the plan in force."""

    name = FlightMode.MISSION
    changes_depth = False

    def refusal(self, status: VehicleStatus | None, *, armed: bool) -> CommandReply | None:
        """Applies to every way of starting it."""
        if not self._plans.items(PlanKind.MISSION):
            return denied("No mission: upload one first")
        if self._plans.checking:
            return CommandReply(result=CommandResult.TEMPORARILY_REJECTED, reason=f"Mission denied: {CHECKING}")
        reason, nav = self._plans.problem, None if status is None else status.estimate
        if armed:
            if not reason and nav is not None and self._goals.clearance_m(nav.pos_ned_m) < 0.0:
                reason = "outside the fence or in an obstacle: go to a free place first"
            reason = reason or self._mission.refusal(nav)
        return denied(f"Mission denied: {reason}") if reason else None

    def enter(self, nav: NavState | None) -> None:
        """Continue at the current item."""
        self._mission.start(self._operator.t_us, nav)

    def leave(self) -> None:
        self._mission.sequencer.pause()

    def step(self, status: VehicleStatus, nav: NavState) -> ModeStep:
        """Goal of this tick, or the end of the mission."""
        t_us = status.t_us
        out = self._mission.step(t_us, nav)
        if out.home_ned_m is not None:
            self._mission.move_home(out.home_ned_m)
        if out.action is Action.HOLD:
            reached = self._mission.completed(t_us, out.progress.lap, out.reached)
            return ModeStep(goal=out.goal, settle=True, reached=reached, orders=out.orders)
        surface = FlightMode.SURFACE if out.action is Action.SURFACE else None
        return ModeStep(goal=out.goal, choose=surface, reached=out.reached, orders=out.orders)

    def watch(self, status: VehicleStatus, goal: Goal, nav: NavState) -> ModeStep:
        """An item that the vehicle gets no nearer to."""
        travels = self._mission.sequencer.travelling
        return self._watch_progress(status, goal, nav, flies=True) if travels else super().watch(status, goal, nav)


class ReturnMode(FlightModeBehaviour):
    """Back to home at the present depth, then hold."""

    name = FlightMode.RETURN
    changes_depth = False

    def refusal(self, status: VehicleStatus | None, *, armed: bool) -> CommandReply | None:
        """Refused while home is outside the fence."""
        refusal = self._goals.refuse_home()
        return denied(f"Return denied: {refusal}") if refusal else None

    def place(self, nav: NavState) -> Goal:
        return self._goals.home(nav)

    def watch(self, status: VehicleStatus, goal: Goal, nav: NavState) -> ModeStep:
        """A home that the vehicle gets no nearer to."""
        there = is_inside(goal, nav)
        return super().watch(status, goal, nav) if there else self._watch_progress(status, goal, nav, flies=False)


class SurfaceMode(FlightModeBehaviour):
    """Up where the vehicle is, then disarm."""

    name = FlightMode.SURFACE
    changes_depth = False

    def place(self, nav: NavState) -> Goal:
        return self._goals.surface(nav)

    def watch(self, status: VehicleStatus, goal: Goal, nav: NavState) -> ModeStep:
        """Ends at the surface."""
        super().watch(status, goal, nav)
        if nav.pos_ned_m[2] > self._goals.top_m + SURFACED_M:
            return GO_ON
        self._operator.say(notices.SURFACED())
        return ModeStep(disarm=True)


class TakeoffMode(FlightModeBehaviour):
    """Down to a depth, then hold."""

    name = FlightMode.TAKEOFF
    steered = True

    def __init__(self, tools: ModeContext) -> None:
        super().__init__(tools)
        self._commanded_depth_m: float | None = None
        """Of a dive that has not begun, None = TKOFF_DEPTH."""
        self._commanded_yaw_rad: float | None = None
        """The same, None = the heading of then."""
        self._depth_m = 0.0

    def prepare(self, nav: NavState | None, *, armed: bool) -> str:
        """To the depth requested before arming, else TKOFF_DEPTH."""
        return self.choose_depth(self._commanded_depth_m, self._commanded_yaw_rad)

    def leave(self) -> None:
        self._commanded_depth_m = self._commanded_yaw_rad = None

    def choose_depth(self, depth_m: float | None, yaw_rad: float | None) -> str:
        """Depth of the next dive, None = TKOFF_DEPTH, and its heading, None = that of then. Returns the reason of a
        refusal, else "".
        """
        wanted_m = self._params["TKOFF_DEPTH"] if depth_m is None else depth_m
        reason = self._goals.refuse_depth(wanted_m)
        if reason:
            return f"Takeoff denied: {reason}" + (", set TKOFF_DEPTH" if depth_m is None else "")
        self._commanded_depth_m, self._depth_m, self._commanded_yaw_rad = depth_m, wanted_m, yaw_rad
        return ""

    def place(self, nav: NavState) -> Goal:
        rest = self._goals.hold(nav)
        yaw_rad = rest.yaw_rad if self._commanded_yaw_rad is None else self._commanded_yaw_rad
        return replace(rest, pos_ned_m=np.array([*rest.pos_ned_m[:2], self._depth_m]), yaw_rad=yaw_rad)

    def watch(self, status: VehicleStatus, goal: Goal, nav: NavState) -> ModeStep:
        """Ends at its depth."""
        super().watch(status, goal, nav)
        self._commanded_depth_m = None
        if abs(nav.pos_ned_m[2] - goal.pos_ned_m[2]) >= DIVED_M:
            return GO_ON
        self._operator.say(notices.DIVED(depth_m=goal.pos_ned_m[2]))
        return ModeStep(settle=True)
