"""Every photograph of tests/data: the detector finds what OpenCV's finds, with a prediction and without."""

import numpy as np
import pytest

from autopilot.core.frames import FloatArray
from autopilot.core.samples import CameraFrame, MarkerSighting
from autopilot.estimator.vision import Hint, MarkerDetector
from tests.bench.photographs import PHOTOGRAPHS, Photograph, read_photographs, shown

PHOTOS = {photo.name: photo for photo in read_photographs(PHOTOGRAPHS)}
LEVEL = Hint(pos_ned_m=np.zeros(3), rpy_rad=np.zeros(3))


def look(photo: Photograph, detector: MarkerDetector, hint: Hint | None) -> MarkerSighting:
    return detector.detect(CameraFrame(t_us=0, image_bgr=photo.image), hint)


def missed(photo: Photograph, sighting: MarkerSighting) -> list[tuple[int, list[float]]]:
    """What OpenCV's detector with default parameters finds and the sighting does not have there: id, middle."""
    result = []
    for marker_id, quad in zip(*shown(photo.image, photo.dictionary), strict=True):
        places = [c for i, c in zip(sighting.ids, sighting.corners_px, strict=True) if i == marker_id]
        if not any(near(quad, corners) for corners in places):
            result.append((int(marker_id), quad.mean(axis=0).tolist()))
    return result


def near(a: FloatArray, b: FloatArray) -> bool:
    return bool(np.abs(a.mean(axis=0) - b.mean(axis=0)).max() < 5.0)


@pytest.mark.parametrize("name", PHOTOS)
def test_tracking_finds_what_opencv_finds(name: str) -> None:
    """With a perfect prediction, and with three that are centimetres and a degree off and know of absent markers."""
    photo = PHOTOS[name]
    rng = np.random.default_rng(1)
    for number in range(4):
        markers = photo.markers() if number == 0 else photo.with_others(rng)
        off = Hint(pos_ned_m=rng.normal(0.0, 0.02, 3), rpy_rad=rng.normal(0.0, 0.01, 3))
        sighting = look(photo, MarkerDetector(photo.camera, markers), LEVEL if number == 0 else off)
        assert missed(photo, sighting) == []
        assert set(sighting.ids) <= set(photo.ids.tolist())


@pytest.mark.parametrize("name", PHOTOS)
def test_the_search_without_a_prediction_finds_what_opencv_finds(name: str) -> None:
    photo = PHOTOS[name]
    sighting = look(photo, MarkerDetector(photo.camera, photo.whole()), None)
    assert missed(photo, sighting) == []
    assert set(sighting.ids) <= set(photo.ids.tolist())


def test_a_marker_seen_twice_is_reported_once() -> None:
    photo = PHOTOS["33369213973_9d9bb4cc96_c"]  # thirteen times the same id
    sighting = look(photo, MarkerDetector(photo.camera, photo.markers()), LEVEL)
    middles = sighting.corners_px.mean(axis=1)
    apart = np.linalg.norm(middles[:, None] - middles[None], axis=2) + 1e3 * np.eye(len(middles))
    assert len(middles) >= 13
    assert apart.min() > 5.0
