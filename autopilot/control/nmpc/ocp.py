"""The optimal control problem of the paper (section III, eq. 12) as a CasADi function: linearisation, one QP,
unpacking.

Decision variables per stage: state (8), thrust (one per thruster) and, from stage 1 on, two slacks: one shared by the
speed limits, one by depth band and half-planes, so that a vehicle outside its workspace does not exceed its speed
limits on the way back. The first state is given and is not a variable. Everything that changes at run time is an
argument: fence, current, weights and limits need no rebuild. The QP is in increments from the guess (Gauss-Newton: the
residuals are linear in state and input, so the Hessian is exact up to the curvature of the dynamics).

* dynamics: RK4 on :mod:`autopilot.core.model4`, intervals subdivided for stability (:func:`longest_step_s`); a guess
  beyond the speeds of :func:`fastest_guess` is not linearised
* hard constraints: thrust, per thruster
* soft constraints with an exact penalty (L1 + L2 on the slack): planar speed, heave, yaw rate, depth band, half-planes
* planar speed: the Euclidean norm of (u, v), linearised in the direction of the guess
* terminal cost: any symmetric matrix; by default :data:`TERMINAL_STAGES` of the state weights, a tail of 2 s at the
  rate of the running cost. An LQR tail of a loop with a settling time constant of 4 s has this size; unlike the DARE
  solution at hover it is independent of heading (position is in the world frame, velocity in the body frame), and it
  needs no equilibrium where the horizon ends within a leg.

Weights, limits and bounds are given per node, so that margins may grow along the prediction.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from autopilot.control.nmpc.grid import MAX_RK4_STEP_S, REFERENCE_DT_S, TimeGrid
from autopilot.core import model4
from autopilot.core.frames import FloatArray
from autopilot.core.model4 import AXES, NX, R, U, V, W, Z

N_LIMITS = 5
"""Planar speed [m/s], heave [m/s], yaw rate [rad/s], depth minimum and maximum [m]."""

N_SLACKS = 2
"""Of the speeds [m/s, rad/s] and of the places [m]."""

N_BOX_ROWS = 4
"""Soft rows per stage beside the half-planes: speed, heave, yaw rate, depth. Two-sided limits enter with the side that
is nearer to the guess: a step never crosses from one limit to the other, and HPIPM pays for every row (8 half-planes
and these 4 fill three of its 4-row panels)."""

SLACK_L1 = 1e3
SLACK_L2 = 1e3
"""Exact penalty per stage of 0.1 s; above the multipliers that occur, small enough for the QP's conditioning."""

TERMINAL_STAGES = 20.0
SPEED_EPSILON_M_S = 0.02
"""Below this guess the speed constraint has no direction and is relaxed."""


ENVELOPE = (1.0, 0.6, 1.25)
"""Planar speed, heave [m/s] and yaw rate [rad/s] through the water up to which predictions have to be accurate: the
limits of plans (SPD_*_MAX) plus disturbances and errors of the current."""

FASTEST_TURN_RAD_S = 5.0
"""No vehicle that this controller is for turns faster."""

FARTHER = (3.0, 2.0, 1.5, 1.2)
"""Times the envelope, where the integration is good for that as well."""

RK4_REACH = 2.5
"""Rate times step up to which RK4 is stable (2.78) and worth something."""


@dataclass(frozen=True, eq=False, kw_only=True)
class QpBackend:
    """A QP plugin of CasADi with its options."""

    plugin: str
    options: dict[str, Any]
    staged: bool
    """Takes the stage structure (N, nx, nu, ng)."""


HPIPM = QpBackend(
    plugin="hpipm",
    options={"hpipm": {"mode": "balance", "iter_max": 100, "mu0": 100.0}},
    staged=True,
)
"""Riccati interior point. Its quicker modes stop early and call that solved: first thrusts are up to 1 N off where a
state is far from the plan. This one is 0.0002 N off, in a hundred iterations at most."""

PIQP = QpBackend(plugin="piqp", options={"piqp": {"kkt_solver": "sparse_ldlt_ineq_cond"}}, staged=False)
"""Slower by half, with the shortest tail; the fallback where the first does not work."""


NATIVE = QpBackend(plugin="native", options={}, staged=True)
"""The step in C (:mod:`autopilot.control.nmpc.solver`), where it was compiled at installation."""

