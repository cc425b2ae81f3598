"""The flow that is learned from estimates: free of divergence, bounded, and right about what it has seen."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from autopilot.control.controller import MotionController
from autopilot.control.current.current_learning import Basin, EstimatedFlow, narrowest_width_m
from autopilot.control.current.current_tuning import CURRENT_LEARNING
from autopilot.control.current.currents import EstimatedCurrent
from autopilot.control.energy.trajectory import Program, Trajectory
from autopilot.core.geometry import Circle, Fence
from autopilot.core.messages import NavHealth
from autopilot.core.params import ParamSet
from autopilot.sitl.current_fields import Gyre
from tests.control.control_loop import TANK, VEHICLE, fly, goal, jet, nav_state
from tests.control.waters import KINDS, errors_of, room, world_of


def along(x: float, y: float, t_s: float, current: np.ndarray, health: NavHealth = NavHealth.GOOD):
    state = np.array([x, y, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0])
    return nav_state(round(t_s * 1e6), state, current, health)


def taught(sweep_y: float = 0.0, basin: Basin = Basin.CLOSED) -> tuple[EstimatedFlow, object]:
    forecast = EstimatedFlow(basin)
    forecast.within(TANK)
    for k in range(201):
        x = -1.8 + 3.6 * k / 200
        nav = along(x, sweep_y, 0.05 * k, jet(np.array([x, sweep_y])))
        forecast.view(nav)
    return forecast, nav


def ask(forecast: EstimatedFlow, nav: object, places: np.ndarray) -> np.ndarray:
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
    flow = forecast._fit.flow(places)
    assert abs(flow[0, 0] - flow[1, 0] + flow[2, 1] - flow[3, 1]) / (2.0 * h) < 1e-3


def test_water_that_does_not_vary_is_expected_to_go_on_so() -> None:
    """Tens of metres ahead the forecast is what was felt so far, in any fence; nobody waits for a return flow."""
    everywhere = np.array([0.08, 0.13, 0.0])
    for fence in (Fence(), Fence(inclusions=(Circle(center_ned_m=np.zeros(2), radius_m=60.0),))):
        forecast = EstimatedFlow()
        forecast.within(fence)
        for k in range(400):
            nav = along(0.05 * k, 0.0, 0.1 * k, everywhere)
            forecast.view(nav)
        assert np.allclose(ask(forecast, nav, np.array([[45.0, 0.0], [10.0, 30.0]]))[:, :2], everywhere[:2], atol=0.03)
        assert forecast.closed < 0.3


def test_the_estimate_rules_here_and_now() -> None:
    forecast, _ = taught()
    nav = along(0.0, 0.0, 20.0, np.array([-0.1, 0.05, 0.01]))
    assert np.allclose(ask(forecast, nav, np.array([[0.0, 0.0]])), [[-0.1, 0.05, 0.01]])
    before = forecast.revision(nav)
    assert forecast.revision(along(0.0, 0.0, 20.1, np.array([0.2, 0.05, 0.01]))) > before


def test_memory_is_bounded_and_bad_estimates_teach_nothing() -> None:
    forecast = EstimatedFlow()
    forecast.within(TANK)
    for k in range(3 * CURRENT_LEARNING.max_cells):
        forecast.view(along(0.7 * k, 0.0, 1.0 * k, np.array([0.1, 0.0, 0.0])))
    assert len(forecast._cells) == CURRENT_LEARNING.max_cells
    fresh = EstimatedFlow()
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


@pytest.mark.parametrize("kind", KINDS)
def test_in_any_water_it_is_hardly_worse_than_uniform_and_better_where_the_flow_varies(kind: str) -> None:
    """Rooms of 3 to 60 m, estimates that lag and err. The prior for a closed basin is allowed to cost a little."""
    rows = []
    for seed in range(2):
        forecasts = {
            "uniform": EstimatedCurrent(),
            "unknown": EstimatedFlow(),
            "closed": EstimatedFlow(Basin.CLOSED),
        }
        found = errors_of(world_of(kind, seed, legs=4, limit_s=250.0), forecasts)
        rows.append([found[name] for name in forecasts])
    uniform, unknown, closed = np.array(rows).transpose(1, 0, 2)
    assert (unknown - uniform < np.array([0.006, 0.02])).all(), (unknown, uniform)
    assert (closed - uniform < np.array([0.03, 0.06])).all(), (closed, uniform)
    if kind in ("jet and return", "gyre"):
        assert (unknown.mean(axis=0) < 0.95 * uniform.mean(axis=0)).all(), (unknown, uniform)


@given(st.floats(0.05, 0.4), st.floats(0.0, 2.0 * math.pi), st.floats(2.0, 300.0), st.sampled_from(list(Basin)))
@settings(max_examples=8, deadline=None)
def test_a_fence_does_not_make_a_basin(speed: float, direction: float, width_m: float, basin: Basin) -> None:
    """A steady stream through a fenced room of any size, felt on two legs of 1.5 correlation lengths: nothing but the
    stream is expected from there on, whatever was believed before."""
    stream = speed * np.array([math.cos(direction), math.sin(direction), 0.0])
    forecast = EstimatedFlow(basin)
    forecast.within(room(width_m, width_m))
    leg_m, step_s = 0.375 * width_m, 0.1 * max(1.0, 0.05 * width_m)
    for k in range(201):
        nav = along(leg_m * min(k, 100) / 100, leg_m * max(k - 100, 0) / 100, step_s * k, stream)
        forecast.view(nav)
    places = np.array([[0.4 * width_m, 0.0], [0.0, -0.4 * width_m], [-0.3 * width_m, -0.4 * width_m]])
    wrong = np.hypot(*(ask(forecast, nav, places) - stream)[:, :2].T)
    assert (wrong < 0.02 + 0.2 * speed).all(), (wrong, forecast.trust, forecast.closed)


def test_what_proves_wrong_is_dropped_within_seconds_and_taken_up_again() -> None:
    """A vehicle has learned a jet; then the water turns round. Within 10 s of way it no longer counts on the jet."""
    forecast, nav = taught()
    for k in range(600):
        y = -1.2 + 2.4 * abs(1.0 - (k % 200) / 100.0)
        nav = along(-0.5, y, 10.0 + 0.1 * k, jet(np.array([-0.5, y])))
        forecast.view(nav)
    assert forecast.trust > 0.9
    turned = np.array([0.0, 0.25, 0.0])
    for k in range(100):
        nav = along(-1.8 + 0.03 * k, 0.0, 70.0 + 0.1 * k, turned)
        forecast.view(nav)
    assert forecast.trust < 0.1
    assert np.allclose(ask(forecast, nav, np.array([[1.5, 1.0], [-1.0, -1.0]]))[:, :2], turned[:2], atol=0.03)


def test_gyres_in_open_water_are_foreseen_from_the_first_leg_on() -> None:
    """Straight through gyres, the water felt on the way: the next 6 m are known better from the start."""
    gyre = Gyre(speed_m_s=0.3, cell_m=20.0)
    forecast, uniform = EstimatedFlow(), EstimatedCurrent()
    forecast.within(Fence())
    errors, trust = [], []
    for k in range(700):
        here = np.array([-10.0 + 0.03 * k, 0.0])
        nav = along(float(here[0]), 0.0, 0.1 * k, np.array(gyre.velocity((here[0], here[1], 0.5), 0.0)))
        forecast.view(nav)
        trust.append(forecast.trust)
        ahead = here + np.column_stack([np.linspace(0.5, 6.0, 6), np.zeros(6)])
        truth = np.array([gyre.velocity((p[0], p[1], 0.5), 0.0)[:2] for p in ahead])
        told = np.empty((6, 3))
        uniform.fill(nav, np.column_stack([ahead, np.full(6, 0.5)]), np.zeros(6), told)
        errors.append([np.hypot(*(f[:, :2] - truth).T).mean() for f in (told, ask(forecast, nav, ahead))])
    same, learned = np.mean(errors, axis=0)
    assert learned < 0.9 * same, (learned, same)
    assert np.mean(trust[:100]) > 0.9, trust[:100]


def test_a_goal_up_a_stream_through_a_fence_is_flown_to_and_not_round(monkeypatch: pytest.MonkeyPatch) -> None:
    """Least energy, 0.33 m/s against the bow, a fence, nothing told of the water: no hunt for a return flow. The plan
    that was made before the stream was felt cannot be kept, which took 150 slow iterations to say."""
    counts, solve = [], Program.solve

    def counted(program: Program, *given: Any, **named: Any) -> Trajectory:
        found = solve(program, *given, **named)
        counts.append(program.iterations)
        return found

    monkeypatch.setattr(Program, "solve", counted)
    flown = fly(
        MotionController(VEHICLE, currents=EstimatedFlow()),
        [goal(2.0, 0.0, 0.6, None)],
        [-2.0, 0.0, 0.6, 0.0, 0.0, 0.0, 0.0, 0.0],
        fence=room(10.0, 10.0),
        params=ParamSet({"MPC_COST": 1}),
        current=lambda _: np.array([-0.33, 0.0, 0.0]),
        noise=0.01,
        limit_s=7.0,
    )
    assert np.abs(flown.x[:, 1]).max() < 0.2
    assert max(counts) < 100
