"""Frames, rotations and angles.

| frame | axes | use |
| --- | --- | --- |
| ``ned`` | north, east, down; origin at the water surface, z = depth | world |
| ``frd`` | forward, right (starboard), down; origin at the centre of gravity | body |
| ``cam`` | OpenCV: x right in the image, y down in the image, z along the optical axis | camera |

A rotation is named ``r_<to>_from_<from>`` so that adjacent names match: ``v_ned = r_ned_from_frd @ v_frd``.
Quaternions are Hamilton, ``[w, x, y, z]``. Euler angles are roll, pitch, yaw in the order z-y-x (Fossen 2011, 2.2).
"""

import math
from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

FloatArray: TypeAlias = NDArray[np.float64]


def wrap_pi(angle_rad: float) -> float:
    """The angle [rad] wrapped to [-pi, pi)."""
    return (angle_rad + math.pi) % (2.0 * math.pi) - math.pi


def unwrap_near(angle_rad: float, reference_rad: float) -> float:
    """``angle_rad`` plus the multiple of 2 pi that brings it within pi of ``reference_rad``."""
    return reference_rad + wrap_pi(angle_rad - reference_rad)


def r_ned_from_frd(rpy_rad: FloatArray) -> FloatArray:
    """Rotation matrix (3, 3) from body (FRD) to world (NED).

    Parameters
    ----------
    rpy_rad
        (3,) roll, pitch, yaw [rad] (Fossen 2011, eq. 2.18).
    """
    roll, pitch, yaw = float(rpy_rad[0]), float(rpy_rad[1]), float(rpy_rad[2])
    cr, sr = math.cos(roll), math.sin(roll)
    cp, sp = math.cos(pitch), math.sin(pitch)
    cy, sy = math.cos(yaw), math.sin(yaw)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def rpy_from_r(r_ned_from_frd_: FloatArray) -> FloatArray:
    """Roll, pitch, yaw (3,) [rad] of a body-to-world rotation matrix (3, 3); pitch in [-pi/2, pi/2]."""
    r = r_ned_from_frd_
    return np.array(
        [
            math.atan2(r[2, 1], r[2, 2]),
            -math.asin(max(-1.0, min(1.0, r[2, 0]))),
            math.atan2(r[1, 0], r[0, 0]),
        ]
    )


def quat_from_rpy(rpy_rad: FloatArray | Sequence[float]) -> FloatArray:
    """Quaternion [w, x, y, z] (body to world) of roll, pitch, yaw (3,) [rad]."""
    roll, pitch, yaw = map(float, rpy_rad)
    hr, hp, hy = 0.5 * roll, 0.5 * pitch, 0.5 * yaw
    cr, sr = math.cos(hr), math.sin(hr)
    cp, sp = math.cos(hp), math.sin(hp)
    cy, sy = math.cos(hy), math.sin(hy)
    return np.array(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ]
    )


def rpy_from_quat(quat: FloatArray | Sequence[float]) -> FloatArray:
    """Roll, pitch, yaw (3,) [rad] of a unit quaternion [w, x, y, z] (body to world)."""
    w, x, y, z = map(float, quat)
    return np.array(
        [
            math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)),
            math.asin(max(-1.0, min(1.0, 2.0 * (w * y - z * x)))),
            math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)),
        ]
    )
