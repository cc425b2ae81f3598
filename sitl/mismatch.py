"""Mismatch between the simulated vehicle and its vehicle file: factors on groups of coefficients.

The controller always uses the vehicle file unchanged; the plant is built from the result of :func:`mismatched`.
"""

import math
from collections.abc import Mapping

import msgspec

from autopilot.core.errors import ConfigError
from autopilot.core.names import unknown
from autopilot.core.thrusters import ThrustCurve, ThrusterDrive
from autopilot.core.toml_table import Vec3
from autopilot.core.vehicle import Body, Vehicle

MISMATCH_KEYS: dict[str, str] = {
    "mass": "mass of hull and trapped water, trim unchanged: weight and buoyancy stay as they are",
    "surge_mass": "hull and trapped water together in surge, as the controller's m_11: its added mass changes",
    "sway_mass": "the same in sway, m_22",
    "heave_mass": "the same in heave, m_33",
    "yaw_inertia": "hull and trapped water together about the yaw axis, m_66: its added inertia changes",
    "inertia": "moments of inertia",
    "added_mass": "added mass, all three axes",
    "added_inertia": "added moments of inertia",
    "linear_drag": "linear drag of translation and rotation",
    "drag": "quadratic drag of translation and rotation",
    "surge_drag": "linear and quadratic drag in surge",
    "sway_drag": "the same in sway",
    "heave_drag": "the same in heave",
    "yaw_drag": "the same about the yaw axis",
    "buoyancy": "buoyancy force itself (1.01 makes 12 kg float up with 1.2 N more)",
    "righting": "distance between centre of gravity and centre of buoyancy",
    "arm": "lever arms of the thrusters",
    "thrust": "thrust of the thrusters: c in F = c V |V|, or that of the curves",
    "lag": "time constant of the thrusters (0 = immediate)",
    "deadband": "deadband of the amplifiers (0 = none)",
    "power": "electrical power of the thrusters",
    "hotel": "power of everything but the thrusters",
    "supply": "open-circuit and empty voltage of the battery",
    "capacity": "energy in the battery: a small one sags from its open-circuit to its empty voltage during a run",
    "resistance": "internal resistance of the battery",
    "tether": "drag and pull of the tether (0 = none)",
    "tether_pull": "its pull alone (0 = none)",
}
"""Every factor of a mismatch, with the coefficients it multiplies."""

_MASS_KEYS = ("surge_mass", "sway_mass", "heave_mass")
_DRAG_KEYS = ("surge_drag", "sway_drag", "heave_drag")

MAY_BE_ZERO = frozenset(
    {"linear_drag", "drag", *_DRAG_KEYS, "yaw_drag", "lag", "deadband", "righting", "arm", "power", "hotel"}
) | {"resistance", "tether", "tether_pull"}
"""Factors with which 0 leaves a physical vehicle."""


def check_mismatch(mismatch: Mapping[str, float], where: str) -> None:
    """ConfigError if a key is unknown or its factor is not usable; ``where`` begins the message."""
    for key, factor in mismatch.items():
        if key not in MISMATCH_KEYS:
            raise unknown(f"{where}: factor", key, tuple(MISMATCH_KEYS))
        if not math.isfinite(factor) or factor < 0.0 or (factor == 0.0 and key not in MAY_BE_ZERO):
            raise ConfigError(f"{where}: {key} = {factor} is not a usable factor; use a number greater than 0")


def _times(factor: float, values: Vec3) -> Vec3:
    return (factor * values[0], factor * values[1], factor * values[2])


def _each(factors: Vec3, values: Vec3) -> Vec3:
    return (factors[0] * values[0], factors[1] * values[1], factors[2] * values[2])


def _added(where: str, key: str, factor: float, hull: float, added: float) -> float:
    """Added mass or inertia for which the sum with the hull's is ``factor`` times the original.

    ConfigError, beginning with ``where``, if it would be negative.
    """
    if factor == 1.0:
        return added
    result = factor * (hull + added) - hull
    if result < 0.0:
        least = hull / (hull + added)
        raise ConfigError(f"{where}: {key} = {factor:g} leaves less than the hull itself; use {least:.3g} or more")
    return result


