"""Commands in closed loop with a noisy estimate: no alternation, no steps, no trembling."""

import math
from dataclasses import replace

import numpy as np
import pytest
from control_loop import TANK, VEHICLE, A, B, Flight, fly, goal, jet, nav_state, still

from autopilot.control.controller import MotionController
from autopilot.control.nmpc.reversal import Reversals
from autopilot.core.params import ParamSet
from autopilot.core.vehicle import load_vehicle
from autopilot.log.smoothness import BARS, Smoothness, ThrustCommands, measure

STEP_S = 0.05


def smoothness(flight: Flight) -> Smoothness:
    """Figures as ``autopilot log check`` takes them."""
    t_s = STEP_S * np.arange(len(flight.thrust_n))
    found = measure(
        ThrustCommands(
            t_s=t_s,
            thrust_n=flight.thrust_n,
            fallback=np.array([output.status.fallback for output in flight.outputs], dtype=np.uint8),
            starts_s=np.array([0.0, *flight.reached_s]),
            reported_s=np.zeros(0),
            limit_n=12.0,
        )
    )
    assert found is not None
    return found


@pytest.mark.parametrize(
    ("current", "planar_max_m_s", "seed"), [(jet, 0.5, 2), (still, 0.44, 1)], ids=["jet", "still, near the speed limit"]
)
def test_commands_are_smooth_although_the_estimate_is_not(current, planar_max_m_s: float, seed: int) -> None:
    """3 mm/s and 1.5 mm of white noise; with the whole step of the iteration commands jump by 9 N."""
    controller = MotionController(VEHICLE, cpu_clock=lambda: 0.0)
    flight = fly(
        controller,
        [B, A],
        [-1.6, -0.35, 0.45, 0, 0, 0, 0, 0],
        current=current,
        noise=0.003,
        limit_s=40.0,
        seed=seed,
        params=ParamSet({"MPC_COST": 0, "SPD_PLANAR_MAX": planar_max_m_s}),
    )
    found = smoothness(flight)
    assert len(flight.reached_s) == 2
    # Two turns and two stops within 20 s have their reversals: the bar for those is one of whole missions.
    assert set(BARS.broken(found)) <= {"reversals_1_s"}, found
    assert found.reversals_1_s < 0.5


@pytest.mark.parametrize(
    ("current", "seed"), [pytest.param(jet, 1, marks=pytest.mark.long), (still, 2)], ids=["jet", "still"]
)
def test_commands_along_trajectories_of_least_energy_are_smooth_from_the_first_leg_on(current, seed: int) -> None:
    """Estimates as above and a first leg of 4 s. Every end is entered from its trajectory: what is missed by
    centimetres is a brake, a turn and a start."""
    controller = MotionController(VEHICLE, cpu_clock=lambda: 0.0)
    goals = [replace(first, following=then) for first, then in ((A, B), (B, A), (A, B))]
    flight = fly(
        controller,
        goals,
        [-1.9, 0.6, 0.4, 0.5, 0, 0, 0, 0],
        current=current,
        noise=0.003,
        limit_s=45.0,
        seed=seed,
        params=ParamSet({"MPC_COST": 1}),
    )
    found = smoothness(flight)
    assert len(flight.reached_s) == 3
    # Three turns within a quarter of a minute: the bar for reversals is one of whole missions.
    assert set(BARS.broken(found)) <= {"reversals_1_s"}, found
    assert found.reversals_1_s < 0.5
    plans_s = [STEP_S * step for step, output in enumerate(flight.outputs) if output.plan is not None]
    assert plans_s[0] < 1.0, "the first leg has a plan although it is short: the water stands still where it begins"
    for reached_s, (before, _) in zip(flight.reached_s, ((A, B), (B, A), (A, B)), strict=True):
        x = flight.x[round(reached_s * 100.0) - 1]
        assert math.hypot(*(x[:2] - before.pos_ned_m[:2])) > 0.2, "entered, not visited"


def test_a_thruster_is_not_turned_round_for_what_noise_asks_for() -> None:
    """Holding a place, where every thruster but the vertical one is asked for nothing in the mean."""
    controller = MotionController(VEHICLE, cpu_clock=lambda: 0.0)
    here = [-1.6, -0.35, 0.45, 0, 0, 0, 0, 0]
    hold = goal(-1.6, -0.35, 0.45, 0.0)
    flight = fly(controller, [hold], here, noise=0.003, limit_s=15.0, seed=3, hold=True)
    assert smoothness(flight).reversals_1_s <= BARS.reversals_1_s
    assert math.hypot(*(flight.x[-1, :2] - here[:2])) < 0.03


def test_one_tick_of_noise_between_steps_turns_no_thruster_round() -> None:
    """The feedback of the inner loop has the noise of every tick: what it turned round stayed so."""
    reversals = Reversals(np.array([12.0, 12.0]))
    assert reversals.worth(np.array([1.0, 1.0])).tolist() == [1.0, 1.0]
    assert reversals.worth(np.array([-0.5, -2.0]), between=True).tolist() == [0.0, -2.0]
    assert reversals.worth(np.array([0.1, 0.1])).tolist() == [0.1, 0.0], "the first has not been turned"
    assert reversals.worth(np.array([-0.5, 0.5])).tolist() == [-0.5, 0.5], "a control step decides"


@pytest.mark.parametrize("vehicle", ["lbv150", "bluerov2"])
def test_a_reference_that_jumps_does_not_tear_at_the_thrusters(vehicle: str) -> None:
    """Goals to and fro while under way: each is a new route and a burst, and would be a step of 10 N and more. What a
    step may be depends on the limit in force (12 N for both), not on what the thrusters could do."""
    controller, params = MotionController(load_vehicle(vehicle), cpu_clock=lambda: 0.0), ParamSet({"THR_LIMIT": 12.0})
    x, thrust = np.array([-1.6, -0.35, 0.45, 0, 0.2, 0, 0, 0.0]), []
    for step in range(40):
        target = (B, A)[step // 10 % 2]
        thrust.append(controller.step(step * 50_000, nav_state(step * 50_000, x), target, TANK, params).thrust_n)
    assert np.abs(thrust).max() > 3.0, "it does turn round"
    assert np.abs(np.diff(thrust, axis=0)).max() <= 3.0