BACKENDS = (NATIVE, HPIPM, PIQP)
"""In the order in which they are tried."""


def bind(
    function: Any, arguments: Sequence[FloatArray], results: Sequence[FloatArray]
) -> tuple[Any, Callable[[], None]]:
    """Tie a CasADi function to arrays: (owner, call). The call reads and writes the arrays and allocates nothing.

    Arrays are C-contiguous and transposed with respect to CasADi's column-major matrices. Keep the owner alive.
    """
    buffer, call = function.buffer()
    for i, array in enumerate(arguments):
        buffer.set_arg(i, array.data)
    for i, array in enumerate(results):
        buffer.set_res(i, array.data)
    return (function, buffer), call


def discrete_dynamics(model: model4.Model4, dt_s: float, substeps: int) -> ca.Function:
    """RK4 over one interval: (x, thrust_n, current_ned_m_s) -> (x_next, A (8, 8), B (8, n))."""
    x, u, c = ca.SX.sym("x", NX), ca.SX.sym("u", model.thrusters), ca.SX.sym("c", 3)
    moved: Any = trimmed_dynamics(model, dt_s, substeps)(x, u, c, model.buoyancy_excess_n)
    return ca.Function("interval", [x, u, c], list(moved))


def trimmed_dynamics(model: model4.Model4, dt_s: float, substeps: int) -> ca.Function:
    """As :func:`discrete_dynamics`, with the excess buoyancy [N] as fourth argument."""
    x, u, c = ca.SX.sym("x", NX), ca.SX.sym("u", model.thrusters), ca.SX.sym("c", 3)
    lift: Any = ca.SX.sym("lift")
    h = dt_s / substeps
    trimmed = replace(model, buoyancy_excess_n=lift)

    def f(state: Any) -> Any:
        return ca.vertcat(*model4.state_derivative(trimmed, ca.vertsplit(state), ca.vertsplit(u), ca.vertsplit(c), ca))

    x_next = model4.rk4(f, x, h)
    single = ca.Function("rk4", [x, u, c, lift], [x_next, ca.jacobian(x_next, x), ca.jacobian(x_next, u)])
    state, a, b = x, ca.SX.eye(NX), ca.SX(NX, model.thrusters)
    for _ in range(substeps):
        state, a_step, b_step = single(state, u, c, lift)
        a, b = ca.mtimes(a_step, a), ca.mtimes(a_step, b) + b_step
    return ca.Function("interval", [x, u, c, lift], [state, a, b])


def _fastest_rate_1_s(model: model4.Model4, scale: float) -> float:
    """Largest modulus of the eigenvalues of d nu'/d nu [1/s] at ``scale`` times the ENVELOPE.

    Surge and sway together turn the vehicle (Munk moment): the yaw rate that results belongs to the envelope.
    """
    planar_m_s, heave_m_s, turn_rad_s = scale * np.array(ENVELOPE)
    munk_nm = 0.5 * abs(model.mass_kg[0] - model.mass_kg[1]) * planar_m_s**2
    turn_rad_s = max(turn_rad_s, min(math.sqrt(munk_nm / max(model.quadratic_drag[3], 1e-9)), FASTEST_TURN_RAD_S))
    course, turn = (
        a.ravel() for a in np.meshgrid(np.linspace(-math.pi, math.pi, 17), turn_rad_s * np.linspace(-1, 1, 5))
    )
    nu = np.stack([planar_m_s * np.cos(course), planar_m_s * np.sin(course), np.full_like(course, heave_m_s), turn])
    slopes = []
    for axis in range(AXES):
        aside = nu.astype(complex)
        aside[axis] += 1e-20j
        slopes.append(
            np.imag(np.stack(model4.body_acceleration(model, list(aside), (0.0,) * model.thrusters, np))) / 1e-20
        )
    return float(np.abs(np.linalg.eigvals(np.array(slopes).transpose(2, 1, 0))).max())


def longest_step_s(model: model4.Model4) -> float:
    """Longest stable RK4 step of the prediction [s]. Light vehicles with large drag are stiff (yaw of the LBV150
    decays with 12 1/s); beyond this step the integration diverges.
    """
    return min(MAX_RK4_STEP_S, RK4_REACH / _fastest_rate_1_s(model, 1.0))


