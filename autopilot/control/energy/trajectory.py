"""Minimum-energy trajectory from a state into a goal region: one nonlinear program with free end time.

Direct multiple shooting on the 4-DoF model: states at ``n + 1`` nodes, piecewise constant thrust, end time T. Cost:
hotel power times T plus the energy of the thrusters, plus a linear terminal cost for the remaining path. Currents
enter as c + G (p - p0) about the guess of every node, obstacles as half-planes that touch them where the guess is
nearest; both are renewed around the solution a fixed number of times (successive convexification: half-planes of
convex obstacles lie in the free space, so every iteration starts feasible).
"""

import math
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from autopilot.control.energy.energy_tuning import SHOOTING, TRAJECTORY
from autopilot.control.energy.power import PowerModel
from autopilot.control.energy.shooting import Shooting
from autopilot.core.background import Cancel
from autopilot.core.frames import FloatArray
from autopilot.core.model4 import NX, Model4


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ProgramInputs:
    """Data of one program: initial state, goal region, bounds. Arrays are per node (n + 1) unless noted otherwise."""

    x0: FloatArray
    """(8,)"""
    goal_ned_m: FloatArray
    """(3,)"""
    radius_m: float
    yaw_rad: float
    """Middle of the heading band at the end, on the turn by which it is to be reached."""
    yaw_band_rad: float
    """Half width; large = free."""
    current: FloatArray
    """(n + 1, 3) at ``places``"""
    gradient: FloatArray
    """(n + 1, 4) d c_n / dx, d c_n / dy, d c_e / dx, d c_e / dy"""
    places: FloatArray
    """(n + 1, 2)"""
    plane_n: FloatArray
    """(n + 1, PLANES, 2)"""
    plane_d: FloatArray
    """(n + 1, PLANES)"""
    planar_m_s: FloatArray
    """(n + 1,) limit of the planar speed"""
    limits: FloatArray
    """(n + 1, 4) heave, yaw rate, depth minimum, depth maximum."""
    thrust_limit_n: FloatArray
    """(thrusters,)"""
    end_slope_j_m: FloatArray
    """(2,) gradient of the remaining cost with respect to north and east of the coasting position."""
    longest_s: float
    buoyancy_excess_n: float


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Trajectory:
    t_s: FloatArray
    """(n + 1,) from its beginning."""
    x: FloatArray
    """(n + 1, 8)"""
    thrust_n: FloatArray
    """(n, thrusters)"""
    energy_j: float
    """Along it, hotel power included, without the remaining cost."""
    cost_j: float
    """With it."""
    solved: bool


class Program:
    """The built program for ``n`` intervals of ``substeps`` RK4 steps each."""

    def __init__(self, model: Model4, power: PowerModel, n: int, substeps: int) -> None:
        self.n, self.substeps, self._power, self._thrusters = n, substeps, power, model.thrusters
        shooting = Shooting(model, power, n, substeps)
        self._lbg, self._ubg = shooting.lower, shooting.upper
        self._stop = _Stop(shooting)
        options = {**OPTIONS, **shooting.derivatives, "iteration_callback": self._stop}
        self._solver = ca.nlpsol("energy", "ipopt", shooting.program, options)
        self.iterations = 0
        """Of the last solution."""

    def solve(
        self,
        inputs: ProgramInputs,
        x: FloatArray,
        thrust_n: FloatArray,
        end_s: float,
        cancel: Cancel | None = None,
        *,
        rough: bool = False,
    ) -> Trajectory:
        """From a guess: states (n + 1, 8), thrust (n, thrusters), end time. Given up once ``cancel`` is requested.
        A ``rough`` solution is there to be compared, not to be flown."""
        n, block = self.n, NX + self._thrusters
        self._stop.begin(cancel or Cancel(), rough)
        arguments = (
            inputs.x0,
            inputs.goal_ned_m,
            np.array([inputs.radius_m, inputs.yaw_rad, inputs.yaw_band_rad]),
            inputs.current,
            inputs.gradient,
            inputs.places,
            inputs.plane_n,
            inputs.plane_d,
            inputs.planar_m_s,
            inputs.limits,
            inputs.end_slope_j_m,
            np.array([inputs.buoyancy_excess_n]),
        )
        lower, upper = self._bounds(inputs)
        guess = np.concatenate([np.hstack([thrust_n, x[1:]]).ravel(), [min(max(end_s, lower[-1]), upper[-1])]])
        answer = self._solver(
            x0=guess,
            lbx=lower,
            ubx=upper,
            lbg=self._lbg,
            ubg=self._ubg,
            p=np.concatenate([np.ravel(a) for a in arguments]),
        )
        stats = self._solver.stats()
        self.iterations = int(stats["iter_count"])
        z, g = answer["x"].full().ravel(), answer["g"].full().ravel()
        solved = bool(stats["success"])
        if stats["return_status"] in STOPPED_SHORT or self._stop.settled:
            off = (self._lbg - g, g - self._ubg, lower - z, z - upper)
            solved = all(float(each.max()) < (TRAJECTORY.rough_feasible if rough else FEASIBLE) for each in off)
        table = z[:-1].reshape(n, block)
        states = np.vstack([inputs.x0, table[:, self._thrusters :]])
        return Trajectory(
            t_s=np.linspace(0.0, z[-1], n + 1),
            x=states,
            thrust_n=table[:, : self._thrusters].copy(),
            energy_j=self._energy_j(float(z[-1]), table[:, : self._thrusters]),
            cost_j=float(answer["f"]) / SHOOTING.cost_scale,
            solved=solved and bool(np.isfinite(z).all()),
        )

    def _bounds(self, inputs: ProgramInputs) -> tuple[FloatArray, FloatArray]:
        n, thrusters = self.n, self._thrusters
        upper = np.full((n, thrusters + NX), np.inf)
        upper[:, :thrusters] = inputs.thrust_limit_n
        return np.append(-upper, TRAJECTORY.min_interval_s * n), np.append(upper, inputs.longest_s)

    def _energy_j(self, end_s: float, thrust_n: FloatArray) -> float:
        return end_s * (self._power.hotel_w + float(self._power.thrust_w(thrust_n).sum()) / self.n)


