"""A moment that the model does not know lowers the limit of the yaw rate, where it turns the vehicle faster."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from autopilot.control.robust.margins import AT_REST, YawRateExcess
from autopilot.control.robust.robust_tuning import YAW_RATE
from autopilot.core.messages import NavHealth, NavState
from autopilot.core.model4 import Model4, body_acceleration
from tests.control.vehicles import LBV150, bluerov2

LAG_S, STEP_S, TICKS = 0.15, 0.05, 50
LEAD_S = LAG_S + YAW_RATE.step_s


class Turning:
    """A vehicle that turns by its model and a moment beside it, and moves through the water as it likes."""

    def __init__(self, model: Model4, surge_m_s: float = 0.0, sway_m_s: float = 0.0) -> None:
        self.model, self.water = model, (surge_m_s, sway_m_s)
        self.excess = YawRateExcess(model, LAG_S)
        self.rate_rad_s, self.t_us = 0.0, 1_000_000
        self.step(np.zeros(model.thrusters), 0.0)

    def nav(self) -> NavState:
        return replace(
            AT_REST,
            t_us=self.t_us,
            vel_water_frd_m_s=np.array([*self.water, 0.0]),
            rate_frd_rad_s=np.array([0.0, 0.0, self.rate_rad_s]),
        )

    def step(self, thrust_n: np.ndarray, moment_n_m: float) -> None:
        for _ in range(TICKS):
            nu = (*self.water, 0.0, self.rate_rad_s)
            turn = body_acceleration(self.model, nu, thrust_n.tolist(), math)[3] + moment_n_m / self.model.mass_kg[3]
            self.rate_rad_s += turn * STEP_S / TICKS
            self.excess.push(thrust_n, STEP_S / TICKS)
        self.t_us += round(1e6 * STEP_S)
        self.excess.update(self.nav())


@given(st.integers(0, 2**32 - 1), st.floats(-0.4, 0.4), st.floats(-0.3, 0.3), st.booleans())
@settings(deadline=None, max_examples=30)
def test_what_the_model_explains_costs_nothing(seed: int, surge: float, sway: float, heavy: bool) -> None:
    model = (bluerov2() if heavy else LBV150).to_model()
    rng, turning = np.random.default_rng(seed), Turning(model, surge, sway)
    for _ in range(40):
        turning.step(rng.uniform(-4.0, 4.0, model.thrusters), 0.0)
        assert turning.excess.back_off_rad_s(1.0) < 0.02 and turning.excess.back_off_rad_s(-1.0) < 0.02


@given(st.floats(0.05, 0.4), st.sampled_from((-1.0, 1.0)), st.floats(-5.0, 5.0))
@settings(deadline=None, max_examples=30)
def test_an_unknown_moment_lowers_the_limit_of_the_turn_that_it_helps(size: float, way: float, thrust: float) -> None:
    model = LBV150.to_model()
    turning = Turning(model)
    for _ in range(12):
        turning.step(np.array([thrust, -thrust, 0.0, 0.0]), way * size)
    expected = size / model.mass_kg[3] * LEAD_S
    assert turning.excess.back_off_rad_s(way) == pytest.approx(expected, rel=0.1, abs=0.01)
    assert turning.excess.back_off_rad_s(-way) == 0.0
    for _ in range(12):
        turning.step(np.array([thrust, -thrust, 0.0, 0.0]), 0.0)
    assert turning.excess.back_off_rad_s(way) < 0.1 * expected + 0.01, "it goes as the moment does"


@pytest.mark.parametrize(
    "change",
    [
        {"reset_count": 1},
        {"health": NavHealth.INVALID},
        {"rate_frd_rad_s": np.full(3, np.nan)},
        {"t_us": 900_000},
        {"t_us": 9_000_000},
    ],
)
def test_jumps_gaps_and_lost_estimates_are_no_moment(change: dict[str, object]) -> None:
    turning = Turning(LBV150.to_model())
    for _ in range(12):
        turning.step(np.zeros(4), 0.3)
    assert turning.excess.back_off_rad_s(1.0) > 0.1
    turning.excess.push(np.zeros(4), STEP_S)
    turning.excess.update(replace(turning.nav(), **change))  # type: ignore[arg-type]
    assert turning.excess.back_off_rad_s(1.0) == 0.0
    turning.excess.push(np.zeros(4), STEP_S)
    turning.excess.update(replace(turning.nav(), t_us=20_000_000))
    assert turning.excess.back_off_rad_s(1.0) == 0.0