def fastest_guess(model: model4.Model4) -> tuple[float, float, float]:
    """Planar speed, heave [m/s] and yaw rate [rad/s] through the water up to which predictions have to be accurate: the
    limits of plans (SPD_*_MAX) plus disturbances and errors of the current."""
    reach = RK4_REACH / longest_step_s(model)
    scale = next((s for s in FARTHER if _fastest_rate_1_s(model, s) <= reach), 1.0)
    return scale * ENVELOPE[0], scale * ENVELOPE[1], scale * ENVELOPE[2]


def argument_shapes(n: int, planes: int, thrusters: int) -> dict[str, tuple[int, int]]:
    """Arguments of the step and their shapes (rows, columns), in order.

    State and thrust of the guess and of the reference, current, weights per node (8 at nodes 1 .. N-1, one per
    thruster at 0 .. N-1, per :data:`REFERENCE_DT_S`), Hessian of the terminal cost, excess buoyancy [N], limits at
    nodes 1 .. N-1, thrust bounds, half-planes at nodes 1 .. N-1.
    """
    return {
        "x_guess": (NX, n + 1),
        "u_guess": (thrusters, n),
        "x_ref": (NX, n + 1),
        "u_ref": (thrusters, n),
        "current": (3, n),
        "weight_x": (NX, n - 1),
        "weight_u": (thrusters, n),
        "terminal": (NX, NX),
        "buoyancy": (1, 1),
        "limits": (N_LIMITS, n - 1),
        "thrust_limit": (thrusters, n),
        "plane_n": (2, planes * (n - 1)),
        "plane_d": (planes, n - 1),
    }


class StepArrays:
    """Arguments and results of one step; the arguments are views of one block of memory."""

    def __init__(self, model: model4.Model4, n: int, planes: int) -> None:
        shapes = argument_shapes(n, planes, model.thrusters)
        ends = np.cumsum([rows * columns for rows, columns in shapes.values()])
        self._block = np.zeros(ends[-1])
        parts = np.split(self._block, ends[:-1])
        self.arguments: dict[str, FloatArray] = {
            name: part.reshape(shape[::-1]) for (name, shape), part in zip(shapes.items(), parts, strict=True)
        }
        """By name, transposed with respect to CasADi's column-major matrices."""
        bounds = list(shapes).index("limits")
        self._numbers, self._bounds = self._block[: ends[bounds - 1]], self._block[ends[bounds - 1] :]
        each = list(self.arguments.values())
        self.x_guess, self.u_guess, self.x_ref, self.u_ref, self.current = each[:5]
        self.weight_x, self.weight_u, self.terminal, self.buoyancy, self.limits, self.thrust_limit = each[5:11]
        self.plane_n, self.plane_d = each[11].reshape(n - 1, planes, 2), each[12]
        self.buoyancy[:] = model.buoyancy_excess_n
        self.x, self.u, self.slack = np.zeros((n + 1, NX)), np.zeros((n, model.thrusters)), np.zeros((n - 1, N_SLACKS))

    def complete(self) -> bool:
        """Whether all arguments are finite and no bound is NaN (bounds may be infinite): solvers treat NaN as full
        thrust.
        """
        return bool(np.isfinite(self._numbers).all() and not np.isnan(self._bounds).any())


