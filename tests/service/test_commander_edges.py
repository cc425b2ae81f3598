"""Commander: failsafes among themselves, taking over, braking, home, and plans that change under way."""

import itertools

import numpy as np
import pytest
from commander_bench import OK, Bench

from autopilot.core.messages import Failsafe, NavHealth
from autopilot.core.plan import PlanKind
from autopilot.mavlink.api import CommandResult, FlightMode
from autopilot.mission.paper import paper_plan
from tests.plan_items import circle, local


def test_a_failsafe_that_holds_does_not_go_on_to_the_waypoint() -> None:
    bench = Bench(FS_BATT_ACT=1)
    bench.load().armed()
    bench.commander.start_mission(None)
    going = bench.run().goal
    assert going is not None
    assert going.seq == 0
    bench.remaining = 0.05
    decision = bench.run(0.02)
    assert decision.mode is FlightMode.HOLD
    assert decision.goal is not None
    assert decision.goal.pos_ned_m == pytest.approx(bench.pos)


def test_position_found_again_while_surfacing_blind_goes_on_surfacing() -> None:
    bench = Bench(FS_NAV_TIMEOUT=1.0).armed()
    bench.run()
    bench.health = None
    assert bench.run(1.2).blind_ascent
    bench.health = NavHealth.GOOD
    decision = bench.run(0.02)
    assert decision.mode is FlightMode.SURFACE
    assert decision.goal is not None
    assert decision.goal.pos_ned_m[2] < 0.2
    bench.pos[2] = 0.13
    bench.run(0.02)
    assert not bench.run().armed


def test_the_operator_may_surface_while_a_failsafe_holds() -> None:
    bench = Bench(FS_BATT_ACT=1).armed()
    bench.remaining = 0.05
    assert bench.run(0.02).mode is FlightMode.HOLD
    assert bench.commander.set_mode(FlightMode.SURFACE).result is OK
    assert bench.run(0.02).mode is FlightMode.SURFACE
    bench.pos[2] = 0.13
    bench.run(0.02)
    assert not bench.run().armed


def test_a_mere_warning_does_not_keep_the_operator_from_taking_over() -> None:
    bench = Bench(FS_BATT_ACT=0).armed()
    bench.remaining = 0.05
    bench.status.solver_failures = 1000
    assert bench.run(0.02).mode is FlightMode.SURFACE
    bench.status.solver_failures = 0
    assert bench.run(0.02).failsafes == 1 << Failsafe.BATTERY
    assert bench.commander.set_mode(FlightMode.HOLD).result is OK
    assert bench.run().mode is FlightMode.HOLD


def test_a_start_that_a_failsafe_refuses_leaves_the_mission_where_it_is(bench: Bench) -> None:
    bench.load().armed()
    bench.status.solver_failures = 1000
    bench.run(0.02)
    assert bench.commander.start_mission(2).result is CommandResult.DENIED
    assert bench.run().progress.current_seq == 0


def test_a_moving_vehicle_holds_where_it_comes_to_rest() -> None:
    bench = Bench().armed()
    bench.yaw, bench.vel_frd_m_s = np.pi / 2, np.array([0.35, 0.0, 0.0])
    bench.run()
    bench.commander.pause()
    goal = bench.run().goal
    assert goal is not None
    assert goal.pos_ned_m == pytest.approx(np.add(bench.pos, [0.0, 0.35**2 / 0.5, 0.0]))


def test_the_braking_distance_ends_before_the_fence(bench: Bench) -> None:
    bench.load().armed()
    bench.pos = np.array([-1.0, 1.15, 0.5])
    bench.yaw, bench.vel_frd_m_s = np.pi / 2, np.array([0.35, 0.0, 0.0])
    bench.run()
    bench.commander.pause()
    goal = bench.run().goal
    assert goal is not None
    assert 1.15 <= goal.pos_ned_m[1] <= 1.17
    assert goal.pos_ned_m[0] == pytest.approx(-1.0)


def test_return_is_refused_while_home_is_forbidden() -> None:
    bench = Bench().armed()
    home = bench.pos.copy()
    bench.pos = np.add(home, [2.0, 0.0, 0.0])
    bench.run()
    assert bench.commander.set_mode(FlightMode.RETURN).result is OK
    decision = bench.run()
    assert decision.goal is not None
    assert decision.goal.pos_ned_m == pytest.approx([home[0], home[1], bench.pos[2]])
    assert bench.plans.replace(PlanKind.FENCE, (circle(0, home[0], home[1], 0.5),)) is None
    answer = bench.commander.set_mode(FlightMode.RETURN)
    assert answer.result is CommandResult.DENIED
    assert "home" in answer.reason


def test_a_fence_upon_the_vehicle_is_reported() -> None:
    bench = Bench().armed()
    bench.run()
    assert bench.plans.replace(PlanKind.FENCE, (circle(0, 3.0, 0.0, 0.5),)) is None
    bench.run()
    assert not any("New fence" in text for text in bench.texts)
    assert bench.plans.replace(PlanKind.FENCE, (circle(0, bench.pos[0], bench.pos[1] + 0.4, 0.3),)) is None
    bench.run()
    assert any("New fence" in text and "0.20 m" in text for text in bench.texts)


