"""Terminal ingredients of one goal: steady input against the current, LQR gain, cost and region, with verification.

In the frame of the goal (error ahead, to starboard, ... of the goal's heading) the vehicle is linearised at rest over
ground: velocity through the water -R^T c, with the thrust that holds it. With the discrete Riccati gain K, P solves
(A + B K)^T P (A + B K) - P = -kappa (Q + K^T R K), kappa > 1, so that E(e) = e^T P e decreases by more than the stage
cost, with a margin for the linearisation error (Chen and Allgower 1998, quasi-infinite horizon, here in discrete
time). The level alpha is the largest for which the ellipsoid E <= alpha satisfies every limit; it is then reduced until
no sample of the nonlinear model violates the decrease.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from autopilot.control.nmpc.grid import REFERENCE_DT_S
from autopilot.control.robust.error_model import error_jacobian, input_matrix
from autopilot.control.robust.riccati import dare, discretise, gain, lyapunov
from autopilot.control.robust.robust_tuning import TERMINAL
from autopilot.core import model4
from autopilot.core.control_allocator import ControlAllocator
from autopilot.core.frames import FloatArray
from autopilot.core.messages import Goal
from autopilot.core.model4 import NX, YAW, Model4, R, U, V, W, X, Z


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class TerminalLimits:
    """Limits of the region, after back-offs."""

    thrust_n: FloatArray
    """(n,)"""
    planar_speed_m_s: float
    heave_m_s: float
    yaw_rate_rad_s: float
    depth_min_m: float
    depth_max_m: float
    clearance_m: float
    """From the goal to the nearest place that the centre must keep out of."""
    thrusters: tuple[str, ...] = ()
    """Names of the n thrusters, as far as they have any."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Terminal:
    """Terminal law and cost of a goal; the region is computed separately."""

    yaw_rad: float
    nu: FloatArray
    """(4,) velocity through the water at the goal."""
    thrust_n: FloatArray
    """(n,) that holds it there, with least energy."""
    k: FloatArray
    """(n, 8) gain on the error in the goal's frame."""
    p: FloatArray
    """(8, 8) cost in the goal's frame, per REFERENCE_DT_S as the stage cost."""
    q: FloatArray
    """(8,)"""
    r: FloatArray
    """(n,)"""

    def cost_ned(self) -> FloatArray:
        """(8, 8) cost on the error in NED, as the optimiser's terminal Hessian is given."""
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        turn = np.eye(NX)
        turn[:2, :2] = [[c, s], [-s, c]]
        return turn.T @ self.p @ turn

    def level(self, error: FloatArray) -> float:
        """E of an error (8,) in the goal's frame."""
        return float(error @ self.p @ error)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Certificate:
    """Terminal region of one goal and the result of its verification by sampling."""

    alpha: float
    """Level of the region, 0 = it is empty."""
    binding: str
    """The limit that decides alpha."""
    radius_m: float
    """Largest horizontal error in the region."""
    depth_m: float
    yaw_rad: float
    planar_speed_m_s: float
    accept_radius_m: float
    """Radius of the goal's own region."""
    fits: bool
    """The goal's own ball lies inside the limits; else the region to be reached is smaller."""
    fit_radius_m: float
    """Largest ball round the goal that does."""
    fit_limit: str
    """Limiting constraint of that ball: clearance or depth."""
    samples: int
    violations: int
    """Samples at which the decrease failed at this alpha: 0 in a finished certificate."""
    shrunk: int
    """Number of reductions of alpha by sampling."""

    @property
    def text(self) -> str:
        if self.alpha <= 0.0:
            return f"no terminal region: the goal is beyond its {self.binding} limit"
        size = f"{self.radius_m:.3f} m, {math.degrees(self.yaw_rad):.1f} deg"
        small = ""
        if not self.fits:
            ball = (
                f"acceptance ball {self.accept_radius_m:g} m does not fit {self.fit_radius_m:.3f} m of {self.fit_limit}"
            )
            small = f"; {ball}, region made smaller"
        looked = f"{self.violations} of {self.samples} violate" if self.samples else "not sampled"
        return f"alpha {self.alpha:.3g} ({size}) by {self.binding}, {looked}{small}"


