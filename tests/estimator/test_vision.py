"""The front end on rendered images of the tank floor, with haze, blur, noise and the laser dot."""

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from test_markers_pose import CAMERA, VEHICLE

from autopilot.core.camera import CameraModel
from autopilot.core.errors import ConfigError
from autopilot.core.frames import FloatArray, r_ned_from_frd, wrap_pi
from autopilot.core.markers import MarkerMap
from autopilot.core.samples import CameraFrame
from autopilot.estimator.laser_detector import find_dot
from autopilot.estimator.markers_pose import MarkerSolver
from autopilot.estimator.vision import Hint, MarkerDetector
from autopilot.sitl.camera_sensor import SimCamera
from autopilot.sitl.floor import Floor
from autopilot.sitl.plant import Truth, build_plant
from autopilot.sitl.scenario import load_scenario
from autopilot.sitl.sensor_tables import ImageModel


def truth_at(pos: FloatArray, rpy: FloatArray) -> Truth:
    some = build_plant(load_scenario("paper-tank"), VEHICLE).truth
    return replace(some, pos_ned_m=pos, rpy_rad=rpy, vel_frd_m_s=np.array([0.3, 0.0, 0.0]), rate_frd_rad_s=np.zeros(3))


def poses(height_m: float, count: int, seed: int) -> list[tuple[FloatArray, FloatArray]]:
    rng = np.random.default_rng(seed)
    return [
        (
            np.array([rng.uniform(-1.9, 1.9), rng.uniform(-1.0, 1.0), 1.5 - 0.1 - height_m]),
            np.array([*rng.normal(0.0, 0.02, 2), rng.uniform(-3.0, 3.0)]),
        )
        for _ in range(count)
    ]


@pytest.mark.parametrize(
    ("height_m", "turbidity", "limit_m"), [(0.45, 0.3, 0.003), (0.8, 1.0, 0.003), (1.1, 0.3, 0.003), (1.1, 2.0, 0.012)]
)
def test_pose_from_rendered_images(
    tank: Floor, detector: MarkerDetector, height_m: float, turbidity: float, limit_m: float
) -> None:
    """No image lost, no false id kept, millimetres; the laser tells the range."""
    renderer = SimCamera(CAMERA, tank, ImageModel(turbidity_1_m=turbidity), 1)
    solver = MarkerSolver(CAMERA, tank.markers)
    rng = np.random.default_rng(9)
    ranges = 0
    for index, (pos, rpy) in enumerate(poses(height_m, 5, 1)):
        frame = CameraFrame(t_us=77, image_bgr=renderer.render(truth_at(pos, rpy), index))
        guess, turned = pos + rng.normal(0.0, 0.02, 3), rpy + rng.normal(0.0, 0.01, 3)
        sighting = detector.detect(frame, Hint(pos_ned_m=guess, rpy_rad=turned))
        assert sighting.t_us == 77
        r = r_ned_from_frd(rpy)
        visible = tank.markers.visible(CAMERA, pos, r)
        assert len(sighting.ids) >= 0.7 * len(visible)
        assert set(sighting.ids) <= set(tank.markers.ids[tank.markers.visible(CAMERA, pos, r, -5.0)].tolist())
        fix = solver.track(sighting, guess, turned)
        assert fix is not None
        assert np.abs(fix.z[:3] - pos).max() < limit_m
        assert abs(wrap_pi(float(fix.z[3] - rpy[2]))) < math.radians(0.15)
        found = solver.laser_range(sighting)
        if found is not None:
            start = pos + r @ np.array(VEHICLE.laser.position_frd_m)
            assert found[0] == pytest.approx((1.5 - start[2]) / r[2, 2], abs=4.0 * found[1])
            ranges += 1
    assert turbidity > 1.0 or ranges >= 4


