"""Minimum-energy trajectory from a state into a goal region: one nonlinear program with free end time.

Direct multiple shooting on the 4-DoF model: states at ``n + 1`` nodes, piecewise constant thrust, end time T. Cost:
hotel power times T plus the energy of the thrusters, plus a linear terminal cost for the remaining path. Currents
enter as c + G (p - p0) about the guess of every node, obstacles as half-planes that touch them where the guess is
nearest; both are renewed around the solution a fixed number of times (successive convexification: half-planes of
convex obstacles lie in the free space, so every iteration starts feasible).
"""

import enum
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from autopilot.control.energy.energy_tuning import SHOOTING, TRAJECTORY
from autopilot.control.energy.power import PowerModel
from autopilot.control.energy.shooting import Shooting
from autopilot.core.frames import FloatArray
from autopilot.core.model4 import NX, Model4, U


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
class Multipliers:
    """Lagrange multipliers of a solution."""

    bounds: FloatArray
    """(variables,)"""
    rows: FloatArray
    """(rows of constraints,)"""


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
    multipliers: Multipliers | None = None
    """Of a solution, for a warm start."""


class Start(enum.Enum):
    """A configuration of IPOPT."""

    ROUGH = "from a guess, to be compared"
    COLD = "from a guess, to be flown"
    WARM = "from a solution of nearly the same program"


class Program:
    """The built program for ``n`` intervals of ``substeps`` RK4 steps each."""

    def __init__(self, model: Model4, power: PowerModel, n: int, substeps: int) -> None:
        self.n, self.substeps, self._power, self._thrusters = n, substeps, power, model.thrusters
        shooting = Shooting(model, power, n, substeps)
        self._lbg, self._ubg = shooting.lower, shooting.upper
        self._solvers = {
            start: ca.nlpsol(
                "energy", "ipopt", shooting.program, {**OPTIONS, **shooting.derivatives, "ipopt": IPOPT | options}
            )
            for start, options in IPOPT_BY_START.items()
        }
        self.iterations = 0
        """Of the last solution."""

    def solve(
        self,
        inputs: ProgramInputs,
        x: FloatArray,
        thrust_n: FloatArray,
        end_s: float,
        *,
        rough: bool = False,
        multipliers: Multipliers | None = None,
    ) -> Trajectory:
        """From a guess: states (n + 1, 8), thrust (n, thrusters), end time, and its ``multipliers`` if it is a
        solution. A ``rough`` solution is there to be compared, not to be flown."""
        n, block = self.n, NX + self._thrusters
        solver = self._solvers[Start.ROUGH if rough else Start.COLD if multipliers is None else Start.WARM]
        known = {} if multipliers is None else {"lam_x0": multipliers.bounds, "lam_g0": multipliers.rows}
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
        answer = solver(
            x0=guess,
            lbx=lower,
            ubx=upper,
            lbg=self._lbg,
            ubg=self._ubg,
            p=np.concatenate([np.ravel(a) for a in arguments]),
            **known,
        )
        stats = solver.stats()
        self.iterations = int(stats["iter_count"])
        z, g = answer["x"].full().ravel(), answer["g"].full().ravel()
        solved = bool(stats["success"])
        if stats["return_status"] in STOPPED_SHORT:
            off = (self._lbg - g, g - self._ubg, lower - z, z - upper)
            solved = all(
                float(each.max()) < (TRAJECTORY.rough_feasible if rough else TRAJECTORY.feasible) for each in off
            )
        table = z[:-1].reshape(n, block)
        states = np.vstack([inputs.x0, table[:, self._thrusters :]])
        return Trajectory(
            t_s=np.linspace(0.0, z[-1], n + 1),
            x=states,
            thrust_n=table[:, : self._thrusters].copy(),
            energy_j=self._energy_j(float(z[-1]), table[:, : self._thrusters]),
            cost_j=float(answer["f"]) / SHOOTING.cost_scale,
            solved=solved and bool(np.isfinite(z).all()),
            multipliers=Multipliers(bounds=answer["lam_x"].full().ravel(), rows=answer["lam_g"].full().ravel()),
        )

    def _bounds(self, inputs: ProgramInputs) -> tuple[FloatArray, FloatArray]:
        n, thrusters = self.n, self._thrusters
        upper = np.full((n, thrusters + NX), np.inf)
        upper[:, :thrusters] = inputs.thrust_limit_n
        speeds = inputs.planar_m_s, inputs.limits[:, 0], inputs.limits[:, 1]
        planar, heave, turn = (float(limit.max()) for limit in speeds)
        upper[:, thrusters + U :] = TRAJECTORY.wide * np.array([planar, planar, heave, turn])
        return np.append(-upper, TRAJECTORY.min_interval_s * n), np.append(upper, inputs.longest_s)

    def _energy_j(self, end_s: float, thrust_n: FloatArray) -> float:
        return end_s * (self._power.hotel_w + float(self._power.thrust_w(thrust_n).sum()) / self.n)


