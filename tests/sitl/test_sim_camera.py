"""Rendered pictures: exact geometry, plausible water, nothing hidden in the state."""

import math

import cv2
import numpy as np
import pytest
from sensor_helpers import CAMERA, CLEAN, floor, height, renderer, truth_at

from autopilot.core.frames import r_ned_from_frd
from autopilot.sitl.camera_sensor import camera_of
from autopilot.sitl.plant import Truth
from autopilot.sitl.sitl_tuning import CAMERA_TUNED


def detect(picture: np.ndarray, truth: Truth) -> tuple[np.ndarray, np.ndarray]:
    """Corners (n, 4, 2) found by OpenCV and the projection of the true ones (n, 4, 2)."""
    markers = floor().markers
    r = r_ned_from_frd(truth.rpy_rad)
    seen = markers.visible(CAMERA, truth.pos_ned_m, r)
    whole = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, markers.dictionary))
    dictionary = cv2.aruco.Dictionary(whole.bytesList[markers.ids[seen]], whole.markerSize, whole.maxCorrectionBits)
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    parameters.cornerRefinementWinSize = 5
    corners, ids, _ = cv2.aruco.ArucoDetector(dictionary, parameters).detectMarkers(picture)
    assert ids is not None
    true = CAMERA.project(CAMERA.cam_from_ned(markers.corners_ned_m[seen[ids.ravel()]], truth.pos_ned_m, r))
    return np.array(corners).reshape(-1, 4, 2), true


POSES = [
    ((0.0, 0.0), (0.0, 0.0, 0.0)),
    ((1.2, -0.7), (0.03, -0.05, 1.1)),
    ((-1.6, 0.4), (-0.06, 0.04, -2.4)),
]


@pytest.mark.parametrize("camera_height_m", [0.45, 1.2])
@pytest.mark.parametrize(("place", "rpy_rad"), POSES)
def test_detected_corners_are_where_the_true_ones_project(
    camera_height_m: float, place: tuple[float, float], rpy_rad: tuple[float, float, float]
) -> None:
    truth = truth_at((*place, height(camera_height_m)), rpy_rad)
    found, true = detect(renderer().render(truth, 0), truth)
    error = found - true
    assert len(found) >= 2
    assert math.sqrt((error**2).mean()) < 0.4
    clean, true = detect(renderer(CLEAN).render(truth, 0), truth)
    error = clean - true
    assert math.sqrt((error**2).mean()) < 0.2
    assert np.abs(error.mean(axis=(0, 1))).max() < 0.06  # no shift by half a pixel anywhere


def test_corner_error_over_many_poses_is_below_0_3_px() -> None:
    rng = np.random.default_rng(3)
    camera, errors = renderer(), []
    for index in range(16):
        pos = (rng.uniform(-2, 2), rng.uniform(-1, 1), height(rng.uniform(0.45, 1.2)))
        truth = truth_at(pos, (rng.normal(0, 0.03), rng.normal(0, 0.03), rng.uniform(-3, 3)), 33_333 * index)
        found, true = detect(camera.render(truth, index), truth)
        errors.append(found - true)
    error = np.concatenate(errors)
    mistaken = np.abs(error).max(axis=(1, 2)) > 3.0  # OpenCV 4.10 reads a marker's inside as another marker at times
    assert mistaken.mean() < 0.01
    error = error[~mistaken].reshape(-1, 2)
    assert math.sqrt((error**2).mean()) < 0.3
    assert np.abs(error.mean(axis=0)).max() < 0.03


def test_full_markers_in_view_are_found() -> None:
    for camera_height_m in (0.45, 0.7, 1.0, 1.2):
        truth = truth_at((0.4, -0.3, height(camera_height_m)), (0.02, 0.01, 0.6))
        found, _ = detect(renderer().render(truth, 1), truth)
        expected = len(floor().markers.visible(CAMERA, truth.pos_ned_m, r_ned_from_frd(truth.rpy_rad), margin_px=4.0))
        assert len(found) >= 0.95 * expected


def test_picture_is_a_function_of_truth_index_and_seed() -> None:
    truth = truth_at((0.3, 0.2, 0.4), (0.01, 0.02, 0.3), t_us=1_000_000, vel_frd_m_s=np.array([0.3, 0.1, 0.0]))
    camera = renderer(seed=1)
    first = camera.render(truth, 5)
    camera.render(truth_at((1.0, 1.0, 1.0)), 6)
    assert np.array_equal(camera.render(truth, 5), first)
    assert np.array_equal(renderer(seed=1).render(truth, 5), first)
    assert not np.array_equal(camera.render(truth, 6), first)
    assert not np.array_equal(renderer(seed=2).render(truth, 5), first)
    assert first.shape == (480, 640, 3)
    assert first.dtype == np.uint8
    assert first.flags.c_contiguous


