"""Detection of the green laser dot: it lies on one line of the image, and its position on it gives the range."""

import math
from typing import Any

import cv2
import numpy as np

from autopilot.core.camera import CameraModel
from autopilot.core.frames import FloatArray
from autopilot.core.robust import MAD_TO_SIGMA
from autopilot.estimator.estimator_tuning import LASER_DOT


def find_dot(image_bgr: Any, camera: CameraModel, range_m: float | None) -> FloatArray | None:
    """Pixel (2,) of the dot near a predicted range along the beam (None: anywhere), None if there is none."""
    if float(np.abs(camera.laser_offset_cam_m[:2]).max()) == 0.0:
        return None
    if range_m is None:
        near, far = LASER_DOT.any_range_m
    else:
        near, far = (
            LASER_DOT.range_band[0] * range_m - LASER_DOT.range_slack_m,
            LASER_DOT.range_band[1] * range_m + LASER_DOT.range_slack_m,
        )
    near = max(near, 0.1)
    ranges = 1.0 / np.linspace(1.0 / near, 1.0 / max(far, 1.1 * near), 12)
    line = camera.laser_pixels(ranges)
    left, top = (math.floor(v) - LASER_DOT.pad_px for v in line.min(axis=0))
    right, bottom = (math.ceil(v) + LASER_DOT.pad_px + 1 for v in line.max(axis=0))
    left, top = max(left, 0), max(top, 0)
    right, bottom = min(right, camera.width_px), min(bottom, camera.height_px)
    if right - left < 2 * LASER_DOT.pad_px or bottom - top < LASER_DOT.pad_px:
        return None
    patch = image_bgr[top:bottom, left:right, :2].astype(np.float32)
    # Under one light, black and white print differ in brightness alone: green follows blue along a straight line, which
    # tint and haze only shift. The laser is above that line.
    blue, green = patch[:, :, 0], patch[:, :, 1]
    blue_off, green_off = blue - blue.mean(), green - green.mean()
    slope = float((blue_off * green_off).sum()) / max(float((blue_off * blue_off).sum()), 1.0)
    smooth = cv2.GaussianBlur(green_off - slope * blue_off, (0, 0), LASER_DOT.smooth_sigma_px)
    level = float(np.median(smooth))
    spread = max(MAD_TO_SIGMA * float(np.median(np.abs(smooth - level))), 0.5)
    inner = _near_line(smooth, line, left, top)
    row, column = (int(v) for v in np.unravel_index(int(inner.argmax()), smooth.shape))
    peak = float(inner[row, column]) - level
    if peak < max(LASER_DOT.min_excess, LASER_DOT.min_contrast * spread):
        return None
    r0, r1 = max(row - LASER_DOT.centroid_px, 0), min(row + LASER_DOT.centroid_px + 1, smooth.shape[0])
    c0, c1 = max(column - LASER_DOT.centroid_px, 0), min(column + LASER_DOT.centroid_px + 1, smooth.shape[1])
    weight = np.maximum(smooth[r0:r1, c0:c1] - level - 0.3 * peak, 0.0)
    total = float(weight.sum())
    rows, columns = np.mgrid[r0:r1, c0:c1]
    return np.array([left + float((weight * columns).sum()) / total, top + float((weight * rows).sum()) / total])


def _near_line(smooth: Any, line: FloatArray, left: int, top: int) -> Any:
    """``smooth`` with everything further than OFF_LINE_PX from the line made small. The line runs along the strip."""
    rows, columns = np.mgrid[0 : smooth.shape[0], 0 : smooth.shape[1]]
    along = line[-1] - line[0]
    normal = np.array([-along[1], along[0]]) / max(float(np.hypot(*along)), 1e-9)
    away = (columns + left - line[0, 0]) * normal[0] + (rows + top - line[0, 1]) * normal[1]
    return np.where(np.abs(away) <= LASER_DOT.off_line_px, smooth, smooth.min())