STOPPED_SHORT = ("Maximum_Iterations_Exceeded", "Search_Direction_Becomes_Too_Small")
"""Such a program may have been at its optimum for long, without proof: see TrajectoryTuning.feasible."""

OPTIONS: dict[str, Any] = {
    "print_time": False,
    # A trial step may leave the domain; IPOPT takes a shorter one.
    "show_eval_warnings": False,
    # Nobody wants them, and after a program that was not solved they are warned about.
    "calc_lam_p": False,
    "no_nlp_grad": True,
}

IPOPT: dict[str, Any] = {
    "print_level": 0,
    "sb": "yes",
    "tol": 1e-5,
    "mu_strategy": "adaptive",
    # The strategy chooses up to 1 on its own, which leads away from guesses that are good.
    "mu_max": 0.1,
    # Programs that are solved need up to 1. Where it grows an iteration takes 20 times as long, and leads nowhere.
    "max_hessian_perturbation": 1e2,
    # These programs are scaled well and nearly banded: the plainest ordering is the quickest.
    "mumps_scaling": 0,
    "mumps_permuting_scaling": 0,
    "mumps_pivot_order": 0,
}


def _acceptable(feasible: float, share: float, iterations: int, **more: float) -> dict[str, Any]:
    """Ends when the cost has changed by less than ``share`` in each of so many iterations, constraints kept within
    ``feasible``: near the optimum thrusts of some 0.1 N are moved from one interval to the next without end."""
    return {
        "acceptable_tol": 1e10,
        "acceptable_dual_inf_tol": 1e10,
        "acceptable_compl_inf_tol": 1e10,
        "acceptable_constr_viol_tol": feasible,
        "acceptable_obj_change_tol": share,
        "acceptable_iter": iterations,
        **more,
    }


_FLOWN = _acceptable(
    TRAJECTORY.feasible, TRAJECTORY.fine_fraction, 3, acceptable_dual_inf_tol=2e-3, acceptable_compl_inf_tol=1e-5
)

IPOPT_BY_START: dict[Start, dict[str, Any]] = {
    Start.ROUGH: {
        # With a larger dual infeasibility short steps would pass for a settled cost.
        **_acceptable(TRAJECTORY.rough_feasible, TRAJECTORY.rough_fraction, 1, acceptable_dual_inf_tol=0.03),
        "max_iter": 40,
    },
    Start.COLD: {**_FLOWN, "max_iter": 80},
    Start.WARM: {
        **_FLOWN,
        "max_iter": 40,
        "mu_strategy": "monotone",
        "mu_init": 1e-4,
        "warm_start_init_point": "yes",
        **{
            f"warm_start_{name}": 1e-6
            for name in ("bound_push", "bound_frac", "slack_bound_push", "slack_bound_frac", "mult_bound_push")
        },
    },
}
"""All limits count iterations: with one on time a flight could not be repeated."""
