"""Pose of the vehicle from known points and their pixels: Gauss-Newton over position and rotation, with its covariance.

All six degrees of freedom are solved for. The AHRS's roll and pitch come in as two weak extra residuals, which decide
when one or two markers leave the tilt open and do not matter when many are seen.
"""

import math
from typing import NamedTuple

import numpy as np

from autopilot.core.camera import NEAR_M, CameraModel
from autopilot.core.frames import FloatArray, r_ned_from_frd, rpy_from_r
from estimator.measure_pose import MIN_SIGMA_POS_M, MIN_SIGMA_YAW_RAD

STEPS = 10
CONVERGED = 4e-3
"""Steps end when nothing moved by more than this [m, rad]; what is left is about its square, 0.02 mm."""
TILT_SIGMA_FEW_RAD = 0.009
"""0.5 degrees: the AHRS's tilt as a prior when at most two markers are seen."""
TILT_SIGMA_MANY_RAD = 0.09
"""5 degrees otherwise: the AHRS's tilt error times the height would be worse than what many corners say."""
FEW_POINTS = 8
MIN_SIGMA_PX = 0.25
INFLATION = 2.0
"""Corners of one marker share errors, so the covariance from independent corners is too small by this factor."""


class Pose(NamedTuple):
    """A solved pose."""

    pos_ned_m: FloatArray
    """(3,)"""
    rpy_rad: FloatArray
    """(3,)"""
    covariance: FloatArray
    """(4, 4) of north, east, down, yaw; floors included."""
    sigma_tilt_rad: float
    """Larger one of the standard deviations of the two tilts."""
    residual_px: FloatArray
    """(m, 2)"""
    rms_px: float


def solve_pose(
    camera: CameraModel,
    points_ned_m: FloatArray,
    pixels: FloatArray,
    pos_ned_m: FloatArray,
    rpy_rad: FloatArray,
    max_rms_px: float,
) -> Pose | None:
    """Pose from m >= 3 points (m, 3) and pixels (m, 2), starting at a rough pose.

    None if it does not converge or if the residuals' root mean square is above ``max_rms_px``."""
    pos = np.array(pos_ned_m, dtype=float)
    rotation = r_ned_from_frd(rpy_rad)
    up_prior = rotation.T[:, 2].copy()
    sigma_tilt = TILT_SIGMA_FEW_RAD if len(points_ned_m) <= FEW_POINTS else TILT_SIGMA_MANY_RAD
    for _ in range(STEPS):
        linear = _linearise(camera, points_ned_m, pixels, pos, rotation)
        if linear is None:
            return None
        residual, jac = linear
        sigma_px = max(MIN_SIGMA_PX, _rms(residual))
        information, gradient = _normal_equations(residual, jac, sigma_px, rotation, up_prior, sigma_tilt)
        delta: FloatArray = np.asarray(np.linalg.solve(information, gradient), dtype=np.float64)
        pos = pos + delta[:3]
        rotation = _turn(delta[3:]) @ rotation
        residual = residual - jac @ delta
        if float(np.abs(delta).max()) < CONVERGED:
            break
    else:
        return None
    rms = _rms(residual)
    if not rms <= max_rms_px:
        return None
    information, _ = _normal_equations(residual, jac, max(MIN_SIGMA_PX, rms), rotation, up_prior, sigma_tilt)
    covariance = INFLATION * np.linalg.inv(information)
    pick = np.array([0, 1, 2, 5])
    noise = covariance[np.ix_(pick, pick)]
    noise[np.arange(4), np.arange(4)] += np.array([MIN_SIGMA_POS_M] * 3 + [MIN_SIGMA_YAW_RAD]) ** 2
    sigma_tilt_rad = float(np.sqrt(max(covariance[3, 3], covariance[4, 4])))
    return Pose(pos, rpy_from_r(rotation), noise, sigma_tilt_rad, residual.reshape(-1, 2), rms)


