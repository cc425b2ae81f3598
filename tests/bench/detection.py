"""What the detector finds and what it imagines, beside OpenCV's detector with its default parameters.

Rendered floors of several dictionaries at random heights in clear to turbid water, and photographs of real markers,
each taken again by worse cameras. A marker is found when its middle is read within half a side of where it is; whatever
else is read is a false id. Every picture is searched with a prediction that is some centimetres off, one in
``BLIND_EVERY`` without any as well.
"""

import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from msgspec.structs import replace as replace_struct

from autopilot.core.camera import CameraModel
from autopilot.core.dictionaries import opencv_dictionary
from autopilot.core.frames import FloatArray, r_ned_from_frd
from autopilot.core.markers import IntArray, MarkerMap
from autopilot.core.samples import CameraFrame, MarkerSighting
from autopilot.core.vehicle import load_vehicle
from autopilot.estimator.vision import Hint, MarkerDetector
from autopilot.sitl.camera_sensor import SimCamera
from autopilot.sitl.floor import build_floor
from autopilot.sitl.plant import build_plant
from autopilot.sitl.scenario import load_scenario
from autopilot.sitl.sensor_tables import ImageModel
from tests.bench.estimator_images import (
    GUESS_SIGMA_M,
    GUESS_SIGMA_RAD,
    SCENARIO,
    SPEED_M_S,
    TILT_SIGMA_RAD,
    VEHICLE,
)
from tests.bench.photographs import PHOTOGRAPHS, Photograph, read_photographs, taken_again

FLOORS = (
    "DICT_4X4_1000",
    "DICT_5X5_250",
    "DICT_6X6_250",
    "DICT_7X7_100",
    "DICT_ARUCO_MIP_36h12",
    "DICT_APRILTAG_16h5",
    "DICT_APRILTAG_25h9",
    "DICT_APRILTAG_36h11",
)
FRAMES, SHORT_FRAMES = 10_000, 400
HEIGHT_M, TURBIDITY_1_M = (0.25, 1.3), (0.0, 3.0)
BLIND_EVERY = 5
LOOK_EVERY = 25
"""Pictures that are taken in one water before another seed is drawn."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DetectionRow:
    source: str
    frames: int
    shown: int
    """Markers in view as a whole (rendered), or read by OpenCV's detector in the photograph as it was taken."""
    found: int
    """Of these with a prediction,"""
    opencv: int
    """by OpenCV's detector with its default parameters and the ids that the prediction allows,"""
    only_opencv: int
    """found by OpenCV's detector and not by ours."""
    false_ids: int
    blind_frames: int
    """Pictures searched without a prediction."""
    blind_shown: int
    blind_found: int
    blind_false_ids: int
    cpu_ms: float
    """Median CPU time with a prediction,"""
    opencv_ms: float
    """and that of OpenCV's detector."""


@dataclass(slots=True, eq=False, kw_only=True)
class _Picture:
    """A picture with what is in it."""

    image: Any
    camera: CameraModel
    detector: MarkerDetector
    blind: MarkerDetector
    dictionary: str
    ids: IntArray
    """(n,) of all markers that it may show,"""
    quads: FloatArray
    """(n, 4, 2) where they are,"""
    whole: np.ndarray
    """(n,) and whether all of each is in view."""
    expected: IntArray
    """Ids that the prediction allows."""
    hint: Hint
    more: bool = False
    """There are more markers of these ids than ``quads`` has."""


def bench_detection(
    frames: int = FRAMES, seed: int = 1, listing: Path = PHOTOGRAPHS, floors: tuple[str, ...] = FLOORS
) -> Iterator[DetectionRow]:
    """Row by row; a third of the frames are photographs where their list is at hand."""
    photos = list(read_photographs(listing)) if listing.exists() else []
    of_floors = math.ceil((frames * 2 / 3 if photos else frames) / len(floors))
    for number, dictionary in enumerate(floors):
        yield _row(dictionary, of_floors, _rendered(dictionary, of_floors, 1000 * seed + number))
    of_photos = math.ceil((frames - of_floors * len(floors)) / max(len(photos), 1))
    for number, photo in enumerate(photos):
        yield _row(photo.name, of_photos, _photographed(photo, of_photos, 1000 * seed + 100 + number))


def totals(rows: Sequence[DetectionRow]) -> DetectionRow:
    """All together; times are means over the frames."""
    frames = sum(row.frames for row in rows)
    counted = {f.name: sum(getattr(row, f.name) for row in rows) for f in fields(DetectionRow) if f.type is int}
    times = ("cpu_ms", "opencv_ms")
    means = {name: sum(getattr(row, name) * row.frames for row in rows) / max(frames, 1) for name in times}
    return DetectionRow(source="all", **counted, **means)


