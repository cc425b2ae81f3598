"""Waves against vehicle model and thruster faults: what goes to and fro makes the model less certain."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from autopilot.control.thrust.disturbance_level import DisturbanceLevel
from autopilot.estimator.measure_model import Swell
from autopilot.estimator.states import NX


class Still:
    """A model of a vehicle that is not accelerated."""

    def at(self, x: Any, moment: Any) -> tuple[float, ...]:
        return 0.0, 0.0, 0.0, 0.0


def swell_of(residual: Any, duration_s: float = 30.0) -> float:
    swell = Swell(Still())  # type: ignore[arg-type]
    for t_us in range(0, int(1e6 * duration_s), 20_000):
        node: Any = SimpleNamespace(t_us=t_us, state=SimpleNamespace(x=np.zeros(NX)), moment=None)
        swell.meet(node, (residual(1e-6 * t_us), 0.0, 0.0))
    return swell.variance


@pytest.mark.parametrize("period_s", [1.0, 2.0, 4.0])
def test_a_wave_is_swell(period_s: float) -> None:
    assert swell_of(lambda t_s: 0.3 * math.sin(2.0 * math.pi * t_s / period_s)) > 10.0 * 0.06**2


@pytest.mark.parametrize("residual", [0.5, -0.5])
def test_a_current_or_a_lost_thruster_is_none(residual: float) -> None:
    assert swell_of(lambda t_s: residual) == 0.0


def test_flat_water_is_none() -> None:
    assert swell_of(lambda t_s: 0.1 * math.sin(3.0 * t_s)) == 0.0


def test_evidence_counts_for_less_until_the_filter_expects_the_waves_and_for_as_much_once_they_are_over() -> None:
    level, s = DisturbanceLevel(), np.eye(4)
    for _ in range(100):
        level.update(0.1, np.array((3.0, 0.3, 0.3, 0.3)), s)
    assert level.evidence_share == 0.0 and (level.factor[1:] == 1.0).all()
    for _ in range(1000):
        level.update(0.1, np.full(4, 0.3), s)
    assert level.evidence_share == 1.0
