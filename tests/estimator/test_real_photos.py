"""Detection and pose on photographs of real markers (origin and licences: tests/data/SOURCES.md)."""

import json
import math
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_markers_pose import CAMERA

from autopilot.core.camera import R_FRD_FROM_CAM, CameraModel
from autopilot.core.dictionaries import opencv_dictionary, read_dictionary
from autopilot.core.frames import FloatArray, r_ned_from_frd
from autopilot.core.markers import MarkerMap
from autopilot.core.samples import CameraFrame, MarkerSighting
from autopilot.estimator.pnp import solve_pose
from autopilot.estimator.vision import MarkerDetector

DATA = Path(__file__).resolve().parents[1] / "data"
OPENCV = DATA / "opencv_contrib"
UBIQUITY = DATA / "ubiquity_fiducials"

NEAR_PX = 1.2
"""Corners lie this close, in x and in y, to those of OpenCV's own detector, which come in whole pixels."""


def markers_of(dictionary: str, count: int) -> MarkerMap:
    """A map with every id of a dictionary; where they lie does not matter to the search without a hint."""
    return MarkerMap(dictionary=dictionary, size_m=0.1, ids=np.arange(count), corners_ned_m=np.zeros((count, 4, 3)))


def search(detector: MarkerDetector, path: Path) -> tuple[MarkerSighting, Any]:
    image = cv2.imread(str(path))
    assert image is not None
    return detector.detect(CameraFrame(t_us=0, image_bgr=image), None), image


def differences_px(sighting: MarkerSighting, image: Any, dictionary: Any) -> FloatArray:
    """(n, 4, 2) corners minus those of OpenCV's detector with default parameters, which refines none."""
    quads, ids, _ = cv2.aruco.ArucoDetector(dictionary, cv2.aruco.DetectorParameters()).detectMarkers(image)
    theirs = dict(zip(np.asarray(ids).ravel().tolist(), (np.reshape(quad, (4, 2)) for quad in quads), strict=True))
    ours = zip(sighting.ids, sighting.corners_px, strict=True)
    return np.array([corners - theirs[i] for i, corners in ours if i in theirs])


def test_board_with_a_dictionary_of_its_own() -> None:
    """35 of 35 markers of a tilted board, with their corners: a refinement window that is too wide for markers of
    8 x 8 cells moves some by 5 px."""
    name = read_dictionary(OPENCV / "tutorial_dict.yml")
    sighting, image = search(MarkerDetector(CAMERA, markers_of(name, 35)), OPENCV / "gboriginal.png")
    assert sorted(sighting.ids) == list(range(35))
    far = differences_px(sighting, image, opencv_dictionary(name))
    assert len(far) == 35
    assert np.abs(far).max() < NEAR_PX
    assert np.sqrt(np.square(far).mean()) < 0.6


def test_six_single_markers() -> None:
    """6 of 6, each turned its own way, and nothing else among 250 ids."""
    detector = MarkerDetector(CAMERA, markers_of("DICT_6X6_250", 250))
    sighting, image = search(detector, OPENCV / "singlemarkersoriginal.jpg")
    assert sorted(sighting.ids) == [23, 40, 62, 98, 124, 203]
    far = differences_px(sighting, image, cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_6X6_250))
    assert len(far) == 6
    assert np.abs(far).max() < NEAR_PX


def test_chessboard_with_small_markers() -> None:
    """17 of 17 markers of 20 to 30 pixels, one of them with a misread cell."""
    detector = MarkerDetector(CAMERA, markers_of("DICT_6X6_250", 250))
    sighting, _ = search(detector, OPENCV / "choriginal.jpg")
    assert sorted(sighting.ids) == list(range(17))


