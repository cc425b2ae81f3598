"""Functions of the compiled library against numpy that says what they mean (:mod:`oracles`), with every number of their
arguments as it should be, and in turn one that is none or nearly none: a bound that takes the other number makes full
thrust of NaN."""

import dataclasses
import math
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import oracles
import pytest
from control_loop import MODEL, nav_state
from vehicles import drawn

from autopilot.control.bounds import PlanClearance, ProgramBounds, largest_gap
from autopilot.control.constraints.obstacles import Features
from autopilot.control.current.current_learning import EstimatedFlow, FlowFit
from autopilot.control.energy.track import TrackedTrajectory
from autopilot.control.energy.trajectory import Trajectory
from autopilot.control.nmpc import ocp
from autopilot.control.nmpc.grid import geometric_grid, uniform_grid
from autopilot.control.nmpc.lag import STEPS, ThrusterLag
from autopilot.control.path.reference import ReferenceRollout, ReferenceTarget, Route
from autopilot.control.robust.ancillary import Ancillary
from autopilot.control.robust.inner import InnerLoop
from autopilot.control.robust.margins import Margins
from autopilot.control.robust.tightening import BackOffs
from autopilot.core.control_allocator import ControlAllocator
from autopilot.core.frames import FloatArray
from autopilot.core.geometry import Circle, Fence, Polygon
from autopilot.core.params import ParamSet
from autopilot.core.response import Response
from tests.hostile_numbers import HOSTILE, agree, outcome, with_one

pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning")
with_and_without = pytest.mark.parametrize("value", [None, *HOSTILE])


def _spoil(rng: np.random.Generator, given: dict[str, FloatArray], turn: int, value: float | None) -> str:
    """Replace a number of one argument, each in turn; its name."""
    name = list(given)[turn % len(given)]
    if value is not None:
        given[name] = with_one(rng, given[name], value)
    return name


@with_and_without
@pytest.mark.parametrize("per_node", [False, True])
def test_bounds_of_a_program(per_node: bool, value: float | None) -> None:
    rng, grid, thrusters = np.random.default_rng(2), uniform_grid(9), 7
    bounds = ProgramBounds(grid, thrusters, 0.2)
    names = ("clearance_m", "depth_m", "planar_speed_m_s", "heave_m_s", "yaw_rate_rad_s")
    for turn in range(44):
        fence = Fence(inclusions=(), exclusions=(), depth_min_m=rng.uniform(0, 0.5), depth_max_m=rng.uniform(0.8, 2))
        given = dict(zip(names, rng.uniform(0.0, 0.6, (5, grid.n - 1)), strict=True))
        given["thrust_n"] = rng.uniform(0.0, 6.0, (grid.n, thrusters))
        given |= {"x0": rng.normal(size=8), "limit_n": rng.choice([0.0, 5.0, 12.0], thrusters)}
        given |= {
            "wished_n": 8.0 * rng.normal(size=(grid.n, thrusters)),
            "plan_n": rng.normal(size=(grid.n, thrusters)),
        }
        given["weight_u"] = rng.uniform(0.1, 1.0, (grid.n, thrusters) if per_node else thrusters)
        hostile = _spoil(rng, given, turn, value)
        off = BackOffs(**{name: given[name] for name in (*names, "thrust_n")})
        now = SimpleNamespace(x0=given["x0"], params=ParamSet(), fence=fence, thrust_limit_n=given["limit_n"])
        wished = SimpleNamespace(thrust_n=given["wished_n"], weight_u=given["weight_u"])
        bounds.fill(off, cast(Any, now), cast(Any, wished), given["plan_n"], 0.2 * (turn % 2))
        for name, expected in oracles.bounds(0.2, off, now, wished, given["plan_n"], 0.2 * (turn % 2)).items():
            assert getattr(bounds, name).shape == expected.shape, name
            assert agree(getattr(bounds, name), expected, 1e-12), (hostile, name)


@with_and_without
def test_room_of_a_plan_and_gaps_between_tables(value: float | None) -> None:
    rng = np.random.default_rng(1)
    x, normals, offsets = np.zeros((12, 8)), np.zeros((11, 3, 2)), np.zeros((11, 3))
    room = PlanClearance(x[1:, :2], normals, offsets)
    for turn in range(45):
        given = {name: rng.normal(size=each.shape) for name, each in (("x", x), ("n", normals), ("d", offsets))}
        hostile = _spoil(rng, given, turn, value)
        x[:], normals[:], offsets[:] = given.values()
        assert agree(room.least_m(), oracles.least_clearance_m(x[1:, :2], normals, offsets), 1e-12), hostile
        other = rng.normal(size=x.shape)
        for b, first, width in ((None, 0, 2), (None, 4, 4), (other, 1, 3)):
            gap = (x if b is None else x - b)[:, first : first + width]
            assert agree(largest_gap(x, b, first, width), float(np.abs(gap).max()), 1e-15), hostile


