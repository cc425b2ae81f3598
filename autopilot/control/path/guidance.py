"""Guidance: from a goal to the reference of the optimiser.

Two implementations: the route guidance moves the reference along a free path at cruise speed (the paper's quadratic
cost), the energy guidance follows a minimum-energy trajectory (:mod:`autopilot.control.energy`).
"""

import cmath
import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from autopilot.control.current.currents import CurrentForecast
from autopilot.control.nmpc.grid import TimeGrid
from autopilot.control.nmpc.ocp import TERMINAL_STAGES
from autopilot.control.path.path_tuning import GUIDANCE, REFERENCE
from autopilot.control.path.planner import Planner
from autopilot.control.path.reference import ReferenceRollout, ReferenceTarget, Route, turn_target
from autopilot.control.path.workers import TaskFailures
from autopilot.core import operator_messages as notices
from autopilot.core.background import BackgroundTask, BackgroundWorker, Cancel
from autopilot.core.control_allocator import ControlAllocator
from autopilot.core.frames import FloatArray, unwrap_near
from autopilot.core.geometry import Fence
from autopilot.core.messages import EnergyPlan, Goal, NavState, Severity
from autopilot.core.model4 import NX, YAW
from autopilot.core.params import ParamSet

BEHIND_M, LOOKAHEAD_M = 0.15, 0.3
"""Deficit of progress above which the reference leads, and its largest lead."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class GuidanceInputs:
    """Inputs of guidance in one step."""

    t_us: int
    x0: FloatArray
    """(8,) state at which the plan begins, yaw on the turn of the last steps."""
    nav: NavState
    goal: Goal
    params: ParamSet
    fence: Fence
    planner: Planner
    """Of the fence in force."""
    radius_m: float
    """That ways keep from every boundary."""
    forecast: CurrentForecast
    speed_cap_m_s: float
    """Planar speed through the water that may be asked for."""
    thrust_limit_n: FloatArray
    """(n,)"""
    last_plan: FloatArray | None = None
    """(N+1, 8) prediction of the last step; None without a plan."""
    bow_rad: float | None = None
    """Heading into a strong stream, instead of the goal's; None = the goal's."""
    least_cap_m_s: float = 0.0
    """Planar speed below which margins do not lower the optimiser's limit."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Reference:
    """Reference of the prediction and its weights."""

    x: FloatArray
    """(N+1, 8)"""
    thrust_n: FloatArray
    """(N, n)"""
    weight_x: FloatArray
    """(8,) or (N-1, 8)"""
    weight_u: FloatArray
    """(n,) or (N, n)"""
    terminal: FloatArray
    """(8, 8)"""
    fresh: bool
    """It has nothing to do with the last one: the optimiser starts anew from it."""
    plan: EnergyPlan | None = None
    """On the step on which it came into force."""


class Guidance(Protocol):
    """The interface of guidance. One instance per vehicle; deterministic: the same calls give the same references."""

    @property
    def unreachable(self) -> bool:
        """True while there is no path to the goal; the vehicle keeps its position."""
        ...

    def reset(self) -> None:
        """Forget everything (after disarming, a jump of the estimate)."""
        ...

    def reference(self, situation: GuidanceInputs) -> Reference: ...

    def ahead(self, here: FloatArray) -> FloatArray:
        """(m, 2) the path from ``here`` (2,) to the goal, first row here, for display."""
        ...

    def take_notices(self) -> list[tuple[Severity, str]]:
        """Severity and text of notices to operator and log since the last call."""
        ...


class Weights:
    """Weights of the running cost as the parameters give them; made anew when those change."""

    def __init__(self, thrusters: int) -> None:
        self._thrusters = thrusters
        self._of: tuple[ParamSet, int] | None = None
        self._r = math.nan
        self.x: FloatArray = np.zeros(NX)
        """(8,)"""
        self.u: FloatArray = np.zeros(thrusters)
        """(n,)"""
        self.terminal: FloatArray = np.zeros((NX, NX))
        """(8, 8) TERMINAL_STAGES of those of the states."""

    def update(self, params: ParamSet, r: float | None = None) -> "Weights":
        """As they are now; ``r``: weight on the thrust, None = the parameter's."""
        of, r = (params, params.revision), params["MPC_R_THRUST"] if r is None else r
        if of != self._of:
            self._of, q = of, params["MPC_Q_POS"]
            self.x = np.array([q, q, params["MPC_Q_Z"], params["MPC_Q_YAW"], *GUIDANCE.velocity_weights])
            self.terminal = np.diag(TERMINAL_STAGES * self.x)
            self.x.setflags(write=False)
        if r != self._r:
            self._r, self.u = r, np.full(self._thrusters, r)
            self.u.setflags(write=False)
        return self


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class RouteRequest:
    planner: Planner
    start_ned_m: FloatArray
    """(2,)"""
    goal_ned_m: FloatArray
    """(2,)"""
    goal_key: tuple[float, ...]


def search_route(request: RouteRequest, cancel: Cancel) -> FloatArray | None:
    """(m, 2) a free path, None if there is none."""
    return request.planner.path(request.start_ned_m, request.goal_ned_m, cancel)


