"""The vision front end: markers and laser dot in one image. The only module of the estimator that uses OpenCV.

With a pose prior (a hint), the detector knows ids, positions and sizes of the visible markers: a dictionary of these
ids and one threshold window make it several times as fast (the cost of identification grows with the dictionary in
OpenCV 5.0) and exclude most false ids. Where an expected marker is missing, that part of the image is searched again
with OpenCV's own windows, and what was nearly a marker there is read again (``second_look``). Without a hint the whole
dictionary is searched; that is slow and meant for initialisation, at a rate limited by the caller.

Misread cells are corrected as far as the dictionary's distances allow (``VISION.correction``).

At low contrast (haze) the smoothed mean of blue and green replaces green, with a lower threshold: the same markers at
half the noise. Histogram equalisation (CLAHE) costs more and detects less.

Works with OpenCV 4.10 to 5.x, whose arrays differ in shape.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from autopilot.core.camera import CameraModel
from autopilot.core.dictionaries import opencv_dictionary
from autopilot.core.frames import FloatArray, r_ned_from_frd
from autopilot.core.markers import ID_SPAN, IntArray, MarkerMap
from autopilot.core.samples import MAX_SIGHTED, CameraFrame, MarkerSighting
from autopilot.estimator.estimator_tuning import SECOND_LOOK, VISION
from autopilot.estimator.laser_detector import find_dot
from autopilot.estimator.marker_image import corner_sigma_px, marker_images, patterns_of
from autopilot.estimator.missing_markers import (
    Found,
    Missing,
    areas_of,
    inside,
    missing_markers,
    nearest_of,
    perimeters_px,
)
from autopilot.estimator.second_look import BoolArray, near_predicted, read_again

EXACT = ("DICT_APRILTAG_16h5",)
"""Families that are not corrected: thirty words of 16 cells with one cell wrong, each in four directions, are one in
thirty of all there are, and whatever is square would be a marker."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Hint:
    """Predicted pose of the vehicle at the exposure."""

    pos_ned_m: FloatArray
    """(3,)"""
    rpy_rad: FloatArray
    """(3,)"""


