"""The program of one control step: limits, half-planes, currents and terminal cost around the plan, and its QPs."""

import math

import numpy as np

from autopilot.control import ocp
from autopilot.control.grid import TimeGrid
from autopilot.control.guidance import VELOCITY_WEIGHTS, Reference, Situation
from autopilot.control.nmpc import Nmpc, NmpcProblem, NmpcResult
from autopilot.control.obstacles import FAR_M, Movers
from autopilot.control.planner import Planner
from autopilot.control.robust.margins import Margins
from autopilot.control.robust.regions import TerminalRegions
from autopilot.control.robust.terminal import TerminalLimits
from autopilot.control.robust.tube import LARGEST_THRUST_SHARE
from autopilot.control.tightening import BackOffs
from autopilot.core.desk import Desk
from autopilot.core.frames import FloatArray
from autopilot.core.messages import SolveStatus
from autopilot.core.model4 import NU, YAW, Model4, U, Z
from autopilot.core.params import ParamSet

BURST_QPS = 3
"""The step that makes a new route solves so many QPs: the plan starts from the reference and converges at once."""

PLAUSIBLE = 4.0
"""m/s, rad/s: no vehicle that this controller is for moves or turns faster."""

SLOWEST_CAP_M_S = 0.05
"""Margins do not lower the cap of the planar speed below this."""


