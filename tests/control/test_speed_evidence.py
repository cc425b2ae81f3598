"""Margins of the planar speed that shrink with evidence: slowly, never below half, and back at once."""

import math
from dataclasses import replace

import numpy as np
import pytest
from control_loop import MODEL, VEHICLE, goal, nav_state, rk4
from hypothesis import given, settings
from hypothesis import strategies as st

from autopilot.control.controller import MotionController
from autopilot.control.nmpc.grid import geometric_grid
from autopilot.control.robust.margins import Margins, SpeedEvidence
from autopilot.control.robust.robust_tuning import EVIDENCE
from autopilot.core.geometry import Fence
from autopilot.core.messages import NavHealth, NavState
from autopilot.core.params import ParamSet

LIMIT, TUBE, LEAST, STRONG, STEP_S = 0.5, 0.13, 0.05, np.array([-0.36, 0.0, 0.0]), 0.05

SPREAD = np.square([1e-3, 1e-3, 1e-3, 1e-3, 1e-3, 1e-2, 0.045, 0.04, 0.02, 0.045, 0.04, 0.02])
"""Variances of the estimator, as in flight with the camera."""


def seen(k: int, speed: float, current: np.ndarray = STRONG, health: NavHealth = NavHealth.GOOD) -> NavState:
    return nav_state(round(k * STEP_S * 1e6), np.array([0, 0, 0.5, 0, speed, 0, 0, 0], dtype=float), current, health)


def at_cap(evidence: SpeedEvidence, seconds: float, noise: float = 0.0, first: int = 0, seed: int = 1) -> int:
    """Fly at 0.95 of the cap for a while; the number of the next step."""
    rng = np.random.default_rng(seed)
    last = first + round(seconds / STEP_S)
    for k in range(first, last):
        evidence.update(
            seen(k, 0.95 * (LIMIT - evidence.margin_fraction * TUBE) + noise * rng.normal()), LIMIT, TUBE, LEAST
        )
    return last


def test_a_speed_that_is_kept_earns_half_of_the_margin_slowly_and_a_gust_takes_it_back_at_once() -> None:
    evidence = SpeedEvidence()
    k = at_cap(evidence, 5.0, 0.004)
    assert evidence.margin_fraction > 0.75, "not within seconds"
    k = at_cap(evidence, 40.0, 0.004, k)
    assert evidence.margin_fraction == pytest.approx(EVIDENCE.least_fraction, abs=0.03)
    rng = np.random.default_rng(3)
    for i in range(40):
        evidence.update(seen(k + i, 0.43 + 0.06 * rng.normal()), LIMIT, TUBE, LEAST)
    assert evidence.margin_fraction > 0.9, "two seconds later"


@pytest.mark.parametrize("current", [0.0, 0.25])
def test_where_there_is_speed_enough_the_margin_stays(current: float) -> None:
    evidence = SpeedEvidence()
    for k in range(800):
        evidence.update(seen(k, 0.35, np.array([-current, 0.0, 0.0])), LIMIT, TUBE, LEAST)
    assert evidence.margin_fraction == 1.0


@given(st.integers(0, 10_000), st.floats(0.0, 0.1))
@settings(max_examples=20, deadline=None)
def test_the_margin_never_jumps_never_falls_below_half_and_holds_what_is_seen(seed: int, noise: float) -> None:
    evidence, rng = SpeedEvidence(), np.random.default_rng(seed)
    before = evidence.margin_fraction
    for k in range(600):
        speed = abs(0.95 * (LIMIT - evidence.margin_fraction * TUBE) + noise * rng.normal())
        current = STRONG * rng.uniform(0.9, 1.1)
        evidence.update(seen(k, speed, current), LIMIT, TUBE, LEAST)
        assert EVIDENCE.least_fraction <= evidence.margin_fraction <= 1.0
        moved = (evidence.margin_fraction - before) * TUBE
        assert -EVIDENCE.shrink_m_s2 * STEP_S - 1e-9 <= moved <= EVIDENCE.grow_m_s2 * STEP_S + 1e-9
        before = evidence.margin_fraction
    assert evidence.margin_fraction >= min(1.0, 2.0 * noise / TUBE) - 0.1


@pytest.mark.parametrize("what", ["lost", "jumped", "nan"])
def test_credit_ends_with_the_estimate_that_earned_it(what: str) -> None:
    evidence = SpeedEvidence()
    k = at_cap(evidence, 40.0)
    assert evidence.margin_fraction < 0.6
    nav = seen(
        k, math.nan if what == "nan" else 0.4, health=NavHealth.DEAD_RECKONING if what == "lost" else NavHealth.GOOD
    )
    evidence.update(replace(nav, reset_count=7) if what == "jumped" else nav, LIMIT, TUBE, LEAST)
    assert evidence.margin_fraction == 1.0


def test_other_margins_know_nothing_of_it_and_clearance_stays() -> None:
    margins, params = Margins(MODEL, geometric_grid()), ParamSet()
    x, thrust = np.zeros((21, 8)), np.zeros((20, 4))
    nav = replace(seen(0, 0.4), variance=SPREAD)
    whole = margins.back_offs(nav, x, thrust, params)
    margins.evidence.margin_fraction = 0.5
    half = margins.back_offs(nav, x, thrust, params)
    assert whole.planar_speed_m_s[-1] > 0.09
    assert np.allclose(half.planar_speed_m_s, np.maximum(0.5 * whole.planar_speed_m_s, params["MPC_SPEED_MARGIN"]))
    assert np.array_equal(half.clearance_m, whole.clearance_m)
    fixed = ParamSet({"MPC_TIGHTEN": 0})
    assert (margins.back_offs(nav, x, thrust, fixed).planar_speed_m_s == fixed["MPC_SPEED_MARGIN"]).all()


def test_up_a_stream_near_the_limit_way_is_made_and_the_limit_holds() -> None:
    """0.35 m/s of 0.5 against the bow, the estimator's spread as in flight: the whole margin leaves nothing of it."""
    controller, params, fence = MotionController(VEHICLE), ParamSet({"MPC_COST": 0}), Fence(depth_max_m=1.2)
    stream = np.array([-0.35, 0.0, 0.0])
    x, acting, fastest, made = np.array([0.0, 0.0, 0.6, 0.0, 0.3, 0.0, 0.0, 0.0]), np.zeros(4), 0.0, []
    rng = np.random.default_rng(1)
    for step in range(700):
        told = x + np.array([0, 0, 0, 0, *(0.003 * rng.normal(size=3)), 0])
        nav = replace(nav_state(step * 50_000, told, stream), variance=SPREAD)
        out = controller.step(step * 50_000, nav, goal(40.0, 0.0, 0.6, None), fence, params)
        for _ in range(2):
            acting = acting + (out.thrust_n - acting) * (1.0 - math.exp(-0.025 / 0.15))
            x = rk4(MODEL, x, acting, lambda _: stream, 0.025)
        fastest = max(fastest, math.hypot(x[4], x[5]))
        made.append(float(x[0]))
    early, late = (made[200] - made[100]) / 5.0, (made[-1] - made[-101]) / 5.0
    assert min(early, late) > 0.08, (early, late)
    assert fastest < 0.5
