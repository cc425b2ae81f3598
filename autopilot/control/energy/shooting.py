"""The nonlinear program of a trajectory, put together from one interval.

All intervals are alike, so one interval's motion, its Jacobian and its Hessian are built as expressions and mapped over
the trajectory; what they give is put into the sparse matrices of the whole by constant selections. Expressions of the
whole program would be 48 times as large: 40 MB for one RK4 step per interval, 70 MB for two, and a second to build.

Variables: thrust (one per thruster) and next state (8) of every interval, then the end time. Rows: the :data:`ROWS` of
every interval, then :data:`END_ROWS`. All rows but those of the motion are at most 0.
"""

from collections.abc import Sequence
from typing import Any, TypeAlias

import casadi as ca
import numpy as np

from autopilot.control.energy.power import PowerModel
from autopilot.core import model4
from autopilot.core.frames import FloatArray
from autopilot.core.model4 import NX, YAW, Model4, R, U, V, W, Z

PLANES = 6
"""Half-planes per node."""

ROWS = NX + 1 + 2 + 2 + 2 + PLANES
"""Of an interval: motion, planar speed, heave, yaw rate, depth, half-planes."""

END_ROWS = 3
"""Distance from the goal, heading."""

COST_SCALE = 1e-2

COAST_S = 1.0
"""A vehicle that arrives with a velocity is taken to be this much farther on at no cost."""

SMALL_THRUST_N = 0.3
"""See :meth:`Shooting._second`."""

Entries: TypeAlias = list[tuple[int, int]]
"""Rows and columns."""


def shapes_of(n: int) -> dict[str, tuple[int, int]]:
    """Parameters of the program and their shapes (rows, columns), in order; see ``trajectory.Ask``. ``band``: radius,
    heading and half width of the heading's band."""
    return {
        "x0": (NX, 1),
        "goal": (3, 1),
        "band": (3, 1),
        "current": (3, n + 1),
        "gradient": (4, n + 1),
        "places": (2, n + 1),
        "plane_n": (2, PLANES * (n + 1)),
        "plane_d": (PLANES, n + 1),
        "planar": (1, n + 1),
        "limits": (4, n + 1),
        "end": (2, 1),
    }


