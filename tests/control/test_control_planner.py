"""Routes: free, short, and none where there is none. References: consistent motion along them."""

import math
from itertools import pairwise

import numpy as np
import pytest
from control_loop import MODEL, TANK
from hypothesis import given, settings
from hypothesis import strategies as st

from autopilot.control.constraints.obstacles import clearance_m
from autopilot.control.nmpc.grid import geometric_grid
from autopilot.control.path.path_tuning import PLANNER
from autopilot.control.path.planner import Planner
from autopilot.control.path.reference import ReferenceRollout, ReferenceTarget, Route, turn_target, water_speed_fraction
from autopilot.control.robust.fallback import station_keeping_thrust
from autopilot.core.control_allocator import ControlAllocator
from autopilot.core.frames import FloatArray
from autopilot.core.geometry import Circle, Fence, Polygon
from autopilot.core.model4 import state_derivative
from autopilot.mission.mission_tuning import VALIDATION
from autopilot.mission.reach import FreeRegions

RADIUS_M = 0.33
A, B = np.array([-1.6, -0.35]), np.array([1.75, 0.0])


def clearance_along(fence: Fence, path: np.ndarray) -> float:
    s = np.linspace(0.0, 1.0, 30)[:, None]
    points = np.concatenate([a + s * (b - a) for a, b in pairwise(path)])
    return float(clearance_m(fence, points).min())


def length(path: np.ndarray) -> float:
    return float(np.hypot(*np.diff(path, axis=0).T).sum())


def test_tank_route_is_free_short_and_avoids_the_south_corridor() -> None:
    planner = Planner(TANK, RADIUS_M)
    for start, end in ((A, B), (B, A)):
        path = planner.path(start, end)
        assert path is not None
        assert np.allclose(path[0], start)
        assert np.allclose(path[-1], end)
        assert clearance_along(TANK, path) > RADIUS_M + PLANNER.planning_extra_m - 0.01
        assert length(path) < 3.65
        near_pillar = path[np.abs(path[:, 0] + 0.625) < 0.3]
        assert (near_pillar[:, 1] > -0.625).all()


def test_free_line_is_taken_as_it_is() -> None:
    path = Planner(TANK, RADIUS_M).path(np.array([-2.0, 1.0]), np.array([2.0, 1.1]))
    assert path is not None
    assert len(path) == 2


def test_pocket_is_left() -> None:
    walls = tuple(Circle(center_ned_m=np.array([0.5 * abs(i) / 4 * -1, 0.2 * i]), radius_m=0.25) for i in range(-4, 5))
    fence = Fence(exclusions=walls)
    path = Planner(fence, RADIUS_M).path(np.array([-0.9, 0.0]), np.array([2.0, 0.0]))
    assert path is not None
    assert clearance_along(fence, path) > RADIUS_M
    assert np.abs(path[:, 1]).max() > 1.2


def test_walled_off_goal_has_no_route() -> None:
    ring = tuple(
        Circle(center_ned_m=np.array([math.cos(a), math.sin(a)]), radius_m=0.3) for a in np.arange(0.0, 6.28, 0.5)
    )
    planner = Planner(Fence(exclusions=ring), 0.2)
    assert planner.path(np.array([-3.0, 0.0]), np.array([0.0, 0.0])) is None
    assert planner.path(np.array([0.0, 0.0]), np.array([3.0, 0.0])) is None
    assert planner.path(np.array([-3.0, 0.0]), np.array([3.0, 0.0])) is not None


@pytest.mark.parametrize(
    ("door_m", "open_"), [(0.64, False), (0.655, False), (0.67, True), (0.70, True), (0.75, True), (0.90, True)]
)
def test_a_tight_door_is_taken_when_there_is_no_other_way(door_m: float, open_: bool) -> None:
    half = door_m / 2
    west = [(-2, -1), (-2, 1), (-0.1, 1), (-0.1, half)]
    east = [(0.1, half), (0.1, 1), (2, 1), (2, -1), (0.1, -1), (0.1, -half), (-0.1, -half), (-0.1, -1)]
    fence = Fence(inclusions=(Polygon(vertices_ned_m=np.array([*west, *east])),))
    path = Planner(fence, RADIUS_M).path(np.array([-1.0, 0.3]), np.array([1.0, -0.3]))
    assert (path is not None) is open_
    if path is not None:
        assert clearance_along(fence, path) >= RADIUS_M - 0.003


