"""The moment that the model does not know is what turns the vehicle beside its thrusters."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from autopilot.control.current.moment import MomentEstimator
from autopilot.control.robust.margins import AT_REST
from autopilot.core.messages import NavHealth, NavState
from autopilot.core.model4 import Model4, body_acceleration
from tests.control.vehicles import LBV150, bluerov2

STEP_S, TICKS = 0.05, 50


class Turning:
    """A vehicle that turns by its model and a moment beside it, and moves through the water as it likes."""

    def __init__(self, model: Model4, surge_m_s: float = 0.0, sway_m_s: float = 0.0) -> None:
        self.model, self.water = model, (surge_m_s, sway_m_s)
        self.found = MomentEstimator(model)
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
            self.found.push(thrust_n, STEP_S / TICKS)
        self.t_us += round(1e6 * STEP_S)
        self.found.update(self.nav(), np.full(self.model.thrusters, 12.0))


@given(st.integers(0, 2**32 - 1), st.floats(-0.4, 0.4), st.floats(-0.3, 0.3), st.booleans())
@settings(deadline=None, max_examples=30)
def test_what_the_model_explains_costs_nothing(seed: int, surge: float, sway: float, heavy: bool) -> None:
    model = (bluerov2() if heavy else LBV150).to_model()
    rng, turning = np.random.default_rng(seed), Turning(model, surge, sway)
    for _ in range(40):
        turning.step(rng.uniform(-4.0, 4.0, model.thrusters), 0.0)
        assert abs(turning.found.moment_nm) < 0.02


@given(st.floats(0.05, 0.4), st.sampled_from((-1.0, 1.0)), st.floats(-5.0, 5.0))
@settings(deadline=None, max_examples=30)
def test_an_unknown_moment_is_found_and_goes_as_it_does(size: float, way: float, thrust: float) -> None:
    model = LBV150.to_model()
    turning = Turning(model)
    for _ in range(24):
        turning.step(np.array([thrust, -thrust, 0.0, 0.0]), way * size)
    assert turning.found.moment_nm == pytest.approx(way * size, rel=0.1, abs=0.01)
    for _ in range(24):
        turning.step(np.array([thrust, -thrust, 0.0, 0.0]), 0.0)
    assert abs(turning.found.moment_nm) < 0.1 * size + 0.01


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
    assert turning.found.moment_nm > 0.2
    turning.found.push(np.zeros(4), STEP_S)
    limit_n = np.full(4, 12.0)
    turning.found.update(replace(turning.nav(), **change), limit_n)  # type: ignore[arg-type]
    assert turning.found.moment_nm == 0.0
    turning.found.push(np.zeros(4), STEP_S)
    turning.found.update(replace(turning.nav(), t_us=20_000_000), limit_n)
    assert turning.found.moment_nm == 0.0


def test_no_more_is_counted_on_than_a_quarter_of_what_thrusters_make() -> None:
    turning = Turning(LBV150.to_model())
    most_nm = float(np.abs(LBV150.to_model().allocation[3]) @ np.full(4, 12.0))
    for _ in range(24):
        turning.step(np.zeros(4), 5.0 * most_nm)
    assert turning.found.moment_nm == pytest.approx(0.25 * most_nm)
