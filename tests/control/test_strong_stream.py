"""Streams about as fast as the vehicle can go: what is given up, in which order, and flights in them."""

import math

import numpy as np
import pytest
from control_loop import MODEL, VEHICLE, goal, nav_state

from autopilot.control.path.path_tuning import STRONG_STREAM
from autopilot.control.path.planner import Planner
from autopilot.control.path.strong_stream import StrongStream
from autopilot.core.control_allocator import ControlAllocator
from autopilot.core.geometry import Circle, Fence
from autopilot.core.messages import Goal
from autopilot.core.params import ParamSet
from tests.bench.streams import draw, fly_stream

PARAMS, LIMIT_N = ParamSet(), np.full(MODEL.thrusters, 12.0)
OPEN = Fence(depth_max_m=1.2)


def stream() -> StrongStream:
    return StrongStream(ControlAllocator.of(VEHICLE), VEHICLE.radius_m)


def updated(strong: StrongStream, speed_m_s: float, to: Goal, fence: Fence = OPEN, steps: int = 100) -> StrongStream:
    """After 5 s at the origin in a stream to the south."""
    for step in range(steps):
        nav = nav_state(50_000 * step, np.zeros(8), np.array([-speed_m_s, 0.0, 0.0]))
        strong.update(nav, np.zeros(8), to, Planner(fence, 0.33), PARAMS, LIMIT_N)
    return strong


def test_in_a_weak_stream_nothing_is_given_up() -> None:
    weak = updated(stream(), 0.3, goal(3.0, 0.0, 0.0, math.pi / 2))
    assert not weak.active and weak.bow_rad is None and weak.cap_m_s == 0.0 and not weak.shortfall


def test_a_strong_stream_ends_below_where_it_begins() -> None:
    strong = updated(stream(), 0.35, goal(3.0, 0.0, 0.0, None))
    assert strong.active
    assert updated(strong, 0.31, goal(3.0, 0.0, 0.0, None)).active
    assert not updated(strong, 0.28, goal(3.0, 0.0, 0.0, None)).active


@pytest.mark.parametrize(
    ("yaw", "given_up"), [(math.pi / 2, True), (-1.5, True), (0.2, False), (math.pi, False), (None, True)]
)
def test_the_bow_replaces_a_heading_that_takes_too_much_thrust(yaw: float | None, given_up: bool) -> None:
    bow = updated(stream(), 0.39, goal(3.0, 0.0, 0.0, yaw)).bow_rad
    assert (bow is not None) == given_up
    assert bow is None or bow == pytest.approx(0.0)


def test_the_margin_of_the_speed_makes_way_for_headway_up_to_the_limit() -> None:
    most = STRONG_STREAM.limit_fraction * PARAMS["SPD_PLANAR_MAX"]
    for speed in (0.35, 0.38, 0.45, 0.55):
        cap = updated(stream(), speed, goal(3.0, 0.0, 0.0, None)).cap_m_s
        assert cap == pytest.approx(min(speed + STRONG_STREAM.headway_m_s, most), abs=1e-3)


def test_beyond_the_limit_only_where_a_boundary_is_near() -> None:
    pillar = Circle(center_ned_m=np.array([-0.8, 0.0]), radius_m=0.16)
    near = Fence(exclusions=(pillar,), depth_max_m=1.2)
    assert updated(stream(), 0.55, goal(3.0, 0.0, 0.0, None), near).cap_m_s > 0.55


@pytest.mark.parametrize(
    ("speed", "to", "text"),
    [
        (0.39, goal(3.0, 0.0, 0.0, None), ""),
        (0.39, goal(3.0, 0.0, 0.0, math.pi / 2), "heading needs 89 % of the thrust"),
        (0.49, goal(3.0, 0.0, 0.0, None), "needs 0.03 m/s more"),
        (0.49, goal(0.0, 3.0, 0.0, None), "needs 0.02 m/s more"),
        (0.49, goal(-3.0, 0.0, 0.0, None), ""),
        (0.49, goal(0.1, 0.0, 0.0, None), "needs 0.02 m/s more"),
    ],
)
def test_what_is_missing_is_said(speed: float, to: Goal, text: str) -> None:
    assert updated(stream(), speed, to).shortfall == text


@pytest.mark.parametrize("seed", [4, *(pytest.param(seed, marks=pytest.mark.long) for seed in (6, 9, 23, 191))])
def test_flights_in_such_streams_touch_nothing_stay_smooth_and_end(seed: int) -> None:
    """Draws of the bench: a pillar in the lee, and a wall where there is thrust enough. In 191 a new route led to the
    other side of the pillar, where there was no coming to."""
    flight = fly_stream(draw(seed), 30.0)
    assert not flight.problem
    assert min(flight.reached_s, flight.given_up_s) < 30.0
