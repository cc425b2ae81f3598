"""The motion controller: guidance, constraints and optimiser behind one ``step``, with its fallbacks."""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from autopilot.control.bounds import largest_gap
from autopilot.control.constraints.obstacles import Movers, fence_key
from autopilot.control.constraints.tracks import Obstructions
from autopilot.control.current.buoyancy import BuoyancyEstimator
from autopilot.control.current.currents import CurrentForecast, EstimatedCurrent
from autopilot.control.energy.energy_guidance import EnergyGuidance
from autopilot.control.energy.power import PowerModel
from autopilot.control.energy.request import TrajectoryPlanner
from autopilot.control.energy.search import EnergyPlanner
from autopilot.control.nmpc import ocp
from autopilot.control.nmpc.grid import TimeGrid, geometric_grid
from autopilot.control.nmpc.lag import ThrusterLag
from autopilot.control.nmpc.reversal import Reversals
from autopilot.control.nmpc.solver import NmpcResult
from autopilot.control.path import shortest
from autopilot.control.path.drive import DriveGuidance
from autopilot.control.path.guidance import Guidance, GuidanceInputs, Reference, RouteGuidance
from autopilot.control.path.planner import Planner
from autopilot.control.path.strong_stream import StrongStream
from autopilot.control.path.workers import BackgroundWorkers
from autopilot.control.protocol import STEP_S, Controller, ControllerContext, simple_output
from autopilot.control.robust.fallback import FallbackWatch, FiniteWatch
from autopilot.control.robust.inner import InnerLoop, plan_error
from autopilot.control.robust.margins import Tighten
from autopilot.control.robust.penalty import PenaltyWatch
from autopilot.control.robust.robust_tuning import WATER_SPEED
from autopilot.control.robust.station import StationKeeper
from autopilot.control.step_program import Solution, StepProgram
from autopilot.control.thrust.slew import SlewWindow, slewed
from autopilot.core import operator_messages as notices
from autopilot.core.control_allocator import ControlAllocator, lacking_thrust
from autopilot.core.errors import ConfigError
from autopilot.core.frames import FloatArray, unwrap_near
from autopilot.core.geometry import Fence
from autopilot.core.messages import (
    ControlOutput,
    Fallback,
    Goal,
    NavHealth,
    NavState,
    NmpcStatus,
    Severity,
    SolveStatus,
)
from autopilot.core.model4 import NO_STATE, YAW, U, X
from autopilot.core.params import ParamSet
from autopilot.core.response import Response
from autopilot.core.samples import ObstacleTrack
from autopilot.core.vehicle import Vehicle

LONGEST_SHIFT_S = 1.0
"""A plan older than this is not continued."""

JUMP_M = 0.5
"""A reference that moves by so much between two steps has nothing to do with the last one."""

WORSE_M = 0.05
"""A new plan that breaks a bound by so much more than the last one is not taken."""

LOST_SHARE = 0.8
"""A thrust limit that falls below this share of itself from one step to the next is a loss: supplies sag slowly."""

BLIND_WAY_M = 0.15
"""Way over ground that guidance asks for within the delay of late commands."""


