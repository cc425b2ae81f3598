"""What the vehicle is doing and why: arming, modes, goals and failsafes.

The commander answers MAVLink requests at once (:class:`autopilot.mavlink.api.VehicleCommands`) and, once per tick,
turns mode, mission and estimate into a goal for the controller. It never touches thrusters itself.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np

from autopilot.command.failsafes import Conditions, FailsafeRules
from autopilot.command.watch import Watch
from autopilot.core.errors import ConfigError
from autopilot.core.frames import FloatArray
from autopilot.core.geometry import Fence
from autopilot.core.messages import (
    Event,
    Goal,
    MissionProgress,
    NavHealth,
    NavState,
    Severity,
)
from autopilot.core.params import ParamSet
from autopilot.core.phrases import NO_START, PLAN_REASON
from autopilot.core.plan import MissionResult, PlanKind, PlanRejection
from autopilot.core.vehicle import Vehicle
from autopilot.mavlink.api import Answer, CommandResult, FlightMode, GeoPoint
from mission.geodesy import MAX_RANGE_M, Origin, far_text, refuse_place
from mission.goals import Goals
from mission.items import ChangeSpeed, Jump, SetHeading, SetHome, Step
from mission.judgement import Verdict
from mission.room import Room
from mission.sequencer import Action, Position, Sequencer, is_inside
from mission.store import Plans, plan_checksum
from mission.upstream import TOLD_M_S, MadeGood, SlowLeg, slowest_leg
from mission.validation import PLACE_TOLERANCE_M

READINESS_EVERY_TICKS = 50
"""Arming checks are looked at twice per second for telemetry, and anew when arming is asked for."""

SURFACED_M = 0.05
"""The vehicle counts as surfaced within this distance of where it floats."""

UPSTREAM_US = 5_000_000
"""What the current leaves of the present leg is looked at so often: a vehicle that lies still does not know it yet."""

CHECKING = "plan check is running, try again"
"""What is said when parameters or origin have changed and the answer about the plans is not there yet."""

REPEAT_US = 5_000_000
"""The same problem of another upload is told again after this time at the earliest."""


class StuckAction(IntEnum):
    """Values of WP_STUCK_ACT."""

    WARN = 0
    HOLD = 1
    SKIP = 2
    REFUSE = 3
    """No start where the current says so beforehand; in flight as HOLD."""


_ACCEPTED = Answer(result=CommandResult.ACCEPTED)


def _denied(reason: str) -> Answer:
    return Answer(result=CommandResult.DENIED, reason=reason)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Decision:
    """What one tick decided."""

    armed: bool
    mode: FlightMode
    goal: Goal | None
    blind_ascent: bool
    """Surface without a position: open-loop heave, everything else neutral."""
    progress: MissionProgress
    reached: tuple[int, ...]
    failsafes: int


class Commander:
    """The vehicle's state machine."""

    def __init__(
        self,
        vehicle: Vehicle,
        params: ParamSet,
        plans: Plans,
        *,
        controller_check: Callable[[NavState], tuple[str, ...]] = lambda _: (),
        speed_m_s: Callable[[NavState], float] | None = None,
    ) -> None:
        """``controller_check`` says what the controller has against arming with an estimate, ``speed_m_s`` what its
        margins leave of the planar speed (None = SPD_PLANAR_MAX)."""
        self._vehicle = vehicle
        self._params = params
        self._plans = plans
        self._controller_check = controller_check
        self._speed_m_s = speed_m_s or (lambda _: params["SPD_PLANAR_MAX"])
        self._made_good = MadeGood()
        self._given_up = False
        """The present goal has been told to be out of reach."""
        self._told_upstream: set[tuple[int, bool]] = set()
        """What has been told of the current on legs since the mission was started."""
        self._upstream_us = 0
        self._sequencer = Sequencer(params)
        self._failsafes = FailsafeRules(params)
        self._goals = Goals(vehicle, params, plans)
        self._watch = Watch(vehicle, plans, self._goals)
        self._armed = False
        self._mode = FlightMode.HOLD
        self._override: FlightMode | None = None
        self._hold: Goal | None = None
        self._conditions: Conditions | None = None
        self._steps: tuple[Step, ...] = ()
        self._checked: tuple[Verdict, bool] | None = None
        self._told = ""
        self._told_us = 0
        self._told_revision = 0
        self._under_way = False
        self._readiness: tuple[str, ...] = ("service is starting",)
        self._events: list[Event] = []
        self._t_us = 0
        self._ticks = 0
        self.orders = 0
        """Grows whenever the vehicle is told to do something else."""
        plans.guard = self._guard_plans

    @property
    def armed(self) -> bool:
        """Whether thrusters may turn."""
        return self._armed

    @property
    def mode(self) -> FlightMode:
        """The mode in force: the operator's, or the one that a failsafe put over it."""
        return self._mode if self._override is None else self._override

    @property
    def fence(self) -> Fence:
        """The workspace in force; the same object until plan, origin or depth band change."""
        return self._goals.fence

    @property
    def under_way(self) -> bool:
        """Whether a mode other than holding, or a go-to, has been entered since arming: what "flying" means here."""
        return self._armed and self._under_way

    @property
    def intended_mode(self) -> FlightMode:
        """The mode that the operator chose."""
        return self._mode

    def drain_events(self) -> tuple[Event, ...]:
        """Messages for the operator since the last call."""
        events, self._events = tuple(self._events), []
        return events

    # Requests

    @property
    def readiness(self) -> tuple[str, ...]:
        """:meth:`prearm_reasons` as of the last half second, for telemetry; only that of the plans while armed."""
        if not self._armed:
            return self._readiness
        return (PLAN_REASON + self._plans.problem,) if self._plans.problem else ()

    def prearm_reasons(self) -> tuple[str, ...]:
        """Why arming would be refused now; empty when ready."""
        if self._conditions is None:
            return ("service is starting",)
        reasons = list(self._failsafes.prearm_reasons(self._conditions))
        nav = self._conditions.nav
        if nav is not None and self._goals.clearance_m(nav.pos_ned_m) < 0.0:
            reasons.append("outside the fence or in an obstacle: check fence and origin")
        if nav is not None and not math.hypot(*nav.pos_ned_m[:2].tolist()) <= MAX_RANGE_M:
            reasons.append(f"position is {far_text(math.hypot(*nav.pos_ned_m[:2].tolist()))}")
        if self._params["DEPTH_MIN"] >= self._params["DEPTH_MAX"]:
            reasons.append("the depth band is empty: set DEPTH_MIN below DEPTH_MAX")
        if self._plans.checking:
            reasons.append(CHECKING)
        elif self._plans.problem:
            reasons.append(PLAN_REASON + self._plans.problem)
        if nav is not None and nav.health is not NavHealth.INVALID:
            reasons += self._controller_check(nav)
        return tuple(reasons)

    def arm(self, force: bool) -> Answer:
        """Arm unless a check fails; ``force`` skips the checks and says so in the log. It does not start anything."""
        if self._armed:
            return _ACCEPTED
        reasons = self.prearm_reasons()
        if reasons and (not force or not self._plans.placed):
            waits = reasons == (CHECKING,) or force
            result = CommandResult.TEMPORARILY_REJECTED if waits else CommandResult.DENIED
            return Answer(result=result, reason="Arming denied: " + (CHECKING if force else "; ".join(reasons)))
        if reasons:
            self._say(Severity.WARNING, "Forced arming despite: " + "; ".join(reasons))
        self._armed = True
        self._failsafes.clear()
        nav = self._nav()
        if nav is not None:
            self._move_home(nav.pos_ned_m)
        self._under_way = False
        self._enter(self._mode if self._refuse_mode(self._mode) is None else FlightMode.HOLD)
        self._say(Severity.INFO, "Armed")
        return _ACCEPTED

    def disarm(self, force: bool) -> Answer:
        """Disarm. ``force`` marks an emergency stop; both are always accepted. The next arming begins in HOLD."""
        if self._armed:
            self._armed = False
            self._override = None
            self._enter(FlightMode.HOLD)
            self._say(Severity.WARNING if force else Severity.INFO, "Emergency stop" if force else "Disarmed")
        return _ACCEPTED

    def set_mode(self, mode: FlightMode) -> Answer:
        """Change the mode, or say why not."""
        refusal = self._refuse_mode(mode)
        if refusal is not None:
            return refusal
        if mode is not self._mode:
            self._say(Severity.INFO, f"Mode {mode.name}")
        if self._override is not None and mode is not FlightMode.SURFACE:
            self._override = None
            self._failsafes.clear()
        elif self._override is not None:
            self._override = FlightMode.SURFACE
        self._enter(mode)
        return _ACCEPTED

    def start_mission(self, first_seq: int | None) -> Answer:
        """Enter MISSION at an item, None = where it is."""
        refusal = self._refuse_mode(FlightMode.MISSION) if self._armed else _denied("Mission start denied: arm first")
        if refusal is not None:
            return refusal
        if first_seq is not None and first_seq > 0:
            answer = self.set_current_item(first_seq)
            if answer.result is not CommandResult.ACCEPTED:
                return answer
        return self.set_mode(FlightMode.MISSION)

    def pause(self) -> Answer:
        """Hold here."""
        return self.set_mode(FlightMode.HOLD)

    def resume(self) -> Answer:
        """Go on with the mission."""
        return self.start_mission(None)

    def set_current_item(self, seq: int) -> Answer:
        """Choose the next mission item."""
        self._load_mission()
        count = len(self._plans.items(PlanKind.MISSION))
        if not 0 <= seq < count:
            return Answer(result=CommandResult.DENIED, reason=f"Mission item {seq} does not exist: plan has {count}")
        self._sequencer.set_current(seq)
        return _ACCEPTED

    @property
    def mission_position(self) -> Position | None:
        """Where the mission stands, None when there is nothing to go on with."""
        return self._sequencer.position

    def stand_at(self, position: Position) -> None:
        """After a restart: the mission of the plan in force stands where it stood. PlanError if it has no such item."""
        self._load_mission()
        self._sequencer.stand_at(position)

    def restore_home(self, pos_ned_m: FloatArray) -> str:
        """After a restart: home (3,) is where it was, for the mission too. Why it is not taken, "" when it is."""
        return self._set_home_ned(pos_ned_m)

    def go_to(self, point: GeoPoint | None, yaw_rad: float | None) -> Answer:
        """Reposition and hold there; None = hold here."""
        if point is None:
            answer = self.set_mode(FlightMode.HOLD)
            if answer.result is CommandResult.ACCEPTED and self._hold is not None and yaw_rad is not None:
                self._hold = replace(self._hold, yaw_rad=yaw_rad)
            return answer
        if not self._armed:
            return Answer(result=CommandResult.DENIED, reason="Go-to denied: arm first")
        refusal = refuse_place(self._plans.origin, point.lat_deg, point.lon_deg)
        target_ned_m = self._plans.local_ned_m(point.lat_deg, point.lon_deg, point.alt_m)
        refusal = refusal or self._goals.refuse(target_ned_m)
        if refusal:
            return Answer(result=CommandResult.DENIED, reason=f"Go-to denied: {refusal}")
        answer = self.set_mode(FlightMode.HOLD)
        if answer.result is CommandResult.ACCEPTED:
            self._hold = self._goals.at(target_ned_m, yaw_rad)
            self._under_way = True
        return answer

    def fall_back(self) -> None:
        """Something inside has failed: hold here until somebody decides anew. A failsafe's action goes on."""
        if self._armed and self._override is None:
            self._enter(FlightMode.HOLD)

    def change_speed(self, speed_m_s: float | None) -> Answer:
        """Speed for what runs now, None = no longer one that was asked for."""
        limit = self._params["SPD_PLANAR_MAX"]
        if speed_m_s is not None and not 0.0 < speed_m_s <= limit:
            return Answer(
                result=CommandResult.DENIED, reason=f"Speed {speed_m_s:g} m/s denied: use above 0 up to {limit:g}"
            )
        self._sequencer.set_speed(speed_m_s)
        if self._hold is not None:
            cruise = self._params["SPD_CRUISE"] if speed_m_s is None else speed_m_s
            self._hold = replace(self._hold, speed_m_s=cruise, speed_asked=speed_m_s is not None)
        return _ACCEPTED

    def set_home(self, point: GeoPoint | None) -> Answer:
        """Home (None = here)."""
        nav = self._nav()
        if point is not None:
            refusal = refuse_place(self._plans.origin, point.lat_deg, point.lon_deg)
            place = np.zeros(3) if refusal else self._plans.local_ned_m(point.lat_deg, point.lon_deg, point.alt_m)
        elif nav is None:
            refusal, place = "no position yet", np.zeros(3)
        else:
            refusal, place = "", nav.pos_ned_m
        refusal = refusal or self._set_home_ned(place)
        return Answer(result=CommandResult.DENIED, reason=f"Home denied: {refusal}") if refusal else _ACCEPTED

    def set_origin(self, point: GeoPoint) -> Answer:
        """Move the local origin. Plans drawn on the map move with the map, so only while disarmed."""
        if self._armed:
            return Answer(result=CommandResult.DENIED, reason="Origin denied: disarm first")
        altitude = self._params.spec("ORIGIN_ALT")
        if not altitude.minimum <= point.alt_m <= altitude.maximum:
            reason = f"altitude {point.alt_m:g} m: use {altitude.minimum:g} to {altitude.maximum:g}"
            return Answer(result=CommandResult.DENIED, reason=f"Origin denied: {reason}")
        try:
            origin = Origin(lat_deg=point.lat_deg, lon_deg=point.lon_deg, alt_m=point.alt_m)
        except ConfigError as error:
            return Answer(result=CommandResult.DENIED, reason=f"Origin denied: {error}")
        rejection = self._plans.set_origin(origin)
        if rejection is not None:
            return _denied(f"Origin denied, clear the plan first: {rejection.reason}")
        return _ACCEPTED

    # One tick

    def step(self, conditions: Conditions) -> Decision:
        """Advance by one tick."""
        self._t_us = conditions.t_us
        self._conditions = conditions
        self._plans.tick()
        self._watch_plan()
        self._watch_check()
        for severity, text in self._watch.look(conditions, armed=self._armed):
            self._say(severity, text)
        self._apply_failsafes(conditions)
        if not self._armed and self._ticks % READINESS_EVERY_TICKS == 0:
            self._readiness = self.prearm_reasons()
        self._ticks += 1
        nav = conditions.nav
        reached: tuple[int, ...] = ()
        goal: Goal | None = None
        usable = nav is not None and nav.health is not NavHealth.INVALID
        if self._armed and usable and nav is not None:
            goal, reached = self._goal(nav)
            self._disarm_when_surfaced(nav)
        return Decision(
            armed=self._armed,
            mode=self.mode,
            goal=goal,
            blind_ascent=self._armed and not usable and self.mode is FlightMode.SURFACE,
            progress=self._sequencer.progress(conditions.t_us),
            reached=reached,
            failsafes=self._failsafes.bits,
        )

    def _goal(self, nav: NavState) -> tuple[Goal, tuple[int, ...]]:
        """Goal of this tick, and the mission items that have been reached on it."""
        reached: tuple[int, ...] = ()
        if self.mode is FlightMode.MISSION:
            out = self._sequencer.step(self._t_us, nav)
            reached = out.reached
            for seq in reached:
                self._say(Severity.INFO, f"Reached item {seq}")
            if out.goal is not None:
                self._hold = out.goal
            if out.home_ned_m is not None:
                self._move_home(out.home_ned_m)
            if out.action is Action.SURFACE:
                self.set_mode(FlightMode.SURFACE)
            elif out.action is Action.HOLD:
                self._mode = FlightMode.HOLD
                skipped = self._sequencer.skipped
                more = f", items skipped: {skipped}" if skipped else ""
                self._say(Severity.NOTICE, f"Mission complete, laps: {out.progress.lap}{more}")
                reached = self._with_last_item(reached)
        if self._hold is None:
            self._hold = self._goal_of(self.mode, nav)
        self._watch_way(self._hold, nav)
        return self._hold, reached

    def _watch_way(self, goal: Goal, nav: NavState) -> None:
        """A goal that the vehicle gets no nearer to is not crept at for ever: WP_STUCK_ACT says what is done."""
        returns = self.mode is FlightMode.RETURN and not is_inside(goal, nav)
        flies = self.mode is FlightMode.MISSION and self._sequencer.travelling
        conditions, params = self._conditions, self._params
        if conditions is None or not (returns or flies):
            self._made_good.forget()
            self._given_up = False
            return
        patience_s = params["WP_STUCK_TIME"]
        step_m = patience_s * params["SPD_GROUND_MIN"]
        idle_s = self._made_good.idle_s(self._t_us, goal, nav, conditions.way_left_m, step_m)
        if flies and self._t_us - self._upstream_us >= UPSTREAM_US:
            self._upstream_us = self._t_us
            self._tell_upstream(only_this=True)
        if idle_s < patience_s:
            self._given_up = False
            return
        if self._given_up:
            return
        self._given_up = True
        current = math.hypot(*nav.current_ned_m_s[:2].tolist())
        why = "no free way" if conditions.unreachable else f"current {current:.2f} m/s"
        action = int(params["WP_STUCK_ACT"]) if flies else 0
        if action == StuckAction.WARN:
            name = f"Item {goal.seq}" if flies else "Home"
            self._say(Severity.WARNING, f"{name} out of reach: {why}")
        elif action == StuckAction.SKIP:
            self._say(Severity.WARNING, f"Skipped item {goal.seq}, out of reach: {why}")
            self._sequencer.skip(nav)
            self._made_good.forget()
            self._given_up = False
        else:
            self._say(Severity.WARNING, f"Holding: item {goal.seq} out of reach, {why}")
            self._enter(FlightMode.HOLD)

    def _slowest_leg(self, first_seq: int, *, only_this: bool = False) -> SlowLeg | None:
        """Of the mission in force from here, in the current as it is estimated now."""
        nav = self._nav()
        if nav is None:
            return None
        current = nav.current_ned_m_s[:2]
        return slowest_leg(
            self._steps[first_seq : first_seq + 1] if only_this else self._steps,
            nav.pos_ned_m[:2],
            first_seq,
            self._speed_m_s(nav),
            lambda places: np.tile(current, (len(places), 1)),
        )

    def _with_last_item(self, reached: tuple[int, ...]) -> tuple[int, ...]:
        """A plan that ends with DO_ items is over with the last of them: MAVSDK's progress waits for its number."""
        steps = self._plans.steps()
        last = len(steps) - 1
        flown = max((*reached, self._sequencer.progress(self._t_us).reached_seq))
        ends_with_orders = all(
            isinstance(step, Jump | ChangeSpeed | SetHeading | SetHome) for step in steps[flown + 1 :]
        )
        return (*reached, last) if flown < last and ends_with_orders else reached

    def _disarm_when_surfaced(self, nav: NavState) -> None:
        if self.mode is FlightMode.SURFACE and nav.pos_ned_m[2] <= self._goals.top_m + SURFACED_M:
            self._say(Severity.NOTICE, "Surfaced")
            self.disarm(force=False)

    def _watch_plan(self) -> None:
        """A new mission is loaded at once; one that replaces a running mission is not started."""
        if not self._load_mission() or self._mode is not FlightMode.MISSION:
            return
        if self._armed:
            self._say(Severity.WARNING, "Mission changed while it ran: holding, start again")
        if self._override is None:
            self._enter(FlightMode.HOLD)
        self._mode = FlightMode.HOLD

    def _load_mission(self) -> bool:
        """Bring the sequencer in line with the plan in force; True if the plan was another one."""
        steps = self._plans.steps()
        if steps is self._steps:
            return False
        self._steps = steps
        self._sequencer.load(steps)
        return True

    def _watch_check(self) -> None:
        """Tell what a new answer to the plans' check means, and end a mission that it forbids."""
        checked = (self._plans.verdict, self._plans.checking)
        if checked == self._checked:
            return
        self._checked = checked
        self._readiness = self.prearm_reasons()
        if self._plans.checking:
            return
        problem, revision = self._plans.problem, self._plans.revision
        if problem and self._mode is FlightMode.MISSION:
            if self._override is None:
                self._enter(FlightMode.HOLD)
            self._mode = FlightMode.HOLD
            self._say(Severity.WARNING, f"Holding: {problem}")
        elif problem and (
            problem != self._told or (revision != self._told_revision and self._t_us - self._told_us >= REPEAT_US)
        ):
            self._say(Severity.WARNING, NO_START + problem)
        elif self._told and not problem:
            self._say(Severity.INFO, "Plan ok")
        else:
            return
        self._told, self._told_us, self._told_revision = problem, self._t_us, revision

    def _guard_plans(self, kinds: Sequence[PlanKind], verdict: Verdict) -> PlanRejection | None:
        """While armed: no fence that the vehicle or its mission would break, and none removed."""
        allowed = not self._armed or self._params["FENCE_ARMED_CHG"] or PlanKind.FENCE not in kinds
        fence = verdict.question.plans[PlanKind.FENCE]
        if allowed or plan_checksum(fence) == self._plans.checksum(PlanKind.FENCE):
            return None
        reason = ""
        if not fence:
            reason = "disarm before the fence is removed"
        elif verdict.joint:
            reason = f"the vehicle is armed and {verdict.joint[0].reason}"
        else:
            reason = self._fence_lack(Room([(s.shape, s.inclusion) for s in verdict.shapes]))
        if not reason:
            return None
        return PlanRejection(seq=0, result=MissionResult.DENIED, reason=f"{reason}; FENCE_ARMED_CHG 1 allows it")

    def _fence_lack(self, room: Room) -> str:
        """What another workspace has against where the vehicle is and where it goes, "" if nothing."""
        nav = self._nav()
        places = [] if nav is None else [("vehicle", nav.pos_ned_m)]
        places += [] if self._hold is None else [("vehicle's goal", self._hold.pos_ned_m)]
        for name, pos_ned_m in places:
            have_m = float(room.clearance_m(pos_ned_m[None, :2])[0])
            # Not worse than it is: a vehicle that was pushed to a boundary may get its fence again.
            need_m = min(self._vehicle.radius_m, self._goals.clearance_m(pos_ned_m)) - PLACE_TOLERANCE_M
            if have_m < need_m:
                return f"the {name} would be {need_m - have_m:.2f} m too near or inside: move it, or the fence"
        return ""

    def _apply_failsafes(self, conditions: Conditions) -> None:
        for event in self._failsafes.update(conditions, armed=self._armed):
            self._events.append(event)
        action = self._failsafes.action
        if not self._armed or action is None:
            return
        if action == "disarm":
            self._say(Severity.CRITICAL, f"Failsafe disarms: {self._failsafes.describe()}")
            self.disarm(force=True)
            return
        mode = FlightMode.SURFACE if action == "surface" else FlightMode.HOLD
        if self._override is not mode and self._override is not FlightMode.SURFACE:
            self._override = mode
            self._sequencer.pause()
            nav = self._nav()
            self._hold = None if nav is None else self._goal_of(mode, nav)
            self._say(Severity.CRITICAL, f"Failsafe {mode.name}: {self._failsafes.describe()}")

    # Modes

    def _refuse_mode(self, mode: FlightMode) -> Answer | None:
        """The refusal of a mode that cannot be entered, None if it can."""
        if self._override is not None and mode is not FlightMode.SURFACE and self._failsafes.acting:
            return _denied(f"Mode change denied: failsafe active ({self._failsafes.describe()})")
        if mode is FlightMode.MISSION:
            return self._refuse_mission()
        refusal = self._goals.refuse_home() if mode is FlightMode.RETURN else ""
        return _denied(f"Return denied: {refusal}") if refusal else None

    def _refuse_mission(self) -> Answer | None:
        """The refusal of the mission, however it is to be begun."""
        if not self._plans.items(PlanKind.MISSION):
            return _denied("No mission: upload one first")
        if self._plans.checking:
            return Answer(result=CommandResult.TEMPORARILY_REJECTED, reason=f"Mission denied: {CHECKING}")
        reason = self._plans.problem
        nav = self._nav()
        if not reason and self._armed and nav is not None and self._goals.clearance_m(nav.pos_ned_m) < 0.0:
            reason = "outside the fence or in an obstacle: go to a free place first"
        if not reason and self._armed and int(self._params["WP_STUCK_ACT"]) == StuckAction.REFUSE:
            leg, least = self._slowest_leg(self._next_item()), self._params["SPD_GROUND_MIN"]
            reason = leg.text(least) if leg is not None and leg.out_of_reach(least) else ""
        return _denied(f"Mission denied: {reason}") if reason else None

    def _next_item(self) -> int:
        """Where the mission goes on."""
        position = self._sequencer.position
        return 0 if position is None else position.cursor

    def _tell_upstream(self, *, only_this: bool = False) -> None:
        """What the current leaves of the speed over ground on the slowest leg that is to come (or on this one), if that
        is little; once per item and answer."""
        leg, least_m_s = self._slowest_leg(self._next_item(), only_this=only_this), self._params["SPD_GROUND_MIN"]
        if leg is not None and only_this:
            leg = leg.made(self._made_good.made_m_s, self._made_good.left_m)
        if leg is None or leg.left_m_s >= TOLD_M_S:
            return
        found = (leg.seq, leg.out_of_reach(least_m_s))
        if found not in self._told_upstream:
            self._told_upstream.add(found)
            self._say(Severity.WARNING, leg.text(least_m_s))

    def _enter(self, mode: FlightMode) -> None:
        """Begin a mode where the vehicle is."""
        self.orders += 1
        self._under_way |= mode is not FlightMode.HOLD
        if mode is FlightMode.MISSION:
            self._load_mission()
            self._sequencer.start()
            self._told_upstream, self._upstream_us = set(), self._t_us
            self._tell_upstream()
        else:
            self._sequencer.pause()
        nav = self._nav()
        self._hold = None if nav is None else self._goal_of(mode, nav)
        self._mode = mode

    def _goal_of(self, mode: FlightMode, nav: NavState) -> Goal:
        """Where a mode goes from here; a mission says so itself, until then it holds."""
        if mode is FlightMode.RETURN:
            return self._goals.home(nav)
        return self._goals.surface(nav) if mode is FlightMode.SURFACE else self._goals.hold(nav)

    def _nav(self) -> NavState | None:
        nav = None if self._conditions is None else self._conditions.nav
        return None if nav is None or nav.health is NavHealth.INVALID else nav

    def _set_home_ned(self, pos_ned_m: FloatArray) -> str:
        """Home is a place on the surface: relative altitudes count from there. Why not, "" when it is taken."""
        home_ned_m = np.array([pos_ned_m[0], pos_ned_m[1], 0.0])
        refusal = self._plans.set_home(home_ned_m)
        if not refusal:
            self._sequencer.set_home(home_ned_m)
        return refusal

    def _move_home(self, pos_ned_m: FloatArray) -> None:
        """The same where nobody is asked."""
        refusal = self._set_home_ned(pos_ned_m)
        if refusal:
            self._say(Severity.WARNING, f"Home stays where it was: {refusal}")

    def _say(self, severity: Severity, text: str) -> None:
        self._events.append(Event(t_us=self._t_us, severity=severity, text=text))
