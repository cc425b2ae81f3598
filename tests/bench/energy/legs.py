"""``autopilot bench energy-legs``: how long plans of random legs take, and how many legs get none.

Every leg has a rectangular basin of its own, 5 to 500 m long, with up to eight pillars and a uniform current: from rest
or under way, with and without a heading and a leg after it. What is measured are the quick plan and the full search.
"""

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from autopilot.control.constraints.obstacles import clearance_m
from autopilot.control.energy.flow import FlowSamples
from autopilot.control.energy.leg_task import shifted
from autopilot.control.energy.patience import Kind
from autopilot.control.energy.power import PowerModel
from autopilot.control.energy.request import Plan, TrajectoryRequest
from autopilot.control.energy.search import EnergyPlanner
from autopilot.core.frames import FloatArray
from autopilot.core.geometry import Circle, Fence, Polygon
from autopilot.core.messages import Goal
from autopilot.core.vehicle import load_vehicle
from tests.control.control_loop import goal as goal_at

LEGS, SHORT_LEGS = 300, 20
SEED = 11
SIDE_M = (5.0, 500.0)
"""Long side of a basin, spread evenly by its logarithm."""

DEPTH_M = 5.0
PILLARS = 8
KEEP_M, FREE_M = 0.33, 0.45
"""Body radius with its margin; clearance of starts and goals."""

SHORTEST_M = 0.5
FASTEST_M_S = 0.2
"""Of the current: half of what the vehicle can do."""

LIMITS = np.array([0.45, 0.24, 0.96, 0.0, DEPTH_M])
THRUST_N, BUOYANCY_N = 11.5, 0.6
BAR_S = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class LegsRow:
    """Plans of one kind, seconds."""

    kind: str
    legs: int
    without: int
    """Legs that got no plan."""
    slow: int
    """Plans that took more CPU time than BAR_S."""
    cpu_p50_s: float
    cpu_p99_s: float
    cpu_max_s: float
    wall_p50_s: float
    wall_p99_s: float
    wall_max_s: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TimedPlan:
    kind: Kind
    plan: Plan
    cpu_s: float
    wall_s: float


def bench_legs(legs: int = LEGS) -> list[LegsRow]:
    taken: dict[Kind, list[TimedPlan]] = {Kind.QUICK: [], Kind.COLD: []}
    for one in timed_plans(legs):
        taken[one.kind].append(one)
    return [_row(kind, plans) for kind, plans in taken.items()]


def timed_plans(legs: int) -> Iterator[TimedPlan]:
    """The quick plan of every leg, then its full search, as the guidance asks for them."""
    vehicle = load_vehicle("lbv150")
    planner = EnergyPlanner(vehicle.to_model(), PowerModel.of(vehicle))
    planner.plan(random_leg(0))  # programs are built once
    for leg in range(legs):
        request = random_leg(leg)
        for kind in (Kind.QUICK, Kind.COLD):
            cpu_s, wall_s = time.process_time(), time.perf_counter()
            plan = planner.plan(replace(request, kind=kind))
            took = time.process_time() - cpu_s, time.perf_counter() - wall_s
            yield TimedPlan(kind=kind, plan=plan, cpu_s=took[0], wall_s=took[1])
            if plan.trajectory is not None:
                request = replace(request, warm=shifted(plan.trajectory, 0.0, request.x0))


def random_leg(leg: int) -> TrajectoryRequest:
    """The request of one leg: a function of its number."""
    rng = np.random.default_rng((SEED, leg))
    long_m = float(np.exp(rng.uniform(*np.log(SIDE_M))))
    half = 0.5 * long_m * np.array([1.0, rng.uniform(0.5, 1.0)])
    fence, places = _basin(rng, half, long_m)
    course, current_m_s = rng.uniform(-math.pi, math.pi), float(rng.uniform(0.0, FASTEST_M_S))
    current = np.zeros((9, 9, 3))
    current[..., :2] = current_m_s * np.array([math.cos(course), math.sin(course)])
    goals = [_goal(rng, place) for place in places[1:]]
    to = goals[0] if rng.uniform() < 0.3 else replace(goals[0], following=goals[1])
    x0 = np.array([*places[0], *np.zeros(5)])
    x0[3] = rng.uniform(-math.pi, math.pi)
    if rng.uniform() < 0.5:
        x0[4:] = rng.uniform(0.0, 0.4), rng.normal(0.0, 0.03), rng.normal(0.0, 0.02), rng.normal(0.0, 0.1)
    return TrajectoryRequest(
        x0=x0,
        goal=to,
        fence=fence,
        radius_m=KEEP_M,
        flow=FlowSamples(
            north_m=np.linspace(-half[0] - 1.0, half[0] + 1.0, 9),
            east_m=np.linspace(-half[1] - 1.0, half[1] + 1.0, 9),
            current_ned_m_s=current,
        ),
        limits=LIMITS,
        thrust_limit_n=np.full(4, THRUST_N),
        buoyancy_excess_n=BUOYANCY_N,
        cruise_m_s=to.speed_m_s,
    )


def _basin(rng: np.random.Generator, half: FloatArray, long_m: float) -> tuple[Fence, list[FloatArray]]:
    """A basin with pillars, and three free places (3,) that lie apart."""
    corners = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]) * half
    count = int(rng.integers(0, PILLARS + 1))
    radius_m = rng.uniform(0.1, 0.02 * long_m + 0.2, count)
    pillars = tuple(Circle(center_ned_m=rng.uniform(-half, half), radius_m=float(r)) for r in radius_m)
    fence = Fence(inclusions=(Polygon(vertices_ned_m=corners),), exclusions=pillars, depth_max_m=DEPTH_M)
    places: list[FloatArray] = []
    while len(places) < 3:
        place = np.array([*rng.uniform(-half, half), rng.uniform(0.5, DEPTH_M - 0.5)])
        apart = not places or np.hypot(*(place - places[-1])[:2]) > SHORTEST_M
        if apart and clearance_m(fence, [place[:2].tolist()])[0] > FREE_M:
            places.append(place)
    return fence, places


def _goal(rng: np.random.Generator, place: FloatArray) -> Goal:
    north, east, down = place.tolist()
    return goal_at(north, east, down, float(rng.uniform(-math.pi, math.pi)) if rng.uniform() < 0.3 else None)


def _row(kind: Kind, plans: list[TimedPlan]) -> LegsRow:
    cpu_s, wall_s = np.array([[one.cpu_s, one.wall_s] for one in plans]).T
    quantiles = [[float(np.quantile(each, q)) for q in (0.5, 0.99, 1.0)] for each in (cpu_s, wall_s)]
    return LegsRow(
        kind=kind.value,
        legs=len(plans),
        without=sum(one.plan.trajectory is None for one in plans),
        slow=int((cpu_s > BAR_S).sum()),
        cpu_p50_s=quantiles[0][0],
        cpu_p99_s=quantiles[0][1],
        cpu_max_s=quantiles[0][2],
        wall_p50_s=quantiles[1][0],
        wall_p99_s=quantiles[1][1],
        wall_max_s=quantiles[1][2],
    )
