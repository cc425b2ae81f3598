"""The beam from dots at known depth, and the dots from pictures."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from board_pictures import Printed, camera
from flights import FLOOR_M, Motion, make_flight

from autopilot.calibrate.boards import BoardSpec, CalibrationBoard
from autopilot.calibrate.laser_dots import board_dots, green_dots, logged_dots
from autopilot.calibrate.laser_fit import Dots, beam_values, fit_beam, floor_depths
from autopilot.core.camera import CameraModel
from autopilot.core.errors import ConfigError, LogError
from autopilot.core.vehicle import load_vehicle

VEHICLE = load_vehicle("lbv150")
CAMERA = CameraModel.of_vehicle(VEHICLE)
SLOPE, BASE_M = np.array([0.012, -0.02]), np.array([0.055, 0.004])


def dots(rng: np.random.Generator, depth_m: np.ndarray, wrong: float = 0.3, sigma_px: float = 0.6) -> Dots:
    """One dot per picture; a share of them is not the laser's."""
    ideal = SLOPE + BASE_M / depth_m[:, None] + sigma_px / 986.0 * rng.standard_normal((len(depth_m), 2))
    false = rng.random(len(depth_m)) < wrong
    ideal[false] = rng.uniform(-0.25, 0.25, (int(false.sum()), 2))
    return Dots(picture=np.arange(len(depth_m)), ideal=ideal, depth_m=depth_m)


def test_beam_comes_back_with_a_third_of_false_dots() -> None:
    rng = np.random.default_rng(2)
    beam = fit_beam(dots(rng, rng.uniform(0.4, 1.1, 200)), CAMERA)
    assert (np.abs(beam.slope - SLOPE) < 3.5 * beam.sigma_slope).all()
    assert (np.abs(beam.base_m - BASE_M) < 3.5 * beam.sigma_base_m).all()
    assert beam.sigma_slope.max() < 0.0005
    assert 0.0 < beam.sigma_range_m(0.8) < 0.002
    assert beam.sigma_range_m(0.4) < beam.sigma_range_m(1.2)
    values = beam_values(beam, CAMERA, VEHICLE)
    x, y, z = values["laser.position_frd_m"]
    assert z == pytest.approx(0.1)
    # Image x is starboard, image y aft.
    assert (x, y) == pytest.approx((-0.004, 0.055), abs=0.002)
    assert values["laser.direction_frd"] == pytest.approx([0.02, 0.012, 1.0], abs=0.002)


def test_useless_dots_are_refused() -> None:
    rng = np.random.default_rng(3)
    with pytest.raises(LogError, match="found in 5 pictures"):
        fit_beam(dots(rng, rng.uniform(0.4, 1.1, 5)), CAMERA)
    with pytest.raises(LogError, match=r"lie between 0\.78 and 0\.82 m"):
        fit_beam(dots(rng, rng.uniform(0.78, 0.82, 100), wrong=0.0, sigma_px=0.05), CAMERA)
    with pytest.raises(LogError, match="lie on one beam"):
        fit_beam(dots(rng, rng.uniform(0.4, 1.1, 60), wrong=1.0), CAMERA)


def test_dots_of_a_flight_with_a_leaning_vehicle() -> None:
    flight = make_flight(Motion(), noise=0.0, duration_s=20.0)
    model = replace(CAMERA, laser_direction_cam=np.array([0.012, -0.02, 1.0]) / np.linalg.norm([0.012, -0.02, 1.0]))
    pixels = []
    for eye, r in zip(flight.eye_ned_m, flight.r_ned_from_cam, strict=True):
        start = eye + r @ model.laser_offset_cam_m
        pixels.append(model.laser_pixel((FLOOR_M - start[2]) / (r @ model.laser_direction_cam)[2]))
    beam = fit_beam(logged_dots(replace(flight, laser_px=np.array(pixels))), flight.camera)
    np.testing.assert_allclose(beam.slope, [0.012, -0.02], atol=1e-5)
    np.testing.assert_allclose(beam.base_m, model.laser_offset_cam_m[:2], atol=1e-5)
    depth = floor_depths(CAMERA, np.array([list(CAMERA.center_px)]), np.eye(3), np.array([0.0, 0.0, 0.7]), FLOOR_M)
    assert depth == pytest.approx([0.8])


def test_from_pictures_of_a_board(tmp_path: Path) -> None:
    model = camera()
    board = CalibrationBoard(BoardSpec())
    printed = Printed(board, model)
    rng = np.random.default_rng(4)
    rows, columns = np.mgrid[0:480, 0:640]
    centre = np.array([*board.spec.size_m, 0.0]) / 2
    for number in range(16):
        turn = np.array([rng.uniform(-0.25, 0.25), rng.uniform(-0.25, 0.25), 0.1])
        r = np.asarray(cv2.Rodrigues(turn)[0])
        shift = np.array([0.03, 0.0, 0.28 + 0.02 * number]) - r @ centre
        grey = printed.picture(turn, shift, rng)
        # The beam (0.05, 0.002, 0) + z (0.01, -0.015, 1) on the board's plane.
        normal, start, along = r[:, 2], np.array([0.05, 0.002, 0.0]), np.array([0.01, -0.015, 1.0])
        x, y = model.project(start + along * float(normal @ (shift - start)) / float(normal @ along))
        glow = np.exp(-0.5 * ((columns - x) ** 2 + (rows - y) ** 2) / 1.5**2)[:, :, None] * [60.0, 200.0, 50.0]
        picture = np.clip(0.8 * grey[:, :, None] + glow, 0.0, 255.0).astype(np.uint8)
        assert np.abs(green_dots(picture)[0] - [x, y]).max() < 1.5
        cv2.imwrite(str(tmp_path / f"{number:02d}.png"), picture)
    beam = fit_beam(board_dots(board, model, tmp_path), model)
    assert beam.used >= 15
    assert (np.abs(beam.slope - [0.01, -0.015]) < np.maximum(4.0 * beam.sigma_slope, 0.001)).all()
    assert np.abs(beam.base_m - [0.05, 0.002]).max() < 0.0015
    with pytest.raises(ConfigError, match="use images of the mode"):
        board_dots(board, replace(model, width_px=1280), tmp_path)
    with pytest.raises(ConfigError, match="no image shows both"):
        board_dots(CalibrationBoard(BoardSpec(dictionary="DICT_7X7_100")), model, tmp_path)
