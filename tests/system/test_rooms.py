"""Rooms: made out of a seed, judged apart from the service, flown, kept and resumed."""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from autopilot.campaign.worlds.distance_map import DistanceMap
from autopilot.campaign.worlds.random_world import KINDS, RandomWorld, files_of, make_world, write_files
from autopilot.campaign.worlds.reachability import prospect
from autopilot.campaign.worlds.world_flight import Flown, WorldTask, fly_world
from autopilot.campaign.worlds.world_judge import judge_flight, judge_refusal
from autopilot.campaign.worlds.world_results import WorldOutcome, WorldResult, read_flights
from autopilot.campaign.worlds.world_shapes import Block, Disc, Point, WorldLayout, box, clearance_m
from autopilot.core.frames import FloatArray
from autopilot.core.params import ParamSet
from autopilot.mission.plan_files import read_plan
from autopilot.run.plan_verdict import verdict_of
from autopilot.sitl.scenario import load_scenario
from autopilot.sitl.simulated_waters import build_world
from tests.short_campaign import command

SEEDS = range(3_000, 3_024)
HALL = ((0.0, -4.0), (12.0, -4.0), (12.0, 4.0), (0.0, 4.0))


def written(room: RandomWorld, folder: Path, mode: int = 0) -> Path:
    write_files(room, folder, mode=mode, duration_s=60.0)
    return folder


def hall_with_door(width_m: float) -> WorldLayout:
    """Two halves of a hall with a wall between them and a door at its middle."""
    half = 0.5 * width_m
    walls = [box((6.0, side * 0.5 * (4.1 + half)), 0.2, 4.1 - half, 0.0) for side in (-1.0, 1.0)]
    return WorldLayout(HALL, tuple(Block(wall) for wall in walls))


def still(places: FloatArray) -> FloatArray:
    return np.zeros((1, len(places), 2))


def stream(places: FloatArray) -> FloatArray:
    """0.3 m/s from the north."""
    return np.broadcast_to(np.array((-0.3, 0.0)), (1, len(places), 2))


def test_a_seed_gives_the_same_files_each_time_and_files_that_the_service_reads(tmp_path: Path) -> None:
    kinds, waters = set(), set()
    for seed in SEEDS:
        room = make_world(seed)
        assert files_of(room, mode=1, duration_s=9.0) == files_of(make_world(seed), mode=1, duration_s=9.0)
        folder = written(room, tmp_path, mode=1)
        scenario = load_scenario(str(folder / "scenario.toml"))
        build_world(scenario)
        assert scenario.params["MPC_COST"] == 1
        assert scenario.tank is None or len(scenario.obstacle) == len(room.layout.solids)
        plan = read_plan(folder / "plan.toml")
        assert 2 <= sum(item.command == 16 for item in plan.mission) <= 6
        kinds.add(room.kind)
        waters.add(room.scenario["current"]["kind"])
    assert kinds == set(KINDS)
    assert len(waters) >= 5


def test_a_vehicle_begins_with_more_room_than_it_keeps() -> None:
    for seed in SEEDS:
        room = make_world(seed)
        assert clearance_m(room.layout, room.start_m) > room.vehicle.radius_m + 0.03


@settings(max_examples=12, deadline=None)
@given(st.integers(0, 10**6))
def test_the_chart_and_the_shapes_agree_on_clearances(seed: int) -> None:
    room = make_world(seed)
    chart = DistanceMap(room.layout, [room.start_m])
    rng = np.random.default_rng(seed)
    for _ in range(40):
        offset = rng.uniform(-5.0, 5.0, 2)
        place = (room.start_m[0] + float(offset[0]), room.start_m[1] + float(offset[1]))
        exact = clearance_m(room.layout, place)
        if 0.0 < exact < 5.0:
            assert chart.clearance_m(place) == pytest.approx(exact, abs=2.2 * chart.pixel_m + 0.005)


@pytest.mark.parametrize(("width_m", "open_"), [(0.6, False), (0.8, True), (3.0, True)])
def test_a_door_lets_through_what_it_is_wide_enough_for(width_m: float, open_: bool) -> None:
    here, there = (2.0, 0.0), (10.0, 1.0)
    chart = DistanceMap(hall_with_door(width_m), [here, there])
    regions = chart.regions(0.33)
    assert bool(chart.regions_near(regions, here, 0.1) & chart.regions_near(regions, there, 0.1)) is open_
    way = chart.paths(0.33, [here, there]).quickest(here, there, 0.2, still, water_m_s=0.5, ground_m_s=0.4, worst=True)
    assert math.isfinite(way.time_s) is open_


