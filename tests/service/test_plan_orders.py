"""Uploads, clears, parameters and orders in any sequence: what is told is true, and nothing unfit is flown."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from commander_bench import OK, Bench
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from autopilot.command.arming import CHECKING
from autopilot.core import free_space
from autopilot.core.background import BackgroundWorker, Cancel
from autopilot.core.geodesy import GeodeticPosition
from autopilot.core.plan import MissionResult, PlanItem, PlanKind
from autopilot.mavlink.api import CommandResult, FlightMode
from autopilot.mission.fence import fence_clearance_m
from autopilot.mission.plan_check import judge
from autopilot.mission.store import CHECK_TICKS, Change, plan_checksum
from tests.plan_items import box, circle, local, waypoint

HALF_N, HALF_E = 3.0, 2.0


coordinate = st.tuples(st.floats(-HALF_N, HALF_N), st.floats(-HALF_E, HALF_E))
depth = st.sampled_from((0.3, 0.5, 1.1, 1.6))


@st.composite
def missions(draw: st.DrawFn) -> tuple[PlanItem, ...]:
    places = draw(st.lists(st.tuples(coordinate, depth), max_size=4))
    return tuple(waypoint(k, north, east, z) for k, ((north, east), z) in enumerate(places))


@st.composite
def fences(draw: st.DrawFn) -> tuple[PlanItem, ...]:
    items: list[PlanItem] = []
    if draw(st.booleans()):
        scale = draw(st.sampled_from((1.2, 1.0, 0.6)))
        items += box(0, 0.0, 0.0, scale * HALF_N, scale * HALF_E, True)
    for north, east in draw(st.lists(coordinate, max_size=2)):
        items.append(circle(len(items), north, east, draw(st.sampled_from((0.2, 0.5, 1.0)))))
    if draw(st.booleans()):
        items += box(len(items), draw(st.floats(-2.0, 2.0)), 0.0, 0.1, draw(st.sampled_from((0.8, 2.5))), False)
    return tuple(items)


rallies = st.lists(coordinate, max_size=2).map(lambda ps: tuple(local(k, 5100, *p) for k, p in enumerate(ps)))
PARAMETERS = {
    "DEPTH_MAX": (1.0, 1.2, 2.0),
    "DEPTH_MIN": (0.05, 0.4),
    "MPC_MARGIN": (0.0, 0.03, 0.3),
    "FENCE_GAP_CHK": (0.0, 1.0),
    "FENCE_ARMED_CHG": (0.0, 1.0),
    "WP_ACCEPT_RADIUS": (0.05, 0.3),
}
orders = st.one_of(
    st.tuples(st.just("mission"), missions()),
    st.tuples(st.just("fence"), fences()),
    st.tuples(st.just("rally"), rallies),
    st.tuples(st.just("clear"), st.sampled_from(((0,), (1,), (2,), (0, 1, 2)))),
    st.sampled_from(sorted(PARAMETERS)).flatmap(lambda n: st.tuples(st.just(n), st.sampled_from(PARAMETERS[n]))),
    st.tuples(st.just("origin"), st.sampled_from((0.0, 1e-5, 0.5))),
    st.tuples(st.just("arm"), st.booleans()),
    st.tuples(
        st.sampled_from(("disarm", "start", "mode", "resume", "pause", "go to", "item", "surface")), st.just(None)
    ),
)
ticks = st.sampled_from((1, 2, CHECK_TICKS, CHECK_TICKS + 2))


class Yard(Bench):
    """A bench whose plans are checked beside the loop, and which watches."""

    def __init__(self) -> None:
        super().__init__(worker=BackgroundWorker())
        self.changes: list[Change] = []
        self._judged: dict[int, tuple[Any, str]] = {}
        self.run()

    def fresh(self) -> str:
        """What a check of the plans in force says now, made anew."""
        question = replace(
            self.plans.verdict.question,
            plans={kind: self.plans.items(kind) for kind in PlanKind},
            origin=self.plans.origin,
            limits=self.plans._question().limits,
        )
        key = hash((*(id(question.plans[kind]) for kind in PlanKind), question.origin, question.limits))
        if key not in self._judged:
            self._judged[key] = (question, judge(question, Cancel()).problem)
        return self._judged[key][1]

    def do(self, order: str, value: Any) -> None:
        commander = self.commander
        at_home = self.plans.origin
        if order in ("mission", "fence", "rally"):
            self.propose({PlanKind[order.upper()]: value})
        elif order == "clear":
            self.propose({PlanKind(kind): () for kind in value})
        elif order in PARAMETERS:
            self.params.set(order, value)
        elif order == "origin":
            point = GeodeticPosition(lat_deg=at_home.lat_deg + value, lon_deg=at_home.lon_deg, alt_m=0.0)
            armed = commander.armed
            assert not (commander.set_origin(point).result is OK and armed)
        elif order == "arm":
            before, armed = self.may_fly(), commander.armed
            answer = commander.arm(value)
            if answer.result is OK and not value and not armed:
                assert before, "armed with plans that must not be flown"
        elif order == "disarm":
            commander.disarm(False)
        elif order == "pause":
            commander.pause()
        elif order == "surface":
            commander.set_mode(FlightMode.SURFACE)
        elif order == "item":
            commander.set_current_item(0)
        elif order == "go to":
            commander.go_to(GeodeticPosition(lat_deg=at_home.lat_deg, lon_deg=at_home.lon_deg, alt_m=-0.5), None)
        else:
            start = {
                "start": lambda: commander.start_mission(None),
                "mode": lambda: commander.set_mode(FlightMode.MISSION),
                "resume": commander.resume,
            }[order]
            was, before, checking = commander.mode, self.may_fly(), self.plans.checking
            answer = start()
            if answer.result is OK:
                assert before and self.plans.items(PlanKind.MISSION), "started with plans that must not be flown"
            else:
                assert commander.mode is was
                assert answer.reason
                assert (answer.result is CommandResult.TEMPORARILY_REJECTED) == (CHECKING in answer.reason)
                assert checking or CHECKING not in answer.reason

    def may_fly(self) -> bool:
        return not self.plans.checking and self.fresh() == ""

    def propose(self, plans: dict[PlanKind, tuple[PlanItem, ...]]) -> None:
        in_force = self.in_force()
        self.changes.append(self.plans.propose(plans))
        assert self.in_force() == in_force

    def in_force(self) -> list[int]:
        """Which plans are in force."""
        return [id(self.plans.items(kind)) for kind in PlanKind]

    def watch(self) -> None:
        """After a tick."""
        commander, plans = self.commander, self.plans
        if plans.checking:
            return
        problem = plans.problem
        assert problem == self.fresh()
        if commander.armed and commander.mode is FlightMode.MISSION:
            assert problem == ""
        assert any(reason.text == f"plan: {problem}" for reason in commander.arming_reasons) == bool(problem)
        told = [text for text in self.texts if text.startswith(("No start: ", "Holding: ", "Plan ok"))]
        assert (told[-1].partition(": ")[2] if told else "") == problem


@pytest.fixture
def coarse() -> Iterator[None]:
    """Coarser cells for the search of ways: the rule is looked at here, not the geometry."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(free_space, "SPACE", replace(free_space.SPACE, base_cells=1500))
        yield