class Shooting:
    """``program`` and ``derivatives`` for CasADi's ``nlpsol``, and the bounds ``lower``, ``upper`` of the rows."""

    def __init__(self, model: Model4, power: PowerModel, n: int, substeps: int) -> None:
        self._n, self._power, self._substeps = n, power, substeps
        self._nu, self._block = model.thrusters, NX + model.thrusters
        self._interval(model)
        self._end()
        z = ca.MX.sym("z", self._block * n + 1)
        p = ca.MX.sym("p", sum(rows * columns for rows, columns in shapes_of(n).values()))
        of_cost, of_rows = ca.MX.sym("of_cost"), ca.MX.sym("of_rows", ROWS * n + END_ROWS)
        cost, rows = self._values(z, p)
        self.program: dict[str, Any] = {"x": z, "f": cost, "g": rows, "p": p}
        hessian = ca.Function(
            "hessian",
            [z, p, of_cost, of_rows],
            [self._hessian(z, p, of_cost, of_rows)],
            ["x", "p", "lam_f", "lam_g"],
            ["triu_hess_gamma_x_x"],
        )
        jacobian = ca.Function("jacobian", [z, p], [rows, self._jacobian(z, p)], ["x", "p"], ["g", "jac_g_x"])
        self.derivatives: dict[str, Any] = {"hess_lag": hessian, "jac_g": jacobian}
        motion = np.tile(np.arange(ROWS) < NX, n)
        self.lower: FloatArray = np.concatenate([np.where(motion, 0.0, -np.inf), np.full(END_ROWS, -np.inf)])
        self.upper: FloatArray = np.zeros(ROWS * n + END_ROWS)

    def _interval(self, model: Model4) -> None:
        """One interval: motion and cost, slopes, Hessian, over state, thrust and end time."""
        z, of_motion, of_cost = ca.SX.sym("z", self._block + 1), ca.SX.sym("of_motion", NX), ca.SX.sym("of_cost")
        water = [ca.SX.sym("c", 3), ca.SX.sym("g", 4), ca.SX.sym("p0", 2)]
        x, u, end_s = z[:NX], z[NX : self._block], z[self._block]
        moved = _step(model, self._substeps)(x, u, *water, end_s / self._n)
        cost = COST_SCALE * end_s / self._n * ca.sum1(self._power.thrust_w(u))
        # For a power |F|^1.5 Newton's step from F leads to -F, which costs the same: thrusts that ought to be zero
        # swing from side to side, until the iterations have run out. A step with the slope over F as curvature leads to
        # zero. So the difference of both is added, fading out where thrusts are not small and it would only make steps
        # shorter. The solution is the same.
        lacking = ca.SX(self._block + 1, 1)
        gap = self._power.secant_over_tangent(u) / (1.0 + (u / SMALL_THRUST_N) ** 2)
        lacking[NX : self._block] = of_cost * COST_SCALE * end_s / self._n * gap
        whole, _ = ca.hessian(of_cost * cost + ca.dot(of_motion, moved), z)
        n = self._n
        self._moved = ca.Function("moved", [z, *water], [moved, cost]).map(n)
        self._slopes = ca.Function("slopes", [z, *water], [ca.densify(ca.jacobian(moved, z))]).map(n)
        curved = ca.densify(whole + ca.diag(lacking))
        self._curved = ca.Function("curved", [z, *water, of_motion, of_cost], [curved]).map(n)

    def _end(self) -> None:
        """What holds at the last node: rows and cost, slopes, Hessian, over its state."""
        x, goal, band = ca.SX.sym("x", NX), ca.SX.sym("goal", 3), ca.SX.sym("band", 3)
        beyond, current = ca.SX.sym("beyond", 2), ca.SX.sym("current", 2)
        of_rows, of_cost = ca.SX.sym("of_rows", END_ROWS), ca.SX.sym("of_cost")
        off = x[YAW] - band[1]
        rows = ca.vertcat(ca.sumsqr(x[:3] - goal) - band[0] ** 2, off - band[2], -off - band[2])
        c, s = ca.cos(x[YAW]), ca.sin(x[YAW])
        ground = ca.vertcat(x[U] * c - x[V] * s, x[U] * s + x[V] * c) + current
        cost = COST_SCALE * ca.dot(beyond, x[:2] + COAST_S * ground - goal[:2])
        known = [x, goal, band, beyond, current]
        curved, _ = ca.hessian(of_cost * cost + ca.dot(of_rows, rows), x)
        self._end_values = ca.Function("end", known, [rows, cost])
        self._end_slopes = ca.Function("end_slopes", known, [ca.densify(ca.jacobian(rows, x))])
        self._end_curved = ca.Function("end_curved", [*known, of_rows, of_cost], [ca.densify(curved)])

    def _split(self, z: Any, p: Any) -> tuple[dict[str, Any], Any, Any, list[Any], list[Any]]:
        """Parameters by name, next states (8, n), intervals (9 + thrusters, n), their water, what the end needs."""
        n, parts, at = self._n, {}, 0
        for name, (rows, columns) in shapes_of(n).items():
            parts[name] = ca.reshape(p[at : at + rows * columns], rows, columns)
            at += rows * columns
        table = ca.reshape(z[:-1], self._block, n)
        following = table[self._nu :, :]
        state = ca.horzcat(parts["x0"], following[:, : n - 1])
        intervals = ca.vertcat(state, table[: self._nu, :], ca.repmat(z[-1], 1, n))
        water = [parts[name][:, :n] for name in ("current", "gradient", "places")]
        end = [following[:, n - 1], parts["goal"], parts["band"], parts["end"], parts["current"][:2, n]]
        return parts, following, intervals, water, end

    def _values(self, z: Any, p: Any) -> tuple[Any, Any]:
        """Cost and rows."""
        n = self._n
        parts, x, intervals, water, end = self._split(z, p)
        moved, costs = self._moved(intervals, *water)
        limits = parts["limits"][:, 1:]
        normals, offsets = parts["plane_n"][:, PLANES:], parts["plane_d"][:, 1:]
        along = [ca.sum1(normals[:, i::PLANES] * x[:2, :]) for i in range(PLANES)]
        rows = ca.vertcat(
            moved - x,
            x[U, :] ** 2 + x[V, :] ** 2 - parts["planar"][:, 1:] ** 2,
            x[W, :] - limits[0, :],
            -x[W, :] - limits[0, :],
            x[R, :] - limits[1, :],
            -x[R, :] - limits[1, :],
            limits[2, :] - x[Z, :],
            x[Z, :] - limits[3, :],
            offsets - ca.vertcat(*along),
        )
        end_rows, end_cost = self._end_values(*end)
        cost = COST_SCALE * self._power.hotel_w * z[-1] + ca.sum2(costs) + end_cost
        assert rows.shape == (ROWS, n)
        return cost, ca.vertcat(ca.vec(rows), end_rows)

    def _jacobian(self, z: Any, p: Any) -> Any:
        """Of the rows."""
        n = self._n
        parts, x, intervals, water, end = self._split(z, p)
        entries: Entries = []
        for k in range(n):
            entries += [(ROWS * k + row, column) for column in self._columns(k) for row in range(NX)]
        values = [ca.vec(self._slopes(intervals, *water))]
        fixed = [(row, row, -1.0) for row in range(NX)]
        fixed += [(NX + 1 + i, column, sign) for i, (column, sign) in enumerate(SIGNED)]
        for row, column, value in fixed:
            entries += [(ROWS * k + row, self._state(k + 1, column)) for k in range(n)]
            values.append(value * ca.DM.ones(n, 1))
        for column in (U, V):
            entries += [(ROWS * k + NX, self._state(k + 1, column)) for k in range(n)]
            values.append(2.0 * x[column, :].T)
        first = ROWS - PLANES
        for column in (0, 1):
            entries += [(ROWS * k + first + i, self._state(k + 1, column)) for k in range(n) for i in range(PLANES)]
            values.append(-parts["plane_n"][column, PLANES:].T)
        entries += [(ROWS * n + row, self._state(n, column)) for column in range(NX) for row in range(END_ROWS)]
        values.append(ca.vec(self._end_slopes(*end)))
        return _sparse(ROWS * n + END_ROWS, self._block * n + 1, entries, ca.vertcat(*values))

    def _hessian(self, z: Any, p: Any, of_cost: Any, of_rows: Any) -> Any:
        """Of the Lagrangian, upper triangle."""
        n = self._n
        _, _, intervals, water, end = self._split(z, p)
        table = ca.reshape(of_rows[: ROWS * n], ROWS, n)
        curved = self._curved(intervals, *water, table[:NX, :], ca.repmat(of_cost, 1, n))
        entries: Entries = []
        for k in range(n):
            columns = self._columns(k)
            entries += [(row, column) for column in columns for row in columns]
        values = [ca.vec(curved)]
        for column in (U, V):
            entries += [(self._state(k + 1, column),) * 2 for k in range(n)]
            values.append(2.0 * table[NX, :].T)
        last = [self._state(n, i) for i in range(NX)]
        entries += [(row, column) for column in last for row in last]
        values.append(ca.vec(self._end_curved(*end, of_rows[ROWS * n :], of_cost)))
        size = self._block * n + 1
        return _sparse(size, size, [(r, c) if r <= c else (-1, -1) for r, c in entries], ca.vertcat(*values))

    def _columns(self, k: int) -> list[int]:
        """Of state, thrust and end time of an interval; -1 = no variable."""
        state = [self._state(k, i) for i in range(NX)]
        return [*state, *(self._block * k + i for i in range(self._nu)), self._block * self._n]

    def _state(self, node: int, i: int) -> int:
        """Column of a state of a node; the first node's are known (-1)."""
        return self._block * (node - 1) + self._nu + i if node else -1


