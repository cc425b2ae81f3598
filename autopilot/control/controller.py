"""The motion controller: route, reference, constraints and optimiser behind one ``step``, with its fallbacks."""

import cmath
import math
import time
from collections.abc import Callable

import numpy as np

from autopilot.control import ocp
from autopilot.control.currents import CurrentForecast, EstimatedCurrent
from autopilot.control.fallback import station_keeping_thrust
from autopilot.control.grid import TimeGrid, geometric_grid
from autopilot.control.lag import ThrusterLag
from autopilot.control.nmpc import Nmpc, NmpcProblem, NmpcResult
from autopilot.control.obstacles import FAR_M, fence_key
from autopilot.control.planner import Planner
from autopilot.control.reference import TURN_AHEAD_M, Route, Target, build_reference, turn_target
from autopilot.core.frames import FloatArray, unwrap_near
from autopilot.core.geometry import Fence
from autopilot.core.messages import ControlOutput, Fallback, Goal, NavHealth, NavState, NmpcStatus, SolveStatus
from autopilot.core.model4 import NU, NX, YAW, Z
from autopilot.core.params import ParamSet
from autopilot.core.vehicle import Vehicle

VELOCITY_WEIGHTS = (8.0, 8.0, 8.0, 0.5)
"""Weights on u, v, w [1/(m/s)^2] and r [1/(rad/s)^2]: enough to hold the cruise speed."""

YAW_RATE_SHARE = 0.92
HEAVE_SHARE = 0.92
"""Shares of the heave and yaw rate limits that the optimiser may use; the rest is for estimation error."""

BURST_QPS = 3
"""The step that makes a new route solves so many QPs: the plan starts from the reference and converges at once."""

REPLAN_DISTANCE_M = 0.3
REPLAN_INTERVAL_US = 1_000_000
"""A vehicle that has been pushed this far off its route gets a new one, at most once a second."""

LONGEST_SHIFT_S = 1.0
"""A plan older than this is not continued."""