class Raspicam:
    """The frame, its calibration and where the seven tags were recorded."""

    def __init__(self) -> None:
        recorded = json.loads((UBIQUITY / "recorded.json").read_text(encoding="utf-8"))
        k = recorded["camera"]["k"]
        self.camera = CameraModel(
            width_px=recorded["camera"]["width_px"],
            height_px=recorded["camera"]["height_px"],
            focal_px=(k[0], k[4]),
            center_px=(k[2], k[5]),
            distortion=tuple(recorded["camera"]["d"]),
            position_frd_m=np.zeros(3),
            laser_offset_cam_m=np.array([0.1, 0.0, 0.0]),
        )
        half = 0.5 * recorded["tag_size_m"]
        square = half * np.array([[-1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [1.0, -1.0, 0.0], [-1.0, -1.0, 0.0]])
        self.corners_m: dict[int, FloatArray] = {}
        """Recorded corners (4, 3) in the body frame of a camera that looks down: a vehicle at the origin."""
        for name, tag in recorded["tags"].items():
            turn = Rotation.from_quat(tag["quaternion_xyzw"]).as_matrix()
            in_cam_m = square @ turn.T + np.array(tag["translation_m"])
            self.corners_m[int(name)] = in_cam_m @ R_FRD_FROM_CAM.T
        self.sighting, _ = search(
            MarkerDetector(self.camera, markers_of("DICT_5X5_1000", 1000)), UBIQUITY / "raspicam.jpg"
        )

    def tag_error_m(self, tag: int, tilt_error_rad: float) -> float:
        """Place of one tag as seen from the camera, from its four corners and a tilt that is off: ours - recorded."""
        points_m = self.corners_m[tag]
        pixels = self.sighting.corners_px[self.sighting.ids.index(tag)]
        tilt = tilt_error_rad * math.sqrt(0.5)
        guess_m, rpy_rad = np.array([0.05, -0.03, 0.05]), np.array([tilt, -tilt, 0.05])
        # What was recorded comes from corners taken as they are found.
        pose = solve_pose(self.camera, points_m, pixels, guess_m, rpy_rad, max_rms_px=1.0, shrink_px=0.0)
        assert pose is not None
        center_m = points_m.mean(axis=0)
        seen_m = r_ned_from_frd(pose.rpy_rad).T @ (center_m - pose.pos_ned_m)
        return float(np.linalg.norm(seen_m - center_m))


@pytest.fixture(scope="module")
def raspicam() -> Raspicam:
    return Raspicam()


def test_all_seven_tags_are_found_among_a_thousand(raspicam: Raspicam) -> None:
    assert sorted(raspicam.sighting.ids) == sorted(raspicam.corners_m)


def test_each_tag_is_where_it_was_recorded(raspicam: Raspicam) -> None:
    """At 1 to 3.4 m, one tag at a time: 0.2 mm; with a tilt that is 0.5 degrees off, 5 mm for six of seven."""
    right = [raspicam.tag_error_m(tag, 0.0) for tag in raspicam.corners_m]
    assert max(right) < 0.001
    off = sorted(raspicam.tag_error_m(tag, math.radians(0.5)) for tag in raspicam.corners_m)
    assert off[5] < 0.005
    assert off[6] < 0.008


def test_all_tags_together_give_the_place_of_the_camera(raspicam: Raspicam) -> None:
    """With 28 corners the tilt prior has no say: 2 degrees off, and the pose is right all the same."""
    sighting = raspicam.sighting
    points_m = np.concatenate([raspicam.corners_m[tag] for tag in sighting.ids])
    start_m, rpy_rad = np.array([0.1, -0.1, 0.1]), np.radians([2.0, -2.0, 3.0])
    pose = solve_pose(raspicam.camera, points_m, sighting.corners_px.reshape(-1, 2), start_m, rpy_rad, max_rms_px=1.0)
    assert pose is not None
    assert np.abs(pose.pos_ned_m).max() < 0.005
    assert np.degrees(np.abs(pose.rpy_rad)).max() < 0.2
    assert pose.rms_px < 0.4