def build_qp_step(model: model4.Model4, grid: TimeGrid, planes: int, backend: QpBackend) -> ca.Function:
    """Build the control step (linearisation, QP, unpacking) as one CasADi function.

    Parameters
    ----------
    model
        The 4-DoF model.
    grid
        Prediction grid of N intervals.
    planes
        Half-planes per stage.
    backend
        The QP solver.

    Returns
    -------
    casadi.Function
        Arguments: :func:`argument_shapes`; the first column of ``x_guess`` is the present state. Results: ``x``
        (8, N+1), ``u`` (thrusters, N) [N], ``slack`` (2, N-1), ``figures`` (6: cost; largest violation of a QP row;
        largest gap of the guess; largest overshoot of a thrust bound before clipping [N]; sum of the step, not finite
        if any entry is not; largest multiplier of a soft row relative to the penalty's slope), ``multipliers``.
    """
    n = grid.n
    nu = model.thrusters
    shapes = argument_shapes(n, planes, nu)
    names = list(shapes)
    arguments = [ca.SX.sym(name, *shape) for name, shape in shapes.items()]
    xg, ug, xref, uref, cur, weight_x, weight_u, terminal, buoyancy, limits, tlim, plane_n, plane_d = arguments

    scale = [dt / REFERENCE_DT_S for dt in grid.dt_s]
    intervals: dict[tuple[float, int], ca.Function] = {}
    blocks: list[list[Any]] = []
    hessian, gradient, lower, upper, row_low, row_high, gaps = [], [], [], [], [], [], []
    for k, (dt, substeps) in enumerate(zip(grid.dt_s, grid.substeps(longest_step_s(model)), strict=True)):
        key = (float(dt), substeps)
        if key not in intervals:
            intervals[key] = trimmed_dynamics(model, dt, substeps)
        x_next, a, b = intervals[key](xg[:, k], ug[:, k], cur[:, k], buoyancy)
        gap = x_next - xg[:, k + 1]
        gaps.append(gap)
        row_low.append(-gap)
        row_high.append(-gap)
        u_ref = ca.fmax(-tlim[:, k], ca.fmin(tlim[:, k], uref[:, k]))
        if k > 0:
            hessian.append(ca.diag(scale[k] * weight_x[:, k - 1]))
            gradient.append(scale[k] * weight_x[:, k - 1] * (xg[:, k] - xref[:, k]))
            lower.append(-ca.inf * ca.SX.ones(NX))
            upper.append(ca.inf * ca.SX.ones(NX))
        hessian.append(ca.diag(scale[k] * weight_u[:, k]))
        gradient.append(scale[k] * weight_u[:, k] * (ug[:, k] - u_ref))
        lower.append(-tlim[:, k] - ug[:, k])
        upper.append(tlim[:, k] - ug[:, k])
        if k > 0:
            hessian.append(scale[k] * SLACK_L2 * ca.SX.eye(N_SLACKS))
            gradient.append(scale[k] * SLACK_L1 * ca.SX.ones(N_SLACKS))
            lower.append(ca.SX.zeros(N_SLACKS))
            upper.append(ca.inf * ca.SX.ones(N_SLACKS))
            c_rows, values = _soft_rows(
                xg[:, k], limits[:, k - 1], plane_n[:, (k - 1) * planes : k * planes], plane_d[:, k - 1], nu
            )
            row_low.append(-ca.inf * ca.SX.ones(c_rows.shape[0]))
            row_high.append(-values)
            blocks.append([a, ca.horzcat(b, ca.SX(NX, N_SLACKS)), c_rows])
        else:
            blocks.append([a, b, None])
    hessian.append(terminal)
    gradient.append(ca.mtimes(terminal, xg[:, n] - xref[:, n]))
    lower.append(-ca.inf * ca.SX.ones(NX))
    upper.append(ca.inf * ca.SX.ones(NX))

    constraint = _assemble(blocks, planes + N_BOX_ROWS, nu)
    linearise = ca.Function(
        "linearise",
        arguments,
        [
            ca.diagcat(*hessian),
            ca.vertcat(*gradient),
            constraint,
            ca.vertcat(*row_low),
            ca.vertcat(*row_high),
            ca.vertcat(*lower),
            ca.vertcat(*upper),
            ca.norm_inf(ca.vertcat(*gaps)),
        ],
    )
    return _embed(linearise, grid, planes, backend, arguments, names, nu)


def _soft_rows(x: Any, limits: Any, normals: Any, offsets: Any, nu: int) -> tuple[Any, Any]:
    """Rows C (m, 8 + nu + 2) of the step and their present values: C dz + value <= 0, slack included."""
    planar = ca.sqrt(x[U] ** 2 + x[V] ** 2 + SPEED_EPSILON_M_S**2)
    heave, turn = ca.if_else(x[W] < 0, -1, 1), ca.if_else(x[R] < 0, -1, 1)
    shallow = x[Z] - limits[3] < limits[4] - x[Z]
    signed = [((U, x[U] / planar), (V, x[V] / planar)), ((W, heave),), ((R, turn),), ((Z, ca.if_else(shallow, -1, 1)),)]
    bounds = [limits[0], limits[1], limits[2], ca.if_else(shallow, -limits[3], limits[4])]
    for j in range(normals.shape[1]):
        signed.append(((0, -normals[0, j]), (1, -normals[1, j])))
        bounds.append(-offsets[j])
    rows, values = ca.SX(len(signed), NX + nu + N_SLACKS), []
    for i, (entries, bound) in enumerate(zip(signed, bounds, strict=True)):
        for column, coefficient in entries:
            rows[i, column] = coefficient
        rows[i, NX + nu + (0 if i < 3 else 1)] = -1.0
        values.append(sum(coefficient * x[column] for column, coefficient in entries) - bound)
    return rows, ca.vertcat(*values)


