"""One control step: bounds, half-planes, currents and terminal cost around the plan, and its QPs.

In steady flight one QP around the shifted plan is enough. After a start or a change of the plan, QPs are repeated
until the thrust to be commanded has converged: one QP is up to 10 N off there. Full Gauss-Newton steps need not
converge (the speed limit is linearised, half-planes change with the guess) but may cycle between two or four plans;
steps that do not decrease are halved, which ends the cycle.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from autopilot.control.bounds import SLOWEST_CAP_M_S, PlanClearance, ProgramBounds, largest_gap, left_n
from autopilot.control.constraints.obstacles import Movers
from autopilot.control.nmpc import ocp
from autopilot.control.nmpc.grid import TimeGrid
from autopilot.control.nmpc.solver import Nmpc, NmpcProblem, NmpcResult
from autopilot.control.nmpc.unsolved import saved
from autopilot.control.path.guidance import GuidanceInputs, Reference, Weights
from autopilot.control.path.planner import Planner
from autopilot.control.path.reference import unknown_speed_m_s
from autopilot.control.robust.margins import Margins
from autopilot.control.robust.regions import TerminalRegions
from autopilot.control.robust.robust_tuning import TUBE
from autopilot.control.robust.terminal import TerminalLimits
from autopilot.core.background import BackgroundWorker
from autopilot.core.control_allocator import ControlAllocator
from autopilot.core.frames import FloatArray
from autopilot.core.messages import SolveStatus, UnsolvedProgram
from autopilot.core.model4 import AXES, YAW, R, U
from autopilot.core.params import ParamSet

CONVERGED_N = 0.05
"""A plan has converged when a QP changes the thrust to be commanded by less than this."""

RESTLESS_N = 1.0
"""In flight, a QP that changes it by more is followed by others: those that change it by less are off by 0.1 N, one in
a hundred by 0.3 N."""

MOST_QPS = 15
"""In one step. Nine of ten starts need 8."""

MOST_UNSOLVED = 3
"""Programs of one step that are kept when they are not solved: one from each guess."""

FULL_STEPS = 3
SHRINKING = 0.7
SHORTEST_STEP = 0.25
"""After so many full steps, a step whose change is more than this share of the last one's is halved, down to this.
While the thrust changes in one direction it grows again, until that fails: one that stayed at a quarter would come
nearer by a quarter only."""

STANDS_AFTER_S = 1.0
"""Time constant with which the motion fades in the last of the guesses."""

CHANGE_STEP_S = 0.05
"""Interval between steps for which MPC_R_CHANGE holds; the longer it is, the less the last plan counts."""

DAMPING_GROWS = 4.0
DAMPING_FADES = 0.97
MOST_DAMPING = 256.0
"""Factors of MPC_R_CHANGE after a step whose iteration has not converged and after another one, and their largest
product."""

PLAUSIBLE = 4.0
"""m/s, rad/s: no vehicle that this controller is for moves or turns faster."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Solution:
    result: NmpcResult
    """Of the last QP."""
    margin_m: float
    """Smallest clearance of the plan beyond the required one."""
    qps: int
    """That were solved."""
    anew: bool
    """The plan does not continue the last one."""
    unsolved: tuple[UnsolvedProgram, ...] = ()
    """Unsolved QPs of this step."""


