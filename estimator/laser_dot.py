"""The green laser dot: it can only lie on one line of the image, at a place that tells the range."""

import math
from typing import Any

import cv2
import numpy as np

from autopilot.core.camera import CameraModel
from autopilot.core.frames import FloatArray

RANGE_BAND = (0.75, 1.35)
"""The dot is looked for within these factors of the predicted range."""
RANGE_SLACK_M = 0.03
ANY_RANGE_M = (0.2, 3.0)
"""Where to look without a prediction."""
PAD_PX = 8
"""Half height of the strip: tilt between beam and axis, distortion."""
SMOOTH_SIGMA_PX = 1.5
"""Of the dot's image."""
MIN_EXCESS = 12.0
"""Grey levels by which the smoothed dot must be greener than what is around it."""
MIN_CONTRAST = 5.0
"""The dot's excess in robust standard deviations of the strip."""
CENTROID_PX = 3
"""Half width of the window whose centre of mass is the dot."""


def find_dot(image_bgr: Any, camera: CameraModel, range_m: float | None) -> FloatArray | None:
    """Pixel (2,) of the dot near a predicted range along the beam (None: anywhere), None if there is none."""
    if float(np.abs(camera.laser_offset_cam_m[:2]).max()) == 0.0:
        return None
    if range_m is None:
        near, far = ANY_RANGE_M
    else:
        near, far = RANGE_BAND[0] * range_m - RANGE_SLACK_M, RANGE_BAND[1] * range_m + RANGE_SLACK_M
    near = max(near, 0.1)
    ranges = 1.0 / np.linspace(1.0 / near, 1.0 / max(far, 1.1 * near), 12)
    line = np.array([camera.laser_pixel(float(r)) for r in ranges])
    left, top = (math.floor(v) - PAD_PX for v in line.min(axis=0))
    right, bottom = (math.ceil(v) + PAD_PX + 1 for v in line.max(axis=0))
    left, top = max(left, 0), max(top, 0)
    right, bottom = min(right, camera.width_px), min(bottom, camera.height_px)
    if right - left < 2 * PAD_PX or bottom - top < PAD_PX:
        return None
    patch = image_bgr[top:bottom, left:right].astype(np.float32)
    excess = patch[:, :, 1] - 0.5 * (patch[:, :, 0] + patch[:, :, 2])
    smooth = cv2.GaussianBlur(excess, (0, 0), SMOOTH_SIGMA_PX)
    # Tinted light makes all white look a little green, more so where it is brighter: judge against the surroundings.
    level = float(np.median(smooth))
    spread = max(1.4826 * float(np.median(np.abs(smooth - level))), 1.0)
    row, column = (int(v) for v in np.unravel_index(int(smooth.argmax()), smooth.shape))
    peak = float(smooth[row, column]) - level
    if peak < max(MIN_EXCESS, MIN_CONTRAST * spread):
        return None
    r0, r1 = max(row - CENTROID_PX, 0), min(row + CENTROID_PX + 1, smooth.shape[0])
    c0, c1 = max(column - CENTROID_PX, 0), min(column + CENTROID_PX + 1, smooth.shape[1])
    weight = np.maximum(smooth[r0:r1, c0:c1] - level - 0.3 * peak, 0.0)
    total = float(weight.sum())
    rows, columns = np.mgrid[r0:r1, c0:c1]
    return np.array([left + float((weight * columns).sum()) / total, top + float((weight * rows).sum()) / total])
