"""The line-of-sight PID controller: legs in cross-currents, walls ahead, thrusters at their limits."""

import itertools
import math
from dataclasses import replace
from typing import cast

import numpy as np
from control_loop import MODEL, TANK, VEHICLE, A, B, fly, goal, jet, nav_state

from autopilot.control.controller import MotionController
from autopilot.control.current.currents import EstimatedCurrent
from autopilot.control.los_pid import TUNING, LosPid
from autopilot.control.path.workers import BackgroundWorkers
from autopilot.control.protocol import ControllerContext
from autopilot.core.geometry import Fence
from autopilot.core.messages import ControlOutput, Goal, NavState, VelocityGoal
from autopilot.core.params import ParamSet

LIMIT_N = np.full(MODEL.thrusters, 12.0)
OPEN = Fence(depth_max_m=50.0)
GUST_CALLS = 10 * 20 * 21
"""10 s of the closed loop: 20 steps a second, one current estimate and five RK4 steps each."""


class _Flown(LosPid):
    """As the closed loop of this folder calls a controller."""

    def __init__(self) -> None:
        super().__init__(
            ControllerContext(vehicle=VEHICLE, model=MODEL, currents=EstimatedCurrent(), desks=BackgroundWorkers())
        )

    def step(  # type: ignore[override]
        self, t_us: int, nav: NavState, goal: Goal, fence: Fence, params: ParamSet
    ) -> ControlOutput:
        return super().step(t_us, nav, goal, fence, params, LIMIT_N, (), delay_s=0.0)


def flown() -> MotionController:
    return cast(MotionController, _Flown())


def test_two_legs_of_the_tank_in_its_jet_without_touching() -> None:
    flight = fly(flown(), [B, A], [*A.pos_ned_m, 0.0, 0.0, 0.0, 0.0, 0.0], current=lambda p: np.append(jet(p)[:2], 0.0))
    assert len(flight.reached_s) == 2
    assert flight.pillar_distance_m() > 0.16 + VEHICLE.radius_m
    assert flight.wall_distance_m() > VEHICLE.radius_m
    assert flight.planar_speed_m_s() < 0.52, "as the log check allows"
    assert np.abs(flight.thrust_n).max() <= LIMIT_N[0]


def test_a_leg_across_a_current_with_more_drag_than_believed_stays_on_its_line() -> None:
    d1, d2, d3, d4 = MODEL.quadratic_drag
    heavy = replace(MODEL, quadratic_drag=(1.3 * d1, 1.3 * d2, d3, d4))
    flight = fly(
        flown(),
        [goal(8.0, 0.0, 5.0, None)],
        [0.0, 0.0, 5.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        fence=OPEN,
        current=lambda _: np.array([0.0, 0.15, 0.0]),
        model=heavy,
    )
    assert flight.reached_s
    underway = flight.x[flight.x[:, 0] > 3.0]
    assert np.abs(underway[:, 1]).max() < 0.1
    # The bow points upstream of the way, along the motion through the water.
    assert abs(float(underway[-1, 3]) + math.atan2(0.15, 0.35)) < 0.15


def test_a_velocity_towards_a_wall_ends_before_it() -> None:
    towards = replace(goal(0.0, 1.0, 0.45, 0.0), drive=VelocityGoal(east_m_s=0.3))
    flight = fly(flown(), [towards], [0.0, -0.4, 0.45, 0.0, 0.0, 0.0, 0.0, 0.0], limit_s=15.0, hold=True)
    assert flight.x[200, 5] > 0.15
    assert VEHICLE.radius_m < flight.wall_distance_m() < VEHICLE.radius_m + 0.2


def test_integrators_do_not_wind_up_in_a_current_that_is_too_fast() -> None:
    controller, place, calls = _Flown(), goal(0.0, 0.0, 5.0, 0.0), itertools.count()
    flight = fly(
        cast(MotionController, controller),
        [place],
        [0.0, 0.0, 5.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        fence=OPEN,
        current=lambda _: np.array([-0.7 if next(calls) < GUST_CALLS else 0.0, 0.0, 0.0]),
        limit_s=60.0,
        hold=True,
    )
    assert flight.x[:, 0].min() < -1.0, "it was carried off"
    assert np.abs(controller._integral).max() <= TUNING.integral_limit_m_s2
    assert flight.x[:, 0].max() < 0.1, "no overshoot on the way back"
    assert abs(flight.x[-1, 0]) < 0.1


def test_nothing_is_driven_without_an_estimate_or_a_thruster_that_answers() -> None:
    controller = LosPid(
        ControllerContext(vehicle=VEHICLE, model=MODEL, currents=EstimatedCurrent(), desks=BackgroundWorkers())
    )
    nav, params = nav_state(0, np.array([*A.pos_ned_m, 0.0, 0.0, 0.0, 0.0, 0.0])), ParamSet()
    lost = replace(nav, pos_ned_m=np.full(3, math.nan))
    for seen, delay_s in ((lost, 0.0), (nav, None)):
        assert not controller.step(0, seen, B, TANK, params, LIMIT_N, (), delay_s=delay_s).thrust_n.any()
    assert controller.step(0, nav, B, TANK, params, LIMIT_N, (), delay_s=1.0).thrust_n.any()
