"""The 4-DoF model over many windows and many sets of coefficients at once."""

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from autopilot.core.frames import FloatArray
from autopilot.core.model4 import YAW, Model4, R, U, V, W, X, Y, Z, body_acceleration, rk4

AXES = ("surge", "sway", "heave", "yaw")
OUTPUTS = (X, Y, Z, YAW, R)
"""Outputs that are compared with the estimate."""

N_COMMON = 3 * len(AXES) + 2
"""Coefficients: masses, linear drags, quadratic drags, buoyancy excess, arm of thrust to the side beyond T_A's."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class CoefficientScale:
    """A base and how each coefficient is counted: value = base + scale * step."""

    base: FloatArray
    """(14,)"""
    scale: FloatArray
    """(14,)"""

    @staticmethod
    def of(model: Model4) -> "CoefficientScale":
        """Around the coefficients of a vehicle file; drags that are zero there count in units of the other kind's."""
        linear, square = np.array(model.linear_drag), np.array(model.quadratic_drag)
        base = np.array(
            [
                *model.mass_kg,
                *model.linear_drag,
                *model.quadratic_drag,
                model.buoyancy_excess_n,
                0.0,
            ]
        )
        scale = np.concatenate(
            [
                model.mass_kg,
                np.maximum(linear, 0.2 * square),
                np.maximum(square, linear),
                [BUOYANCY_SCALE_N, ARM_SCALE_M],
            ]
        )
        return CoefficientScale(base=base, scale=scale)

    def values(self, steps: FloatArray) -> FloatArray:
        """(..., 14) coefficients of (..., 14) steps."""
        return self.base + self.scale * steps


BUOYANCY_SCALE_N = 1.0
ARM_SCALE_M = 0.05
CURRENT_SCALE_M_S = 0.05


def model_of(values: FloatArray, like: Model4) -> Model4:
    """Coefficients (14,) as a model; the rest of the allocation as in ``like``."""
    v = values.tolist()
    surge, sway, heave, yaw = like.allocation
    return Model4(
        mass_kg=(v[0], v[1], v[2], v[3]),
        linear_drag=(v[4], v[5], v[6], v[7]),
        quadratic_drag=(v[8], v[9], v[10], v[11]),
        buoyancy_excess_n=v[12],
        allocation=(surge, sway, heave, tuple(arm + v[13] * push for arm, push in zip(yaw, sway, strict=True))),
    )


def predict(
    values: FloatArray,
    like: Model4,
    start: FloatArray,
    inputs: FloatArray,
    current: FloatArray,
    step_s: float,
) -> FloatArray:
    """Outputs (..., n + 1, 5) from starts (..., 8), inputs (..., n, thrusters + 4) and currents (..., 2) by RK4.

    Inputs of a step: thrust of all thrusters [N], roll and pitch [rad], roll and pitch rate [rad/s]. A vehicle
    that goes ahead with its nose two degrees down sinks; that must not be charged to heave. ``values`` (..., 14)
    broadcasts against the leading axes."""
    v: list[Any] = [values[..., k] for k in range(N_COMMON)]
    model = Model4(
        mass_kg=(v[0], v[1], v[2], v[3]),
        linear_drag=(v[4], v[5], v[6], v[7]),
        quadratic_drag=(v[8], v[9], v[10], v[11]),
        buoyancy_excess_n=v[12],
        allocation=like.allocation,
    )
    sideways = [(j, push) for j, push in enumerate(like.allocation[1]) if push]
    lead, steps = start.shape[:-1], inputs.shape[-2]
    result = np.empty((*lead, steps + 1, len(OUTPUTS)))
    x = np.moveaxis(start, -1, 0).copy()

    def rates_of(given: list[FloatArray], state: FloatArray) -> FloatArray:
        rates = _motion(model, state, given, current)
        rates[R] = rates[R] + v[13] * sum(push * given[j] for j, push in sideways) / model.mass_kg[3]
        return np.stack([np.broadcast_to(rate, lead) for rate in rates])

    for n in range(steps + 1):
        result[..., n, :] = np.moveaxis(x[list(OUTPUTS)], 0, -1)
        if n == steps:
            break
        given = [np.broadcast_to(inputs[..., n, k], lead) for k in range(inputs.shape[-1])]
        x = rk4(partial(rates_of, given), x, step_s)
    return result


def _motion(model: Model4, x: FloatArray, given: list[FloatArray], current: FloatArray) -> list[Any]:
    """dx/dt (8): the 4-DoF model with roll and pitch as they were (Fossen 2011, eq. 2.18 and 6.53 with diagonal M)."""
    roll, pitch, p, q = given[-4:]
    u, v, w, r = x[U], x[V], x[W], x[R]
    m11, m22, m33, _ = model.mass_kg
    surge, sway, heave, yaw = body_acceleration(model, (u, v, w, r), given[:-4], np)
    (cr, sr), (cp, sp), (cy, sy) = _turn(roll), _turn(pitch), _turn(x[YAW])
    level_x = cp * u + sp * (sr * v + cr * w)
    level_y = cr * v - sr * w
    return [
        cy * level_x - sy * level_y + current[..., 0],
        sy * level_x + cy * level_y + current[..., 1],
        cp * (sr * v + cr * w) - sp * u,
        (cr * r + sr * q) / cp,
        surge - m33 * w * q / m11 + model.buoyancy_excess_n * sp / m11,
        sway + m33 * w * p / m22 - model.buoyancy_excess_n * cp * sr / m22,
        heave + (m11 * u * q - m22 * v * p) / m33,
        yaw,
    ]


def _turn(angle: FloatArray) -> tuple[FloatArray, FloatArray]:
    return np.cos(angle), np.sin(angle)
