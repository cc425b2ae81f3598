"""The flow that is learned from estimates: free of divergence, bounded, and right about what it has seen."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from autopilot.control.current_learning import FLOW_M_S, MAX_CELLS, LearnedCurrent, narrowest_width_m
from autopilot.core.geometry import Circle, Fence
from autopilot.core.messages import NavHealth
from tests.control.control_loop import TANK, jet, nav_state


def along(x: float, y: float, t_s: float, current: np.ndarray, health: NavHealth = NavHealth.GOOD):
    state = np.array([x, y, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0])
    return nav_state(round(t_s * 1e6), state, current, health)


def taught(sweep_y: float = 0.0) -> tuple[LearnedCurrent, object]:
    forecast = LearnedCurrent()
    forecast.within(TANK)
    for k in range(201):
        x = -1.8 + 3.6 * k / 200
        nav = along(x, sweep_y, 0.05 * k, jet(np.array([x, sweep_y])))
        forecast.view(nav)
    return forecast, nav


def ask(forecast: LearnedCurrent, nav: object, places: np.ndarray) -> np.ndarray:
    out = np.empty((len(places), 3))
    forecast.fill(nav, np.column_stack([places, np.full(len(places), 0.5)]), np.zeros(len(places)), out)  # type: ignore[arg-type]
    return out


def test_it_gives_back_what_was_seen_and_expects_the_return_flow() -> None:
    forecast, nav = taught()
    seen = np.column_stack([np.linspace(-1.5, 1.5, 7), np.zeros(7)])
    truth = np.array([jet(p)[0] for p in seen])
    assert np.allclose(ask(forecast, nav, seen)[:, 0], truth, atol=0.03)
    beside = np.array([[-0.5, 1.15], [-0.5, -1.15]])
    assert (ask(forecast, nav, beside)[:, 0] < -0.02).all()


@given(st.floats(-2.0, 0.5), st.floats(-1.2, 1.2))
@settings(max_examples=30, deadline=None)
def test_the_flow_is_free_of_divergence(x: float, y: float) -> None:
    forecast, _ = taught(0.3)
    h = 1e-3
    places = np.array([[x + h, y], [x - h, y], [x, y + h], [x, y - h]])
    flow = forecast._flow(places)
    assert abs(flow[0, 0] - flow[1, 0] + flow[2, 1] - flow[3, 1]) / (2.0 * h) < 1e-3


def test_water_that_does_not_vary_is_expected_to_go_on_so() -> None:
    """Tens of metres ahead the forecast is what was felt so far; a jet makes it careful again."""
    forecast = LearnedCurrent()
    everywhere = np.array([0.08, 0.13, 0.0])
    for k in range(400):
        nav = along(0.05 * k, 0.0, 0.1 * k, everywhere)
        forecast.view(nav)
    assert np.allclose(ask(forecast, nav, np.array([[45.0, 0.0]]))[0, :2], everywhere[:2], atol=0.01)
    assert forecast._flow_m_s == FLOW_M_S[-1]
    swept, _ = taught()
    assert swept._flow_m_s > FLOW_M_S[-1]


def test_the_estimate_rules_here_and_now() -> None:
    forecast, _ = taught()
    nav = along(0.0, 0.0, 20.0, np.array([-0.1, 0.05, 0.01]))
    assert np.allclose(ask(forecast, nav, np.array([[0.0, 0.0]])), [[-0.1, 0.05, 0.01]])
    before = forecast.revision(nav)
    assert forecast.revision(along(0.0, 0.0, 20.1, np.array([0.2, 0.05, 0.01]))) > before


def test_memory_is_bounded_and_bad_estimates_teach_nothing() -> None:
    forecast = LearnedCurrent()
    forecast.within(TANK)
    for k in range(3 * MAX_CELLS):
        forecast.view(along(0.7 * k, 0.0, 1.0 * k, np.array([0.1, 0.0, 0.0])))
    assert len(forecast._cells) == MAX_CELLS
    fresh = LearnedCurrent()
    fresh.view(along(0.0, 0.0, 0.0, np.array([math.nan, 0.0, 0.0])))
    fresh.view(along(0.0, 0.0, 1.0, np.array([0.5, 0.0, 0.0]), NavHealth.DEAD_RECKONING))
    assert not fresh._cells


def test_another_workspace_begins_anew() -> None:
    forecast, _ = taught()
    forecast.within(TANK)
    assert forecast._cells
    forecast.within(Fence(inclusions=(Circle(center_ned_m=np.zeros(2), radius_m=20.0),)))
    assert not forecast._cells
    assert narrowest_width_m(Fence()) is None
    assert narrowest_width_m(TANK) == pytest.approx(3.0)
