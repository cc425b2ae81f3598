"""Doors: what the check of uploads lets pass the route planner finds, and the energy planner, in basins of any size."""

import math
from dataclasses import dataclass

import numpy as np
import pytest
from control_loop import MODEL, VEHICLE, goal, nav_state

from autopilot.control.constraints.obstacles import Features
from autopilot.control.current.currents import EstimatedCurrent
from autopilot.control.energy.field import LONGEST_MOVE, EnergyField
from autopilot.control.energy.flow import FlowField, area_of, sample_flow
from autopilot.control.energy.power import PowerModel, speed_table
from autopilot.control.energy.request import TrajectoryRequest
from autopilot.control.energy.search import EnergyPlanner
from autopilot.control.path.planner import Planner
from autopilot.core.core_tuning import SPACE
from autopilot.core.frames import FloatArray
from autopilot.core.free_space import FreeSpace
from autopilot.core.geometry import Circle, Fence, Polygon
from autopilot.mission.mission_tuning import VALIDATION
from autopilot.mission.reach import FreeRegions

KEEP_M = 0.33
TABLE = speed_table(MODEL, PowerModel.of(VEHICLE), 0.5)


@dataclass(frozen=True, kw_only=True)
class Basin:
    """A basin with walls across it, a door in each."""

    fence: Fence
    start: FloatArray
    goal: FloatArray
    narrowest_m: float


def basin(rng: np.random.Generator, length_m: float, width_m: float, doors_m: list[float]) -> Basin:
    """Doors anywhere in walls of any thickness, pillars away from them, turned by any angle."""
    angle = rng.uniform(0.0, math.pi)
    turned = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]]).T
    at = length_m * (np.arange(len(doors_m)) + 1.0) / (len(doors_m) + 1.0)
    parts: list[Polygon | Circle] = []
    for x, door in zip(at, doors_m, strict=True):
        thick, y = float(rng.choice([0.002, 0.1, 0.5])), float(rng.uniform(1.0, width_m - 1.0 - door))
        for low, high in ((-1.0, y), (y + door, width_m + 1.0)):
            wall = np.array([[x, low], [x + thick, low], [x + thick, high], [x, high]])
            parts.append(Polygon(vertices_ned_m=wall @ turned))
    for x in 0.5 * (at[1:] + at[:-1]):
        radius = 0.05 * length_m / (len(doors_m) + 1.0)
        if width_m > 2.0 * radius + 3.0:
            center = np.array([x, rng.uniform(radius + 1.5, width_m - radius - 1.5)])
            parts.append(Circle(center_ned_m=center @ turned, radius_m=radius))
    edge = np.array([[0.0, 0.0], [length_m, 0.0], [length_m, width_m], [0.0, width_m]])
    ends = np.array([[0.8, rng.uniform(0.3, 0.7) * width_m], [length_m - 0.8, rng.uniform(0.3, 0.7) * width_m]])
    fence = Fence(inclusions=(Polygon(vertices_ned_m=edge @ turned),), exclusions=tuple(parts), depth_max_m=5.0)
    start, end = ends @ turned
    return Basin(fence=fence, start=start, goal=end, narrowest_m=min(doors_m))


def energy_way(made: Basin) -> FloatArray | None:
    """(m, 2) of the energy field's way in still water."""
    ends = np.stack([made.start, made.goal])
    area = area_of(made.fence, ends)
    x0 = np.array([*made.start, 0.5, 0, 0, 0, 0, 0])
    flow = FlowField(sample_flow(EstimatedCurrent(), nav_state(0, x0), area, 0.5))
    field = EnergyField(FreeSpace(Features(made.fence), area, KEEP_M, long_moves=LONGEST_MOVE), flow, TABLE)
    to_go = field.to(made.goal)
    path = None if to_go is None else to_go.path(made.start)
    return None if path is None else path.points_ned_m


@pytest.mark.parametrize("size_m", [(6.0, 4.0), (30.0, 20.0), (300.0, 200.0)])
def test_a_door_that_an_upload_is_accepted_with_is_found_by_both_planners(size_m: tuple[float, float]) -> None:
    for seed, doors in enumerate(([0.667], [0.657], [0.7, 0.668, 1.2], [3.0, 0.64])):
        made = basin(np.random.default_rng(seed), *size_m, doors if size_m[0] > 10.0 else doors[-1:])
        ends = np.stack([made.start, made.goal])
        here, there = FreeRegions(made.fence, ends, KEEP_M + VALIDATION.passage_m).of_points
        accepted = here == there
        assert accepted is (made.narrowest_m > 2.0 * (KEEP_M + VALIDATION.passage_m))
        for path in (Planner(made.fence, KEEP_M).path(made.start, made.goal), energy_way(made)):
            assert path is not None or not accepted
            if path is None:
                continue
            assert made.narrowest_m > 2.0 * KEEP_M - 0.002
            share = np.linspace(0.0, 1.0, 200)[:, None, None]
            dense = (path[:-1] + share * np.diff(path, axis=0)).reshape(-1, 2)
            assert Features(made.fence).clearance_m(dense).min() > KEEP_M - 0.002


def test_cells_are_bounded_and_fine_only_where_that_decides() -> None:
    rng = np.random.default_rng(5)
    made = basin(rng, 300.0, 200.0, [0.67, 0.67])
    space = FreeSpace(Features(made.fence), area_of(made.fence, made.start[None]), KEEP_M)
    assert space.base_cell_m > 1.0 and len(space.places_ned_m) < 15_000
    pillars = tuple(Circle(center_ned_m=rng.uniform([0.0, 0.0], [300.0, 200.0]), radius_m=2.0) for _ in range(300))
    harbour = Fence(inclusions=made.fence.inclusions, exclusions=pillars)
    crowded = FreeSpace(Features(harbour), area_of(harbour, made.start[None]), KEEP_M)
    assert len(crowded.places_ned_m) <= SPACE.max_cells


def test_a_door_in_a_large_basin_has_a_trajectory() -> None:
    """Not only a way: the vehicle's own motion through 0.69 m in a basin of 30 m x 20 m."""
    made = basin(np.random.default_rng(3), 30.0, 20.0, [0.69])
    here = made.start + 0.35 * (made.goal - made.start)
    x0 = np.array([*here, 0.5, 0, 0, 0, 0, 0])
    area = area_of(made.fence, np.stack([here, made.goal]))
    request = TrajectoryRequest(
        x0=x0,
        goal=goal(float(made.goal[0]), float(made.goal[1]), 0.5, None),
        fence=made.fence,
        radius_m=KEEP_M,
        flow=sample_flow(EstimatedCurrent(), nav_state(0, x0), area, 0.5),
        limits=np.array([0.45, 0.24, 0.96, 0.0, 5.0]),
        thrust_limit_n=np.full(4, 11.5),
        buoyancy_excess_n=MODEL.buoyancy_excess_n,
    )
    plan = EnergyPlanner(MODEL, PowerModel.of(VEHICLE)).plan(request)
    assert plan.trajectory is not None and plan.trajectory.solved, plan.why
