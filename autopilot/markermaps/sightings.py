"""What a survey starts from: marker corners seen from many places, out of a log or out of pictures."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import msgspec
import numpy as np

from autopilot.core.camera import CameraModel
from autopilot.core.errors import ConfigError, LogError
from autopilot.core.frames import FloatArray
from autopilot.core.markers import IntArray, MarkerMap
from autopilot.core.samples import CameraFrame
from autopilot.core.vehicle import Vehicle
from autopilot.log.reader import Log, open_log
from estimator.vision import MarkerDetector

MIN_MARKERS = 2
"""A view of fewer markers ties nothing to anything."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class View:
    """One image."""

    name: str
    """Time or file."""
    ids: IntArray
    """(n,) as in the map that was looked for (:data:`autopilot.core.markers.ID_SPAN`)."""
    corners_px: FloatArray
    """(n, 4, 2)"""


def log_camera(log: Log) -> CameraModel:
    """The camera of the vehicle that wrote the log. LogError if the log does not hold its file."""
    raw = log.attachments.get("vehicle.json")
    if raw is None:
        raise LogError(f"{log.path}: has no vehicle.json, so its camera is not known; give --vehicle FILE")
    try:
        vehicle = msgspec.json.decode(raw, type=Vehicle)
    except msgspec.ValidationError as error:
        raise LogError(f"{log.path}: vehicle.json: {error}; give --vehicle FILE") from error
    return CameraModel.of(vehicle.camera, vehicle.laser)


def views_of_log(path: Path, most: int) -> tuple[list[View], Log]:
    """Up to ``most`` views evenly over the log, each with two markers or more. LogError if there are none."""
    log = open_log(path)
    if "/in/markers" not in log.topics:
        raise LogError(f"{path}: has no marker sightings (/in/markers); record with the camera")
    table = log["/in/markers"]
    count = np.asarray(table["count"], dtype=np.int64)
    usable = np.flatnonzero(count >= MIN_MARKERS)
    if len(usable) < 2:
        raise LogError(f"{path}: shows two markers at once in {len(usable)} images; fly where markers are in view")
    picks = usable[np.unique(np.linspace(0, len(usable) - 1, min(most, len(usable))).round().astype(int))]
    views = []
    for k in picks:
        n = int(count[k])
        corners = np.asarray(table["corners_px"][k], dtype=float)[: 8 * n].reshape(n, 4, 2)
        ids = np.asarray(table["ids"][k], dtype=np.int64)[:n]
        views.append(_view(f"{table['t_us'][k] * 1e-6:.2f} s", ids, corners))
    return views, log


def views_of_images(paths: Sequence[Path], camera: CameraModel, wanted: MarkerMap) -> list[View]:
    """Markers of ``wanted`` (whatever their places) in image files. ConfigError for a file that is no such image."""
    detector = MarkerDetector(camera, wanted)
    views = []
    for path in paths:
        image = cv2.imread(str(path), cv2.IMREAD_COLOR)
        if image is None:
            raise ConfigError(f"{path}: is not an image that OpenCV reads; give JPEG or PNG files")
        if image.shape[:2] != (camera.height_px, camera.width_px):
            raise ConfigError(
                f"{path}: is {image.shape[1]} x {image.shape[0]} and the camera {camera.width_px} x {camera.height_px}"
                " pixels; give images of this camera, not scaled"
            )
        sighting = detector.detect(CameraFrame(t_us=0, image_bgr=np.asarray(image, dtype=np.uint8)), None)
        if len(sighting.ids) >= MIN_MARKERS:
            views.append(_view(path.name, np.array(sighting.ids, dtype=np.int64), sighting.corners_px))
    if len(views) < 2:
        raise ConfigError(f"two markers at once are in {len(views)} of {len(paths)} images; a survey needs 2 or more")
    return views


def _view(name: str, ids: IntArray, corners_px: FloatArray) -> View:
    """A view without markers that it shows twice: one of the two is wrong."""
    _, first, times = np.unique(ids, return_index=True, return_counts=True)
    once = np.sort(first[times == 1])
    return View(name=name, ids=ids[once], corners_px=corners_px[once])