@settings(max_examples=120, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(st.lists(st.tuples(orders, ticks), min_size=4, max_size=16), coordinate, st.integers(0, 3))
def test_in_any_order_nothing_unfit_is_flown_and_what_is_told_is_true(
    coarse: None, steps: list[tuple[tuple[str, Any], int]], place: tuple[float, float], begun: int
) -> None:
    yard = Yard()
    yard.pos = np.array([*place, 0.5])
    yard.run()
    if begun:
        wide = box(0, 0.0, 0.0, 2.0 * HALF_N, 2.0 * HALF_E, True)
        assert yard.plans.replace(PlanKind.FENCE, tuple(wide)) is None
        assert yard.plans.replace(PlanKind.MISSION, (waypoint(0, 0.0, 0.0), waypoint(1, 2.0, 1.0))) is None
        yard.run()
    if begun > 1:
        assert yard.commander.arm(False).result is OK
    if begun == 3:
        assert yard.commander.start_mission(None).result is OK
    for (order, value), count in steps:
        yard.do(order, value)
        for _ in range(count):
            armed, allowed = yard.commander.armed, bool(yard.params["FENCE_ARMED_CHG"])
            before, in_force = yard.plans.items(PlanKind.FENCE), yard.in_force()
            waiting = [change for change in yard.changes if not change.done]
            yard.run()
            yard.watch()
            after = yard.plans.items(PlanKind.FENCE)
            if armed and not allowed and plan_checksum(after) != plan_checksum(before):
                assert after or not before, "the fence of an armed vehicle was removed"
                assert not yard.plans.verdict.joint
            if any(change.done and change.rejection is not None for change in waiting):
                assert yard.in_force() == in_force, "a refused request changes nothing"
    yard.run(0.5)
    yard.watch()
    assert not yard.plans.checking, "a check must come to its end"
    assert all(change.done for change in yard.changes)


def test_the_answer_to_a_check_comes_a_counted_number_of_ticks_later() -> None:
    yard = Yard()
    fence = tuple(box(0, 0.0, 0.0, HALF_N, HALF_E, True))
    change = yard.plans.propose({PlanKind.FENCE: fence})
    for _ in range(CHECK_TICKS - 1):
        yard.run()
        assert not change.done and yard.plans.items(PlanKind.FENCE) == ()
    yard.run()
    assert change.done and change.rejection is None and yard.plans.items(PlanKind.FENCE) is fence


def test_arming_and_starting_wait_for_the_check_of_new_parameters() -> None:
    yard = Yard()
    yard.load()
    yard.run()
    yard.params.set("DEPTH_MAX", 0.4)
    for answer in (yard.commander.arm(False), yard.commander.set_mode(FlightMode.MISSION)):
        assert answer.result is CommandResult.TEMPORARILY_REJECTED and CHECKING in answer.reason
    yard.run(0.01 * CHECK_TICKS + 0.01)
    assert "DEPTH_MAX 0.4 m" in yard.commander.arm(False).reason
    assert yard.texts[-1].startswith("No start: item 0: depth 0.45 m, DEPTH_MAX 0.4 m: use 0.05 to 0.4 m")
    yard.params.set("DEPTH_MAX", 0.5)
    yard.run(0.01 * CHECK_TICKS + 0.01)
    assert yard.texts[-1] == "Plan ok"
    assert yard.commander.arm(False).result is OK


def test_parameters_that_never_rest_do_not_keep_a_client_waiting_for_ever() -> None:
    yard = Yard()
    change = yard.plans.propose({PlanKind.FENCE: tuple(box(0, 0.0, 0.0, HALF_N, HALF_E, True))})
    for k in range(200):
        yard.params.set("DEPTH_MAX", 2.0 + k % 2)
        yard.run()
    assert change.done and change.rejection is not None and "try again" in change.rejection.reason
    yard.run(0.1)
    assert not yard.plans.checking


def test_an_armed_vehicle_keeps_a_fence_that_it_does_not_break() -> None:
    yard = Yard()
    yard.load()
    yard.armed()
    tank = yard.plans.items(PlanKind.FENCE)

    def offer(fence: tuple[PlanItem, ...]) -> str:
        change = yard.plans.propose({PlanKind.FENCE: fence})
        yard.run(0.1)
        assert change.done
        taken = change.rejection is None
        assert (yard.plans.items(PlanKind.FENCE) is fence) == taken
        if change.rejection is None:
            return ""
        assert change.rejection.result == MissionResult.DENIED
        assert change.rejection.reason.endswith("; FENCE_ARMED_CHG 1 allows it")
        return change.rejection.reason

    north, east, _ = yard.pos
    around = circle(len(tank), north + 0.1, east, 0.3)
    assert "disarm" in offer(())
    assert "disarm" in offer((local(0, 5000, 0.0, 0.0),)), "a return point keeps nothing in or out"
    assert "the vehicle would be" in offer((*tank, around))
    assert "armed and item 1 is" in offer((*tank[:4], circle(4, 1.75, 0.0, 0.1)))
    assert offer(tuple(replace(item) for item in tank)) == ""
    assert yard.commander.armed
    yard.params.set("FENCE_ARMED_CHG", 1)
    assert offer(()) == ""
    assert float(fence_clearance_m(yard.commander.fence, yard.pos[None, :2])[0]) == np.inf
    assert offer((*tank[:4], circle(4, 1.75, 0.0, 0.1))) == ""
    assert yard.commander.start_mission(None).result is CommandResult.DENIED


def test_an_armed_vehicle_takes_no_fence_that_cuts_it_off_from_its_item() -> None:
    yard = Yard()
    basin = tuple(box(0, 0.0, 0.0, HALF_N, HALF_E, True))
    wall = box(4, 0.5, 0.0, 0.1, HALF_E, False)
    assert yard.plans.replace(PlanKind.FENCE, basin) is None
    assert yard.plans.replace(PlanKind.MISSION, (waypoint(0, 2.0, 0.0),)) is None
    yard.armed()
    for mode, refused in ((FlightMode.MISSION, True), (FlightMode.HOLD, False)):
        assert yard.commander.set_mode(mode).result is OK
        yard.run(0.1)
        change = yard.plans.propose({PlanKind.FENCE: (*basin, *wall)})
        yard.run(0.1)
        assert change.done and (change.rejection is not None) == refused
        if change.rejection is not None:
            assert change.rejection.reason.startswith("no free path from the vehicle to item 0: move the vehicle")


def test_a_check_that_fails_forbids_to_fly_and_ends_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    yard = Yard()
    yard.load()
    yard.run()

    def broken(*_: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr("autopilot.mission.store.judge", broken)
    change = yard.plans.propose({PlanKind.MISSION: ()})
    yard.run(0.1)
    assert change.rejection is not None and "ZeroDivisionError" in change.rejection.reason
    assert yard.commander.arm(False).result is OK, "the plans in force are as good as before"
    yard.commander.disarm(False)
    yard.params.set("DEPTH_MAX", 1.1)
    yard.run(0.1)
    assert "the plan check failed" in yard.commander.arm(False).reason
