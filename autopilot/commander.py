"""What the vehicle is doing and why: arming, modes, goals and failsafes.

The commander answers MAVLink requests at once (:class:`autopilot.mavlink.api.VehicleCommands`) and, once per tick,
turns mode, mission and estimate into a goal for the controller. It never touches thrusters itself.
"""

from dataclasses import dataclass, replace

import numpy as np

from autopilot.core.errors import ConfigError
from autopilot.core.frames import FloatArray
from autopilot.core.geometry import Fence
from autopilot.core.messages import (
    Event,
    Goal,
    MissionProgress,
    NavHealth,
    NavState,
)
from autopilot.core.params import ParamSet
from autopilot.core.plan import PlanItem, PlanKind
from autopilot.core.vehicle import Vehicle
from autopilot.failsafes import Conditions, FailsafeRules
from autopilot.mavlink.api import Answer, CommandResult, FlightMode, GeoPoint
from mission.fence import fence_clearance_m
from mission.geodesy import Origin
from mission.sequencer import Action, Sequencer
from mission.store import Plans

SEVERITY_CRITICAL, SEVERITY_ERROR, SEVERITY_WARNING, SEVERITY_NOTICE, SEVERITY_INFO = 2, 3, 4, 5, 6
"""MAV_SEVERITY (common.xml)."""

READINESS_EVERY_TICKS = 50
"""Arming checks are looked at twice per second for telemetry, and anew at every request."""

SURFACED_M = 0.05
"""The vehicle counts as surfaced within this distance of where it floats."""

MAX_YAW_AIM_RAD = 0.15
"""Acceptance band of goals that are not mission items."""

SUBMERGED_M = 0.2
"""Centre deeper than this: under water (half the hull's height and a margin)."""

