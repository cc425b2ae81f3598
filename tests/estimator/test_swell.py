"""Waves against vehicle model and thruster faults: what goes to and fro makes the model less certain."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from autopilot.control.thrust.actuation_delay import DisturbanceLevel
from autopilot.estimator.measure_model import Swell
from autopilot.estimator.states import NX, YAW


class Still:
    """A model of a vehicle that is not accelerated."""

    def at(self, x: Any, moment: Any) -> tuple[float, ...]:
        return 0.0, 0.0, 0.0, 0.0


def swell_of(residual: Any, duration_s: float = 30.0, *, turn_rad_s: float = 0.0, ned: bool = False) -> float:
    """``residual`` forward, or with ``ned`` north, of a vehicle that turns."""
    swell, x = Swell(Still()), np.zeros(NX)  # type: ignore[arg-type]
    for t_us in range(0, int(1e6 * duration_s), 20_000):
        t_s = 1e-6 * t_us
        x[YAW] = turn_rad_s * t_s
        node: Any = SimpleNamespace(t_us=t_us, state=SimpleNamespace(x=x), moment=None)
        c, s = (math.cos(x[YAW]), math.sin(x[YAW])) if ned else (1.0, 0.0)
        swell.meet(node, (c * residual(t_s), -s * residual(t_s), 0.0))
    return swell.variance


@pytest.mark.parametrize("turn_rad_s", [0.0, 0.2, -0.5])
@pytest.mark.parametrize("period_s", [1.0, 2.0, 4.0])
def test_a_wave_is_swell(period_s: float, turn_rad_s: float) -> None:
    wave = swell_of(lambda t_s: 0.4 * math.sin(2.0 * math.pi * t_s / period_s), turn_rad_s=turn_rad_s, ned=True)
    assert wave > 10.0 * 0.06**2


@settings(max_examples=30)
@given(st.floats(-0.5, 0.5), st.floats(-1.0, 1.0), st.booleans())
def test_a_current_or_a_lost_thruster_is_none(residual: float, turn_rad_s: float, ned: bool) -> None:
    """Nor while the vehicle turns: the model had no more weight then, and the current was 0.25 m/s off."""
    assert swell_of(lambda t_s: residual, turn_rad_s=turn_rad_s, ned=ned) == 0.0


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
