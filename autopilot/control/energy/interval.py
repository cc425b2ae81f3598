"""One Runge-Kutta step of a trajectory with its derivatives: as CasADi expressions, and the same in C.

CasADi generates the C source when the package is built. Without the compiled library it evaluates the expressions
itself: the same results within rounding, ten times slower.

Variables q (13) of a step: state (8), force per axis (4), length of the step. Vehicles differ in coefficients, which
are arguments, and in the allocation matrix, which is applied outside.
"""

from dataclasses import dataclass
from typing import Any

import casadi as ca

from autopilot.control.nmpc.model_code import COEFFICIENTS, model_of
from autopilot.core import compiled, model4
from autopilot.core.model4 import AXES, NX

FORCE, LENGTH = NX, NX + AXES
"""Places of force and step length among the variables."""

VARIABLES = NX + AXES + 1

NAMES = ("trajectory_moved", "trajectory_slopes", "trajectory_curved")

HEAD = """\
#if defined(__GNUC__) && !defined(_WIN32)
#define CASADI_SYMBOL_EXPORT __attribute__((visibility("default")))
#endif

"""
"""What the library offers must be visible: all else in it is compiled hidden."""


@dataclass(frozen=True, slots=True, eq=False)
class Interval:
    """Functions of (q (13,), current (3,), its gradient (4,), place (2,) where it is that, coefficients (13,)); water
    as in ``trajectory.Ask``."""

    moved: Any
    """The state (8,) after it."""
    slopes: Any
    """(8, 13) its derivative by q."""
    curved: Any
    """(13, 13) second derivative of the product with one more argument, weights (8,)."""


def one_step() -> Interval:
    """A single RK4 step: compiled where there is a library."""
    if compiled.library() is None:
        return Interval(*_expressions())
    return Interval(*(ca.external(name, str(compiled.LIBRARY)) for name in NAMES))


def steps(count: int) -> Interval:
    """That many consecutive RK4 steps of equal length."""
    one = one_step()
    if count == 1:
        return one
    q, weights = ca.MX.sym("q", VARIABLES), ca.MX.sym("weights", NX)
    water = [ca.MX.sym("current", 3), ca.MX.sym("gradient", 4), ca.MX.sym("place", 2)]
    known = [*water, ca.MX.sym("coefficients", COEFFICIENTS)]
    nodes, kept = [q], ca.horzcat(ca.DM.zeros(VARIABLES - NX, NX), ca.DM.eye(VARIABLES - NX))
    for _ in range(count):
        nodes.append(ca.vertcat(one.moved(nodes[-1], *known), q[NX:]))
    # Derivatives of the nodes by q, and of the results by the nodes.
    each = [one.slopes(node, *known) for node in nodes[:-1]]
    by_q = [ca.DM.eye(VARIABLES)]
    for slopes in each:
        by_q.append(ca.vertcat(ca.mtimes(slopes, by_q[-1]), kept))
    curved, left = ca.MX.zeros(VARIABLES, VARIABLES), weights
    for node, slopes, chain in reversed(list(zip(nodes, each, by_q, strict=False))):
        curved += ca.mtimes(chain.T, ca.mtimes(one.curved(node, *known, left), chain))
        left = ca.mtimes(slopes[:, :NX].T, left)
    return Interval(
        ca.Function("moved", [q, *known], [nodes[-1][:NX]]),
        ca.Function("slopes", [q, *known], [ca.densify(by_q[-1][:NX, :])]),
        ca.Function("curved", [q, *known, weights], [ca.densify(curved)]),
    )


def interval_code() -> str:
    generator = ca.CodeGenerator("interval.c", {"with_header": False})
    for function in _expressions():
        generator.add(function)
    return HEAD + str(generator.dump())


def _expressions() -> tuple[Any, Any, Any]:
    """The three functions of a step."""
    q, weights = ca.SX.sym("q", VARIABLES), ca.SX.sym("weights", NX)
    current, gradient, place = ca.SX.sym("current", 3), ca.SX.sym("gradient", 4), ca.SX.sym("place", 2)
    values = ca.SX.sym("coefficients", COEFFICIENTS)
    model, force = model_of(values), ca.vertsplit(q[FORCE:LENGTH])

    def slope(state: Any) -> Any:
        north_m, east_m = state[0] - place[0], state[1] - place[1]
        water = [
            current[0] + gradient[0] * north_m + gradient[1] * east_m,
            current[1] + gradient[2] * north_m + gradient[3] * east_m,
            current[2],
        ]
        return ca.vertcat(*model4.state_derivative(model, ca.vertsplit(state), force, water, ca))

    moved = model4.rk4(slope, q[:NX], q[LENGTH])
    slopes = ca.densify(ca.jacobian(moved, q))
    curved = ca.densify(ca.hessian(ca.dot(weights, moved), q)[0])
    known = [q, current, gradient, place, values]
    what = ((known, moved), (known, slopes), ([*known, weights], curved))
    first, second, third = (
        ca.Function(name, given, [value], {"cse": True}) for name, (given, value) in zip(NAMES, what, strict=True)
    )
    return first, second, third
