"""What follows a plan by the compiled library, against the code that says what it means."""

import numpy as np
import pytest
from control_loop import nav_state
from vehicles import drawn

from autopilot.control.energy.track import TrackedTrajectory
from autopilot.control.energy.trajectory import Trajectory
from autopilot.control.nmpc.grid import geometric_grid
from autopilot.control.nmpc.lag import ThrusterLag
from autopilot.control.robust.ancillary import Ancillary
from autopilot.control.robust.inner import InnerLoop
from autopilot.control.water.current_learning import FlowFit, LearnedCurrent
from autopilot.control.way.reference import Route
from autopilot.core import compiled
from autopilot.core.frames import FloatArray
from autopilot.core.response import Response
from tests.hostile_numbers import HOSTILE, agree, outcome, with_one

needs_library = pytest.mark.skipif(compiled.missing() is not None, reason="not compiled")


@needs_library
@pytest.mark.parametrize("thrusters", [4, 6])
def test_the_state_ahead_and_the_inner_loop(thrusters: int, monkeypatch: pytest.MonkeyPatch) -> None:
    rng, grid = np.random.default_rng(thrusters), geometric_grid()
    model = drawn(rng, thrusters).to_model()
    ancillary, response = Ancillary(model), Response([0.15] * thrusters)
    ours = ThrusterLag(model, response), InnerLoop(ancillary, grid)
    monkeypatch.setenv(compiled.SWITCH, compiled.OFF)
    plain = ThrusterLag(model, response), InnerLoop(ancillary, grid)
    assert plain[1]._quick is None
    for _ in range(40):
        x, current, pushed = rng.normal(size=8), 0.2 * rng.normal(size=3), 5.0 * rng.normal(size=thrusters)
        ahead = []
        for lag, _ in (ours, plain):
            lag.follow(pushed, 0.05)
            ahead.append(lag.ahead(x, current))
        assert np.allclose(*ahead, rtol=1e-11, atol=1e-11)
        begin_us, plan, thrust = (
            int(rng.integers(10**6)),
            rng.normal(size=(grid.n + 1, 8)),
            rng.normal(size=(grid.n, thrusters)),
        )
        now_us, limit_n = (
            begin_us + int(rng.choice([-1, 0, 10_000, 250_000, 5_000_000, 20_000_000])),
            rng.uniform(0.0, 9.0, thrusters),
        )
        answers = []
        for _, inner in (ours, plain):
            inner.start(begin_us, plan, thrust, current)
            answers.append(inner.thrust(now_us, 4.0 * x, current + 0.1, limit_n))
        assert np.allclose(*answers, rtol=1e-9, atol=1e-9)


def _trajectory(rng: np.random.Generator, thrusters: int = 4) -> Trajectory:
    nodes = int(rng.integers(2, 30))
    t_s = np.concatenate([[0.0], np.cumsum(rng.uniform(0.05, 0.6, nodes - 1))])
    x = np.cumsum(0.1 * rng.normal(size=(nodes, 8)), axis=0)
    thrust_n = rng.normal(size=(nodes - 1, thrusters))
    return Trajectory(t_s=t_s, x=x, thrust_n=thrust_n, energy_j=0.0, cost_j=0.0, solved=True)


@needs_library
def test_places_on_a_trajectory() -> None:
    rng = np.random.default_rng(6)
    for _ in range(60):
        ours = TrackedTrajectory(_trajectory(rng), None, True)  # type: ignore[arg-type]
        plain = TrackedTrajectory(ours.trajectory, None, True)  # type: ignore[arg-type]
        plain._library = None
        times: FloatArray = np.concatenate([ours.trajectory.t_s, rng.uniform(-1.0, 1.3 * ours.length_s, 30)])
        assert np.allclose(ours._at(times), plain._at(times), rtol=1e-12, atol=1e-12)
        x0, around_s = ours.trajectory.x[0] + rng.normal(size=8), rng.uniform(0.0, ours.length_s)
        for found, meant in zip(ours._nearest(x0, around_s), plain._nearest(x0, around_s), strict=True):
            assert found == pytest.approx(meant, abs=1e-9)


