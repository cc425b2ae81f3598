"""Fisheye and flat-port cameras: OpenCV's formulas, Snell's law, derivatives, and what a pinhole makes of a pane."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec import structs
from scipy.optimize import least_squares

from autopilot.core.camera import NEAR_M, CameraModel
from autopilot.core.errors import ConfigError
from autopilot.core.flat_port import FlatPort
from autopilot.core.frames import FloatArray
from autopilot.core.markers import grid_floor
from autopilot.core.vehicle import load_vehicle

VEHICLE = load_vehicle("lbv150")
WATER = CameraModel.of_vehicle(VEHICLE)
PORT = FlatPort(distance_m=0.02, thickness_m=0.006, glass_index=1.49, water_index=1.333)
WIDE = replace(
    WATER, focal_px=(521.0, 521.0), center_px=(319.5, 239.5), distortion=(-0.1, 0.02, 1e-3, -2e-3, 0.0), port=PORT
)
"""The PS Eye's wide setting behind a pane, calibrated in air."""
FISHEYE = replace(
    WATER,
    focal_px=(280.0, 281.0),
    center_px=(322.0, 238.0),
    distortion=(-0.02, 0.01, -0.004, 0.0005, 0.0),
    fisheye=True,
)

PORTS = st.builds(
    FlatPort,
    distance_m=st.floats(0.001, 0.1),
    thickness_m=st.floats(0.0, 0.03),
    glass_index=st.floats(1.4, 1.8),
    water_index=st.floats(1.32, 1.36),
)


@settings(deadline=None, max_examples=60)
@given(port=PORTS, x=st.floats(-0.6, 0.6), y=st.floats(-0.5, 0.5), range_m=st.floats(0.1, 5.0))
def test_light_obeys_snell_at_both_surfaces(port: FlatPort, x: float, y: float, range_m: float) -> None:
    """The path to a projected point, walked in three straight pieces, ends at the point."""
    point = np.array([x * range_m, y * range_m, port.outside_m + range_m])
    camera = replace(WIDE, port=port, distortion=(0.0, 0.0, 0.0, 0.0, 0.0))
    pixel = camera.project(point)
    ray = np.append((pixel - camera.center_px) / camera.focal_px, 1.0)
    ray /= np.linalg.norm(ray)
    place, axis = np.zeros(3), np.array([0.0, 0.0, 1.0])
    for depth_m, ratio in ((port.distance_m, 1.0 / port.glass_index), (port.thickness_m, 0.0)):
        place = place + ray * (depth_m / ray[2])
        if ratio == 0.0:
            ratio = port.glass_index / port.water_index
        sideways = ratio * (ray - ray[2] * axis)  # Snell: the sine changes by the ratio of the indices
        ray = sideways + np.sqrt(1.0 - sideways @ sideways) * axis
    reached = place + ray * (range_m / ray[2])
    np.testing.assert_allclose(reached, point, atol=1e-9 * (1.0 + range_m))


@settings(deadline=None, max_examples=60)
@given(x=st.floats(0.0, 639.0), y=st.floats(0.0, 479.0), depth_m=st.floats(0.1, 4.0))
@pytest.mark.parametrize("camera", [WIDE, FISHEYE, WATER.behind(PORT)])
def test_a_point_on_a_pixels_ray_projects_to_that_pixel(
    camera: CameraModel, x: float, y: float, depth_m: float
) -> None:
    pixel = np.array([x, y])
    origin, direction = camera.rays(pixel)
    point = origin + (depth_m - origin[2]) * direction
    np.testing.assert_allclose(camera.project(point), pixel, atol=1e-6)
    np.testing.assert_allclose(camera.distort(camera.normalized(pixel)), pixel, atol=1e-6)


@settings(deadline=None, max_examples=40)
@given(x=st.floats(-0.4, 0.4), y=st.floats(-0.3, 0.3), z=st.floats(0.3, 2.0))
@pytest.mark.parametrize("camera", [WATER, WIDE, FISHEYE])
def test_derivatives_are_those_of_the_projection(camera: CameraModel, x: float, y: float, z: float) -> None:
    point = np.array([x * z, y * z, z])
    pixel, slopes = camera.linearise(point)
    np.testing.assert_allclose(pixel, camera.project(point), atol=1e-9)
    step = 1e-6
    for axis in range(3):
        ahead, behind = point.copy(), point.copy()
        ahead[axis] += step
        behind[axis] -= step
        expected = (camera.project(ahead) - camera.project(behind)) / (2.0 * step)
        np.testing.assert_allclose(slopes[:, axis], expected, rtol=1e-5, atol=1e-3)


def test_on_the_axis_nothing_is_singular() -> None:
    for camera in (WATER, WIDE, FISHEYE):
        pixel, slopes = camera.linearise(np.array([0.0, 0.0, 1.0]))
        np.testing.assert_allclose(pixel, camera.center_px, atol=1e-9)
        assert np.isfinite(slopes).all()
        np.testing.assert_allclose(camera.normalized(np.array(camera.center_px)), 0.0, atol=1e-12)


def test_fisheye_is_opencvs() -> None:
    rng = np.random.default_rng(1)
    points = np.column_stack([rng.uniform(-1.5, 1.5, 200), rng.uniform(-1.5, 1.5, 200), np.ones(200)])
    zero = np.zeros(3)
    expected, _ = cv2.fisheye.projectPoints(
        points.reshape(-1, 1, 3), zero, zero, FISHEYE.matrix, FISHEYE.distortion_coefficients[:4]
    )
    np.testing.assert_allclose(FISHEYE.project(points), expected.reshape(-1, 2), atol=1e-8)


