"""The controller's problem solved to convergence by IPOPT or fatrop: the yardstick for the real-time iteration.

The same dynamics, weights, penalties, bounds and half-planes as :mod:`autopilot.control.nmpc.ocp`, written as a plain
nonlinear program with two-sided limits and the speed norm as it stands, so that it also checks the linearisation.
"""

from typing import Any

import casadi as ca
import numpy as np

from autopilot.control.nmpc import ocp
from autopilot.control.nmpc.grid import REFERENCE_DT_S, TimeGrid
from autopilot.control.nmpc.solver import NmpcProblem
from autopilot.core.frames import FloatArray
from autopilot.core.model4 import NX, Model4, R, U, V, W, Z

SOFT_ROWS = (
    *("planar speed", "sinking", "rising", "turning to starboard", "turning to port"),
    *("least depth", "greatest depth"),
)
"""Soft limits of a node, in the order of its rows, followed by the half-planes."""
PLANE = "boundary "
COST_SCALE = 1e-2
"""Brings the cost to the size that the tolerance is meant for."""


class IpoptNmpc:
    """One built nonlinear program, warm-started by a plan. Variables and rows are in the order of the stages."""

    def __init__(
        self, model: Model4, grid: TimeGrid, planes: int, tolerance: float = 1e-6, plugin: str = "ipopt"
    ) -> None:
        n = self._n = grid.n
        nu = model.thrusters
        width = NX + nu + ocp.N_SLACKS
        z = ca.MX.sym("z", nu + (n - 1) * width + NX)
        place = nu + width * np.arange(n)[:, None]
        self._at_x = place + np.arange(NX)
        self._at_u = np.vstack([np.arange(nu), place[:-1] + NX + np.arange(nu)])
        self._at_s = place[:-1] + NX + nu + np.arange(ocp.N_SLACKS)
        x, u, s = (
            ca.reshape(z[at.ravel().tolist()], at.shape[1], at.shape[0]) for at in (self._at_x, self._at_u, self._at_s)
        )
        shapes = {"x0": (NX, 1), **ocp.argument_shapes(n, planes, nu)}
        self._names = [name for name in shapes if not name.endswith("_guess")]
        self._shapes = {name: shapes[name] for name in self._names}
        parameters = [ca.MX.sym(name, *shape) for name, shape in self._shapes.items()]
        x0, x_ref, u_ref, current, weight_x, weight_u, terminal, buoyancy, *rest = parameters
        limits, thrust_limit, plane_n, plane_d = rest
        cost: Any = 0.0
        rows: list[Any] = []
        is_gap: list[bool] = []
        self.rows: list[tuple[int, str]] = []
        """Node and name of every row; "" = dynamics."""
        state = x0
        substeps_of = grid.substeps(ocp.longest_step_s(model))
        for k, (dt, substeps) in enumerate(zip(grid.dt_s, substeps_of, strict=True)):
            scale = dt / REFERENCE_DT_S
            step = ocp.trimmed_dynamics(model, float(dt), substeps)
            rows.append(x[:, k] - step(state, u[:, k], current[:, k], buoyancy)[0])
            is_gap += [True] * NX
            self.rows += [(k + 1, "")] * NX
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
                is_gap += [False] * (7 + planes)
                self.rows += [(k, name) for name in (*SOFT_ROWS, *(f"{PLANE}{number}" for number in range(planes)))]
            state = x[:, k]
        error = state - x_ref[:, n]
        cost += 0.5 * ca.bilin(terminal, error, error)
        p = ca.vertcat(*(ca.vec(v) for v in parameters))
        options: dict[str, Any] = {"expand": True, "print_time": False}
        if plugin == "fatrop":
            stages = {
                "N": n,
                "nx": [0] + [NX] * n,
                "nu": [nu] + [nu + ocp.N_SLACKS] * (n - 1) + [0],
                "ng": [0] + [7 + planes] * (n - 1) + [0],
            }
            options |= {"structure_detection": "manual", **stages, "equality": is_gap}
            options["fatrop"] = {"print_level": 0, "tolerance": tolerance, "mu_init": 1e-2, "max_iter": 200}
        else:
            inner = {"print_level": 0, "sb": "yes", "tol": tolerance, "max_iter": 200, "warm_start_init_point": "yes"}
            options["ipopt"] = inner
        program: Any = {"x": z, "f": COST_SCALE * cost, "g": ca.vertcat(*rows), "p": p}
        self._evaluate: Any = ca.Function("look", [z, p], [cost, program["g"]])
        self._solver: Any = ca.nlpsol(plugin, plugin, program, options)
        self._ubg = np.zeros(len(is_gap))
        self._lbg = np.where(is_gap, 0.0, -np.inf)
        self._guess = np.zeros(z.shape[0])
        self.cost = 0.0
        """Of the last answer."""
        self.multipliers: FloatArray = np.zeros(len(is_gap))
        """(rows,) of its rows, in units of the cost per unit of the row."""
        self.thrust_multipliers: FloatArray = np.zeros((n, nu))
        """(N, thrusters) of its thrust bounds, positive at the upper one."""

    def set_plan(self, x: FloatArray, thrust_n: FloatArray) -> None:
        """Start from states (N+1, 8) and thrust (N, 4)."""
        self._guess[self._at_x], self._guess[self._at_u], self._guess[self._at_s] = x[1:], thrust_n, 0.0

    def solve(self, problem: NmpcProblem) -> tuple[FloatArray, FloatArray, bool]:
        """States (N+1, 8), thrust (N, 4) and whether the solver calls it solved."""
        lower, upper = np.full(len(self._guess), -np.inf), np.full(len(self._guess), np.inf)
        parameters = self._parameters(problem)
        bound = np.broadcast_to(problem.thrust_limit_n, problem.thrust_ref_n.shape)
        lower[self._at_u], upper[self._at_u] = -bound, bound
        lower[self._at_s] = 0.0
        answer = self._solver(x0=self._guess, lbx=lower, ubx=upper, lbg=self._lbg, ubg=self._ubg, p=parameters)
        z = answer["x"].full().ravel()
        self.cost = float(answer["f"]) / COST_SCALE
        self.multipliers = answer["lam_g"].full().ravel() / COST_SCALE
        self.thrust_multipliers = answer["lam_x"].full().ravel()[self._at_u] / COST_SCALE
        return np.vstack([problem.x0, z[self._at_x]]), z[self._at_u], bool(self._solver.stats()["success"])

    def cost_of(self, problem: NmpcProblem, x: FloatArray, thrust_n: FloatArray) -> float:
        """Cost of a given plan, penalties of violated soft limits included."""
        z = np.zeros(len(self._guess))
        z[self._at_x], z[self._at_u] = x[1:], thrust_n
        parameters = self._parameters(problem)
        rows = self._evaluate(z, parameters)[1].full().ravel()
        slack = np.zeros(self._at_s.shape)
        for (node, name), over in zip(self.rows, rows.tolist(), strict=True):
            if name and over > 0.0:
                kind = 0 if name in SOFT_ROWS[:5] else 1
                slack[node - 1, kind] = max(slack[node - 1, kind], over)
        z[self._at_s] = slack
        return float(self._evaluate(z, parameters)[0])

    def _parameters(self, problem: NmpcProblem) -> FloatArray:
        values = (
            problem.x0,
            problem.x_ref,
            problem.thrust_ref_n,
            problem.current_ned_m_s,
            problem.weight_x,
            problem.weight_u,
            problem.terminal,
            problem.buoyancy_excess_n,
            problem.limits,
            problem.thrust_limit_n,
            problem.plane_n.reshape(-1, 2),
            problem.plane_d_m,
        )
        return np.concatenate(
            [
                np.broadcast_to(value, (columns, rows) if value.ndim == 2 or columns > 1 else (rows,)).ravel()
                for value, (rows, columns) in zip(values, self._shapes.values(), strict=True)
            ]
        )
