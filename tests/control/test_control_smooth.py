"""Commands in closed loop with a noisy estimate: no alternation, no steps, no trembling."""

import numpy as np
import pytest
from control_loop import TANK, VEHICLE, A, B, Flight, fly, jet, nav_state, still

from autopilot.control.controller import MotionController
from autopilot.core.params import ParamSet
from autopilot.log.smoothness import BARS, Commands, Smoothness, measure

STEP_S = 0.05


def smoothness(flight: Flight) -> Smoothness:
    """Figures as ``autopilot log check`` takes them."""
    t_s = STEP_S * np.arange(len(flight.thrust_n))
    found = measure(
        Commands(
            t_s=t_s,
            thrust_n=flight.thrust_n,
            fallback=np.array([output.status.fallback for output in flight.outputs], dtype=np.uint8),
            starts_s=np.array([0.0, *flight.reached_s]),
            told_s=np.zeros(0),
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


def test_a_reference_that_jumps_does_not_tear_at_the_thrusters() -> None:
    """Goals to and fro while under way: each is a new route and a burst, and would be a step of 10 N and more."""
    controller, params = MotionController(VEHICLE, cpu_clock=lambda: 0.0), ParamSet()
    x, thrust = np.array([-1.6, -0.35, 0.45, 0, 0.2, 0, 0, 0.0]), []
    for step in range(40):
        target = (B, A)[step // 10 % 2]
        thrust.append(controller.step(step * 50_000, nav_state(step * 50_000, x), target, TANK, params).thrust_n)
    assert np.abs(thrust).max() > 6.0, "all that it may, in the end"
    assert np.abs(np.diff(thrust, axis=0)).max() <= 3.0
