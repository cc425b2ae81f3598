"""The check of all plans: one function of frozen data, cheap enough for hostile plans, and it can be called off."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from autopilot.core.background import Cancel, WithdrawnError
from autopilot.core.geometry import Circle, Polygon, Shape
from autopilot.core.params import ParamSet
from autopilot.core.plan import MAX_ITEMS, MissionResult, PlanItem, PlanKind
from autopilot.core.shapes import boundary_gap_m, boundary_point, clearance_m
from autopilot.mission.clearance import Clearance
from autopilot.mission.fence import read_fence
from autopilot.mission.gaps import narrow_gaps
from autopilot.mission.plan_check import PLAN_PARAMETERS, PlanCheckInputs, PlanVerdict, judge
from autopilot.mission.store import CHECK_TICKS, Plans
from tests.plan_items import ORIGIN, RADIUS_M, box, circle, context, local, plain, polygon, tank, waypoint

MOST = MAX_ITEMS[PlanKind.FENCE]


def question(mission: list[PlanItem], fence: list[PlanItem], rally: list[PlanItem], **params: float) -> PlanCheckInputs:
    plans = {PlanKind.MISSION: tuple(mission), PlanKind.FENCE: tuple(fence), PlanKind.RALLY: tuple(rally)}
    values = ParamSet(params)
    return PlanCheckInputs(
        plans={kind: tuple(replace(item, seq=k) for k, item in enumerate(items)) for kind, items in plans.items()},
        origin=ORIGIN,
        limits=tuple(values[name] for name in PLAN_PARAMETERS),
        radius_m=RADIUS_M,
        goal_margin_m=values["MPC_MARGIN"],
    )


def judged(
    mission: list[PlanItem], fence: list[PlanItem] | None = None, rally: list[PlanItem] | None = None, **params: float
) -> PlanVerdict:
    return judge(question(mission, fence or [], rally or [], **params), Cancel())


def octagons(count: int) -> list[PlanItem]:
    side = math.ceil(math.sqrt(count))
    items = box(0, 1.5 * side, 1.5 * side, 1.5 * side + 2.0, 1.5 * side + 2.0, True)
    for k in range(count):
        north, east = 3.0 * (k // side) + 1.5, 3.0 * (k % side) + 1.5
        rim = [(north + 0.8 * math.cos(a), east + 0.8 * math.sin(a)) for a in np.arange(8) * math.pi / 4]
        items += polygon(len(items), rim)
    return items


def test_the_answer_brings_what_the_vehicle_needs_of_the_plans() -> None:
    verdict = judged([waypoint(0, -1.0, 0.0), waypoint(1, 1.0, 0.0)], [*tank(), circle(4, 0.0, 0.0, 0.2)])
    assert verdict.problem == "" and verdict.own == verdict.joint == verdict.warnings == ()
    assert [step.seq for step in verdict.steps] == [0, 1]
    assert len(verdict.shapes) == 2
    assert [name for name, _ in verdict.goal_clearance_m] == ["item 0", "item 1"]
    assert verdict.goal_clearance_m[0][1] == pytest.approx(1.0 - 0.2 - RADIUS_M)
    assert 0.5 < verdict.widest_m < 1.2


@pytest.mark.parametrize("looks", range(5))
def test_a_check_that_is_not_wanted_any_more_ends_at_its_next_step(looks: int) -> None:
    class After(Cancel):
        """Called off after so many looks."""

        @property
        def requested(self) -> bool:  # type: ignore[override]
            self.left -= 1
            return self.left < 0

    cancel = object.__new__(After)
    cancel.left = looks  # type: ignore[attr-defined]
    with pytest.raises(WithdrawnError):
        judge(question([waypoint(0, -1.0, 0.0)], octagons(4), []), cancel)


rng = np.random.default_rng(3)
STAR = [((20 + 3 * (k % 2)) * math.cos(k / 250 * math.tau), 20 * math.sin(k / 250 * math.tau)) for k in range(1000)]
HOSTILE: dict[str, Callable[[], PlanCheckInputs]] = {
    "dots side by side": lambda: question([], [circle(k, *rng.uniform(0.0, 0.6, 2), 0.001) for k in range(MOST)], []),
    "dots, tolerated": lambda: question(
        [], [circle(k, *rng.uniform(0.0, 0.6, 2), 0.001) for k in range(MOST)], [], FENCE_GAP_CHK=0
    ),
    "one upon the other": lambda: question(
        [], [item for k in range(250) for item in box(4 * k, 0, 0, 1, 1, False)], []
    ),
    "rings": lambda: question([], [circle(k, 0.0, 0.0, 0.5 * (k + 1)) for k in range(500)], []),
    "a ring of no width": lambda: question(
        [waypoint(0, 3000.0, 0.0)], [circle(0, 0.0, 0.0, 2e4, True), circle(1, 0.0, 0.0, 2e4)], []
    ),
    "a polygon of a thousand corners": lambda: question(
        [waypoint(0, 0, 0)] * 20, polygon(0, [(a * (1 + k / 5000), b) for k, (a, b) in enumerate(STAR[:250])], True), []
    ),
    "jumps": lambda: question([plain(k, 177, (k + 1) % MOST, -1) for k in range(MOST)], [], []),
    "octagons and many items": lambda: question([waypoint(k, 0.0, 0.0) for k in range(500)], octagons(50), []),
    "every item in every obstacle": lambda: question(
        [waypoint(k, 0.0, 0.0) for k in range(500)], [circle(k, 0.0, 0.0, 5.0) for k in range(500)], []
    ),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_a_plan_that_is_made_to_take_long_is_answered(name: str) -> None:
    """Some of these once took minutes: pairs of shapes, items times shapes, and texts grew with the square."""
    verdict = judge(HOSTILE[name](), Cancel())
    assert len(verdict.own) + len(verdict.joint) + len(verdict.warnings) <= 2 * MOST


ACROSS = [waypoint(0, -1.5, 0.0)] * 11 + [waypoint(0, 1.5, 0.0)]
PILLARS = [circle(k, 9.0, 3.0 * k, 0.2) for k in range(99)]
"""Far off: they make item numbers long."""


@pytest.mark.parametrize(
    "verdict",
    [
        judged([waypoint(0, 0.0, 0.0)] * 100 + [waypoint(0, -9.0, 0.0)], tank()),
        judged([waypoint(0, 0.0, 0.0)] * 100 + [waypoint(0, -2.3, 0.0)], [*PILLARS, *tank()]),
        judged([waypoint(0, 0.0, 0.0)] * 100 + [waypoint(0, 0.0, 0.0, depth=1.3)], tank()),
        judged(ACROSS, [*tank(), *box(4, 0.0, 0.0, 0.1, 1.6, False)]),
        judged([waypoint(0, 0.0, 0.0)], tank(), [local(0, 5100, 0.0, 0.0)] * 12 + [local(0, 5100, 9.0, 0.0)]),
        judged([*ACROSS[:11], *ACROSS], [*PILLARS, *tank(), *box(4, 0.0, 0.2, 0.1, 1.2, False)]),
        judged([], box(0, 0.0, 0.0, 0.2, 0.2, True)),
    ],
    ids=["outside", "too near", "too deep", "no way", "rally point", "gap", "no room"],
)  # fmt: skip
def test_reason_and_remedy_come_first(verdict: PlanVerdict) -> None:
    """Ground stations show 100 characters; the longest prefix is "Mission refused: "."""
    prefix = "No start: " if verdict.joint else "Mission refused: "
    shown = (prefix + verdict.problem)[:100]
    assert any(remedy in shown for remedy in (": move ", ": widen ", ": enlarge ", ": use ")), shown


coordinate = st.floats(-4.0, 4.0)
circles = st.builds(
    lambda n, e, r: Circle(center_ned_m=np.array([n, e]), radius_m=r), coordinate, coordinate, st.floats(0.01, 3.0)
)
stars = st.builds(
    lambda n, e, radii: Polygon(
        vertices_ned_m=np.array(
            [
                (n + r * math.cos(k / len(radii) * math.tau), e + r * math.sin(k / len(radii) * math.tau))
                for k, r in enumerate(radii)
            ]
        )
    ),
    coordinate,
    coordinate,
    st.lists(st.floats(0.1, 2.0), min_size=3, max_size=9),
)


@settings(max_examples=60)
@given(
    st.lists(st.tuples(st.one_of(circles, stars), st.booleans()), min_size=1, max_size=5),
    st.lists(st.tuples(coordinate, coordinate), min_size=1, max_size=20),
    st.floats(0.05, 2.0),
)
def test_the_room_of_many_shapes_is_that_of_each(
    shapes: list[tuple[Shape, bool]], places: list[tuple[float, float]], reach_m: float
) -> None:
    points = np.array(places)
    room = Clearance(shapes)
    # Places that are on a boundary to the last digit may count as either.
    one_by_one = np.stack([clearance_m(s, points) * (-1.0 if inside else 1.0) for s, inside in shapes], axis=1)
    np.testing.assert_allclose(room.of_shapes_m(points), one_by_one, atol=1e-9)
    near, slope = room.near(points, reach_m)
    np.testing.assert_allclose(near, np.clip(one_by_one.min(axis=1), -reach_m, reach_m), atol=1e-9)
    clear = np.abs(near) > 1e-3  # on a boundary either side may be meant
    uphill = room.clearance_m(points + 1e-6 * slope) - near
    inner = clear & (np.abs(near) < reach_m - 1e-3)
    assert np.all(uphill[inner] > -1e-9), "the slope leads away from boundaries"


@settings(max_examples=40)
@given(
    st.lists(st.one_of(circles, stars), min_size=9, max_size=25),
    st.lists(st.tuples(coordinate, coordinate), max_size=40),
    st.floats(0.05, 2.0),
)
def test_many_shapes_together_are_what_they_are_one_by_one(
    shapes: list[Shape], places: list[tuple[float, float]], reach_m: float
) -> None:
    points = np.array(places).reshape(-1, 2)
    near, slope = Clearance([(shape, False) for shape in shapes]).near(points, reach_m)
    alone = [Clearance([(shape, False)]).near(points, reach_m) for shape in shapes]
    least = np.argmin([clearance for clearance, _ in alone], axis=0)
    for k, which in enumerate(least.tolist()):
        assert near[k] == alone[which][0][k] and np.array_equal(slope[k], alone[which][1][k])


@settings(max_examples=40)
@given(st.lists(st.tuples(coordinate, coordinate, st.floats(0.05, 1.5), st.booleans()), min_size=1, max_size=9))
def test_gaps_to_the_edge_of_the_workspace_are_all_found(things: list[tuple[float, float, float, bool]]) -> None:
    """Shapes far from the edge are left out before anything is computed of them."""
    items = box(0, 0.0, 0.0, 4.0, 3.0, True)
    for north, east, size, square in things:
        seq = len(items)
        items += box(seq, north, east, size, size, False) if square else [circle(seq, north, east, size)]
    shapes, problems = read_fence(items, ORIGIN)
    assert not problems
    found = {gap.second.seq for gap in narrow_gaps(shapes, 2.0 * RADIUS_M) if gap.first.inclusion}
    for shape in shapes[1:]:
        lone = {gap.second.seq for gap in narrow_gaps([shapes[0], shape], 2.0 * RADIUS_M)}
        width, _ = boundary_gap_m(shapes[0].shape, shape.shape)
        inside = clearance_m(shapes[0].shape, boundary_point(shape.shape)[None])[0] < 0.0
        assert bool(lone) == (inside and 0.02 < width < 2.0 * RADIUS_M)
        assert lone >= found & {shape.seq}


@settings(max_examples=40)
@given(st.lists(st.tuples(coordinate, coordinate, st.floats(0.05, 0.6)), min_size=2, max_size=7))
def test_gaps_of_pillars_are_those_of_pairs(pillars: list[tuple[float, float, float]]) -> None:
    """All at once and two by two; what pillars that touch have between them is no gap."""
    shapes, problems = read_fence([circle(k, *pillar) for k, pillar in enumerate(pillars)], ORIGIN)
    assert not problems
    found = {(gap.first.seq, gap.second.seq): gap for gap in narrow_gaps(shapes, 2.0 * RADIUS_M)}
    for (i, j), gap in found.items():
        width, middle = boundary_gap_m(shapes[i].shape, shapes[j].shape)
        assert gap.width_m == pytest.approx(width) and 0.0 < width < 2.0 * RADIUS_M
        np.testing.assert_allclose(gap.middle_ned_m, middle, atol=1e-9)
    assert list(found) == sorted(found)
    for i, a in enumerate(shapes):
        for j in range(i + 1, len(shapes)):
            width, middle = boundary_gap_m(a.shape, shapes[j].shape)
            alone = all(
                clearance_m(s.shape, middle[None])[0] > 0.0 for k, s in enumerate(shapes) if k not in (i, j)
            ) and all(boundary_gap_m(s.shape, t.shape)[0] > 0.03 for s in shapes for t in shapes if s is not t)
            if alone and 0.03 < width < 2.0 * RADIUS_M - 1e-6:
                inside = np.hypot(*(a.shape.center_ned_m - shapes[j].shape.center_ned_m)) < max(  # type: ignore[union-attr]
                    a.shape.radius_m,
                    shapes[j].shape.radius_m,  # type: ignore[union-attr]
                )
                assert (i, j) in found or inside


def test_what_is_asked_is_what_parameters_are_looked_at() -> None:
    """No check may look at a parameter that does not belong to the question: its answer would outlive the parameter."""
    assert set(question([], [], []).context.params) == set(PLAN_PARAMETERS)
    assert set(PLAN_PARAMETERS) <= set(context().params)


def test_a_change_that_is_called_off_is_not_taken() -> None:
    from autopilot.core.background import BackgroundWorker

    store = Plans(ParamSet(), RADIUS_M, ORIGIN, worker=BackgroundWorker())
    first = store.propose({PlanKind.FENCE: tuple(tank())})
    second = store.propose({PlanKind.MISSION: (waypoint(0, 0.0, 0.0),)})
    assert first.done and first.rejection is not None and "send it again" in first.rejection.reason
    second.cancel()
    for _ in range(10):
        store.tick()
    assert store.revision == 0 and store.items(PlanKind.MISSION) == store.items(PlanKind.FENCE) == ()
    third = store.propose({PlanKind.FENCE: tuple(tank())})
    for _ in range(10):
        store.tick()
    assert third.done and third.rejection is None and store.revision == 1
    third.cancel()
    assert third.rejection is None, "what is done is done"


def test_a_decision_that_fails_is_an_answer_and_not_the_end_of_all_uploads() -> None:
    """What the guard of the plans raises goes on up; whoever waits for the change hears of it."""
    from autopilot.core.background import BackgroundWorker

    store = Plans(ParamSet(), RADIUS_M, ORIGIN, worker=BackgroundWorker())

    def broken(kinds: object, verdict: PlanVerdict) -> None:
        raise ZeroDivisionError

    fine, store.guard = store.guard, broken
    plan = tuple(tank())
    change = store.propose({PlanKind.FENCE: plan})
    with pytest.raises(ZeroDivisionError):
        for _ in range(2 * CHECK_TICKS):
            store.tick()
    assert change.done and change.rejection is not None and change.rejection.result is MissionResult.ERROR
    assert "send the plan again" in change.rejection.reason
    store.guard = fine
    change = store.propose({PlanKind.FENCE: plan})
    for _ in range(2 * CHECK_TICKS):
        store.tick()
    assert change.done and change.rejection is None and store.items(PlanKind.FENCE) is plan