def _assemble(blocks: list[list[Any]], rows_per_stage: int, nu: int) -> Any:
    """The staged constraint matrix [A B -I; C D] from the blocks of all stages."""
    n = len(blocks)
    height = NX * n + rows_per_stage * (n - 1)
    row = offset = 0
    width = nu + (n - 1) * (NX + nu + N_SLACKS) + NX
    matrix = ca.SX(height, width)
    for k, (a, b, c) in enumerate(blocks):
        n_x, n_u = (0 if k == 0 else NX), (nu if k == 0 else nu + N_SLACKS)
        if k > 0:
            matrix[row : row + NX, offset : offset + NX] = a
        matrix[row : row + NX, offset + n_x : offset + n_x + n_u] = b
        nxt = offset + n_x + n_u
        matrix[row : row + NX, nxt : nxt + NX] = -ca.SX.eye(NX)
        row += NX
        if c is not None:
            matrix[row : row + rows_per_stage, offset:nxt] = c
            row += rows_per_stage
        offset = nxt
    return ca.sparsify(matrix)


def _embed(
    linearise: ca.Function,
    grid: TimeGrid,
    planes: int,
    backend: QpBackend,
    arguments: list[Any],
    names: list[str],
    nu: int,
) -> ca.Function:
    """Linearisation, QP and unpacking as one MX function."""
    n = grid.n
    symbols = [ca.MX.sym(name, *symbol.shape) for name, symbol in zip(names, arguments, strict=True)]
    h, g, a, lba, uba, lbx, ubx, gap = linearise(*symbols)
    options = dict(backend.options)
    if backend.staged:
        options |= {
            "N": n,
            "nx": [0] + [NX] * n,
            "nu": [nu] + [nu + N_SLACKS] * (n - 1) + [0],
            "ng": [0] + [planes + N_BOX_ROWS] * (n - 1) + [0],
        }
    options |= {"error_on_fail": False}
    solver = ca.conic("qp", backend.plugin, {"h": h.sparsity(), "a": a.sparsity()}, options)
    solution = solver(h=h, g=g, a=a, lba=lba, uba=uba, lbx=lbx, ubx=ubx)
    z = solution["x"]
    value = ca.mtimes(a, z)
    violation = ca.mmax(ca.fmax(ca.fmax(lba - value, value - uba), 0))
    width = NX + nu + N_SLACKS
    body = ca.reshape(z[nu : nu + (n - 1) * width], width, n - 1)
    dx = ca.horzcat(ca.MX.zeros(NX, 1), body[:NX, :], z[nu + (n - 1) * width :])
    du = ca.horzcat(z[:nu], body[NX : NX + nu, :])
    x, u = symbols[0] + dx, symbols[1] + du
    bound = symbols[names.index("thrust_limit")]
    overshoot = ca.mmax(ca.fabs(u) - bound)
    rows = NX + planes + N_BOX_ROWS
    soft = ca.reshape(solution["lam_a"][NX:], rows, n - 1)[NX:, :]
    penalty = ca.DM([SLACK_L1 * dt / REFERENCE_DT_S for dt in grid.dt_s[1:]]).T
    use = ca.mmax(ca.fabs(soft) / ca.repmat(penalty, planes + N_BOX_ROWS, 1))
    figures = ca.vertcat(solution["cost"], violation, gap, overshoot, ca.sum1(z), use)
    u = ca.fmax(ca.fmin(u, bound), -bound)
    # The plugin writes all multipliers, asked for or not: they are an output so that it has the memory to write to.
    return ca.Function(
        "nmpc_step",
        symbols,
        [x, u, body[NX + nu :, :], figures, solution["lam_a"]],
        names,
        ["x", "u", "slack", "figures", "multipliers"],
    )
