"""``autopilot bench energy-latency``: how long plans of least energy take, beside when their answers are due.

Requests as a flight makes them, of every kind and in three kinds of water: the paper's tank with its jet, a basin of
40 x 25 m with ten pillars, and open water with legs of 60 to 85 m. In lockstep an answer is due after what the slowest
tenth of its kind takes (:data:`autopilot.control.energy.patience.ANSWER_STEPS`), so that a run at any speed plans as
late as a vehicle does.
"""

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from autopilot.analysis.nmpc_flight import TANK
from autopilot.control.current.currents import CurrentForecast, EstimatedCurrent
from autopilot.control.energy.energy_tuning import PATIENCE
from autopilot.control.energy.flow import area_of, sample_flow
from autopilot.control.energy.leg_task import shifted
from autopilot.control.energy.patience import ANSWER_STEPS, Kind
from autopilot.control.energy.power import PowerModel
from autopilot.control.energy.request import Plan, TrajectoryRequest
from autopilot.control.energy.search import EnergyPlanner
from autopilot.core.frames import FloatArray
from autopilot.core.geometry import Circle, Fence, Polygon
from autopilot.core.messages import Goal, NavState
from autopilot.core.vehicle import load_vehicle
from tests.bench.energy.cases import CASES, A, B, EnergyGoal
from tests.bench.energy.flight import known_current, nav_state, plant_of
from tests.control.control_loop import goal as goal_at

RUNS, SHORT_RUNS = 8, 3
"""Requests per kind and water."""

KEEP_M = 0.33
LIMITS = np.array([0.45, 0.24, 0.96, 0.0, 50.0])
THRUST_N, BUOYANCY_N = 11.5, 0.6
UPDATE_AFTER = 0.3
"""Share of a trajectory after which it is brought up to date."""

OFF_M = 0.1
"""How far from it the vehicle is then."""

SEED = 7


