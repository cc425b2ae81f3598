"""The nonlinear program of a trajectory, assembled from one interval.

All intervals have the same structure: motion, Jacobian and Hessian of one interval are built as expressions and mapped
over the trajectory, and constant selections place the results in the sparse matrices of the program. Expressions of
the whole program would be 48 times as large: 40 MB for one RK4 step per interval, 70 MB for two, and a second to
build.

Variables: thrust (one per thruster) and next state (8) of every interval, then the end time. Constraints: the
:data:`ROWS` of every interval, then :data:`SHOOTING.end_rows`. All but the dynamics are inequalities, at most 0.
"""

from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np

from autopilot.control.energy.energy_tuning import SHOOTING
from autopilot.control.energy.interval import steps
from autopilot.control.energy.power import PowerModel
from autopilot.control.nmpc.model_code import BUOYANCY, coefficients
from autopilot.core.frames import FloatArray
from autopilot.core.model4 import NX, YAW, Model4, R, U, V, W, Z

SIGNED = ((W, 1.0), (W, -1.0), (R, 1.0), (R, -1.0), (Z, -1.0), (Z, 1.0))
"""States that a row bounds on one side each. (As bounds of the variables, or as rows between two limits, they take a
tenth off an iteration, and long trajectories in open water are not solved from guesses that are beyond them.)"""

ROWS = NX + 1 + len(SIGNED) + SHOOTING.planes
"""Of an interval: motion, planar speed, heave, yaw rate, depth, half-planes."""


SMALL_THRUST_N = 0.3
"""See :meth:`Shooting._second`."""


