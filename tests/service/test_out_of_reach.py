"""Goals that the current keeps from the vehicle: told beforehand, and given up instead of crept at for ever."""

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from autopilot.core.messages import Goal, NavHealth, NavState, Outputs, ProgressState
from autopilot.core.plan import PlanItem, PlanKind
from autopilot.mavlink.api import FlightMode
from autopilot.mission.items import GoTo
from autopilot.mission.mission_tuning import UPSTREAM
from autopilot.mission.upstream import MadeGood, ground_speed_m_s, slowest_leg
from tests.plan_items import local, nav, plain, tank, waypoint
from tests.service.commander_bench import OK, Bench
from tests.system.system_harness import sessions

SCENARIO = """
[scenario]
name = "stream"
description = "a stream that the margins leave nothing against"
plan = "plan.mission.toml"
[sensors]
position = "pose"
[current]
kind = "uniform"
velocity_m_s = [-0.46, 0.0, 0.0]
[vehicle]
start_m = [0.0, 0.0, 0.5]
held = true
[params]
WP_STUCK_TIME = 10
"""
PLAN = """
[origin]
lat_deg = 37.9755
lon_deg = 23.7790
alt_m = 0.0
[[waypoint]]
x_m = 5.0
y_m = 0.0
depth_m = 0.5
[[waypoint]]
x_m = -8.0
y_m = 0.0
depth_m = 0.5
accept_m = 0.5
"""


def flown(tmp_path: Path, params: dict[str, float], duration_s: float) -> tuple[list[str], Outputs]:
    (tmp_path / "stream.toml").write_text(SCENARIO)
    (tmp_path / "plan.mission.toml").write_text(PLAN)
    outputs: list[Outputs] = []
    with sessions(tmp_path) as session:
        session(
            str(tmp_path / "stream.toml"), start=True, duration=duration_s, log=tmp_path / "run.mcap", params=params,
            on_tick=outputs.append,
        ).run(stop=lambda: bool(outputs) and outputs[-1].progress.state is ProgressState.COMPLETE)  # fmt: skip
    return [event.text for out in outputs for event in out.events], outputs[-1]


@pytest.mark.long
def test_a_goal_up_too_fast_a_stream_is_told_skipped_and_the_next_one_reached(tmp_path: Path) -> None:
    texts, last = flown(tmp_path, {}, 75.0)
    told = [
        text for text in texts if text.startswith(("Item 0 is upstream: 0.0", "Item 0 is out of reach: current 0."))
    ]
    assert told and len(told) <= 2, texts
    missing = tuple(f"Skipped item 0, out of reach: {what} 0." for what in ("needs", "current"))
    skipped = [text for text in texts if text.startswith(missing)]
    assert len(skipped) == 1 and len(skipped[0]) <= 50, texts
    assert "Reached item 0" not in texts and "Reached item 1" in texts
    assert "Mission complete, laps: 1, items skipped: 1" in texts
    assert last.progress.reached_seq == 1


def _started(**params: float) -> Bench:
    bench = Bench(WP_STUCK_TIME=10, **params)
    bench.load().armed()
    assert bench.commander.set_mode(FlightMode.MISSION).result is OK
    bench.run(1.0)
    return bench


@pytest.mark.parametrize(
    ("action", "text"), [(0, "Item 0 out of reach"), (1, "Holding: item 0 out of"), (3, "Holding: ")]
)
def test_what_is_done_about_it_is_a_parameter(action: float, text: str) -> None:
    bench = _started(WP_STUCK_ACT=action)
    bench.run(30.0)
    assert len([t for t in bench.texts if t.startswith(text)]) == 1
    assert bench.commander.mode is (FlightMode.MISSION if action == 0 else FlightMode.HOLD)


def test_items_given_up_one_after_the_other_end_the_mission() -> None:
    bench = _started()
    bench.run(60.0)
    assert sum(text.startswith("Skipped item") for text in bench.texts) >= 2
    assert any(text.startswith("Mission complete") and "items skipped" in text for text in bench.texts)
    assert bench.commander.mode is FlightMode.HOLD


def test_no_free_way_is_named_as_such() -> None:
    bench = _started()
    bench.status.unreachable = True
    bench.run(12.0)
    assert any(text == "Skipped item 0, out of reach: no free way" for text in bench.texts)


def _in_tank(*mission: PlanItem, **params: float) -> Bench:
    bench = Bench(**params)
    bench.pos = np.array([-1.9, 0.9, 0.5])
    assert bench.plans.replace(PlanKind.FENCE, tuple(tank())) is None
    assert bench.plans.replace(PlanKind.MISSION, mission) is None
    return bench


def test_a_circle_round_the_vehicle_is_not_begun_where_it_has_no_room() -> None:
    bench = _in_tank(plain(0, 18, 1.0, 0.0, 0.9))
    bench.run()
    assert "circle comes within -0.30 m of the fence, keep 0.3" in bench.commander.arm(force=False).reason
    bench.pos = np.array([0.0, 0.0, 0.5])
    bench.armed()
    bench.pos = np.array([-1.9, 0.9, 0.5])
    bench.run()
    assert "circle comes within" in bench.commander.set_mode(FlightMode.MISSION).reason


