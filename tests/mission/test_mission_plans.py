"""Whole plans: the paper's is taken. What is wrong by itself is refused with item, reason and remedy, and the old plan
stays; what is wrong only between plans is stored, and said to forbid flying."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from autopilot.core.geodesy import Origin
from autopilot.core.geometry import Circle, Polygon
from autopilot.core.params import ParamSet
from autopilot.core.plan import MAX_ITEMS, MissionResult, PlanItem, PlanKind
from autopilot.mission.fence import fence_clearance_m
from autopilot.mission.mission_tuning import VALIDATION
from autopilot.mission.paper import paper_plan
from autopilot.mission.store import Plans, plan_checksum
from tests.plan_items import NAN, ORIGIN, RADIUS_M, box, circle, local, nav, plain, polygon, tank, waypoint

R = MissionResult

MOST = MAX_ITEMS[PlanKind.MISSION]


def plans(**overrides: float) -> Plans:
    return Plans(ParamSet(overrides), RADIUS_M, ORIGIN)


@pytest.fixture(name="store")
def store_fixture() -> Plans:
    return plans()


def fenced(items: list[PlanItem], **overrides: float) -> Plans:
    store = plans(**overrides)
    assert store.replace(PlanKind.FENCE, tuple(items)) is None
    return store


def numbered(*groups: list[PlanItem] | PlanItem) -> list[PlanItem]:
    flat = [item for group in groups for item in (group if isinstance(group, list) else [group])]
    return [replace(item, seq=k) for k, item in enumerate(flat)]


def test_the_papers_plan_is_taken_and_means_what_the_paper_says(store: Plans) -> None:
    plan = paper_plan()
    assert store.replace(PlanKind.FENCE, plan.fence) is None
    assert store.replace(PlanKind.MISSION, plan.mission) is None
    fence = store.fence()
    (workspace,) = fence.inclusions
    assert isinstance(workspace, Polygon)
    corners = {tuple(np.round(v, 2).tolist()) for v in workspace.vertices_ned_m}
    assert corners == {(-2.5, -1.5), (2.5, -1.5), (2.5, 1.5), (-2.5, 1.5)}
    first, second = fence.exclusions
    assert isinstance(first, Circle)
    assert isinstance(second, Circle)
    assert first.center_ned_m == pytest.approx([-0.625, -0.625], abs=0.006)
    assert second.center_ned_m == pytest.approx([0.9375, 0.0], abs=0.006)
    assert (first.radius_m, second.radius_m) == (0.16, 0.16)
    assert (fence.depth_min_m, fence.depth_max_m) == (0.05, 1.2)
    assert [type(s).__name__ for s in store.steps()] == ["GoTo", "GoTo", "GoTo", "Jump"]


def test_mission_and_fence_in_the_other_order(store: Plans) -> None:
    assert store.replace(PlanKind.MISSION, paper_plan().mission) is None
    assert store.replace(PlanKind.FENCE, paper_plan().fence) is None
    assert store.problem == ""


@pytest.mark.parametrize(
    ("mission", "words"),
    [
        (
            [waypoint(0, -1.6, 0), waypoint(1, 0.9, 0.1)],
            "item 1 is 0.05 m inside exclusion circle (fence item 5): move it 0.35 m (at north 0.90, east 0.10 m",
        ),
        ([waypoint(0, -0.625, -0.25)], "item 0 is only 0.21 m from exclusion circle (fence item 4): move it 0.09 m"),
        ([waypoint(0, 3.0, 0)], "item 0 is 0.50 m outside inclusion polygon (fence item 0): move it 0.80 m"),
        ([waypoint(0, 2.3, 0)], "item 0 is only 0.20 m inside inclusion polygon (fence item 0): move it 0.10 m"),
        ([local(0, 21, 3.0, 0.0)], "item 0 is 0.50 m outside"),
        ([local(0, 179, 0.9375, 0.0, 0, (0, 0, 0, 0))], "home of item 0 is 0.15 m inside"),
    ],
)
@pytest.mark.parametrize("fence_first", [True, False])
def test_a_mission_that_the_fence_forbids_is_stored_and_not_flown(
    mission: list[PlanItem], words: str, fence_first: bool
) -> None:
    store = plans()
    new = {PlanKind.MISSION: tuple(mission), PlanKind.FENCE: paper_plan().fence}
    for kind in (PlanKind.FENCE, PlanKind.MISSION) if fence_first else new:
        assert store.problem == ""
        assert store.replace(kind, new[kind]) is None
        assert store.items(kind) is new[kind]
    assert store.problem.startswith(words), store.problem
    assert "\n" not in store.problem
    assert store.replace(PlanKind.MISSION, paper_plan().mission) is None
    assert store.problem == ""


@pytest.mark.parametrize(
    ("mission", "seq", "result", "words"),
    [
        ([waypoint(0, 0, 0.9, depth=1.3)], 0, R.INVALID_PARAM7, "DEPTH_MAX 1.2"),
        ([waypoint(0, 0, 0.9, depth=0.0)], 0, R.INVALID_PARAM7, "DEPTH_MIN 0.05"),
        ([waypoint(0, 0, 0.9, depth=-0.5)], 0, R.INVALID_PARAM7, "above the surface"),
        ([waypoint(0, 0, 0.9, depth=NAN)], 0, R.INVALID_PARAM7, "nan"),
        ([plain(0, 178, 1, 0.7), waypoint(1, 0, 0.9)], 0, R.INVALID_PARAM2, "SPD_PLANAR_MAX"),
        ([waypoint(0, 0, 0.9), plain(1, 177, 2, 1)], 1, R.INVALID_PARAM1, "does not exist"),
        ([plain(0, 178, 1, 0.3), plain(1, 177, 0, -1)], 1, R.INVALID, "for ever; put a waypoint in between"),
        ([plain(0, 177, 1, -1), plain(1, 177, 0, -1), waypoint(2, 0, 0.9)], 0, R.INVALID, "for ever"),
        ([waypoint(0, 0, 0.9), waypoint(2, 0, 0.9)], 2, R.INVALID_SEQUENCE, "number the items"),
    ],
)
def test_bad_missions_are_refused_and_the_old_one_stays(
    mission: list[PlanItem], seq: int, result: MissionResult, words: str
) -> None:
    store = fenced(list(paper_plan().fence))
    assert store.replace(PlanKind.MISSION, paper_plan().mission) is None
    before, id_before = store.items(PlanKind.MISSION), store.checksum(PlanKind.MISSION)
    rejection = store.replace(PlanKind.MISSION, tuple(mission))
    assert rejection is not None
    assert (rejection.seq, rejection.result) == (seq, result)
    assert words in rejection.reason
    assert "\n" not in rejection.reason
    assert store.items(PlanKind.MISSION) is before
    assert store.checksum(PlanKind.MISSION) == id_before
    assert len(store.steps()) == 4


def test_too_many_items() -> None:
    mission = tuple(waypoint(k, 0.0, 0.9) for k in range(MOST + 1))
    rejection = plans().replace(PlanKind.MISSION, mission)
    assert rejection is not None
    assert rejection.result is R.NO_SPACE
    assert plans().replace(PlanKind.MISSION, mission[:-1]) is None


@pytest.mark.parametrize(
    ("fence", "seq", "result", "words"),
    [
        (tank()[:3], 0, R.INVALID_PARAM1, "3 of 4 vertices"),
        ([*tank()[:3], circle(3, 0, 0, 0.2)], 0, R.INVALID_PARAM1, "3 of 4 vertices"),
        (polygon(0, [(0, 0), (2, 2), (2, 0), (0, 2)]), 0, R.INVALID, "intersects itself"),
        (polygon(0, [(0, 0), (0, 0), (2, 2)]), 0, R.INVALID, "intersects itself"),
        (polygon(0, [(0, 0), (1, 1), (1, 1.0005)]), 0, R.INVALID, "no area"),
        (box(0, 0, 0, 0.25, 0.25, True), 0, R.INVALID, "no room"),
        ([*tank(), circle(4, 0, 0, 3.5)], 0, R.INVALID, "no room"),
        ([circle(0, -2, 0, 1.0, True), circle(1, 2, 0, 1.0, True)], 0, R.INVALID, "no room"),
        ([replace(circle(0, 0, 0, 1.0), z=NAN, param1=-1.0)], 0, R.INVALID_PARAM1, "radius"),
        ([circle(0, 0, 0, 1e5, True)], 0, R.INVALID_PARAM1, "radius (param1) is 100000 m; give more than 0, up to"),
    ],
)
def test_bad_fences_are_refused_and_the_old_one_stays(
    fence: list[PlanItem], seq: int, result: MissionResult, words: str
) -> None:
    store = fenced(tank())
    rejection = store.replace(PlanKind.FENCE, tuple(fence))
    assert rejection is not None
    assert (rejection.seq, rejection.result) == (seq, result)
    assert words in rejection.reason
    assert "\n" not in rejection.reason
    assert len(store.fence().inclusions) == 1
    assert len(store.items(PlanKind.FENCE)) == 4


def test_narrow_gaps_that_no_leg_needs_are_reported_unless_the_parameter_says_otherwise() -> None:
    for fence, width in (
        ([circle(0, 0, 0, 0.5), circle(1, 1.4, 0, 0.5)], "0.40"),
        ([*box(0, 0, 0, 1, 1, False), *box(4, 2.5, 0, 1, 1, False)], "0.50"),
        ([*tank(), circle(4, 0.0, 1.0, 0.16)], "0.34"),
    ):
        store = fenced(fence)
        (warning,) = store.warnings()
        assert f"gap of {width} m to fence item 0, vehicle is 0.60 m: it does not pass there (at north " in warning
        assert store.problem == ""
        assert fenced(fence, FENCE_GAP_CHK=0).warnings() == ()


@pytest.mark.parametrize(
    "fence",
    [
        [circle(0, 0, 0, 0.5), circle(1, 0.9, 0, 0.5)],
        [circle(0, 0, 0, 0.5), circle(1, 1.0, 0, 0.5)],
        [circle(0, 0, 0, 1.5), circle(1, 0.5, 0, 0.2)],
        [*tank(), circle(4, 0.0, 1.45, 0.16)],
        [*tank(), circle(4, 0.0, 2.0, 0.16)],
        [*tank(), *box(4, 2.6, 0.0, 0.4, 0.2, False)],
        [circle(0, 0, 0, 0.5), circle(1, 1.4, 0, 0.5), *box(2, 0.7, 0.0, 0.5, 0.2, False)],
        [*tank(), circle(4, 0, 0, 0.5), circle(5, 0, 0, 4.0, inclusion=True)],
    ],
    ids=["overlap", "touch", "nested", "at the wall", "outside", "through the wall", "bridged", "two workspaces"],
)
def test_what_is_no_gap_is_not_reported(store: Plans, fence: list[PlanItem]) -> None:
    assert store.replace(PlanKind.FENCE, tuple(fence)) is None
    assert store.warnings() == ()


def test_a_fence_that_forbids_the_mission_in_force_names_the_waypoint(store: Plans) -> None:
    assert store.replace(PlanKind.MISSION, paper_plan().mission) is None
    fence = tuple(numbered(tank(), circle(0, 1.55, 0.0, 0.2)))
    assert store.replace(PlanKind.FENCE, fence) is None
    assert store.problem.startswith("item 1 is ")
    assert "exclusion circle (fence item 4): move it" in store.problem
    assert store.items(PlanKind.FENCE) is fence
    assert store.replace(PlanKind.FENCE, ()) is None
    assert store.problem == ""


def test_a_wall_across_the_tank_leaves_no_path() -> None:
    wall = box(4, 0.0, 0.0, 0.1, 1.6, False)
    store = fenced([*tank(), *wall])
    assert store.replace(PlanKind.MISSION, (waypoint(0, -1.5, 0), waypoint(1, -1, 0.5), waypoint(2, 1.5, 0))) is None
    (problem,) = store.verdict.joint
    assert (problem.kind, problem.seq) == (PlanKind.MISSION, 2)
    assert problem.reason.startswith("no free path from item 1 to item 2: move item 2 or open the fence")
    assert store.replace(PlanKind.MISSION, (waypoint(0, -1.5, 0), waypoint(1, -1, 0.5))) is None
    assert store.problem == ""
    door = box(4, 0.0, -0.4, 0.1, 1.2, False)
    open_ = fenced([*tank(), *door])
    assert open_.replace(PlanKind.MISSION, (waypoint(0, -1.5, 0), waypoint(1, 1.5, 0))) is None
    assert open_.problem == ""


def test_a_place_that_is_always_jumped_over_needs_no_path() -> None:
    wall = box(4, 1.0, 0.0, 0.1, 1.6, False)
    over, beyond = plain(1, 177, 3, -1), waypoint(2, 2.0, 0.0)
    both = ((0, 2), (2, 3))
    for jump, ways in ((over, ()), (replace(over, param2=1.0), both), (replace(over, param2=0.0), both)):
        store = fenced([*tank(), *wall])
        mission = (waypoint(0, -1.5, 0.0), jump, beyond, waypoint(3, 0.0, 0.0), plain(4, 177, 0, -1))
        assert store.replace(PlanKind.MISSION, mission) is None
        found = [problem.reason.partition(":")[0] for problem in store.verdict.joint]
        assert found == [f"no free path from item {a} to item {b}" for a, b in ways]
        here = np.array([-1.5, 0.0, 0.5])
        assert (store.verdict.path_problem(here, 1) == "") == (jump is over)
        assert store.verdict.path_problem(here, 2).startswith("no free path from the vehicle to item 2")


def test_the_way_to_a_home_that_the_mission_sets_is_one_of_its_legs() -> None:
    wall = box(4, 0.0, 0.0, 0.1, 1.6, False)
    for home, cut_off in ((-1.2, False), (1.5, True)):
        store = fenced([*tank(), *wall])
        mission = (waypoint(0, -1.5, 0.0), local(1, 179, home, 0.0), plain(2, 20))
        assert store.replace(PlanKind.MISSION, mission) is None
        assert store.problem.startswith("no free path from item 0 to item 2: ") == cut_off


def test_rally_points_are_checked_against_the_fence() -> None:
    store = fenced(tank())
    assert store.replace(PlanKind.RALLY, (local(0, 5100, 5.0, 0.0),)) is None
    assert store.problem.startswith("rally point 0 is 2.50 m outside")
    assert store.replace(PlanKind.RALLY, (local(0, 5100, 1.0, 0.0),)) is None
    assert store.problem == ""
    assert store.replace(PlanKind.FENCE, tuple(box(0, -5, 0, 2, 2, True))) is None
    assert store.problem.startswith("rally point 0 is 4.00 m outside")
    assert store.replace(PlanKind.RALLY, (local(0, 16, 1.0, 0.0, 0.5),)) is not None


def test_clearing_is_always_possible_and_changes_the_id() -> None:
    store = fenced(tank())
    taken = store.checksum(PlanKind.FENCE)
    revision = store.revision
    assert taken != 0
    assert store.replace(PlanKind.FENCE, ()) is None
    assert store.checksum(PlanKind.FENCE) == 0
    assert store.revision == revision + 1
    fence = store.fence()
    assert (fence.inclusions, fence.exclusions) == ((), ())
    assert fence_clearance_m(fence, np.zeros((2, 2))) == pytest.approx([np.inf, np.inf])


def test_ids_tell_plans_apart_and_nan_is_a_value_like_any_other() -> None:
    a, b = waypoint(0, 1.0, 0.0), waypoint(0, 1.0001, 0.0)
    assert plan_checksum((a,)) != plan_checksum((b,))
    assert plan_checksum((a,)) == plan_checksum((replace(a),))
    assert plan_checksum(()) == 0


def test_the_origin_moves_global_plans_and_not_local_ones(store: Plans) -> None:
    assert store.replace(PlanKind.MISSION, (waypoint(0, 1.0, 0.0),)) is None
    moved = Origin(lat_deg=38.0, lon_deg=23.8)
    assert store.set_origin(moved) is None
    assert store.steps()[0].pos_ned_m == pytest.approx([1.0, 0.0, 0.5])  # type: ignore[union-attr]
    assert store.replace(PlanKind.MISSION, ()) is None
    assert store.set_origin(ORIGIN) is None
    assert store.replace(PlanKind.MISSION, paper_plan().mission) is None
    refused = store.set_origin(Origin(lat_deg=10.0, lon_deg=23.8))
    assert refused is not None
    assert "km from the local origin" in refused.reason
    assert store.origin == ORIGIN


def test_parameters_that_change_later_are_noticed() -> None:
    params = ParamSet()
    store = Plans(params, RADIUS_M, ORIGIN)
    assert store.replace(PlanKind.MISSION, (waypoint(0, 0, 0, depth=1.0),)) is None
    assert store.problem == ""
    params.set("DEPTH_MAX", 0.8)
    assert "DEPTH_MAX 0.8" in store.problem
    assert store.items(PlanKind.MISSION) != ()
    params.set("DEPTH_MAX", 1.0)
    assert store.problem == ""


def test_home_in_both_coordinates(store: Plans) -> None:
    store.set_home(nav(1.0, -2.0, 0.5).pos_ned_m)
    back = store.local_ned_m(store.home.lat_deg, store.home.lon_deg, store.home.alt_m)
    assert back == pytest.approx([1.0, -2.0, 0.5], abs=1e-6)


coordinate = st.floats(-4.0, 4.0)


def test_a_place_that_the_margin_keeps_the_vehicle_from_is_refused() -> None:
    store = fenced(tank())
    near = waypoint(0, -2.2, 0.0)
    assert store.replace(PlanKind.MISSION, (near,)) is None
    assert store.problem == ""
    assert store.replace(PlanKind.MISSION, (replace(near, param2=0.02),)) is None
    assert "only 0.30 m inside" in store.problem
    assert "keeps 0.32 m" in store.problem


def test_a_door_that_the_margin_closes_is_no_way() -> None:
    def rooms(door_m: float) -> Plans:
        half = door_m / 2
        west = [(-2, -1), (-2, 1), (-0.1, 1), (-0.1, half)]
        east = [(0.1, half), (0.1, 1), (2, 1), (2, -1), (0.1, -1), (0.1, -half), (-0.1, -half), (-0.1, -1)]
        return fenced(polygon(0, [*west, *east], True))

    mission = (waypoint(0, -1.0, 0.0), waypoint(1, 1.0, 0.0))
    wide, narrow = rooms(0.75), rooms(0.58)
    assert wide.replace(PlanKind.MISSION, mission) is None
    assert wide.problem == ""
    assert narrow.replace(PlanKind.MISSION, mission) is None
    assert "no free path from item 0 to item 1" in narrow.problem
    assert "keeps 0.33 m" in narrow.problem


@settings(max_examples=40)
@given(
    st.lists(st.tuples(coordinate, coordinate, st.floats(0.05, 1.0)), max_size=6),
    st.lists(st.tuples(coordinate, coordinate), min_size=1, max_size=5),
)
def test_whatever_may_be_flown_keeps_the_vehicle_clear(
    obstacles: list[tuple[float, float, float]], route: list[tuple[float, float]]
) -> None:
    store = plans()
    fence = numbered(box(0, 0, 0, 3.5, 3.5, True), *[circle(0, *o) for o in obstacles])
    if store.replace(PlanKind.FENCE, tuple(fence)) is not None:
        return
    mission = tuple(waypoint(k, x, y) for k, (x, y) in enumerate(route))
    assert store.replace(PlanKind.MISSION, mission) is None
    if not store.problem:
        points = np.array([s.pos_ned_m[:2] for s in store.steps()])  # type: ignore[union-attr]
        assert float(np.min(fence_clearance_m(store.fence(), points))) >= RADIUS_M - 0.0121


def test_a_full_plan_is_taken() -> None:
    pillars = [circle(4 + k, 4.0 * (k // 30), 4.0 * (k % 30), 0.5) for k in range(MAX_ITEMS[PlanKind.FENCE] - 4)]
    fence = [*box(0, 64.0, 58.0, 70.0, 62.0, True), *pillars]
    mission = tuple(waypoint(k, 2.0 + 4.0 * (k // 30 % 30), 2.0 + 4.0 * (k % 28)) for k in range(MOST))
    store = plans()
    assert store.replace(PlanKind.FENCE, tuple(fence)) is None
    assert store.replace(PlanKind.MISSION, mission) is None
    assert store.problem == ""
    assert len(store.steps()) == MOST


def test_the_shipped_plan_is_its_generators_output() -> None:
    from autopilot.mission.local_plan import read_local_plan
    from autopilot.mission.qgc_plan import write_qgc_plan

    folder = Path(__file__).resolve().parents[2] / "sitl" / "scenarios"
    shipped = (folder / "paper.plan").read_text(encoding="utf-8")
    assert shipped == write_qgc_plan(paper_plan())
    toml = (folder / "paper.mission.toml").read_text(encoding="utf-8")
    assert write_qgc_plan(read_local_plan(toml, "paper.mission.toml")) == shipped


def doors(*widths_m: float) -> list[PlanItem]:
    """A basin of rooms in a row along north, 2 m each, with doors of these widths in the walls between."""
    items, half = box(0, float(len(widths_m)), 0.0, len(widths_m) + 1.0, 1.5, True), 1.5
    for k, width_m in enumerate(widths_m):
        wall = 0.5 * (half + 0.1 - 0.5 * width_m)
        for side in (-1.0, 1.0):
            items += box(len(items), 2.0 * k + 1.0, side * (0.5 * width_m + wall), 0.05, wall, False)
    return items


@pytest.mark.parametrize(
    ("widths_m", "goal", "says"),
    [
        ((0.5,), 0.0, ""),
        ((0.7,), 2.0, ""),
        ((0.5,), 2.0, "widen the gap of fence items 4 and 8 (0.50 m, needs 0.66 m; at north "),
        ((0.5, 0.4, 0.9), 6.0, "widen the gap of fence items 12 and 16 (0.40 m, needs 0.66 m; at north 2.95, east"),
        ((0.5, 0.4, 0.9), 2.0, "widen the gap of fence items 4 and 8 (0.50 m"),
        ((0.0,), 2.0, "move item 1 or open the fence"),
    ],
    ids=["no leg needs it", "wide enough", "one", "narrowest of two", "the one on the way", "no gap"],
)
def test_a_gap_matters_where_a_leg_needs_it(store: Plans, widths_m: tuple[float, ...], goal: float, says: str) -> None:
    fence, mission = numbered(doors(*widths_m)), (waypoint(0, 0.0, 0.4), waypoint(1, goal, 0.5))
    assert store.replace(PlanKind.FENCE, tuple(fence)) is None
    assert store.replace(PlanKind.MISSION, mission) is None
    assert store.problem.startswith(f"no free path from item 0 to item 1: {says}" if says else "")
    assert bool(store.problem) is bool(says)


def test_the_way_to_the_first_place_is_one_of_the_mission(store: Plans) -> None:
    store.replace(PlanKind.FENCE, tuple(numbered(doors(0.5, 0.8))))
    store.replace(PlanKind.MISSION, (waypoint(0, 2.0, 0.0), waypoint(1, 4.0, 0.0)))
    verdict = store.verdict
    assert verdict.problem == ""
    assert verdict.path_problem(np.array([0.0, 0.0, 0.3]), 0).startswith(
        "no free path from the vehicle to item 0: move"
    )
    for north, first in ((2.5, 0), (4.5, 0), (4.5, 1)):
        assert verdict.path_problem(np.array([north, 0.0, 0.3]), first) == ""


@pytest.mark.parametrize("margin_m", [0.0, 0.03, 0.2])
def test_a_place_needs_the_controllers_margin_less_what_its_acceptance_allows(margin_m: float) -> None:
    wall, accept_m = 2.5, 0.1
    for spare_m in (-0.02, 0.02):
        north = wall - RADIUS_M - max(0.0, margin_m - VALIDATION.approach_fraction * accept_m) - spare_m
        store = Plans(ParamSet({"WP_ACCEPT_RADIUS": accept_m}), RADIUS_M, ORIGIN, goal_margin_m=lambda: margin_m)
        store.replace(PlanKind.FENCE, tuple(numbered(tank())))
        store.replace(PlanKind.MISSION, (waypoint(0, north, 0.0),))
        assert bool(store.problem) is (spare_m < 0.0), store.problem