def shapes_of(n: int) -> dict[str, tuple[int, int]]:
    """Parameters of the program and their shapes (rows, columns), in order; see ``trajectory.ProgramInputs``.
    ``band``: radius, heading and half width of the heading's band."""
    return {
        "x0": (NX, 1),
        "goal": (3, 1),
        "band": (3, 1),
        "current": (3, n + 1),
        "gradient": (4, n + 1),
        "places": (2, n + 1),
        "plane_n": (2, SHOOTING.planes * (n + 1)),
        "plane_d": (SHOOTING.planes, n + 1),
        "planar": (1, n + 1),
        "limits": (4, n + 1),
        "end": (2, 1),
        "buoyancy": (1, 1),
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
        of_cost, of_rows = ca.MX.sym("of_cost"), ca.MX.sym("of_rows", ROWS * n + SHOOTING.end_rows)
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
        gradient = ca.Function("gradient", [z, p], [cost, self._gradient(z, p)], ["x", "p"], ["f", "grad_f_x"])
        self.derivatives: dict[str, Any] = {"hess_lag": hessian, "jac_g": jacobian, "grad_f": gradient}
        motion = np.tile(np.arange(ROWS) < NX, n)
        self.lower: FloatArray = np.concatenate([np.where(motion, 0.0, -np.inf), np.full(SHOOTING.end_rows, -np.inf)])
        self.upper: FloatArray = np.zeros(ROWS * n + SHOOTING.end_rows)

    def _interval(self, model: Model4) -> None:
        """One interval: motion with slopes and Hessian; power of its thrusters with theirs."""
        n, interval = self._n, steps(self._substeps)
        self._matrix = np.array(model.allocation)
        self._hull = ca.DM(coefficients(model)[:BUOYANCY])
        self._moved, self._slopes, self._curved = (
            each.map(n) for each in (interval.moved, interval.slopes, interval.curved)
        )
        u = ca.SX.sym("u", self._nu)
        watts = ca.sum1(self._power.thrust_w(u))
        slope = ca.gradient(watts, u)
        # For a power |F|^1.5 Newton's step from F leads to -F, which costs the same: thrusts that ought to be zero
        # swing from side to side, until the iterations have run out. A step with the slope over F as curvature leads to
        # zero. So the difference of both is added, fading out where thrusts are not small and it would only make steps
        # shorter. The solution is the same.
        gap = self._power.secant_over_tangent(u) / (1.0 + (u / SMALL_THRUST_N) ** 2)
        self._watts = ca.Function("watts", [u], [watts]).map(n)
        self._watt_slopes = ca.Function("watt_slopes", [u], [watts, slope]).map(n)
        self._watt_curved = ca.Function("watt_curved", [u], [slope, ca.diag(ca.jacobian(slope, u)) + gap]).map(n)

    def _end(self) -> None:
        """Terminal constraints and cost, their gradients and Hessian, over the last state."""
        x, goal, band = ca.SX.sym("x", NX), ca.SX.sym("goal", 3), ca.SX.sym("band", 3)
        beyond, current = ca.SX.sym("beyond", 2), ca.SX.sym("current", 2)
        of_rows, of_cost = ca.SX.sym("of_rows", SHOOTING.end_rows), ca.SX.sym("of_cost")
        off = x[YAW] - band[1]
        rows = ca.vertcat(ca.sumsqr(x[:3] - goal) - band[0] ** 2, off - band[2], -off - band[2])
        c, s = ca.cos(x[YAW]), ca.sin(x[YAW])
        ground = ca.vertcat(x[U] * c - x[V] * s, x[U] * s + x[V] * c) + current
        cost = SHOOTING.cost_scale * ca.dot(beyond, x[:2] + SHOOTING.coast_s * ground - goal[:2])
        known = [x, goal, band, beyond, current]
        curved, _ = ca.hessian(of_cost * cost + ca.dot(of_rows, rows), x)
        self._end_values = ca.Function("end", known, [rows, cost])
        self._end_slopes = ca.Function("end_slopes", known, [ca.densify(ca.jacobian(rows, x))])
        self._end_gradient = ca.Function("end_gradient", known, [ca.densify(ca.gradient(cost, x))])
        self._end_curved = ca.Function("end_curved", [*known, of_rows, of_cost], [ca.densify(curved)])

    def _split(self, z: Any, p: Any) -> tuple[dict[str, Any], Any, Any, list[Any], list[Any]]:
        """Parameters by name, next states (8, n), thrusts (thrusters, n), arguments of the dynamics, of the terminal
        conditions.
        """
        n, parts, at = self._n, {}, 0
        for name, (rows, columns) in shapes_of(n).items():
            parts[name] = ca.reshape(p[at : at + rows * columns], rows, columns)
            at += rows * columns
        table = ca.reshape(z[:-1], self._block, n)
        following, thrusts = table[self._nu :, :], table[: self._nu, :]
        state = ca.horzcat(parts["x0"], following[:, : n - 1])
        length = z[-1] / (n * self._substeps)
        variables = ca.vertcat(state, ca.mtimes(ca.DM(self._matrix), thrusts), ca.repmat(length, 1, n))
        parameters = ca.repmat(ca.vertcat(self._hull, parts["buoyancy"]), 1, n)
        motion = [variables, *(parts[name][:, :n] for name in ("current", "gradient", "places")), parameters]
        end = [following[:, n - 1], parts["goal"], parts["band"], parts["end"], parts["current"][:2, n]]
        return parts, following, thrusts, motion, end

    def _values(self, z: Any, p: Any) -> tuple[Any, Any]:
        """Objective and constraint values."""
        n = self._n
        parts, x, thrusts, motion, end = self._split(z, p)
        heave, turn, shallow, deep = ca.vertsplit(parts["limits"][:, 1:])
        limits = (heave, heave, turn, turn, -shallow, deep)
        normals, offsets = parts["plane_n"][:, SHOOTING.planes :], parts["plane_d"][:, 1:]
        along = [ca.sum1(normals[:, i :: SHOOTING.planes] * x[:2, :]) for i in range(SHOOTING.planes)]
        rows = ca.vertcat(
            self._moved(*motion) - x,
            x[U, :] ** 2 + x[V, :] ** 2 - parts["planar"][:, 1:] ** 2,
            ca.vertcat(*(sign * x[i, :] - limit for (i, sign), limit in zip(SIGNED, limits, strict=True))),
            offsets - ca.vertcat(*along),
        )
        end_rows, end_cost = self._end_values(*end)
        cost = SHOOTING.cost_scale * z[-1] * (self._power.hotel_w + ca.sum2(self._watts(thrusts)) / n) + end_cost
        assert rows.shape == (ROWS, n)
        return cost, ca.vertcat(ca.vec(rows), end_rows)

    def _gradient(self, z: Any, p: Any) -> Any:
        n = self._n
        _, _, thrusts, _, end = self._split(z, p)
        watts, slopes = self._watt_slopes(thrusts)
        table = ca.MX.zeros(self._block, n)
        table[: self._nu, :] = SHOOTING.cost_scale * z[-1] / n * slopes
        table[self._nu :, n - 1] = self._end_gradient(*end)
        return ca.vertcat(ca.vec(table), SHOOTING.cost_scale * (self._power.hotel_w + ca.sum2(watts) / n))

    def _jacobian(self, z: Any, p: Any) -> Any:
        n = self._n
        parts, x, _, motion, end = self._split(z, p)
        matrix = _Sparse(ROWS * n + SHOOTING.end_rows, self._block * n + 1)
        matrix.add(
            self._slopes(*motion),
            [
                [(ROWS * k + row, column, weight) for column, weight in columns]
                for k in range(n)
                for columns in self._columns(k)
                for row in range(NX)
            ],
        )
        for row in range(NX):
            matrix.add(-ca.DM.ones(n, 1), [[(ROWS * k + row, self._state(k + 1, row), 1.0)] for k in range(n)])
        for column in (U, V):
            places = [[(ROWS * k + NX, self._state(k + 1, column), 1.0)] for k in range(n)]
            matrix.add(2.0 * x[column, :].T, places)
        for i, (state, sign) in enumerate(SIGNED):
            places = [[(ROWS * k + NX + 1 + i, self._state(k + 1, state), sign)] for k in range(n)]
            matrix.add(ca.DM.ones(n, 1), places)
        first = ROWS - SHOOTING.planes
        for column in (0, 1):
            matrix.add(
                -parts["plane_n"][column, SHOOTING.planes :].T,
                [
                    [(ROWS * k + first + i, self._state(k + 1, column), 1.0)]
                    for k in range(n)
                    for i in range(SHOOTING.planes)
                ],
            )
        places = [
            [(ROWS * n + row, self._state(n, column), 1.0)] for column in range(NX) for row in range(SHOOTING.end_rows)
        ]
        matrix.add(self._end_slopes(*end), places)
        return matrix.filled()

    def _hessian(self, z: Any, p: Any, of_cost: Any, of_rows: Any) -> Any:
        """Hessian of the Lagrangian, upper triangle."""
        n, nu = self._n, self._nu
        _, _, thrusts, motion, end = self._split(z, p)
        table = ca.reshape(of_rows[: ROWS * n], ROWS, n)
        matrix = _Sparse(self._block * n + 1, self._block * n + 1, upper=True)
        places = []
        for k in range(n):
            columns = self._columns(k)
            for right in columns:
                places += [[(i, j, a * b) for i, a in left for j, b in right] for left in columns]
        matrix.add(self._curved(*motion, table[:NX, :]), places)
        slopes, curved = self._watt_curved(thrusts)
        at = [self._block * k + i for k in range(n) for i in range(nu)]
        matrix.add(of_cost * SHOOTING.cost_scale * z[-1] / n * curved, [[(i, i, 1.0)] for i in at])
        matrix.add(of_cost * SHOOTING.cost_scale / n * slopes, [[(i, self._block * n, 1.0)] for i in at])
        for column in (U, V):
            matrix.add(2.0 * table[NX, :].T, [[(self._state(k + 1, column),) * 2 + (1.0,)] for k in range(n)])
        last = [self._state(n, i) for i in range(NX)]
        places = [[(row, column, 1.0)] for column in last for row in last]
        matrix.add(self._end_curved(*end, of_rows[ROWS * n :], of_cost), places)
        return matrix.filled()

    def _columns(self, k: int) -> list[list[tuple[int, float]]]:
        """Sources of the variables of an interval's motion: columns and factors; none for the first state."""
        state = [[(column, 1.0)] if (column := self._state(k, i)) >= 0 else [] for i in range(NX)]
        force = [
            [(self._block * k + j, float(weight)) for j, weight in enumerate(row) if weight] for row in self._matrix
        ]
        return [*state, *force, [(self._block * self._n, 1.0 / (self._n * self._substeps))]]

    def _state(self, node: int, i: int) -> int:
        """Column of a node's state; -1 for the first node, whose state is given."""
        return self._block * (node - 1) + self._nu + i if node else -1


class _Sparse:
    """A sparse matrix put together from values, each with its places (row, column) and its shares in them."""

    def __init__(self, rows: int, columns: int, *, upper: bool = False) -> None:
        self._shape, self._upper = (rows, columns), upper
        self._values: list[Any] = []
        self._entries: list[tuple[int, int, int, float]] = []
        self._count = 0

    def add(self, values: Any, places: Sequence[Sequence[tuple[int, int, float]]]) -> None:
        """Add ``values`` column by column at their positions; duplicates are summed."""
        self._values.append(ca.vec(values))
        assert self._values[-1].shape[0] == len(places)
        for source, found in enumerate(places, self._count):
            self._entries += [(row, column, source, weight) for row, column, weight in found]
        self._count += len(places)

    def filled(self) -> Any:
        """The matrix, or its upper triangle."""
        rows, columns = self._shape
        entries = [entry for entry in self._entries if entry[0] <= entry[1] or not self._upper]
        at = np.array([entry[:3] for entry in entries])
        # CasADi counts down the columns.
        order, place = np.unique(at[:, 1] * rows + at[:, 0], return_inverse=True)
        pattern = ca.Sparsity.triplet(rows, columns, (order % rows).tolist(), (order // rows).tolist())
        weights = ca.DM([entry[3] for entry in entries])
        choice = ca.DM.triplet(place.tolist(), at[:, 2].tolist(), weights, len(order), self._count)
        return ca.MX(pattern, ca.mtimes(choice, ca.vertcat(*self._values)))