@needs_library
@pytest.mark.parametrize("cells", [0, 1, 40])
def test_the_learned_flow(cells: int, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(cells)
    fit = FlowFit(
        length_m=0.7,
        places_ned_m=rng.normal(size=(cells, 2)),
        pull=rng.normal(size=(2, cells)),
        mean_m_s=rng.normal(size=2),
    )
    places = rng.normal(size=(21, 3))[:, :2]
    ours, quick, plain = fit.flow(places), LearnedCurrent(), LearnedCurrent()
    nav, t_s = nav_state(0, rng.normal(size=8), rng.normal(size=3)), np.linspace(0.0, 40.0, 21)
    along, filled, meant = rng.normal(size=(21, 8))[:, :3], np.zeros((21, 3)), np.zeros((21, 3))
    for forecast in (quick, plain):
        forecast._fit, forecast._trust.share = fit, 0.7
    quick.fill(nav, along, t_s, filled)
    monkeypatch.setenv(compiled.SWITCH, compiled.OFF)
    plain._quick = None
    plain.fill(nav, along, t_s, meant)
    assert np.allclose(ours, fit.flow(places), rtol=1e-11, atol=1e-11)
    assert np.allclose(filled, meant, rtol=1e-11, atol=1e-11)


@needs_library
def test_the_nearest_place_of_a_route(monkeypatch: pytest.MonkeyPatch) -> None:
    rng, found = np.random.default_rng(9), []
    routes = [np.cumsum(rng.normal(size=(rng.integers(1, 9), 2)) * rng.uniform(0.0, 1.0), axis=0) for _ in range(80)]
    asked = [(rng.normal(size=2), rng.uniform(-0.2, 1.2), rng.uniform(0.1, 2.0)) for _ in range(80)]
    for switch in ("", compiled.OFF):
        monkeypatch.setenv(compiled.SWITCH, switch)
        made = [Route(corners) for corners in routes]
        found.append([r.project(p, share * r.length_m, w) for r, (p, share, w) in zip(made, asked, strict=True)])
    assert np.allclose(*found, rtol=1e-11, atol=1e-11)


@needs_library
@pytest.mark.parametrize("value", HOSTILE)
def test_what_is_no_number_stays_none(value: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """A clamp that takes the other number makes full thrust of NaN."""
    rng, grid, thrusters = np.random.default_rng(5), geometric_grid(), 4
    model = drawn(rng, thrusters).to_model()
    ancillary, response = Ancillary(model), Response([0.15] * thrusters)
    compiled_parts = ThrusterLag(model, response), InnerLoop(ancillary, grid)
    monkeypatch.setenv(compiled.SWITCH, compiled.OFF)
    plain_parts = ThrusterLag(model, response), InnerLoop(ancillary, grid)
    for turn in range(40):
        given = [rng.normal(size=8), 0.2 * rng.normal(size=3), rng.uniform(1.0, 9.0, thrusters)]
        plan = [rng.normal(size=(grid.n + 1, 8)), rng.normal(size=(grid.n, thrusters)), 0.1 * rng.normal(size=3)]
        (given if turn % 2 else plan)[turn % 3] = with_one(rng, (given if turn % 2 else plan)[turn % 3], value)
        x, current, limit_n = given
        answers, ahead = [], []
        for lag, inner in (compiled_parts, plain_parts):
            inner.start(0, *plan)
            answers.append(outcome(inner.thrust, 260_000, x, current, limit_n))
            ahead.append(outcome(lag.ahead, x, current))
        assert agree(*answers), (turn, answers)
        # The order of sums differs: where one overflows the other may be just below.
        assert agree(*ahead) or abs(value) == 1e308, (turn, ahead)


@needs_library
def test_thrust_of_a_state_that_is_no_number_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    model = drawn(np.random.default_rng(5), 4).to_model()
    grid = geometric_grid()
    inner = InnerLoop(Ancillary(model), grid)
    inner.start(0, np.zeros((grid.n + 1, 8)), np.zeros((grid.n, 4)), np.zeros(3))
    for place in range(8):
        x = np.zeros(8)
        x[place] = np.nan
        thrust = inner.thrust(20_000, x, np.zeros(3), np.full(4, 9.0))
        assert np.isnan(thrust).any()
        assert not (np.abs(thrust) == 9.0).any(), "no full reverse"


@needs_library
@pytest.mark.parametrize("value", HOSTILE)
def test_no_place_on_a_trajectory_is_made_of_what_is_no_number(value: float) -> None:
    rng = np.random.default_rng(7)
    for turn in range(30):
        ours = TrackedTrajectory(_trajectory(rng), None, True)  # type: ignore[arg-type]
        plain = TrackedTrajectory(ours.trajectory, None, True)  # type: ignore[arg-type]
        plain._library = None
        times = with_one(rng, rng.uniform(0.0, ours.length_s, 9), value)
        assert agree(ours._at(times), outcome(plain._at, times))
        x0, around_s = ours.trajectory.x[0].copy(), rng.uniform(0.0, ours.length_s)
        x0[turn % 2] = value
        with np.errstate(all="ignore"):
            found, expected = ours._nearest(x0, around_s), plain._nearest(x0, around_s)
        assert agree(found[1], expected[1]), (turn, found, expected)
        assert np.isfinite(found[0])


@needs_library
@pytest.mark.parametrize("value", HOSTILE)
def test_no_current_is_made_of_what_is_no_number(value: float) -> None:
    rng = np.random.default_rng(3)
    for turn in range(20):
        arrays = [rng.normal(size=(6, 2)), rng.normal(size=(2, 6)), rng.normal(size=2)]
        along, t_s, here = rng.normal(size=(9, 3)), np.linspace(0.0, 40.0, 9), rng.normal(size=8)
        which = turn % 6
        if which < 3:
            arrays[which] = with_one(rng, arrays[which], value)
        else:
            along, t_s, here[:3] = (
                with_one(rng, each, value) if which == 3 + i else each for i, each in enumerate((along, t_s, here[:3]))
            )
        fit = FlowFit(length_m=0.7, places_ned_m=arrays[0], pull=arrays[1], mean_m_s=arrays[2])
        quick, plain, filled = LearnedCurrent(), LearnedCurrent(), [np.zeros((9, 3)), np.zeros((9, 3))]
        for forecast in (quick, plain):
            forecast._fit, forecast._trust.share = fit, 0.7
        plain._quick = None
        with np.errstate(all="ignore"):
            quick.fill(nav_state(0, here, rng.normal(size=3)), along, t_s, filled[0])
            monkey = pytest.MonkeyPatch()
            monkey.setenv(compiled.SWITCH, compiled.OFF)
            plain.fill(nav_state(0, here, np.zeros(3)), along, t_s, filled[1])
            monkey.undo()
        assert (np.isfinite(filled[0]) == np.isfinite(filled[1])).all() or abs(value) == 1e308, (turn, which)


@needs_library
@pytest.mark.parametrize("value", HOSTILE)
def test_the_nearest_place_of_a_route_of_what_is_no_number(value: float, monkeypatch: pytest.MonkeyPatch) -> None:
    route, asked = np.array([[0.0, 0.0], [1.0, 0.5], [2.0, 0.0]]), np.array([0.4, 0.3, 0.5, 0.6])
    for place in range(4):
        given, found = asked.copy(), []
        given[place] = value
        for switch in ("", compiled.OFF):
            monkeypatch.setenv(compiled.SWITCH, switch)
            made = Route(route)
            found.append(outcome(made.project, given[:2], given[2], given[3]))
        assert agree(found[0], found[1]), (place, found)
