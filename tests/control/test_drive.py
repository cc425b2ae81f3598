"""Motions instead of places, in the paper's tank: a pilot who steers at walls and pillars, circles, random sticks."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest
from control_loop import MODEL, TANK, Flight, goal, jet, nav_state, rk4, still

from autopilot.control.controller import MotionController
from autopilot.core.frames import FloatArray
from autopilot.core.messages import Fallback, Goal, VelocityGoal
from autopilot.core.params import ParamSet
from autopilot.core.vehicle import load_vehicle

BODY_M = 0.3
"""The vehicle's ball: touching is a distance of its centre below this."""

Pilot = Callable[[float, FloatArray], Goal]


def driving(
    north: float,
    east: float,
    *,
    turn_rad_s: float = 0.0,
    down_m_s: float | None = None,
    yaw_rate_rad_s: float | None = None,
) -> Goal:
    wish = VelocityGoal(
        north_m_s=north, east_m_s=east, turn_rad_s=turn_rad_s, down_m_s=down_m_s, yaw_rate_rad_s=yaw_rate_rad_s
    )
    return replace(goal(0.0, 0.0, 0.5, 0.0, speed_m_s=0.5, seq=-1), drive=wish)


def drive(
    pilot: Pilot,
    start: Sequence[float],
    seconds: float,
    *,
    current: Callable[[FloatArray], FloatArray] = still,
    params: ParamSet | None = None,
) -> Flight:
    """The controller on its own model, thrusters with their lag; the pilot says a goal every control step."""
    controller, params = MotionController(load_vehicle("lbv150")), params or ParamSet()
    x, acting, believed = np.array(start, dtype=float), np.zeros(4), np.zeros(3)
    states, thrusts, outputs = [], [], []
    for step in range(round(20 * seconds)):
        t_us = step * 50_000
        truth = current(x[:2])
        believed = believed + (truth - believed) * 0.05
        seen, (c, s), error = x.copy(), (math.cos(x[3]), math.sin(x[3])), truth - believed
        seen[4:6] += c * error[0] + s * error[1], c * error[1] - s * error[0]
        output = controller.step(t_us, nav_state(t_us, seen, believed.copy()), pilot(t_us * 1e-6, x), TANK, params)
        outputs.append(output)
        thrusts.append(output.thrust_n)
        for _ in range(5):
            acting = acting + (output.thrust_n - acting) * (1.0 - math.exp(-0.01 / 0.15))
            x = rk4(MODEL, x, acting, current, 0.01)
            states.append(x)
    return Flight(x=np.array(states), thrust_n=np.array(thrusts), outputs=outputs, reached_s=[])


def keeps_clear(flight: Flight) -> None:
    assert flight.wall_distance_m() > BODY_M
    assert flight.pillar_distance_m() - 0.16 > BODY_M
    assert float(np.abs(np.diff(flight.thrust_n, axis=0)).max()) <= 3.0
    assert not any(out.status.fallback is not Fallback.NONE for out in flight.outputs)


@pytest.mark.parametrize(
    ("start", "velocity"),
    [((0.0, 0.8, 0.5, 0.0), (0.5, 0.0)), ((0.0, 0.0, 0.5, 1.0), (0.0, 0.5)), ((-0.2, 0.0, 0.5, 0.0), (0.5, 0.0))],
    ids=["north wall", "east wall", "pillar"],
)
def test_a_pilot_who_steers_straight_at_a_boundary_is_stopped_before_it(
    start: tuple[float, ...], velocity: tuple[float, float]
) -> None:
    flight = drive(lambda t, x: driving(*velocity), (*start, 0.0, 0.0, 0.0, 0.0), 12.0)
    keeps_clear(flight)
    assert flight.planar_speed_m_s() > 0.25
    assert float(np.hypot(*flight.x[-100:, 4:6].T).max()) < 0.02
    near = min(flight.wall_distance_m(), flight.pillar_distance_m() - 0.16)
    assert near < BODY_M + 0.15, "it is slowed down at the boundary, not kept far away"


def test_along_a_wall_that_is_met_at_an_angle_the_vehicle_goes_on() -> None:
    flight = drive(lambda t, x: driving(0.25, 0.35), (-1.5, 0.6, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0), 14.0)
    keeps_clear(flight)
    assert flight.x[-1, 0] > 0.0


@pytest.mark.parametrize("seed", range(3))
def test_random_sticks_in_a_jet_touch_nothing(seed: int) -> None:
    rng = np.random.default_rng(seed)
    wishes = [
        driving(*rng.uniform(-0.5, 0.5, 2), down_m_s=rng.uniform(-0.3, 0.3), yaw_rate_rad_s=rng.uniform(-1.0, 1.0))
        for _ in range(12)
    ]
    flight = drive(lambda t, x: wishes[int(t / 1.5)], (-1.6, -0.3, 0.5, 0, 0, 0, 0, 0), 18.0, current=jet)
    keeps_clear(flight)
    assert flight.x[:, 2].min() > -0.01 and flight.x[:, 2].max() < 1.25
    assert float(np.abs(flight.x[:, 7]).max()) < 1.1


def test_released_sticks_hold_the_place_and_rates_are_flown_as_asked() -> None:
    def pilot(t: float, x: FloatArray) -> Goal:
        return driving(0.0, 0.0, down_m_s=0.1, yaw_rate_rad_s=0.4) if t < 6.0 else driving(0.0, 0.0)

    flight = drive(pilot, (0.05, 0.05, 0.3, 0.0, 0.0, 0.0, 0.0, 0.0), 14.0)
    assert flight.x[590, 3] == pytest.approx(0.4 * 6.0, rel=0.15)
    assert flight.x[590, 2] - 0.3 == pytest.approx(0.6, rel=0.2)
    assert float(np.abs(flight.x[-1, :3] - (0.0, 0.0, 0.5)).max()) < 0.03


@pytest.mark.parametrize("north", [0.0, 0.03, 0.2])
def test_depth_changes_as_fast_as_asked_however_fast_the_other_stick_goes(north: float) -> None:
    """With a drift of 0.03 m/s it changed at half of that: it was to arrive with the way ahead, near the end of the
    depth band ever more slowly."""
    flight = drive(lambda _, __: driving(north, 0.0, down_m_s=-0.12), (-1.9, 0.6, 0.6, 0.0, 0.0, 0.0, 0.0, 0.0), 3.5)
    assert 0.6 - flight.x[-1, 2] > 0.3
    assert flight.x[:, 2].min() > ParamSet()["DEPTH_MIN"]


def test_an_arc_is_flown_as_an_arc() -> None:
    """The velocity's direction turns along the prediction: a circle is not cut."""
    radius, speed = 0.6, 0.2
    centre = np.array([-1.6, 0.6])

    def pilot(t: float, x: FloatArray) -> Goal:
        away = x[:2] - centre
        angle = math.atan2(away[1], away[0])
        pull = 0.6 * (radius - math.hypot(*away))
        north = -speed * math.sin(angle) + pull * math.cos(angle)
        east = speed * math.cos(angle) + pull * math.sin(angle)
        return driving(north, east, turn_rad_s=speed / radius)

    flight = drive(pilot, (-1.0, 0.6, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0), 25.0)
    off = np.hypot(*(flight.x[500:, :2] - centre).T) - radius
    assert float(np.abs(off).max()) < 0.06
    assert float(np.diff(np.unwrap(np.arctan2(*(flight.x[::10, :2] - centre).T[::-1]))).sum()) > 6.0