def test_nothing_between_the_lens_and_just_outside_the_pane_has_an_image() -> None:
    depths = np.array([-1.0, 0.0, 0.01, PORT.outside_m + 0.5 * NEAR_M, PORT.outside_m + 2.0 * NEAR_M])
    points = np.column_stack([np.full(5, 0.001), np.zeros(5), depths])
    assert np.isfinite(WIDE.project(points)).all(axis=1).tolist() == [False] * 4 + [True]


def test_a_pane_without_refraction_changes_nothing() -> None:
    air = FlatPort(distance_m=0.02, thickness_m=0.006, glass_index=1.0, water_index=1.0)
    points = np.random.default_rng(2).uniform([-0.4, -0.3, 0.5], [0.4, 0.3, 1.5], (50, 3))
    np.testing.assert_allclose(
        replace(WIDE, port=air).project(points), replace(WIDE, port=None).project(points), atol=1e-9
    )


def test_far_away_a_calibration_in_water_and_its_lens_behind_the_pane_agree() -> None:
    """``behind`` takes the refraction out of the calibration: equal to fourth order at 100 m, 1 px at the rim."""
    behind = WATER.behind(structs.replace(PORT, distance_m=0.0, thickness_m=0.0))
    pixels = np.stack(np.meshgrid(np.linspace(80, 560, 9), np.linspace(60, 420, 7)), axis=-1).reshape(-1, 2)
    rays = np.column_stack((WATER.normalized(pixels), np.ones(len(pixels)))) * 100.0
    error_px = behind.project(rays) - pixels
    assert np.sqrt(np.square(error_px).mean()) < 0.3
    assert np.abs(error_px).max() < 1.2


def pinhole_for(camera: CameraModel, depths_m: FloatArray) -> tuple[CameraModel, float]:
    """The pinhole with k1 and k2, and how far before the lens it sits, that fits a flat-port camera best there."""
    grid = np.stack(np.meshgrid(np.linspace(5, 635, 15), np.linspace(5, 475, 11)), axis=-1).reshape(-1, 2)
    origins, directions = camera.rays(grid)
    points = np.concatenate([origins + (d - origins[:, 2:]) * directions for d in depths_m])
    pixels = np.tile(grid, (len(depths_m), 1))

    def model(p: FloatArray) -> CameraModel:
        return replace(camera, port=None, focal_px=(p[0], p[0]), distortion=(p[1], p[2], 0.0, 0.0, 0.0))

    def residual(p: FloatArray) -> FloatArray:
        return (model(p).project(points - [0.0, 0.0, p[3]]) - pixels).ravel()

    fit = least_squares(residual, [690.0, 0.0, 0.0, 0.0], x_scale=[100.0, 0.1, 0.1, 0.01])
    assert np.sqrt(np.mean(np.square(fit.fun))) < 0.3
    return model(fit.x), float(fit.x[3])


def test_a_pinhole_calibrated_in_water_sits_8_millimetres_behind_the_lens() -> None:
    """Pane 20 mm before the lens: 8.5 mm over the whole of a wide picture (on the axis (n - 1) 20 mm = 6.7 mm). Whoever
    takes the lens for the centre of the pinhole is that much off in height, at every height."""
    wide = replace(WIDE, distortion=(0.0, 0.0, 0.0, 0.0, 0.0), port=structs.replace(PORT, thickness_m=0.0))
    pinhole, before_m = pinhole_for(wide, np.array([0.3, 0.6, 0.9, 1.2]))
    assert wide.port is not None
    assert before_m == pytest.approx(-0.0085, abs=0.0008)
    assert pinhole.focal_px[0] == pytest.approx(694.0, rel=0.02)


def test_what_is_in_view_is_what_projects_into_the_picture() -> None:
    polygon = np.array([[-1.5, -1.0], [1.5, -1.0], [1.5, 1.0], [-1.5, 1.0]])
    floor = grid_floor(polygon_m=polygon, depth_m=1.5, pitch_m=0.08, size_m=0.06, seed=7)
    for depth_m in (0.2, 0.8, 1.2):
        pos = np.array([0.1, 0.2, depth_m])
        pixels = WIDE.project(WIDE.cam_from_ned(floor.corners_ned_m, pos, np.eye(3)))
        expected = np.flatnonzero(WIDE.inside(pixels).all(axis=1))
        assert floor.visible(WIDE, pos, np.eye(3)).tolist() == expected.tolist()


CAMERA_TABLES = [
    ('model = "flat_port"', r'`model` = "flat_port"'),
    ("port = { distance_m = 0.02 }", r'`model` = "pinhole"'),
    ('model = "flat_port"\nport = { distance_m = -0.02 }', r"distance_m"),
    ('model = "flat_port"\nport = { distance_m = 0.02, water_index = 3.0 }', r"water_index"),
    ('model = "fisheye"\n', ""),
    ('model = "dome"', r"\$\.camera\.model"),
]


@pytest.mark.parametrize(("extra", "message"), CAMERA_TABLES)
def test_vehicle_file(tmp_path: Path, extra: str, message: str) -> None:
    shipped = Path(__file__).resolve().parents[2] / "autopilot" / "data" / "vehicles" / "lbv150.toml"
    text = shipped.read_text(encoding="utf-8")
    file = tmp_path / "boat.toml"
    file.write_text(text.replace("[camera]", f"[camera]\n{extra}\n#", 1), encoding="utf-8")
    if message:
        with pytest.raises(ConfigError, match=message):
            load_vehicle(str(file))
    else:
        vehicle = load_vehicle(str(file))
        assert CameraModel.of_vehicle(vehicle).fisheye