@pytest.mark.parametrize("seed", range(8))
def test_upload_check_and_planner_agree_on_doors(seed: int) -> None:
    """What the check of uploads lets pass the planner finds; what it refuses is narrower than the vehicle keeps."""
    rng = np.random.default_rng(seed)
    thick, aside, turn = float(rng.choice([0.0005, 0.1, 0.4])), rng.uniform(-0.2, 0.2), rng.uniform(0.0, 3.0)
    turned = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
    ends = np.array([[-1.0, 0.3], [1.0, -0.3]]) @ turned.T
    for door_m in (0.60, 0.64, 0.657, 0.667, 0.68, 0.69):
        low, high = aside - 0.5 * door_m, aside + 0.5 * door_m
        west = [(-2.0, -1.0), (-2.0, 1.0), (-thick, 1.0), (-thick, high)]
        east = [(thick, high), (thick, 1.0), (2.0, 1.0), (2.0, -1.0), (thick, -1.0), (thick, low)]
        corners = np.array([*west, *east, (-thick, low), (-thick, -1.0)]) @ turned.T
        fence = Fence(inclusions=(Polygon(vertices_ned_m=corners),))
        here, there = FreeRegions(fence, ends, RADIUS_M + VALIDATION.passage_m).of_points
        accepted = here == there
        assert accepted is (door_m > 2.0 * (RADIUS_M + VALIDATION.passage_m))
        found = Planner(fence, RADIUS_M).path(*ends)
        assert not accepted or found is not None
        assert found is None or door_m >= 2.0 * RADIUS_M


def test_goal_inside_an_obstacle_or_outside_the_workspace_has_no_route() -> None:
    planner = Planner(TANK, RADIUS_M)
    assert planner.path(A, np.array([-3.5, 0.0])) is None
    wide = Fence(exclusions=(Circle(center_ned_m=np.array([0.0, 0.0]), radius_m=1.0),))
    assert Planner(wide, RADIUS_M).path(np.array([-3.0, 0.0]), np.array([0.1, 0.0])) is None


def test_start_and_goal_a_little_inside_the_inflated_zone() -> None:
    planner = Planner(TANK, RADIUS_M)
    start, end = np.array([-0.625, -0.625 + 0.47]), np.array([0.9375 + 0.48, 0.0])
    path = planner.path(start, end)
    assert path is not None
    assert np.allclose(path[[0, -1]], [start, end])
    assert clearance_along(TANK, path) > 0.29


def test_route_round_the_corner_of_a_room_that_is_not_convex() -> None:
    room = Fence(
        inclusions=(
            Polygon(
                vertices_ned_m=np.array([[-3.0, -3.0], [-3.0, 3.0], [0.0, 3.0], [0.0, 0.0], [3.0, 0.0], [3.0, -3.0]])
            ),
        )
    )
    path = Planner(room, RADIUS_M).path(np.array([-0.6, 2.5]), np.array([2.5, -0.6]))
    assert path is not None
    assert clearance_along(room, path) > RADIUS_M
    assert length(path) < 5.7


def test_large_workspace_stays_small() -> None:
    square = np.array([[0.0, 0.0], [400.0, 0.0], [400.0, 200.0], [0.0, 200.0]])
    rng = np.random.default_rng(4)
    pillars = tuple(Circle(center_ned_m=rng.uniform([40, 20], [360, 180]), radius_m=6.0) for _ in range(50))
    fence = Fence(inclusions=(Polygon(vertices_ned_m=square),), exclusions=pillars)
    planner = Planner(fence, RADIUS_M)
    path = planner.path(np.array([5.0, 100.0]), np.array([395.0, 100.0]))
    assert path is not None
    assert clearance_along(fence, path) > RADIUS_M
    assert length(path) < 420.0