@pytest.mark.parametrize(
    ("goal", "expected_m_s"), [((10.0, 0.0), 0.2), ((1.0, 0.0), 0.8), ((6.0, 3.0), 0.4)], ids=["up", "down", "across"]
)
def test_ways_in_a_stream_take_as_long_as_the_triangle_of_speeds_says(goal: Point, expected_m_s: float) -> None:
    here = (6.0, -3.0) if goal[1] else (5.5, 0.0)
    chart = DistanceMap(WorldLayout(HALL), [here, goal])
    way = chart.paths(0.33, [here, goal]).quickest(here, goal, 0.16, stream, water_m_s=0.5, ground_m_s=9.0, worst=True)
    assert way.time_s == pytest.approx(math.dist(here, goal) / expected_m_s, rel=0.08)


def test_water_faster_than_the_vehicle_leaves_no_way_up() -> None:
    ways = DistanceMap(WorldLayout(HALL), []).paths(0.33, [(5.0, 0.0), (10.0, 0.0)])
    assert math.isinf(
        ways.quickest((5.0, 0.0), (10.0, 0.0), 0.2, stream, water_m_s=0.29, ground_m_s=1.0, worst=False).time_s
    )


def refused_rooms() -> list[tuple[RandomWorld, str]]:
    """Rooms whose plans the service's own check refuses, with its reasons."""
    found = []
    for seed in (5_016, 5_020, *range(5_080, 5_100)):
        room = make_world(seed)
        problem = refusal_of(room)
        if problem:
            found.append((room, problem))
    return found


def read_local(room: RandomWorld) -> Any:
    from autopilot.mission.local_plan import read_local_plan

    return read_local_plan(files_of(room, mode=0, duration_s=1.0)["plan.toml"].decode(), "plan.toml")


def test_the_services_refusals_are_found_right_and_the_same_words_about_other_rooms_wrong() -> None:
    refused = refused_rooms()
    assert len(refused) >= 3
    empty = next(room for room in map(make_world, range(100)) if all(leg.sure for leg in prospect(room).legs))
    empty = replace(empty, layout=replace(empty.layout, solids=()))
    for room, reason in refused:
        assert judge_refusal(room, prospect(room), reason).outcome is WorldOutcome.REFUSED, reason
        if "no free path" in reason:
            assert judge_refusal(empty, prospect(empty), reason).outcome is WorldOutcome.MISREFUSED, reason


@pytest.mark.parametrize(
    "reason",
    ["", "no", "fence item 3: is not nice", "item 0: depth 1.00 m, DEPTH_MAX 9.00 m", "item 0: current is too strong"],
)
def test_a_reason_that_is_none_is_a_wrong_refusal(reason: str) -> None:
    room = next(r for r in map(make_world, range(100)) if r.scenario["current"]["kind"] == "none")
    assert all(leg.sure for leg in prospect(room).legs)
    assert judge_refusal(room, prospect(room), reason).outcome is WorldOutcome.MISREFUSED


def test_every_shape_of_fault_is_held_against_a_flight() -> None:
    fine = WorldResult(room=0, mode=0, seed=0, outcome=WorldOutcome.REACHED)
    assert not fine.failed
    for changes in (
        {"contacts": 1},
        {"failsafes": ["solver"]},
        {"fallbacks": 1, "first_fallback_s": 1.0},
        {"alarms": ["Thruster port gives 50 % of its thrust"]},
        {"broken": {"depth": 0.2}},
        {"outcome": WorldOutcome.NOT_REACHED},
    ):
        fields: dict[str, Any] = {"room": 0, "mode": 0, "seed": 0, "outcome": WorldOutcome.REACHED, **changes}
        assert WorldResult(**fields).failed, changes


def test_finished_flights_are_kept_and_the_folder_holds_one_campaign(tmp_path: Path) -> None:
    """The rooms of this seed begin with one that is refused, so that nothing has to fly."""
    seed = 42
    assert refusal_of(make_world(1_000_000 * seed))
    arguments = ["--runs", "1", "--seed", str(seed), "--jobs", "1", "--out", str(tmp_path), "--json"]
    code, printed = command("rooms", *arguments)
    assert code == 0
    assert [row["refused"] for row in json.loads(printed)["modes"]] == [1, 1]
    before = (tmp_path / "flights.jsonl").read_bytes()
    assert len(read_flights(tmp_path)) == 2
    assert command("rooms", *arguments)[0] == 0
    assert (tmp_path / "flights.jsonl").read_bytes() == before
    code, printed = command("rooms", "--runs", "1", "--seed", str(seed + 1), "--out", str(tmp_path))
    assert code == 1