@with_and_without
@pytest.mark.parametrize("thrusters", [4, 8])
def test_margins_of_the_tube(thrusters: int, value: float | None) -> None:
    rng, grid, params = np.random.default_rng(3), uniform_grid(12), ParamSet()
    tube = Margins(drawn(rng, thrusters).to_model(), grid).tube
    for _ in range(30):
        variance = np.abs(rng.normal(size=12)) * 10.0 ** rng.uniform(-6, 0)
        nav = dataclasses.replace(nav_state(0, rng.normal(size=8)), variance=variance)
        x, still, thrust_n = 0.4 * rng.normal(size=(13, 8)), np.zeros((13, 8)), np.zeros((12, thrusters))
        x[:, 4] = x[:, 4] if value is None else with_one(rng, x[:, 4], value)
        for states, share in ((x, rng.uniform(0.2, 1.0)), (still, 1.0)):
            ours = tube.back_offs(nav, states, thrust_n, params, share)
            theirs = oracles.tube_back_offs(tube, grid, nav, states, params, share)
            for field in dataclasses.fields(ours):
                assert agree(getattr(ours, field.name), getattr(theirs, field.name), 1e-12), field.name
        assert tube.rest_speed_m_s(nav, params) == pytest.approx(ours.planar_speed_m_s[-1], rel=1e-12)


@with_and_without
@pytest.mark.parametrize("thrusters", [4, 6])
def test_thrust_between_two_steps_and_the_state_one_lag_ahead(thrusters: int, value: float | None) -> None:
    rng, grid = np.random.default_rng(thrusters), geometric_grid()
    model = drawn(rng, thrusters).to_model()
    ancillary, response = Ancillary(model), Response([0.15] * thrusters)
    inner, lag = InnerLoop(ancillary, grid), ThrusterLag(model, response)
    interval = ocp.discrete_dynamics(model, response.mean_s, STEPS)
    for turn in range(48):
        given = {"x": 4.0 * rng.normal(size=8), "current": 0.2 * rng.normal(size=3)}
        given |= {"limit_n": rng.uniform(0.0, 9.0, thrusters), "plan": rng.normal(size=(grid.n + 1, 8))}
        given |= {"plan_n": rng.normal(size=(grid.n, thrusters)), "plan_current": 0.1 * rng.normal(size=3)}
        hostile = _spoil(rng, given, turn, value)
        x, current, limit_n, *plan = given.values()
        begin_us, after_us = int(rng.integers(10**6)), int(rng.choice([-1, 0, 10_000, 250_000, 5_000_000, 20_000_000]))
        inner.start(begin_us, *plan)
        found = inner.thrust(begin_us + after_us, x, current, limit_n)
        meant = outcome(oracles.inner_thrust, ancillary, grid, plan, 1e-6 * after_us, x, current, limit_n)
        assert agree(found, meant) or abs(value or 0.0) == 1e308, hostile
        lag.follow(5.0 * rng.normal(size=thrusters), 0.05)
        after = outcome(lambda *a: interval(*a)[0].full().ravel(), x, lag.acting_n, current)
        # The order of sums differs: where one overflows the other may be just below.
        assert agree(lag.ahead(x, current), after) or abs(value or 0.0) == 1e308, hostile


def test_thrust_for_a_state_that_is_no_number_is_none() -> None:
    grid = geometric_grid()
    inner = InnerLoop(Ancillary(MODEL), grid)
    inner.start(0, np.zeros((grid.n + 1, 8)), np.zeros((grid.n, 4)), np.zeros(3))
    for place in range(8):
        x = np.zeros(8)
        x[place] = np.nan
        thrust = inner.thrust(20_000, x, np.zeros(3), np.full(4, 9.0))
        assert np.isnan(thrust).any()
        assert not (np.abs(thrust) == 9.0).any(), "no full reverse"


