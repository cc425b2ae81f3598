"""Vehicle files and marker maps with stated errors: exact ones, and ones that are off by what they state."""

import tomllib
from dataclasses import dataclass, replace

import msgspec
import numpy as np

from autopilot.calibrate.vehicle_edit import Changes, edited, vehicle_text
from autopilot.core.frames import FloatArray
from autopilot.core.map_errors import DEPTH_SIGMA_M, SCALE_SIGMA
from autopilot.core.markers import MarkerMap
from autopilot.core.toml_table import convert
from autopilot.core.vehicle import Vehicle, load_vehicle

VEHICLE = "lbv150"
EXACT: Changes = {
    "camera.time_offset_sigma_s": 0.0,
    "camera.focal_sigma": 0.0,
    "camera.distortion_sigma": 0.0,
    "camera.position_sigma_m": (0.0, 0.0, 0.0),
    "camera.mounting_sigma_rad": (0.0, 0.0, 0.0),
    "laser.direction_sigma_rad": 0.0,
}
"""Of a vehicle file whose calibration leaves nothing open: what the filter states is its own error."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Drawn:
    """What a vehicle is given that nobody has calibrated."""

    vehicle: Vehicle
    markers: MarkerMap
    late_us: int
    """By which pictures are stamped late."""


def with_camera(vehicle: Vehicle, **changes: object) -> Vehicle:
    """Other keys of its ``[camera]``."""
    return msgspec.structs.replace(vehicle, camera=msgspec.structs.replace(vehicle.eye, **changes))


def exact_text() -> str:
    """The vehicle file with :data:`EXACT`."""
    origin, text = vehicle_text(VEHICLE)
    return edited(text, EXACT, "simulated without errors", origin)


def calibrated() -> Vehicle:
    """The vehicle with :data:`EXACT`."""
    vehicle: Vehicle = convert(tomllib.loads(exact_text()), Vehicle, VEHICLE)
    return vehicle


def exact_map(plan: MarkerMap) -> MarkerMap:
    """The map, stated to be free of common errors."""
    return replace(plan, scale_sigma=0.0, depth_sigma_m=0.0)


def uncertain_map(plan: MarkerMap) -> MarkerMap:
    """The map, with the common errors of one that states nothing."""
    return replace(plan, scale_sigma=SCALE_SIGMA, depth_sigma_m=DEPTH_SIGMA_M)


def drawn(plan: MarkerMap, rng: np.random.Generator) -> Drawn:
    """Vehicle file, map of the floor ``plan`` and stamps that are off by what they state."""
    plain = load_vehicle(VEHICLE)
    eye = plain.eye
    focal, distortion = 1.0 + rng.normal(0.0, (eye.focal_sigma, eye.distortion_sigma))
    vehicle = with_camera(
        plain,
        position_frd_m=tuple(eye.position_frd_m + rng.normal(0.0, eye.position_sigma_m)),
        mounting_rpy_rad=tuple(eye.mounting_rpy_rad + rng.normal(0.0, eye.mounting_sigma_rad)),
        focal_px=tuple(focal * np.array(eye.focal_px)),
        distortion=tuple(distortion * np.array(eye.distortion)),
    )
    middle: FloatArray = plan.centers_ned_m[:, None, :]
    corners = middle + (1.0 + rng.normal(0.0, plan.scale_sigma)) * (plan.corners_ned_m - middle)
    corners = corners + np.array([0.0, 0.0, rng.normal(0.0, plan.depth_sigma_m)])
    late_us = round(1e6 * rng.normal(0.0, eye.time_offset_sigma_s))
    return Drawn(vehicle=vehicle, markers=replace(plan, corners_ned_m=corners), late_us=late_us)
