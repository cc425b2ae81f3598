"""A trajectory of least energy from a state into a goal region: one nonlinear program with free end time.

Direct multiple shooting on the 4-DoF model: states at ``n + 1`` nodes, thrust constant in between, end time T. Cost:
hotel power times T plus the power of the thrusters, plus a linear cost at the end for what follows. Currents enter as
c + G (p - p0) about the guess of every node, obstacles as half-planes that touch them where the guess is nearest; both
are made anew around the solution, a counted number of times (successive approximation: half-planes of convex obstacles
lie in free space, so every round starts feasible).
"""

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from autopilot.control.energy.power import PowerModel
from autopilot.core import model4
from autopilot.core.desk import Cancel
from autopilot.core.frames import FloatArray
from autopilot.core.model4 import NU, NX, YAW, Model4, R, U, V, W, Z

PLANES = 6
"""Half-planes per node."""

SUBSTEP_S = 0.5
"""Longest RK4 step: with longer ones the program makes a profit of integration errors in the unstable sway-yaw mode."""

SPEED_EPSILON_M_S = 1e-4


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Ask:
    """One program: where from, where to, within what. Arrays are per node (n + 1) unless said otherwise."""

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
    """(4,) heave, yaw rate, depth minimum, depth maximum."""
    thrust_limit_n: FloatArray
    """(4,)"""
    end_slope_j_m: FloatArray
    """(2,) slope of the cost of what follows, over north and east of the place where the vehicle coasts to."""
    longest_s: float


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Trajectory:
    """A solution."""

    t_s: FloatArray
    """(n + 1,) from its beginning."""
    x: FloatArray
    """(n + 1, 8)"""
    thrust_n: FloatArray
    """(n, 4)"""
    energy_j: float
    """Along it, hotel power included, without the cost of what follows."""
    cost_j: float
    """With it."""
    solved: bool


COAST_S = 1.0
"""A vehicle that arrives with a velocity is taken to be this much farther on at no cost."""


class Program:
    """The built program for ``n`` intervals of ``substeps`` RK4 steps each."""

    def __init__(self, model: Model4, power: PowerModel, n: int, substeps: int) -> None:
        self.n, self.substeps, self._power = n, substeps, power
        self._shapes = {
            "x0": (NX, 1),
            "goal": (3, 1),
            "band": (3, 1),
            "current": (3, n + 1),
            "gradient": (4, n + 1),
            "places": (2, n + 1),
            "plane_n": (2, PLANES * (n + 1)),
            "plane_d": (PLANES, n + 1),
            "planar": (1, n + 1),
            "limits": (4, 1),
            "end": (2, 1),
        }
        program, self._lbg, self._ubg = _build(model, power, n, substeps, self._shapes)
        self._stop = _Stop(program)
        self._solver = ca.nlpsol("energy", "ipopt", program, {**OPTIONS, "iteration_callback": self._stop})

    def solve(
        self, ask: Ask, x: FloatArray, thrust_n: FloatArray, end_s: float, cancel: Cancel | None = None
    ) -> Trajectory:
        """From a guess: states (n + 1, 8), thrust (n, 4), end time. Given up once ``cancel`` is requested."""
        n = self.n
        self._stop.cancel = cancel or Cancel()
        arguments = (
            ask.x0,
            ask.goal_ned_m,
            np.array([ask.radius_m, ask.yaw_rad, ask.yaw_band_rad]),
            ask.current,
            ask.gradient,
            ask.places,
            ask.plane_n,
            ask.plane_d,
            ask.planar_m_s,
            ask.limits,
            ask.end_slope_j_m,
        )
        width = (NX + NU) * n
        lower, upper = np.full(width + 1, -np.inf), np.full(width + 1, np.inf)
        thrusts = slice(0, width), np.arange(width) % (NX + NU) < NU
        bound = np.tile(ask.thrust_limit_n, n)
        lower[thrusts[0]][thrusts[1]] = -bound
        upper[thrusts[0]][thrusts[1]] = bound
        lower[-1], upper[-1] = MIN_INTERVAL_S * n, ask.longest_s
        guess = np.concatenate([np.hstack([thrust_n, x[1:]]).ravel(), [min(max(end_s, lower[-1]), upper[-1])]])
        answer = self._solver(
            x0=guess,
            lbx=lower,
            ubx=upper,
            lbg=self._lbg,
            ubg=self._ubg,
            p=np.concatenate([np.ravel(a) for a in arguments]),
        )
        z = answer["x"].full().ravel()
        table = z[:-1].reshape(n, NX + NU)
        states = np.vstack([ask.x0, table[:, NU:]])
        return Trajectory(
            t_s=np.linspace(0.0, z[-1], n + 1),
            x=states,
            thrust_n=table[:, :NU].copy(),
            energy_j=self._energy_j(float(z[-1]), table[:, :NU]),
            cost_j=float(answer["f"]) / COST_SCALE,
            solved=bool(self._solver.stats()["success"]) and bool(np.isfinite(z).all()),
        )

    def _energy_j(self, end_s: float, thrust_n: FloatArray) -> float:
        return end_s * (self._power.hotel_w + float(self._power.thrust_w(thrust_n).sum()) / self.n)


