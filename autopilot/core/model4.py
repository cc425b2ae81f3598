"""The 4-DoF vehicle model of controller and estimator (paper, section III-B, with M^-1 in front of T_A tau).

    eta' = J(yaw) nu_r + (c, 0)        M nu_r' + C(nu_r) nu_r + D(nu_r) nu_r + g = T_A F

State x (8): x, y, z [m, NED], yaw [rad], u_r, v_r, w_r [m/s, FRD, relative to the water], r [rad/s].
Input F (n): thrust of the n thrusters [N], in the order of the vehicle file. Current c (3): NED [m/s], constant over
a step. M includes added mass; C is Coriolis and Munk terms, D linear and quadratic drag, g buoyancy minus weight
(Fossen 2011, ch. 6 and 7).

The equations are written once and run on floats, numpy arrays and CasADi symbols: ``ops`` supplies cos, sin and sqrt
(:mod:`math`, :mod:`numpy` or :mod:`casadi`). The simulator does not use this module: it has its own 6-DoF equations.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

NX = 8
AXIS_NAMES = ("surge", "sway", "heave", "yaw")
AXES = len(AXIS_NAMES)

NO_STATE = 1e6
"""m, m/s, rad: a hundred times the range of the local frame; larger values are a diverged integration."""

X, Y, Z, YAW, U, V, W, R = range(NX)
"""Indices of the state."""

NO_FORCES = (0.0,) * AXES
"""Zero generalised force."""

ABS_SMOOTHING_M2_S2 = 1e-6
"""|a| is taken as sqrt(a^2 + this) so that quadratic drag is differentiable at rest (1 mm/s)."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Model4:
    """Coefficients of the 4-DoF model in the order surge, sway, heave, yaw. Drag coefficients are positive."""

    mass_kg: tuple[float, float, float, float]
    """m11, m22, m33 [kg] and m44 [kg m^2], added mass included."""
    linear_drag: tuple[float, float, float, float]
    """N s/m; N m s for yaw."""
    quadratic_drag: tuple[float, float, float, float]
    """N s^2/m^2; N m s^2 for yaw."""
    buoyancy_excess_n: float
    """Buoyancy minus weight [N], positive floats up."""
    allocation: tuple[tuple[float, ...], ...]
    """T_A (4, n): rows X, Y, Z [N], N [N m]; one column per thruster. Nothing but these columns says what a thruster
    does."""

    @property
    def thrusters(self) -> int:
        """Number of thrusters n."""
        return len(self.allocation[0])


def body_acceleration(model: Model4, nu: Sequence[Any], thrust_n: Sequence[Any], ops: Any) -> list[Any]:
    """Acceleration relative to the water, M^-1 (T_A F - C nu - D nu - g).

    Parameters
    ----------
    model
        Coefficients.
    nu
        (4,) u_r, v_r, w_r [m/s], r [rad/s].
    thrust_n
        (n,) thrust of each thruster [N].
    ops
        Module with ``sqrt``: math, numpy or casadi.

    Returns
    -------
    list
        u_r', v_r', w_r' [m/s^2], r' [rad/s^2].
    """
    forces = [sum([a * thrust_n[j] for j, a in enumerate(row) if a != 0.0]) for row in model.allocation]
    return forced_acceleration(model, nu, forces, ops)


def forced_acceleration(model: Model4, nu: Sequence[Any], forces: Sequence[Any], ops: Any) -> list[Any]:
    """As :func:`body_acceleration`, for the generalised force (4,) X, Y, Z [N], N [N m] of the thrusters."""
    u, v, w, r = nu[0], nu[1], nu[2], nu[3]
    m11, m22, m33, m44 = model.mass_kg
    drag = [
        model.linear_drag[i] * a + model.quadratic_drag[i] * ops.sqrt(a * a + ABS_SMOOTHING_M2_S2) * a
        for i, a in enumerate((u, v, w, r))
    ]
    return [
        (forces[0] - drag[0] + m22 * v * r) / m11,
        (forces[1] - drag[1] - m11 * u * r) / m22,
        (forces[2] - drag[2] - model.buoyancy_excess_n) / m33,
        (forces[3] - drag[3] + (m11 - m22) * u * v) / m44,
    ]


def state_derivative(
    model: Model4, x: Sequence[Any], thrust_n: Sequence[Any], current_ned_m_s: Sequence[Any], ops: Any
) -> list[Any]:
    """x' = f(x, F, c) (paper, eq. 6).

    Parameters
    ----------
    model
        Coefficients.
    x
        (8,) state.
    thrust_n
        (n,) thrust of each thruster [N].
    current_ned_m_s
        (3,) current, NED [m/s].
    ops
        Module with ``cos``, ``sin``, ``sqrt``: math, numpy or casadi.

    Returns
    -------
    list
        The 8 derivatives, in SI units.
    """
    c, s = ops.cos(x[YAW]), ops.sin(x[YAW])
    return [
        x[U] * c - x[V] * s + current_ned_m_s[0],
        x[U] * s + x[V] * c + current_ned_m_s[1],
        x[W] + current_ned_m_s[2],
        x[R],
        *body_acceleration(model, (x[U], x[V], x[W], x[R]), thrust_n, ops),
    ]


def steady_force(model: Model4, nu: Sequence[Any], ops: Any) -> list[Any]:
    """Generalised force (4,) X, Y, Z [N], N [N m] that keeps nu = (u_r, v_r, w_r, r) constant: drag, buoyancy, Munk
    moment.
    """
    drift = forced_acceleration(model, nu, NO_FORCES, ops)
    return [-m * a for m, a in zip(model.mass_kg, drift, strict=True)]


def rk4(f: Callable[[Any], Any], x: Any, step_s: Any) -> Any:
    """State after one step ``step_s`` [s] of the classical fourth-order Runge-Kutta method for x' = f(x)."""
    k1 = f(x)
    k2 = f(x + step_s / 2 * k1)
    k3 = f(x + step_s / 2 * k2)
    k4 = f(x + step_s * k3)
    return x + step_s / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
