"""The controller's problem solved to convergence by IPOPT: the yardstick for the real-time iteration.

The same dynamics, weights, penalties, bounds and half-planes as :mod:`autopilot.control.ocp`, written as a plain
nonlinear program with two-sided limits and the speed norm as it stands, so that it also checks the linearisation.
"""

from typing import Any

import casadi as ca
import numpy as np

from autopilot.control import ocp
from autopilot.control.grid import REFERENCE_DT_S, TimeGrid
from autopilot.control.nmpc import NmpcProblem
from autopilot.core.frames import FloatArray
from autopilot.core.model4 import NU, NX, Model4, R, U, V, W, Z

COST_SCALE = 1e-2
"""Brings the cost to the size that the tolerance is meant for."""


class IpoptNmpc:
    """One built nonlinear program, warm-started by its own last solution."""

    def __init__(self, model: Model4, grid: TimeGrid, planes: int, tolerance: float = 1e-6) -> None:
        n = self._n = grid.n
        self._planes = planes
        x, u, s = ca.MX.sym("x", NX, n), ca.MX.sym("u", NU, n), ca.MX.sym("s", ocp.N_SLACKS, n - 1)
        shapes = {"x0": (NX, 1), **ocp.argument_shapes(n, planes)}
        self._names = [name for name in shapes if not name.endswith("_guess")]
        self._shapes = {name: shapes[name] for name in self._names}
        parameters = [ca.MX.sym(name, *shape) for name, shape in self._shapes.items()]
        x0, x_ref, u_ref, current, weight_x, weight_u, terminal, limits, thrust_limit, plane_n, plane_d = parameters
        cost: Any = 0.0
        gaps: list[Any] = []
        rows: list[Any] = []
        state = x0
        for k, (dt, substeps) in enumerate(zip(grid.dt_s, grid.substeps(), strict=True)):
            scale = dt / REFERENCE_DT_S
            step = ocp.discrete_dynamics(model, float(dt), substeps)
            gaps.append(step(state, u[:, k], current[:, k])[0] - x[:, k])
            thrust = u[:, k] - ca.fmax(-thrust_limit[:, k], ca.fmin(thrust_limit[:, k], u_ref[:, k]))
            cost += 0.5 * scale * ca.dot(weight_u[:, k] * thrust, thrust)
            if k > 0:
                error, slack, limit = state - x_ref[:, k], s[:, k - 1], limits[:, k - 1]
                cost += 0.5 * scale * ca.dot(weight_x[:, k - 1] * error, error)
                cost += scale * (ocp.SLACK_L1 * ca.sum1(slack) + 0.5 * ocp.SLACK_L2 * ca.sumsqr(slack))
                normals = plane_n[:, (k - 1) * planes : k * planes]
                rows += [
                    ca.sqrt(state[U] ** 2 + state[V] ** 2 + 1e-12) - limit[0] - slack[0],
                    state[W] - limit[1] - slack[0],
                    -state[W] - limit[1] - slack[0],
                    state[R] - limit[2] - slack[0],
                    -state[R] - limit[2] - slack[0],
                    limit[3] - state[Z] - slack[1],
                    state[Z] - limit[4] - slack[1],
                    plane_d[:, k - 1] - ca.mtimes(normals.T, state[:2]) - slack[1],
                ]
            state = x[:, k]
        error = state - x_ref[:, n]
        cost += 0.5 * ca.bilin(terminal, error, error)
        variables = ca.vertcat(ca.vec(x), ca.vec(u), ca.vec(s))
        constraints = ca.vertcat(*gaps, *rows)
        p = ca.vertcat(*(ca.vec(v) for v in parameters))
        options: dict[str, Any] = {
            "expand": True,
            "print_time": False,
            "ipopt": {"print_level": 0, "sb": "yes", "tol": tolerance, "max_iter": 200, "warm_start_init_point": "yes"},
        }
        program: Any = {"x": variables, "f": COST_SCALE * cost, "g": constraints, "p": p}
        self._solver: Any = ca.nlpsol("ipopt", "ipopt", program, options)
        self._ubg = np.zeros(constraints.shape[0])
        self._lbg = np.full(constraints.shape[0], -np.inf)
        self._lbg[: NX * n] = 0.0
        self._guess: FloatArray | None = None

    def set_plan(self, x: FloatArray, thrust_n: FloatArray) -> None:
        """Start from states (N+1, 8) and thrust (N, 4)."""
        self._guess = np.concatenate([x[1:].ravel(), thrust_n.ravel(), np.zeros(ocp.N_SLACKS * (self._n - 1))])

    def solve(self, problem: NmpcProblem) -> tuple[FloatArray, FloatArray, bool]:
        """States (N+1, 8), thrust (N, 4) and whether IPOPT calls it solved."""
        n = self._n
        width = NX * n + NU * n + ocp.N_SLACKS * (n - 1)
        lower, upper = np.full(width, -np.inf), np.full(width, np.inf)
        values = (
            problem.x0,
            problem.x_ref,
            problem.thrust_ref_n,
            problem.current_ned_m_s,
            problem.weight_x,
            problem.weight_u,
            problem.terminal,
            problem.limits,
            problem.thrust_limit_n,
            problem.plane_n.reshape(-1, 2),
            problem.plane_d_m,
        )
        parameters = np.concatenate(
            [
                np.broadcast_to(value, (columns, rows) if value.ndim == 2 or columns > 1 else (rows,)).ravel()
                for value, (rows, columns) in zip(values, self._shapes.values(), strict=True)
            ]
        )
        bound = np.broadcast_to(problem.thrust_limit_n, (n, NU)).ravel()
        lower[NX * n : NX * n + NU * n], upper[NX * n : NX * n + NU * n] = -bound, bound
        lower[NX * n + NU * n :] = 0.0
        guess = np.zeros(width) if self._guess is None else self._guess
        answer = self._solver(x0=guess, lbx=lower, ubx=upper, lbg=self._lbg, ubg=self._ubg, p=parameters)
        z = answer["x"].full().ravel()
        x = np.vstack([problem.x0, z[: NX * n].reshape(n, NX)])
        u = z[NX * n : NX * n + NU * n].reshape(n, NU)
        return x, u, bool(self._solver.stats()["success"])
