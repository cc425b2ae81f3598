"""The camera's formulas against OpenCV's, and which way is up in the picture."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from autopilot.core.camera import R_FRD_FROM_CAM, CameraModel
from autopilot.core.frames import r_ned_from_frd
from autopilot.core.vehicle import load_vehicle

VEHICLE = load_vehicle("lbv150")
CAMERA = CameraModel.of_vehicle(VEHICLE)


def test_projection_is_opencvs() -> None:
    rng = np.random.default_rng(1)
    points = np.column_stack([rng.uniform(-0.4, 0.4, 200), rng.uniform(-0.3, 0.3, 200), rng.uniform(0.8, 1.4, 200)])
    zero = np.zeros(3)
    expected, _ = cv2.projectPoints(points, zero, zero, CAMERA.matrix, CAMERA.distortion_coefficients)
    np.testing.assert_allclose(CAMERA.project(points), expected.reshape(-1, 2), atol=1e-9)


@settings(deadline=None)
@given(x=st.floats(-20.0, 660.0), y=st.floats(-20.0, 500.0))
def test_normalized_undoes_distort(x: float, y: float) -> None:
    pixel = np.array([x, y])
    np.testing.assert_allclose(CAMERA.distort(CAMERA.normalized(pixel)), pixel, atol=1e-8)


@pytest.mark.parametrize(
    ("offset_frd_m", "axis", "sign"),
    [((0.1, 0.0, 0.0), 1, -1), ((-0.1, 0.0, 0.0), 1, 1), ((0.0, 0.1, 0.0), 0, 1), ((0.0, -0.1, 0.0), 0, -1)],
)
def test_ahead_is_up_and_starboard_is_right(offset_frd_m: tuple[float, float, float], axis: int, sign: int) -> None:
    pos, r = np.array([1.0, 2.0, 0.4]), r_ned_from_frd(np.array([0.0, 0.0, 0.7]))
    below = pos + r @ np.array([0.0, 0.0, 1.0])
    centre = CAMERA.project(CAMERA.cam_from_ned(below, pos, r))
    moved = CAMERA.project(CAMERA.cam_from_ned(below + r @ np.array(offset_frd_m), pos, r))
    assert sign * (moved - centre)[axis] > 50.0
    assert abs((moved - centre)[1 - axis]) < 10.0


def test_mounting_is_a_rotation() -> None:
    np.testing.assert_allclose(R_FRD_FROM_CAM @ R_FRD_FROM_CAM.T, np.eye(3))
    assert np.linalg.det(R_FRD_FROM_CAM) == pytest.approx(1.0)


def test_lever_arm_and_laser_are_the_vehicle_files() -> None:
    level = np.eye(3)
    point = np.array(VEHICLE.camera.position_frd_m) + np.array([0.0, 0.0, 1.0])
    np.testing.assert_allclose(
        CAMERA.project(CAMERA.cam_from_ned(point, np.zeros(3), level)), CAMERA.center_px, atol=1e-9
    )
    dot = np.array(VEHICLE.laser.position_frd_m) + np.array([0.0, 0.0, 0.9])
    np.testing.assert_allclose(
        CAMERA.laser_pixel(0.9), CAMERA.project(CAMERA.cam_from_ned(dot, np.zeros(3), level)), atol=1e-9
    )
    assert CAMERA.laser_pixel(0.5)[0] > CAMERA.laser_pixel(1.0)[0] > CAMERA.center_px[0]


def test_points_behind_the_lens_have_no_image() -> None:
    pixels = CAMERA.project(np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]))
    assert np.isnan(pixels[:2]).all()
    assert CAMERA.inside(pixels).tolist() == [False, False, True]
    assert not CAMERA.inside(np.array([639.5, 100.0]))
    assert not CAMERA.inside(np.array([5.0, 100.0]), margin_px=6.0)