@pytest.mark.parametrize(
    ("action", "text"), [(1, "Holding: item 3 out of reach, circle"), (2, "Skipped item 3, out of reach: circle")]
)
def test_a_circle_that_a_jump_brings_to_a_place_without_room_is_given_up_at_once(action: float, text: str) -> None:
    ring = plain(3, 18, 1.0, 0.0, 0.9)
    mission = (waypoint(0, -1.9, 0.9), plain(1, 177, 3, 1), waypoint(2, 0.0, 0.0), ring, waypoint(4, 0.0, 0.0))
    bench = _in_tank(*mission, WP_STUCK_ACT=action).armed()
    for times in (1, 2):
        assert bench.commander.set_mode(FlightMode.MISSION).result is OK
        bench.run(0.5)
        found = [told for told in bench.texts if told.startswith(text)]
        assert len(found) == (times if action == 1 else 1), bench.texts
        assert bench.commander.mode is (FlightMode.HOLD if action == 1 else FlightMode.MISSION)
    assert "of the fence, keep 0.3" in found[0]


def test_a_last_gate_that_is_given_up_is_not_reached() -> None:
    bench = _in_tank(waypoint(0, -1.9, 0.9), local(1, 4501, 1.0, 0.9, 0.5), WP_STUCK_TIME=10).armed()
    assert bench.commander.set_mode(FlightMode.MISSION).result is OK
    reached = [seq for _ in range(2000) for seq in bench.run().reached]
    assert reached == [0] and "Mission complete, laps: 1, items skipped: 1" in bench.texts


def test_a_mission_that_returns_is_not_started_with_a_home_beyond_the_fence() -> None:
    here = plain(1, 179, 1.0)
    for mission, denied in (((plain(1, 20),), True), ((here, plain(2, 20)), False)):
        bench = _in_tank(waypoint(0, -1.5, 0.0), *mission).armed()
        assert bench.commander.restore_home(np.array([-3.0, 0.0, 0.0])) == ""
        answer = bench.commander.set_mode(FlightMode.MISSION)
        assert (answer.reason == "Mission denied: home is 0.50 m beyond the fence: set another") == denied


def test_a_goal_that_the_current_puts_out_of_reach_is_given_up_in_10_s_with_what_is_missing(bench: Bench) -> None:
    bench.load().armed()
    assert bench.commander.set_mode(FlightMode.MISSION).result is OK
    bench.run(15.0)
    assert not any(text.startswith("Skipped") for text in bench.texts), "WP_STUCK_TIME is 60 s"
    bench.status.shortfall = "heading needs 98 % of the thrust"
    bench.run(0.5)
    assert "Skipped item 0, out of reach: heading needs 98 % of the thrust" in bench.texts


def test_a_slow_approach_is_no_reason_to_give_up_a_goal_once_the_current_seems_too_strong(bench: Bench) -> None:
    bench.pos = np.array([2.0, -1.0, 0.45])
    bench.load().armed()
    assert bench.commander.set_mode(FlightMode.MISSION).result is OK
    way = np.array([-3.6, 0.65, 0.0]) / math.hypot(3.6, 0.65)
    for tenth in range(400):
        bench.status.shortfall = "current" if tenth > 150 else ""
        bench.run(0.1)
        bench.pos = bench.pos + 0.003 * way
    assert not any(text.startswith("Skipped") for text in bench.texts)


def test_an_item_that_is_got_nearer_to_is_not_said_to_be_out_of_reach(bench: Bench) -> None:
    """What margins and estimate leave is a prediction; the way that is made good is not."""
    bench.pos = np.array([2.0, -1.0, 0.45])
    bench.load().armed()
    assert bench.commander.set_mode(FlightMode.MISSION).result is OK
    way = np.array([-3.6, 0.65, 0.0]) / math.hypot(3.6, 0.65)
    for _ in range(250):
        bench.run(0.1)
        bench.pos = bench.pos + 0.004 * way
    bench.current = np.array([0.6, 0.0, 0.0])
    for _ in range(150):
        bench.run(0.1)
        bench.pos = bench.pos + 0.004 * way
    told = [text for text in bench.texts if text.startswith("Item 0")]
    assert len(told) == 1 and told[0].startswith("Item 0 is upstream: 0.040"), told
    bench.run(40.0)
    assert "Item 0 is out of reach: current 0.60 m/s" in bench.texts


@pytest.mark.parametrize(("north_m_s", "told"), [(0.3, ["Item 0 is upstream: 0.099 m/s left, 8 min"]), (0.0, [])])
def test_a_long_way_round_against_the_current_is_told_though_the_goal_lies_downstream(
    bench: Bench, north_m_s: float, told: list[str]
) -> None:
    bench.load().armed()
    assert bench.commander.set_mode(FlightMode.MISSION).result is OK
    bench.current = np.array([north_m_s, 0.0, 0.0])
    for tenth in range(300):
        bench.status.path_left_m = 50.0 - 0.01 * tenth
        bench.run(0.1)
    assert [text for text in bench.texts if text.startswith("Item 0")] == told


