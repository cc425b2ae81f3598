"""Arming, modes, goals and failsafes.

The commander answers MAVLink requests at once (:class:`autopilot.mavlink.api.VehicleCommands`) and, once per tick,
turns mode, mission and estimate into a goal for the controller. It does not command thrusters.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from autopilot.command.announcements import Announcements
from autopilot.command.arming import CHECKING, STARTING, ArmingChecks, ControllerCheck
from autopilot.command.change_watch import ChangeWatch
from autopilot.command.decision import Decision
from autopilot.command.disarming import Disarming
from autopilot.command.failsafe_inputs import FailsafeInputs
from autopilot.command.failsafes import FailsafeRules
from autopilot.command.mission_run import MissionRun
from autopilot.command.mode_machine import ModeMachine
from autopilot.command.modes.automatic import TakeoffMode
from autopilot.command.modes.circle import CircleMode
from autopilot.command.modes.guided import GuidedMode
from autopilot.command.modes.mode import ModeContext, denied
from autopilot.command.motor_tests import MotorTests
from autopilot.command.plan_watch import FenceGuard, PlanCheckNews
from autopilot.command.vehicle_status import VehicleStatus
from autopilot.core import operator_messages as notices
from autopilot.core.arming_reasons import ArmingReason
from autopilot.core.errors import ConfigError
from autopilot.core.frames import FloatArray
from autopilot.core.geodesy import GeodeticPosition, Origin, refuse_place
from autopilot.core.geometry import Fence
from autopilot.core.messages import Event, NavState, RunEnd
from autopilot.core.params import ParamSet
from autopilot.core.plan import PlanKind, PlanRejection
from autopilot.core.vehicle import Vehicle
from autopilot.mavlink.api import ACCEPTED, Circling, CommandReply, CommandResult, FlightMode, MotorTest, SetPoint
from autopilot.mavlink.flight_modes import group_of
from autopilot.mission.goals import Goals
from autopilot.mission.plan_check import PlanVerdict
from autopilot.mission.sequencer import Position
from autopilot.mission.store import Plans

READINESS_EVERY_US = 500_000
"""Arming checks run twice per second for telemetry, and again at an arming request."""

END_AFTER_US = 200_000
"""Delay of a requested shutdown, for its answer to be sent."""


class Commander:
    """Checks orders before they go to the state machine (:class:`~autopilot.command.mode_machine.ModeMachine`)."""

    def __init__(
        self,
        vehicle: Vehicle,
        params: ParamSet,
        plans: Plans,
        *,
        controller_check: ControllerCheck = lambda _: (),
        speed_m_s: Callable[[NavState], float] | None = None,
        has_markers: bool = True,
    ) -> None:
        """``controller_check``: the controller's reasons against arming with an estimate; ``speed_m_s``: planar speed
        left by its margins (None = SPD_PLANAR_MAX); ``has_markers``: whether the position comes from markers.
        """
        self._params = params
        self._plans = plans
        self._operator = Announcements()
        self._goals = Goals(vehicle, params, plans)
        speed_m_s = speed_m_s or (lambda _: params["SPD_PLANAR_MAX"])
        self._mission = MissionRun(params, plans, self._goals, self._operator, speed_m_s)
        self._failsafe_inputs = FailsafeInputs(vehicle, params, plans, self._goals, self._mission.sequencer)
        self._failsafe_inputs.has_markers = has_markers
        self._failsafes = FailsafeRules(params, self._failsafe_inputs)
        tools = ModeContext(
            vehicle=vehicle,
            params=params,
            plans=plans,
            goals=self._goals,
            mission=self._mission,
            operator=self._operator,
        )
        self._modes = ModeMachine(tools, self._failsafes)
        self._disarming = Disarming(self._operator)
        self._tests = MotorTests(vehicle, self._goals, self._modes, self._operator)
        self._watch = ChangeWatch(vehicle, plans, self._goals, has_markers=has_markers)
        self._arming = ArmingChecks(
            params, plans, self._goals, self._failsafes, controller_check, self._mission.path_problem
        )
        self._check_news = PlanCheckNews(plans, self._operator)
        self._fence_guard = FenceGuard(vehicle, params, plans, self._goals)
        self._readiness: tuple[ArmingReason, ...] = STARTING
        self._readiness_us = 0
        self._ending: tuple[int, RunEnd] | None = None
        """At which tick the run ends, and how."""
        plans.guard = self._guard_plans

    @property
    def armed(self) -> bool:
        """Whether thrusters may turn."""
        return self._modes.armed

    @property
    def shows_armed(self) -> bool:
        """Whether thrusters may turn, by us or by the flight controller below."""
        status = self._modes.status
        below = None if status is None else status.below
        return self._modes.armed or (below is not None and below.armed is True)

    @property
    def disarms_flight_controller(self) -> bool:
        """Whether the flight controller is to be disarmed."""
        return self._disarming.waits and not self._modes.armed

    @property
    def mode(self) -> FlightMode:
        """The mode in force: the operator's, or the one that a failsafe put over it."""
        return self._modes.mode

    @property
    def intended_mode(self) -> FlightMode:
        """The mode that the operator chose."""
        return self._modes.chosen

    @property
    def fence(self) -> Fence:
        """The workspace in force; the same object until plan, origin or depth band change."""
        return self._goals.fence

    @property
    def under_way(self) -> bool:
        """Whether a mode other than hold, or a go-to, has been entered since arming (reported as "flying")."""
        return self._modes.under_way

    @property
    def orders(self) -> int:
        """Incremented by every new order."""
        return self._modes.orders

    @property
    def mission_position(self) -> Position | None:
        """Mission progress, None when there is nothing to resume."""
        return self._mission.position

    def drain_events(self) -> tuple[Event, ...]:
        """Messages for the operator since the last call."""
        return self._operator.drain()

    @property
    def arming_reasons(self) -> tuple[ArmingReason, ...]:
        """Reasons in any mode as of the last half second, for telemetry; of an armed vehicle only that of the plans."""
        return self._arming.while_armed if self._modes.armed else self._readiness

    @property
    def fenced(self) -> bool:
        return self._arming.fenced

    def prearm_reasons(self) -> tuple[str, ...]:
        """Why arming would be refused now; empty when ready."""
        group = group_of(self._modes.chosen)
        return tuple(reason.text for reason in self._arming.reasons(self._modes.status) if reason.modes & group)

    # Requests: arming and modes

    def arm(self, force: bool) -> CommandReply:
        """Arm unless a check fails; ``force`` skips the checks and is logged. It starts no mission."""
        if self._modes.armed:
            return ACCEPTED
        if self._disarming.refusal is not None:
            return self._disarming.refusal
        reasons = self.prearm_reasons()
        if reasons and (not force or not self._plans.placed):
            waits = reasons == (CHECKING,) or force
            result = CommandResult.TEMPORARILY_REJECTED if waits else CommandResult.DENIED
            return CommandReply(result=result, reason="Arming denied: " + (CHECKING if force else "; ".join(reasons)))
        if reasons:
            self._operator.say(notices.FORCED_ARMING(reasons="; ".join(reasons)))
        self._modes.arm()
        self._disarming.give_up()
        self._ending = None
        mode = self._modes.chosen
        refusal = self._modes.refusal(mode)
        reason = self._modes.prepare(mode) if refusal is None else refusal.reason
        self._modes.enter(FlightMode.HOLD if reason else mode)
        self._operator.say(notices.ARMED())
        if reason:
            self._operator.say(notices.REFUSED(reason=reason))
        if not self._arming.fenced:
            self._operator.say(notices.ARMED_UNFENCED())
        return ACCEPTED

    def disarm(self, force: bool) -> CommandReply:
        """Disarm. ``force`` marks an emergency stop; neither is refused. The next arming begins in HOLD.

        With a flight controller below the answer is IN_PROGRESS until its heartbeat shows it (:meth:`disarmed`)."""
        modes = self._modes
        modes.disarm(force=force)
        modes.disarms_flight_controller = modes.handed_back = False
        self._disarming.begin()
        return self._disarming.answer

    def disarmed(self) -> CommandReply:
        return self._disarming.answer

    def set_mode(self, mode: FlightMode) -> CommandReply:
        refusal = self._modes.refusal(mode)
        if refusal is not None:
            return refusal
        reason = self._modes.prepare(mode)
        if reason:
            return denied(reason)
        self._modes.choose(mode)
        return ACCEPTED

    def pause(self) -> CommandReply:
        return self.set_mode(FlightMode.HOLD)

    def fall_back(self) -> None:
        """After an internal fault: hold until the next order. A failsafe action continues."""
        self._modes.fall_back()

    # Requests: the mission

    def start_mission(self, first_seq: int | None) -> CommandReply:
        """Enter MISSION at an item, None = the current one."""
        if not self._modes.armed:
            return denied("Mission start denied: arm first")
        self._mission.load()
        sequencer = self._mission.sequencer
        before, answer = sequencer.run_copy(), ACCEPTED
        if first_seq is not None and self._plans.items(PlanKind.MISSION):
            answer = self.set_current_item(first_seq)
        if answer.result is CommandResult.ACCEPTED:
            answer = self.set_mode(FlightMode.MISSION)
        if answer.result is not CommandResult.ACCEPTED:
            sequencer.restore_run(before)
        return answer

    def resume(self) -> CommandReply:
        return self.start_mission(None)

    def set_current_item(self, seq: int, *, reset: bool = False) -> CommandReply:
        """Choose the item that runs next; refused under way where the mission could not be started at it."""
        self._mission.load()
        count = len(self._plans.items(PlanKind.MISSION))
        if not 0 <= seq < count:
            return denied(f"Mission item {seq} does not exist: plan has {count}")
        sequencer = self._mission.sequencer
        before = sequencer.run_copy()
        sequencer.set_current(seq, reset=reset)
        under_way = self._modes.armed and self._modes.mode is FlightMode.MISSION
        refusal = self._modes.refusal(FlightMode.MISSION) if under_way else None
        if refusal is not None:
            sequencer.restore_run(before)
            return refusal
        return ACCEPTED

    def stand_at(self, position: Position) -> None:
        """After a restart: restore the mission progress. PlanError if the plan in force has no such item."""
        self._mission.load()
        self._mission.sequencer.stand_at(position)

    def change_speed(self, speed_m_s: float | None) -> CommandReply:
        """Speed of the current mode or mission, None = the default again."""
        limit = self._params["SPD_PLANAR_MAX"]
        if speed_m_s is not None and not 0.0 < speed_m_s <= limit:
            return denied(f"Speed {speed_m_s:g} m/s denied: use above 0 up to {limit:g}")
        self._mission.sequencer.set_speed(speed_m_s)
        if self._modes.goal is not None:
            cruise = self._params["SPD_CRUISE"] if speed_m_s is None else speed_m_s
            self._modes.goal = replace(self._modes.goal, speed_m_s=cruise, speed_asked=speed_m_s is not None)
        return ACCEPTED

    # Requests: steering

    def set_point(self, point: SetPoint) -> CommandReply:
        """Follow it in GUIDED. One that cannot be followed ends the mode."""
        guided = self._modes.of_kind(GuidedMode)
        refusal = guided.refuse_point(point)
        if not refusal:
            guided.take(point)
            return ACCEPTED
        return self.refuse_set_point(refusal)

    def refuse_set_point(self, reason: str) -> CommandReply:
        """A set point that is not followed: GUIDED ends."""
        self._modes.of_kind(GuidedMode).take(None, f"set point refused, {reason}")
        if self._modes.armed and self._modes.chosen is FlightMode.GUIDED:
            self._modes.interrupt()
        return denied(f"Set point refused: {reason}")

    def orbit(self, circle: Circling) -> CommandReply:
        if not self._modes.armed:
            return denied("Orbit denied: arm first")
        refusal = self._modes.refusal(FlightMode.CIRCLE)
        if refusal is not None:
            return refusal
        reason = self._modes.of_kind(CircleMode).choose(circle, self._modes.nav)
        if reason:
            return denied(f"Orbit denied: {reason}")
        self._modes.choose(FlightMode.CIRCLE)
        return ACCEPTED

    def test_motor(self, test: MotorTest) -> CommandReply:
        reason = self._tests.begin(test)
        return denied(f"Motor test denied: {reason}") if reason else ACCEPTED

    def change_depth(self, depth_m: float) -> CommandReply:
        """Another depth where the vehicle is, or on its circle."""
        nav = self._modes.nav
        if not self._modes.armed:
            return denied("Change of depth denied: arm first")
        if nav is None:
            return denied("Change of depth denied: no position")
        if not self._modes.active.changes_depth:
            return denied(f"Change of depth denied in {self._modes.mode.name}: hold first")
        reason = self._modes.active.go_to_depth(depth_m)
        if reason is None:
            goal = self._goals.hold(nav)
            place = np.array([*goal.pos_ned_m[:2], depth_m])
            reason = self._goals.refuse_depth(depth_m)
            if not reason:
                answer = self.set_mode(FlightMode.HOLD)
                if answer.result is not CommandResult.ACCEPTED:
                    return answer
                self._modes.fly_to(self._goals.at(place, goal.yaw_rad))
        return denied(f"Change of depth denied: {reason}") if reason else ACCEPTED

    def take_off(self, depth_m: float | None, yaw_rad: float | None = None) -> CommandReply:
        """Dive and hold; at arming when disarmed."""
        refusal = self._modes.refusal(FlightMode.TAKEOFF)
        if refusal is not None:
            return refusal
        reason = self._modes.of_kind(TakeoffMode).choose_depth(depth_m, yaw_rad)
        if reason:
            return denied(reason)
        self._modes.choose(FlightMode.TAKEOFF)
        return ACCEPTED

    # Requests: places

    def go_to(self, point: GeodeticPosition | None, yaw_rad: float | None) -> CommandReply:
        """Reposition and hold there; None = hold here."""
        if point is None:
            answer = self.set_mode(FlightMode.HOLD)
            if answer.result is CommandResult.ACCEPTED and self._modes.goal is not None and yaw_rad is not None:
                self._modes.goal = replace(self._modes.goal, yaw_rad=yaw_rad)
            return answer
        if not self._modes.armed:
            return denied("Go-to denied: arm first")
        refusal = refuse_place(self._plans.origin, point.lat_deg, point.lon_deg)
        target_ned_m = self._plans.local_ned_m(point.lat_deg, point.lon_deg, point.alt_m)
        refusal = refusal or self._goals.refuse(target_ned_m)
        if refusal:
            return denied(f"Go-to denied: {refusal}")
        answer = self.set_mode(FlightMode.HOLD)
        if answer.result is CommandResult.ACCEPTED:
            self._modes.fly_to(self._goals.at(target_ned_m, yaw_rad))
        return answer

    def set_home(self, point: GeodeticPosition | None) -> CommandReply:
        nav = self._modes.nav
        if point is not None:
            refusal = refuse_place(self._plans.origin, point.lat_deg, point.lon_deg)
            place = np.zeros(3) if refusal else self._plans.local_ned_m(point.lat_deg, point.lon_deg, point.alt_m)
        elif nav is None:
            refusal, place = "no position yet", np.zeros(3)
        else:
            refusal, place = "", nav.pos_ned_m
        refusal = refusal or self._mission.set_home(place)
        return denied(f"Home denied: {refusal}") if refusal else ACCEPTED

    def restore_home(self, pos_ned_m: FloatArray) -> str:
        """After a restart: restore home (3,), for the mission too. Returns the reason if it is rejected, else ""."""
        return self._mission.set_home(pos_ned_m)

    def set_origin(self, point: GeodeticPosition) -> CommandReply:
        """Move the local origin. Plans drawn on the map move with the map, so only while disarmed."""
        if self._modes.armed:
            return denied("Origin denied: disarm first")
        altitude = self._params.spec("ORIGIN_ALT")
        if not altitude.minimum <= point.alt_m <= altitude.maximum:
            reason = f"altitude {point.alt_m:g} m: use {altitude.minimum:g} to {altitude.maximum:g}"
            return denied(f"Origin denied: {reason}")
        try:
            origin = Origin(lat_deg=point.lat_deg, lon_deg=point.lon_deg, alt_m=point.alt_m)
        except ConfigError as error:
            return denied(f"Origin denied: {error}")
        rejection = self._plans.set_origin(origin)
        if rejection is not None:
            return denied(f"Origin denied, clear the plan first: {rejection.reason}")
        return ACCEPTED

    def end_run(self, end: RunEnd) -> CommandReply:
        if self._modes.armed:
            return CommandReply(result=CommandResult.TEMPORARILY_REJECTED, reason="Reboot refused: disarm first")
        self._ending = self._operator.t_us + END_AFTER_US, end
        self._operator.say(notices.RESTARTING() if end is RunEnd.AGAIN else notices.STOPPING())
        return ACCEPTED

    @property
    def run_end(self) -> RunEnd | None:
        """Requested end of the run, None = continue. Cancelled if the vehicle has been armed meanwhile."""
        if self._ending is None or self._operator.t_us < self._ending[0] or self._modes.armed:
            return None
        return self._ending[1]

    # One tick

    def step(self, status: VehicleStatus) -> Decision:
        modes = self._modes
        self._operator.t_us = status.t_us
        modes.status = status
        self._watch_plan()
        self._watch_check(status.t_us)
        for text in self._watch.update(status, armed=modes.armed):
            self._operator.say(text)
        modes.watch_flight_controller(status.below, self._may_resume)
        mode = modes.mode
        self._failsafe_inputs.update(
            status,
            armed=modes.armed,
            surfacing=mode is FlightMode.SURFACE,
            on_mission=mode is FlightMode.MISSION,
            blind=modes.armed and not modes.active.needs_position,
        )
        modes.apply_failsafes(status)
        if not modes.armed and status.t_us >= self._readiness_us:
            self._readiness, self._readiness_us = self._arming.reasons(status), status.t_us + READINESS_EVERY_US
        goal, reached = modes.advance(status)
        test = self._tests.step(status)
        self._disarm_flight_controller(status)
        orders, modes.equipment_orders = tuple(modes.equipment_orders), []
        return Decision(
            orders=orders,
            armed=modes.armed,
            mode=modes.mode,
            goal=goal if test is None else None,
            motor_test=test,
            blind_ascent=(modes.armed and not modes.yielded and modes.nav is None and modes.mode is FlightMode.SURFACE),
            progress=self._mission.sequencer.progress(status.t_us),
            reached=reached,
            failsafes=self._failsafes.bits,
            ascent=modes.ascent,
            by_hand=modes.by_hand(status) if test is None else None,
            drop_weight=modes.drop_weight,
            hand_back=modes.handed_back,
            disarm_flight_controller=self.disarms_flight_controller,
        )

    def _disarm_flight_controller(self, status: VehicleStatus) -> None:
        """Disarm the flight controller together with the service."""
        if self._modes.disarms_flight_controller:
            self._modes.disarms_flight_controller = False
            self._disarming.begin()
        self._disarming.step(status.t_us, status.below)

    def _may_resume(self) -> bool:
        """Whether to resume a mission that a pilot has interrupted."""
        return self._params["PILOT_BACK"] > 0.0 and self._modes.refusal(FlightMode.MISSION) is None

    def _watch_plan(self) -> None:
        """A new mission is loaded at once; one that replaces a running mission is not started."""
        if not self._mission.load() or self._modes.chosen is not FlightMode.MISSION:
            return
        if self._modes.armed:
            loaded = self._plans.items(PlanKind.MISSION)
            self._operator.say(notices.MISSION_CHANGED() if loaded else notices.MISSION_GONE())
        self._modes.interrupt()

    def _watch_check(self, t_us: int) -> None:
        """Report a new result of the plan check, and end a mission that it forbids."""
        if not self._check_news.changed():
            return
        self._readiness = self._arming.reasons(self._modes.status)
        if self._check_news.tell(t_us, in_mission=self._modes.chosen is FlightMode.MISSION):
            self._modes.interrupt()

    def _guard_plans(self, kinds: Sequence[PlanKind], verdict: PlanVerdict) -> PlanRejection | None:
        modes = self._modes
        return self._fence_guard.refusal(kinds, verdict, modes.nav, modes.goal) if modes.armed else None