@pytest.mark.parametrize("camera_height_m", [0.3, 0.6, 1.1])
@pytest.mark.parametrize("rpy_rad", [(0.0, 0.0, 0.4), (0.05, -0.08, 2.0)])
def test_laser_dot_is_where_the_beam_meets_the_floor(
    camera_height_m: float, rpy_rad: tuple[float, float, float]
) -> None:
    truth = truth_at((0.3, 0.1, height(camera_height_m)), rpy_rad)
    with_dot = renderer(CLEAN, laser_brightness=0.25).render(truth, 0).astype(float)
    glow = (with_dot - renderer(CLEAN).render(truth, 0))[..., 1]
    rows, columns = np.mgrid[0:480, 0:640]
    dot = np.array([(glow * columns).sum(), (glow * rows).sum()]) / glow.sum()
    r = r_ned_from_frd(truth.rpy_rad)
    start = truth.pos_ned_m + r @ np.array([0.0, 0.05, 0.10])  # the vehicle file's [laser]
    range_m = (1.5 - start[2]) / r[2, 2]
    spot = CAMERA.cam_from_ned(start + range_m * r[:, 2], truth.pos_ned_m, r)
    assert dot == pytest.approx(CAMERA.project(spot), abs=0.3)
    assert dot == pytest.approx(CAMERA.laser_pixel(range_m), abs=0.3)


def test_the_dot_is_greener_than_anything_else() -> None:
    truth = truth_at((0.2, 0.3, 0.4), (0.0, 0.0, 0.2))
    picture = renderer().render(truth, 0).astype(float)
    excess = picture[..., 1] - np.maximum(picture[..., 0], picture[..., 2])
    row, column = np.unravel_index(cv2.GaussianBlur(excess, (0, 0), 1.5).argmax(), excess.shape)
    assert (column, row) == pytest.approx(tuple(CAMERA.laser_pixel(1.0)), abs=2.0)


def test_dot_outside_of_the_picture_and_tilted_cameras_do_no_harm() -> None:
    for rpy in ((0.0, 0.0, 0.0), (1.4, 0.0, 0.0), (0.0, -1.5, 0.0), (3.1, 0.0, 0.0)):
        for depth in (1.38, 1.395, 1.45, 0.0):
            assert renderer().render(truth_at((0.0, 0.0, depth), rpy), 0).shape == (480, 640, 3)


def test_turbid_water_takes_contrast_and_red() -> None:
    truth = truth_at((0.2, 0.3, height(1.0)))
    clear, turbid = (renderer(CLEAN, turbidity_1_m=c).render(truth, 0).astype(float) for c in (0.0, 1.0))
    ratio = turbid.std(axis=(0, 1)) / clear.std(axis=(0, 1))
    assert ratio[1] == pytest.approx(math.exp(-1.0), rel=0.03)
    assert ratio[2] == pytest.approx(math.exp(-2.2), rel=0.06)


def test_corners_are_darker_and_noise_is_as_declared() -> None:
    truth = truth_at((0.2, 0.3, height(1.0)))
    even = renderer(CLEAN).render(truth, 0).astype(float)
    dim = renderer(CLEAN, vignetting=0.5).render(truth, 0).astype(float)
    assert dim[:60, :60].mean() / even[:60, :60].mean() == pytest.approx(1 - 0.5 * 0.82, abs=0.05)
    assert dim[220:260, 300:340].mean() / even[220:260, 300:340].mean() == pytest.approx(1.0, abs=0.02)
    noisy = renderer(CLEAN, noise_levels=4.0).render(truth, 0).astype(float)
    assert (noisy - even).std() == pytest.approx(4.0, rel=0.03)
    assert abs((noisy - even).mean()) < 0.1


def test_motion_blurs_along_its_direction_only() -> None:
    still = renderer(CLEAN).render(truth_at((0.2, 0.3, height(0.8))), 0)[..., 1].astype(float)
    ahead = truth_at((0.2, 0.3, height(0.8)), vel_frd_m_s=np.array([0.5, 0.0, 0.0]))
    moved = renderer(CLEAN, exposure_s=0.02).render(ahead, 0)[..., 1].astype(float)

    def edges(picture: np.ndarray, axis: int) -> float:
        return float((np.diff(picture, axis=axis) ** 2).mean())

    assert edges(moved, 0) < 0.45 * edges(still, 0)  # ahead is up in the picture
    assert edges(moved, 1) > 0.8 * edges(still, 1)


def test_beyond_the_floor_there_is_wall() -> None:
    outside = renderer(CLEAN).render(truth_at((30.0, 0.0, 0.4)), 0)
    assert np.abs(outside[..., 1].astype(int) - CAMERA_TUNED.wall_level).max() <= 1
    edge = renderer(CLEAN).render(truth_at((0.0, 1.5, height(1.0))), 0)[..., 1]  # half over the east wall
    assert np.abs(edge[:, 400:].astype(int) - CAMERA_TUNED.wall_level).max() <= 1
    assert edge[:, :300].std() > 30


def test_light_and_caustics_change_the_picture_over_time_but_not_its_mean() -> None:
    pictures = [
        renderer(CLEAN, caustics=0.3).render(truth_at((0.2, 0.3, height(1.0)), t_us=t), 0).astype(float)
        for t in (0, 500_000, 1_000_000)
    ]
    assert np.abs(pictures[0] - pictures[1]).mean() > 2.0
    plain = renderer(CLEAN).render(truth_at((0.2, 0.3, height(1.0))), 0).astype(float)
    assert np.mean(pictures) == pytest.approx(plain.mean(), rel=0.1)
    dark = renderer(CLEAN, light=0.5).render(truth_at((0.2, 0.3, height(1.0))), 0).astype(float)
    assert dark.mean() == pytest.approx(0.5 * plain.mean(), rel=0.02)


def test_a_wrong_calibration_shows() -> None:
    true = camera_of(CAMERA, 1.02)
    assert true.focal_px == pytest.approx((1.02 * CAMERA.focal_px[0], 1.02 * CAMERA.focal_px[1]))
    assert true.center_px == CAMERA.center_px