def test_route_projection_and_points() -> None:
    route = Route(np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 0.0], [2.0, 1.0]]))
    assert route.length_m == pytest.approx(3.0)
    assert route.project(np.array([0.7, 0.2]), 0.6) == pytest.approx((0.7, 0.2))
    assert route.project(np.array([2.3, 0.5]), 2.2) == pytest.approx((2.5, 0.3))
    # The window keeps the projection on the present stretch of a route that comes near itself.
    assert route.project(np.array([1.9, 0.9]), 1.0)[0] == pytest.approx(1.5)
    assert route.point(2.5) == pytest.approx(2.0 + 0.5j)
    assert np.allclose(route.ahead(np.array([0.5, 0.1]), 0.5), [[0.5, 0.1], [2.0, 0.0], [2.0, 1.0]])
    still = Route(np.array([[1.0, 1.0], [1.0, 1.0]]))
    assert still.length_m == 0.0


def target(**changes) -> ReferenceTarget:
    values = {
        "route": Route(np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.5]])),
        "s0_m": 0.0,
        "depth_m": 0.3,
        "yaw_rad": 1.0,
        "cruise_m_s": 0.35,
        "speed_limit_m_s": 0.46,
        "heave_limit_m_s": 0.25,
        "yaw_rate_limit_rad_s": 1.0,
    }
    return ReferenceTarget(**(values | changes))


def references(t_s: FloatArray, x0: FloatArray, target: ReferenceTarget, current: FloatArray) -> FloatArray:
    return ReferenceRollout(ControlAllocator(MODEL), t_s)(x0, target, current, np.full(4, np.inf))[0]


@given(st.floats(0.01, 10.0), st.floats(0.02, 0.45), st.floats(-2.0, 2.0))
@settings(max_examples=60, deadline=None)
def test_a_reference_stops_at_the_end(distance: float, speed: float, turn: float) -> None:
    t_s = np.linspace(0.0, 60.0 + distance / speed, 4001)
    along = target(route=Route(np.array([[0.0, 0.0], [distance, 0.0]])), cruise_m_s=speed, yaw_rad=turn)
    ref = references(t_s, np.zeros(8), along, np.zeros(3))
    assert ref[0, 0] == pytest.approx(0.0, abs=1e-12)
    assert ref[-1] == pytest.approx([distance, 0.0, 0.3, turn, 0.0, 0.0, 0.0, 0.0], abs=1e-9)
    assert (np.hypot(ref[:, 4], ref[:, 5]) <= speed + 1e-12).all()
    assert np.allclose(np.gradient(ref[:, 0], t_s)[1:-1], np.hypot(ref[:, 4], ref[:, 5])[1:-1], atol=0.02)


@given(st.floats(-0.4, 0.4), st.floats(-0.4, 0.4), st.floats(0.05, 0.6), st.floats(-3.1, 3.1))
@settings(max_examples=100, deadline=None)
def test_ground_speed_respects_the_limit_through_the_water(cn: float, ce: float, cruise: float, heading: float) -> None:
    tangent, current = complex(math.cos(heading), math.sin(heading)), complex(cn, ce)
    along = target(route=Route(9.0 * np.array([[0.0, 0.0], [tangent.real, tangent.imag]])), cruise_m_s=cruise)
    first = references(np.array([0.0, 0.1]), np.zeros(8), along, np.array([cn, ce, 0.0]))[0]
    water = complex(first[4], first[5])
    speed = (tangent.conjugate() * (water + current)).real
    assert 0.0 < speed <= max(cruise, 0.02) + 1e-12
    if speed > 0.0201:
        assert abs(water) <= 0.46 or speed == pytest.approx(cruise)
        if speed < cruise - 1e-9:
            asked = water_speed_fraction(-(tangent.conjugate() * current).real, 0.46)
            assert 0.95 <= asked <= 0.985
            assert abs(water) == pytest.approx(asked * 0.46)