def _rendered(dictionary: str, count: int, seed: int) -> Iterator[_Picture]:
    scenario, vehicle = load_scenario(SCENARIO), load_vehicle(VEHICLE)
    floor = build_floor(replace_struct(scenario, markers=replace_struct(scenario.markers, dictionary=dictionary)))
    assert floor is not None, "the scenario has a printed floor"
    markers = floor.markers
    camera = CameraModel.of_vehicle(vehicle)
    detector = MarkerDetector(camera, markers)
    truth = replace(
        build_plant(scenario, vehicle).truth, vel_frd_m_s=np.array([SPEED_M_S, 0.0, 0.0]), rate_frd_rad_s=np.zeros(3)
    )
    rng = np.random.default_rng(seed)
    for k in range(count):
        if k % LOOK_EVERY == 0:
            imaging = ImageModel(turbidity_1_m=float(rng.uniform(*TURBIDITY_1_M)))
            renderer = SimCamera(camera, floor, imaging, int(rng.integers(1 << 30)))
        below_m = float(camera.position_frd_m[2]) + rng.uniform(*HEIGHT_M)
        pos = np.array([*(rng.uniform(-1.0, 1.0, 2) * [2.4, 1.4]), floor.depth_m - below_m])
        rpy = np.array([*rng.normal(0.0, TILT_SIGMA_RAD, 2), rng.uniform(-math.pi, math.pi)])
        image = renderer.render(replace(truth, pos_ned_m=pos, rpy_rad=rpy), k)
        r = r_ned_from_frd(rpy)
        seen = markers.visible(camera, pos, r, -60.0)
        quads = camera.project(camera.cam_from_ned(markers.corners_ned_m[seen], pos, r))
        hint = Hint(
            pos_ned_m=pos + rng.normal(0.0, GUESS_SIGMA_M, 3), rpy_rad=rpy + rng.normal(0.0, GUESS_SIGMA_RAD, 3)
        )
        near = markers.visible(camera, hint.pos_ned_m, r_ned_from_frd(hint.rpy_rad), -60.0)
        yield _Picture(
            image=image,
            camera=camera,
            detector=detector,
            blind=detector,
            dictionary=dictionary,
            ids=markers.ids[seen],
            quads=quads,
            whole=np.asarray(camera.inside(quads, 10.0).all(axis=1)),
            expected=np.unique(markers.ids[near]),
            hint=hint,
        )


def _photographed(photo: Photograph, count: int, seed: int) -> Iterator[_Picture]:
    rng = np.random.default_rng(seed)
    everything = photo.whole()
    for k in range(count):
        again = photo if k == 0 else taken_again(photo, rng)
        known: MarkerMap = again.with_others(rng)
        camera = again.camera
        yield _Picture(
            image=again.image,
            camera=camera,
            detector=MarkerDetector(camera, known),
            blind=MarkerDetector(camera, everything),
            dictionary=photo.dictionary,
            ids=again.ids,
            quads=again.quads,
            whole=np.asarray(camera.inside(again.quads, 0.0).all(axis=1)),
            expected=np.unique(known.ids),
            hint=Hint(pos_ned_m=rng.normal(0.0, GUESS_SIGMA_M, 3), rpy_rad=rng.normal(0.0, GUESS_SIGMA_RAD, 3)),
            more=photo.more,
        )


def _row(source: str, count: int, pictures: Iterator[_Picture]) -> DetectionRow:
    total = np.zeros(9, dtype=np.int64)
    times = []
    for k, picture in enumerate(pictures):
        frame = CameraFrame(t_us=0, image_bgr=picture.image)
        begin_s = time.thread_time()
        sighting = picture.detector.detect(frame, picture.hint)
        middle_s = time.thread_time()
        theirs = _opencv(picture)
        times.append((middle_s - begin_s, time.thread_time() - middle_s))
        ours, false = _matched(picture, sighting)
        other, _ = _matched(picture, theirs)
        whole = picture.whole
        total[:5] += (whole.sum(), (ours & whole).sum(), (other & whole).sum(), (other & ~ours).sum(), false)
        if k % BLIND_EVERY == 0:
            blind, blind_false = _matched(picture, picture.blind.detect(frame, None))
            total[5:] += (1, whole.sum(), (blind & whole).sum(), blind_false)
    ours_s, theirs_s = np.median(np.array(times), axis=0)
    values = total.tolist()
    return DetectionRow(
        source=source,
        frames=count,
        shown=values[0],
        found=values[1],
        opencv=values[2],
        only_opencv=values[3],
        false_ids=values[4],
        blind_frames=values[5],
        blind_shown=values[6],
        blind_found=values[7],
        blind_false_ids=values[8],
        cpu_ms=1e3 * float(ours_s),
        opencv_ms=1e3 * float(theirs_s),
    )


def _opencv(picture: _Picture) -> MarkerSighting:
    whole = opencv_dictionary(picture.dictionary)
    few = cv2.aruco.Dictionary(whole.bytesList[picture.expected], whole.markerSize, whole.maxCorrectionBits)
    quads, ids, _ = cv2.aruco.ArucoDetector(few, cv2.aruco.DetectorParameters()).detectMarkers(picture.image)
    found = [] if ids is None else picture.expected[np.asarray(ids).ravel()].tolist()
    corners = np.array(quads, dtype=np.float64).reshape(-1, 4, 2)
    return MarkerSighting(t_us=0, ids=tuple(found), corners_px=corners, laser_px=None)


def _matched(picture: _Picture, sighting: MarkerSighting) -> tuple[np.ndarray, int]:
    """Which markers (n,) of the picture were found, and how many ids were read that are not there."""
    found = np.zeros(len(picture.ids), dtype=bool)
    false = 0
    middles = picture.quads.mean(axis=1)
    sides = picture.quads - np.roll(picture.quads, -1, axis=1)
    reach = 0.5 * np.sqrt((sides * sides).sum(axis=2)).mean(axis=1)
    for marker_id, corners in zip(sighting.ids, sighting.corners_px, strict=True):
        apart = np.linalg.norm(middles - corners.mean(axis=0), axis=1)
        hits = np.flatnonzero((picture.ids == marker_id) & (apart < reach))
        found[hits] = True
        false += not len(hits) and not (picture.more and marker_id in picture.ids)
    return found, false
