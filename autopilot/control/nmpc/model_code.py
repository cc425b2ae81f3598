"""The model's derivative in C, written by CasADi from :mod:`autopilot.core.model4` when the package is built."""

import re
from typing import Any

import casadi as ca

from autopilot.core import model4
from autopilot.core.model4 import AXES, NX, Model4

COEFFICIENTS = 3 * AXES + 1
"""Mass, linear and quadratic drag per axis, buoyancy; the thrusters' columns are multiplied beside it."""

BUOYANCY = 3 * AXES
"""Where it stands among them."""

HEAD = """\
#include <math.h>

static inline double square(double x) { return x * x; }

"""


def coefficients(model: Model4) -> list[float]:
    """(13,) what the C code is told of a vehicle's hull."""
    return [*model.mass_kg, *model.linear_drag, *model.quadratic_drag, model.buoyancy_excess_n]


def model_of(values: Any) -> Model4:
    """The model of symbolic coefficients (13,) with one "thruster" per axis: what real ones do is a matrix in front,
    whatever their number."""
    parts: Any = ca.vertsplit(values)
    return Model4(
        mass_kg=tuple(parts[:AXES]),
        linear_drag=tuple(parts[AXES : 2 * AXES]),
        quadratic_drag=tuple(parts[2 * AXES : 3 * AXES]),
        buoyancy_excess_n=parts[3 * AXES],
        allocation=tuple(tuple(float(i == j) for j in range(AXES)) for i in range(AXES)),
    )


def model_function() -> ca.Function:
    """(x (8,), force (4,), current (3,), coefficients (13,)) -> (dx/dt (8,), its Jacobian by force and state, rows)."""
    x, force, current = ca.SX.sym("x", NX), ca.SX.sym("force", AXES), ca.SX.sym("current", 3)
    values = ca.SX.sym("coefficients", COEFFICIENTS)
    model = model_of(values)
    slope = ca.vertcat(*model4.state_derivative(model, ca.vertsplit(x), ca.vertsplit(force), ca.vertsplit(current), ca))
    jacobian = ca.densify(ca.horzcat(ca.jacobian(slope, force), ca.jacobian(slope, x)).T)
    return ca.Function("model_slope", [x, force, current, values], [slope, jacobian])


def model_code() -> str:
    """The C source: of what CasADi writes, the one function that computes."""
    generator = ca.CodeGenerator("model.c", {"with_header": False})
    generator.add(model_function())
    written = str(generator.dump())
    found = re.search(r"static int casadi_f0\(.*?\n\}\n", written, re.DOTALL)
    if found is None:
        raise RuntimeError("CasADi writes its code in another way: look for the function in it")
    body = re.sub(r"\bcasadi_sq\b", "square", found[0].replace("casadi_f0", "model_slope"))
    return HEAD + body.replace("casadi_real", "double").replace("casadi_int", "long long")