class StepProgram:
    """Keeps the optimiser with its plan, the margins, the terminal regions and the arrays of the program."""

    def __init__(
        self, model: Model4, grid: TimeGrid, radius_m: float, backends: tuple[ocp.QpBackend, ...], certificates: Desk
    ) -> None:
        self.nmpc = Nmpc(model, grid, backends=backends)
        self.margins = Margins(model, grid)
        self.regions = TerminalRegions(model, certificates)
        self.tube_m: FloatArray = np.zeros(grid.n + 1)
        """(N+1,) distance that every node of the last plan keeps from boundaries beyond the body."""
        self._radius_m = radius_m
        self._plane_n = np.zeros((grid.n - 1, self.nmpc.planes, 2))
        self._plane_d = np.zeros((grid.n - 1, self.nmpc.planes))
        self._limits = np.zeros((grid.n - 1, ocp.N_LIMITS))
        self._currents = np.zeros((grid.n, 3))
        self._speed_back_off_m_s = 0.0
        self._cleared: tuple[Planner, FloatArray, float] | None = None

    def reset(self) -> None:
        """Forget what the last steps left behind."""
        self._speed_back_off_m_s = 0.0
        self.regions.reset()

    def speed_cap_m_s(self, params: ParamSet) -> float:
        """Planar speed that guidance may ask for: what the margins of the last step leave, in steps of 1 cm/s."""
        back_off = max(params["MPC_SPEED_MARGIN"], math.ceil(100.0 * self._speed_back_off_m_s - 1e-6) / 100.0)
        return max(SLOWEST_CAP_M_S, params["SPD_PLANAR_MAX"] - back_off)

    def solve(self, qps: int, now: Situation, reference: Reference, movers: Movers | None) -> tuple[NmpcResult, float]:
        """``qps`` QPs from the plan in ``nmpc``: result of the last, and the smallest clearance of the plan [m].

        ``movers`` are the obstacles that move along the prediction.
        """
        nmpc, n = self.nmpc, self.nmpc.grid.n
        now.forecast.fill(now.nav, nmpc.x[:n, :3], nmpc.grid.t_s[:n], self._currents)
        back_off = self.margins.back_offs(now.nav, nmpc.x, nmpc.u, now.params)
        self._fill_limits(back_off, now)
        self._speed_back_off_m_s = float(back_off.planar_speed_m_s[-1])
        self.tube_m[1:-1] = back_off.clearance_m
        self.tube_m[0], self.tube_m[-1] = back_off.clearance_m[0], back_off.clearance_m[-1]
        terminal = self._terminal(now, reference, back_off)
        problem = NmpcProblem(
            x0=now.x0,
            x_ref=reference.x,
            thrust_ref_n=reference.thrust_n,
            current_ned_m_s=self._currents,
            weight_x=reference.weight_x,
            weight_u=reference.weight_u,
            terminal=terminal,
            limits=self._limits,
            thrust_limit_n=_left(now.thrust_limit_n, back_off.thrust_n),
            plane_n=self._plane_n,
            plane_d_m=self._plane_d,
        )
        keep_m = self._radius_m + back_off.clearance_m
        states, thrusts = nmpc.x.copy(), nmpc.u.copy()
        result, margin = self._iterate(qps, problem, now.planner, keep_m, movers)
        if qps < BURST_QPS and not (result.status is SolveStatus.OK and _plausible(nmpc.x)):
            # Around a guess that has run away no step is any good: once more from the reference, and at once.
            nmpc.set_plan(reference.x, np.zeros_like(thrusts))
            result, margin = self._iterate(BURST_QPS, problem, now.planner, keep_m, movers)
            if result.status is not SolveStatus.OK:
                nmpc.set_plan(states, thrusts)
        return result, margin

    def _iterate(
        self, qps: int, problem: NmpcProblem, planner: Planner, keep_m: FloatArray, movers: Movers | None
    ) -> tuple[NmpcResult, float]:
        """QPs around the plan, each with the half-planes of the one before."""
        nmpc, n, margin = self.nmpc, self.nmpc.grid.n, FAR_M
        path, t_s = nmpc.x[:n, :2], nmpc.grid.t_s[:n]
        for _ in range(qps):
            nmpc.x[0] = problem.x0
            margin = planner.features.half_planes(path, t_s, keep_m, nmpc.planes, self._plane_n, self._plane_d, movers)
            result = nmpc.solve(problem)
            if result.status is not SolveStatus.OK:
                return result, margin
        # The half-planes certify the new plan, chords included; only where they do not it is looked at again.
        room = self._plane_n[..., 0] * path[1:, :1] + self._plane_n[..., 1] * path[1:, 1:] - self._plane_d
        margin = min(margin, float(room.min()))
        return result, margin if margin >= 0.0 else planner.features.margin_m(path, t_s, keep_m, movers)

    def _fill_limits(self, back_off: BackOffs, now: Situation) -> None:
        """Limits (N-1, 5) of the prediction."""
        limits, params, fence, depth_m = self._limits, now.params, now.fence, float(now.x0[Z])
        limits[:, 0] = np.maximum(params["SPD_PLANAR_MAX"] - back_off.planar_speed_m_s, SLOWEST_CAP_M_S)
        limits[:, 1] = np.maximum(params["SPD_HEAVE_MAX"] - back_off.heave_m_s, 0.0)
        limits[:, 2] = np.maximum(params["SPD_YAW_MAX"] - back_off.yaw_rate_rad_s, 0.0)
        limits[:, 3] = np.minimum(depth_m, max(fence.depth_min_m, params["DEPTH_MIN"]) + back_off.depth_m)
        limits[:, 4] = np.maximum(depth_m, min(fence.depth_max_m, params["DEPTH_MAX"]) - back_off.depth_m)

    def _terminal(self, now: Situation, reference: Reference, back_off: BackOffs) -> FloatArray:
        """Terminal Hessian (8, 8): the goal's own where the reference ends there, else what guidance gives."""
        goal, params = now.goal, now.params
        q = params["MPC_Q_POS"]
        place = goal.pos_ned_m[:2]
        if self._cleared is None or self._cleared[0] is not now.planner or not (self._cleared[1] == place).all():
            room = float(now.planner.features.clearance_m(place[None])[0])
            self._cleared = (now.planner, place.copy(), room - self._radius_m - params["MPC_MARGIN"])
        self.regions.follow(
            goal,
            float(reference.x[-1, YAW]),
            now.nav.current_ned_m_s,
            TerminalLimits(
                thrust_n=_left(now.thrust_limit_n, back_off.thrust_n[-1]),
                planar_speed_m_s=params["SPD_PLANAR_MAX"] - float(back_off.planar_speed_m_s[-1]),
                heave_m_s=params["SPD_HEAVE_MAX"] - float(back_off.heave_m_s[-1]),
                yaw_rate_rad_s=params["SPD_YAW_MAX"] - float(back_off.yaw_rate_rad_s[-1]),
                depth_min_m=max(now.fence.depth_min_m, params["DEPTH_MIN"]) + float(back_off.depth_m[-1]),
                depth_max_m=min(now.fence.depth_max_m, params["DEPTH_MAX"]) - float(back_off.depth_m[-1]),
                clearance_m=self._cleared[2],
            ),
            np.array([q, q, params["MPC_Q_Z"], params["MPC_Q_YAW"], *VELOCITY_WEIGHTS]),
            np.full(NU, params["MPC_R_THRUST"]),
        )
        cost = None if int(params["MPC_COST"]) else self.regions.cost_at(reference.x[-1], goal)
        return reference.terminal if cost is None else cost


def _plausible(x: FloatArray) -> bool:
    """Whether a plan (N+1, 8) moves as a vehicle can: a step of the iteration may run away with an unstable plant."""
    return float(np.abs(x[:, U:]).max()) < PLAUSIBLE


def _left(limit_n: FloatArray, back_off_n: FloatArray) -> FloatArray:
    """What the margins leave of thrust limits (4,)."""
    left: FloatArray = limit_n - np.minimum(back_off_n, LARGEST_THRUST_SHARE * limit_n)
    return left