class MarkerDetector:
    """Finds the markers of one map with one camera."""

    def __init__(self, camera: CameraModel, markers: MarkerMap, *, quick: bool = False) -> None:
        """``quick``: without a hint not every marker is found, but enough for a pose."""
        cv2.setNumThreads(1)
        self._camera = camera
        self._markers = markers
        self._floor_m = markers.floor_m
        self._dictionaries = [opencv_dictionary(name) for name in markers.dictionaries]
        self._patterns = [patterns_of(name) for name in markers.dictionaries]
        known = np.unique(markers.ids)
        self._known = [known[known // ID_SPAN == kind] for kind in np.unique(known // ID_SPAN)]
        """Ids of the map, one group for each dictionary."""
        self._quick = quick

    def detect(self, frame: CameraFrame, hint: Hint | None) -> MarkerSighting:
        """Detections in the image; a function of its arguments alone. ``decode_us`` is set by the caller."""
        image = frame.image_bgr
        grey, hazy = grey_of(image)
        # Most maps are of one dictionary; each further kind in view costs a search of its own.
        each = self._blind(grey, hazy) if hint is None else self._predicted(grey, hazy, hint)
        laser = find_dot(image, self._camera, self._laser_range_m(hint)) if self._camera.has_laser else None
        ids = np.array([int(i) for some in each for i in some.ids], dtype=np.int64)
        # All, or as many as a sighting can hold, spread over the picture.
        kept = np.unique(np.linspace(0, len(ids) - 1, min(len(ids), MAX_SIGHTED)).round().astype(np.int64))
        corners_px = np.concatenate([np.empty((0, 4, 2)), *(some.corners_px for some in each)])
        return MarkerSighting(
            t_us=frame.t_us,
            ids=tuple(ids[kept].tolist()),
            corners_px=corners_px[kept],
            laser_px=laser,
            sigma_px=np.concatenate([some.sigma_px for some in each])[kept] if len(ids) else None,
            stamp_sigma_s=frame.stamp_sigma_s,
        )

    def _blind(self, grey: Any, hazy: bool) -> list["_Seen"]:
        """Markers of the whole map. If quick: in the middle of the image, in all of it where these are too few, and
        again where these are."""
        for share in (VISION.middle, 1.0) if self._quick else (1.0,):
            part = _Part.middle_of(grey, share)
            each = [part.back(self._search(part.of(grey), hazy, ids, share)) for ids in self._known]
            if sum(len(some.ids) for some in each) >= VISION.enough:
                break
        return each

    def _predicted(self, grey: Any, hazy: bool, hint: Hint) -> list["_Seen"]:
        """Markers where they should be: in the image, or around its middle where that has enough for a sighting."""
        seen, corners, margin_px = self._expected(hint)
        part = _Part.middle_of(grey, _share_with(VISION.most_expected, corners, grey.shape))
        corners = corners - part.corner_px
        kinds = self._markers.ids[seen] // ID_SPAN
        near = part.near(corners, margin_px)
        return [
            part.back(self._track(part.of(grey), hazy, self._markers.ids[seen[some]], corners[some]))
            for kind in np.unique(kinds[near])
            for some in (near & (kinds == kind),)
        ]

    def _expected(self, hint: Hint) -> tuple[IntArray, FloatArray, float]:
        """Markers that can be in view: their places in the map (n,), predicted corners (n, 4, 2), and how far outside
        of the image these may be [px].
        """
        r = r_ned_from_frd(hint.rpy_rad)
        eye_m = float((hint.pos_ned_m + r @ self._camera.position_frd_m)[2])
        above_m = max(self._floor_m - eye_m, 0.05)
        margin_px = max(VISION.hint_margin_px, VISION.hint_margin_m * self._camera.focal_water_px / above_m)
        return *self._markers.in_view(self._camera, hint.pos_ned_m, r, -margin_px), margin_px

    def _laser_range_m(self, hint: Hint | None) -> float | None:
        if hint is None:
            return None
        r = r_ned_from_frd(hint.rpy_rad)
        start_ned_m = hint.pos_ned_m + r @ self._camera.position_frd_m
        return (self._floor_m - float(start_ned_m[2])) / max(float(r[2, 2]), 0.2)

    def _track(self, grey: Any, hazy: bool, ids: IntArray, predicted: FloatArray) -> "_Seen":
        """Markers of those (n,) that should lie at ``predicted`` (n, 4, 2), all of one dictionary."""
        unique_ids = np.unique(ids)
        dictionary = self._dictionary_of(unique_ids)
        cells = dictionary.markerSize + 2
        sides_px = perimeters_px(predicted) / 4.0
        least_px, most_px = (
            max(float(sides_px.min()), VISION.min_side_px),
            max(float(sides_px.max()), VISION.min_side_px),
        )
        smooth = _smoothed(grey, least_px / cells) if hazy else grey
        placed = self._placed(smooth, hazy, ids, predicted) if len(ids) >= VISION.many else None
        if placed is None:
            seen = _NOTHING
            found, rejected = _detected(smooth, dictionary, unique_ids, least_px, most_px, hazy)
            nearly, left = [rejected], missing_markers(ids, predicted, found, grey.shape)
        else:
            seen, left = placed
            found, nearly = Found(seen.ids, seen.corners_px.astype(np.float32)), []
        if not len(left.places):
            return seen.joined(self._accepted(smooth, dictionary, found.since(len(seen.ids))))
        for x, y, right, bottom in areas_of(left, found, grey.shape):
            part = np.ascontiguousarray(smooth[y:bottom, x:right])
            parameters = _second_pass(least_px, most_px, max(part.shape), hazy, smooth is not grey)
            again, rejected = _quads(part, dictionary, parameters)
            corner_px = np.array([x, y], dtype=np.float32)
            found = found.with_new(Found(unique_ids[again.ids], again.quads + corner_px))
            nearly.append(rejected + corner_px)
        left = missing_markers(ids, predicted, found, grey.shape)
        if len(found.ids):
            nearly.append(left.places)
        nearby = near_predicted(found.elsewhere(np.concatenate(nearly)), left.places, left.spread_px)
        found = self._with_nearly(smooth, dictionary, found, left.ids, *nearby)
        return seen.joined(self._accepted(smooth, dictionary, found.since(len(seen.ids))))

    def _placed(self, smooth: Any, hazy: bool, ids: IntArray, predicted: FloatArray) -> tuple["_Seen", Missing] | None:
        """Those markers, of which a few in the middle are detected: they tell where the others are, to less than a
        cell, and what is there is compared with them. None if too few are found so; those that are not."""
        part = _Part.middle_of(smooth, _share_with(VISION.guides, predicted, smooth.shape))
        near = part.near(predicted - part.corner_px, VISION.hint_margin_px)
        if not near.any():
            return None
        near_ids, sides_px = np.unique(ids[near]), perimeters_px(predicted[near]) / 4.0
        dictionary = self._dictionary_of(near_ids)
        least_px, most_px = max(float(sides_px.min()), VISION.min_side_px), float(sides_px.max())
        guides, _ = _detected(part.of(smooth), dictionary, near_ids, least_px, most_px, hazy)
        if len(guides.ids) < VISION.least_guides:
            return None
        guides = Found(guides.ids, guides.quads + part.corner_px.astype(np.float32))
        which = nearest_of(ids, predicted, guides)
        corners_px, sigma_px, known = predicted.copy(), np.zeros(len(ids)), np.zeros(len(ids), dtype=np.bool_)
        corners_px[which], sigma_px[which], fit = self._measured(smooth, dictionary, guides)
        known[which] = fit >= VISION.least_fit
        for _ in range(VISION.placed_rounds):
            if int(known.sum()) < VISION.least_guides:
                return None
            # An error of the prediction moves what is on a plane as a homography does.
            have, want = (some[known].reshape(-1, 2) for some in (predicted, corners_px))
            moved, _ = cv2.findHomography(have, want, cv2.RANSAC, VISION.placed_px)
            if moved is None:
                return None
            places = cv2.perspectiveTransform(predicted.reshape(1, -1, 2), moved).reshape(-1, 4, 2).astype(np.float32)
            others = np.flatnonzero(~known & inside(places, smooth.shape, 0.0))
            if not len(others):
                break
            corners_px[others], sigma_px[others], fit = self._measured(
                smooth, dictionary, Found(ids[others], places[others])
            )
            off_px = np.abs(corners_px[others] - places[others]).max(axis=2)
            # A corner that would leave its window stays where it was.
            there = (fit >= VISION.placed_fit) & ((off_px > 0.0) & (off_px < VISION.placed_px)).all(axis=1)
            known[others[there]] = True
        left = ~known & inside(places, smooth.shape, VISION.border_px)
        if int(left.sum()) > VISION.most_left * int(known.sum()):
            return None
        good = known & inside(corners_px, smooth.shape, VISION.border_px)
        seen = _Seen(ids[good], corners_px[good], sigma_px[good])
        return seen, Missing(ids[left], places[left].astype(np.float64), VISION.placed_px)

    def _search(self, grey: Any, hazy: bool, ids: IntArray, share: float) -> "_Seen":
        """Markers whose id is one of ``ids``, all of one dictionary, in this share of an image."""
        unique_ids = np.unique(ids)
        dictionary = self._dictionary_of(unique_ids)
        smooth = _smoothed(grey, VISION.hazy_smooth_px[0][0]) if hazy else cv2.GaussianBlur(grey, (3, 3), 0.0)
        found, rejected = _quads(smooth, dictionary, _acquiring(max(grey.shape), hazy))
        seen = smooth if hazy else grey
        if self._quick and (share < 1.0 or len(found.ids) >= VISION.enough):
            return self._accepted(seen, dictionary, Found(unique_ids[found.ids], found.quads))
        # Smoothing removes small or pale markers. Those found need not be identified again.
        rest = cv2.fillPoly(grey.copy(), np.round(found.quads).astype(np.int32), 255.0) if len(found.ids) else grey
        more, nearly = _quads(rest, dictionary, _acquiring_small(max(grey.shape), hazy))
        found = found.with_new(more)
        found = Found(unique_ids[found.ids], found.quads)
        quads = found.elsewhere(np.concatenate((rejected, nearly)))[: SECOND_LOOK.most]
        allowed = np.ones((len(quads), 4, len(unique_ids)), dtype=np.bool_)
        return self._accepted(seen, dictionary, self._with_nearly(seen, dictionary, found, unique_ids, quads, allowed))

    def _with_nearly(
        self, grey: Any, dictionary: Any, found: Found, ids: IntArray, quads: Any, allowed: BoolArray
    ) -> Found:
        """Found markers, and those of ``ids`` (k,) that a second look finds (:func:`read_again`)."""
        if not len(quads):
            return found
        patterns = self._patterns[int(ids[0]) // ID_SPAN][ids % ID_SPAN]
        correct = int(VISION.correction * dictionary.maxCorrectionBits)
        second = read_again(grey, quads, patterns, allowed, correct)
        return Found(np.append(found.ids, ids[second.which]), np.concatenate((found.quads, second.quads)))

    def _accepted(self, grey: Any, dictionary: Any, found: Found) -> "_Seen":
        """Detections with subpixel corners, without those whose appearance does not match their id."""
        if not len(found.ids):
            return _NOTHING
        corners_px, sigma_px, fit = self._measured(grey, dictionary, found)
        sure = fit >= VISION.least_fit
        return _Seen(found.ids[sure], corners_px[sure], sigma_px[sure])

    def _measured(self, grey: Any, dictionary: Any, found: Found) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Subpixel corners (n, 4, 2), their standard deviations (n,) [px] as the log keeps them, and correlation (n,)
        of the cells with the pattern."""
        halves = _window_px(found.quads, dictionary.markerSize + 2)
        quads = _refined(grey, found.quads, halves)
        images = marker_images(grey, quads, self._patterns[int(found.ids[0]) // ID_SPAN][found.ids % ID_SPAN])
        return quads, corner_sigma_px(images, halves).astype(np.float32).astype(np.float64), images.fit

    def _dictionary_of(self, ids: IntArray) -> Any:
        """OpenCV's dictionary of these ids alone, all of one dictionary."""
        kind = int(ids[0]) // ID_SPAN
        whole = self._dictionaries[kind]
        exact = self._markers.dictionaries[kind] in EXACT
        correct = 0 if exact else whole.maxCorrectionBits
        return cv2.aruco.Dictionary(whole.bytesList[ids % ID_SPAN], whole.markerSize, correct)


def _share_with(count: int, corners_px: FloatArray, shape: tuple[int, ...]) -> float:
    """Share of an image's width and height around its middle that holds so many of the markers (n, 4, 2), at most 1."""
    half_px = 0.5 * np.array(shape[::-1])
    reach = np.abs(corners_px / half_px - 1.0).max(axis=(1, 2))
    return 1.0 if len(reach) <= count else min(1.0, float(np.partition(reach, count - 1)[count - 1]))


class _Part(NamedTuple):
    """A part of an image, in whole pixels."""

    left: int
    top: int
    right: int
    bottom: int

    @classmethod
    def middle_of(cls, image: Any, share: float) -> "_Part":
        """The middle with that share of width and height."""
        rows, columns = image.shape
        left, top = round(0.5 * (1.0 - share) * columns), round(0.5 * (1.0 - share) * rows)
        return cls(left, top, columns - left, rows - top)

    @property
    def corner_px(self) -> FloatArray:
        return np.array([self.left, self.top], dtype=float)

    def of(self, image: Any) -> Any:
        return np.ascontiguousarray(image[self.top : self.bottom, self.left : self.right])

    def near(self, corners_px: FloatArray, margin_px: float) -> NDArray[np.bool_]:
        """(n,) which of (n, 4, 2), in pixels of the part, lie in it or no further away than that."""
        size_px = np.array([self.right - self.left, self.bottom - self.top])
        inside = (corners_px > -margin_px) & (corners_px < size_px + margin_px)
        return np.asarray(inside.all(axis=(1, 2)))

    def back(self, seen: "_Seen") -> "_Seen":
        """What was seen in the part, in pixels of the image, as the log keeps them."""
        corners_px = (seen.corners_px + self.corner_px).astype(np.float32).astype(np.float64)
        return seen._replace(corners_px=corners_px)


class _Seen(NamedTuple):
    ids: IntArray
    """(n,)"""
    corners_px: FloatArray
    """(n, 4, 2)"""
    sigma_px: FloatArray
    """(n,) of the corners."""

    def joined(self, more: "_Seen") -> "_Seen":
        if not len(self.ids) or not len(more.ids):
            return self if len(self.ids) else more
        return _Seen(*(np.concatenate(both) for both in zip(self, more, strict=True)))


_NOTHING = _Seen(np.empty(0, dtype=np.int64), np.empty((0, 4, 2)), np.empty(0))


def _quads(grey: Any, dictionary: Any, parameters: Any) -> tuple[Found, Any]:
    """Markers in an image, with their places in the dictionary for ids and corners in whole pixels (float32), and the
    quadrilaterals (m, 4, 2) that are none."""
    quads, indices, rejected = cv2.aruco.ArucoDetector(dictionary, parameters).detectMarkers(grey)
    ids = np.empty(0, dtype=np.int64) if indices is None else np.asarray(indices, dtype=np.int64).ravel()
    found, rest = (np.array(some, dtype=np.float32).reshape(-1, 4, 2) for some in (quads, rejected))
    return Found(ids, found), rest


def _detected(
    smooth: Any, dictionary: Any, unique_ids: IntArray, least_px: float, most_px: float, hazy: bool
) -> tuple[Found, Any]:
    """Markers of that dictionary, of these ids and with sides of about so many pixels, and quadrilaterals that are
    none."""
    # Noise makes thousands of contours, which cost more than the markers: halve where the cells are large enough.
    halved = least_px >= VISION.half_cell_px * (dictionary.markerSize + 2)
    scale = 2.0 if halved else 1.0
    smaller = cv2.pyrDown(smooth) if halved else smooth
    parameters = _tracking(least_px / scale, most_px / scale, max(smaller.shape), hazy, scale)
    found, rejected = _quads(smaller, dictionary, parameters)
    return Found(unique_ids[found.ids], found.quads * np.float32(scale)), rejected * np.float32(scale)


def _window_px(quads: Any, cells: int) -> IntArray:
    """(n,) half widths of the windows in which corners are refined. ``cells``: of a marker's side, border included."""
    steps = quads - np.roll(quads, -1, axis=1)
    cell_px = np.sqrt((steps * steps).sum(axis=2)).min(axis=1) / cells
    return np.asarray(np.clip(np.round(VISION.refine_cells * cell_px), *VISION.refine_window_px), dtype=np.int64)


def _refined(grey: Any, quads: Any, halves: IntArray) -> FloatArray:
    """Corners (n, 4, 2) to fractions of a pixel."""
    corners = np.asarray(quads, dtype=np.float32).copy()
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 20, 0.01)
    for half in np.unique(halves).tolist():
        some = halves == half
        start = np.ascontiguousarray(corners[some].reshape(-1, 1, 2))
        refined = cv2.cornerSubPix(grey, start, (half, half), (-1, -1), criteria)
        corners[some] = np.asarray(refined, dtype=np.float32).reshape(-1, 4, 2)
    return corners.astype(np.float64)


def grey_of(image_bgr: Any) -> tuple[Any, bool]:
    """The image (rows, columns) for detection, and whether it is hazy.

    Water absorbs red first. Green alone is the cheapest with contrast; where noise matters, blue has as much.
    """
    green = cv2.extractChannel(image_bgr, 1)
    _, spread = cv2.meanStdDev(np.ascontiguousarray(green[::4, ::4]))
    if float(spread[0, 0]) >= VISION.hazy_std_dev:
        return green, False
    both = cv2.addWeighted(cv2.extractChannel(image_bgr, 0), 0.5, green, 0.5, 0.0)
    return both, True


def _smoothed(grey: Any, cell_px: float) -> Any:
    """A hazy image with less noise, as far as markers with such cells bear it."""
    side_px = next((side for least_px, side in VISION.hazy_smooth_px if cell_px >= least_px), 1)
    return grey if side_px == 1 else cv2.GaussianBlur(grey, (side_px, side_px), 0.0)


def _parameters(hazy: bool, constant: float, windows_px: tuple[int, int, int]) -> Any:
    """The detector's, with the first, last and step of its threshold windows."""
    parameters = cv2.aruco.DetectorParameters()
    parameters.adaptiveThreshConstant = VISION.hazy_threshold_constant if hazy else constant
    parameters.minOtsuStdDev = VISION.hazy_min_otsu_std_dev if hazy else VISION.min_otsu_std_dev
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_NONE
    parameters.errorCorrectionRate = VISION.correction
    parameters.adaptiveThreshWinSizeMin, parameters.adaptiveThreshWinSizeMax = windows_px[:2]
    parameters.adaptiveThreshWinSizeStep = windows_px[2]
    return parameters


def _bounds(parameters: Any, least_px: float, most_px: float, image_px: int) -> None:
    parameters.minMarkerPerimeterRate = max(VISION.min_side_px, VISION.size_band[0] * least_px) * 4.0 / image_px
    parameters.maxMarkerPerimeterRate = VISION.size_band[1] * 4.0 * most_px / image_px


def _tracking(least_px: float, most_px: float, image_px: int, hazy: bool, scale: float) -> Any:
    parameters = _parameters(hazy, VISION.threshold_constant, (VISION.window_px, VISION.window_px, 1))
    parameters.minDistanceToBorder = round(VISION.border_px / scale)
    _bounds(parameters, least_px, most_px, image_px)
    return parameters


def _second_pass(least_px: float, most_px: float, image_px: int, hazy: bool, smoothed: bool) -> Any:
    windows_px = VISION.hazy_second_windows_px if smoothed else VISION.second_windows_px
    constant = VISION.threshold_constant if hazy else VISION.second_constant
    parameters = _parameters(hazy and smoothed, constant, windows_px)
    _bounds(parameters, least_px, most_px, image_px)
    return parameters


def _acquiring(image_px: int, hazy: bool) -> Any:
    parameters = _parameters(hazy, VISION.threshold_constant, VISION.acquire_windows_px)
    parameters.minMarkerPerimeterRate = 4.0 * VISION.min_side_px / image_px
    return parameters


def _acquiring_small(image_px: int, hazy: bool) -> Any:
    constant = VISION.threshold_constant if hazy else VISION.second_constant
    parameters = _parameters(False, constant, VISION.second_windows_px)
    parameters.minMarkerPerimeterRate = 4.0 * VISION.min_side_px / image_px
    return parameters