def _trajectory(rng: np.random.Generator, thrusters: int) -> Trajectory:
    nodes = int(rng.integers(2, 30))
    t_s = np.concatenate([[0.0], np.cumsum(rng.uniform(0.05, 0.6, nodes - 1))])
    x, thrust_n = np.cumsum(0.1 * rng.normal(size=(nodes, 8)), axis=0), rng.normal(size=(nodes - 1, thrusters))
    return Trajectory(t_s=t_s, x=x, thrust_n=thrust_n, energy_j=0.0, cost_j=0.0, solved=True)


@with_and_without
def test_places_on_a_trajectory(value: float | None) -> None:
    rng = np.random.default_rng(6)
    for turn in range(60):
        track = TrackedTrajectory(_trajectory(rng, 4 + 30 * (turn % 2)), None, True)  # type: ignore[arg-type]
        times: FloatArray = np.concatenate([track.trajectory.t_s, rng.uniform(-1.0, 1.3 * track.length_s, 30)])
        x0, around_s = track.trajectory.x[0] + rng.normal(size=8), rng.uniform(0.0, track.length_s)
        if value is not None:
            times, x0[turn % 2] = with_one(rng, times, value), value
        assert agree(track._at(times), oracles.rows_at(track.trajectory, times), 1e-12)
        found, meant = track._nearest(x0, around_s), oracles.nearest_on_trajectory(track.trajectory, x0, around_s)
        assert agree(found[1], meant[1])
        assert np.isfinite(found[0])
        assert value is not None or found[0] == pytest.approx(meant[0], abs=1e-9)


@with_and_without
@pytest.mark.parametrize("cells", [0, 1, 40])
def test_the_learned_flow(cells: int, value: float | None) -> None:
    rng, current = np.random.default_rng(cells), EstimatedFlow()
    for turn in range(18):
        given = {"along": rng.normal(size=(21, 3)), "t_s": np.linspace(0.0, 40.0, 21), "here": rng.normal(size=8)}
        given |= {"mean": rng.normal(size=2)}
        given |= {"places": rng.normal(size=(cells, 2)), "pull": rng.normal(size=(2, cells))} if cells else {}
        hostile = _spoil(rng, given, turn, value if list(given)[turn % len(given)] != "here" else None)
        if hostile == "here" and value is not None:
            given["here"][turn % 3] = value
        along, t_s, here, mean, *cell = given.values()
        places, pull = cell or (np.zeros((0, 2)), np.zeros((2, 0)))
        fit = FlowFit(length_m=0.7, places_ned_m=places, pull=pull, mean_m_s=mean)
        current._fit, current._trust.weight, filled = fit, 0.7, np.zeros((21, 3))
        nav = nav_state(0, here, rng.normal(size=3))
        current.fill(nav, along, t_s, filled)
        meant = oracles.currents(fit, nav, along, t_s, current._length_m, 0.7)
        finite = np.isfinite(filled)
        assert (finite == np.isfinite(meant)).all() or abs(value or 0.0) == 1e308, hostile
        if value is None:
            assert np.allclose(filled, meant, rtol=1e-11, atol=1e-11)
            assert np.allclose(fit.flow(along[:, :2]), oracles.flow(fit, along[:, :2]), rtol=1e-11, atol=1e-11)


@with_and_without
def test_the_nearest_place_of_a_route(value: float | None) -> None:
    rng = np.random.default_rng(9)
    for turn in range(80):
        route = Route(np.cumsum(rng.normal(size=(rng.integers(1, 9), 2)) * rng.uniform(0.0, 1.0), axis=0))
        asked = np.array([*rng.normal(size=2), rng.uniform(-0.2, 1.2) * route.length_m, rng.uniform(0.1, 2.0)])
        if value is not None:
            asked[turn % 4] = value
        found = outcome(route.project, asked[:2], asked[2], asked[3])
        meant = outcome(oracles.nearest_on_route, route.points, asked[:2], asked[2], asked[3])
        assert agree(found, meant), (turn % 4, found, meant)


def _fence(rng: np.random.Generator) -> Fence:
    """A tank, sometimes an octagon or concave, with pillars, islands and sometimes a round outside."""
    angles = np.sort(rng.uniform(0.0, 2.0 * np.pi, rng.integers(4, 8)))
    reach = rng.uniform(2.0, 4.0, len(angles))
    inclusions: list[Polygon | Circle] = [
        Polygon(vertices_ned_m=np.stack([reach * np.cos(angles), reach * np.sin(angles)], axis=1))
    ]
    if rng.random() < 0.3:
        inclusions.append(Circle(center_ned_m=rng.normal(size=2), radius_m=4.0))
    exclusions: list[Polygon | Circle] = [
        Circle(center_ned_m=rng.uniform(-2.0, 2.0, 2), radius_m=rng.uniform(0.0, 0.4))
        for _ in range(rng.integers(0, 4))
    ]
    if rng.random() < 0.5:
        corner = rng.uniform(-1.5, 1.5, 2)
        exclusions.append(Polygon(vertices_ned_m=corner + np.array([[0.0, 0.0], [0.5, 0.1], [0.4, 0.6], [0.2, 0.3]])))
    return Fence(inclusions=tuple(inclusions), exclusions=tuple(exclusions), depth_max_m=2.0)


