"""Arming, modes and failsafes, tick by tick."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from commander_bench import OK, Bench

from autopilot.command.commander import Commander
from autopilot.core.geodesy import GeodeticPosition, geodetic_from_ned
from autopilot.core.messages import Failsafe, NavDoubt, NavHealth
from autopilot.core.plan import PlanKind
from autopilot.core.vehicle import load_vehicle
from autopilot.mavlink.api import CommandResult, FlightMode
from autopilot.mission.paper import paper_plan


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"health": None}, "markers"),
        ({"health": NavHealth.DEAD_RECKONING}, "markers"),
        ({"ahrs_age_s": None}, "AHRS"),
        ({"ahrs_age_s": 2.0}, "AHRS"),
        ({"remaining": 0.05}, "battery"),
        ({"wet_us": math.inf}, "water in the hull: open"),
        ({"thruster_problem": "heading cannot be held"}, "THRn_HEALTH"),
    ],
)
def test_arming_is_refused_with_a_reason(bench: Bench, change: dict[str, Any], word: str) -> None:
    for name, value in change.items():
        setattr(bench if hasattr(bench, name) else bench.status, name, value)
    bench.run()
    answer = bench.commander.arm(force=False)
    assert answer.result is CommandResult.DENIED
    assert word in answer.reason
    assert not bench.run().armed
    assert bench.commander.arm(force=True).result is OK
    assert bench.run().armed


def test_a_vehicle_without_markers_is_not_sent_to_them() -> None:
    for has_markers, remedy in ((True, "markers must be in view"), (False, "check the pose source")):
        bench = Bench()
        bench.commander = Commander(load_vehicle("lbv150"), bench.params, bench.plans, has_markers=has_markers)
        bench.health = None
        bench.run(0.1)
        assert f"no position yet: {remedy}" in bench.commander.prearm_reasons()


def test_a_vehicle_without_markers_hears_of_none(bench: Bench) -> None:
    """Nor of a camera: health, doubts and failsafes alike."""
    bench.commander = Commander(load_vehicle("lbv150"), bench.params, bench.plans, has_markers=False)
    bench.armed()
    for health in (NavHealth.DEAD_RECKONING, NavHealth.INVALID):
        bench.health = health
        bench.run(0.1)
    bench.status.nav_doubts = frozenset({NavDoubt.FIXES})
    bench.run(4.0)
    bench.status.nav_doubts = frozenset(NavDoubt) - {NavDoubt.MAP}
    bench.run(2.0)
    assert any("lost, drifting" in text for text in bench.texts)
    assert any("Poses disagree" in text for text in bench.texts)
    assert any("source suspect" in text for text in bench.texts)
    assert not [text for text in bench.texts if "arker" in text or "amera" in text]


def test_fixes_that_disagree_are_reported_if_nothing_says_why() -> None:
    for cause, after_s, said in ((None, 0.0, 1), (NavDoubt.CALIBRATION, 1.0, 0), (NavDoubt.CALIBRATION, 4.0, 1)):
        bench = Bench().armed()
        bench.status.nav_doubts = frozenset({NavDoubt.FIXES})
        bench.run(0.5)
        assert not [text for text in bench.texts if "disagree" in text]
        bench.run(after_s)
        bench.status.nav_doubts = frozenset() if cause is None else frozenset({NavDoubt.FIXES, cause})
        bench.run(4.0)
        assert sum("Markers disagree" in text for text in bench.texts) == said, (cause, after_s)


def test_a_blow_is_not_called_a_wrong_accelerometer_unless_it_stays_wrong() -> None:
    for struck, lasts_s, said in ((False, 0.3, 1), (True, 0.3, 0), (True, 6.0, 1)):
        bench = Bench().armed()
        bench.status.nav_doubts = frozenset({NavDoubt.ACCELEROMETER})
        bench.run(0.2)
        if struck:
            bench.status.collided_us = bench.status.t_us
        bench.run(lasts_s - 0.2)
        bench.status.nav_doubts = frozenset()
        bench.run(6.0)
        assert sum("Accelerometer wrong" in text for text in bench.texts) == said, (struck, lasts_s)


def test_arming_outside_the_fence_is_refused(bench: Bench) -> None:
    bench.load()
    bench.pos = np.array([0.9375, 0.0, 0.5])
    bench.run()
    assert "fence" in bench.commander.arm(force=False).reason


def test_a_disarmed_vehicle_has_no_goal_and_an_armed_one_holds(bench: Bench) -> None:
    assert bench.run().goal is None
    bench.armed()
    goal = bench.run().goal
    assert goal is not None
    assert goal.pos_ned_m == pytest.approx(bench.pos)
    bench.pos = bench.pos + 0.2
    held = bench.run().goal
    assert held is not None
    assert held.pos_ned_m == pytest.approx(goal.pos_ned_m)


def test_the_mission_runs_to_its_end_and_then_holds(bench: Bench) -> None:
    bench.load().armed()
    assert bench.commander.start_mission(None).result is OK
    reached: list[int] = []
    for x, y, z, yaw in [(-1.6, -0.35, 0.45, 0.0), (1.75, 0.0, 0.3, np.pi), (-1.6, -0.35, 0.45, 0.0)]:
        bench.pos, bench.yaw = np.array([x, y, z]), yaw
        reached += bench.run().reached
    assert reached == [0, 1, 2, 3]
    decision = bench.run()
    assert decision.mode is FlightMode.HOLD
    assert decision.progress.state.name == "COMPLETE"
    assert decision.goal is not None
    assert decision.goal.pos_ned_m[:2] == pytest.approx([-1.6, -0.35], abs=0.02)


def test_start_without_plan_or_arms_is_refused(bench: Bench) -> None:
    bench.run()
    assert "arm" in bench.commander.start_mission(None).reason
    bench.armed()
    assert "upload" in bench.commander.start_mission(None).reason
    assert "upload" in bench.commander.set_mode(FlightMode.MISSION).reason


def test_pause_and_resume_keep_the_place_in_the_mission(bench: Bench) -> None:
    bench.load().armed()
    bench.commander.start_mission(None)
    bench.pos = np.array([-1.6, -0.35, 0.45])
    bench.run(0.05)
    assert bench.run().progress.current_seq == 1
    assert bench.commander.pause().result is OK
    goal = bench.run().goal
    assert goal is not None
    assert goal.pos_ned_m == pytest.approx(bench.pos)
    assert bench.commander.resume().result is OK
    decision = bench.run()
    assert decision.progress.current_seq == 1
    assert decision.goal is not None
    assert decision.goal.seq == 1


def test_a_new_plan_stops_the_running_one(bench: Bench) -> None:
    bench.load().armed()
    bench.commander.start_mission(None)
    bench.run()
    assert bench.plans.replace(PlanKind.MISSION, paper_plan(2).mission) is None
    assert bench.run().mode is FlightMode.HOLD
    assert any("changed" in text for text in bench.texts)
    assert bench.commander.start_mission(None).result is OK
    assert bench.plans.replace(PlanKind.MISSION, ()) is None
    assert bench.run().mode is FlightMode.HOLD
    assert any("cleared while it ran" in text for text in bench.texts)


def test_surfacing_ends_disarmed() -> None:
    bench = Bench().armed()
    assert bench.commander.set_mode(FlightMode.SURFACE).result is OK
    goal = bench.run().goal
    assert goal is not None
    assert goal.pos_ned_m[2] < 0.2
    bench.pos[2] = 0.14
    bench.run(0.02)
    assert not bench.run().armed


def test_go_to_is_checked_against_the_fence(bench: Bench) -> None:
    bench.load().armed()

    def go(north: float, east: float, down: float) -> Any:
        lat, lon, alt = geodetic_from_ned(bench.plans.origin, np.array([north, east, down]))
        return bench.commander.go_to(GeodeticPosition(lat_deg=lat, lon_deg=lon, alt_m=alt), None)

    assert go(0.0, 0.8, 0.4).result is OK
    goal = bench.run().goal
    assert goal is not None
    assert goal.pos_ned_m == pytest.approx([0.0, 0.8, 0.4], abs=1e-3)
    for bad in [(0.9375, 0.1, 0.4), (3.0, 0.0, 0.4), (0.0, 0.8, -0.5), (0.0, 0.8, 1.4)]:
        assert go(*bad).result is CommandResult.DENIED
    assert go(16.44, 0.0, 0.5).reason == "Go-to denied: target 13.9 m outside of the fence, keep 0.33 m"
    kept = bench.run().goal
    assert kept is not None
    assert kept.pos_ned_m == pytest.approx(goal.pos_ned_m)


def test_origin_moves_only_while_disarmed(bench: Bench) -> None:
    bench.run()
    there = GeodeticPosition(lat_deg=10.0, lon_deg=20.0, alt_m=1.0)
    assert bench.commander.set_origin(there).result is OK
    assert bench.plans.origin.lat_deg == 10.0
    bench.armed()
    assert bench.commander.set_origin(there).result is CommandResult.DENIED
    assert bench.commander.set_origin(GeodeticPosition(lat_deg=95.0, lon_deg=0.0, alt_m=0.0)).result is not OK


def test_lost_position_surfaces_blind_after_the_timeout() -> None:
    bench = Bench(FS_NAV_TIMEOUT=2.0).armed()
    bench.run()
    bench.health = NavHealth.INVALID
    assert bench.run(1.9).mode is FlightMode.HOLD
    decision = bench.run(0.2)
    assert decision.mode is FlightMode.SURFACE
    assert decision.blind_ascent
    assert decision.goal is None
    assert decision.failsafes == 1 << Failsafe.NAV_LOST
    assert bench.commander.set_mode(FlightMode.HOLD).result is CommandResult.DENIED


def test_emergency_stop_always_works() -> None:
    bench = Bench().armed()
    assert bench.commander.disarm(force=True).result is OK
    assert not bench.run().armed
    assert "Emergency stop" in bench.texts


def test_items_behind_a_return_are_not_reported_as_reached(bench: Bench) -> None:
    plan = paper_plan(1)
    assert bench.plans.replace(PlanKind.FENCE, plan.fence) is None
    first = plan.mission[0]
    rtl = replace(first, seq=1, frame=2, command=20, param2=0.0, param4=0.0, x=0, y=0, z=0.0)
    land = replace(rtl, seq=2, command=21)
    assert bench.plans.replace(PlanKind.MISSION, (first, rtl, land)) is None
    bench.armed()
    assert bench.commander.start_mission(None).result is OK
    reached: list[int] = []
    for place in ([-1.6, -0.35, 0.45], [-1.0, 0.5, 0.45]):
        bench.pos = np.array(place)
        for _ in range(5):
            reached += bench.run().reached
    assert reached == [0, 1]