def terminal_law(
    allocator: ControlAllocator,
    yaw_rad: float,
    current_ned_m_s: FloatArray,
    q: FloatArray,
    r: FloatArray,
    limit_n: FloatArray,
) -> Terminal:
    """Steady input, LQR gain and terminal cost of a goal in a current.

    Parameters
    ----------
    allocator
        Control allocation and model of the vehicle.
    yaw_rad
        Heading at the goal [rad].
    current_ned_m_s
        (3,) current, NED [m/s].
    q, r
        (8,), (n,) diagonal weights of the stage cost on error and thrust.
    limit_n
        (n,) thrust limits for the allocation of redundant thrusters [N].

    Returns
    -------
    Terminal
        ``thrust_n`` exceeds ``limit_n`` if the thrusters cannot hold the vehicle in the current.
    """
    model, c, s = allocator.model, math.cos(yaw_rad), math.sin(yaw_rad)
    cn, ce, cd = (float(v) for v in current_ned_m_s)
    nu = np.array([-(c * cn + s * ce), -(c * ce - s * cn), -cd, 0.0])
    force = model4.steady_force(model, nu.tolist(), math)
    # If the thrusters cannot hold it, the required thrust violates the limits below.
    enough = allocator.makes(np.array(force), limit_n)
    thrust = allocator.thrust_n(np.array(force), limit_n if enough else np.full(model.thrusters, np.inf))
    a, b = _goal_jacobian(model, nu), input_matrix(model)
    a_d, b_d = discretise(a, b, REFERENCE_DT_S)
    weights = np.diag(np.maximum(q, 1e-6))
    r_d = np.diag(r)
    k = gain(a_d, b_d, dare(a_d, b_d, weights, r_d), r_d)
    closed = a_d + b_d @ k
    p = lyapunov(closed.T, TERMINAL.kappa * (weights + k.T @ r_d @ k))
    return Terminal(yaw_rad=yaw_rad, nu=nu, thrust_n=thrust, k=k, p=0.5 * (p + p.T), q=q, r=r)


def _goal_jacobian(model: Model4, nu: FloatArray) -> FloatArray:
    """(8, 8) dynamics of the error in the goal's frame, which does not turn."""
    a = error_jacobian(model, nu)
    a[0, 1] = a[1, 0] = 0.0
    return a


def analytic_alpha(law: Terminal, goal: Goal, limits: TerminalLimits) -> tuple[float, str]:
    """Largest level of E = e^T P e that satisfies every limit.

    On the ellipsoid E <= alpha a linear function h^T e has the maximum sqrt(alpha h^T P^-1 h).

    Returns
    -------
    alpha
        The level, 0 if the goal itself violates a limit.
    binding
        Name of the limit that decides it.
    """
    spread = np.linalg.inv(law.p)
    feedback = np.einsum("ij,jk,ik->i", law.k, spread, law.k)
    planar = float(np.linalg.eigvalsh(spread[:2, :2])[-1])
    ball = float(np.linalg.eigvalsh(spread[:3, :3])[-1])
    planar_speed = float(np.linalg.eigvalsh(spread[U : V + 1, U : V + 1])[-1])
    depth = float(goal.pos_ned_m[2])
    yaw_slack = TERMINAL.free_yaw_rad if goal.yaw_rad is None else goal.accept_yaw_rad
    slacks = {
        "clearance": (limits.clearance_m, planar),
        "acceptance radius": (goal.accept_radius_m, ball),
        "acceptance heading": (yaw_slack, spread[YAW, YAW]),
        "depth": (min(depth - limits.depth_min_m, limits.depth_max_m - depth), spread[Z, Z]),
        "planar speed": (limits.planar_speed_m_s - math.hypot(law.nu[0], law.nu[1]), planar_speed),
        "heave speed": (limits.heave_m_s - abs(float(law.nu[2])), spread[W, W]),
        "yaw rate": (limits.yaw_rate_rad_s, spread[R, R]),
    }
    for i, name in enumerate(limits.thrusters or [f"thruster {i + 1}" for i in range(len(law.thrust_n))]):
        slacks[f"{name} thrust"] = (float(limits.thrust_n[i] - abs(law.thrust_n[i])), feedback[i])
    levels = {name: math.copysign(slack * slack, slack) / float(size) for name, (slack, size) in slacks.items()}
    binding = min(levels, key=lambda name: levels[name])
    return max(levels[binding], 0.0), binding


