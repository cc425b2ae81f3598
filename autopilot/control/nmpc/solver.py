"""Real-time iteration: one Gauss-Newton QP per control step, warm-started by the shifted last plan (Diehl et al.
2005).

Holds the compiled step of :mod:`autopilot.control.nmpc.ocp` and its argument arrays; nothing is allocated or built
after construction. The first solver that passes a self-test is used.
"""

import ctypes
import dataclasses
import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from autopilot.control.nmpc import ocp
from autopilot.control.nmpc.grid import REFERENCE_DT_S, TimeGrid, shift_matrices
from autopilot.control.nmpc.model_code import BUOYANCY, coefficients
from autopilot.core import compiled
from autopilot.core.control_allocator import least_in_box
from autopilot.core.errors import ConfigError
from autopilot.core.frames import FloatArray
from autopilot.core.messages import SolveStatus
from autopilot.core.model4 import NX, Model4, U, rk4, state_derivative

PLANES = 8
"""Half-plane slots per stage: four walls of a tank and four obstacles."""

VIOLATION_LIMIT = 1e-3
"""Largest violation of a QP row (dynamics in SI units, constraints in metres and m/s) that counts as solved."""

OVERSHOOT_LIMIT_N = 1e-3
"""Largest thrust beyond its bound that counts as solved (it is clipped)."""

GUESS_LIMIT = 100.0
"""m/s, rad/s: around a guess that moves faster (or is no number) nothing can be linearised; solvers would print it."""

SELF_TEST_WAY = np.array([0.2, 0.1, 0.1, 0.2, 0.0, 0.0, 0.0, 0.0])
"""Reference state of the self-test, from rest."""

SELF_TEST_WEIGHTS = np.array([20.0, 20.0, 40.0, 3.0, 1.0, 1.0, 1.0, 0.5])
SELF_TEST_THRUST_WEIGHT = 0.02

SELF_TEST_TOLERANCE = 0.05
"""Tolerance of the self-test, relative to the thrust bound and to the distance."""
FIGURES = 8
"""As the other solvers' six, then interior point iterations and whether the program is unsolved."""

ARRAYS = (
    *("coefficients", "allocation", "step_s", "steps", "scale", "x_guess", "u_guess", "x_ref", "u_ref", "current"),
    *("weight_x", "weight_u", "terminal", "limits", "thrust_limit", "plane_n", "plane_d"),
    *("x", "u", "slack", "figures", "work"),
)


class _Task(compiled.Mirror):
    """ctypes layout of the struct in task.h."""

    _fields_ = (
        ("n", ctypes.c_long),
        ("thrusters", ctypes.c_long),
        ("slack_l1", ctypes.c_double),
        ("slack_l2", ctypes.c_double),
        *((name, ctypes.c_void_p) for name in ARRAYS),
    )


