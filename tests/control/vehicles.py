"""Vehicles with any thrusters, for tests: hulls and drives of the LBV150 or a BlueROV2 under other allocations."""

import math
from typing import Any

import msgspec
import numpy as np

from autopilot.core.control_allocator import lacking_thrust
from autopilot.core.frames import FloatArray
from autopilot.core.thrusters import ThrusterTable
from autopilot.core.vehicle import Model4Table, Vehicle, load_vehicle

LBV150 = load_vehicle("lbv150")

BLUEROV2_HULL: dict[str, Any] = {
    "mass_kg": (17.0, 24.2, 26.07, 0.28),
    "linear_drag": (4.03, 6.22, 5.18, 0.07),
    "quadratic_drag": (18.18, 21.66, 36.99, 1.55),
    "buoyancy_excess_n": 2.0,
}
"""Wu 2018."""

ALONG_M, ASIDE_M = 0.156, 0.111
"""Where the four horizontal thrusters of a BlueROV2 sit."""


def vectored(verticals: int) -> FloatArray:
    """(4, 4 + verticals): four thrusters at 45 degrees, the rest straight down."""
    columns = []
    for x, y in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        # Outward at the bow and at the stern, each pushing ahead.
        push = np.array([math.sqrt(0.5), -x * y * math.sqrt(0.5)])
        columns.append([push[0], push[1], 0.0, x * ALONG_M * push[1] - y * ASIDE_M * push[0]])
    columns += [[0.0, 0.0, 1.0, 0.0]] * verticals
    return np.array(columns).T


def vehicle_with(allocation: FloatArray, like: Vehicle = LBV150, **hull: object) -> Vehicle:
    """The vehicle with other thrusters (columns of ``allocation``: a direction and what it turns) and another hull."""
    tables = []
    for i, (x, y, z, turn) in enumerate(allocation.T.tolist()):
        arm = turn / max(x * x + y * y, 1e-12)
        tables.append(ThrusterTable(name=f"t{i + 1}", position_frd_m=(arm * y, -arm * x, 0.0), direction_frd=(x, y, z)))
    table = msgspec.structs.replace(like.model4, **hull)
    assert isinstance(table, Model4Table)
    body = msgspec.structs.replace(like.body, thruster_offset_frd_m={})
    return msgspec.structs.replace(like, name="made", model4=table, body=body, thruster_tables=tuple(tables))


def bluerov2(verticals: int = 2) -> Vehicle:
    """A BlueROV2, with four verticals a Heavy (in four degrees of freedom)."""
    return vehicle_with(vectored(verticals), **BLUEROV2_HULL)


def drawn(rng: np.random.Generator, thrusters: int) -> Vehicle:
    """Thrusters anywhere on the hull in any direction, as long as they push along every axis."""
    while True:
        direction = rng.normal(size=(3, thrusters))
        direction /= np.linalg.norm(direction, axis=0)
        place = rng.uniform(-0.2, 0.2, size=(2, thrusters))
        yaw = place[0] * direction[1] - place[1] * direction[0]
        vehicle = vehicle_with(np.vstack([direction, yaw]))
        if not lacking_thrust(vehicle.to_model(), np.full(thrusters, 0.25 * vehicle.drive.limit_n)):
            return vehicle
