"""Which speed a leg of least energy is flown at: bounded by the cruise speed, the one asked for where one is."""

import math
from dataclasses import replace

import numpy as np
import pytest

from autopilot.control.controller import MotionController
from autopilot.control.energy.power import PowerModel, planar_limit_m_s, speed_table
from autopilot.core.frames import FloatArray
from autopilot.core.geometry import Fence
from autopilot.core.messages import Goal
from autopilot.core.params import ParamSet
from tests.control.control_loop import MODEL, VEHICLE, Flight, fly, goal

OPEN = Fence(inclusions=(), exclusions=(), depth_min_m=0.0, depth_max_m=20.0)
AHEAD = goal(9.0, 0.0, 0.5, None)
START = [0.0, 0.0, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0]


def flown(to: Goal, current_m_s: tuple[float, float] = (0.0, 0.0)) -> Flight:
    current = np.array([*current_m_s, 0.0])
    start = [*START[:4], -current_m_s[0], -current_m_s[1], 0.0, 0.0]
    flight = fly(
        MotionController(VEHICLE),
        [to],
        start,
        fence=OPEN,
        params=ParamSet({"MPC_COST": 1}),
        current=lambda _: current,
        limit_s=150.0,
    )
    assert flight.reached_s
    return flight


def under_way(flight: Flight) -> FloatArray:
    """States between 15 and 60 % of the flight: neither setting out nor arriving."""
    return flight.x[int(0.15 * len(flight.x)) : int(0.6 * len(flight.x))]


def test_an_asked_speed_is_flown() -> None:
    way = under_way(flown(replace(AHEAD, speed_m_s=0.12, speed_asked=True)))
    ground_m_s = (way[-1, 0] - way[0, 0]) / (0.01 * (len(way) - 1))
    assert ground_m_s == pytest.approx(0.12, abs=0.01)


@pytest.mark.parametrize("north_m_s", [0.0, -0.12, 0.15])
def test_the_cruise_speed_bounds_what_the_vehicle_makes(north_m_s: float) -> None:
    way = under_way(flown(replace(AHEAD, speed_m_s=0.18), (north_m_s, 0.0)))
    water_m_s = np.hypot(way[:, 4], way[:, 5])
    bound = 0.18 + max(0.0, -north_m_s)
    assert float(water_m_s.max()) < bound + 0.03
    assert float(water_m_s.mean()) > 0.85 * bound


def test_the_bound_is_over_ground_against_a_current_and_in_the_water_with_one() -> None:
    table = speed_table(MODEL, PowerModel.of(VEHICLE), 0.5, 0.3)
    along, across = np.array([0.0, -0.1, 0.2, 0.0]), np.array([0.0, 0.0, 0.0, 0.4])
    assert planar_limit_m_s(table, along, across) == pytest.approx([0.3, 0.4, 0.3, 0.5])
    assert math.isinf(planar_limit_m_s(speed_table(MODEL, PowerModel.of(VEHICLE), 0.5), along, across)[0])