class NativeStep(ocp.StepArrays):
    """The step in C with its argument and result arrays; the same interface as :class:`QpStep`.

    RuntimeError when there is none for this machine or vehicle.

    Part of the compiled library (:mod:`autopilot.core.compiled`), which serves all vehicles: the coefficients are
    arguments. If it is missing, does not support the vehicle or fails the self-test, the next solver is used."""

    def __init__(self, model: Model4, grid: TimeGrid, planes: int, backend: ocp.QpBackend) -> None:
        if planes != PLANES:
            raise RuntimeError(f"made for {PLANES} half-planes, not {planes}")
        if compiled.switched_off():
            raise RuntimeError(f"switched off by {compiled.SWITCH}={compiled.OFF}")
        library = compiled.load(_Task)
        size = library.workspace_bytes(grid.n, model.thrusters)
        if size == 0:
            raise RuntimeError(f"not made for {model.thrusters} thrusters")
        n = grid.n
        self.backend = backend
        super().__init__(model, n, planes)
        self.figures = np.zeros(FIGURES)
        steps = np.array(grid.substeps(ocp.longest_step_s(model)), dtype=float)
        self._arrays: dict[str, FloatArray] = {
            **self.arguments,
            "step_s": grid.dt_s / steps,
            "steps": steps,
            "scale": grid.dt_s / REFERENCE_DT_S,
            "x": self.x,
            "u": self.u,
            "slack": self.slack,
            "figures": self.figures,
            "work": np.zeros(size // 8 + 1),
            "coefficients": np.array(coefficients(model)),
            "allocation": np.array(model.allocation),
        }
        addresses = {name: self._arrays[name].ctypes.data for name in ARRAYS}
        self._task = _Task(n=n, thrusters=model.thrusters, slack_l1=ocp.SLACK_L1, slack_l2=ocp.SLACK_L2, **addresses)
        self._reference, self._call = ctypes.byref(self._task), library.control_step

    def evaluate(self) -> None:
        """Linearise at the guess, solve, write the results. An unsolved program has an infinite violation."""
        self._arrays["coefficients"][BUOYANCY] = self.buoyancy[0, 0]
        self._call(self._reference)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class NmpcProblem:
    """Data of one QP that change from step to step. N intervals; state order of :mod:`autopilot.core.model4`."""

    x0: FloatArray
    """(8,) present state, yaw on the same turn as the references."""
    x_ref: FloatArray
    """(N+1, 8)"""
    thrust_ref_n: FloatArray
    """(N, thrusters), cut to the bounds inside."""
    current_ned_m_s: FloatArray
    """(N, 3) per stage."""
    weight_x: FloatArray
    """(8,) or (N-1, 8) on the state at nodes 1 .. N-1, per REFERENCE_DT_S."""
    weight_u: FloatArray
    """(thrusters,) or (N, thrusters) on the thrust, per REFERENCE_DT_S."""
    terminal: FloatArray
    """(8, 8) Hessian of the terminal cost, positive semidefinite."""
    limits: FloatArray
    """(5,) or (N-1, 5): planar speed, heave, yaw rate, depth minimum, depth maximum at nodes 1 .. N-1."""
    thrust_limit_n: FloatArray
    """(thrusters,) or (N, thrusters)"""
    plane_n: FloatArray
    """(N-1, PLANES, 2) unit normals of the half-planes n . p >= d at stages 1 .. N-1; zero = unused."""
    plane_d_m: FloatArray
    """(N-1, PLANES)"""
    buoyancy_excess_n: FloatArray
    """(1,) buoyancy minus weight [N] as it has proved to be, positive floats up."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class NmpcResult:
    """Solution of one QP. With a status other than OK, ``x`` and ``thrust_n`` are the previous plan."""

    status: SolveStatus
    x: FloatArray
    """(N+1, 8) predicted states."""
    thrust_n: FloatArray
    """(N, thrusters) planned thrust."""
    cost: float
    """Decrease of the cost that the last QP predicted, plus penalties."""
    slack_max: float
    gap_max: float
    """Largest defect of the guess in the dynamics."""
    penalty_use: float
    """Largest multiplier of a soft constraint over the penalty's slope: above 0 a limit is touched, at 1 given up."""


class QpStep(ocp.StepArrays):
    """QP step as a CasADi function."""

    def __init__(self, model: Model4, grid: TimeGrid, planes: int, backend: ocp.QpBackend) -> None:
        super().__init__(model, grid.n, planes)
        self.backend = backend
        function = _build(dataclasses.astuple(model), tuple(grid.dt_s.tolist()), planes, backend)
        self.figures = np.zeros(6)
        self._multipliers = np.zeros(function.nnz_out("multipliers"))
        results = (self.x, self.u, self.slack, self.figures, self._multipliers)
        self._owner, self._evaluate = ocp.bind(function, list(self.arguments.values()), results)

    def evaluate(self) -> None:
        """Linearise at the guess, solve, write the results."""
        self._evaluate()


@lru_cache(maxsize=8)
def _build(model_values: tuple[Any, ...], dt_s: tuple[float, ...], planes: int, backend: ocp.QpBackend) -> Any:
    """The built function is pure; controllers of the same vehicle and grid share it."""
    dt = np.array(dt_s)
    grid = TimeGrid(dt_s=dt, t_s=np.concatenate(([0.0], np.cumsum(dt))))
    fields = (field.name for field in dataclasses.fields(Model4))
    model = Model4(**dict(zip(fields, model_values, strict=True)))
    return ocp.build_qp_step(model, grid, planes, backend)


def passes_self_test(step: QpStep | NativeStep, model: Model4, grid: TimeGrid) -> bool:
    """Solve one problem with a known solution: from rest to a position close by, with thrust bounds of half the
    optimum.

    Condensed, it is a QP with bounds only (:func:`_condensed`), small enough for an independent solver. Thrust of the
    first interval and the final state have to agree, and all residuals have to be small.
    """
    step.x_guess[:] = 0.0
    step.u_guess[:] = 0.0
    step.x_ref[:] = SELF_TEST_WAY
    step.u_ref[:] = 0.0
    step.current[:] = 0.0
    step.weight_x[:] = SELF_TEST_WEIGHTS
    step.weight_u[:] = SELF_TEST_THRUST_WEIGHT
    step.terminal[:] = ocp.TERMINAL_STAGES * np.diag(SELF_TEST_WEIGHTS)
    step.limits[:] = [10.0, 10.0, 10.0, -10.0, 10.0]
    step.plane_n[:] = 0.0
    step.plane_d[:] = -1.0
    hessian, gradient, moved, effect = _condensed(model, grid)
    bound_n = 0.5 * float(np.abs(np.linalg.solve(hessian, gradient)[: model.thrusters]).max())
    step.thrust_limit[:] = bound_n
    thrust = least_in_box(hessian, gradient, np.full(len(gradient), bound_n))
    step.evaluate()
    return bool(
        np.isfinite(step.figures).all()
        and step.figures[1] < VIOLATION_LIMIT
        and step.figures[3] < OVERSHOOT_LIMIT_N
        and np.abs(step.u[0] - thrust[: model.thrusters]).max() < SELF_TEST_TOLERANCE * bound_n
        and np.abs(step.x[-1] - moved - effect @ thrust).max() < SELF_TEST_TOLERANCE * float(SELF_TEST_WAY.max())
    )


def _condensed(model: Model4, grid: TimeGrid) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Condensed self-test: Hessian and gradient over all thrusts (N n,), final state without thrust, and its
    sensitivity (8, N n). Derivatives by complex steps.
    """
    count, n = model.thrusters, grid.n
    hessian, gradient = np.zeros((n * count, n * count)), np.zeros(n * count)
    state, effect = np.zeros(NX), np.zeros((NX, n * count))
    substeps = grid.substeps(ocp.longest_step_s(model))
    pushed = np.eye(NX + count)[NX:] * 1e-20j

    def slope(x: Any) -> Any:
        return np.stack(state_derivative(model, list(x), list(pushed), (0.0,) * 3, np))

    for k in range(n):
        after: Any = np.hstack([np.eye(NX) * 1e-20j, np.zeros((NX, count))])
        for _ in range(substeps[k]):
            after = rk4(slope, after, float(grid.dt_s[k]) / substeps[k])
        slopes = np.imag(after) / 1e-20
        # The guess stands still: one interval takes it to where rest takes it.
        state = slopes[:, :NX] @ state + np.real(after[:, 0])
        effect = slopes[:, :NX] @ effect
        effect[:, k * count : (k + 1) * count] = slopes[:, NX:]
        scale = float(grid.dt_s[k]) / REFERENCE_DT_S
        own = np.arange(k * count, (k + 1) * count)
        hessian[own, own] += scale * SELF_TEST_THRUST_WEIGHT
        weight = ocp.TERMINAL_STAGES if k == n - 1 else float(grid.dt_s[k + 1]) / REFERENCE_DT_S
        weighed = weight * SELF_TEST_WEIGHTS[:, None] * effect
        hessian += weighed.T @ effect
        gradient += weighed.T @ (state - SELF_TEST_WAY)
    return hessian, gradient, state, effect


def choose_step(
    model: Model4, grid: TimeGrid, planes: int, backends: tuple[ocp.QpBackend, ...]
) -> tuple[QpStep | NativeStep, tuple[str, ...]]:
    """The first QP backend that passes the self-test.

    Returns
    -------
    step
        The compiled step with its argument arrays.
    reasons
        One line for each backend before it, with the reason for its rejection.

    Raises
    ------
    ConfigError
        No backend passes.
    """
    reasons = []
    for backend in backends:
        try:
            kind = NativeStep if backend is ocp.NATIVE else QpStep
            step = kind(model, grid, planes, backend)
        except RuntimeError as error:
            reasons.append(f"{backend.plugin}: {str(error).splitlines()[-1]}")
            continue
        if passes_self_test(step, model, grid):
            return step, tuple(reasons)
        reasons.append(f"{backend.plugin}: wrong answer in the self-test")
    raise ConfigError(f"no QP solver works ({'; '.join(reasons)}); reinstall casadi from its binary wheel")


class Nmpc:
    """Real-time iteration NMPC: holds the plan, states ``x`` (N+1, 8) and thrust ``u`` (N, thrusters) [N].

    Parameters
    ----------
    model
        The 4-DoF model.
    grid
        Prediction grid of N intervals.
    planes
        Half-planes per stage.
    backends
        QP solvers in order of preference.
    """

    def __init__(
        self,
        model: Model4,
        grid: TimeGrid,
        *,
        planes: int = PLANES,
        backends: tuple[ocp.QpBackend, ...] = ocp.BACKENDS,
    ) -> None:
        self.model, self.grid = model, grid
        self.planes = planes
        self._step, passed_over = choose_step(model, grid, planes, backends)
        self.slower = "; ".join(passed_over)
        """Why solvers that are quicker than the one in use are not used; empty when there is none."""
        self._fastest = ocp.fastest_guess(model)
        self._shifts: dict[float, tuple[FloatArray, FloatArray]] = {}
        self.x = np.zeros((grid.n + 1, NX))
        self.u = np.zeros((grid.n, model.thrusters))
        self.last_problem: NmpcProblem | None = None
        """The last problem (its arrays may be the caller's), for comparisons."""
        self.violation = 0.0
        """Largest of a row of the last QP."""

    @property
    def solver(self) -> str:
        """Name of the solver in use."""
        return self._step.backend.plugin

    @property
    def guess(self) -> tuple[FloatArray, FloatArray]:
        """Linearisation point of the last QP: states (N+1, 8) and thrust (N, thrusters) [N]."""
        return self._step.x_guess.copy(), self._step.u_guess.copy()

    def set_plan(self, x: FloatArray, thrust_n: FloatArray) -> None:
        """Replace the plan: states (N+1, 8) and thrust (N, thrusters) [N]."""
        self.x[:], self.u[:] = x, thrust_n

    def shift(self, delta_s: float) -> None:
        """Shift the plan by ``delta_s`` [s] (warm start), interpolated on the grid."""
        key = round(delta_s, 6)
        if key not in self._shifts:
            if len(self._shifts) > 64:
                self._shifts.clear()
            self._shifts[key] = shift_matrices(self.grid, key)
        states, inputs = self._shifts[key]
        self.x[:] = states @ self.x
        self.u[:] = inputs @ self.u

    def _slow_down(self, x: FloatArray) -> None:
        """Bring states (m, 8) of a guess to speeds at which the prediction's integration is stable."""
        planar_m_s, heave_m_s, yaw_rate_rad_s = self._fastest
        moves = x[:, U:]
        if float(np.abs(moves).max()) <= min(0.7 * planar_m_s, heave_m_s, yaw_rate_rad_s):
            return
        moves[:, :2] *= np.minimum(1.0, planar_m_s / np.maximum(np.hypot(moves[:, 0], moves[:, 1]), 1e-9))[:, None]
        np.clip(moves[:, 2:], (-heave_m_s, -yaw_rate_rad_s), (heave_m_s, yaw_rate_rad_s), out=moves[:, 2:])

    def solve(self, problem: NmpcProblem) -> NmpcResult:
        """Solve one Gauss-Newton QP around the present plan.

        Parameters
        ----------
        problem
            Initial state, references, weights, bounds and half-planes.

        Returns
        -------
        NmpcResult
            ``status`` OK only if the solution is finite and satisfies every row of the QP to VIOLATION_LIMIT; only
            then it replaces the plan. The arrays are views of the plan. No exceptions: a failure of the solver is a
            status.
        """
        step, self.last_problem = self._step, problem
        step.x_guess[:] = self.x
        step.x_guess[0] = problem.x0
        step.u_guess[:] = self.u
        step.x_ref[:] = problem.x_ref
        step.u_ref[:] = problem.thrust_ref_n
        step.current[:] = problem.current_ned_m_s
        step.weight_x[:] = problem.weight_x
        step.weight_u[:] = problem.weight_u
        step.terminal[:] = problem.terminal
        step.buoyancy[:] = problem.buoyancy_excess_n
        step.limits[:] = problem.limits
        step.thrust_limit[:] = problem.thrust_limit_n
        step.plane_n[:] = problem.plane_n
        step.plane_d[:] = problem.plane_d_m
        if not (float(np.abs(step.x_guess[:, U:]).max()) < GUESS_LIMIT and step.complete()):
            return NmpcResult(
                status=SolveStatus.NOT_FINITE,
                x=self.x,
                thrust_n=self.u,
                cost=math.nan,
                slack_max=math.nan,
                gap_max=math.nan,
                penalty_use=math.nan,
            )
        self._slow_down(step.x_guess[1:])
        status = SolveStatus.OK
        try:
            step.evaluate()
        except RuntimeError:
            status = SolveStatus.EXCEPTION
        cost, violation, gap, overshoot, total, use = step.figures[:6].tolist()
        self.violation = violation
        if status is SolveStatus.OK:
            if not math.isfinite(total + gap):
                status = SolveStatus.NOT_FINITE
            elif not (violation < VIOLATION_LIMIT and overshoot < OVERSHOOT_LIMIT_N):
                status = SolveStatus.RESIDUAL
        if status is SolveStatus.OK:
            self.x[:] = step.x
            self.u[:] = step.u
        return NmpcResult(
            status=status,
            x=self.x,
            thrust_n=self.u,
            cost=cost,
            slack_max=float(step.slack.max()),
            gap_max=gap,
            penalty_use=use,
        )
