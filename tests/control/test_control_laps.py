"""The paper's mission on the model: three laps A-B-A, in a jet that the controller only estimates."""

import numpy as np
from control_loop import VEHICLE, A, B, fly, jet

from autopilot.control.controller import MotionController
from autopilot.core.messages import Fallback, SolveStatus


def test_three_laps_without_a_violation() -> None:
    controller = MotionController(VEHICLE, cpu_clock=lambda: 0.0)
    flight = fly(controller, [B, A] * 3, [-1.6, -0.35, 0.45, 0, 0, 0, 0, 0], current=jet, noise=0.01, limit_s=120.0)
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