def _body(body: Body, factors: Mapping[str, float], where: str) -> Body:
    def factor(key: str) -> float:
        return factors.get(key, 1.0)

    offsets = body.thruster_offset_frd_m
    further_buoyancy_n = (body.weight_n + body.buoyancy_excess_n) * (factor("buoyancy") - 1.0)
    mass_kg, inertia_kg_m2 = body.mass_kg * factor("mass"), _times(factor("inertia"), body.inertia_kg_m2)
    x, y, z = _times(factor("added_mass"), body.added_mass_kg)
    added = [_added(where, key, factor(key), mass_kg, each) for key, each in zip(_MASS_KEYS, (x, y, z), strict=True)]
    roll, pitch, yaw = _times(factor("added_inertia"), body.added_inertia_kg_m2)
    yaw = _added(where, "yaw_inertia", factor("yaw_inertia"), inertia_kg_m2[2], yaw)
    surge, sway, heave = (factor(key) for key in _DRAG_KEYS)
    shift, turn = (surge, sway, heave), (1.0, 1.0, factor("yaw_drag"))
    linear, square = factor("linear_drag"), factor("drag")
    return msgspec.structs.replace(
        body,
        mass_kg=mass_kg,
        buoyancy_excess_n=body.buoyancy_excess_n + further_buoyancy_n,
        inertia_kg_m2=inertia_kg_m2,
        center_of_buoyancy_frd_m=_times(factor("righting"), body.center_of_buoyancy_frd_m),
        added_mass_kg=(added[0], added[1], added[2]),
        added_inertia_kg_m2=(roll, pitch, yaw),
        linear_drag_n_s_m=_each(shift, _times(linear, body.linear_drag_n_s_m)),
        angular_linear_drag_n_m_s=_each(turn, _times(linear, body.angular_linear_drag_n_m_s)),
        quadratic_drag_n_s2_m2=_each(shift, _times(square, body.quadratic_drag_n_s2_m2)),
        angular_quadratic_drag_n_m_s2=_each(turn, _times(square, body.angular_quadratic_drag_n_m_s2)),
        thruster_offset_frd_m={name: _times(factor("arm"), offset) for name, offset in offsets.items()},
    )


def _drive(drive: ThrusterDrive, factors: Mapping[str, float]) -> ThrusterDrive:
    thrust, deadband = factors.get("thrust", 1.0), factors.get("deadband", 1.0)
    power, reverse = factors.get("power", 1.0), drive.reverse_power_w_n15
    common = msgspec.structs.replace(
        drive,
        time_constant_s=drive.time_constant_s * factors.get("lag", 1.0),
        power_w_n15=drive.power_w_n15 * power,
        reverse_power_w_n15=None if reverse is None else reverse * power,
    )
    if drive.curve:
        curves = tuple(_curve(curve, drive, thrust, deadband) for curve in drive.curve)
        return msgspec.structs.replace(common, curve=curves)
    band, forward, reverse = drive.brushed_law
    return msgspec.structs.replace(
        common, deadband_duty=band * deadband, forward_n_v2=forward * thrust, reverse_n_v2=reverse * thrust
    )


def _curve(curve: ThrustCurve, drive: ThrusterDrive, thrust: float, deadband: float) -> ThrustCurve:
    """A curve with its thrust times a factor and its band without thrust times another; full pulses stay full."""
    still = [pulse for pulse, force in zip(curve.pulse_us, curve.thrust_n, strict=True) if force == 0.0]
    points: dict[int, float] = {}
    for pulse, force in zip(curve.pulse_us, curve.thrust_n, strict=True):
        side, edge = (1, still[-1]) if pulse > drive.neutral_us else (-1, still[0])
        offset, band = side * (pulse - drive.neutral_us), side * (edge - drive.neutral_us)
        if offset <= band:
            moved = offset * deadband
        else:
            moved = band * deadband + (offset - band) * (drive.span_us - band * deadband) / (drive.span_us - band)
        points.setdefault(drive.neutral_us + side * round(moved), force * thrust)
    pulses = sorted(points)
    return msgspec.structs.replace(curve, pulse_us=tuple(pulses), thrust_n=tuple(points[pulse] for pulse in pulses))


def _scaled2(pair: tuple[float, float], factor: float) -> tuple[float, float]:
    return pair[0] * factor, pair[1] * factor


def mismatched(vehicle: Vehicle, mismatch: Mapping[str, float], where: str = "mismatch") -> Vehicle:
    """``vehicle`` with the factors of ``mismatch`` (missing keys = 1) applied.

    ConfigError, beginning with ``where``, for unknown keys and for factors that leave no physical vehicle."""
    check_mismatch(mismatch, where)

    def factor(key: str) -> float:
        return mismatch.get(key, 1.0)

    battery, tether = vehicle.battery, vehicle.tether
    return msgspec.structs.replace(
        vehicle,
        hotel_power_w=vehicle.hotel_power_w * factor("hotel"),
        body=_body(vehicle.body, mismatch, where),
        thruster_tables=tuple(
            msgspec.structs.replace(
                table,
                position_frd_m=_times(factor("arm"), table.position_frd_m),
                drive=None if table.drive is None else _drive(table.drive, mismatch),
            )
            for table in vehicle.thruster_tables
        ),
        drive=_drive(vehicle.drive, mismatch),
        battery=msgspec.structs.replace(
            battery,
            open_circuit_v=battery.open_circuit_v * factor("supply"),
            empty_v=battery.empty_v * factor("supply"),
            capacity_j=battery.capacity_j * factor("capacity"),
            internal_resistance_ohm=battery.internal_resistance_ohm * factor("resistance"),
            plausible_v=None if battery.plausible_v is None else _scaled2(battery.plausible_v, factor("supply")),
            low_v=None if battery.low_v is None else battery.low_v * factor("supply"),
            critical_v=None if battery.critical_v is None else battery.critical_v * factor("supply"),
        ),
        tether=msgspec.structs.replace(
            tether,
            drag_coefficient=tether.drag_coefficient * factor("tether"),
            pull_n=tether.pull_n * factor("tether") * factor("tether_pull"),
        ),
    )
