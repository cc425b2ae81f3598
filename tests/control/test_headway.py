"""Headway against a current that is nearly as fast as the vehicle may swim, with drag and thrust that are not those of
the vehicle file: closed loop of the controller, which knows the current and not the drag."""

import math
from dataclasses import replace

import numpy as np
import pytest
from control_loop import MODEL, VEHICLE, A, B, Flight, fly, goal, jet
from hypothesis import given, settings
from hypothesis import strategies as st

from autopilot.control.controller import MotionController
from autopilot.control.path import guidance
from autopilot.control.path.guidance import BEHIND_M, LOOKAHEAD_M, ReferenceLookahead
from autopilot.control.path.path_tuning import GUIDANCE
from autopilot.control.path.reference import Route
from autopilot.core.frames import FloatArray
from autopilot.core.geometry import Fence
from autopilot.core.messages import Goal
from autopilot.core.model4 import Model4
from autopilot.core.params import ParamSet

OPEN = Fence(depth_max_m=1.2)
CAP_M_S = 0.42
"""SPD_PLANAR_MAX less MPC_SPEED_MARGIN."""


def worse(drag: float, thrust: float) -> Model4:
    """The vehicle with so many times the drag and the thrust of its file."""
    return replace(
        MODEL,
        linear_drag=tuple(drag * each for each in MODEL.linear_drag),
        quadratic_drag=tuple(drag * each for each in MODEL.quadratic_drag),
        allocation=tuple(tuple(thrust * each for each in row) for row in MODEL.allocation),
    )


def upstream(
    model: Model4, current: FloatArray, away_m: float, to: Goal, cost: int, limit_s: float, noise: float = 0.005
) -> Flight:
    """From a place downstream of the goal, at the speed that holds it there."""
    along, yaw = current / np.hypot(*current[:2]), to.yaw_rad
    heading = math.atan2(-current[1], -current[0]) if yaw is None else yaw
    c, s = math.cos(heading), math.sin(heading)
    water = -c * current[0] - s * current[1], s * current[0] - c * current[1]
    start = [*(to.pos_ned_m + away_m * along), heading, *water, 0.0, 0.0]
    controller, params = MotionController(VEHICLE, cpu_clock=lambda: 0.0), ParamSet({"MPC_COST": cost})
    return fly(
        controller,
        [to],
        start,
        fence=OPEN,
        params=params,
        current=lambda _: current,
        model=model,
        limit_s=limit_s,
        noise=noise,
    )


@pytest.mark.parametrize("seed", range(8))
def test_a_vehicle_that_has_speed_and_thrust_left_does_not_hover_against_a_current(seed: int) -> None:
    rng = np.random.default_rng(seed)
    drag, thrust, speed = rng.uniform(1.15, 1.3), rng.uniform(0.9, 1.0), CAP_M_S * rng.uniform(0.8, 0.9)
    to, cost = float(rng.uniform(-3.1, 3.1)), seed % 2
    current = speed * np.array([math.cos(to), math.sin(to), 0.0])
    # The bow against the current or with it, as at the paper's waypoint A, give or take; or as the way goes.
    facing = (None, to + rng.uniform(-0.3, 0.3), to + math.pi + rng.uniform(-0.3, 0.3))[seed % 3]
    place = goal(1.0, -2.0, 0.6, None if facing is None else math.remainder(facing, 2.0 * math.pi))
    ideal_s = 0.45 / (CAP_M_S - speed)
    flight = upstream(worse(drag, thrust), current, 0.75, place, cost, limit_s=4.0 * ideal_s + 15.0)
    assert flight.reached_s, f"drag {drag:.2f}, thrust {thrust:.2f}, current {speed:.3f}: {flight.x[-1, :2]}"
    assert flight.planar_speed_m_s() < 0.5 and np.abs(flight.thrust_n).max() <= 12.0


@pytest.mark.parametrize("cost", [0, 1])
def test_the_paper_tank_against_its_jet_with_the_drag_that_hovered(cost: int) -> None:
    """Campaign r3, seed 11, run 3: 0.45 m before waypoint A, astern, drag 1.28, thrust 0.92."""
    current = 0.385 * np.array([math.cos(0.12), math.sin(0.12), 0.0])
    flight = upstream(worse(1.28, 0.92), current, 0.47, A, cost, limit_s=50.0, noise=0.01)
    assert flight.reached_s


@pytest.mark.parametrize(("to", "start"), [(B, [*A.pos_ned_m, 0.0]), (A, [*B.pos_ned_m, math.pi])], ids=["B", "A"])
def test_a_vehicle_that_goes_as_it_should_is_not_hurried(
    to: Goal, start: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Starts, turns on the spot, the paper's jet, arrivals, holding: bit for bit as if there were no lead."""
    flights = []
    for most_m in (guidance.LOOKAHEAD_M, 0.0):
        monkeypatch.setattr(guidance, "LOOKAHEAD_M", most_m)
        controller, params = MotionController(VEHICLE, cpu_clock=lambda: 0.0), ParamSet({"MPC_COST": 0})
        state = [*start, 0.0, 0.0, 0.0, 0.0]
        flights.append(fly(controller, [to], state, params=params, current=jet, noise=0.01, limit_s=22.0, hold=True))
    assert np.array_equal(flights[0].x, flights[1].x)


@given(st.lists(st.tuples(st.floats(-0.3, 0.3), st.floats(0.0, 0.5)), min_size=1, max_size=200))
@settings(max_examples=40, deadline=None)
def test_the_lead_is_bounded_and_gone_once_the_vehicle_has_made_it_good(steps: list[tuple[float, float]]) -> None:
    route, lead, s_m, t_us = Route(np.array([[0.0, 0.0], [100.0, 0.0]])), ReferenceLookahead(), 40.0, 0
    for speed, asked in steps:
        lead.set_reference(np.zeros(3), np.array([asked * 0.1, 0.0, 0.0]), 0.1)
        s_m, t_us = s_m + 0.05 * speed, t_us + 50_000
        lead.update(t_us, route, s_m)
        assert 0.0 <= lead.m <= LOOKAHEAD_M + 1e-12
    lead.update(t_us + 50_000, route, s_m + BEHIND_M + LOOKAHEAD_M + 0.05 * GUIDANCE.least_progress_m_s)
    assert lead.m == 0.0
    other = Route(np.array([[0.0, 0.0], [50.0, 0.0]]))
    lead.update(t_us + 100_000, other, 0.0)
    assert lead.m == 0.0, "another route is no step back"
