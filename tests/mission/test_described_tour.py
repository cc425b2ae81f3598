"""The tour that a log is judged by is the one that the mission flies, wherever it jumps."""

from pathlib import Path

import pytest
from click.testing import CliRunner
from hypothesis import example, given
from hypothesis import strategies as st

from autopilot import fly
from autopilot.cli.mission_new import new
from autopilot.core.messages import ProgressState
from autopilot.core.params import ParamSet
from autopilot.core.plan import PlanItem
from autopilot.log.analysis import visit_order
from autopilot.log.check import BoundVerdict, acceptance_table, overall
from autopilot.log.description import AcceptBounds, RunDescription
from autopilot.mission.item_types import parse_step
from autopilot.mission.items import GoTo, Step
from autopilot.mission.paper import paper_plan
from autopilot.run.describe import Tour, tour_of
from tests.mission.test_mission_sequencer import Flight
from tests.plan_items import ORIGIN, plain, waypoint

TICKS = 6000


def steps_of(items: tuple[PlanItem, ...]) -> list[Step]:
    return [parse_step(item, ORIGIN) for item in items]


def described(items: tuple[PlanItem, ...]) -> Tour:
    return tour_of(steps_of(items), ParamSet())


def jump(seq: int, target_seq: int, count: int) -> PlanItem:
    return plain(seq, 177, target_seq, count)


@st.composite
def missions(draw: st.DrawFn) -> tuple[PlanItem, ...]:
    count = draw(st.integers(1, 6))
    items = [waypoint(seq, draw(st.floats(-1.0, 1.0)), draw(st.floats(-1.0, 1.0)), 0.5) for seq in range(count)]
    for seq in draw(st.sets(st.integers(1, count - 1), max_size=2)) if count > 1 else ():
        target_seq = draw(st.integers(0, count - 1).filter(lambda target, seq=seq: target != seq))
        items[seq] = jump(seq, target_seq, draw(st.integers(-1, 2)))
    return tuple(items)


@given(missions())
@example((waypoint(0, 1.0, 0.0, 0.5), waypoint(1, -1.0, 0.0, 0.5), jump(2, 0, 1)))  # as `mission new --laps 2`
@example((waypoint(0, 1.0, 0.0, 0.5), waypoint(1, -1.0, 0.0, 0.5), waypoint(2, 0.0, 1.0, 0.5), jump(3, 1, 2)))
@example((waypoint(0, 1.0, 0.0, 0.5), waypoint(1, -1.0, 0.0, 0.5), jump(2, 0, 1), waypoint(3, 0.0, 1.0, 0.5)))
@example(paper_plan(3).mission)
def test_the_judged_tour_is_the_one_that_is_flown(items: tuple[PlanItem, ...]) -> None:
    tour = described(items)
    run = RunDescription(
        scenario="tour",
        vehicle="lbv150",
        waypoints=tour.waypoints,
        closed_tour=tour.closed,
        tour=tour.order,
        accept=AcceptBounds(laps=tour.laps),
    )
    flight = Flight(items)
    flight.sequencer.start()
    places = {step.seq: step.pos_ned_m.tolist() for step in steps_of(items) if isinstance(step, GoTo)}
    flown = [places[seq] for seq in flight.fly(TICKS)]
    judged = [list(point.pos_ned_m) for point, _ in visit_order(run)]
    complete = flight.sequencer.state is ProgressState.COMPLETE
    assert judged == flown[: len(judged)] and (len(judged) == len(flown) or not complete)


def test_a_jump_ahead_without_end_is_made() -> None:
    """It leads past items, and ends nothing."""
    items = (waypoint(0, 0.0, 0.0), jump(1, 3, -1), waypoint(2, 1.0, 0.0), waypoint(3, 2.0, 0.0))
    assert described(items).order == (0, 2)


def test_laps_are_named_where_there_are_some() -> None:
    laps = [described(items) for items in (paper_plan(3).mission, (waypoint(0, 1, 0, 0.5), jump(1, 0, 4)))]
    assert [(tour.laps, tour.closed, len(tour.waypoints)) for tour in laps] == [(3, True, 2), (5, False, 1)]


@pytest.mark.long
def test_two_laps_back_to_the_first_waypoint_pass_the_check(tmp_path: Path) -> None:
    """As the first hour has it: A-B-A-B, and no way home."""
    plan = tmp_path / "mine.plan"
    obstacles = ("--obstacle", "-0.625,-0.625,0.16", "--obstacle", "0.9375,0,0.16")
    stops = ("--waypoint", "1.2,-0.8,0.4", "--waypoint", "-1.5,0.7,0.5,90")
    done = CliRunner().invoke(new, ("--tank", "5x3", *obstacles, *stops, "--laps", "2", "--out", str(plan)))
    assert done.exit_code == 0
    rows = acceptance_table(fly("paper-tank", plan=plan, sensors="pose", seed=1))
    laps = next(row for row in rows if row.name == "laps")
    assert (laps.worst, laps.limit) == (2.0, 2.0) and overall(rows) is BoundVerdict.PASS
