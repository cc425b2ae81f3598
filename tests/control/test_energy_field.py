"""Energy per metre, energy-to-go and the ways that it offers."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from autopilot.control.constraints.obstacles import Features
from autopilot.control.current.currents import EstimatedCurrent
from autopilot.control.energy.field import LONGEST_MOVE, EnergyField, alternative_paths
from autopilot.control.energy.flow import FlowField, FlowSamples, area_of, sample_flow
from autopilot.control.energy.power import PowerModel, energy_per_metre, speed_table
from autopilot.core.free_space import Area, FreeSpace
from autopilot.core.geometry import Circle, Fence, Polygon
from autopilot.core.model4 import steady_force
from tests.control.control_loop import MODEL, TANK, VEHICLE, nav_state

POWER = PowerModel.of(VEHICLE)
TABLE = speed_table(MODEL, POWER, 0.5, 200)
OPEN = Fence()


def uniform(north: float, east: float) -> FlowField:
    values = np.zeros((5, 5, 3))
    values[..., 0], values[..., 1] = north, east
    axis = np.linspace(-50.0, 50.0, 5)
    return FlowField(FlowSamples(north_m=axis, east_m=axis, current_ned_m_s=values))


@given(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3))
@settings(max_examples=40, deadline=None)
def test_energy_per_metre_is_the_least_over_all_speeds(along: float, across: float) -> None:
    speed = np.linspace(0.0, 0.5, 2001)
    drag = 0.5 * (MODEL.linear_drag[0] + MODEL.quadratic_drag[0] * speed) * speed
    watt = 12.0 + 1.2 * (2.0 * drag**1.5 + 0.6**1.5)
    room = speed**2 - across**2
    headway = np.sqrt(np.maximum(room, 0.0)) + along
    usable = (room >= 0.0) & (headway > 0.02)
    least = (watt[usable] / headway[usable]).min() if usable.any() else math.inf
    found = float(energy_per_metre(TABLE, np.array([along]), np.array([across]))[0])
    if least < 1000.0:
        assert found == pytest.approx(least, rel=0.01)


def test_what_holds_the_depth_costs_what_the_side_that_it_pushes_to_costs() -> None:
    dear = replace(POWER, reverse_w_n15=tuple(3.0 * c for c in POWER.thrust_w_n15))
    table = speed_table(MODEL, dear, 0.6, count=3)
    for speed, power_w in zip(table.speed_m_s, table.power_w, strict=True):
        thrust = np.linalg.solve(MODEL.allocation, np.array(steady_force(MODEL, (speed, 0.0, 0.0, 0.0), np)))
        watt = dear.thrust_w(thrust)[np.abs(thrust) > 1e-6]
        assert power_w == pytest.approx(12.0 + watt.sum(), rel=1e-3)


@pytest.mark.parametrize(("north", "east"), [(0.0, 0.0), (0.15, 0.0), (-0.15, 0.0), (0.0, 0.15), (0.1, 0.2)])
def test_open_water_costs_what_the_closed_form_says(north: float, east: float) -> None:
    goal = np.array([40.0, 0.0])
    area = area_of(OPEN, np.stack([np.zeros(2), goal]))
    way = (
        EnergyField(FreeSpace(Features(OPEN), area, 0.3, long_moves=LONGEST_MOVE), uniform(north, east), TABLE)
        .to(goal)
        .path(np.zeros(2))
    )
    expected = 40.0 * float(energy_per_metre(TABLE, np.array([north]), np.array([east]))[0])
    assert way is not None
    assert way.energy_j == pytest.approx(expected, rel=0.02)


def test_a_current_faster_than_the_vehicle_leaves_no_way_up_it() -> None:
    area = Area(low_m=np.array([-5.0, -5.0]), high_m=np.array([45.0, 5.0]))
    field = EnergyField(FreeSpace(Features(OPEN), area, 0.3, long_moves=LONGEST_MOVE), uniform(-0.6, 0.0), TABLE)
    up, down = field.to(np.array([40.0, 0.0])), field.to(np.array([0.0, 0.0]))
    assert up is not None
    assert up.path(np.zeros(2)) is None
    assert down is not None
    assert down.path(np.array([40.0, 0.0])) is not None


def test_ways_keep_clear_and_offer_the_other_side() -> None:
    features, goal = Features(TANK), np.array([1.75, 0.0])
    field = EnergyField(
        FreeSpace(features, area_of(TANK, goal[None]), 0.32, long_moves=LONGEST_MOVE), uniform(0.0, 0.0), TABLE
    )
    to_go = field.to(goal)
    best = to_go.path(np.array([-1.6, -0.35]))
    others = alternative_paths(field, to_go, best, features, 2)
    for way in (best, *others):
        share = np.linspace(0.0, 1.0, 9)[:, None, None]
        dense = (way.points_ned_m[:-1] + share * np.diff(way.points_ned_m, axis=0)).reshape(-1, 2)
        inner = np.hypot(*(dense - goal).T) > 0.3
        assert features.clearance_m(dense[inner]).min() >= 0.32 - 2.1e-3
    assert {np.sign(w.points_ned_m[np.abs(w.points_ned_m[:, 0] - 0.94).argmin(), 1]) for w in (best, *others)} == {
        -1,
        1,
    }
    assert all(way.energy_j >= best.energy_j for way in others)


def test_a_closed_room_has_no_way_and_no_exception() -> None:
    wall = Polygon(vertices_ned_m=np.array([[0.0, -2.0], [0.1, -2.0], [0.1, 2.0], [0.0, 2.0]]))
    fence = Fence(inclusions=TANK.inclusions, exclusions=(wall,))
    goal = np.array([1.75, 0.0])
    to_go = EnergyField(
        FreeSpace(Features(fence), area_of(fence, goal[None]), 0.3, long_moves=LONGEST_MOVE), uniform(0.0, 0.0), TABLE
    ).to(goal)
    assert to_go is not None
    assert to_go.path(np.array([-1.6, 0.0])) is None
    tiny = Fence(inclusions=(Circle(center_ned_m=np.zeros(2), radius_m=0.2),))
    assert (
        EnergyField(
            FreeSpace(Features(tiny), area_of(tiny, goal[None]), 0.3, long_moves=LONGEST_MOVE), uniform(0.0, 0.0), TABLE
        ).to(goal)
        is None
    )


def test_the_slope_points_away_from_the_goal() -> None:
    goal = np.array([10.0, 0.0])
    area = Area(low_m=np.array([-2.0, -6.0]), high_m=np.array([12.0, 6.0]))
    to_go = EnergyField(FreeSpace(Features(OPEN), area, 0.3, long_moves=LONGEST_MOVE), uniform(0.0, 0.0), TABLE).to(
        goal
    )
    slope = to_go.slope(np.zeros(2), 0.5)
    assert slope[0] == pytest.approx(-float(energy_per_metre(TABLE, np.zeros(1), np.zeros(1))[0]), rel=0.05)
    assert abs(slope[1]) < 0.05 * abs(slope[0])


def test_samples_of_the_forecast_give_it_back() -> None:
    nav = nav_state(0, np.zeros(8), np.array([0.1, -0.05, 0.01]))
    flow = FlowField(sample_flow(EstimatedCurrent(), nav, area_of(TANK, np.zeros((1, 2))), 0.5))
    assert flow.uniform
    assert np.allclose(flow.current(np.array([[0.3, 0.2]])), [[0.1, -0.05, 0.01]])
    assert np.allclose(flow.gradient(np.array([[0.3, 0.2]])), 0.0)


def test_between_samples_a_jet_is_smooth() -> None:
    north, east = np.linspace(-2.5, 2.5, 51), np.linspace(-1.5, 1.5, 31)
    values = np.zeros((51, 31, 3))
    values[..., 0] = 0.25 * np.cos(east)[None, :] ** 2 + 0.05 * np.sin(north)[:, None]
    flow = FlowField(FlowSamples(north_m=north, east_m=east, current_ned_m_s=values))
    places = np.random.default_rng(1).uniform([-2.0, -1.0], [2.0, 1.0], (50, 2))
    assert np.allclose(
        flow.current(places)[:, 0], 0.25 * np.cos(places[:, 1]) ** 2 + 0.05 * np.sin(places[:, 0]), atol=1e-5
    )
    assert np.allclose(flow.gradient(places)[:, 1], -0.25 * np.sin(2.0 * places[:, 1]), atol=1e-3)