def test_position_and_way_are_reported_once() -> None:
    bench = Bench().armed()
    bench.run()
    bench.health, bench.status.unreachable = NavHealth.DEAD_RECKONING, True
    assert bench.run(0.1).armed
    bench.health, bench.status.unreachable = NavHealth.GOOD, False
    bench.run(0.1)
    for word in ("Dead reckoning", "No free path", "good again"):
        assert sum(word in text for text in bench.texts) == 1, word


@pytest.mark.parametrize("chosen", [FlightMode.RETURN, FlightMode.SURFACE])
def test_arming_begins_the_mode_that_was_chosen(bench: Bench, chosen: FlightMode) -> None:
    bench.run()
    assert bench.commander.set_mode(chosen).result is OK
    bench.pos = np.add(bench.pos, [0.0, 0.5, 0.0])
    bench.armed()
    decision = bench.run()
    assert decision.mode is chosen
    assert decision.goal is not None
    assert decision.goal.pos_ned_m[:2] == pytest.approx(bench.pos[:2])
    bench.commander.disarm(force=True)
    assert bench.run().mode is FlightMode.HOLD


def test_arming_for_a_mission_that_has_been_cleared_holds(bench: Bench) -> None:
    bench.load()
    bench.run()
    assert bench.commander.set_mode(FlightMode.MISSION).result is OK
    assert bench.plans.replace(PlanKind.MISSION, ()) is None
    assert bench.commander.arm(force=False).result is OK
    assert bench.run().mode is FlightMode.HOLD


def test_a_new_mission_does_not_end_a_failsafe(bench: Bench) -> None:
    bench.load().armed()
    bench.commander.start_mission(None)
    bench.run()
    bench.status.solver_failures = 1000
    assert bench.run(0.02).mode is FlightMode.SURFACE
    bench.status.solver_failures = 0
    bench.run()
    assert bench.plans.replace(PlanKind.MISSION, paper_plan(2).mission) is None
    assert bench.run(0.02).mode is FlightMode.SURFACE


def test_an_empty_depth_band_is_no_place_to_fly() -> None:
    bench = Bench(DEPTH_MIN=3.0, DEPTH_MAX=2.0)
    bench.run()
    assert "depth band" in bench.commander.arm(force=False).reason


def test_go_to_without_a_place_turns_on_the_spot() -> None:
    bench = Bench().armed()
    assert bench.commander.go_to(None, 1.0).result is OK
    goal = bench.run().goal
    assert goal is not None
    assert goal.yaw_rad == 1.0
    assert goal.pos_ned_m == pytest.approx(bench.pos)


def test_a_refused_takeoff_leaves_the_one_that_was_accepted(bench: Bench) -> None:
    bench.run()
    assert bench.commander.take_off(0.8).result is OK
    assert bench.commander.take_off(50.0).result is CommandResult.DENIED
    bench.armed()
    goal = bench.run().goal
    assert bench.commander.mode is FlightMode.TAKEOFF
    assert goal is not None
    assert goal.pos_ned_m[2] == pytest.approx(0.8)


def test_arming_says_why_it_holds_instead_of_the_mode_chosen_before(bench: Bench) -> None:
    bench.run()
    assert bench.commander.set_mode(FlightMode.GUIDED).result is OK
    assert bench.armed().run().mode is FlightMode.HOLD
    assert "Offboard denied: send set points first" in bench.texts


def test_a_start_at_an_item_is_judged_from_that_item_and_leaves_the_mission_alone_if_refused() -> None:
    """The first item lies upstream, the second downstream."""
    bench = Bench(WP_STUCK_ACT=3)
    items = tuple(local(seq, 16, x, 0.5, 0.5, (0.0, 0.2, 0.0, 0.0)) for seq, x in enumerate((1.5, -1.8)))
    assert bench.plans.replace(PlanKind.MISSION, items) is None
    bench.current = np.array([-0.6, 0.0, 0.0])
    bench.armed()
    bench.run()
    assert bench.commander.start_mission(1).result is OK, bench.texts
    assert bench.run().progress.current_seq == 1
    for order, seq in itertools.product((bench.commander.start_mission, bench.commander.set_current_item), (0, 7)):
        assert order(seq).result is CommandResult.DENIED
        assert bench.run().progress.current_seq == 1
        assert bench.commander.mode is FlightMode.MISSION


def test_a_mission_is_set_back_with_its_jumps_and_laps(bench: Bench) -> None:
    bench.load(laps=3)
    bench.armed()
    bench.commander.start_mission(None)
    for place in [(-1.6, -0.35, 0.45), (1.75, 0.0, 0.3), (-1.6, -0.35, 0.45), (1.75, 0.0, 0.3)]:
        bench.pos, bench.yaw = np.array(place), np.pi if place[0] > 0.0 else 0.0
        bench.run(0.1)
    position = bench.commander.mission_position
    assert position is not None
    assert position.lap > 0
    assert position.jumps_done
    assert bench.commander.set_current_item(0, reset=True).result is OK
    position = bench.commander.mission_position
    assert position is not None
    assert (position.cursor, position.lap, position.jumps_done) == (0, 0, ())