def test_reference_is_a_motion_of_the_model() -> None:
    """The derivative of the referenced pose is the model's kinematics at the referenced velocities."""
    t_s = np.linspace(0.0, 12.0, 2401)
    current = np.array([0.1, -0.05, 0.02])
    x0 = np.array([0.0, 0.0, 0.8, -0.5, 0.0, 0.0, 0.0, 0.0])
    ref = references(t_s, x0, target(), current)
    slope = np.gradient(ref[:, :4], t_s, axis=0)
    kinematics = np.array([state_derivative(MODEL, x, [0.0] * 4, current, np)[:4] for x in ref])
    corners = np.abs(slope - kinematics).max(axis=1) > 1e-2
    assert corners.sum() < 12
    assert np.allclose(ref[-1, :4], [1.0, 1.5, 0.3, 1.0])
    assert np.abs(ref[:, 6] + current[2]).max() < 0.25
    assert np.abs(ref[:, 7]).max() < 1.0


def test_goal_in_a_current_is_a_steady_state_of_the_reference() -> None:
    current = np.array([0.1, -0.2, 0.03])
    x0 = np.array([1.0, 1.5, 0.3, 1.0, 0.0, 0.0, 0.0, 0.0])
    ref = references(geometric_grid().t_s, x0, target(s0_m=2.5), current)
    assert np.allclose(ref, ref[0])
    assert np.allclose(state_derivative(MODEL, ref[0], [0.0] * 4, current, np)[:4], 0.0, atol=1e-12)


def test_half_turn_keeps_its_direction() -> None:
    first = turn_target(0.0, math.pi - 1e-3, None)
    assert first == pytest.approx(math.pi - 1e-3)
    assert turn_target(-0.01, math.pi - 1e-3, first) == first
    assert turn_target(-0.4, math.pi - 1e-3, first) == first
    assert turn_target(-0.8, math.pi - 1e-3, first) == pytest.approx(-math.pi - 1e-3)
    assert turn_target(0.2, 0.5, first) == pytest.approx(0.5)
    assert turn_target(13.0, 0.5, None) == pytest.approx(0.5 + 4.0 * math.pi)


def test_equal_ways_round_unwind_the_tether() -> None:
    assert turn_target(math.pi, 0.0, None) == pytest.approx(0.0)
    assert turn_target(-math.pi, 0.0, None) == pytest.approx(0.0)
    assert turn_target(math.pi + 0.1, 0.0, None) == pytest.approx(0.0)
    assert turn_target(math.pi + 0.3, 0.0, None) == pytest.approx(2.0 * math.pi)
    yaw = 0.0
    for goal in [math.pi, 0.0] * 10:
        yaw = turn_target(yaw, goal, None)
    assert yaw == pytest.approx(0.0)


def test_station_keeping_balances_the_current_and_pulls_back() -> None:
    current, limit = np.array([0.15, -0.1, 0.0]), np.full(4, 12.0)
    held = np.array([1.0, 1.0, 0.5, 0.7, 0.0, 0.0, 0.0, 0.0])
    x = held.copy()
    c, s = math.cos(0.7), math.sin(0.7)
    x[4], x[5] = -(c * 0.15 - s * 0.1), -(-s * 0.15 - c * 0.1)
    balance = station_keeping_thrust(ControlAllocator(MODEL), x, held, current, limit)
    rate = state_derivative(MODEL, x.tolist(), balance.tolist(), current.tolist(), math)
    assert np.allclose(rate, 0.0, atol=1e-9)
    away = x + np.array([-0.3, 0.0, 0.2, -0.4, 0.0, 0.0, 0.0, 0.0])
    pull = station_keeping_thrust(ControlAllocator(MODEL), away, held, current, limit) - balance
    assert pull[2] < 0.0
    assert pull[0] > pull[1]
    assert (
        np.abs(station_keeping_thrust(ControlAllocator(MODEL), away + 5.0, held, current, np.full(4, 2.0))) <= 2.0
    ).all()
