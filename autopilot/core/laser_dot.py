"""Range from the laser dot's position in the image."""

import math

import numpy as np

from autopilot.core.camera import CameraModel
from autopilot.core.frames import FloatArray

LASER_SIGMA_PX = 0.7
"""Measured on rendered images: 0.2 px in clear water, 0.6 px in haze."""
LASER_OFF_LINE_PX = 6.0
"""Largest distance of the dot from its line."""
LASER_MIN_RANGE_M = 0.1


def dot_range(camera: CameraModel, pixel: FloatArray) -> tuple[float, float] | None:
    """Range along the beam and its sigma [m] from the laser dot's pixel, None for one off its line."""
    dx, dy, dz = camera.laser_direction_cam.tolist()
    ox, oy, oz = camera.laser_offset_cam_m.tolist()
    # A dot at depth Z is seen at (dx, dy) / dz, the beam's vanishing point, plus (ox, oy) / Z, where the beam
    # passes (ox, oy) beside the lens.
    ox, oy = ox - oz * dx / dz, oy - oz * dy / dz
    origin, direction = camera.rays(np.asarray(pixel, dtype=float))
    (px, py, pz), (x, y, _) = origin.tolist(), direction.tolist()
    ox, oy = ox - (px - pz * x), oy - (py - pz * y)  # behind a port, rays miss the lens
    x, y = x - dx / dz, y - dy / dz
    focal = camera.focal_water_px
    base2 = ox * ox + oy * oy
    along = ox * x + oy * y
    if base2 == 0.0 or along <= 0.0 or abs(ox * y - oy * x) / math.sqrt(base2) * focal > LASER_OFF_LINE_PX:
        return None
    depth = base2 / along
    if (depth - oz) / dz < LASER_MIN_RANGE_M:
        return None
    sigma_rad = math.hypot(LASER_SIGMA_PX / focal, camera.laser_sigma_rad)
    return (depth - oz) / dz, depth * depth * sigma_rad / (math.sqrt(base2) * dz)
