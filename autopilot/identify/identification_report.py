"""Report of a fit per coefficient, and its changes to a vehicle file."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from autopilot.core.frames import FloatArray
from autopilot.core.vehicle import Body, Vehicle
from autopilot.identify.fit import IdentificationFit
from autopilot.identify.prediction import AXES, N_COMMON

THRUST_FRACTION = 0.015
"""Standard deviation of the thrust curve itself: masses and drags are only as well known as the force that they are
compared with. (A bollard test with a spring balance; supply voltage between two readings.)"""

REFERENCE_SPEEDS = (0.3, 0.3, 0.2, 0.5)
"""Where drag is compared: surge, sway, heave [m/s], yaw [rad/s]. Linear and quadratic part trade against each other."""

WIDEST = 0.25
"""An axis whose mass or drag has a wider interval (half of it over the value) was not excited: nothing changes."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CoefficientRow:
    name: str
    unit: str
    before: float
    """In the vehicle file."""
    value: float
    low: float
    """95 % interval."""
    high: float
    kept: bool
    """Not identifiable from the flight: the vehicle file's value stays."""


def rows_of(fit: IdentificationFit, vehicle: Vehicle) -> list[CoefficientRow]:
    """Masses, drag at the reference speeds, linear and quadratic drags, buoyancy excess."""
    model = vehicle.model4
    before = np.array([*model.mass_kg, *model.linear_drag, *model.quadratic_drag, model.buoyancy_excess_n])
    kept = kept_axes(fit)
    rows = []
    for i, axis in enumerate(AXES):
        rows.append(_row(f"{axis} mass", _unit("kg", i), before, fit, _one(i), kept[i]))
    for i, axis in enumerate(AXES):
        speed = REFERENCE_SPEEDS[i]
        unit = "N m" if i == 3 else "N"
        rows.append(_row(f"{axis} drag at {speed:g}", unit, before, fit, _drag(i), kept[i]))
    for name, first, unit in (("linear drag", len(AXES), "N s/m"), ("quadratic drag", 2 * len(AXES), "N s2/m2")):
        for i, axis in enumerate(AXES):
            rows.append(_row(f"{axis} {name}", _unit(unit, i), before, fit, _one(first + i), kept[i]))
    rows.append(_row("buoyancy excess", "N", before, fit, _one(3 * len(AXES)), kept[2]))
    return rows


def kept_axes(fit: IdentificationFit) -> tuple[bool, ...]:
    """Per axis, whether the flight excites it too little to be identified."""
    result = []
    for i in range(len(AXES)):
        mass, drag = _figure(fit, _one(i)), _figure(fit, _drag(i))
        wide = [half > WIDEST * abs(value) or value <= 0.0 for value, half in (mass, drag)]
        result.append(any(wide))
    return tuple(result)


def changes(fit: IdentificationFit, vehicle: Vehicle) -> dict[str, Sequence[float] | float]:
    """``table.key`` -> value for the vehicle file: the model, and the simulated body likewise. Kept axes stay."""
    kept, model, body = kept_axes(fit), vehicle.model4, vehicle.body

    def merged(found: FloatArray, before: Sequence[float]) -> list[float]:
        return [old if stay else float(new) for new, old, stay in zip(found, before, kept, strict=True)]

    mass = merged(fit.values[0:4], model.mass_kg)
    linear = merged(np.maximum(fit.values[4:8], 0.0), model.linear_drag)
    square = merged(np.maximum(fit.values[8:12], 0.0), model.quadratic_drag)
    buoyancy_n = model.buoyancy_excess_n if kept[2] else float(fit.values[12])
    return {
        "model4.mass_kg": _rounded(mass),
        "model4.linear_drag": _rounded(linear),
        "model4.quadratic_drag": _rounded(square),
        "model4.buoyancy_excess_n": round(buoyancy_n, 4),
        **_body_changes(body, mass, linear, square, buoyancy_n),
    }


def _body_changes(
    body: Body, mass: list[float], linear: list[float], square: list[float], buoyancy_n: float
) -> dict[str, Sequence[float] | float]:
    """Added mass of the simulated body so that it moves as the model: identified mass minus the hull's."""
    added = [max(0.0, total - body.mass_kg) for total in mass[:3]]
    turning = [*body.added_inertia_kg_m2[:2], max(0.0, mass[3] - body.inertia_kg_m2[2])]
    return {
        "body.added_mass_kg": _rounded(added),
        "body.added_inertia_kg_m2": _rounded(turning),
        "body.linear_drag_n_s_m": _rounded(linear[:3]),
        "body.quadratic_drag_n_s2_m2": _rounded(square[:3]),
        "body.angular_linear_drag_n_m_s": _rounded([*body.angular_linear_drag_n_m_s[:2], linear[3]]),
        "body.angular_quadratic_drag_n_m_s2": _rounded([*body.angular_quadratic_drag_n_m_s2[:2], square[3]]),
        "body.buoyancy_excess_n": round(buoyancy_n, 4),
    }


def _rounded(values: Sequence[float]) -> list[float]:
    return [round(value, 4) for value in values]


def _unit(unit: str, axis: int) -> str:
    return {"kg": "kg m2", "N s/m": "N m s", "N s2/m2": "N m s2"}[unit] if axis == 3 else unit


def _one(index: int) -> FloatArray:
    """(13,) unit vector."""
    result = np.zeros(N_COMMON - 1)
    result[index] = 1.0
    return result


def _drag(axis: int) -> FloatArray:
    """(13,) drag at the reference speed as a sum of coefficients."""
    speed = REFERENCE_SPEEDS[axis]
    return speed * _one(len(AXES) + axis) + speed * speed * _one(2 * len(AXES) + axis)


def _figure(fit: IdentificationFit, weights: FloatArray) -> tuple[float, float]:
    """A sum of coefficients and half the width of its 95 % interval."""
    value = float(weights @ fit.values[:-1])
    variance = float(weights @ fit.covariance[:-1, :-1] @ weights)
    return value, fit.student * math.sqrt(variance + (THRUST_FRACTION * value) ** 2)


def _row(
    name: str, unit: str, before: FloatArray, fit: IdentificationFit, weights: FloatArray, kept: bool
) -> CoefficientRow:
    value, half = _figure(fit, weights)
    return CoefficientRow(
        name=name,
        unit=unit,
        before=float(weights @ before),
        value=value,
        low=value - half,
        high=value + half,
        kept=kept,
    )