def closed_loop(model: Model4, law: Terminal, error: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Errors (m, 8) after one REFERENCE_DT_S of the nonlinear model under the local law (RK4), and stage costs (m,)."""
    feedback = error @ law.k.T
    cost = (error * error) @ law.q + (feedback * feedback) @ law.r
    thrust = law.thrust_n + feedback
    c, s = math.cos(law.yaw_rad), math.sin(law.yaw_rad)
    u, v, w, _ = (float(x) for x in law.nu)
    current = (-(c * u - s * v), -(s * u + c * v), -w)
    offset = np.array([0.0, 0.0, 0.0, law.yaw_rad, *law.nu])
    state = error + offset
    state[:, 0], state[:, 1] = c * error[:, 0] - s * error[:, 1], s * error[:, 0] + c * error[:, 1]

    def f(x: FloatArray) -> FloatArray:
        return np.stack(model4.state_derivative(model, list(x.T), list(thrust.T), current, np), axis=1)

    after = model4.rk4(f, state, REFERENCE_DT_S) - offset
    after[:, 0], after[:, 1] = c * after[:, 0] + s * after[:, 1], c * after[:, 1] - s * after[:, 0]
    return after, cost


def violations(model: Model4, law: Terminal, error: FloatArray) -> int:
    """Number of errors (m, 8) whose E decreases by less than the stage cost in one step."""
    after, cost = closed_loop(model, law, error)
    change = ((after @ law.p) * after).sum(axis=1) - ((error @ law.p) * error).sum(axis=1)
    return int((change > -cost).sum())


@lru_cache(maxsize=4)
def unit_samples(count: int = TERMINAL.samples, seed: int = TERMINAL.seed) -> FloatArray:
    """(count, 8) points of the unit ball: half on its surface, half inside (radius uniform)."""
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(count, NX))
    points /= np.linalg.norm(points, axis=1)[:, None]
    points[1::2] *= rng.uniform(0.02, 1.0, size=(len(points[1::2]), 1))
    points.setflags(write=False)
    return points


class CertificateJob:
    """The verification of one goal in slices."""

    def __init__(self, model: Model4, law: Terminal, goal: Goal, limits: TerminalLimits, samples: FloatArray) -> None:
        self._model, self._law, self._goal, self._limits, self._samples = model, law, goal, limits, samples
        self._alpha, self._binding = analytic_alpha(law, goal, limits)
        self._to_error = np.linalg.inv(np.linalg.cholesky(law.p)).T
        self._done = 0
        self._shrunk = 0
        self.certificate: Certificate | None = None
        """Set once all samples are checked."""
        if self._alpha < TERMINAL.least_alpha:
            self._alpha = 0.0
            self.certificate = self._certify()

    def advance(self, count: int) -> Certificate | None:
        """Check the next ``count`` samples. The certificate once all are checked, else None."""
        if self.certificate is None:
            part = self._samples[self._done : self._done + count]
            error = math.sqrt(self._alpha) * (part @ self._to_error.T)
            if violations(self._model, self._law, error):
                self._alpha *= TERMINAL.shrink
                self._shrunk += 1
                self._done = 0
                if self._alpha < TERMINAL.least_alpha:
                    self._alpha, self._binding = 0.0, "decrease"
                    self.certificate = self._certify()
            else:
                self._done += len(part)
                if self._done >= len(self._samples):
                    self.certificate = self._certify()
        return self.certificate

    def _certify(self) -> Certificate:
        spread = np.linalg.inv(self._law.p) * self._alpha
        goal, limits = self._goal, self._limits
        depth = float(goal.pos_ned_m[2])
        vertical_m = min(depth - limits.depth_min_m, limits.depth_max_m - depth)
        return Certificate(
            alpha=self._alpha,
            binding="decrease" if self._shrunk else self._binding,
            radius_m=math.sqrt(float(np.linalg.eigvalsh(spread[:2, :2])[-1])),
            depth_m=math.sqrt(float(spread[Z, Z])),
            yaw_rad=math.sqrt(float(spread[YAW, YAW])),
            planar_speed_m_s=math.sqrt(float(np.linalg.eigvalsh(spread[U : V + 1, U : V + 1])[-1])),
            accept_radius_m=goal.accept_radius_m,
            fits=goal.accept_radius_m <= min(limits.clearance_m, vertical_m),
            fit_radius_m=min(limits.clearance_m, vertical_m),
            fit_limit="clearance" if limits.clearance_m < vertical_m else "depth",
            samples=self._done,
            violations=0,
            shrunk=self._shrunk,
        )


def certify(
    model: Model4,
    law: Terminal,
    goal: Goal,
    limits: TerminalLimits,
    samples: FloatArray | None = None,
    check: Callable[[], None] = lambda: None,
) -> Certificate:
    """Verify a terminal region by sampling the nonlinear model.

    Parameters
    ----------
    model
        The 4-DoF model.
    law
        Steady input, gain and cost at the goal.
    goal
        Position, heading and acceptance radius.
    limits
        Limits that the region has to meet.
    samples
        (m, 8) points of the unit ball; None = :func:`unit_samples`.
    look
        Called between slices; an exception from it ends the work.
    """
    job = CertificateJob(model, law, goal, limits, unit_samples() if samples is None else samples)
    while job.certificate is None:
        check()
        job.advance(2_000)
    return job.certificate


def region_error(law: Terminal, x: FloatArray, pos_ned_m: FloatArray) -> FloatArray:
    """Error (8,) of a state ``x`` (8,) relative to rest over ground at ``pos_ned_m`` (3,), in the frame of the goal."""
    c, s = math.cos(law.yaw_rad), math.sin(law.yaw_rad)
    e = np.empty(NX)
    north, east = float(x[X] - pos_ned_m[0]), float(x[1] - pos_ned_m[1])
    e[0], e[1], e[2] = c * north + s * east, c * east - s * north, x[Z] - pos_ned_m[2]
    turn = float(x[YAW]) - law.yaw_rad
    e[YAW] = turn - 2.0 * math.pi * round(turn / (2.0 * math.pi))
    e[U:] = x[U:] - law.nu
    return e
