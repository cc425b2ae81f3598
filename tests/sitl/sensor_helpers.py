"""Truths to order, and the tank's floor and camera built once."""

from functools import cache
from typing import Any

import msgspec
import numpy as np

from autopilot.core.camera import CameraModel
from autopilot.core.frames import quat_from_rpy
from autopilot.core.vehicle import load_vehicle
from autopilot.sitl.camera_sensor import SimCamera
from autopilot.sitl.floor import Floor, build_floor
from autopilot.sitl.plant import Truth
from autopilot.sitl.scenario import load_scenario
from autopilot.sitl.sensor_tables import ImageModel

VEHICLE = load_vehicle("lbv150")
SCENARIO = load_scenario("paper-tank")
CAMERA = CameraModel.of_vehicle(VEHICLE)
FLOOR_M = 1.5
CLEAN = ImageModel(
    turbidity_1_m=0.0, blur_px=0.0, exposure_s=0.0, noise_levels=0.0, vignetting=0.0, caustics=0.0, laser_brightness=0.0
)


def truth_at(
    pos_ned_m: tuple[float, float, float] = (0.0, 0.0, 0.4),
    rpy_rad: tuple[float, float, float] = (0.0, 0.0, 0.0),
    t_us: int = 0,
    **changes: Any,
) -> Truth:
    """A vehicle at rest somewhere, unless said otherwise."""
    zero = np.zeros(3)
    values: dict[str, Any] = {
        "t_us": t_us,
        "pos_ned_m": np.array(pos_ned_m, dtype=float),
        "rpy_rad": np.array(rpy_rad, dtype=float),
        "quat": quat_from_rpy(np.array(rpy_rad, dtype=float)),
        "vel_frd_m_s": zero,
        "vel_water_frd_m_s": zero,
        "rate_frd_rad_s": zero,
        "accel_frd_m_s2": np.array([0.0, 0.0, -9.81]),
        "current_ned_m_s": zero,
        "thrust_n": np.zeros(8),
        "power_w": 12.0,
        "voltage_v": 18.9,
        "current_a": 0.6,
        "energy_used_j": 0.0,
        "energy_remaining": 1.0,
        "contact_depth_m": 0.0,
        "contact_count": 0,
        "max_penetration_m": 0.0,
        "emerged_m": 0.0,
    }
    return Truth(**{**values, **changes})


def sampled(sensor: Any, seconds: float, **truth: Any) -> list[tuple[int, Any]]:
    """Every sample that a sensor takes of a truth, with the time of its arrival; polled at 100 Hz."""
    arrived = []
    for t_us in range(0, round(seconds * 1e6), 10_000):
        while sensor.next_us <= t_us:
            sensor.observe(truth_at(t_us=sensor.next_us, **truth))
        arrived += [(t_us, sample) for sample in sensor.poll(t_us)]
    return arrived


def height(camera_height_m: float) -> float:
    """Depth of the vehicle whose camera is that high above the floor."""
    return FLOOR_M - camera_height_m - VEHICLE.camera.position_frd_m[2]


@cache
def floor() -> Floor:
    """The floor of the paper's tank."""
    built = build_floor(SCENARIO)
    assert built is not None
    return built


def renderer(imaging: ImageModel = SCENARIO.camera, seed: int = 1, **changes: Any) -> SimCamera:
    """A camera over that floor."""
    return SimCamera(CAMERA, floor(), msgspec.structs.replace(imaging, **changes), seed)
