"""The mission in execution, against a vehicle that goes straight to its goal."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from autopilot.core.errors import PlanError
from autopilot.core.frames import wrap_pi
from autopilot.core.messages import Goal, NavHealth, ProgressState
from autopilot.core.params import ParamSet
from autopilot.core.plan import PlanItem
from autopilot.mission.item_types import parse_step
from autopilot.mission.items import Command
from autopilot.mission.paper import paper_plan
from autopilot.mission.sequencer import Action, Sequencer, SequencerOutput, is_inside
from tests.plan_items import NAN, ORIGIN, local, nav, plain, waypoint

TICK_US = 10_000
S = ProgressState


class Flight:
    """A sequencer and a vehicle that moves a little towards the goal on every tick."""

    def __init__(self, items: list[PlanItem] | tuple[PlanItem, ...], **overrides: float) -> None:
        self.sequencer = Sequencer(ParamSet(overrides))
        self.sequencer.load([parse_step(item, ORIGIN) for item in items])
        self.pos = np.array([-1.6, -0.35, 0.45])
        self.yaw = 0.0
        self.t_us = 0
        self.health = NavHealth.GOOD
        self.outputs: list[SequencerOutput] = []

    def tick(self, move: bool = True) -> SequencerOutput:
        out = self.sequencer.step(self.t_us, nav(*self.pos, yaw=self.yaw, t_us=self.t_us, health=self.health))
        self.outputs.append(out)
        if move and out.goal is not None:
            self.follow(out.goal)
        self.t_us += TICK_US
        return out

    def follow(self, goal: Goal) -> None:
        off = goal.pos_ned_m - self.pos
        distance = float(np.linalg.norm(off))
        self.pos = self.pos + off * min(1.0, 0.1 / max(distance, 1e-9))
        if goal.yaw_rad is not None:
            self.yaw = wrap_pi(self.yaw + max(-0.1, min(0.1, wrap_pi(goal.yaw_rad - self.yaw))))

    def fly(self, ticks: int = 2000) -> list[int]:
        """Run until complete; the items reached."""
        for _ in range(ticks):
            if self.tick().progress.state is S.COMPLETE:
                break
        return self.reached

    @property
    def reached(self) -> list[int]:
        return [seq for out in self.outputs for seq in out.reached]

    @property
    def last(self) -> SequencerOutput:
        return self.outputs[-1]


@pytest.mark.parametrize("laps", [1, 2, 3, 7])
def test_the_papers_tour(laps: int) -> None:
    flight = Flight(paper_plan(laps).mission)
    flight.sequencer.start()
    assert flight.fly() == [0, *[1, 2] * laps]
    progress = flight.last.progress
    assert (progress.state, progress.lap, progress.reached_seq) == (S.COMPLETE, laps, 2)
    assert flight.last.action is Action.HOLD
    assert flight.last.goal is not None
    assert flight.last.goal.pos_ned_m == pytest.approx([-1.6, -0.35, 0.45], abs=0.006)
    assert flight.tick().action is None
    visited = [out.goal.seq for out in flight.outputs if out.goal is not None]
    assert set(visited) == {1, 2}, "the vehicle stands at A, so item 0 is reached on the first tick"


def test_goals_carry_what_the_item_and_the_parameters_say() -> None:
    flight = Flight(paper_plan().mission, SPD_CRUISE=0.3, WP_ACCEPT_YAW=0.2)
    flight.sequencer.start(1)
    goal = flight.tick(move=False).goal
    assert goal is not None
    assert (goal.seq, goal.accept_radius_m, goal.accept_yaw_rad, goal.speed_m_s) == (1, 0.3, 0.2, 0.3)
    assert goal.yaw_rad == pytest.approx(-math.pi)


def test_nothing_happens_before_the_start_and_without_a_mission() -> None:
    empty = Flight([])
    assert (empty.tick().goal, empty.last.progress.state) == (None, S.NO_MISSION)
    with pytest.raises(PlanError, match="no mission"):
        empty.sequencer.start()
    flight = Flight(paper_plan().mission)
    assert (flight.tick().goal, flight.last.progress.state) == (None, S.NOT_STARTED)
    with pytest.raises(PlanError, match="item 4 does not exist"):
        flight.sequencer.start(4)
    assert flight.sequencer.state is S.NOT_STARTED


def test_reached_needs_ball_and_heading_band_at_once() -> None:
    flight = Flight([waypoint(0, 0, 0, 0.5, yaw_deg=90.0)])
    flight.sequencer.start()
    for x, z, yaw in [(0.31, 0.5, math.pi / 2), (0, 0.81, math.pi / 2), (0, 0.5, math.pi / 2 - 0.16), (0.2, 0.75, 1.5)]:
        flight.pos, flight.yaw = np.array([x, 0.0, z]), yaw
        assert flight.tick(move=False).reached == ()
    flight.pos, flight.yaw = np.array([0.15, 0.1, 0.6]), math.pi / 2 + 0.14
    assert flight.tick(move=False).reached == (0,)


def test_hold_time_is_without_a_break_and_not_on_an_invalid_estimate() -> None:
    flight = Flight([waypoint(0, 0, 0, 0.5, hold_s=1.0)])
    flight.sequencer.start()
    flight.pos = np.array([0.0, 0.0, 0.5])
    for k in range(99):
        assert flight.tick(move=False).reached == (), k
    flight.pos = np.array([0.5, 0.0, 0.5])
    flight.tick(move=False)
    flight.pos = np.array([0.0, 0.0, 0.5])
    for _ in range(60):
        flight.tick(move=False)
    flight.health = NavHealth.INVALID
    flight.tick(move=False)
    flight.health = NavHealth.DEAD_RECKONING
    for _ in range(100):
        assert flight.tick(move=False).reached == ()
    assert flight.tick(move=False).reached == (0,)


def test_speed_and_heading_commands_act_on_what_follows_and_are_not_reported() -> None:
    items = [
        waypoint(0, 0, 0, yaw_deg=0.0),
        plain(1, Command.DO_CHANGE_SPEED, 1, 0.2),
        plain(2, Command.CONDITION_YAW, 90),
        waypoint(3, 1, 0),
        waypoint(4, 1, 1, yaw_deg=180.0),
        plain(5, Command.DO_CHANGE_SPEED, 1, -2),
        plain(6, Command.CONDITION_YAW, 90, 0, 1, 1),
        waypoint(7, 0, 1),
    ]
    flight = Flight(items)
    flight.sequencer.start()
    assert flight.fly() == [0, 3, 4, 7]
    goals = {out.goal.seq: out.goal for out in flight.outputs if out.goal is not None}
    assert [goals[k].speed_m_s for k in (0, 3, 4, 7)] == [0.35, 0.2, 0.2, 0.35]
    assert goals[3].yaw_rad == pytest.approx(math.pi / 2)
    assert goals[7].yaw_rad == pytest.approx(-math.pi / 2, abs=0.16)


def test_the_operators_speed_holds_until_the_plan_changes_it() -> None:
    flight = Flight([waypoint(0, 2, 0), plain(1, 178, 1, 0.1), waypoint(2, 0, 0)])
    flight.sequencer.start()
    flight.tick()
    flight.sequencer.set_speed(0.22)
    goal = flight.tick().goal
    assert goal is not None
    assert goal.speed_m_s == 0.22
    flight.fly()
    assert flight.last.goal is not None
    assert flight.last.goal.speed_m_s == 0.1


def test_pause_holds_here_and_resume_goes_on() -> None:
    flight = Flight(paper_plan().mission)
    flight.sequencer.start()
    for _ in range(15):
        flight.tick()
    where = flight.pos.copy()
    flight.sequencer.pause()
    for _ in range(30):
        out = flight.tick()
        assert out.progress.state is S.PAUSED
        assert out.goal is not None
        assert out.goal.seq == -1
        assert out.goal.pos_ned_m == pytest.approx(where)
    current = flight.last.progress.current_seq
    flight.sequencer.start(None)
    assert flight.tick().progress.current_seq == current
    assert flight.fly() == [0, 1, 2, 1, 2, 1, 2]


def test_set_current_jumps_at_once_and_refuses_what_is_not_there() -> None:
    flight = Flight(paper_plan(1).mission)
    flight.sequencer.start()
    flight.tick()
    flight.sequencer.set_current(2)
    out = flight.tick(move=False)
    assert out.goal is not None
    assert out.goal.seq == 2
    with pytest.raises(PlanError, match="item 9 does not exist; the mission has items 0 to 3"):
        flight.sequencer.set_current(9)
    flight.fly()
    flight.sequencer.set_current(1)
    assert flight.tick().progress.state is S.NOT_STARTED
    flight.sequencer.start()
    flight.outputs.clear()
    assert flight.fly() == [1, 2]


def test_an_item_that_is_chosen_ends_the_circle_or_the_end_before_it() -> None:
    flight = Flight([waypoint(0, 1, 1), local(1, 18, 0, 0, 0.5, (5.0, 0.0, 0.5, NAN)), plain(2, 93, 1.0)])
    sequencer = flight.sequencer
    for seq in (0, 2):
        sequencer.start(1)
        for _ in range(100):
            flight.tick()
        assert sequencer.circle_left_m is not None
        sequencer.set_current(seq)
        goal = flight.tick(move=False).goal
        assert goal is not None and goal.drive is None and sequencer.circle_left_m is None
        sequencer.set_speed(0.11)
        goal = flight.tick(move=False).goal
        assert goal is not None and goal.speed_m_s == 0.11
    last = Flight([waypoint(0, 1, 1), waypoint(1, 0, 0)])
    last.sequencer.start(1)
    last.tick()
    last.sequencer.skip(nav(*last.pos))
    last.sequencer.set_current(0)
    assert last.fly() == [0, 1]


def test_a_circle_and_the_way_to_it_have_the_speed_that_was_set() -> None:
    flight = Flight([plain(0, 178, 1, 0.12), local(1, 18, 0, 0, 0.5, (5.0, 0.0, 0.5, NAN))], CIRCLE_SPEED=0.2)

    def goal() -> Goal:
        for _ in range(6):
            goal = flight.tick(move=False).goal
        assert goal is not None
        return goal

    flight.sequencer.start()
    assert (goal().speed_m_s, goal().speed_asked, goal().drive) == (0.12, True, None)
    flight.sequencer.set_speed(0.25)
    assert (goal().speed_m_s, goal().speed_asked, goal().drive) == (0.25, True, None)
    flight.sequencer.set_speed(None)
    assert (goal().speed_m_s, goal().speed_asked) == (ParamSet({})["SPD_CRUISE"], False)
    for _ in range(100):
        flight.tick()
    assert goal().drive is not None and goal().speed_m_s == 0.2
    flight.sequencer.set_speed(0.12)
    assert goal().speed_m_s == 0.12
    flight.sequencer.set_speed(None)
    assert goal().speed_m_s == 0.2


def test_an_endless_loop_goes_on_from_its_jump_when_that_is_chosen() -> None:
    flight = Flight([waypoint(0, 0, 0), waypoint(1, 1, 0), plain(2, 177, 0, -1)])
    flight.sequencer.start()
    flight.fly(60)
    assert flight.reached[:3] == [0, 1, 0]
    flight.sequencer.set_current(2)
    flight.tick()
    flight.sequencer.set_current(2)
    flight.outputs.clear()
    flight.fly(100)
    assert flight.last.progress.state is S.ACTIVE and flight.reached[:2] == [0, 1]


def test_jumps_that_lead_to_jumps_are_counted_as_written() -> None:
    jumps = [plain(2, 177, 4, 3), plain(3, 177, 0, 1), plain(4, 177, 2, 1)]
    flight = Flight([waypoint(0, 0, 0), waypoint(1, 1, 0), *jumps])
    flight.sequencer.start()
    assert flight.fly() == [0, 1]


def test_a_complete_mission_starts_anew_with_its_jumps() -> None:
    flight = Flight(paper_plan(2).mission)
    for _ in range(2):
        flight.outputs.clear()
        flight.sequencer.start()
        assert flight.fly() == [0, 1, 2, 1, 2]


def test_loading_another_mission_forgets_the_old_run() -> None:
    flight = Flight(paper_plan(2).mission)
    flight.sequencer.start()
    flight.fly(60)
    flight.sequencer.load([parse_step(waypoint(0, 1, 1), ORIGIN)])
    out = flight.tick()
    assert (out.goal, out.progress.state, out.progress.reached_seq, out.progress.lap) == (None, S.NOT_STARTED, -1, 0)


def test_loiter_unlimited_never_ends() -> None:
    flight = Flight([local(0, 17, 0, 0, 0.5), waypoint(1, 1, 1)])
    flight.sequencer.start()
    assert flight.fly(500) == []
    assert flight.pos == pytest.approx([0.0, 0.0, 0.5])
    assert flight.last.progress.state is S.ACTIVE


def test_loiter_here_for_a_time_and_delays() -> None:
    items = [plain(0, 19, 0.5), plain(1, 93, 0.5), plain(2, 112, 0.5), waypoint(3, -1, 0)]
    flight = Flight(items)
    start = flight.pos.copy()
    flight.sequencer.start()
    for _ in range(150):
        flight.tick()
        assert flight.pos == pytest.approx(start)
    assert flight.reached == [0, 1]
    assert flight.fly() == [0, 1, 3]


def test_return_goes_home_and_ends_the_mission() -> None:
    flight = Flight([plain(0, 179, 1), waypoint(1, 1, 1), plain(2, 20), waypoint(3, 2, 2)])
    home = flight.pos.copy()
    flight.sequencer.start()
    first = flight.tick()
    assert first.home_ned_m is not None
    assert first.home_ned_m == pytest.approx(home)
    assert flight.fly() == [1, 2]
    assert flight.last.action is Action.HOLD
    assert np.linalg.norm(flight.pos - home) < 0.31


@pytest.mark.parametrize(("depth_m", "kept_m"), [(0.45, 0.45), (-0.2, 0.05), (1.5, 1.2)])
def test_return_keeps_the_depth_and_the_depth_band(depth_m: float, kept_m: float) -> None:
    flight = Flight([plain(0, 20)])
    flight.sequencer.set_home(np.array([1.0, 0.5, 0.0]))
    flight.pos[2] = depth_m
    flight.sequencer.start()
    goal = flight.tick().goal
    assert goal is not None
    assert goal.pos_ned_m == pytest.approx([1.0, 0.5, kept_m])


def test_a_pause_does_not_count_as_waiting() -> None:
    flight = Flight([waypoint(0, -1.6, -0.35, 0.45), plain(1, 93, 1.0), waypoint(2, -1, 0)])
    flight.sequencer.start()
    for _ in range(50):
        flight.tick()
    flight.sequencer.pause()
    for _ in range(200):
        flight.tick()
    flight.sequencer.start()
    for _ in range(45):
        assert flight.tick().progress.current_seq == 1
    for _ in range(10):
        flight.tick()
    assert flight.reached == [0, 1]


def test_a_heading_before_a_wait_is_turned_to_while_waiting() -> None:
    flight = Flight([waypoint(0, -1.6, -0.35, 0.45), plain(1, 115, 90.0), plain(2, 93, 1.0)])
    flight.sequencer.start()
    for _ in range(60):
        flight.tick()
    assert flight.yaw == pytest.approx(math.pi / 2)


def test_land_goes_there_then_up_then_asks_for_the_surface() -> None:
    flight = Flight([waypoint(0, 0, 0, 0.8), local(1, 21, 1.0, 1.0, 0.0), waypoint(2, 0, 0)])
    flight.sequencer.start()
    assert flight.fly() == [0, 1]
    depths = [out.goal.pos_ned_m[2] for out in flight.outputs if out.goal is not None and out.goal.seq == 1]
    assert (depths[0], depths[-1]) == (0.8, 0.05)
    assert flight.last.action is Action.SURFACE
    assert flight.last.progress.state is S.COMPLETE
    assert np.linalg.norm(flight.pos[:2] - [1, 1]) < 0.31
    up_here = Flight([waypoint(0, 0, 0, 0.8), plain(1, 21)])
    up_here.sequencer.start()
    up_here.fly()
    assert up_here.last.goal is not None
    assert up_here.last.goal.pos_ned_m == pytest.approx([0.0, 0.0, 0.05])


def test_without_autocontinue_the_mission_waits_for_the_operator() -> None:
    flight = Flight([replace(waypoint(0, 0, 0), autocontinue=0), waypoint(1, 1, 0)])
    flight.sequencer.start()
    assert flight.fly(300) == [0]
    assert flight.last.progress.state is S.PAUSED
    assert flight.last.goal is not None
    assert flight.last.goal.seq == 0
    flight.sequencer.start()
    assert flight.fly() == [0, 1]


def test_a_plan_of_empty_jumps_does_not_stall_a_tick() -> None:
    items = [plain(0, 178, 1, 0.3), plain(1, 177, 0, 500), waypoint(2, 0, 0)]
    flight = Flight(items)
    flight.sequencer.start()
    assert flight.fly() == [2]
    assert flight.last.progress.lap == 2, "an empty lap is not made again and again"


def test_an_estimate_that_is_not_finite_gives_no_goal_of_its_own() -> None:
    flight = Flight([plain(0, 17)])
    flight.sequencer.start()
    flight.pos = np.array([NAN, 0.0, 0.5])
    assert flight.tick().goal is None
    flight.pos = np.array([0.1, 0.0, 0.5])
    goal = flight.tick().goal
    assert goal is not None
    assert goal.pos_ned_m == pytest.approx([0.1, 0.0, 0.5])


places = st.floats(-2.0, 2.0)
steps = st.one_of(
    st.tuples(st.just("wp"), places, places, st.floats(0.05, 1.2), st.sampled_from([NAN, 0.0, 90.0, 350.0])),
    st.tuples(st.just("speed"), st.floats(0.05, 0.5)),
    st.tuples(st.just("yaw"), st.floats(-360.0, 360.0), st.sampled_from([0.0, 1.0])),
    st.tuples(st.just("jump"), st.integers(0, 7), st.integers(0, 3)),
    st.tuples(st.just("delay"), st.floats(0.0, 0.2)),
    st.tuples(st.just("home")),
    st.tuples(st.just("loiter"), st.floats(0.0, 0.2)),
    st.tuples(st.just("end"), st.sampled_from([20, 21])),
)


def _item(seq: int, count: int, spec: tuple) -> PlanItem:
    kind, *v = spec
    if kind == "wp":
        return waypoint(seq, v[0], v[1], v[2], yaw_deg=v[3])
    if kind == "jump":
        target = v[0] % count
        return plain(seq, 177, target, v[1]) if target != seq else plain(seq, 112, 0.0)
    command, params = {
        "speed": (178, [1.0, *v]),
        "yaw": (115, [v[0], 0.0, 0.0, v[1]] if kind == "yaw" else []),
        "delay": (93, v),
        "home": (179, [1.0]),
        "loiter": (19, v),
        "end": (v[0] if kind == "end" else 20, [0.0, 0.0, 0.0, NAN]),
    }[kind]
    return plain(seq, int(command), *params)


@settings(max_examples=60)
@given(st.lists(steps, min_size=1, max_size=8), st.lists(st.integers(0, 400), max_size=3))
def test_any_mission_comes_to_an_end_with_sane_outputs(specs: list[tuple], pauses: list[int]) -> None:
    items = [_item(k, len(specs), spec) for k, spec in enumerate(specs)]
    flight = Flight(items)
    flight.sequencer.start()
    lap = 0
    for k in range(12_000):
        if k in pauses:
            flight.sequencer.pause()
        elif k - 5 in pauses:
            flight.sequencer.start()
        out = flight.tick()
        assert len(out.reached) <= 1
        assert all(items[seq].command in (16, 17, 19, 20, 21, 93) for seq in out.reached)
        assert 0 <= out.progress.current_seq < len(items)
        assert out.progress.lap >= lap
        lap = out.progress.lap
        if out.goal is not None:
            assert bool(np.all(np.isfinite(out.goal.pos_ned_m)))
            assert 0.05 <= out.goal.pos_ned_m[2] <= 1.2
            assert out.goal.yaw_rad is None or math.isfinite(out.goal.yaw_rad)
            assert out.goal.speed_m_s > 0.0
        if out.progress.state is S.COMPLETE:
            break
    assert out.progress.state is S.COMPLETE
    assert out.action in (Action.HOLD, Action.SURFACE)
    if not pauses:
        redundant_one = Flight(items)
        redundant_one.sequencer.start()
        redundant_one.fly(12_000)
        assert redundant_one.reached == flight.reached
        assert np.array_equal(redundant_one.pos, flight.pos)


@given(st.floats(0.0, 1.0), st.floats(0.0, 0.5))
def test_reached_is_surely_reached(sigma_m: float, distance_m: float) -> None:
    goal = Goal(pos_ned_m=np.zeros(3), yaw_rad=None, speed_m_s=0.3, accept_radius_m=0.3, accept_yaw_rad=0.15, seq=0)
    variance = np.zeros(12)
    variance[0] = sigma_m**2
    seen = replace(nav(distance_m, 0.0, 0.0), variance=variance)
    inside = is_inside(goal, seen)
    if distance_m > 0.3 or (distance_m > 0.27 and distance_m + 3.0 * sigma_m > 0.3 + 1e-9):
        assert not inside
    if distance_m < 0.27:
        assert inside


@pytest.mark.parametrize(("altitude", "depth"), [(50.0, 0.6), (0.0, 0.6), (-0.9, 0.9)])
def test_a_takeoff_dives_where_the_vehicle_is(altitude: float, depth: float) -> None:
    """As QGroundControl begins every plan: with a place on the map and a height in the air."""
    takeoff = PlanItem(
        seq=0, frame=3, command=22, param1=15.0, param2=0.0, param3=0.0, param4=NAN, x=379_755_100, y=237_790_100,
        z=altitude, autocontinue=1,
    )  # fmt: skip
    flight = Flight([takeoff, waypoint(1, -1.0, 0.0)], TKOFF_DEPTH=0.6)
    flight.pos = np.array([-1.0, 0.2, 0.0])
    flight.sequencer.start()
    while 0 not in flight.reached:
        out = flight.tick()
        if 0 not in flight.reached:
            assert out.goal is not None
            assert out.goal.pos_ned_m.tolist() == pytest.approx([-1.0, 0.2, depth])
    assert abs(depth - flight.pos[2]) < 0.15
    assert flight.fly() == [0, 1]