def corners_of(markers: MarkerMap, pos: FloatArray, rpy: FloatArray, margin_px: float) -> dict[int, FloatArray]:
    """Corners (4, 2) of the markers in view, by their ids."""
    seen, corners_px = markers.in_view(CAMERA, pos, r_ned_from_frd(rpy), margin_px)
    return dict(zip(markers.ids[seen].tolist(), corners_px, strict=True))


@pytest.mark.parametrize("seed", [3, 4])
def test_all_of_many_markers_are_found_where_they_are(tank: Floor, detector: MarkerDetector, seed: int) -> None:
    """However far off the prediction is."""
    renderer, rng, off_px = SimCamera(CAMERA, tank, ImageModel(), 1), np.random.default_rng(seed), []
    for index, (pos, rpy) in enumerate(poses(1.0, 4, seed)):
        frame = CameraFrame(t_us=0, image_bgr=renderer.render(truth_at(pos, rpy), index))
        guess, turned = pos + rng.normal(0.0, 0.02, 3), rpy + rng.normal(0.0, 0.02, 3)
        sighting = detector.detect(frame, Hint(pos_ned_m=guess, rpy_rad=turned))
        shown = corners_of(tank.markers, pos, rpy, -5.0)
        found = dict(zip(sighting.ids, sighting.corners_px, strict=True))
        assert len(found) >= min(64, len(corners_of(tank.markers, pos, rpy, 8.0))) - 2
        off_px += [found[each] - shown[each] for each in found]
    assert len(off_px) > 100
    assert float(np.std(off_px)) < 0.3
    assert np.abs(off_px).max() < 2.5


def test_a_sheet_that_has_slipped_is_found_where_it_lies(tank: Floor, detector: MarkerDetector) -> None:
    """As the map's monitor needs it, though all the others tell that it is elsewhere."""
    pos, rpy = np.array([0.1, 0.2, 0.5]), np.array([0.0, 0.0, 0.4])
    image = SimCamera(CAMERA, tank, ImageModel(), 1).render(truth_at(pos, rpy), 0)
    shown = corners_of(tank.markers, pos, rpy, 40.0)
    which = max(shown, key=lambda each: float(shown[each][:, 0].mean()))
    left, top = (shown[which].min(axis=0) - 4.0).astype(int)
    right, bottom = (shown[which].max(axis=0) + 5.0).astype(int)
    slipped = image.copy()
    slipped[top:bottom, left + 9 : right + 9] = image[top:bottom, left:right]
    sighting = detector.detect(CameraFrame(t_us=0, image_bgr=slipped), Hint(pos_ned_m=pos, rpy_rad=rpy))
    found = dict(zip(sighting.ids, sighting.corners_px, strict=True))
    assert len(found) > 20
    np.testing.assert_allclose(found[which], shown[which] + [9.0, 0.0], atol=2.0)


def test_without_a_hint_the_whole_dictionary_is_searched(tank: Floor, detector: MarkerDetector) -> None:
    renderer = SimCamera(CAMERA, tank, ImageModel(), 1)
    solver = MarkerSolver(CAMERA, tank.markers)
    for index, (pos, rpy) in enumerate(poses(0.9, 2, 3)):
        frame = CameraFrame(t_us=0, image_bgr=renderer.render(truth_at(pos, rpy), index))
        sighting = detector.detect(frame, None)
        fix = solver.locate(sighting, float(rpy[0]) + 0.008, float(rpy[1]))
        assert fix is not None
        assert np.abs(fix.z[:3] - pos).max() < 0.003
        again = detector.detect(frame, None)
        assert again.ids == sighting.ids
        np.testing.assert_array_equal(again.corners_px, sighting.corners_px)