class _Stop(ca.Callback):
    """Iteration callback of IPOPT that decides on early termination: an iteration takes up to 12 ms, a solution up to
    150.
    """

    def __init__(self, shooting: Shooting) -> None:
        ca.Callback.__init__(self)
        program = shooting.program
        count, rows, parameters = (program[name].shape[0] for name in ("x", "g", "p"))
        self._sizes = {"x": count, "f": 1, "g": rows, "lam_x": count, "lam_g": rows, "lam_p": parameters}
        self._lower, self._upper = shooting.lower, shooting.upper
        self.begin(Cancel(), False)
        self.construct("stop", {})

    def begin(self, cancel: Cancel, rough: bool) -> None:
        """A new program is to be solved."""
        self._cancel, self._rough = cancel, rough
        self._cost = self._least_off = math.inf
        self._since = 0
        """Iterations since the constraint violation was that small."""
        self.settled = False
        """Whether a rough solution was good enough."""

    def get_n_in(self) -> int:
        return int(ca.nlpsol_n_out())

    def get_n_out(self) -> int:
        return 1

    def get_name_in(self, i: int) -> str:
        return str(ca.nlpsol_out(i))

    def get_name_out(self, i: int) -> str:
        return "ret"

    def get_sparsity_in(self, i: int) -> Any:
        return ca.Sparsity.dense(self._sizes[self.get_name_in(i)])

    def eval(self, arg: Any) -> list[int]:
        """Return 1 to stop the solver."""
        rows = arg[2].full().ravel()
        off = float(max((self._lower - rows).max(), (rows - self._upper).max()))
        if self._rough:
            cost = float(arg[1])
            still, self._cost = abs(cost - self._cost) < TRAJECTORY.rough_fraction * abs(cost), cost
            self.settled = still and off < TRAJECTORY.rough_feasible
        return [int(self._cancel.requested or self.settled or self._stalled(off))]

    def _stalled(self, off: float) -> bool:
        """Whether the largest constraint violation has not decreased for STALLED_ITERATIONS."""
        if off < TRAJECTORY.nearer * self._least_off:
            self._least_off, self._since = off, 0
        self._since += 1
        return self._since > TRAJECTORY.stalled_iterations and self._least_off > TRAJECTORY.rough_feasible


STOPPED_SHORT, FEASIBLE = ("Maximum_Iterations_Exceeded", "Search_Direction_Becomes_Too_Small"), 1e-5
"""Such a program may have been at its optimum for long, without proof. A result that satisfies dynamics and bounds to
this tolerance (SI units) can be flown."""

OPTIONS: dict[str, Any] = {
    "print_time": False,
    # A trial step may leave the domain; IPOPT takes a shorter one.
    "show_eval_warnings": False,
    # Nobody wants them, and after a program that was not solved they are warned about.
    "calc_lam_p": False,
    "no_nlp_grad": True,
    "ipopt": {
        "print_level": 0,
        "sb": "yes",
        "tol": 1e-5,
        "acceptable_tol": 1e-4,
        "max_iter": 150,
        "mu_strategy": "adaptive",
        # These programs are scaled well and nearly banded: the plainest ordering is the quickest.
        "mumps_scaling": 0,
        "mumps_permuting_scaling": 0,
        "mumps_pivot_order": 0,
    },
}