@pytest.mark.parametrize(("made_m_s", "stuck"), [(0.028, False), (0.0, True)])
def test_who_stems_a_current_slowly_is_not_stuck(bench: Bench, made_m_s: float, stuck: bool) -> None:
    bench.load().armed()
    assert bench.commander.set_mode(FlightMode.MISSION).result is OK
    for tenth in range(300):
        bench.status.thrust_n, bench.status.path_left_m = np.full(4, 8.0), 5.0 - 0.1 * made_m_s * tenth
        bench.run(0.1)
    assert any("stuck" in text for text in bench.texts) == stuck, bench.texts


def test_no_start_where_the_current_says_so_and_the_parameter_asks_for_it() -> None:
    bench = Bench(WP_STUCK_ACT=3)
    bench.load().armed()
    bench.current = np.array([0.0, 0.7, 0.0])
    bench.run()
    answer = bench.commander.set_mode(FlightMode.MISSION)
    assert answer.result is not OK and "out of reach: current 0.70 m/s" in answer.reason


def _nav(x: float, t_s: float, health: NavHealth = NavHealth.GOOD) -> NavState:
    return nav(x, 0.0, 0.5, t_us=round(t_s * 1e6), health=health)


GOAL = Goal(
    pos_ned_m=np.array([0.0, 0.0, 0.5]), yaw_rad=None, speed_m_s=0.3, accept_radius_m=0.3, accept_yaw_rad=0.1, seq=3
)


@given(st.floats(-0.3, 0.3), st.floats(1.0, 200.0))
@settings(max_examples=60, deadline=None)
def test_way_made_good_is_told_from_drifting_and_creeping(speed_m_s: float, far_m: float) -> None:
    """At 0.02 m/s and more nothing is given up, below 0.009 m/s everything is."""
    watch, idle_s = MadeGood(), 0.0
    for k in range(130):
        x = -far_m + speed_m_s * k
        if x > -0.3:
            return
        idle_s = max(idle_s, watch.idle_s(k * 1_000_000, GOAL, _nav(x, k), None, 0.6))
    assert (idle_s < 60.0) if speed_m_s > 0.02 else (idle_s >= 60.0 or speed_m_s > 0.009)


def test_another_way_counts_anew_but_not_for_ever_and_blind_time_not_at_all() -> None:
    watch, left_m, idle_s, starts = MadeGood(), 20.0, [], 0
    for k in range(1200):
        left_m = 20.0 if k % 50 == 0 else left_m - 0.001
        left_m = left_m + 5.0 if k % 100 == 0 else left_m
        idle_s.append(watch.idle_s(k * 1_000_000, GOAL, _nav(-9.0, k), left_m, 0.6))
        starts += idle_s[-1] == 0.0
    assert starts <= 2 * UPSTREAM.fresh_starts + 2 and idle_s[-1] > 300.0
    blind = MadeGood()
    for k in range(200):
        health = NavHealth.DEAD_RECKONING if k > 5 else NavHealth.GOOD
        assert blind.idle_s(k * 1_000_000, GOAL, _nav(-9.0, k, health), None, 0.6) <= 5.0


@given(st.floats(0.0, 0.6), st.floats(0.0, 2.0 * math.pi), st.floats(0.1, 0.5))
@settings(max_examples=60, deadline=None)
def test_speed_over_ground_closes_the_triangle(current: float, angle: float, speed: float) -> None:
    """What is left along the way, less the current, is a motion through the water at just that speed."""
    c = current * np.array([[math.cos(angle), math.sin(angle)]])
    left = float(ground_speed_m_s(np.array([1.0, 0.0]), c, speed)[0])
    if math.isfinite(left):
        assert math.hypot(left - c[0, 0], c[0, 1]) == pytest.approx(speed, abs=1e-9)
    else:
        assert abs(c[0, 1]) > speed


def test_the_slowest_leg_is_named_with_its_time() -> None:
    places = [(0.0, 0.0), (10.8, 0.0), (10.8, 5.0)]
    steps = [
        GoTo(
            seq=k,
            pos_ned_m=np.array([*place, 0.5]),
            yaw_rad=None,
            hold_s=0.0,
            accept_radius_m=None,
            autocontinue=True,
        )
        for k, place in enumerate(places)
    ]

    asked = []

    def stream(places: np.ndarray) -> np.ndarray:
        asked.append(len(places))
        return np.tile([-0.355, 0.0], (len(places), 1))

    leg = slowest_leg(steps, np.array([1.0, 0.0]), 0, 0.37, stream)
    assert leg is not None and len(asked) == 1, "a mission of hundreds of legs starts within a tick"
    assert leg.text(0.01) == "Item 1 is upstream: 0.015 m/s left, 12 min"
    assert leg.text(0.02) == "Item 1 is out of reach: current 0.35 m/s"
    assert slowest_leg(steps[:1], None, 0, 0.37, stream) is None
