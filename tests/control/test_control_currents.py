"""The beliefs about the water: estimate, map with a memory of what it lacked, none."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from autopilot.control.current.currents import (
    CurrentForecast,
    CurrentMemory,
    EstimatedCurrent,
    MappedCurrent,
    NoCurrent,
    PointwiseField,
)
from autopilot.core.messages import NavHealth, NavState
from tests.plan_items import nav


def _nav(
    current: list[float],
    pos: tuple[float, float, float] = (1.0, 2.0, 0.5),
    t_s: float = 2.0,
    health: NavHealth = NavHealth.GOOD,
) -> NavState:
    return replace(
        nav(*pos, t_us=round(t_s * 1e6), health=health),
        vel_frd_m_s=np.array([0.3, 0.0, 0.0]),
        vel_water_frd_m_s=np.array([0.1, 0.0, 0.0]),
        current_ned_m_s=np.array(current),
        variance=np.full(12, 1e-4),
    )


def _blank() -> MappedCurrent:
    """A map of still water: what is foretold is what is remembered."""
    return MappedCurrent(PointwiseField(lambda pos, _: (0.0, 0.0, 0.0)))


PLACES = np.array([[1.0, 2.0, 0.5], [2.0, 2.0, 0.5], [9.0, 2.5, 0.4]])
TIMES = np.array([0.0, 1.0, 2.0])


def _ramp(pos: tuple[float, float, float], t_s: float) -> tuple[float, float, float]:
    return 0.1 * pos[0], 0.01 * t_s, 0.0


def _filled(forecast: CurrentForecast, nav: NavState, places: np.ndarray, times: np.ndarray) -> np.ndarray:
    out = np.empty((len(places), 3))
    forecast.fill(nav, places, times, out)
    return out


def test_the_estimate_holds_everywhere() -> None:
    assert (_filled(EstimatedCurrent(), _nav([0.1, -0.2, 0.0]), PLACES, TIMES) == [0.1, -0.2, 0.0]).all()


def test_the_map_is_read_at_place_and_time_and_corrected_near_the_vehicle() -> None:
    out = _filled(MappedCurrent(PointwiseField(_ramp)), _nav([0.15, 0.04, 0.0]), PLACES, TIMES)
    # Here as estimated; 1 m away the correction of 0.05, 0.02 has faded by exp(-0.7^2 / 2); far away it is gone.
    share = math.exp(-0.5 * 0.7**2)
    np.testing.assert_allclose(out[0], [0.15, 0.04, 0.0])
    np.testing.assert_allclose(out[1], [0.2 + 0.05 * share, 0.03 + 0.02 * share, 0.0])
    np.testing.assert_allclose(out[2], [0.9, 0.04, 0.0], atol=1e-12)


FORECASTS = {
    "estimate": EstimatedCurrent,
    "map": lambda: MappedCurrent(PointwiseField(lambda pos, _: (0.1 * pos[0], 0.0, 0.0))),
    "memory": _blank,
}


@pytest.mark.parametrize("name", FORECASTS)
@given(current=st.tuples(*[st.floats(-0.5, 0.5)] * 3), side_m=st.floats(0.0, 0.3), angle=st.floats(0.0, 6.28))
def test_at_a_goal_the_forecast_is_the_estimate_at_every_stage(
    name: str, current: tuple[float, float, float], side_m: float, angle: float
) -> None:
    """What a vehicle that holds its place predicts must not change along the horizon, or it would lean against it."""
    forecast = FORECASTS[name]()
    nav = _nav(list(current), (0.0, 0.0, 1.0))
    forecast.view(_nav([0.2, 0.1, 0.0], (side_m * math.cos(angle), side_m * math.sin(angle), 1.0), 1.0))
    forecast.view(nav)
    stay = np.tile(nav.pos_ned_m, (20, 1))
    out = _filled(forecast, nav, stay, np.linspace(0.0, 8.0, 20))
    np.testing.assert_allclose(out, np.tile(current, (20, 1)), atol=1e-12)


def _jet(pos: tuple[float, float, float], _t: float) -> tuple[float, float, float]:
    return 0.25 * math.cos(2.0 * math.pi / 3.0 * pos[1]), 0.0, 0.0


def _swim(forecast: CurrentForecast, laps: int, t_s: float = 0.0) -> NavState:
    """To and fro across a jet, with an estimate that is right."""
    nav = _nav([0.0, 0.0, 0.0])
    for k in range(laps * 400):
        pos = (0.0, -1.0 + 2.0 * abs(1.0 - (k % 400) / 200.0), 0.5)
        nav = _nav(list(_jet(pos, 0.0)), pos, t_s + 0.05 * k)
        forecast.view(nav)
    return nav


def test_memory_knows_where_the_vehicle_has_been_and_nothing_elsewhere() -> None:
    forecast = _blank()
    nav = _swim(forecast, 1)
    track = np.array([(0.0, y, 0.5) for y in np.linspace(-0.9, 0.9, 19)])
    truth = np.array([_jet(tuple(p), 0.0) for p in track])
    error = np.abs(_filled(forecast, nav, track, np.zeros(19)) - truth).max()
    naive = np.abs(_filled(EstimatedCurrent(), nav, track, np.zeros(19)) - truth).max()
    assert error < 0.12
    assert naive > 0.3
    far = np.array([[12.0, 0.0, 0.5]])
    np.testing.assert_allclose(_filled(forecast, nav, far, np.zeros(1))[0], np.zeros(3), atol=1e-6)


def test_a_wrong_map_is_put_right_where_the_vehicle_has_been() -> None:
    forecast = MappedCurrent(PointwiseField(lambda pos, _: (0.0, 0.1, 0.0)))
    nav = _swim(forecast, 1)
    track = np.array([(0.0, y, 0.5) for y in np.linspace(-0.9, 0.9, 19)])
    truth = np.array([_jet(tuple(p), 0.0) for p in track])
    assert np.abs(_filled(forecast, nav, track, np.zeros(19)) - truth).max() < 0.12
    far = np.array([[12.0, 0.0, 0.5]])
    np.testing.assert_allclose(_filled(forecast, nav, far, np.zeros(1))[0], [0.0, 0.1, 0.0], atol=1e-6)


def test_memory_forgets_and_learns_nothing_from_a_bad_estimate() -> None:
    forecast = _blank()
    _swim(forecast, 1)
    place = np.array([[0.0, 0.0, 0.5]])
    later = _nav([0.0, 0.0, 0.0], (8.0, 8.0, 0.5), 4.0 * 3600.0)
    assert np.abs(_filled(forecast, later, place, np.zeros(1))).max() < 1e-3
    blind = _blank()
    for k in range(200):
        blind.view(_nav([0.3, 0.0, 0.0], (0.0, 0.0, 0.5), 0.05 * k, NavHealth.DEAD_RECKONING))
    nav = _nav([0.0, 0.1, 0.0], (3.0, 3.0, 0.5), 11.0)
    np.testing.assert_allclose(_filled(blind, nav, place, np.zeros(1))[0], np.zeros(3), atol=1e-4)


def test_memory_is_a_window_that_wraps_round_without_mixing_places() -> None:
    forecast = _blank()
    for k in range(200):
        forecast.view(_nav([0.3, 0.0, 0.0], (0.0, 0.0, 0.5), 0.05 * k))
    nav = _nav([0.0, 0.1, 0.0], (40.0, 3.0, 0.5), 11.0)
    for place in ([32.0, 0.0, 0.5], [0.0, -32.0, 0.5], [64.0, 32.0, 0.5]):
        np.testing.assert_allclose(_filled(forecast, nav, np.array([place]), np.zeros(1))[0], np.zeros(3), atol=1e-6)
    assert _filled(forecast, nav, np.array([[0.0, 0.0, 0.5]]), np.zeros(1))[0, 0] > 0.29


def test_a_revision_says_when_to_plan_anew() -> None:
    estimate = EstimatedCurrent()
    assert [estimate.revision(_nav([c, 0.0, 0.0])) for c in (0.1, 0.12, 0.14, 0.14, 0.1)] == [0, 0, 1, 1, 2]
    memory = _blank()
    _swim(memory, 1)
    memory.revision(_nav(list(_jet((0.0, -0.1, 0.5), 0.0)), (0.0, -0.1, 0.5), 20.0))
    known = memory.revision(_nav(list(_jet((0.0, 0.0, 0.5), 0.0)), (0.0, 0.0, 0.5), 20.0))
    assert memory.revision(_nav(list(_jet((0.0, 0.3, 0.5), 0.0)), (0.0, 0.3, 0.5), 20.1)) == known
    assert memory.revision(_nav([-0.1, 0.0, 0.0], (0.0, 0.0, 0.5), 20.2)) == known + 1
    tide = MappedCurrent(PointwiseField(lambda _, t_s: (0.01 * t_s, 0.0, 0.0)))
    assert [tide.revision(_nav([0.01 * t, 0.0, 0.0], t_s=t)) for t in (0.0, 1.0, 2.0, 4.0, 5.0)] == [0, 0, 0, 1, 1]
    assert NoCurrent().revision(_nav([1.0, 0.0, 0.0])) == 0


def test_without_currents_ground_speed_is_water_speed() -> None:
    view = NoCurrent().view(_nav([0.2, 0.0, 0.0]))
    assert (view.current_ned_m_s == 0.0).all()
    assert view.vel_water_frd_m_s == pytest.approx([0.3, 0.0, 0.0])
    assert not _filled(NoCurrent(), view, PLACES, TIMES).any()


@given(st.integers(0, 2**32 - 1))
def test_memory_that_works_out_its_nodes_at_every_lesson_knows_the_same(seed: int) -> None:
    random = np.random.default_rng(seed)
    kept, anew = CurrentMemory(1.0), CurrentMemory(1.0)
    place, t_us = random.normal(size=3), 0
    for _ in range(30):
        t_us += int(random.choice([0, 10_000, 20_000, 500_000]))
        place = place + random.normal(size=3) * random.choice([0.02, 0.3, 40.0], p=[0.8, 0.18, 0.02])
        lesson = t_us, place, random.normal(size=3), random.uniform(0.0, 1e-3)
        kept.learn(*lesson)
        anew._put_back()
        anew._patch = None  # the same cell is looked up again
        anew.learn(*lesson)
    asked = t_us, place + 0.3 * random.normal(size=(9, 3)), np.zeros(3)
    assert np.array_equal(kept.recall(*asked), anew.recall(*asked))
