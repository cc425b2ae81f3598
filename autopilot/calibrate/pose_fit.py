"""Pose of the camera from one sighting, by itself: no attitude prior, no filter.

Least squares over position, rotation and the distance by which blur draws corners into their markers (see
:mod:`.estimator.pnp`, which leans on the AHRS where it has to; a calibration of the AHRS against the camera must not).
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from autopilot.calibrate.calibrate_tuning import POSE_FIT
from autopilot.core.camera import CameraModel
from autopilot.core.frames import FloatArray
from autopilot.core.robust import PLANAR_MEDIAN


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class CameraPose:
    eye_ned_m: FloatArray
    """(3,)"""
    r_ned_from_cam: FloatArray
    """(3, 3)"""
    rms_px: float
    corners: int


def fit_pose(
    camera: CameraModel, points_ned_m: FloatArray, pixels: FloatArray, eye_ned_m: FloatArray, r_ned_from_cam: FloatArray
) -> CameraPose | None:
    """Pose from corners (4n, 3) of n markers and their pixels (4n, 2) from a rough pose; None without a good fit."""
    squares = pixels.reshape(-1, 4, 2)
    inward = squares.mean(axis=1, keepdims=True) - squares
    inward /= np.maximum(np.linalg.norm(inward, axis=2, keepdims=True), 1e-9)
    inward = inward.reshape(-1, 2)
    keep = np.ones(len(pixels), dtype=bool)
    eye, r = np.array(eye_ned_m, dtype=float), np.array(r_ned_from_cam, dtype=float)
    shrink = POSE_FIT.shrink_px
    weight = (POSE_FIT.corner_sigma_px / POSE_FIT.shrink_sigma_px) ** 2
    off = np.zeros(len(pixels))
    for step in range(POSE_FIT.steps):
        cam = (points_ned_m - eye) @ r
        seen, slopes = camera.linearise(cam)
        residual = pixels - shrink * inward - seen
        if not np.isfinite(residual).all():
            return None
        off = np.linalg.norm(residual, axis=1)
        if step >= 3:
            keep = off <= max(POSE_FIT.corner_floor_px, POSE_FIT.corner_sigmas * float(np.median(off)) / PLANAR_MEDIAN)
        jac = np.empty((len(pixels), 2, 7))
        jac[:, :, :3] = -slopes @ r.T
        jac[:, :, 3:6] = np.cross(slopes, cam[:, None, :])
        jac[:, :, 6] = inward
        flat, error = jac[keep].reshape(-1, 7), residual[keep].reshape(-1)
        normal, gradient = flat.T @ flat, flat.T @ error
        normal[6, 6] += weight
        gradient[6] += weight * (POSE_FIT.shrink_px - shrink)
        try:
            delta = np.linalg.solve(normal, gradient)
        except np.linalg.LinAlgError:
            return None
        eye, shrink = eye + delta[:3], shrink + float(delta[6])
        r = r @ Rotation.from_rotvec(delta[3:6]).as_matrix()
        if step > 3 and float(np.abs(delta[:6]).max()) < POSE_FIT.converged:
            break
    rms_px = math.sqrt(float((off[keep] ** 2).mean()))
    if (
        not rms_px < POSE_FIT.max_rms_px
        or 4 * int(keep.sum()) < 3 * len(keep)
        or int(keep.sum()) < POSE_FIT.min_corners
    ):
        return None
    return CameraPose(eye_ned_m=eye, r_ned_from_cam=r, rms_px=rms_px, corners=int(keep.sum()))