@dataclass(frozen=True, slots=True, kw_only=True)
class LatencyRow:
    """One kind of request in one kind of water, CPU seconds."""

    situation: str
    kind: str
    plans: int
    """How many requests were answered with a trajectory."""
    asked: int
    p50_s: float
    p90_s: float
    max_s: float
    due_s: float
    """When the answer is taken in lockstep."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Situation:
    name: str
    fence: Fence
    forecast: CurrentForecast
    nav: NavState
    legs: list[tuple[FloatArray, Goal]]
    """Where from (8,), where to."""


def bench_latency(runs: int = RUNS) -> Iterator[LatencyRow]:
    vehicle = load_vehicle("lbv150")
    planner = EnergyPlanner(vehicle.to_model(), PowerModel.of(vehicle))
    planner.warm()
    for situation in _situations(runs):
        spent_s: dict[Kind, list[float]] = {kind: [] for kind in Kind}
        solved = dict.fromkeys(Kind, 0)
        for x0, goal in situation.legs:
            request = _request(situation, x0, goal)
            quick = _timed(planner, request, Kind.QUICK, spent_s, solved).trajectory
            if quick is not None:
                request = replace(request, warm=shifted(quick, 0.0, x0))
            plan = _timed(planner, request, Kind.COLD, spent_s, solved)
            found = plan.trajectory
            if found is None:
                continue
            by_s = UPDATE_AFTER * float(found.t_s[-1])
            here = np.array([np.interp(by_s, found.t_s, column) for column in found.x.T])
            here[:2] += OFF_M / math.sqrt(2.0)
            again = replace(_request(situation, here, goal), warm=shifted(found, by_s, here))
            _timed(planner, again, Kind.WARM, spent_s, solved)
            if goal.following is not None:
                _timed(planner, _request(situation, found.x[-1], goal.following), Kind.NEXT, spent_s, solved)
        for kind, seconds in spent_s.items():
            if seconds:
                p50, p90 = np.quantile(seconds, (0.5, 0.9))
                yield LatencyRow(
                    situation=situation.name,
                    kind=kind.value,
                    plans=solved[kind],
                    asked=len(seconds),
                    p50_s=float(p50),
                    p90_s=float(p90),
                    max_s=max(seconds),
                    due_s=ANSWER_STEPS[kind] * PATIENCE.step_s,
                )


def _timed(
    planner: EnergyPlanner,
    request: TrajectoryRequest,
    kind: Kind,
    spent_s: dict[Kind, list[float]],
    solved: dict[Kind, int],
) -> Plan:
    begin_s = time.thread_time()
    plan = planner.plan(replace(request, kind=kind))
    spent_s[kind].append(time.thread_time() - begin_s)
    solved[kind] += plan.trajectory is not None
    return plan


def _request(situation: _Situation, x0: FloatArray, goal: Goal) -> TrajectoryRequest:
    places = [x0[:2], goal.pos_ned_m[:2]] + ([] if goal.following is None else [goal.following.pos_ned_m[:2]])
    area = area_of(situation.fence, np.stack(places))
    return TrajectoryRequest(
        x0=x0,
        goal=goal,
        fence=situation.fence,
        radius_m=KEEP_M,
        flow=sample_flow(situation.forecast, situation.nav, area, float(x0[2])),
        limits=LIMITS,
        thrust_limit_n=np.full(4, THRUST_N),
        buoyancy_excess_n=BUOYANCY_N,
    )


def _situations(runs: int) -> Iterator[_Situation]:
    rng, vehicle = np.random.default_rng(SEED), load_vehicle("lbv150")
    still = nav_state(plant_of(CASES["b1"], vehicle).truth)
    there, back = _goal(EnergyGoal(pos_ned_m=B[:3], yaw_rad=B[3])), _goal(EnergyGoal(pos_ned_m=A[:3], yaw_rad=A[3]))
    legs = []
    for index in range(runs):
        begin, to, then = ((*A,), there, back) if index % 2 == 0 else ((*B,), back, there)
        x0 = np.array([*begin, *rng.normal(0.0, 0.05, 3), rng.normal(0.0, 0.1)])
        x0[:2] += rng.uniform(-0.2, 0.2, 2)
        legs.append((x0, replace(to, following=replace(then, following=to))))
    yield _Situation(name="tank", fence=TANK, forecast=known_current(CASES["b1"]), nav=still, legs=legs)
    flowing = replace(still, current_ned_m_s=np.array([0.12, -0.08, 0.0]))
    edge = np.array([[0.0, 0.0], [40.0, 0.0], [40.0, 25.0], [0.0, 25.0]])
    grid = np.stack(np.meshgrid(np.linspace(8.0, 32.0, 5), (8.0, 17.0), indexing="ij"), axis=-1).reshape(-1, 2)
    pillars = tuple(Circle(center_ned_m=place + rng.uniform(-1.5, 1.5, 2), radius_m=1.0) for place in grid)
    basin = Fence(inclusions=(Polygon(vertices_ned_m=edge),), exclusions=pillars, depth_max_m=5.0)
    corners = [
        np.array([rng.uniform(2.0, 5.0), rng.uniform(2.0, 23.0), rng.uniform(1.0, 4.0)]) for _ in range(runs + 2)
    ]
    for place in corners[1::2]:
        place[0] += 33.0
    yield _Situation(name="basin", fence=basin, forecast=EstimatedCurrent(), nav=flowing, legs=_tour(corners))
    places = [np.zeros(3)]
    for _ in range(runs + 1):
        course = rng.uniform(-math.pi, math.pi)
        step = rng.uniform(60.0, 85.0) * np.array([math.cos(course), math.sin(course)])
        places.append(np.array([*(places[-1][:2] + step), rng.uniform(10.0, 50.0)]))
    yield _Situation(
        name="open water", fence=Fence(depth_max_m=60.0), forecast=EstimatedCurrent(), nav=flowing, legs=_tour(places)
    )


def _tour(places: list[FloatArray]) -> list[tuple[FloatArray, Goal]]:
    """Legs from place to place, at rest over ground, each with the one after it."""
    goals = [_goal(EnergyGoal(pos_ned_m=(float(p[0]), float(p[1]), float(p[2])), yaw_rad=None)) for p in places]
    return [
        (np.array([*places[i], 0.0, 0.0, 0.0, 0.0, 0.0]), replace(goals[i + 1], following=goals[i + 2]))
        for i in range(len(places) - 2)
    ]


def _goal(goal: EnergyGoal) -> Goal:
    return goal_at(*goal.pos_ned_m, goal.yaw_rad)