def _linearise(
    camera: CameraModel, points: FloatArray, pixels: FloatArray, pos: FloatArray, rotation: FloatArray
) -> tuple[FloatArray, FloatArray] | None:
    """Residual (2m,) pixels minus projection, and d projection / d (position, small rotation in NED) (2m, 6)."""
    r_cam_from_ned = (rotation @ camera.r_frd_from_cam).T
    arm = points - pos
    cam = arm @ r_cam_from_ned.T - camera.r_frd_from_cam.T @ camera.position_frd_m
    z = cam[:, 2]
    if not float(z.min()) > NEAR_M:
        return None
    x, y = cam[:, 0] / z, cam[:, 1] / z
    k1, k2, p1, p2, k3 = camera.distortion
    fx, fy = camera.focal_px
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = 2.0 * (k1 + r2 * (2.0 * k2 + 3.0 * r2 * k3))
    xy = x * y
    residual = np.empty((len(z), 2))
    residual[:, 0] = pixels[:, 0] - camera.center_px[0] - fx * (x * radial + 2.0 * p1 * xy + p2 * (r2 + 2.0 * x * x))
    residual[:, 1] = pixels[:, 1] - camera.center_px[1] - fy * (y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * xy)
    dux = fx * (radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x)
    duy = fx * (slope * xy + 2.0 * p1 * x + 2.0 * p2 * y)
    dvx = fy * (slope * xy + 2.0 * p1 * x + 2.0 * p2 * y)
    dvy = fy * (radial + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x)
    # d pixel / d camera coordinates, (m, 2, 3), then to NED by the chain rule: cam = C (point - pos) - const.
    by_cam = np.empty((len(z), 2, 3))
    by_cam[:, 0, 0], by_cam[:, 0, 1] = dux / z, duy / z
    by_cam[:, 1, 0], by_cam[:, 1, 1] = dvx / z, dvy / z
    by_cam[:, 0, 2] = -(by_cam[:, 0, 0] * x + by_cam[:, 0, 1] * y)
    by_cam[:, 1, 2] = -(by_cam[:, 1, 0] * x + by_cam[:, 1, 1] * y)
    by_point = by_cam.reshape(-1, 3) @ r_cam_from_ned
    jac = np.empty((2 * len(z), 6))
    jac[:, :3] = -by_point
    arm2 = np.repeat(arm, 2, axis=0)
    # A rotation by t in NED moves a point as seen from the vehicle by -t x arm; g . (arm x t) = (g x arm) . t
    jac[:, 3] = by_point[:, 1] * arm2[:, 2] - by_point[:, 2] * arm2[:, 1]
    jac[:, 4] = by_point[:, 2] * arm2[:, 0] - by_point[:, 0] * arm2[:, 2]
    jac[:, 5] = by_point[:, 0] * arm2[:, 1] - by_point[:, 1] * arm2[:, 0]
    return residual.reshape(-1), jac


def _normal_equations(
    residual: FloatArray,
    jac: FloatArray,
    sigma_px: float,
    rotation: FloatArray,
    up_prior: FloatArray,
    sigma_tilt: float,
) -> tuple[FloatArray, FloatArray]:
    """Information (6, 6) and gradient (6,) of pixels and tilt prior."""
    weight = 1.0 / (sigma_px * sigma_px)
    information = weight * (jac.T @ jac)
    gradient = weight * (jac.T @ residual)
    # The prior's vertical, seen through this rotation, leans off the vertical: turning by (-lean_e, lean_n) rights it.
    lean = rotation @ up_prior
    tilt = 1.0 / (sigma_tilt * sigma_tilt)
    information[3, 3] += tilt
    information[4, 4] += tilt
    gradient[3] += tilt * float(lean[1])
    gradient[4] -= tilt * float(lean[0])
    return information, gradient


def _rms(residual: FloatArray) -> float:
    return math.sqrt(float(residual @ residual) / len(residual))


def _turn(vector: FloatArray) -> FloatArray:
    """Rotation matrix (3, 3) of a rotation vector (Rodrigues)."""
    a, b, c = vector.tolist()
    angle = math.sqrt(a * a + b * b + c * c)
    if angle < 1e-12:
        return np.eye(3)
    x, y, z = a / angle, b / angle, c / angle
    s, v = math.sin(angle), 1.0 - math.cos(angle)
    return np.array(
        [
            [1.0 - v * (y * y + z * z), v * x * y - s * z, v * x * z + s * y],
            [v * x * y + s * z, 1.0 - v * (x * x + z * z), v * y * z - s * x],
            [v * x * z - s * y, v * y * z + s * x, 1.0 - v * (x * x + y * y)],
        ]
    )
