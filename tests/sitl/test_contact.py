"""Contact: what is touched, how deep, and what it does to the hull."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plant_helpers import NEUTRAL, VEHICLE, body_with, kinetic_energy_j, plant

from autopilot.core.errors import ConfigError
from autopilot.sitl.contact import Cylinder, Prism, SolidGeometry, Sphere, is_inside
from autopilot.sitl.plant import Plant
from autopilot.sitl.simulated_waters import SimulatedWaters
from autopilot.sitl.sitl_tuning import CONTACT

TRIMMED = body_with(buoyancy_excess_n=0.0)
TANK = ((-2.5, -1.5), (2.5, -1.5), (2.5, 1.5), (-2.5, 1.5))
ELL = ((-15.0, -10.0), (15.0, -10.0), (15.0, 2.0), (5.0, 2.0), (5.0, 10.0), (-15.0, 10.0))
RADIUS = VEHICLE.hull_radius_m
HALF_HEIGHT = VEHICLE.hull_half_height_m
POST = Cylinder(name="post", center_ned_m=(1.0, 0.0), radius_m=0.16)
WORLD = SimulatedWaters(polygon_ned_m=TANK, floor_m=1.5, solids=(POST,))


def surroundings(**changes: object) -> SolidGeometry:
    options: dict[str, object] = {
        "polygon_ned_m": None,
        "floor_m": None,
        "solids": (),
        "hull_radius_m": RADIUS,
        "hull_half_height_m": HALF_HEIGHT,
    }
    options.update(changes)
    return SolidGeometry(**options)


def pushed(force_ned_n: tuple[float, float, float], start: tuple[float, float, float]) -> Plant:
    hull = plant(TRIMMED, WORLD, start_pos_ned_m=start)
    hull.set_external_wrench(force_ned_n=force_ned_n)
    return hull


def test_a_push_against_the_wall_presses_the_hull_in_by_force_over_stiffness() -> None:
    hull = pushed((0.0, 10.0, 0.0), (0.0, 1.1, 0.7))
    hull.advance(20_000_000, NEUTRAL)
    truth = hull.truth
    assert truth.contact_depth_m == pytest.approx(10.0 / CONTACT.stiffness_n_m, rel=1e-3)
    assert truth.pos_ned_m[1] == pytest.approx(1.5 - RADIUS + 10.0 / CONTACT.stiffness_n_m, abs=1e-6)
    assert truth.max_penetration_m > truth.contact_depth_m
    np.testing.assert_allclose(truth.accel_frd_m_s2[:2], 0.0, atol=1e-6)
    assert {record.what for record in hull.contacts} == {"wall"}
    assert max(record.max_depth_m for record in hull.contacts) == truth.max_penetration_m
    assert truth.contact_count == len(hull.contacts)


def test_a_push_into_a_corner_meets_two_walls() -> None:
    hull = pushed((10.0, 10.0, 0.0), (2.0, 1.0, 0.7))
    hull.advance(20_000_000, NEUTRAL)
    expected = np.array([2.5, 1.5]) - RADIUS + 10.0 / CONTACT.stiffness_n_m
    np.testing.assert_allclose(hull.truth.pos_ned_m[:2], expected, atol=1e-5)


def test_the_floor_carries_a_heavy_hull() -> None:
    hull = pushed((0.0, 0.0, 5.0), (0.0, 0.0, 1.0))
    hull.advance(30_000_000, NEUTRAL)
    assert hull.truth.pos_ned_m[2] == pytest.approx(1.5 - HALF_HEIGHT + 5.0 / CONTACT.stiffness_n_m, abs=1e-6)
    assert {record.what for record in hull.contacts} == {"floor"}


def test_a_hull_that_runs_into_a_cylinder_is_recorded_and_thrown_back_with_less_energy() -> None:
    hull = plant(TRIMMED, WORLD, start_pos_ned_m=(0.3, 0.0, 0.7), start_vel_frd_m_s=(0.4, 0.0, 0.0))
    energy = kinetic_energy_j(hull.truth)
    deepest = 0.0
    for k in range(1, 400):
        hull.advance(k * 5_000, NEUTRAL)
        gap = math.hypot(hull.truth.pos_ned_m[0] - 1.0, hull.truth.pos_ned_m[1])
        deepest = max(deepest, 0.16 + RADIUS - gap)
    truth = hull.truth
    assert truth.vel_frd_m_s[0] < -0.05
    assert kinetic_energy_j(truth) < energy
    assert truth.contact_count == 1
    assert truth.contact_depth_m == 0.0
    assert truth.max_penetration_m == pytest.approx(deepest, abs=1e-12)
    assert 0.003 < deepest < 0.02
    assert hull.contacts[0].what == "post"
    assert 500_000 < hull.contacts[0].t_us < 1_200_000


def test_no_contact_no_record() -> None:
    hull = plant(TRIMMED, WORLD, start_pos_ned_m=(-1.0, 0.0, 0.7))
    hull.advance(1_000_000, (1600, 1600, 1500, 1500))
    assert hull.truth.contact_count == 0
    assert hull.truth.max_penetration_m == 0.0
    assert hull.contacts == ()


@pytest.mark.parametrize(
    ("start", "what"), [((2.3, 0.0, 0.7), "wall"), ((0.0, 0.0, 1.4), "floor"), ((1.2, 0.3, 0.7), "post")]
)
def test_a_start_inside_something_is_refused(start: tuple[float, float, float], what: str) -> None:
    with pytest.raises(ConfigError, match=rf"start position .* inside {what}; move the start away"):
        plant(TRIMMED, WORLD, start_pos_ned_m=start)


@given(st.floats(-14.7, 14.7), st.floats(-9.7, 9.7))
def test_clearance_from_the_walls_is_the_smallest_distance_to_their_points(x: float, y: float) -> None:
    if not is_inside(ELL, x, y):
        return
    room = surroundings(polygon_ned_m=ELL)
    points = [
        (a[0] + s * (b[0] - a[0]), a[1] + s * (b[1] - a[1]))
        for a, b in zip(ELL, (*ELL[1:], ELL[0]), strict=True)
        for s in np.linspace(0.0, 1.0, 601)
    ]
    brute = min(math.hypot(x - px, y - py) for px, py in points) - RADIUS
    assert room.clearance_m((x, y, 1.0)) == pytest.approx(brute, abs=0.03)


def test_a_corner_that_points_inwards_pushes_once() -> None:
    room = surroundings(polygon_ned_m=ELL)
    touches = room.touches((4.9, 1.9, 1.0))
    assert len(touches) == 1
    assert touches[0].depth_m == pytest.approx(RADIUS - math.hypot(0.1, 0.1))
    np.testing.assert_allclose(touches[0].normal_ned, [-math.sqrt(0.5), -math.sqrt(0.5), 0.0])


def test_inside_of_a_polygon_that_is_not_convex() -> None:
    assert is_inside(ELL, 0.0, 9.0)
    assert is_inside(ELL, 14.0, 0.0)
    assert not is_inside(ELL, 14.0, 9.0)
    assert not is_inside(ELL, -16.0, 0.0)


def test_a_sphere_is_touched_at_its_side_and_on_its_top() -> None:
    ball = Sphere(name="ball", center_ned_m=(0.0, 0.0, 2.0), radius_m=0.5)
    room = surroundings(solids=(ball,))
    beside = room.touches((RADIUS + 0.49, 0.0, 2.05))
    assert beside[0].depth_m == pytest.approx(0.01)
    np.testing.assert_allclose(beside[0].normal_ned, [1.0, 0.0, 0.0])
    above = room.touches((0.1, 0.0, 1.5 - HALF_HEIGHT + 0.01))
    assert above[0].depth_m == pytest.approx(0.01)
    np.testing.assert_allclose(above[0].normal_ned, [0.0, 0.0, -1.0])
    assert room.touches((RADIUS + 0.49, 0.0, 1.0)) == []
    assert room.touches((0.0, 0.0, 2.0))[0].depth_m == pytest.approx(0.5)


def test_contact_only_pushes() -> None:
    room = surroundings(floor_m=1.5)
    place = (0.0, 0.0, 1.5 - HALF_HEIGHT + 0.001)
    assert room.force_ned_n(place, (0.0, 0.0, 0.0)) == pytest.approx((0.0, 0.0, -20.0))
    assert room.force_ned_n(place, (0.0, 0.0, -1.0)) == (0.0, 0.0, 0.0)


BOX = Prism(name="box", polygon_ned_m=((0.8, -0.3), (1.2, -0.3), (1.2, 0.3), (0.8, 0.3)))


def test_a_push_against_a_box_presses_the_hull_in_by_force_over_stiffness() -> None:
    hull = plant(TRIMMED, SimulatedWaters(floor_m=1.5, solids=(BOX,)), start_pos_ned_m=(0.2, 0.0, 0.7))
    hull.set_external_wrench(force_ned_n=(10.0, 0.0, 0.0))
    hull.advance(20_000_000, NEUTRAL)
    assert hull.truth.pos_ned_m[0] == pytest.approx(0.8 - RADIUS + 10.0 / CONTACT.stiffness_n_m, abs=1e-5)
    assert {record.what for record in hull.contacts} == {"box"}


@given(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0))
def test_a_box_is_as_far_away_as_its_nearest_side_and_pushes_out_the_shortest_way(x: float, y: float) -> None:
    dx, dy = abs(x - 1.0) - 0.2, abs(y) - 0.3
    distance = math.hypot(max(dx, 0.0), max(dy, 0.0)) if max(dx, dy) > 0.0 else max(dx, dy)
    touch = surroundings(solids=(BOX,)).touches((x, y, 0.7), math.inf)[0]
    assert -touch.depth_m == pytest.approx(distance - RADIUS, abs=1e-9)
    assert math.hypot(*touch.normal_ned) == pytest.approx(1.0)
    further = surroundings(solids=(BOX,)).touches(
        (x + 1e-3 * touch.normal_ned[0], y + 1e-3 * touch.normal_ned[1], 0.7), math.inf
    )[0]
    assert further.depth_m == pytest.approx(touch.depth_m - 1e-3, abs=1e-6)
