"""Input of a survey: marker corners from many viewpoints, from a log, pictures or videos."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

from autopilot.core.camera import CameraModel
from autopilot.core.errors import ConfigError, LogError, SourceError
from autopilot.core.frames import FloatArray
from autopilot.core.markers import ID_SPAN, IntArray, MarkerMap
from autopilot.core.samples import CameraFrame
from autopilot.core.vehicle import Vehicle
from autopilot.estimator.marker_image import misread_cells, patterns_of
from autopilot.estimator.vision import MarkerDetector
from autopilot.log.reader import Log, open_log
from autopilot.markermaps.markermaps_tuning import SIGHTINGS

FILMS = (".mp4", ".avi", ".mkv", ".mov", ".webm", ".mjpg", ".m4v")
"""Endings of films."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SheetView:
    name: str
    """Time or file."""
    ids: IntArray
    """(n,) as in the map searched for (:data:`autopilot.core.markers.ID_SPAN`)."""
    corners_px: FloatArray
    """(n, 4, 2)"""
    repeated: tuple[int, ...] = ()
    """Ids that it shows twice; they are left out."""
    misread: tuple[int, ...] = ()
    """Ids of which :data:`SIGHTINGS.misread_cells` cells or more are not as they should be."""


def log_camera(log: Log) -> CameraModel:
    """The camera of the vehicle that wrote the log. LogError if the log does not hold its file."""
    raw = log.attachments.get("vehicle.json")
    if raw is None:
        raise LogError(f"{log.path}: has no vehicle.json, so its camera is not known; give --vehicle FILE")
    try:
        vehicle = msgspec.json.decode(raw, type=Vehicle)
    except msgspec.ValidationError as error:
        raise LogError(f"{log.path}: vehicle.json: {error}; give --vehicle FILE") from error
    return CameraModel.of_vehicle(vehicle)


def views_of_log(path: Path, most: int) -> tuple[list[SheetView], Log]:
    """Up to ``most`` views evenly over the log, each with two markers or more. LogError if there are none."""
    log = open_log(path)
    if "/in/markers" not in log.topics:
        raise log.lacks("no marker sightings (/in/markers)", "record with the camera")
    table = log["/in/markers"]
    count = np.asarray(table["count"], dtype=np.int64)
    usable = np.flatnonzero(count >= SIGHTINGS.min_markers)
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


def views_of_images(
    paths: Sequence[Path], camera: CameraModel, wanted: MarkerMap, most: int = SIGHTINGS.most_of_a_film
) -> list[SheetView]:
    """Markers of ``wanted`` (whatever their places) in image files, and in up to ``most`` frames of each film.
    ConfigError for a file that is neither, or of another size."""
    detector = MarkerDetector(camera, wanted)
    views, count = [], 0
    for name, path, image in _images(paths, most):
        count += 1
        if image.shape[:2] != (camera.height_px, camera.width_px):
            raise ConfigError(
                f"{path}: is {image.shape[1]} x {image.shape[0]} and the camera {camera.width_px} x {camera.height_px}"
                " pixels; give images of this camera, not scaled"
            )
        sighting = detector.detect(CameraFrame(t_us=0, image_bgr=np.asarray(image, dtype=np.uint8)), None)
        if len(sighting.ids) >= SIGHTINGS.min_markers:
            ids = np.array(sighting.ids, dtype=np.int64)
            misread = _misread(image, wanted, ids, sighting.corners_px)
            views.append(_view(name, ids, sighting.corners_px, tuple(sorted(set(ids[misread].tolist())))))
    if len(views) < 2:
        raise ConfigError(f"two markers at once are in {len(views)} of {count} images; a survey needs 2 or more")
    return views


def _images(paths: Sequence[Path], most: int) -> Iterator[tuple[str, Path, Any]]:
    """Name, file and pixels of all pictures."""
    for path in paths:
        if path.suffix.lower() in FILMS:
            yield from ((f"{path.name} {number}", path, image) for number, image in _frames(path, most))
            continue
        image = cv2.imread(str(path), cv2.IMREAD_COLOR)
        if image is None:
            raise SourceError(f"{path}: is not an image that OpenCV reads; give JPEG or PNG files, or a film")
        yield path.name, path, image


def _frames(path: Path, most: int) -> Iterator[tuple[int, Any]]:
    """Number and pixels of frames evenly over a film. ConfigError if it cannot be read."""
    film = cv2.VideoCapture(str(path))
    try:
        total = int(film.get(cv2.CAP_PROP_FRAME_COUNT)) if film.isOpened() else 0
        if total < 1:
            raise SourceError(f"{path}: is not a film that OpenCV reads; give its frames as JPEG or PNG files")
        wanted = set(np.linspace(0, total - 1, min(most, total)).round().astype(int).tolist())
        for number in range(total):
            if not film.grab():
                return
            if number in wanted:
                ok, image = film.retrieve()
                if ok:
                    yield number, image
    finally:
        film.release()


def _misread(image: Any, wanted: MarkerMap, ids: IntArray, corners_px: FloatArray) -> NDArray[np.bool_]:
    """Which markers (n,) have cells that are not those of their id."""
    result = np.zeros(len(ids), dtype=bool)
    grey = np.ascontiguousarray(image[:, :, 1])
    for kind in np.unique(ids // ID_SPAN).tolist():
        some = np.flatnonzero(ids // ID_SPAN == kind)
        patterns = patterns_of(wanted.dictionaries[kind])[ids[some] % ID_SPAN]
        result[some] = misread_cells(grey, corners_px[some], patterns) >= SIGHTINGS.misread_cells
    return result


def _view(name: str, ids: IntArray, corners_px: FloatArray, misread: tuple[int, ...] = ()) -> SheetView:
    """A view without markers that it shows twice: one of the two is wrong."""
    which, first, times = np.unique(ids, return_index=True, return_counts=True)
    once = np.sort(first[times == 1])
    repeated = tuple(which[times > 1].tolist())
    return SheetView(name=name, ids=ids[once], corners_px=corners_px[once], repeated=repeated, misread=misread)
