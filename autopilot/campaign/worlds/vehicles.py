"""Vehicles of the random worlds: the shipped one and variants in size, mass, drag, thrust and lag.

Their number is limited, because the control step is compiled once per model; worlds draw one and add a mismatch.
"""

import copy
import math
from importlib import resources
from typing import Any

import numpy as np

from autopilot.core.toml_table import convert, read_toml
from autopilot.core.vehicle import Vehicle

VEHICLES = 12
"""Number 0 is the shipped one."""
SHIPPED = "lbv150"
_SEED = 20_261


def vehicle_tables(number: int) -> dict[str, Any]:
    """The vehicle file of a number from 0 to :data:`VEHICLES` - 1."""
    base = resources.files("autopilot") / "data" / "vehicles" / f"{SHIPPED}.toml"
    with resources.as_file(base) as path:
        tables = read_toml(path)
    return tables if number == 0 else _varied(tables, number)


def vehicle_of(tables: dict[str, Any]) -> Vehicle:
    vehicle: Vehicle = convert(copy.deepcopy(tables), Vehicle, "room")
    return vehicle


def _varied(tables: dict[str, Any], number: int) -> dict[str, Any]:
    """Another vehicle: lengths times a scale, masses with its cube, areas (drag, thrust) with its square."""
    rng = np.random.default_rng((_SEED, number))
    size = float(np.exp(rng.uniform(math.log(0.75), math.log(1.45))))

    def some(low: float, high: float) -> float:
        return float(rng.uniform(low, high))

    tables["name"] = f"room{number}"
    tables["description"] = f"vehicle {number} of the rooms, {size:.2f} times the size of the {SHIPPED}"
    tables["hotel_power_w"] = round(some(8.0, 20.0), 1)
    for key in ("radius_m", "hull_radius_m", "hull_half_height_m"):
        tables[key] = round(tables[key] * size, 3)
    body = tables["body"]
    mass, added, drag = size**3 * some(0.85, 1.2), size**3 * some(0.7, 1.4), size**2 * some(0.7, 1.4)
    _scale(body, mass, "mass_kg", "weight_n", "buoyancy_excess_n")
    body["buoyancy_excess_n"] *= some(0.5, 1.8)
    _scale(body, mass * size**2, "inertia_kg_m2")
    _scale(body, added, "added_mass_kg")
    _scale(body, added * size**2, "added_inertia_kg_m2")
    _scale(body, size, "center_of_buoyancy_frd_m")
    _scale(body, drag, "quadratic_drag_n_s2_m2", "linear_drag_n_s_m")
    _scale(body, drag * size**3, "angular_quadratic_drag_n_m_s2", "angular_linear_drag_n_m_s")
    force = drag * some(0.75, 1.5)
    drive = tables["drive"]
    _scale(drive, force, "limit_n", "forward_n_v2", "reverse_n_v2")
    drive["limit_n"] = round(drive["limit_n"], 2)
    drive["time_constant_s"] = round(some(0.08, 0.3), 3)
    drive["deadband_duty"] = round(some(0.0, 0.08), 3)
    drive["power_w_n15"] = round(some(0.8, 1.6), 2)
    for thruster in tables["thruster"]:
        _scale(thruster, size, "position_frd_m")
    _scale(body["thruster_offset_frd_m"], size, *body["thruster_offset_frd_m"])
    tables["model4"] = _model4(tables)
    tables["sources"] = {"all": f"{SHIPPED}, varied at random"}
    return tables


def _scale(table: dict[str, Any], factor: float, *keys: str) -> None:
    for key in keys:
        value = table[key]
        table[key] = [each * factor for each in value] if isinstance(value, list) else value * factor


def _model4(tables: dict[str, Any]) -> dict[str, Any]:
    """The controller's model: the body on four axes."""
    body = tables["body"]
    mass = [body["mass_kg"] + added for added in body["added_mass_kg"]]
    yaw = body["inertia_kg_m2"][2] + body["added_inertia_kg_m2"][2]
    return {
        "mass_kg": [*mass, yaw],
        "dry_mass_kg": body["mass_kg"],
        "linear_drag": [*body["linear_drag_n_s_m"], body["angular_linear_drag_n_m_s"][2]],
        "quadratic_drag": [*body["quadratic_drag_n_s2_m2"], body["angular_quadratic_drag_n_m_s2"][2]],
        "buoyancy_excess_n": body["buoyancy_excess_n"],
    }


def speed_held_m_s(vehicle: Vehicle, axis: int, force_n: float) -> float:
    """Steady speed relative to the water (axis 0 surge, 1 sway, 2 heave) at which drag takes that force."""
    linear = vehicle.model4.linear_drag[axis]
    square = vehicle.model4.quadratic_drag[axis]
    return (-linear + math.sqrt(linear**2 + 4.0 * square * max(force_n, 0.0))) / (2.0 * square)
