"""Mismatch between the simulated vehicle and its vehicle file: factors on groups of coefficients.

The controller always works from the vehicle file as it is; the plant is built from the result of :func:`mismatched`.
"""

import math
from collections.abc import Mapping

import msgspec

from autopilot.core.errors import ConfigError
from autopilot.core.vehicle import Body, Vec3, Vehicle

MISMATCH_KEYS: dict[str, str] = {
    "mass": "mass of hull and trapped water, trim unchanged: weight and buoyancy stay as they are",
    "inertia": "moments of inertia",
    "added_mass": "added mass, all three axes",
    "added_inertia": "added moments of inertia",
    "linear_drag": "linear drag of translation and rotation",
    "drag": "quadratic drag of translation and rotation",
    "buoyancy": "buoyancy force itself (1.01 makes 12 kg float up with 1.2 N more)",
    "righting": "distance between centre of gravity and centre of buoyancy",
    "arm": "lever arms of the thrusters",
    "thrust": "thrust constant c in F = c V |V|",
    "lag": "time constant of the thrusters (0 = immediate)",
    "deadband": "deadband of the amplifiers (0 = none)",
    "power": "electrical power of the thrusters",
    "hotel": "power of everything but the thrusters",
    "supply": "open-circuit and empty voltage of the battery",
    "tether": "drag and pull of the tether (0 = none)",
}
"""Every factor that a mismatch may hold, and what it multiplies."""

MAY_BE_ZERO = frozenset({"linear_drag", "drag", "lag", "deadband", "righting", "arm", "power", "hotel", "tether"})
"""Factors with which 0 leaves a physical vehicle."""


def check_mismatch(mismatch: Mapping[str, float], where: str) -> None:
    """ConfigError if a key is unknown or its factor is not usable; ``where`` begins the message."""
    for key, factor in mismatch.items():
        if key not in MISMATCH_KEYS:
            raise ConfigError(f"{where}: {key!r} is not a mismatch factor; use one of {', '.join(MISMATCH_KEYS)}")
        if not math.isfinite(factor) or factor < 0.0 or (factor == 0.0 and key not in MAY_BE_ZERO):
            raise ConfigError(f"{where}: {key} = {factor} is not a usable factor; use a number greater than 0")


def _times(factor: float, values: Vec3) -> Vec3:
    return (factor * values[0], factor * values[1], factor * values[2])


def _body(body: Body, factors: Mapping[str, float]) -> Body:
    """The body with its factors applied."""

    def factor(key: str) -> float:
        return factors.get(key, 1.0)

    further_buoyancy_n = (body.weight_n + body.buoyancy_excess_n) * (factor("buoyancy") - 1.0)
    return msgspec.structs.replace(
        body,
        mass_kg=body.mass_kg * factor("mass"),
        buoyancy_excess_n=body.buoyancy_excess_n + further_buoyancy_n,
        inertia_kg_m2=_times(factor("inertia"), body.inertia_kg_m2),
        center_of_buoyancy_frd_m=_times(factor("righting"), body.center_of_buoyancy_frd_m),
        added_mass_kg=_times(factor("added_mass"), body.added_mass_kg),
        added_inertia_kg_m2=_times(factor("added_inertia"), body.added_inertia_kg_m2),
        linear_drag_n_s_m=_times(factor("linear_drag"), body.linear_drag_n_s_m),
        angular_linear_drag_n_m_s=_times(factor("linear_drag"), body.angular_linear_drag_n_m_s),
        quadratic_drag_n_s2_m2=_times(factor("drag"), body.quadratic_drag_n_s2_m2),
        angular_quadratic_drag_n_m_s2=_times(factor("drag"), body.angular_quadratic_drag_n_m_s2),
    )


def mismatched(vehicle: Vehicle, mismatch: Mapping[str, float]) -> Vehicle:
    """``vehicle`` with the factors of ``mismatch`` (missing keys = 1) applied. ConfigError for unknown keys."""
    check_mismatch(mismatch, "mismatch")

    def factor(key: str) -> float:
        return mismatch.get(key, 1.0)

    drive, battery, tether = vehicle.drive, vehicle.battery, vehicle.tether
    return msgspec.structs.replace(
        vehicle,
        hotel_power_w=vehicle.hotel_power_w * factor("hotel"),
        body=_body(vehicle.body, mismatch),
        thruster=[
            msgspec.structs.replace(thruster, position_frd_m=_times(factor("arm"), thruster.position_frd_m))
            for thruster in vehicle.thruster
        ],
        drive=msgspec.structs.replace(
            drive,
            forward_n_v2=drive.forward_n_v2 * factor("thrust"),
            reverse_n_v2=drive.reverse_n_v2 * factor("thrust"),
            time_constant_s=drive.time_constant_s * factor("lag"),
            deadband_duty=drive.deadband_duty * factor("deadband"),
            power_w_n15=drive.power_w_n15 * factor("power"),
        ),
        battery=msgspec.structs.replace(
            battery,
            open_circuit_v=battery.open_circuit_v * factor("supply"),
            empty_v=battery.empty_v * factor("supply"),
        ),
        tether=msgspec.structs.replace(
            tether,
            drag_coefficient=tether.drag_coefficient * factor("tether"),
            pull_n=tether.pull_n * factor("tether"),
        ),
    )