class StepProgram:
    """Keeps the optimiser with its plan, the margins, the terminal regions and the arrays of the program."""

    def __init__(
        self,
        allocator: ControlAllocator,
        grid: TimeGrid,
        radius_m: float,
        backends: tuple[ocp.QpBackend, ...],
        certificates: BackgroundWorker,
        thrusters: tuple[str, ...],
        lag_s: float,
    ) -> None:
        """``thrusters``: their names; ``lag_s``: their mean lag."""
        model, self._allocator, self._thrusters = allocator.model, allocator, thrusters
        self.nmpc = Nmpc(model, grid, backends=backends)
        self.margins = Margins(model, grid, lag_s)
        self.regions = TerminalRegions(allocator, certificates)
        self._bounds = bounds = ProgramBounds(grid, model.thrusters, radius_m)
        self.tube_m = bounds.tube_m
        """(N+1,) distance that every node of the last plan keeps from boundaries beyond the body."""
        self._radius_m = radius_m
        self._plane_n = np.zeros((grid.n - 1, self.nmpc.planes, 2))
        self._plane_d = np.zeros((grid.n - 1, self.nmpc.planes))
        self._path = self.nmpc.x[: grid.n, :2]
        self._t_s = grid.t_s[: grid.n]
        self._plan_clearance = PlanClearance(self._path[1:], self._plane_n, self._plane_d)
        self._weights = Weights(model.thrusters)
        self._currents = np.zeros((grid.n, 3))
        self._unsolved: list[tuple[SolveStatus, NmpcProblem, FloatArray, FloatArray]] = []
        self.speed_back_off_m_s, self._damping = 0.0, 1.0
        self._last_us = 0
        self._cleared: tuple[Planner, list[float], float] | None = None

    @property
    def keep_m(self) -> FloatArray:
        """(N,) distance of the last plan's nodes from every boundary, body radius included [m]."""
        return self._bounds.keep_m

    def reset(self) -> None:
        """Discard the state of previous steps."""
        self.speed_back_off_m_s, self._damping = 0.0, 1.0
        self.margins.restart()
        self.regions.reset()

    def speed_cap_m_s(self, params: ParamSet, least_m_s: float) -> float:
        """Largest planar speed for guidance: the limit minus the last step's back-off, at least ``least_m_s``, in steps
        of 1 cm/s."""
        back_off = math.ceil(100.0 * self.speed_back_off_m_s - 1e-6) / 100.0
        if self.margins.speed_margin_m_s is None:
            back_off = max(unknown_speed_m_s(params), back_off)
        return max(SLOWEST_CAP_M_S, params["SPD_PLANAR_MAX"] - back_off, math.floor(100.0 * least_m_s) / 100.0)

    def begin(self, now: GuidanceInputs, reference: Reference) -> None:
        """Begin from the reference with its thrust, as far as the thrusters can."""
        limit = now.thrust_limit_n
        self.nmpc.set_plan(reference.x, np.clip(reference.thrust_n, -limit, limit))

    def solve(self, start: bool, now: GuidanceInputs, reference: Reference, movers: Movers | None) -> Solution:
        """QPs from the plan in ``nmpc``: one, or at a ``start`` as many as it takes.

        ``movers`` are the obstacles that move along the prediction.
        """
        nmpc, bounds = self.nmpc, self._bounds
        now.forecast.fill(now.nav, nmpc.x[: nmpc.grid.n, :3], self._t_s, self._currents)
        self.margins.update(now.nav, now.params)
        back_off = self.margins.back_offs(now.nav, nmpc.x, nmpc.u, now.params)
        if self.margins.speed_margin_m_s is not None:
            planar = np.full_like(back_off.planar_speed_m_s, self.margins.speed_margin_m_s)
            back_off = replace(back_off, planar_speed_m_s=planar)
        faster_rad_s = self.margins.yaw_rate.back_off_rad_s(nmpc.x.item(1, R))
        if faster_rad_s > 0.0:
            yaw_rate = back_off.yaw_rate_rad_s + faster_rad_s
            most = TUBE.largest_fraction * now.params["SPD_YAW_MAX"]
            back_off = replace(back_off, yaw_rate_rad_s=np.minimum(yaw_rate, most))
        if now.least_cap_m_s:
            most = now.params["SPD_PLANAR_MAX"] - now.least_cap_m_s
            back_off = replace(back_off, planar_speed_m_s=np.minimum(back_off.planar_speed_m_s, most))
        bounds.fill(back_off, now, reference, nmpc.u, self._change_weight(start, now))
        self.speed_back_off_m_s = float(back_off.planar_speed_m_s[-1])
        terminal = self._terminal(now, reference)

        def problem(thrust_ref_n: FloatArray, weight_u: FloatArray) -> NmpcProblem:
            return NmpcProblem(
                x0=now.x0,
                x_ref=reference.x,
                thrust_ref_n=thrust_ref_n,
                current_ned_m_s=self._currents,
                weight_x=reference.weight_x,
                weight_u=weight_u,
                terminal=terminal,
                limits=bounds.limits,
                thrust_limit_n=bounds.thrust_n,
                plane_n=self._plane_n,
                plane_d_m=self._plane_d,
                buoyancy_excess_n=np.array([self._allocator.buoyancy_excess_n]),
            )

        states, thrusts = nmpc.x.copy(), nmpc.u.copy()
        self._unsolved.clear()
        free = reference.thrust_n, reference.weight_u
        # In flight, changes of the last plan's thrust are penalised as well.
        begun = problem(*free) if start else problem(bounds.held_ref_n, bounds.held_weight)
        found = self._iterate(start, begun, now.planner, movers)
        # Around a guess that has run away no step is any good: once more from the reference, then from standing still.
        for again in (self.begin,) * (not start) + (self._stand,):
            if found.result.status is SolveStatus.OK and self._plausible():
                break
            again(now, reference)
            found = self._iterate(True, problem(*free), now.planner, movers, found.qps)
        if found.result.status is not SolveStatus.OK:
            nmpc.set_plan(states, thrusts)
        self._damp(now, found.qps)
        if not self._unsolved:
            return found
        return replace(found, unsolved=tuple(saved(now.t_us, nmpc, *one) for one in self._unsolved))

    def _stand(self, now: GuidanceInputs, _: Reference) -> None:
        """Begin from the place where the vehicle is; its motion fades."""
        x = np.tile(now.x0, (self.nmpc.grid.n + 1, 1))
        x[:, U:] *= np.exp(-self.nmpc.grid.t_s / STANDS_AFTER_S)[:, None]
        self.nmpc.set_plan(x, np.zeros_like(self.nmpc.u))

    def _iterate(
        self,
        start: bool,
        problem: NmpcProblem,
        planner: Planner,
        movers: Movers | None,
        before: int = 0,
    ) -> Solution:
        """QPs around the plan, each with the half-planes of the one before, until the first thrust stands still.
        ``before``: QPs that have been solved in vain."""
        nmpc, keep_m = self.nmpc, self._bounds.keep_m
        path, t_s, fraction, last_n = self._path, self._t_s, 1.0, math.inf
        last, grown, may_grow = np.zeros(nmpc.model.thrusters), False, True
        good: tuple[FloatArray, FloatArray, NmpcResult, float] | None = None
        for qps in range(1, MOST_QPS + 1):
            nmpc.x[0] = problem.x0
            guess, thrust = nmpc.x.copy(), nmpc.u.copy()
            margin = planner.features.half_planes(path, t_s, keep_m, nmpc.planes, self._plane_n, self._plane_d, movers)
            result = nmpc.solve(problem)
            if result.status is not SolveStatus.OK and len(self._unsolved) < MOST_UNSOLVED:
                planes = {"plane_n": self._plane_n.copy(), "plane_d_m": self._plane_d.copy()}
                self._unsolved.append((result.status, replace(problem, **planes), guess, thrust))
            change = nmpc.u[0] - thrust[0]
            change_n = max(map(abs, change.tolist()))
            calm = change_n < CONVERGED_N or (qps == 1 and not start and change_n < RESTLESS_N)
            if result.status is not SolveStatus.OK and good is not None and not start:
                # The previous QP's solution is a valid plan, although it has not converged.
                nmpc.set_plan(*good[:2])
                result, margin = good[2:]
                break
            if result.status is not SolveStatus.OK or calm or qps == MOST_QPS:
                break
            good = (nmpc.x.copy(), nmpc.u.copy(), result, margin)
            if fraction < 1.0 and may_grow and float(change @ last) > 0.0:
                fraction, grown = 2.0 * fraction, True
            elif qps > FULL_STEPS and change_n > SHRINKING * last_n:
                fraction, may_grow = max(0.5 * fraction, SHORTEST_STEP), not grown
            if fraction < 1.0:
                nmpc.set_plan(guess + fraction * (nmpc.x - guess), thrust + fraction * (nmpc.u - thrust))
            last, last_n = change, change_n
        if result.status is SolveStatus.OK:
            # The half-planes certify the new plan, chords included; otherwise its clearance is recomputed.
            margin = min(margin, self._plan_clearance.least_m())
            if margin < 0.0:
                margin = planner.features.margin_m(path, t_s, keep_m, movers)
        return Solution(result=result, margin_m=margin, qps=before + qps, anew=start)

    def _damp(self, now: GuidanceInputs, qps: int) -> None:
        """In a strong stream, where thrust and limits saturate, iterations that do not converge raise the weight on the
        change of thrust (Levenberg-Marquardt) for the next steps."""
        grown = self._damping * (DAMPING_GROWS if qps >= MOST_QPS else DAMPING_FADES)
        self._damping = min(max(grown, 1.0), MOST_DAMPING) if now.least_cap_m_s else 1.0

    def _change_weight(self, start: bool, now: GuidanceInputs) -> float:
        """Weight on the change of thrust relative to the last plan."""
        if start:
            return 0.0
        elapsed_s, self._last_us = (now.t_us - self._last_us) * 1e-6, now.t_us
        return self._damping * now.params["MPC_R_CHANGE"] * min(1.0, CHANGE_STEP_S / max(elapsed_s, 1e-3))

    def _terminal(self, now: GuidanceInputs, reference: Reference) -> FloatArray:
        """Terminal Hessian (8, 8): the goal's own if the reference ends there, else guidance's."""
        goal, params, regions = now.goal, now.params, self.regions
        if goal.drive is not None:
            return reference.terminal
        place = goal.pos_ned_m[:2].tolist()
        if self._cleared is None or self._cleared[0] is not now.planner or self._cleared[1] != place:
            free_m = float(now.planner.features.clearance_m(np.array([place]))[0])
            self._cleared = (now.planner, place, free_m - self._radius_m - params["MPC_MARGIN"])
        weights, free = self._weights.update(params), not int(params["MPC_COST"])

        def limits() -> TerminalLimits:
            back_off = self.margins.settled(now.nav, params)
            return TerminalLimits(
                thrust_n=left_n(now.thrust_limit_n, back_off.thrust_n[-1]),
                planar_speed_m_s=params["SPD_PLANAR_MAX"] - float(back_off.planar_speed_m_s[-1]),
                heave_m_s=params["SPD_HEAVE_MAX"] - float(back_off.heave_m_s[-1]),
                yaw_rate_rad_s=params["SPD_YAW_MAX"] - float(back_off.yaw_rate_rad_s[-1]),
                depth_min_m=max(now.fence.depth_min_m, params["DEPTH_MIN"]) + float(back_off.depth_m[-1]),
                depth_max_m=min(now.fence.depth_max_m, params["DEPTH_MAX"]) - float(back_off.depth_m[-1]),
                clearance_m=clearance_m,
                thrusters=self._thrusters,
            )

        clearance_m, end = self._cleared[2], reference.x[-1]
        away_m = math.hypot(float(now.x0[0]) - place[0], float(now.x0[1]) - place[1])
        arguments = goal, float(end[YAW]), now.nav.current_ned_m_s, clearance_m, limits, weights.x, weights.u, away_m
        regions.follow(*arguments, sampled=free)
        cost = regions.cost_at(end, goal) if free else None
        return reference.terminal if cost is None else cost

    def _plausible(self) -> bool:
        """Whether the plan moves as a vehicle can: a step of the iteration may run away with an unstable plant."""
        return largest_gap(self.nmpc.x, None, U, AXES) < PLAUSIBLE