def refusal_of(room: RandomWorld) -> str:
    plan = read_local(room)
    verdict = verdict_of(plan, plan.home, ParamSet(room.scenario["params"]), room.vehicle)
    return verdict.problem or verdict.path_problem(np.array(room.scenario["vehicle"]["start_m"]), 0)


def test_a_disc_and_a_block_are_as_far_apart_as_their_rims() -> None:
    layout = WorldLayout(None, (Disc((0.0, 0.0), 0.5), Block(box((3.0, 0.0), 1.0, 1.0, 0.0))))
    assert clearance_m(layout, (1.0, 0.0)) == pytest.approx(0.5)
    assert clearance_m(layout, (2.0, 0.0)) == pytest.approx(0.5)
    assert clearance_m(layout, (3.0, 0.0)) == pytest.approx(-0.5)


@pytest.fixture(scope="module")
def flown() -> tuple[RandomWorld, Flown]:
    """A tank with twelve obstacles, a wall with two doors and a jet, in the energy mode: 17 s of flight."""
    room = make_world(1_000_003)
    result = fly_world(room, 1)
    assert result is not None
    return room, result


def judged_again(room: RandomWorld, flown: Flown) -> WorldResult:
    """The same flight as if it had been in another room."""
    assert flown.watch is not None
    assert flown.end is not None
    return judge_flight(room, prospect(room), 1, flown.watch, flown.end)


@pytest.mark.long
def test_a_room_is_flown_to_its_end(flown: tuple[RandomWorld, Flown]) -> None:
    result = flown[1].result
    assert result.outcome is WorldOutcome.REACHED
    assert result.faults == []
    assert result.visited == result.goals == len(flown[0].waypoints)
    assert result.simulated_s < result.bound_s


def test_the_judge_sees_goals_that_were_not_visited_and_bounds_that_were_broken(
    flown: tuple[RandomWorld, Flown],
) -> None:
    room, flight = flown
    assert judged_again(room, flight).faults == []
    last = {**room.waypoints[-1], "depth_m": room.waypoints[-1]["depth_m"] - 0.6}
    elsewhere = replace(room, plan={**room.plan, "waypoint": [*room.waypoints[:-1], last]})
    assert judged_again(elsewhere, flight).outcome is WorldOutcome.NOT_REACHED
    assert flight.watch is not None
    middle = flight.watch.rows[len(flight.watch.rows) // 2]
    post = Disc((float(middle[1]), float(middle[2])), 0.05)
    in_the_way = replace(room, layout=replace(room.layout, solids=(*room.layout.solids, post)))
    assert judged_again(in_the_way, flight).broken["clearance"] > 0.3
    rows = flight.watch.rows
    fastest = float(np.hypot(rows[:, 10], rows[:, 11]).max())
    for name, limit, found in (
        ("SPD_PLANAR_MAX", fastest - 0.04, "planar speed"),
        ("THR_LIMIT", 0.99 * float(rows[:, 19].max()), "thrust"),
        ("DEPTH_MAX", float(rows[:, 3].max()) - 0.1, "depth"),
    ):
        params = {**room.scenario["params"], name: limit}
        slower = replace(room, scenario={**room.scenario, "params": params})
        assert found in judged_again(slower, flight).broken


@pytest.mark.parametrize(
    ("room", "mode", "reason"),
    [
        (57, 0, "no free path from item 1 to item 2"),
        # A harbour so large that the wall was thinner than the cells of the check: accepted once, and stuck on the way.
        (4, 1, "no free path from item 0 to item 1"),
    ],
)
def test_a_wall_without_a_way_is_refused_by_the_service_itself(room: int, mode: int, reason: str) -> None:
    result = WorldTask(room=room, mode=mode, seed=1_000_000 + room).fly()
    assert result is not None
    assert result.outcome is WorldOutcome.REFUSED
    assert reason in result.what
    assert (result.room, result.mode, result.seed) == (room, mode, 1_000_000 + room)