_ACCEPTED = Answer(result=CommandResult.ACCEPTED)


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

    def __init__(self, vehicle: Vehicle, params: ParamSet, plans: Plans) -> None:
        self._vehicle = vehicle
        self._params = params
        self._plans = plans
        self._sequencer = Sequencer(params)
        self._failsafes = FailsafeRules(params)
        self._armed = False
        self._mode = FlightMode.HOLD
        self._override: FlightMode | None = None
        self._hold: Goal | None = None
        self._conditions: Conditions | None = None
        self._mission: tuple[PlanItem, ...] = ()
        self._origin = plans.origin
        self._fence_key: tuple[float, ...] = ()
        self._fence = plans.fence()
        self._problem_key: tuple[int, int] = (-1, -1)
        self._problem = ""
        self._readiness: tuple[str, ...] = ("service is starting",)
        self._events: list[Event] = []
        self._t_us = 0
        self._ticks = 0

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
        key = (self._plans.revision, self._params["DEPTH_MIN"], self._params["DEPTH_MAX"])
        if key != self._fence_key:
            self._fence_key, self._fence = key, self._plans.fence()
        return self._fence

    @property
    def submerged(self) -> bool:
        """Whether the hull is under water, as far as is known."""
        nav = self._nav()
        return nav is not None and float(nav.pos_ned_m[2]) > SUBMERGED_M

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
        """:meth:`prearm_reasons` as of the last half second, for telemetry; empty while armed."""
        return () if self._armed else self._readiness

    def prearm_reasons(self) -> tuple[str, ...]:
        """Why arming would be refused now; empty when ready."""
        if self._conditions is None:
            return ("service is starting",)
        reasons = list(self._failsafes.prearm_reasons(self._conditions))
        nav = self._conditions.nav
        if nav is not None and self._clearance_m(nav.pos_ned_m) < 0.0:
            reasons.append("vehicle is outside the fence or inside an obstacle: check fence and origin")
        problem = self._plan_problem()
        return (*reasons, problem) if problem else tuple(reasons)

    def arm(self, force: bool) -> Answer:
        """Arm unless a check fails; ``force`` skips the checks and says so in the log."""
        if self._armed:
            return _ACCEPTED
        reasons = self.prearm_reasons()
        if reasons and not force:
            return Answer(result=CommandResult.DENIED, reason="Arming denied: " + "; ".join(reasons))
        if reasons:
            self._say(SEVERITY_WARNING, "Forced arming despite: " + "; ".join(reasons))
        self._armed = True
        self._override = None
        self._failsafes.clear()
        nav = self._nav()
        if nav is not None:
            self._set_home_ned(nav.pos_ned_m)
        self._hold_here()
        self._say(SEVERITY_INFO, "Armed")
        return _ACCEPTED

    def disarm(self, force: bool) -> Answer:
        """Disarm. ``force`` marks an emergency stop; both are always accepted."""
        if self._armed:
            self._armed = False
            self._sequencer.pause()
            self._say(SEVERITY_WARNING if force else SEVERITY_INFO, "Emergency stop" if force else "Disarmed")
        return _ACCEPTED

    def set_mode(self, mode: FlightMode) -> Answer:
        """Change the mode, or say why not."""
        if self._override is not None and mode is not FlightMode.SURFACE:
            if self._failsafes.acting(self._conditions):
                return Answer(
                    result=CommandResult.DENIED,
                    reason=f"Mode change denied: failsafe active ({self._failsafes.describe()})",
                )
            self._override = None
            self._failsafes.clear()
        if mode is FlightMode.MISSION:
            if not self._plans.items(PlanKind.MISSION):
                return Answer(result=CommandResult.DENIED, reason="No mission: upload one first")
            self._load_mission()
            self._sequencer.start()
        else:
            self._sequencer.pause()
        if mode is FlightMode.RETURN:
            self._hold = self._goal_at(self._return_point(), None)
        elif mode is FlightMode.SURFACE:
            self._hold = self._surface_goal()
        elif mode is FlightMode.HOLD:
            self._hold_here()
        if mode is not self._mode:
            self._say(SEVERITY_INFO, f"Mode {mode.name}")
        self._mode = mode
        return _ACCEPTED

    def start_mission(self, first_seq: int | None) -> Answer:
        """Enter MISSION at an item, None = where it is."""
        if not self._armed:
            return Answer(result=CommandResult.DENIED, reason="Mission start denied: arm first")
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

    def go_to(self, point: GeoPoint | None, yaw_rad: float | None) -> Answer:
        """Reposition and hold there; None = hold here."""
        if point is None:
            return self.set_mode(FlightMode.HOLD)
        if not self._armed:
            return Answer(result=CommandResult.DENIED, reason="Go-to denied: arm first")
        target_ned_m = self._plans.local_ned_m(point.lat_deg, point.lon_deg, point.alt_m)
        refusal = self._refuse_target(target_ned_m)
        if refusal:
            return Answer(result=CommandResult.DENIED, reason=f"Go-to denied: {refusal}")
        answer = self.set_mode(FlightMode.HOLD)
        if answer.result is CommandResult.ACCEPTED:
            self._hold = self._goal_at(target_ned_m, yaw_rad)
        return answer

    def change_speed(self, speed_m_s: float) -> Answer:
        """Cruise speed until the next mission start."""
        limit = self._params["SPD_PLANAR_MAX"]
        if not 0.0 < speed_m_s <= limit:
            return Answer(
                result=CommandResult.DENIED, reason=f"Speed {speed_m_s:g} m/s denied: use above 0 up to {limit:g}"
            )
        self._sequencer.set_speed(speed_m_s)
        if self._hold is not None:
            self._hold = replace(self._hold, speed_m_s=speed_m_s)
        return _ACCEPTED

    def set_home(self, point: GeoPoint | None) -> Answer:
        """Home (None = here)."""
        if point is not None:
            self._set_home_ned(self._plans.local_ned_m(point.lat_deg, point.lon_deg, point.alt_m))
            return _ACCEPTED
        nav = self._nav()
        if nav is None:
            return Answer(result=CommandResult.DENIED, reason="Home denied: no position yet")
        self._set_home_ned(nav.pos_ned_m)
        return _ACCEPTED

    def set_origin(self, point: GeoPoint) -> Answer:
        """Move the local origin. Plans drawn on the map move with the map, so only while disarmed."""
        if self._armed:
            return Answer(result=CommandResult.DENIED, reason="Origin denied: disarm first")
        try:
            origin = Origin(lat_deg=point.lat_deg, lon_deg=point.lon_deg, alt_m=point.alt_m)
        except ConfigError as error:
            return Answer(result=CommandResult.DENIED, reason=f"Origin denied: {error}")
        problem = self._plans.set_origin(origin)
        if problem is not None:
            return Answer(result=CommandResult.DENIED, reason=f"Origin denied, clear the plan first: {problem.reason}")
        return _ACCEPTED

    # One tick

    def step(self, conditions: Conditions) -> Decision:
        """Advance by one tick."""
        self._t_us = conditions.t_us
        self._conditions = conditions
        self._watch_plan()
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

    def _goal(self, nav: NavState) -> tuple[Goal | None, tuple[int, ...]]:
        if self.mode is not FlightMode.MISSION:
            if self._hold is None:
                self._hold_here()
            return self._hold, ()
        out = self._sequencer.step(self._t_us, nav)
        for seq in out.reached:
            self._say(SEVERITY_INFO, f"Reached item {seq}")
        if out.goal is not None:
            self._hold = out.goal
        if out.home_ned_m is not None:
            self._plans.set_home(out.home_ned_m)
        if out.action is Action.SURFACE:
            self.set_mode(FlightMode.SURFACE)
        elif out.action is Action.HOLD:
            self._mode = FlightMode.HOLD
            self._say(SEVERITY_NOTICE, f"Mission complete: {out.progress.lap} laps")
            return self._hold, self._with_last_item(out.reached)
        return self._hold, out.reached

    def _with_last_item(self, reached: tuple[int, ...]) -> tuple[int, ...]:
        """A plan that ends with DO_ items is over with the last of them: MAVSDK's progress waits for its number."""
        last = len(self._mission) - 1
        return reached if last in reached else (*reached, last)

    def _disarm_when_surfaced(self, nav: NavState) -> None:
        if self.mode is FlightMode.SURFACE and nav.pos_ned_m[2] <= self._top_m() + SURFACED_M:
            self._say(SEVERITY_NOTICE, "Surfaced")
            self.disarm(force=False)
            self._mode, self._override = FlightMode.HOLD, None

    def _watch_plan(self) -> None:
        """A new mission is loaded at once; one that replaces a running mission is not started."""
        if self._load_mission() and self._armed and self._mode is FlightMode.MISSION:
            self._say(SEVERITY_WARNING, "Mission changed while it ran: holding, start again")
            self.set_mode(FlightMode.HOLD)

    def _load_mission(self) -> bool:
        """Bring the sequencer in line with the plan in force; True if the plan was another one."""
        items = self._plans.items(PlanKind.MISSION)
        if items is self._mission and self._origin is self._plans.origin:
            return False
        self._mission, self._origin = items, self._plans.origin
        self._sequencer.load(self._plans.steps())
        return True

    def _apply_failsafes(self, conditions: Conditions) -> None:
        for event in self._failsafes.update(conditions, armed=self._armed):
            self._say(event.severity, event.text)
        action = self._failsafes.action
        if not self._armed or action is None:
            return
        if action == "disarm":
            self._say(SEVERITY_CRITICAL, f"Failsafe disarms: {self._failsafes.describe()}")
            self.disarm(force=True)
            return
        mode = FlightMode.SURFACE if action == "surface" else FlightMode.HOLD
        if self._override is not mode and self._override is not FlightMode.SURFACE:
            self._override = mode
            self._sequencer.pause()
            self._hold = self._surface_goal() if mode is FlightMode.SURFACE else self._hold
            self._say(SEVERITY_CRITICAL, f"Failsafe {mode.name}: {self._failsafes.describe()}")

    # Goals

    def _nav(self) -> NavState | None:
        nav = None if self._conditions is None else self._conditions.nav
        return None if nav is None or nav.health is NavHealth.INVALID else nav

    def _plan_problem(self) -> str:
        """What the parameters, as they are now, forbid of the plans in force; looked at only when one changed."""
        key = (self._plans.revision, self._params.revision)
        if key != self._problem_key:
            problem = self._plans.recheck()
            self._problem_key, self._problem = key, "" if problem is None else problem.reason
        return self._problem

    def _clearance_m(self, pos_ned_m: FloatArray) -> float:
        return float(fence_clearance_m(self.fence, pos_ned_m[None, :2])[0])

    def _set_home_ned(self, pos_ned_m: FloatArray) -> None:
        """Home is a place on the surface: relative altitudes count from there."""
        home_ned_m = np.array([pos_ned_m[0], pos_ned_m[1], 0.0])
        self._plans.set_home(home_ned_m)
        self._sequencer.set_home(home_ned_m)

    def _refuse_target(self, target_ned_m: FloatArray) -> str:
        low, high = self._params["DEPTH_MIN"], self._params["DEPTH_MAX"]
        if not low <= target_ned_m[2] <= high:
            return f"depth {target_ned_m[2]:.2f} m is outside {low:g} to {high:g} m"
        clearance_m = self._clearance_m(target_ned_m)
        needed_m = self._vehicle.radius_m + self._params["MPC_MARGIN"]
        if clearance_m < needed_m:
            return f"target is {clearance_m:.2f} m from the fence, needs {needed_m:.2f} m"
        return ""

    def _goal_at(self, pos_ned_m: FloatArray, yaw_rad: float | None) -> Goal:
        return Goal(
            pos_ned_m=pos_ned_m,
            yaw_rad=yaw_rad,
            speed_m_s=self._params["SPD_CRUISE"],
            accept_radius_m=self._params["WP_ACCEPT_RADIUS"],
            accept_yaw_rad=MAX_YAW_AIM_RAD,
            seq=-1,
        )

    def _hold_here(self) -> None:
        nav = self._nav()
        if nav is None:
            self._hold = None
            return
        pos_ned_m = nav.pos_ned_m.copy()
        pos_ned_m[2] = np.clip(pos_ned_m[2], self._params["DEPTH_MIN"], self._params["DEPTH_MAX"])
        self._hold = self._goal_at(pos_ned_m, float(nav.rpy_rad[2]))

    def _return_point(self) -> FloatArray:
        nav = self._nav()
        home_ned_m = self._plans.home_ned_m.copy()
        depth_m = self._params["DEPTH_MIN"] if nav is None else nav.pos_ned_m[2]
        home_ned_m[2] = np.clip(depth_m, self._params["DEPTH_MIN"], self._params["DEPTH_MAX"])
        return home_ned_m

    def _surface_goal(self) -> Goal | None:
        nav = self._nav()
        if nav is None:
            return None
        pos_ned_m = nav.pos_ned_m.copy()
        pos_ned_m[2] = self._top_m()
        return self._goal_at(pos_ned_m, float(nav.rpy_rad[2]))

    def _top_m(self) -> float:
        """Depth of the centre at the surface: the hull floats up no farther than its half height."""
        return max(self._params["DEPTH_MIN"], self._vehicle.hull_half_height_m)

    def _say(self, severity: int, text: str) -> None:
        self._events.append(Event(t_us=self._t_us, severity=severity, text=text))
