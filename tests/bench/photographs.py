"""Photographs of real markers as pictures of a floor, and what else cameras make of them.

A list in JSON names the files, the dictionary of each and the ids that it shows. Where its markers lie is what OpenCV's
detector finds with every correction that the dictionary allows; that gives the map and the prediction for tracking.
"""

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from autopilot.core.camera import CameraModel
from autopilot.core.dictionaries import dictionary_size, opencv_dictionary, resolve_dictionary
from autopilot.core.errors import ConfigError
from autopilot.core.frames import FloatArray
from autopilot.core.markers import IntArray, MarkerMap

PHOTOGRAPHS = Path(__file__).resolve().parents[1] / "data" / "photographs.json"
"""The list of the source tree."""
ENLARGED, MAX_WIDTH_PX = (2.0, 3.0), 2500
"""Photographs of at most this width are enlarged by these factors to see what else is in them."""
SAME_PX = 5.0
FOCAL_PX = 800.0
"""Any camera does: the map is what it would see."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Photograph:
    """One photograph and the markers in it."""

    name: str
    image: Any
    """(rows, columns, 3) BGR"""
    dictionary: str
    ids: IntArray
    """(n,) all that OpenCV can read in it, enlarged or not."""
    quads: FloatArray
    """(n, 4, 2) their corners [px]."""
    more: bool = False
    """There are more markers of these ids, too small or too slanted for OpenCV."""

    @property
    def camera(self) -> CameraModel:
        """A camera that looks straight down."""
        height, width = self.image.shape[:2]
        return CameraModel(
            width_px=width,
            height_px=height,
            focal_px=(FOCAL_PX, FOCAL_PX),
            center_px=(0.5 * width, 0.5 * height),
            distortion=(0.0, 0.0, 0.0, 0.0, 0.0),
            position_frd_m=np.zeros(3),
            laser_offset_cam_m=np.array([0.1, 0.0, 0.0]),
        )

    def markers(self) -> MarkerMap:
        """The markers of the photograph on a floor one metre below the camera, as they would look just like this."""
        return self._map(self.ids, self.quads)

    def with_others(self, rng: np.random.Generator) -> MarkerMap:
        """The same, and as many that the photograph does not show, where it shows something else."""
        count = dictionary_size(self.dictionary) or 0
        absent = np.setdiff1d(np.arange(count), self.ids)
        others = rng.choice(absent, min(len(absent), len(self.ids)), replace=False)
        like = self.quads[rng.integers(len(self.quads), size=len(others))]
        height, width = self.image.shape[:2]
        places = rng.uniform([0.1 * width, 0.1 * height], [0.9 * width, 0.9 * height], (len(others), 2))
        moved = like - like.mean(axis=1, keepdims=True) + places[:, None, :]
        return self._map(np.concatenate((self.ids, others)), np.concatenate((self.quads, moved)))

    def whole(self) -> MarkerMap:
        """A map of the whole dictionary, for the search without a prediction."""
        count = dictionary_size(self.dictionary) or 0
        return MarkerMap(
            dictionary=self.dictionary, size_m=0.1, ids=np.arange(count), corners_ned_m=np.zeros((count, 4, 3))
        )

    def _map(self, ids: IntArray, quads: FloatArray) -> MarkerMap:
        _, rays = self.camera.rays(quads)
        corners = rays @ self.camera.r_frd_from_cam.T
        return MarkerMap(dictionary=self.dictionary, size_m=0.1, ids=ids, corners_ned_m=corners)


def read_photographs(listing: Path) -> Iterator[Photograph]:
    """All photographs of a list. ConfigError for a file that is missing or no image."""
    for entry in json.loads(listing.read_text(encoding="utf-8")):
        path = listing.parent / entry["file"]
        image = cv2.imread(str(path), cv2.IMREAD_COLOR)
        if image is None:
            raise ConfigError(f"{path}: is not an image that OpenCV reads; look at {listing}")
        name = resolve_dictionary(entry["dictionary"], listing.parent, str(listing))
        found = shown(np.asarray(image), name)
        if sorted(found[0].tolist()) != entry["ids"]:
            raise ConfigError(f"{path}: shows markers {sorted(found[0].tolist())}; {listing} says {entry['ids']}")
        ids, quads = _all_shown(np.asarray(image), name, *found)
        yield Photograph(
            name=path.stem,
            image=np.asarray(image),
            dictionary=name,
            ids=ids,
            quads=quads,
            more=entry.get("more", False),
        )


def _all_shown(image: Any, dictionary: str, ids: IntArray, quads: FloatArray) -> tuple[IntArray, FloatArray]:
    """With the markers that are found in the image when it is enlarged: a campaign must not call them false."""
    for scale in ENLARGED:
        if scale * image.shape[1] > MAX_WIDTH_PX:
            continue
        larger = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
        for marker_id, quad in zip(*shown(larger, dictionary), strict=True):
            middle = quad.mean(axis=0) / scale
            known = np.linalg.norm(quads[ids == marker_id].mean(axis=1) - middle, axis=1)
            if not (known < SAME_PX).any():
                ids = np.append(ids, marker_id)
                quads = np.concatenate((quads, (quad / scale)[None]))
    return ids, quads


def shown(image: Any, dictionary: str) -> tuple[IntArray, FloatArray]:
    """Ids (n,) and corners (n, 4, 2) of the markers that OpenCV's detector finds with its default parameters."""
    detector = cv2.aruco.ArucoDetector(opencv_dictionary(dictionary), cv2.aruco.DetectorParameters())
    quads, ids, _ = detector.detectMarkers(image)
    if ids is None:
        return np.empty(0, dtype=np.int64), np.empty((0, 4, 2))
    return np.asarray(ids, dtype=np.int64).ravel(), np.asarray(quads, dtype=np.float64).reshape(-1, 4, 2)


def taken_again(photo: Photograph, rng: np.random.Generator) -> Photograph:
    """The photograph as a worse camera might have taken it: scaled, turned, blurred, pale, noisy, compressed."""
    height, width = photo.image.shape[:2]
    scale = rng.uniform(0.6, 1.0) * min(1.0, 900.0 / width)
    size = (round(scale * width), round(scale * height))
    turn = cv2.getRotationMatrix2D((0.5 * width, 0.5 * height), float(rng.uniform(-180.0, 180.0)), scale)
    turn[:, 2] += 0.5 * np.array(size) - 0.5 * np.array([width, height])
    grey = float(photo.image.mean())
    image = cv2.warpAffine(photo.image, turn, size, flags=cv2.INTER_AREA, borderValue=(grey, grey, grey))
    image = cv2.GaussianBlur(image, (0, 0), float(rng.uniform(0.3, 1.2)))
    contrast = float(rng.uniform(0.1, 1.0))
    level = rng.uniform(0.0, 255.0 * (1.0 - contrast))
    noisy = contrast * image + level + rng.normal(0.0, rng.uniform(0.5, 6.0), image.shape)
    image = np.clip(noisy, 0.0, 255.0).astype(np.uint8)
    quality = int(rng.integers(40, 100))
    packed = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
    image = np.asarray(cv2.imdecode(packed, cv2.IMREAD_COLOR))
    quads = np.concatenate((photo.quads, np.ones((len(photo.quads), 4, 1))), axis=2) @ turn.T
    return replace(photo, image=image, quads=quads)