class MotionController:
    """Guidance and NMPC. Called every 50 ms (any other interval works). One instance per vehicle; :meth:`step` is
    deterministic.

    The parameter MPC_COST chooses between the guidances. The horizon is a geometric grid of ``n`` intervals over
    ``horizon_s``, or any other ``grid``. ``desks`` are background workers for routes, minimum-energy trajectories (by
    ``trajectories``) and certificates. ``cpu_clock`` measures the cost of a step (for reports only). The current
    estimate is constant over the horizon: it also contains unmodelled forces (drag, tether), which do not fade with
    distance; a faded current would give every goal an offset, and the part beyond the first seconds is replanned
    before it is flown.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        *,
        n: int = 20,
        horizon_s: float = 8.0,
        grid: TimeGrid | None = None,
        currents: CurrentForecast | None = None,
        desks: BackgroundWorkers | None = None,
        trajectories: TrajectoryPlanner | None = None,
        cpu_clock: Callable[[], float] = time.thread_time,
        backends: tuple[ocp.QpBackend, ...] = ocp.BACKENDS,
    ) -> None:
        self._vehicle = vehicle
        self._model = vehicle.to_model()
        self._cpu_clock = cpu_clock
        grid = grid or geometric_grid(n, horizon_s)
        self.desks = desks = desks or BackgroundWorkers()
        """Whoever owns the loop closes them, and says what is attended to while an answer is waited for."""
        self._allocator = allocator = ControlAllocator.of(vehicle)
        response = Response.of(vehicle.thrusters)
        self._most_n = np.array([thruster.limit_n for thruster in vehicle.thrusters])
        lacking = lacking_thrust(self._model, self._most_n)
        if lacking:
            raise ConfigError(f"vehicle {vehicle.name}: {lacking}")
        self._program = StepProgram(
            allocator,
            grid,
            vehicle.radius_m,
            backends,
            desks.certificates,
            tuple(each.name for each in vehicle.thrusters),
            response.mean_s,
        )
        self.nmpc, self.margins, self.regions = self._program.nmpc, self._program.margins, self._program.regions
        self._solver_news: list[tuple[Severity, str]] = [notices.SOLVER(name=self.solver)]
        if self.nmpc.slower:
            self._solver_news.insert(0, notices.SLOWER_SOLVER(name=self.nmpc.solver))
        self._lag = ThrusterLag(self._model, response)
        self._lift = BuoyancyEstimator(self._model, vehicle.hull_half_height_m)
        self._forecast = currents or EstimatedCurrent()
        self._inner = InnerLoop(self.margins.ancillary, grid)
        self._station = StationKeeper(allocator)
        self._stream = StrongStream(allocator, vehicle.radius_m)
        self._reversals, self._window = Reversals(self._most_n), SlewWindow(STEP_S)
        self._penalty = PenaltyWatch()
        self._fallbacks, self._numbers = FallbackWatch(), FiniteWatch()
        self._nominal_t_s = response.mean_s + grid.t_s
        self._plan_current = np.zeros(3)
        self.trajectories = trajectories = trajectories or EnergyPlanner(self._model, PowerModel.of(vehicle))
        """Makes plans of least energy."""
        route = RouteGuidance(allocator, grid, desks.routes)
        energy = EnergyGuidance(allocator, grid, desks.trajectories, trajectories, route)
        self._guidances: tuple[Guidance, ...] = (route, energy)
        self._drive = DriveGuidance(allocator, grid)
        self._guidance: Guidance = self._guidances[0]
        self._planner: Planner | None = None
        self._planner_key: tuple[object, ...] = ()
        self._fence: Fence | None = None
        self._forecast_fence: Fence | None = None
        self._obstructions = Obstructions()
        self._movers: Movers | None = None
        self.situation: GuidanceInputs | None = None
        """Of the last step that had a plan made, for a look at it afterwards."""
        self.reference: Reference | None = None
        """The same."""
        self.reset()

    @property
    def unreachable(self) -> bool:
        """True while the planner finds no path to the goal; the vehicle keeps its position."""
        return self._guidance.unreachable

    @property
    def shortfall(self) -> str:
        """See :attr:`autopilot.control.protocol.Controller.shortfall`."""
        return self._stream.shortfall

    def warm(self, params: ParamSet) -> None:
        """Import and build in the background what the first steps need; otherwise they would be a second late."""
        routes, trajectories = self.desks.routes, self.desks.trajectories
        if not routes.blocking:
            routes.submit(0, lambda _, __: shortest.warm(), None)
        if not trajectories.blocking and int(params["MPC_COST"]):
            trajectories.submit(0, lambda planner, _: planner.warm(), self.trajectories)

    def reset(self) -> None:
        """Forget the plan (after disarming, before a new start)."""
        self._last_us: int | None = None
        self._followed_us: int | None = None
        self._yaw_rad: float | None = None
        self._reset_count = -1
        self._plan_age_s: float | None = None
        self._planned: FloatArray | None = None
        self._command = np.zeros(self._model.thrusters)
        self._stepped: FloatArray | None = None
        self._reference: FloatArray | None = None
        self._limit_n = np.zeros(self._model.thrusters)
        self._penalty.reset()
        self._fallbacks.reset()
        self._lag.reset()
        self._lift.reset()
        self._inner.stop()
        self._station.release()
        self._stream.reset()
        self._reversals.reset()
        self._window.clear()
        self._program.reset()
        self._guidance.reset()
        self._obstructions.reset()

    def step(
        self,
        t_us: int,
        nav: NavState,
        goal: Goal,
        fence: Fence,
        params: ParamSet,
        thruster_limit_n: FloatArray | None = None,
        tracks: Sequence[ObstacleTrack] = (),
        *,
        delay_s: float | None = 0.0,
    ) -> ControlOutput:
        """See :meth:`autopilot.control.protocol.Controller.step`. ValueError: a limit below 0 or NaN.

        ``delay_s`` None: no thrust.
        """
        began = self._cpu_clock()
        limit_n = np.minimum(self._most_n, params["THR_LIMIT"])
        if thruster_limit_n is not None:
            limit_n = np.minimum(limit_n, thruster_limit_n)
            if not limit_n.min() >= 0.0:
                raise ValueError(f"thruster_limit_n has to be 0 or more: {limit_n.tolist()}")
        elapsed_s = 0.0 if self._last_us is None else (t_us - self._last_us) * 1e-6
        if delay_s or bool((limit_n < LOST_SHARE * self._limit_n).any()):
            # What a thruster with a loss or a late command gives is not the drag's.
            self.margins.water_speed.reset()
        self._last_us, self._limit_n = t_us, limit_n
        self._follow_lag(t_us)
        body, nav = nav, self._forecast.view(nav).in_level_frame()
        if math.dist(body.vel_frd_m_s[:2], nav.vel_frd_m_s[:2]) > WATER_SPEED.aslant_m_s:
            self.margins.water_speed.reset()
        x, current = self._state(nav), nav.current_ned_m_s
        if nav.health is NavHealth.INVALID or delay_s is None:
            return self._neutral(t_us, nav, began)
        if not _all_finite(x, current):
            return self._void(t_us, nav, began)
        self._trim(nav, fence, params, limit_n)
        if delay_s:
            goal = replace(goal, speed_m_s=min(goal.speed_m_s, BLIND_WAY_M / delay_s))
        self._lag.act_late(delay_s)
        # A leg of least energy is flown at the limits, and with late commands the limits are not kept that closely.
        to_place = self._guidances[0 if delay_s else int(params["MPC_COST"])]
        guidance: Guidance = to_place if goal.drive is None else self._drive
        if nav.reset_count != self._reset_count or guidance is not self._guidance:
            self._reset_count, self._guidance = nav.reset_count, guidance
            guidance.reset()
            self._lag.jumped()
        if fence is not self._forecast_fence:
            self._forecast_fence = fence
            self._forecast.within(fence)
        x0 = self._lag.ahead(x, current)
        # The model's drag grows with the square of the speed: a finite state may be none one lag later.
        if not _all_finite(x0):
            return self._void(t_us, nav, began)
        self._numbers.watch(True)
        radius_m = self._vehicle.radius_m + self.margins.clearance_m(params)
        fence, self._movers = self._obstructions.go_round(
            t_us, fence, tracks, nav, goal, radius_m, self._guidance.ahead
        )
        planner = self._planner_for(fence, radius_m)
        self._stream.update(nav, x0, goal, planner, params, limit_n)
        now = GuidanceInputs(
            t_us=t_us,
            x0=x0,
            nav=nav,
            goal=goal,
            params=params,
            fence=fence,
            planner=planner,
            radius_m=radius_m,
            forecast=self._forecast,
            speed_cap_m_s=self._program.speed_cap_m_s(params, self._stream.cap_m_s),
            thrust_limit_n=limit_n,
            last_plan=self.nmpc.x if self._plan_age_s == 0.0 else None,
            bow_rad=self._stream.bow_rad,
            least_cap_m_s=self._stream.cap_m_s,
        )
        reference = self._guidance.reference(now)
        self.situation, self.reference = now, reference
        found = self._solve(now, reference, elapsed_s)
        result = found.result
        thrust, fallback = self._choose(result, now, now.x0 if delay_s else x, limit_n, elapsed_s)
        thrust = self._window.limited(t_us, self._reversals.worth(thrust), limit_n)
        self._command = self._stepped = thrust
        self._fallbacks.watch(fallback)
        self._penalty.watch(result.penalty_use if result.status is SolveStatus.OK else 0.0)
        return ControlOutput(
            thrust_n=thrust,
            status=NmpcStatus(
                t_us=t_us,
                status=result.status,
                fallback=fallback,
                iterations=found.qps,
                solve_s=self._cpu_clock() - began,
                cost=result.cost if math.isfinite(result.cost) else 0.0,
                slack_max=result.slack_max if math.isfinite(result.slack_max) else 0.0,
                margin_m=found.margin_m,
                tube_m=max(self._program.tube_m.tolist()),
                penalty_use=result.penalty_use if math.isfinite(result.penalty_use) else 0.0,
                lift_n=self._lift.lift_n,
                speed_margin_m_s=self._program.speed_back_off_m_s,
                drag_excess=self.margins.water_speed.excess,
                drag_excess_sigma=self.margins.water_speed.excess_sigma,
            ),
            horizon_ned_m=self.nmpc.x[:, :3].copy(),
            route_ned_m=self._guidance.ahead(np.array(nav.pos_ned_m[:2], dtype=float)),
            nominal=self.nmpc.x.copy(),
            nominal_t_s=self._nominal_t_s + delay_s,
            tube_m=self._program.tube_m.copy(),
            plan=reference.plan,
            restarted=found.anew,
            unsolved=found.unsolved,
        )

    def tick(self, t_us: int, nav: NavState) -> FloatArray | None:
        """Thrust (n,) between two steps: the last plan with the ancillary feedback. None = keep the last command (no
        plan, no estimate, or margins without feedback); zero thrust for a state that is not finite.
        """
        self._follow_lag(t_us)
        if not self._inner.active or nav.health is NavHealth.INVALID or nav.reset_count != self._reset_count:
            return None
        nav = self._forecast.view(nav).in_level_frame()
        x, current = self._state(nav), nav.current_ned_m_s
        x0 = self._lag.ahead(x, current) if _all_finite(x, current) else None
        finite = x0 is not None and _all_finite(x0)
        self._numbers.watch(finite)
        if x0 is None or not finite:
            self._command = np.zeros(self._model.thrusters)
            self._window.clear()
            return self._command
        thrust = self._inner.thrust(t_us, x0, current, self._limit_n)
        self._command = self._window.limited(t_us, self._reversals.worth(thrust, between=True), self._limit_n)
        return self._command

    def planar_speed_m_s(self, nav: NavState, params: ParamSet) -> float:
        """Planar speed limit minus its back-off, with this estimate, or what is made in a strong stream [m/s]."""
        return self._stream.can_m_s or self.margins.planar_speed_m_s(nav, params)

    def goal_margin_m(self, params: ParamSet) -> float:
        """See :meth:`autopilot.control.robust.margins.Margins.goal_margin_m`."""
        return self.margins.goal_margin_m(params)

    def refusals(
        self, nav: NavState, goals: Sequence[tuple[str, float]], fence_half_m: float, params: ParamSet
    ) -> tuple[str, ...]:
        """See :meth:`autopilot.control.robust.margins.Margins.refusals`; goals are judged with the plan, by
        :meth:`goal_margin_m`.
        """
        return self.margins.refusals(nav, fence_half_m, params)

    def take_news(self) -> list[tuple[Severity, str]]:
        """Severity and text of notices to the operator since the last call."""
        first, self._solver_news = self._solver_news, []
        for part in (
            self._lift,
            self.margins,
            self.regions,
            self._penalty,
            self._fallbacks,
            self._numbers,
            self._guidance,
        ):
            first += part.take_notices()
        return first

    @property
    def keep_m(self) -> FloatArray:
        """(N,) distance of the last plan's nodes from every boundary, body radius included [m]."""
        return self._program.keep_m.copy()

    @property
    def solver(self) -> str:
        """Which one makes the plans, and why no quicker one."""
        slower = f" ({self.nmpc.slower})" if self.nmpc.slower else ""
        return self.nmpc.solver + slower

    def _follow_lag(self, t_us: int) -> None:
        elapsed_s = 0.0 if self._followed_us is None else (t_us - self._followed_us) * 1e-6
        self._followed_us = t_us
        self._lag.follow(self._command, elapsed_s)
        self._lift.push(self._lag.acting_n, elapsed_s)
        self.margins.water_speed.push(self._lag.acting_n, elapsed_s)
        self.margins.yaw_rate.push(self._lag.acting_n, elapsed_s)

    def _trim(self, nav: NavState, fence: Fence, params: ParamSet, limit_n: FloatArray) -> None:
        """Update the estimated vertical disturbance, which all plans and holds use."""
        low_m, high_m = max(fence.depth_min_m, params["DEPTH_MIN"]), min(fence.depth_max_m, params["DEPTH_MAX"])
        self._lift.update(nav, low_m, high_m, limit_n)
        self._allocator.buoyancy_excess_n = self._lift.excess_n
        self._lag.trim(self._lift.excess_n)

    def _state(self, nav: NavState) -> FloatArray:
        x = nav.model4_state()
        yaw = x.item(YAW)
        if abs(yaw) < NO_STATE:
            x[YAW] = self._yaw_rad = yaw if self._yaw_rad is None else unwrap_near(yaw, self._yaw_rad)
        return x

    def _planner_for(self, fence: Fence, radius: float) -> Planner:
        """The planner of this fence; another one when fence or margin have changed."""
        planner = self._planner
        if planner is not None and fence is self._fence and self._planner_key[0] == radius:
            return planner
        key = (radius, *fence_key(fence))
        if planner is None or key != self._planner_key:
            planner = Planner(fence, radius)
            self._planner, self._planner_key = planner, key
        self._fence = fence
        return planner

    def _solve(self, now: GuidanceInputs, reference: Reference, elapsed_s: float) -> Solution:
        """The last plan moved on and improved; or a new one from the reference, unless that breaks bounds that the
        last one keeps: in a stream that it cannot hold against, a vehicle does not come to the other side of what is
        in its lee.
        """
        meant, self._reference = self._reference, reference.x
        moved_on = self._moved_on(now, elapsed_s)
        # A Gauss-Newton step cannot move a plan to the other side of an obstacle: restart from the reference.
        jumped = meant is not None and largest_gap(reference.x, meant, X, 2) > JUMP_M
        if moved_on and not reference.fresh and not jumped:
            return self._program.solve(False, now, reference, self._movers)
        kept = (self.nmpc.x.copy(), self.nmpc.u.copy()) if moved_on else None
        kept_from, self._plan_age_s, self._planned = self._planned, None, None
        self._program.begin(now, reference)
        found = self._program.solve(True, now, reference, self._movers)
        if kept is None or found.result.slack_max <= WORSE_M:
            return found
        anew = self.nmpc.x.copy(), self.nmpc.u.copy()
        self.nmpc.set_plan(*kept)
        other = self._program.solve(False, now, reference, self._movers)
        if other.result.status is SolveStatus.OK and other.result.slack_max < found.result.slack_max - WORSE_M:
            self._reference, self._planned = meant, kept_from
            return other
        self.nmpc.set_plan(*anew)
        return self._program.solve(True, now, reference, self._movers)

    def _moved_on(self, now: GuidanceInputs, elapsed_s: float) -> bool:
        """Move the last plan on; False = there is none that can be."""
        if self._plan_age_s is None or not 0.0 <= elapsed_s <= LONGEST_SHIFT_S:
            return False
        self.nmpc.shift(elapsed_s)
        turn = 2.0 * math.pi * round((now.x0[YAW] - self.nmpc.x[0, YAW]) / (2.0 * math.pi))
        if turn:
            self.nmpc.x[:, YAW] += turn
        self._planned = self.nmpc.x[0].copy()
        return True

    def _choose(
        self, result: NmpcResult, now: GuidanceInputs, x: FloatArray, limit_n: FloatArray, elapsed_s: float
    ) -> tuple[FloatArray, Fallback]:
        """The fallback chain: new plan, rest of the last plan with feedback, station keeping where that ended."""
        current = now.nav.current_ned_m_s
        if result.status is SolveStatus.OK:
            self._plan_age_s = 0.0
            self._plan_current = current
            self._station.release()
            self.nmpc.u[0] = self._slewed(result.thrust_n[0], limit_n, elapsed_s)
            if Tighten(int(now.params["MPC_TIGHTEN"])) is Tighten.TUBE:
                self._inner.start(now.t_us, self.nmpc.x, self.nmpc.u, current)
            else:
                self._inner.stop()
            return self.nmpc.u[0].copy(), Fallback.NONE
        if self._plan_age_s is not None and self._planned is not None and self._station.target is None:
            self._plan_age_s += elapsed_s
            if self._plan_age_s < self.nmpc.grid.t_s[-1]:
                planned = self.nmpc.x[0] = self._planned
                error = plan_error(now.x0, planned, current, self._plan_current)
                thrust = self.nmpc.u[0] + self.margins.ancillary.gain(float(planned[U])) @ error
                return self._slewed(thrust, limit_n, elapsed_s), Fallback.SHIFTED_PLAN
        self._plan_age_s = None
        self._inner.stop()
        return self._slewed(self._station.thrust(x, current, limit_n), limit_n, elapsed_s), Fallback.STATION_KEEPING

    def _slewed(self, thrust_n: FloatArray, limit_n: FloatArray, elapsed_s: float) -> FloatArray:
        """Thrust (n,) within the limits (n,) and no farther from the last step's command than it may change."""
        return slewed(thrust_n, thrust_n if self._stepped is None else self._stepped, limit_n, elapsed_s)

    def _void(self, t_us: int, nav: NavState, began: float) -> ControlOutput:
        """The state or its prediction is not finite: zero thrust, nothing is stored."""
        self._numbers.watch(False)
        self._lag.jumped()
        return self._neutral(t_us, nav, began)

    def _neutral(self, t_us: int, nav: NavState, began: float) -> ControlOutput:
        """Without an estimate there is nothing to control: no thrust, and the plan is void."""
        self._command = np.zeros(self._model.thrusters)
        self._lift.forget()
        self._plan_age_s = self._yaw_rad = self._stepped = None
        self._inner.stop()
        self._station.release()
        self._reversals.reset()
        self._window.clear()
        self._guidance.reset()
        output, solve_s = simple_output(t_us, nav, np.zeros(self._model.thrusters)), self._cpu_clock() - began
        status = replace(output.status, status=SolveStatus.IDLE, fallback=Fallback.NEUTRAL, solve_s=solve_s)
        return replace(output, status=status)


def _all_finite(*arrays: FloatArray) -> bool:
    """Whether a state and a current are finite, and no larger than any of a vehicle."""
    return sum([sum(map(abs, array.tolist())) for array in arrays]) < NO_STATE


def of_context(context: ControllerContext) -> Controller:
    """The shipped controller by name ("nmpc")."""
    return MotionController(
        context.vehicle, currents=context.currents, desks=context.desks, trajectories=context.trajectories
    )
