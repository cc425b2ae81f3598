"""Poses over maps with boards at several depths, leaning tags, two sizes and two dictionaries."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_markers_pose import CAMERA, sight

from autopilot.core.camera import CameraModel
from autopilot.core.flat_port import FlatPort
from autopilot.core.frames import FloatArray, r_ned_from_frd, wrap_pi
from autopilot.core.marker_files import PlacedMarker, make_map
from autopilot.core.markers import MarkerMap
from autopilot.core.samples import MarkerSighting
from autopilot.estimator.markers_pose import MarkerSolver
from autopilot.estimator.pnp import solve_pose


def terrain(lean_rad: float) -> MarkerMap:
    """Steps of 0.25 m, every marker leaning its own way by up to ``lean_rad``; every third one an AprilTag."""
    rng = np.random.default_rng(5)
    placed = []
    for n, (i, j) in enumerate(np.ndindex(9, 9)):
        tag = n % 3 == 0
        rpy = np.array([rng.uniform(-lean_rad, lean_rad), rng.uniform(-lean_rad, lean_rad), rng.uniform(-3.0, 3.0)])
        placed.append(
            PlacedMarker(
                place="",
                dictionary="DICT_APRILTAG_36h11" if tag else "DICT_4X4_250",
                id=n,
                size_m=0.09 if tag else 0.06,
                center_ned_m=np.array([0.2 * i - 0.8, 0.2 * j - 0.8, 1.5 - 0.25 * ((i + j) % 2)]),
                r_ned_from_marker=r_ned_from_frd(rpy),
            )
        )
    return make_map(placed, "test")


STEPS, SLOPES = terrain(0.0), terrain(0.7)


@settings(deadline=None, max_examples=30)
@given(
    place=st.tuples(st.floats(-0.4, 0.4), st.floats(-0.4, 0.4), st.floats(0.2, 0.6)),
    tilt=st.tuples(st.floats(-0.05, 0.05), st.floats(-0.05, 0.05)),
    yaw=st.floats(-math.pi, math.pi),
    seed=st.integers(0, 1000),
)
@pytest.mark.parametrize("markers", [STEPS, SLOPES])
def test_pose_from_anywhere(
    markers: MarkerMap, place: tuple[float, float, float], tilt: tuple[float, float], yaw: float, seed: int
) -> None:
    """With a prediction and without one."""
    rng = np.random.default_rng(seed)
    pos, rpy = np.array(place), np.array([*tilt, yaw])
    sighting = sight(markers, pos, rpy, rng, sigma_px=0.1)
    if len(sighting.ids) < 3:
        return
    solver = MarkerSolver(CAMERA, markers)
    tracked = solver.track(sighting, pos + rng.normal(0.0, 0.01, 3), rpy + rng.normal(0.0, 0.01, 3))
    located = solver.locate(sighting, tilt[0] + 0.01, tilt[1] - 0.01)
    for fix in (tracked, located):
        assert fix is not None
        error = np.append(fix.z[:3] - pos, wrap_pi(float(fix.z[3]) - yaw))
        assert np.abs(error[:3]).max() < 0.02
        assert error @ np.linalg.solve(fix.noise, error) < 60.0


def flat_port_sighting(camera: CameraModel, markers: MarkerMap, pos: FloatArray, rpy: FloatArray) -> MarkerSighting:
    r = r_ned_from_frd(rpy)
    seen = markers.visible(camera, pos, r)
    pixels = camera.project(camera.cam_from_ned(markers.corners_ned_m[seen], pos, r))
    return MarkerSighting(
        t_us=0, ids=tuple(markers.ids[seen].tolist()), corners_px=pixels, laser_px=camera.laser_pixel(0.8)
    )


@pytest.mark.parametrize("height_m", [0.35, 0.6, 1.1])
def test_behind_a_flat_port_the_pose_is_exact(floor: MarkerMap, height_m: float) -> None:
    """A pane 50 mm before the lens. The in-water pinhole that the port replaces is millimetres to centimetres off."""
    camera = CAMERA.behind(FlatPort(distance_m=0.05, thickness_m=0.006, glass_index=1.49, water_index=1.333))
    pos, rpy = np.array([0.3, -0.2, 1.5 - 0.1 - height_m]), np.array([0.02, -0.03, 0.8])
    sighting = flat_port_sighting(camera, floor, pos, rpy)
    solver = MarkerSolver(camera, floor)
    for fix in (solver.track(sighting, pos + 0.01, rpy + 0.005), solver.locate(sighting, 0.02, -0.03)):
        assert fix is not None
        assert np.abs(fix.z[:3] - pos).max() < 0.02
    found = solver.laser_range(sighting)
    assert found is not None
    assert found[0] == pytest.approx(0.8, abs=1e-6)
    seen = floor.visible(camera, pos, r_ned_from_frd(rpy))
    points = floor.corners_ned_m[seen].reshape(-1, 3)
    start = (pos + 0.01, rpy + 0.005)
    exact = solve_pose(camera, points, sighting.corners_px.reshape(-1, 2), *start, max_rms_px=3.0)
    wrong = solve_pose(CAMERA, points, sighting.corners_px.reshape(-1, 2), *start, max_rms_px=30.0)
    assert exact is not None
    assert wrong is not None
    assert abs(wrong.pos_ned_m[2] - pos[2]) > 0.01
    assert np.abs(exact.pos_ned_m - pos).max() < 0.2 * abs(wrong.pos_ned_m[2] - pos[2])