class MotionController:
    """Called every 50 ms (any other interval works). One instance per vehicle; :meth:`step` is deterministic.

    The horizon is a geometric grid of ``n`` intervals over ``horizon_s``, or any other ``grid``. ``cpu_clock`` measures
    what a step costs (reported, never acted upon). The current estimate holds over the whole horizon: it carries what
    the model lacks as well (drag, tether), which does not fade with distance, a faded current would give every goal an
    offset, and what lies beyond the first seconds is planned again before it is flown.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        *,
        n: int = 20,
        horizon_s: float = 8.0,
        grid: TimeGrid | None = None,
        currents: CurrentForecast | None = None,
        cpu_clock: Callable[[], float] = time.thread_time,
        backends: tuple[ocp.QpBackend, ...] = (ocp.HPIPM, ocp.PIQP),
    ) -> None:
        self._vehicle = vehicle
        self._model = vehicle.model4.to_model()
        self._cpu_clock = cpu_clock
        grid = grid or geometric_grid(n, horizon_s)
        self.nmpc = Nmpc(self._model, grid, backends=backends)
        self._lag = ThrusterLag(self._model, vehicle.drive.time_constant_s)
        self._plane_n = np.zeros((grid.n - 1, self.nmpc.planes, 2))
        self._plane_d = np.zeros((grid.n - 1, self.nmpc.planes))
        self._forecast = currents or EstimatedCurrent()
        self._currents = np.zeros((grid.n, 3))
        self._planner: Planner | None = None
        self._planner_key: tuple[object, ...] = ()
        self._fence: Fence | None = None
        self.unreachable = False
        """True while the planner finds no way to the goal; the vehicle holds its place."""
        self.reset()

    def reset(self) -> None:
        """Forget the plan (after disarming, before a new start)."""
        self._last_us: int | None = None
        self._goal_key: tuple[float, ...] | None = None
        self._route: Route | None = None
        self._s = 0.0
        self._routed_us = 0
        self._yaw_rad: float | None = None
        self._yaw_target: float | None = None
        self._reset_count = -1
        self._plan_age_s: float | None = None
        self._burst = False
        self._hold: FloatArray | None = None
        self._hold_goal: FloatArray | None = None
        self._command = np.zeros(NU)
        self._lag.reset()
        self.unreachable = False

    def step(
        self,
        t_us: int,
        nav: NavState,
        goal: Goal,
        fence: Fence,
        params: ParamSet,
        thruster_limit_n: FloatArray | None = None,
    ) -> ControlOutput:
        """Thrust for the next interval. ``thruster_limit_n`` (4,) lowers THR_LIMIT per thruster (derating, failure)."""
        began = self._cpu_clock()
        limit_n = np.full(NU, params["THR_LIMIT"])
        if thruster_limit_n is not None:
            limit_n = np.minimum(limit_n, thruster_limit_n)
        elapsed_s = 0.0 if self._last_us is None else (t_us - self._last_us) * 1e-6
        self._last_us = t_us
        self._lag.follow(self._command, elapsed_s)
        nav = self._forecast.view(nav)
        x, current = self._state(nav), nav.current_ned_m_s
        if nav.health is NavHealth.INVALID or not math.isfinite(float(x.sum() + current.sum())):
            return self._neutral(t_us, nav, began)

        x0 = self._lag.ahead(x, current)
        if nav.reset_count != self._reset_count:
            self._reset_count, self._route = nav.reset_count, None
        planner = self._planner_for(fence, params)
        fresh, route = self._update_task(t_us, x0, goal, planner)
        fresh |= not 0.0 <= elapsed_s <= LONGEST_SHIFT_S
        reference = self._reference(x0, goal, route, current, params)
        if fresh or self._plan_age_s is None:
            self._plan_age_s = None
            self.nmpc.set_plan(reference, np.zeros((self.nmpc.grid.n, NU)))
            self._burst = True
        else:
            self.nmpc.shift(elapsed_s)
            turn = 2.0 * math.pi * round((x0[YAW] - self.nmpc.x[0, YAW]) / (2.0 * math.pi))
            if turn:
                self.nmpc.x[:, YAW] += turn
        result, qps, margin_m = self._solve(x0, reference, nav, planner, fence, params, limit_n)
        thrust, fallback = self._choose(result, x, current, limit_n, elapsed_s)
        self._command = thrust
        return ControlOutput(
            thrust_n=thrust,
            status=NmpcStatus(
                t_us=t_us,
                status=result.status,
                fallback=fallback,
                iterations=qps,
                solve_s=self._cpu_clock() - began,
                cost=result.cost if math.isfinite(result.cost) else 0.0,
                slack_max=result.slack_max if math.isfinite(result.slack_max) else 0.0,
                margin_m=margin_m,
            ),
            horizon_ned_m=self.nmpc.x[:, :3].copy(),
            route_ned_m=self._route_ahead(nav),
        )

    def _state(self, nav: NavState) -> FloatArray:
        yaw = float(nav.rpy_rad[2])
        self._yaw_rad = yaw if self._yaw_rad is None else unwrap_near(yaw, self._yaw_rad)
        x = np.empty(NX)
        x[:3] = nav.pos_ned_m
        x[YAW] = self._yaw_rad
        x[4:7] = nav.vel_water_frd_m_s
        x[7] = nav.rate_frd_rad_s[2]
        return x

    def _planner_for(self, fence: Fence, params: ParamSet) -> Planner:
        """The planner of this fence; another one, and no route yet, when fence or margin have changed."""
        planner, radius = self._planner, self._vehicle.radius_m + params["MPC_MARGIN"]
        if planner is not None and fence is self._fence and self._planner_key[0] == radius:
            return planner
        key = (radius, *fence_key(fence))
        if planner is None or key != self._planner_key:
            planner = Planner(fence, radius)
            self._planner, self._planner_key, self._route = planner, key, None
        self._fence = fence
        return planner

    def _update_task(self, t_us: int, x0: FloatArray, goal: Goal, planner: Planner) -> tuple[bool, Route]:
        """Whether the route is another one, and the route."""
        goal_key = (
            *(float(p) for p in goal.pos_ned_m),
            0.0 if goal.yaw_rad is None else goal.yaw_rad,
            float(goal.yaw_rad is None),
        )
        route = self._route
        changed = goal_key != self._goal_key or route is None
        if self._goal_key is None or goal_key[3:] != self._goal_key[3:]:
            self._yaw_target = None
        self._goal_key = goal_key
        if not changed and route is not None:
            self._s, off = route.project(x0[:2], self._s)
            pushed = off > REPLAN_DISTANCE_M or self.unreachable
            if not pushed or t_us - self._routed_us < REPLAN_INTERVAL_US:
                return False, route
        path = planner.path(x0[:2], np.asarray(goal.pos_ned_m, dtype=float))
        self._routed_us = t_us
        was_unreachable, self.unreachable = self.unreachable, path is None
        if path is None:
            if was_unreachable and not changed and route is not None:
                return False, route
            self._hold_goal = x0.copy()
            path = np.stack([x0[:2], x0[:2]])
        else:
            self._hold_goal = None
        route = Route(path)
        self._route, self._s = route, 0.0
        return True, route

    def _reference(self, x0: FloatArray, goal: Goal, route: Route, current: FloatArray, params: ParamSet) -> FloatArray:
        """References (N+1, 8) along the route; chooses the way round to the heading."""
        hold = self._hold_goal
        if hold is not None:
            self._yaw_target = float(hold[YAW])
        elif goal.yaw_rad is not None:
            self._yaw_target = turn_target(float(x0[YAW]), goal.yaw_rad, self._yaw_target)
        elif route.length_m - self._s > TURN_AHEAD_M or self._yaw_target is None:
            look = route.point(min(self._s + TURN_AHEAD_M, route.length_m)) - complex(x0[0], x0[1])
            if abs(look) > 0.5 * TURN_AHEAD_M:
                self._yaw_target = unwrap_near(cmath.phase(look), float(x0[YAW]))
            elif self._yaw_target is None:
                self._yaw_target = float(x0[YAW])
        target = Target(
            route=route,
            s0_m=self._s,
            depth_m=float(goal.pos_ned_m[2] if hold is None else hold[2]),
            yaw_rad=self._yaw_target,
            cruise_m_s=goal.speed_m_s,
            speed_limit_m_s=_speed_cap(params),
            heave_limit_m_s=params["SPD_HEAVE_MAX"],
            yaw_rate_limit_rad_s=params["SPD_YAW_MAX"],
        )
        return build_reference(self.nmpc.grid.t_s, x0, target, current)

    def _solve(
        self,
        x0: FloatArray,
        reference: FloatArray,
        nav: NavState,
        planner: Planner,
        fence: Fence,
        params: ParamSet,
        limit_n: FloatArray,
    ) -> tuple[NmpcResult, int, float]:
        """The QPs of this step: result of the last, their number, and the smallest clearance of the plan."""
        n = self.nmpc.grid.n
        self._forecast.fill(nav, self.nmpc.x[:n, :3], self.nmpc.grid.t_s[:n], self._currents)
        problem = NmpcProblem(
            x0=x0,
            x_ref=reference,
            current_ned_m_s=self._currents,
            weights=_weights(params),
            limits=np.array(
                [
                    _speed_cap(params),
                    HEAVE_SHARE * params["SPD_HEAVE_MAX"],
                    YAW_RATE_SHARE * params["SPD_YAW_MAX"],
                    min(x0[Z], max(fence.depth_min_m, params["DEPTH_MIN"])),
                    max(x0[Z], min(fence.depth_max_m, params["DEPTH_MAX"])),
                ]
            ),
            thrust_limit_n=limit_n,
            plane_n=self._plane_n,
            plane_d_m=self._plane_d,
        )
        radius = self._vehicle.radius_m + params["MPC_MARGIN"]
        qps = BURST_QPS if self._burst else 1
        self._burst = False
        margin = FAR_M
        for _ in range(qps):
            self.nmpc.x[0] = x0
            margin = planner.features.half_planes(
                self.nmpc.x[:n, :2], self.nmpc.grid.t_s[:n], radius, self.nmpc.planes, self._plane_n, self._plane_d
            )
            result = self.nmpc.solve(problem)
            if result.status is not SolveStatus.OK:
                break
        return result, qps, margin

    def _choose(
        self, result: NmpcResult, x: FloatArray, current: FloatArray, limit_n: FloatArray, elapsed_s: float
    ) -> tuple[FloatArray, Fallback]:
        """The fallback chain: new plan, rest of the last plan, station keeping where that ended."""
        if result.status is SolveStatus.OK:
            self._plan_age_s, self._hold = 0.0, None
            return result.thrust_n[0].copy(), Fallback.NONE
        if self._plan_age_s is not None and self._hold is None:
            self._plan_age_s += elapsed_s
            if self._plan_age_s < self.nmpc.grid.t_s[-1]:
                return np.clip(self.nmpc.u[0], -limit_n, limit_n), Fallback.SHIFTED_PLAN
        self._plan_age_s = None
        if self._hold is None:
            self._hold = x.copy()
        return station_keeping_thrust(self._model, x, self._hold, current, limit_n), Fallback.STATION_KEEPING

    def _neutral(self, t_us: int, nav: NavState, began: float) -> ControlOutput:
        """Without an estimate there is nothing to control: no thrust, and the plan is void."""
        self._command = np.zeros(NU)
        self._plan_age_s = self._hold = self._yaw_rad = self._yaw_target = self._route = None
        status = NmpcStatus(
            t_us=t_us,
            status=SolveStatus.IDLE,
            fallback=Fallback.NEUTRAL,
            iterations=0,
            solve_s=self._cpu_clock() - began,
            cost=0.0,
            slack_max=0.0,
            margin_m=0.0,
        )
        here = np.asarray(nav.pos_ned_m, dtype=float)[None]
        return ControlOutput(
            thrust_n=np.zeros(NU), status=status, horizon_ned_m=here.copy(), route_ned_m=here[:, :2].copy()
        )

    def _route_ahead(self, nav: NavState) -> FloatArray:
        route = self._route
        here = np.array(nav.pos_ned_m[:2], dtype=float)
        return here[None] if route is None or self.unreachable else route.ahead(here, self._s)


def _speed_cap(params: ParamSet) -> float:
    return max(0.05, params["SPD_PLANAR_MAX"] - params["MPC_SPEED_MARGIN"])


def _weights(params: ParamSet) -> FloatArray:
    q = params["MPC_Q_POS"]
    return np.array([q, q, params["MPC_Q_Z"], params["MPC_Q_YAW"], *VELOCITY_WEIGHTS, *[params["MPC_R_THRUST"]] * NU])