SIGNED = ((W, 1.0), (W, -1.0), (R, 1.0), (R, -1.0), (Z, -1.0), (Z, 1.0))
"""States that are bounded on one side by each of the rows after that of the planar speed."""


def _sparse(rows: int, columns: int, entries: Entries, values: Any) -> Any:
    """A sparse matrix of ``values`` (m,) at ``entries`` (m,), summed where they meet, left out where negative."""
    at = np.array(entries)
    used = np.flatnonzero((at >= 0).all(axis=1))
    # CasADi counts down the columns.
    order, place = np.unique(at[used, 1] * rows + at[used, 0], return_inverse=True)
    pattern = ca.Sparsity.triplet(rows, columns, (order % rows).tolist(), (order // rows).tolist())
    choice = ca.DM.triplet(place.tolist(), used.tolist(), ca.DM.ones(len(used), 1), len(order), len(entries))
    return ca.MX(pattern, ca.mtimes(choice, values))


def _step(model: Model4, substeps: int) -> ca.Function:
    """RK4 over one interval in water that changes with the place."""
    x, u = ca.SX.sym("x", NX), ca.SX.sym("u", model.thrusters)
    c, g, p0, dt = ca.SX.sym("c", 3), ca.SX.sym("g", 4), ca.SX.sym("p0", 2), ca.SX.sym("dt")

    def f(state: Any) -> Any:
        dx, dy = state[0] - p0[0], state[1] - p0[1]
        current: Sequence[Any] = [c[0] + g[0] * dx + g[1] * dy, c[1] + g[2] * dx + g[3] * dy, c[2]]
        return ca.vertcat(*model4.state_derivative(model, ca.vertsplit(state), ca.vertsplit(u), current, ca))

    h = dt / substeps
    state = x
    for _ in range(substeps):
        state = model4.rk4(f, state, h)
    return ca.Function("step", [x, u, c, g, p0, dt], [state])
