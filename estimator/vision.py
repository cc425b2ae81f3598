"""The vision front end: markers and laser dot in one image. OpenCV lives here and nowhere else in the estimator.

While the pose is roughly known (a hint), the detector knows which ids can be in view and how large they are: a
dictionary of these few ids and one threshold window make it several times faster (the cost of identification grows with
the dictionary in OpenCV 5.0) and rule out most false ids. Without a hint the whole dictionary is searched; that is slow
and meant for start-up, at a rate that the caller limits.

Where haze has left little contrast, the mean of blue and green, smoothed, takes the place of green, and the threshold
is lower: the same markers with half of the noise. Equalising the histogram (CLAHE) instead costs more and finds less.

Works with OpenCV 4.10 to 5.x, whose arrays differ in shape.
"""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from autopilot.core.camera import CameraModel
from autopilot.core.errors import ConfigError
from autopilot.core.frames import FloatArray, r_ned_from_frd
from autopilot.core.markers import ID_SPAN, IntArray, MarkerMap
from autopilot.core.samples import CameraFrame, MarkerSighting
from estimator.laser_dot import find_dot

HINT_MARGIN_PX, HINT_MARGIN_M = 60.0, 0.06
"""Markers so far outside of the predicted image (the larger one, seen on the floor) may be in view: some centimetres
and degrees of error. Close to the floor a centimetre is many pixels."""
WINDOW_PX = 13
"""The one adaptive threshold window while tracking: about a quarter to a half of a marker's side."""
ACQUIRE_WINDOWS_PX = (7, 31, 8)
"""First, last and step of the windows without a hint."""
THRESHOLD_CONSTANT = 3.0
"""Instead of OpenCV's 7: finds markers that haze has left with little contrast."""
MIN_OTSU_STD_DEV = 2.0
"""Instead of OpenCV's 5, for the same reason."""
HAZY_STD_DEV = 24.0
"""An image whose grey levels spread by less than this standard deviation is hazy: a floor of markers has 74 in clear
water, 32 at turbidity 1 1/m and 0.8 m, 15 at 2 1/m, 4 at 3 1/m and 1.2 m."""
HAZY_THRESHOLD_CONSTANT, HAZY_MIN_OTSU_STD_DEV = 1.5, 1.0
"""Find all markers at 1 m and 3 1/m, where 3 and 2 find one in twenty; the smoothing keeps noise out."""
HAZY_SMOOTH_PX = 5
"""Side of the Gaussian that smooths hazy images: halves the error of the pose (5 against 10 mm at 1 m and 3 1/m)."""
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
        for name in markers.dictionaries:
            if not hasattr(cv2.aruco, name):
                raise ConfigError(f"marker dictionary {name!r} is not known to OpenCV; use e.g. DICT_4X4_1000")
        self._camera = camera
        self._markers = markers
        self._floor_m = markers.floor_m
        self._dictionaries: list[Any] = [
            cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name)) for name in markers.dictionaries
        ]
        self._known: IntArray = np.unique(markers.ids)

    def detect(self, frame: CameraFrame, hint: Hint | None) -> MarkerSighting:
        """What is in the image; a function of its arguments alone. ``decode_us`` is left to the caller's clock."""
        image = frame.image_bgr
        grey, hazy = grey_of(image)
        found: list[int] = []
        corners = np.empty((0, 4, 2))
        # Most maps are of one dictionary; each further kind in view costs a search of its own.
        for ids, sides_px in self._acquisition() if hint is None else self._expected(hint):
            more, where = self._search(grey, hazy, ids, sides_px)
            found += more
            corners = np.concatenate((corners, where))
        laser = find_dot(image, self._camera, self._laser_range_m(hint))
        return MarkerSighting(t_us=frame.t_us, ids=tuple(found), corners_px=corners, laser_px=laser)

    def _acquisition(self) -> list[tuple[IntArray, None]]:
        """All ids of the map, one group for each dictionary."""
        kinds = self._known // ID_SPAN
        return [(self._known[kinds == kind], None) for kind in np.unique(kinds)]

    def _expected(self, hint: Hint) -> list[tuple[IntArray, tuple[float, float]]]:
        """Ids that can be in view, one group for each dictionary, and how long markers' sides are at least and at
        most [px]."""
        r = r_ned_from_frd(hint.rpy_rad)
        eye_m = float((hint.pos_ned_m + r @ self._camera.position_frd_m)[2])
        above_m = max(self._floor_m - eye_m, 0.05)
        margin_px = max(HINT_MARGIN_PX, HINT_MARGIN_M * self._camera.focal_water_px / above_m)
        seen = self._markers.visible(self._camera, hint.pos_ned_m, r, -margin_px)
        height_m = np.maximum(self._markers.centers_ned_m[seen, 2] - eye_m, 0.05)
        side_px = np.maximum(self._markers.sizes_m[seen] * self._camera.focal_water_px / height_m, MIN_SIDE_PX)
        ids = self._markers.ids[seen]
        groups = []
        for kind in np.unique(ids // ID_SPAN):
            here = ids // ID_SPAN == kind
            groups.append((np.unique(ids[here]), (float(side_px[here].min()), float(side_px[here].max()))))
        return groups

    def _laser_range_m(self, hint: Hint | None) -> float | None:
        if hint is None:
            return None
        r = r_ned_from_frd(hint.rpy_rad)
        start_ned_m = hint.pos_ned_m + r @ self._camera.position_frd_m
        return (self._floor_m - float(start_ned_m[2])) / max(float(r[2, 2]), 0.2)

    def _search(
        self, grey: Any, hazy: bool, ids: IntArray, sides_px: tuple[float, float] | None
    ) -> tuple[list[int], FloatArray]:
        """Ids and refined corners (n, 4, 2) of the markers whose id is one of ``ids``, all of one dictionary."""
        dictionary = self._dictionaries[int(ids[0]) // ID_SPAN]
        few = cv2.aruco.Dictionary(dictionary.bytesList[ids % ID_SPAN], dictionary.markerSize, 0)
        # Noise makes thousands of contours, which cost more than the markers: smooth, and halve where that is possible.
        halved = sides_px is not None and sides_px[0] >= HALF_SIDE_PX
        smooth = cv2.pyrDown(grey) if halved else cv2.GaussianBlur(grey, (3, 3), 0.0)
        scale = 2.0 if halved else 1.0
        band_px = None if sides_px is None else (sides_px[0] / scale, sides_px[1] / scale)
        detector = cv2.aruco.ArucoDetector(few, _parameters(band_px, max(smooth.shape), hazy))
        quads, indices, _ = detector.detectMarkers(smooth)
        if indices is None or len(quads) == 0:
            return [], np.empty((0, 4, 2))
        corners = np.array(quads, dtype=np.float32).reshape(-1, 2) * np.float32(scale)
        sides_px = np.linalg.norm(np.diff(corners.reshape(-1, 4, 2), axis=1), axis=2).min(axis=1)
        cell_px = float(np.median(sides_px)) / (dictionary.markerSize + 2)
        half = int(np.clip(round(REFINE_CELLS * cell_px), *REFINE_WINDOW_PX))
        criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 20, 0.01)
        refined = cv2.cornerSubPix(grey, corners.reshape(-1, 1, 2).copy(), (half, half), (-1, -1), criteria)
        result = np.asarray(refined, dtype=np.float64).reshape(-1, 4, 2)
        return [int(i) for i in ids[np.asarray(indices).ravel()]], result


def grey_of(image_bgr: Any) -> tuple[Any, bool]:
    """The image (rows, columns) in which markers are looked for, and whether it is hazy.

    Water takes red first. Green alone is the cheapest that keeps contrast; where noise matters, blue has as much."""
    green = np.ascontiguousarray(image_bgr[:, :, 1])
    _, spread = cv2.meanStdDev(np.ascontiguousarray(green[::4, ::4]))
    if float(spread[0, 0]) >= HAZY_STD_DEV:
        return green, False
    both = cv2.addWeighted(np.ascontiguousarray(image_bgr[:, :, 0]), 0.5, green, 0.5, 0.0)
    return cv2.GaussianBlur(both, (HAZY_SMOOTH_PX, HAZY_SMOOTH_PX), 0.0), True


def _parameters(sides_px: tuple[float, float] | None, image_px: int, hazy: bool) -> Any:
    parameters = cv2.aruco.DetectorParameters()
    parameters.adaptiveThreshConstant = HAZY_THRESHOLD_CONSTANT if hazy else THRESHOLD_CONSTANT
    parameters.minOtsuStdDev = HAZY_MIN_OTSU_STD_DEV if hazy else MIN_OTSU_STD_DEV
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_NONE
    if sides_px is None:
        first, last, step = ACQUIRE_WINDOWS_PX
        parameters.adaptiveThreshWinSizeMin, parameters.adaptiveThreshWinSizeMax = first, last
        parameters.adaptiveThreshWinSizeStep = step
        parameters.minMarkerPerimeterRate = 4.0 * MIN_SIDE_PX / image_px
    else:
        parameters.adaptiveThreshWinSizeMin = parameters.adaptiveThreshWinSizeMax = WINDOW_PX
        parameters.minMarkerPerimeterRate = max(4.0 * MIN_SIDE_PX, SIZE_BAND[0] * 4.0 * sides_px[0]) / image_px
        parameters.maxMarkerPerimeterRate = SIZE_BAND[1] * 4.0 * sides_px[1] / image_px
    return parameters