def test_wrong_hint_finds_little_and_nothing_false_survives(tank: Floor, detector: MarkerDetector) -> None:
    renderer = SimCamera(CAMERA, tank, ImageModel(), 1)
    solver = MarkerSolver(CAMERA, tank.markers)
    pos, rpy = np.array([1.0, 0.5, 0.4]), np.array([0.0, 0.0, 0.3])
    frame = CameraFrame(t_us=0, image_bgr=renderer.render(truth_at(pos, rpy), 0))
    elsewhere = np.array([-1.5, -0.7, 0.4])
    sighting = detector.detect(frame, Hint(pos_ned_m=elsewhere, rpy_rad=rpy))
    assert len(sighting.ids) < 10
    fix = solver.track(sighting, elsewhere, rpy)
    assert fix is None or np.abs(fix.z[:3] - elsewhere).max() > 0.3
    high = Hint(pos_ned_m=np.array([50.0, 0.0, 0.4]), rpy_rad=rpy)
    assert detector.detect(frame, high).ids == ()


@pytest.mark.parametrize("level", [0, 128, 255])
def test_empty_images(detector: MarkerDetector, level: int) -> None:
    image = np.full((480, 640, 3), level, dtype=np.uint8)
    for hint in (None, Hint(pos_ned_m=np.array([0.0, 0.0, 0.4]), rpy_rad=np.zeros(3))):
        sighting = detector.detect(CameraFrame(t_us=5, image_bgr=image), hint)
        assert sighting.ids == ()
        assert sighting.corners_px.shape == (0, 4, 2)
        assert sighting.laser_px is None


def test_dot_on_plain_ground_and_none_in_noise() -> None:
    rng = np.random.default_rng(0)
    noise = np.clip(rng.normal(120.0, 4.0, (480, 640, 3)), 0, 255).astype(np.uint8)
    assert find_dot(noise, CAMERA, 0.8) is None
    assert find_dot(noise, CAMERA, None) is None
    x, y = CAMERA.laser_pixel(0.8)
    image = noise.astype(float)
    rows, columns = np.mgrid[0:480, 0:640]
    image[:, :, 1] += 60.0 * np.exp(-0.5 * ((columns - x) ** 2 + (rows - y) ** 2) / 2.0)
    for range_m in (0.8, 0.7, None):
        dot = find_dot(np.clip(image, 0, 255).astype(np.uint8), CAMERA, range_m)
        assert dot is not None
        assert np.abs(dot - [x, y]).max() < 0.6


SHIFTS_PX = (-900, -640, -420, -300, 0, 300, 420, 640, 900)


@pytest.mark.parametrize("right_px", SHIFTS_PX)
@pytest.mark.parametrize("down_px", SHIFTS_PX)
def test_a_beam_at_the_border_or_beside_the_picture(right_px: int, down_px: int) -> None:
    """The strip that is looked at is cut at all four borders; of one that is outside nothing is looked at."""
    straight = CameraModel.of(VEHICLE.camera, VEHICLE.laser)
    x_px, y_px = straight.center_px
    camera = replace(straight, center_px=(x_px + right_px, y_px + down_px))
    x, y = camera.laser_pixel(0.8)
    image = np.clip(np.random.default_rng(0).normal(120.0, 4.0, (480, 640, 3)), 0, 255)
    rows, columns = np.mgrid[0:480, 0:640]
    image[:, :, 1] += 60.0 * np.exp(-0.5 * ((columns - x) ** 2 + (rows - y) ** 2) / 2.0)
    dot = find_dot(np.clip(image, 0, 255).astype(np.uint8), camera, 0.8)
    if 15.0 < x < 624.0 and 15.0 < y < 464.0:
        assert dot is not None
        assert np.abs(dot - [x, y]).max() < 0.6
    elif not (-2.0 < x < 642.0 and -2.0 < y < 482.0):
        assert dot is None


def test_unknown_dictionary_is_refused(floor: MarkerMap) -> None:
    wrong = MarkerMap(dictionary="DICT_NO_SUCH", size_m=floor.size_m, ids=floor.ids, corners_ned_m=floor.corners_ned_m)
    with pytest.raises(ConfigError, match=r"DICT_NO_SUCH.*use e\.g\. DICT_4X4_1000"):
        MarkerDetector(CAMERA, wrong)


def test_one_thread_is_enough(detector: MarkerDetector) -> None:
    assert cv2.getNumThreads() == 1