class ReferenceLookahead:
    """Lead of the reference over a vehicle that falls behind: integral action along the path.

    A reference that starts at the vehicle in every step has no memory of missing progress: a constant unmodelled force
    (more drag, less thrust, a pull) reduces the speed by a constant amount. In a strong current the vehicle could
    hover for ever with thrust and speed in reserve. The deficit against the minimum progress is therefore integrated,
    and the optimiser, which sees the reference ahead, applies the missing force. In nominal motion the integral stays
    zero, also at starts and turns.
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        self._behind_m = self._reference_speed_m_s = 0.0
        self._last: tuple[Route, int, float] | None = None

    @property
    def m(self) -> float:
        """Arc length along the route [m]."""
        return max(0.0, self._behind_m - BEHIND_M)

    def update(self, t_us: int, route: Route, s_m: float) -> None:
        """Once per step, with the arc length at which the vehicle is."""
        if self._last is not None and self._last[0] is route:
            elapsed_s = max(0.0, (t_us - self._last[1]) * 1e-6)
            least_m = elapsed_s * min(
                GUIDANCE.least_progress_fraction * self._reference_speed_m_s, GUIDANCE.least_progress_m_s
            )
            self._behind_m = min(max(self._behind_m + least_m - (s_m - self._last[2]), 0.0), BEHIND_M + LOOKAHEAD_M)
        self._last = route, t_us, s_m

    def set_reference(self, begin_m: FloatArray, end_m: FloatArray, after_s: float) -> None:
        """Set the positions of the reference now and ``after_s`` later (each at least x and y)."""
        self._reference_speed_m_s = math.dist(begin_m[:2].tolist(), end_m[:2].tolist()) / after_s


class RouteGuidance:
    """Moves the reference along the shortest free path at cruise speed over ground.

    A straight path is used at once. Another one is planned in the background; meanwhile the vehicle follows its
    present route, if that is free, or keeps its position.
    """

    def __init__(self, allocator: ControlAllocator, grid: TimeGrid, worker: BackgroundWorker) -> None:
        self._t_s = grid.t_s
        self._weights = Weights(allocator.model.thrusters)
        self._references = ReferenceRollout(allocator, grid.t_s)
        self._worker = worker
        self._task: BackgroundTask[FloatArray | None] | None = None
        self._failures = TaskFailures("route search", notices.ROUTE_SEARCH_FAILED)
        self._lookahead = ReferenceLookahead()
        self.unreachable = False
        self.reset()

    def reset(self) -> None:
        self._withdraw()
        self._step = 0
        self._requested: RouteRequest | None = None
        self._first_request_step = 0
        self._goal_key: tuple[float, ...] | None = None
        self._planner: Planner | None = None
        self._route: Route | None = None
        self._route_planner: Planner | None = None
        self._s = 0.0
        self._lookahead.reset()
        self._routed_us = 0
        self._yaw_target: float | None = None
        self._hold: FloatArray | None = None
        self.unreachable = False

    def take_notices(self) -> list[tuple[Severity, str]]:
        return self._failures.take_notices()

    def reference(self, situation: GuidanceInputs) -> Reference:
        fresh, route = self._update(situation)
        self._lookahead.update(situation.t_us, route, self._s)
        x, thrust = self._rollout(situation, route)
        self._lookahead.set_reference(x[0], x[1], float(self._t_s[1]))
        weights = self._weights.update(situation.params)
        return Reference(
            x=x, thrust_n=thrust, weight_x=weights.x, weight_u=weights.u, terminal=weights.terminal, fresh=fresh
        )

    @property
    def searching(self) -> bool:
        """Whether a route request is pending."""
        return self._task is not None

    def ahead(self, here: FloatArray) -> FloatArray:
        route = self._route
        return here[None] if route is None or self.unreachable else route.ahead(here, self._s)

    def _update(self, now: GuidanceInputs) -> tuple[bool, Route]:
        """Whether the route is another one, and the route."""
        goal, x0 = now.goal, now.x0
        self._step += 1
        key = (
            *(float(p) for p in goal.pos_ned_m),
            0.0 if goal.yaw_rad is None else goal.yaw_rad,
            float(goal.yaw_rad is None),
        )
        if self._goal_key is None or key[3:] != self._goal_key[3:]:
            self._yaw_target = None
        if key != self._goal_key:
            self.unreachable = False
            self._lookahead.reset()
        changed = key != self._goal_key or now.planner is not self._planner
        self._goal_key, self._planner = key, now.planner
        fresh = self._answered(now)
        route = self._route
        if route is not None and not fresh:
            self._s, off = route.project(x0[:2], self._s)
            pushed = (off > GUIDANCE.replan_distance_m or self.unreachable) and self._task is None
            if not changed and pushed and now.t_us - self._routed_us >= GUIDANCE.replan_interval_us:
                fresh = self._search(now)
        if changed:
            fresh |= self._search(now) or self._fallback_route(now)
        assert self._route is not None
        return fresh, self._route

    def _search(self, now: GuidanceInputs) -> bool:
        """Use the straight line to the goal if it is free (True), else request a route."""
        start, goal = now.x0[:2].copy(), np.array(now.goal.pos_ned_m[:2], dtype=float)
        self._routed_us = now.t_us
        if now.planner.sees(start, goal):
            self._withdraw()
            self._take(now, np.stack([start, goal]), now.planner)
            return True
        if self._task is None:
            self._first_request_step = self._step
        elif self._step - self._first_request_step >= GUIDANCE.patience_steps:
            return False
        self._withdraw()
        assert self._goal_key is not None
        requested = RouteRequest(planner=now.planner, start_ned_m=start, goal_ned_m=goal, goal_key=self._goal_key)
        self._requested = requested
        self._task = self._worker.submit(self._step + GUIDANCE.answer_steps, search_route, requested)
        return False

    def _answered(self, now: GuidanceInputs) -> bool:
        """Put the answer into force, if there is one. Whether the route is another one then."""
        answer = None if self._task is None else self._task.poll(self._step)
        requested = self._requested
        if answer is None or requested is None:
            return False
        self._task = self._requested = None
        path = answer.value
        newest = requested.planner is now.planner and requested.goal_key == self._goal_key
        if answer.error is None:
            self._failures.succeeded()
        else:
            self._failures.failed(answer.error, notify=newest)
        if newest:
            return self._take(now, path, requested.planner)
        # It has been overtaken, but it is the newest that there is.
        usable = path is not None and now.planner.free(path)
        fresh = usable and self._take(now, path, now.planner)
        return self._search(now) or fresh

    def _take(self, now: GuidanceInputs, path: FloatArray | None, planner: Planner) -> bool:
        """Go along a path, or hold the place without one. Whether the route is another one."""
        self.unreachable = path is None
        if path is None:
            return self._stay(now)
        self._hold = None
        self._route, self._route_planner = Route(path), planner
        self._s, _ = self._route.project(now.x0[:2], 0.0)
        return True

    def _fallback_route(self, now: GuidanceInputs) -> bool:
        """Fallback while a route is planned: the present route if it is free, else the position. Whether the route
        changed.
        """
        route, same = self._route, now.planner is self._route_planner
        if route is None or self._hold is not None:
            return self._stay(now)
        if not (same or now.planner.free(route.ahead(now.x0[:2], self._s))):
            return self._stay(now)
        self._route_planner = now.planner
        return False

    def _stay(self, now: GuidanceInputs) -> bool:
        """Hold the place, or go on holding it. Whether the route is another one."""
        if self._hold is not None and self._route is not None:
            return False
        self._hold = now.x0.copy()
        self._route, self._route_planner, self._s = Route(np.stack([now.x0[:2]] * 2)), now.planner, 0.0
        return True

    def _withdraw(self) -> None:
        if self._task is not None:
            self._task.cancel()
        self._task = None

    def _facing(self, place_ned_m: FloatArray, x0: FloatArray) -> float:
        """Heading towards a place (2,); a place that is under the vehicle has no direction."""
        ray = complex(*place_ned_m) - complex(x0[0], x0[1])
        if abs(ray) < GUIDANCE.facing_m:
            return float(x0[YAW]) if self._yaw_target is None else self._yaw_target
        return turn_target(float(x0[YAW]), cmath.phase(ray), None)

    def _rollout(self, now: GuidanceInputs, route: Route) -> tuple[FloatArray, FloatArray]:
        """References (N+1, 8) along the route and their thrust (N, n); chooses the direction of turning to the
        heading.
        """
        hold, goal, x0, params = self._hold, now.goal, now.x0, now.params
        if now.bow_rad is not None:
            self._yaw_target = unwrap_near(now.bow_rad, float(x0[YAW]))
        elif hold is not None:
            self._yaw_target = float(hold[YAW])
        elif goal.facing_ned_m is not None:
            self._yaw_target = self._facing(goal.facing_ned_m, x0)
        elif goal.yaw_rad is not None:
            self._yaw_target = turn_target(float(x0[YAW]), goal.yaw_rad, self._yaw_target)
        elif route.length_m - self._s > REFERENCE.turn_ahead_m or self._yaw_target is None:
            ray = route.point(min(self._s + REFERENCE.turn_ahead_m, route.length_m)) - complex(x0[0], x0[1])
            if abs(ray) > 0.5 * REFERENCE.turn_ahead_m:
                self._yaw_target = unwrap_near(cmath.phase(ray), float(x0[YAW]))
            elif self._yaw_target is None:
                self._yaw_target = float(x0[YAW])
        target = ReferenceTarget(
            route=route,
            s0_m=min(self._s + self._lookahead.m, route.length_m),
            depth_m=float(goal.pos_ned_m[2] if hold is None else hold[2]),
            yaw_rad=self._yaw_target,
            cruise_m_s=goal.speed_m_s,
            speed_limit_m_s=now.speed_cap_m_s,
            heave_limit_m_s=params["SPD_HEAVE_MAX"],
            yaw_rate_limit_rad_s=params["SPD_YAW_MAX"],
        )
        return self._references(x0, target, now.nav.current_ned_m_s, now.thrust_limit_n)