class _Stop(ca.Callback):
    """IPOPT asks it after every iteration whether to go on: they take up to 12 ms, a solution up to 150 of them."""

    def __init__(self, program: dict[str, Any]) -> None:
        ca.Callback.__init__(self)
        self.cancel = Cancel()
        count, rows, parameters = (program[name].shape[0] for name in ("x", "g", "p"))
        self._sizes = {"x": count, "f": 1, "g": rows, "lam_x": count, "lam_g": rows, "lam_p": parameters}
        self.construct("stop", {})

    def get_n_in(self) -> int:
        """What a solver gives out."""
        return int(ca.nlpsol_n_out())

    def get_n_out(self) -> int:
        """One flag."""
        return 1

    def get_name_in(self, i: int) -> str:
        """As the solver names them."""
        return str(ca.nlpsol_out(i))

    def get_name_out(self, i: int) -> str:
        """As the solver wants it."""
        return "ret"

    def get_sparsity_in(self, i: int) -> Any:
        """Columns."""
        return ca.Sparsity.dense(self._sizes[self.get_name_in(i)])

    def eval(self, arg: Any) -> list[int]:
        """1 = stop."""
        return [int(self.cancel.requested)]


MIN_INTERVAL_S = 0.005
COST_SCALE = 1e-2

OPTIONS: dict[str, Any] = {
    "print_time": False,
    # A trial step may leave the domain; IPOPT takes a shorter one.
    "show_eval_warnings": False,
    # Nobody wants them, and after a program that was not solved they are warned about.
    "calc_lam_p": False,
    "ipopt": {
        "print_level": 0,
        "sb": "yes",
        "tol": 1e-5,
        "acceptable_tol": 1e-4,
        "max_iter": 150,
        "mu_strategy": "adaptive",
    },
}


def _build(
    model: Model4, power: PowerModel, n: int, substeps: int, shapes: dict[str, tuple[int, int]]
) -> tuple[dict[str, Any], FloatArray, FloatArray]:
    """The nonlinear program and the bounds of its constraints."""
    w = [ca.SX.sym(f"w{k}", NU + NX) for k in range(n)]
    end_s = ca.SX.sym("T")
    p = {name: ca.SX.sym(name, *shape) for name, shape in shapes.items()}
    step = _interval(model, substeps)
    x = p["x0"]
    cost = power.hotel_w * end_s
    g, low, high = [], [], []

    def add(value: Any, lower: float, upper: float) -> None:
        g.append(value)
        count = value.shape[0] if hasattr(value, "shape") else 1
        low.extend([lower] * count)
        high.extend([upper] * count)

    dt = end_s / n
    for k in range(n):
        u, x_next = w[k][:NU], w[k][NU:]
        moved = step(x, u, p["current"][:, k], p["gradient"][:, k], p["places"][:, k], dt)
        add(moved - x_next, 0.0, 0.0)
        cost += dt * sum(power.thrust_w(u[i]) for i in range(NU))
        x = x_next
        add(x[U] ** 2 + x[V] ** 2 - p["planar"][k + 1] ** 2, -np.inf, 0.0)
        add(ca.vertcat(x[W] - p["limits"][0], -x[W] - p["limits"][0]), -np.inf, 0.0)
        add(ca.vertcat(x[R] - p["limits"][1], -x[R] - p["limits"][1]), -np.inf, 0.0)
        add(ca.vertcat(p["limits"][2] - x[Z], x[Z] - p["limits"][3]), -np.inf, 0.0)
        normals = p["plane_n"][:, (k + 1) * PLANES : (k + 2) * PLANES]
        add(p["plane_d"][:, k + 1] - ca.mtimes(normals.T, x[:2]), -np.inf, 0.0)
    away = x[:3] - p["goal"]
    add(ca.sumsqr(away) - p["band"][0] ** 2, -np.inf, 0.0)
    add(ca.vertcat(x[YAW] - p["band"][1] - p["band"][2], p["band"][1] - p["band"][2] - x[YAW]), -np.inf, 0.0)
    c, s = ca.cos(x[YAW]), ca.sin(x[YAW])
    ground = ca.vertcat(x[U] * c - x[V] * s, x[U] * s + x[V] * c) + p["current"][:2, n]
    cost += ca.dot(p["end"], x[:2] + COAST_S * ground - p["goal"][:2])
    program: Any = {
        "x": ca.vertcat(*w, end_s),
        "f": COST_SCALE * cost,
        "g": ca.vertcat(*g),
        "p": ca.vertcat(*(ca.vec(v) for v in p.values())),
    }
    return program, np.array(low), np.array(high)


def _interval(model: Model4, substeps: int) -> ca.Function:
    x, u = ca.SX.sym("x", NX), ca.SX.sym("u", NU)
    c, g, p0, dt = ca.SX.sym("c", 3), ca.SX.sym("g", 4), ca.SX.sym("p0", 2), ca.SX.sym("dt")

    def f(state: Any) -> Any:
        dx, dy = state[0] - p0[0], state[1] - p0[1]
        current = [c[0] + g[0] * dx + g[1] * dy, c[1] + g[2] * dx + g[3] * dy, c[2]]
        return ca.vertcat(*model4.state_derivative(model, ca.vertsplit(state), ca.vertsplit(u), current, ca))

    h = dt / substeps
    state = x
    for _ in range(substeps):
        k1 = f(state)
        k2 = f(state + h / 2 * k1)
        k3 = f(state + h / 2 * k2)
        k4 = f(state + h * k3)
        state = state + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return ca.Function("interval", [x, u, c, g, p0, dt], [state])
