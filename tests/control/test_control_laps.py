"""The paper's mission on the model: three laps A-B-A, still water and a jet that the controller only estimates."""

import numpy as np
import pytest
from control_loop import VEHICLE, A, B, fly, jet, still

from autopilot.control.controller import MotionController
from autopilot.core.messages import Fallback, SolveStatus


@pytest.mark.parametrize(("current", "noise"), [(still, 0.0), (jet, 0.01)], ids=["still", "jet"])
def test_three_laps_without_a_violation(current, noise: float) -> None:
    controller = MotionController(VEHICLE, cpu_clock=lambda: 0.0)
    flight = fly(
        controller, [B, A] * 3, [-1.6, -0.35, 0.45, 0, 0, 0, 0, 0], current=current, noise=noise, limit_s=120.0
    )
    assert len(flight.reached_s) == 6
    assert flight.reached_s[-1] < 90.0
    assert flight.pillar_distance_m() >= 0.46
    assert flight.wall_distance_m() >= 0.3
    assert flight.planar_speed_m_s() <= 0.5
    assert np.abs(flight.x[:, 6]).max() <= 0.25
    assert np.abs(flight.x[:, 7]).max() <= 1.0
    assert flight.x[:, 2].min() > 0.0
    assert flight.x[:, 2].max() < 1.2
    assert np.abs(flight.thrust_n).max() <= 12.0
    assert {o.status.fallback for o in flight.outputs} == {Fallback.NONE}
    assert {o.status.status for o in flight.outputs} == {SolveStatus.OK}
    assert max(o.status.slack_max for o in flight.outputs) < 0.03
    assert min(o.status.margin_m for o in flight.outputs) > -0.03


def test_settles_at_b_in_the_jet() -> None:
    controller = MotionController(VEHICLE, cpu_clock=lambda: 0.0)
    flight = fly(controller, [B], [0.6, 0.8, 0.5, 1.0, 0, 0, 0, 0], current=jet, noise=0.01, limit_s=20.0, hold=True)
    end = flight.x[-500:]
    assert np.linalg.norm(end[:, :3] - B.pos_ned_m, axis=1).max() < 0.05
    assert np.abs(np.abs(end[:, 3]) - np.pi).max() < 0.05