@with_and_without
def test_half_planes(value: float | None) -> None:
    """In the common case; the others are left to :mod:`autopilot.control.constraints.chords`, the oracle here."""
    rng, quick, turns = np.random.default_rng(8), 0, 90 if value else 400
    for turn in range(turns):
        features, slots, m = Features(_fence(rng)), int(rng.integers(2, 10)), int(rng.integers(1, 20))
        if features.many:
            continue
        x = np.zeros((m + 2, 8))
        x[:, :2] = rng.uniform(-1.0, 1.0, 2) + np.cumsum(rng.normal(size=(m + 2, 2)) * 0.1, axis=0)
        given = {"path": x[: m + 1, :2], "t_s": np.linspace(0.0, 4.0, m + 1), "keep": rng.uniform(0.2, 0.5, m)}
        _spoil(rng, given, turn, value)
        normals, offsets = np.full((m, slots, 2), 7.0), np.full((m, slots), 7.0)
        assert features._quick is not None
        margin = features._quick.margin_m(*given.values(), slots, normals, offsets)
        if margin is None:
            continue
        quick += 1
        assert agree(features._quick.margin_m(*given.values()) or math.nan, margin)
        features._quick, plain_n, plain_d = None, np.zeros_like(normals), np.zeros_like(offsets)
        assert agree(margin, features.half_planes(*given.values(), slots, plain_n, plain_d)), turn
        if value is not None:  # where a number is none rows have no order
            assert (np.isfinite(offsets).sum(axis=1) == np.isfinite(plain_d).sum(axis=1)).all(), turn
            continue
        for row in range(m):
            ours, theirs = (_in_order(n[row], d[row]) for n, d in ((normals, offsets), (plain_n, plain_d)))
            assert np.allclose(ours, theirs, atol=1e-9)
    assert quick > (150 if value is None else 10) or not np.isfinite(value or 0.0)


def test_half_planes_of_many_features() -> None:
    """Beside the path without the compiled library, which leaves out what is a metre away."""
    rng, quick = np.random.default_rng(4), 0
    room = Polygon(vertices_ned_m=np.array([[-9.0, -9.0], [9.0, -9.0], [9.0, 9.0], [-9.0, 9.0]]))
    square = np.array([[0.0, 0.0], [0.5, 0.1], [0.4, 0.6], [0.2, 0.3]])
    for squares in (0, 5, 20, 30, 40) * 4:
        angle, away_m = rng.uniform(0.0, 2.0 * np.pi, 70), rng.uniform(1.2, 5.0, 70)
        places = np.stack([away_m * np.cos(angle), away_m * np.sin(angle)], axis=1)
        pillars = tuple(Circle(center_ned_m=place, radius_m=0.1) for place in places[:30])
        islands = tuple(Polygon(vertices_ned_m=place + square) for place in places[30 : 30 + squares])
        features = Features(Fence(inclusions=(room,), exclusions=(*pillars, *islands)))
        assert features.many and features._quick is not None
        path = np.cumsum(rng.normal(size=(16, 2)) * 0.05, axis=0)
        given = path, np.linspace(0.0, 4.0, 16), np.full(15, 0.3)
        ours, theirs = ((np.zeros((15, 16, 2)), np.zeros((15, 16))) for _ in range(2))
        quick += features._quick.margin_m(*given, 16, *ours) is not None
        margin = features.half_planes(*given, 16, *ours)
        features._quick = None
        assert margin == pytest.approx(features.half_planes(*given, 16, *theirs), abs=1e-9)
        for k in range(15):
            near = [
                _in_order(n[k][chosen], d[k][chosen])
                for n, d in (ours, theirs)
                for chosen in [n[k] @ path[k + 1] - d[k] < 0.9]
            ]
            assert near[0].shape == near[1].shape and np.allclose(*near, atol=1e-9)
    assert quick >= 4


