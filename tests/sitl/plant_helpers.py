"""Vehicles and plants with single effects switched off, so that closed forms hold."""

import math
from typing import Any

import msgspec
import numpy as np

from autopilot.core.vehicle import Vehicle, load_vehicle
from autopilot.sitl.plant import Plant, Truth
from autopilot.sitl.simulated_waters import SimulatedWaters

VEHICLE = load_vehicle("lbv150")
NEUTRAL = (1500,) * 4 + (0,) * 4
DEEP = (0.0, 0.0, 50.0)
NO_DRAG: dict[str, Any] = {
    "linear_drag_n_s_m": (0.0, 0.0, 0.0),
    "quadratic_drag_n_s2_m2": (0.0, 0.0, 0.0),
    "angular_linear_drag_n_m_s": (0.0, 0.0, 0.0),
    "angular_quadratic_drag_n_m_s2": (0.0, 0.0, 0.0),
}


def body_with(**changes: Any) -> Vehicle:
    """The LBV150 with some body coefficients replaced."""
    return msgspec.structs.replace(VEHICLE, body=msgspec.structs.replace(VEHICLE.body, **changes))


def plant(vehicle: Vehicle = VEHICLE, world: SimulatedWaters | None = None, **options: Any) -> Plant:
    """A plant deep in open still water unless said otherwise."""
    options.setdefault("start_pos_ned_m", DEEP)
    return Plant(vehicle, world if world is not None else SimulatedWaters(), **options)


def terminal_speed(force: float, linear: float, quadratic: float) -> float:
    """Speed at which linear + quadratic drag balance a force."""
    return (-linear + math.sqrt(linear * linear + 4.0 * quadratic * force)) / (2.0 * quadratic)


def kinetic_energy_j(truth: Truth, vehicle: Vehicle = VEHICLE) -> float:
    """Of hull and added mass, in still water."""
    body = vehicle.body
    mass = body.mass_kg + np.array(body.added_mass_kg)
    inertia = np.array(body.inertia_kg_m2) + np.array(body.added_inertia_kg_m2)
    return float(0.5 * (mass @ truth.vel_frd_m_s**2 + inertia @ truth.rate_frd_rad_s**2))
