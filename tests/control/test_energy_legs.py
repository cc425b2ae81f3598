"""Legs whose programs were not solved, or only after thousands of trial steps: every leg has a plan, soon."""

from dataclasses import replace

import numpy as np
import pytest
from control_loop import MODEL, VEHICLE, goal

from autopilot.control.energy.flow import FlowSamples
from autopilot.control.energy.patience import Kind
from autopilot.control.energy.power import PowerModel
from autopilot.control.energy.request import TrajectoryRequest
from autopilot.control.energy.search import EnergyPlanner
from autopilot.control.energy.trajectory import Program, Trajectory
from autopilot.core.geometry import Circle, Fence, Polygon
from tests.bench.energy.legs import random_leg

PLANNER = EnergyPlanner(MODEL, PowerModel.of(VEHICLE))
MOST_ITERATIONS = 150
"""Of all programs of a plan, at 5 ms each. Unlike time they do not depend on the machine."""


@pytest.fixture
def iterations(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Of every program that is solved."""
    counts: list[int] = []
    solve = Program.solve

    def counted(program: Program, *arguments: object, **more: object) -> Trajectory:
        found = solve(program, *arguments, **more)  # type: ignore[arg-type]
        counts.append(program.iterations)
        return found

    monkeypatch.setattr(Program, "solve", counted)
    return counts


@pytest.mark.parametrize("moved", range(3))
def test_a_start_moved_by_centimetres_has_its_plan_as_soon(moved: int, iterations: list[int]) -> None:
    """50 x 50 m, one pillar off the way: 0.2 s, 4 s or no plan, as chance had it."""
    corners = np.array([[-25.0, -25.0], [25.0, -25.0], [25.0, 25.0], [-25.0, 25.0]])
    pillar = Circle(center_ned_m=np.array([21.27, 0.54]), radius_m=0.3)
    axis, current = np.linspace(-26.0, 26.0, 9), np.zeros((9, 9, 3))
    current[..., :2] = 0.12, -0.08
    to = replace(goal(8.0, 5.0, 2.0, None), following=goal(8.0, -8.0, 2.0, None))
    request = TrajectoryRequest(
        x0=np.array([-8.0 + 0.1 * moved, -6.0 + 0.05 * moved, 2.0, *np.zeros(5)]),
        goal=to,
        fence=Fence(inclusions=(Polygon(vertices_ned_m=corners),), exclusions=(pillar,), depth_max_m=5.0),
        radius_m=0.33,
        flow=FlowSamples(north_m=axis, east_m=axis, current_ned_m_s=current),
        limits=np.array([0.45, 0.24, 0.96, 0.0, 5.0]),
        thrust_limit_n=np.full(4, 11.5),
        buoyancy_excess_n=0.6,
        cruise_m_s=to.speed_m_s,
    )
    plan = PLANNER.plan(request)
    assert plan.trajectory is not None, plan.why
    assert sum(iterations) < MOST_ITERATIONS


@pytest.mark.parametrize(
    ("leg", "kind"),
    [(30, Kind.QUICK), (60, Kind.QUICK), (82, Kind.QUICK), (124, Kind.COLD), (152, Kind.COLD), (159, Kind.QUICK)],
)
def test_random_legs_that_had_none(leg: int, kind: Kind, iterations: list[int]) -> None:
    plan = PLANNER.plan(replace(random_leg(leg), kind=kind))
    assert plan.trajectory is not None, plan.why
    assert sum(iterations) < MOST_ITERATIONS


def test_a_program_that_is_not_solved_is_begun_once_more_from_a_slower_guess(monkeypatch: pytest.MonkeyPatch) -> None:
    solve, guesses = Program.solve, []

    def first_fails(
        program: Program, ask: object, x: object, thrust: object, end_s: float, **more: object
    ) -> Trajectory:
        guesses.append(end_s)
        found = solve(program, ask, x, thrust, end_s, **more)  # type: ignore[arg-type]
        return replace(found, solved=len(guesses) > 1)

    monkeypatch.setattr(Program, "solve", first_fails)
    plan = PLANNER.plan(replace(random_leg(30), kind=Kind.QUICK))
    assert plan.trajectory is not None, plan.why
    assert len(guesses) == 2 and guesses[1] == pytest.approx(1.3 * guesses[0])
