"""Where the camera looks and where the laser points, as the vehicle file has it."""

import msgspec
import numpy as np
import pytest

from autopilot.core.camera import R_FRD_FROM_CAM, CameraModel
from autopilot.core.errors import ConfigError
from autopilot.core.frames import r_ned_from_frd
from autopilot.core.markers import grid_floor
from autopilot.core.samples import MarkerSighting
from autopilot.core.toml_table import convert
from autopilot.core.vehicle import Laser, load_vehicle
from autopilot.estimator.markers_pose import MarkerSolver


def test_a_turned_camera_and_a_slanting_beam() -> None:
    vehicle = load_vehicle("lbv150")
    straight = CameraModel.of_vehicle(vehicle)
    turn = (0.02, -0.03, 0.05)
    camera = msgspec.structs.replace(vehicle.camera, mounting_rpy_rad=turn)
    slanting = Laser(position_frd_m=vehicle.laser.position_frd_m, direction_frd=(0.0, -0.1, 2.0))
    turned = CameraModel.of(camera, slanting)
    r_frd_from_cam = r_ned_from_frd(np.array(turn)) @ R_FRD_FROM_CAM
    np.testing.assert_allclose(turned.r_frd_from_cam, r_frd_from_cam, atol=1e-15)
    # The dot is where a point on the beam is seen, whichever way the camera looks.
    dot_ned_m = np.array(slanting.position_frd_m) + 0.8 * np.array([0.0, -0.1, 2.0]) / np.hypot(0.1, 2.0)
    seen = turned.project(turned.cam_from_ned(dot_ned_m, np.zeros(3), np.eye(3)))
    np.testing.assert_allclose(turned.laser_pixel(0.8), seen, atol=1e-9)
    assert abs(seen - straight.laser_pixel(0.8)).max() > 10.0


@pytest.mark.parametrize("direction", [(0.0, 0.0, 0.0), (0.0, 0.0, -1.0), (1.0, 0.0, 0.5)])
def test_a_beam_that_does_not_go_down_is_refused(direction: tuple[float, float, float]) -> None:
    tables = {"position_frd_m": [0.0, 0.05, 0.1], "direction_frd": list(direction)}
    with pytest.raises(ConfigError, match="direction_frd"):
        convert(tables, Laser, "test.toml")


def test_range_and_pose_with_a_turned_camera_and_a_slanting_beam() -> None:
    vehicle = load_vehicle("lbv150")
    table = msgspec.structs.replace(vehicle.camera, mounting_rpy_rad=(0.03, -0.02, 0.04))
    slanting = Laser(position_frd_m=vehicle.laser.position_frd_m, direction_frd=(0.01, -0.05, 1.0))
    camera = CameraModel.of(table, slanting)
    square = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    floor = grid_floor(polygon_m=square, depth_m=1.5, pitch_m=0.08, size_m=0.06, seed=7)
    solver = MarkerSolver(camera, floor)
    for range_m in (0.4, 0.9):
        dot = MarkerSighting(t_us=0, ids=(), corners_px=np.empty((0, 4, 2)), laser_px=camera.laser_pixel(range_m))
        found = solver.laser_range(dot)
        assert found is not None
        assert found[0] == pytest.approx(range_m, abs=1e-4)
    pos, rpy = np.array([0.1, -0.2, 0.7]), np.array([0.02, 0.01, 0.5])
    visible = floor.visible(camera, pos, r_ned_from_frd(rpy))
    corners = camera.project(camera.cam_from_ned(floor.corners_ned_m[visible], pos, r_ned_from_frd(rpy)))
    sighting = MarkerSighting(t_us=0, ids=tuple(int(i) for i in floor.ids[visible]), corners_px=corners, laser_px=None)
    for fix in (solver.track(sighting, pos + 0.01, rpy), solver.locate(sighting, 0.02, 0.01)):
        assert fix is not None
        np.testing.assert_allclose(fix.z, np.append(pos, rpy[2]), atol=2e-3)
