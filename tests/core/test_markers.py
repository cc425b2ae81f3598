"""The marker floor: what the layout promises, and which markers a pose shows."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from autopilot.core.camera import CameraModel
from autopilot.core.errors import ConfigError
from autopilot.core.frames import r_ned_from_frd
from autopilot.core.markers import SAME_ID_DISTANCE_M, MarkerMap, grid_floor
from autopilot.core.vehicle import load_vehicle
from autopilot.sitl.scenario import load_scenario

VEHICLE = load_vehicle("lbv150")
CAMERA = CameraModel.of_vehicle(VEHICLE)
TANK = np.array([[-2.5, -1.5], [2.5, -1.5], [2.5, 1.5], [-2.5, 1.5]])
DEPTH_M = 1.5


@pytest.fixture(scope="module")
def floor() -> MarkerMap:
    """The floor of the shipped tank."""
    layout = load_scenario("paper-tank").markers
    return grid_floor(polygon_m=TANK, depth_m=DEPTH_M, pitch_m=layout.pitch_m, size_m=layout.size_m, seed=layout.seed)


def test_two_full_markers_in_view_at_any_yaw_from_120_down_to_45_cm(floor: MarkerMap) -> None:
    # Camera 0.45 to 1.2 m above the floor, anywhere the body's ball fits in the tank, up to 3 deg of roll and pitch.
    # 2 px free at the border; the worst height is the lowest, so half of the poses are there.
    rng = np.random.default_rng(2)
    arm_m = CAMERA.position_frd_m[2]
    for trial in range(1500):
        height_m = 0.45 if trial % 2 else rng.uniform(0.45, 1.2)
        tilt = np.radians(rng.uniform(-3.0, 3.0, 2))
        rpy = np.array([*tilt, rng.uniform(-np.pi, np.pi)])
        pos = np.array([rng.uniform(-2.2, 2.2), rng.uniform(-1.2, 1.2), DEPTH_M - height_m - arm_m])
        assert len(floor.visible(CAMERA, pos, r_ned_from_frd(rpy), margin_px=2.0)) >= 2, (pos, rpy)


def test_few_markers_in_view_where_the_mission_flies(floor: MarkerMap) -> None:
    seen = floor.visible(CAMERA, np.array([0.1, 0.1, 0.3]), np.eye(3))
    assert 25 <= len(seen) <= 60


def test_same_ids_are_far_apart(floor: MarkerMap) -> None:
    centers = floor.centers_ned_m[:, :2]
    assert len(floor.ids) > 1000  # more markers than ids: they do repeat
    for marker_id in np.unique(floor.ids):
        places = centers[floor.ids == marker_id]
        distance = np.linalg.norm(places[:, None] - places[None], axis=-1)
        assert distance[~np.eye(len(places), dtype=bool)].min(initial=9.0) >= SAME_ID_DISTANCE_M - 0.09


def test_no_pair_of_neighbours_occurs_twice(floor: MarkerMap) -> None:
    pitch = load_scenario("paper-tank").markers.pitch_m
    cells = np.rint((floor.centers_ned_m[:, :2] - floor.centers_ned_m[0, :2]) / pitch).astype(int)
    by_cell = {tuple(cell): int(marker_id) for cell, marker_id in zip(cells, floor.ids, strict=True)}
    for step in ((1, 0), (0, 1), (1, 1), (1, -1)):
        pairs = [
            (marker_id, by_cell[(i + step[0], j + step[1])])
            for (i, j), marker_id in by_cell.items()
            if (i + step[0], j + step[1]) in by_cell
        ]
        assert len(pairs) == len(set(pairs)) > 2000


def test_corners_run_as_opencv_wants_them_for_a_top_to_the_north(floor: MarkerMap) -> None:
    top_left, top_right, bottom_right, bottom_left = floor.corners_ned_m[17]
    np.testing.assert_allclose(top_right - top_left, [0.0, floor.size_m, 0.0], atol=1e-12)
    np.testing.assert_allclose(bottom_left - top_left, [-floor.size_m, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(bottom_right - bottom_left, [0.0, floor.size_m, 0.0], atol=1e-12)
    assert (floor.corners_ned_m[..., 2] == DEPTH_M).all()


@settings(deadline=None, max_examples=60)
@given(
    north=st.floats(-2.3, 2.3),
    east=st.floats(-1.3, 1.3),
    depth=st.floats(0.0, 1.2),
    roll=st.floats(-1.2, 1.2),
    pitch=st.floats(-1.2, 1.2),
    yaw=st.floats(-3.1, 3.1),
    margin=st.floats(-60.0, 20.0),
)
def test_visible_is_what_projecting_every_marker_gives(
    floor: MarkerMap,
    north: float,
    east: float,
    depth: float,
    roll: float,
    pitch: float,
    yaw: float,
    margin: float,
) -> None:
    pos, r = np.array([north, east, depth]), r_ned_from_frd(np.array([roll, pitch, yaw]))
    pixels = CAMERA.project(CAMERA.cam_from_ned(floor.corners_ned_m, pos, r))
    expected = np.flatnonzero(CAMERA.inside(pixels, margin).all(axis=1))
    assert floor.visible(CAMERA, pos, r, margin).tolist() == expected.tolist()


def test_markers_stay_inside_a_polygon_that_is_not_convex() -> None:
    corner = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [1.0, 1.0], [1.0, 2.0], [0.0, 2.0]])
    markers = grid_floor(polygon_m=corner, depth_m=1.0, pitch_m=0.1, size_m=0.08, seed=1)
    north, east = markers.corners_ned_m[..., 0], markers.corners_ned_m[..., 1]
    assert len(markers.ids) == 300
    assert ((north < 1.0) | (east < 1.0)).all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"size_m": 0.08}, "markers.size_m = 0.08"),
        ({"dictionary": "DICT_9X9_5"}, "DICT_9X9_5"),
        ({"pitch_m": 9.0}, "leaves no room"),
    ],
)
def test_refuses_a_floor_that_cannot_be(change: dict[str, object], message: str) -> None:
    whole: dict[str, Any] = {"polygon_m": TANK, "depth_m": DEPTH_M, "pitch_m": 0.08, "size_m": 0.06, "seed": 1}
    with pytest.raises(ConfigError, match=message):
        grid_floor(**{**whole, **change})