def _in_order(normals: FloatArray, offsets: FloatArray) -> FloatArray:
    """Half-planes of a node (slots, 3), sorted: solvers do not care which is first."""
    rows = np.concatenate([normals, offsets[:, None]], axis=1)
    return rows[np.lexsort(np.round(rows, 6).T)]


def _limits(rng: np.random.Generator, thrusters: int) -> FloatArray:
    """Some thrusters weak, sometimes one lost, sometimes no bound at all."""
    limit_n = rng.uniform(0.5, 15.0, thrusters)
    if rng.random() < 0.3:
        limit_n[rng.integers(thrusters)] = 0.0
    return np.full(thrusters, math.inf) if rng.random() < 0.2 else limit_n


@pytest.mark.parametrize("thrusters", [4, 5, 8])
def test_references_and_the_thrust_that_holds_them(thrusters: int) -> None:
    rng, grid = np.random.default_rng(thrusters), geometric_grid()
    allocator = ControlAllocator(drawn(rng, thrusters).to_model())
    made = ReferenceRollout(allocator, grid.t_s)
    for turn in range(150):
        route = Route(np.cumsum(rng.normal(size=(rng.integers(1, 6), 2)) * rng.uniform(0.0, 2.0), axis=0))
        x0, current = rng.normal(size=8), rng.choice([0.0, 0.1, 0.5]) * rng.normal(size=3)
        target = ReferenceTarget(
            route=route,
            s0_m=float(rng.choice([0.0, route.length_m, rng.uniform(0.0, 1.1) * route.length_m])),
            depth_m=float(rng.choice([x0[2], rng.normal()])),
            yaw_rad=float(rng.choice([x0[3], 4.0 * rng.normal()])),
            cruise_m_s=rng.uniform(0.01, 1.0),
            speed_limit_m_s=rng.uniform(0.05, 0.8),
            heave_limit_m_s=rng.uniform(0.02, 0.5),
            yaw_rate_limit_rad_s=rng.uniform(0.05, 2.0),
            climb_at_once=turn % 3 == 0,
        )
        limit_n = _limits(rng, thrusters)
        x, thrust = made(x0, target, current, limit_n)
        meant = oracles.references(grid.t_s, x0, target, current)
        made(x0 + 1.0, target, current, limit_n)  # an answer is no view of the next one
        assert np.allclose(x, meant, rtol=1e-12, atol=1e-12)
        assert np.allclose(thrust, allocator.hold_n(meant[:-1, 4:], limit_n), rtol=1e-9, atol=1e-9)


TARGET = ReferenceTarget(
    route=Route(np.array([[0.0, 0.0], [1.0, 0.5], [2.0, 0.0]])),
    s0_m=0.3,
    depth_m=0.8,
    yaw_rad=1.0,
    cruise_m_s=0.35,
    speed_limit_m_s=0.4,
    heave_limit_m_s=0.2,
    yaw_rate_limit_rad_s=0.9,
)
NUMBERS = [field.name for field in dataclasses.fields(TARGET) if field.type is float or field.type == "float"]


@pytest.mark.parametrize("value", HOSTILE)
@pytest.mark.parametrize("hostile", [*NUMBERS, "x0", "current"])
def test_no_reference_is_made_of_what_is_no_number(hostile: str, value: float) -> None:
    rng, grid = np.random.default_rng(3), uniform_grid(7)
    made = ReferenceRollout(ControlAllocator(drawn(rng, 4).to_model()), grid.t_s)
    for _ in range(4):
        x0, current, target = rng.normal(size=8), 0.1 * rng.normal(size=3), TARGET
        if hostile == "x0":
            x0[2:4] = with_one(rng, x0[2:4], value)
        elif hostile == "current":
            current = with_one(rng, current, value)
        else:
            target = dataclasses.replace(TARGET, **{hostile: value})
        ours, _ = made(x0, target, current, np.full(4, 9.0))
        theirs = outcome(oracles.references, grid.t_s, x0, target, current)
        if abs(value) == 1e308 and np.ndim(theirs) == 0:
            continue  # an overflow raises in Python, and need not count in the end
        # A state is used as a whole: in which of its numbers it shows is another matter.
        rows = np.isfinite(ours).all(axis=-1) & np.isfinite(theirs).all(axis=-1)
        assert (rows == np.isfinite(ours).all(axis=-1)).all()
        assert agree(ours[rows], np.broadcast_to(theirs, ours.shape)[rows])
        assert not (np.isnan(value) and rows.all())
