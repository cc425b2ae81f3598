"""The vision front end: markers and laser dot in one image. OpenCV lives here and nowhere else in the estimator.

While the pose is roughly known (a hint), the detector knows which ids can be in view and how large they are: a
dictionary of these few ids and one threshold window make it several times faster (the cost of identification grows with
the dictionary in OpenCV 5.0) and rule out most false ids. Without a hint the whole dictionary is searched; that is slow
and meant for start-up, at a rate that the caller limits.

Works with OpenCV 4.10 to 5.x, whose arrays differ in shape.
"""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from autopilot.core.camera import CameraModel
from autopilot.core.errors import ConfigError
from autopilot.core.frames import FloatArray, r_ned_from_frd
from autopilot.core.markers import IntArray, MarkerMap
from autopilot.core.messages import CameraFrame, MarkerSighting
from estimator.laser_dot import find_dot

HINT_MARGIN_PX = 60.0
"""Markers so far outside of the predicted image may be in view: some centimetres and degrees of error."""
WINDOW_PX = 13
"""The one adaptive threshold window while tracking: about a quarter to a half of a marker's side."""
ACQUIRE_WINDOWS_PX = (7, 31, 8)
"""First, last and step of the windows without a hint."""
THRESHOLD_CONSTANT = 3.0
"""Instead of OpenCV's 7: finds markers that haze has left with little contrast."""
MIN_OTSU_STD_DEV = 2.0
"""Instead of OpenCV's 5, for the same reason."""
SIZE_BAND = (0.6, 1.6)
"""A marker's perimeter may differ by these factors from the predicted one."""
MIN_SIDE_PX = 10.0
"""Smaller markers cannot be read."""
HALF_SIDE_PX = 44.0
"""Markers at least this large are looked for in the image at half its size; their cells still have 3.7 pixels there."""
REFINE_CELLS = 0.72
"""Half width of the corner refinement window in cells of the marker, black border included: a wider window would be
drawn to the next cell's corner."""
REFINE_WINDOW_PX = (2, 5)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Hint:
    """Where the vehicle is thought to be when the image was taken."""

    pos_ned_m: FloatArray
    """(3,)"""
    rpy_rad: FloatArray
    """(3,)"""


class MarkerDetector:
    """Finds the markers of one map with one camera."""

    def __init__(self, camera: CameraModel, markers: MarkerMap) -> None:
        cv2.setNumThreads(1)
        if not hasattr(cv2.aruco, markers.dictionary):
            raise ConfigError(
                f"marker dictionary {markers.dictionary!r} is not known to OpenCV; use e.g. DICT_4X4_1000"
            )
        self._camera = camera
        self._markers = markers
        self._floor_m = float(markers.corners_ned_m[..., 2].mean())
        self._dictionary: Any = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, markers.dictionary))
        self._known: IntArray = np.unique(markers.ids)

    def detect(self, frame: CameraFrame, hint: Hint | None) -> MarkerSighting:
        """What is in the image; a function of its arguments alone. ``decode_us`` is left to the caller's clock."""
        image = frame.image_bgr
        # Water takes red first; green keeps the most contrast.
        grey = np.ascontiguousarray(image[:, :, 1])
        if hint is None:
            ids, side_px = self._known, None
        else:
            ids, side_px = self._expected(hint)
        found, corners = self._search(grey, ids, side_px) if len(ids) else ([], np.empty((0, 4, 2)))
        laser = find_dot(image, self._camera, self._laser_range_m(hint))
        return MarkerSighting(t_us=frame.t_us, ids=tuple(found), corners_px=corners, laser_px=laser)

    def _expected(self, hint: Hint) -> tuple[IntArray, float]:
        """Ids that can be in view, and how long a marker's side is [px]."""
        r = r_ned_from_frd(hint.rpy_rad)
        ids = self._markers.ids[self._markers.visible(self._camera, hint.pos_ned_m, r, -HINT_MARGIN_PX)]
        height_m = self._floor_m - float((hint.pos_ned_m + r @ self._camera.position_frd_m)[2])
        side_px = self._markers.size_m * self._camera.focal_px[0] / max(height_m, 0.05)
        return np.unique(ids), max(side_px, MIN_SIDE_PX)

    def _laser_range_m(self, hint: Hint | None) -> float | None:
        if hint is None:
            return None
        r = r_ned_from_frd(hint.rpy_rad)
        start_ned_m = hint.pos_ned_m + r @ self._camera.position_frd_m
        return (self._floor_m - float(start_ned_m[2])) / max(float(r[2, 2]), 0.2)

    def _search(self, grey: Any, ids: IntArray, side_px: float | None) -> tuple[list[int], FloatArray]:
        """Ids and refined corners (n, 4, 2) of the markers whose id is one of ``ids``."""
        few = cv2.aruco.Dictionary(self._dictionary.bytesList[ids], self._dictionary.markerSize, 0)
        # Noise makes thousands of contours, which cost more than the markers: smooth, and halve where that is possible.
        halved = side_px is not None and side_px >= HALF_SIDE_PX
        smooth = cv2.pyrDown(grey) if halved else cv2.GaussianBlur(grey, (3, 3), 0.0)
        scale = 2.0 if halved else 1.0
        size_px = None if side_px is None else side_px / scale
        detector = cv2.aruco.ArucoDetector(few, _parameters(size_px, max(smooth.shape)))
        quads, indices, _ = detector.detectMarkers(smooth)
        if indices is None or len(quads) == 0:
            return [], np.empty((0, 4, 2))
        corners = np.array(quads, dtype=np.float32).reshape(-1, 2) * np.float32(scale)
        sides_px = np.linalg.norm(np.diff(corners.reshape(-1, 4, 2), axis=1), axis=2).min(axis=1)
        cell_px = float(np.median(sides_px)) / (self._dictionary.markerSize + 2)
        half = int(np.clip(round(REFINE_CELLS * cell_px), *REFINE_WINDOW_PX))
        criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 20, 0.01)
        refined = cv2.cornerSubPix(grey, corners.reshape(-1, 1, 2).copy(), (half, half), (-1, -1), criteria)
        result = np.asarray(refined, dtype=np.float64).reshape(-1, 4, 2)
        return [int(i) for i in ids[np.asarray(indices).ravel()]], result


def _parameters(side_px: float | None, image_px: int) -> Any:
    parameters = cv2.aruco.DetectorParameters()
    parameters.adaptiveThreshConstant = THRESHOLD_CONSTANT
    parameters.minOtsuStdDev = MIN_OTSU_STD_DEV
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_NONE
    if side_px is None:
        first, last, step = ACQUIRE_WINDOWS_PX
        parameters.adaptiveThreshWinSizeMin, parameters.adaptiveThreshWinSizeMax = first, last
        parameters.adaptiveThreshWinSizeStep = step
        parameters.minMarkerPerimeterRate = 4.0 * MIN_SIDE_PX / image_px
    else:
        parameters.adaptiveThreshWinSizeMin = parameters.adaptiveThreshWinSizeMax = WINDOW_PX
        parameters.minMarkerPerimeterRate = max(4.0 * MIN_SIDE_PX, SIZE_BAND[0] * 4.0 * side_px) / image_px
        parameters.maxMarkerPerimeterRate = SIZE_BAND[1] * 4.0 * side_px / image_px
    return parameters
