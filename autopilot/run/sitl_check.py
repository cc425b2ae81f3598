"""``autopilot scenario check``: contents of a scenario, errors that keep it from being flown, and warnings."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from autopilot.core.errors import AutopilotError
from autopilot.core.geodesy import Origin
from autopilot.core.geometry import Fence
from autopilot.core.params import ParamSet
from autopilot.core.vehicle import Vehicle, load_vehicle
from autopilot.core.vehicle_summary import facts_of
from autopilot.mission.fence import FenceShape, build_fence
from autopilot.mission.items import GoTo, Step
from autopilot.mission.plan_files import read_plan
from autopilot.run.plan_verdict import verdict_of
from autopilot.run.sitl_console import unknown_obstacles
from autopilot.run.sitl_fence import scenario_plan
from autopilot.sitl.contact import SolidGeometry
from autopilot.sitl.plant import build_plant
from autopilot.sitl.scenario import plan_path
from autopilot.sitl.scenario_tables import Scenario
from autopilot.sitl.simulated_waters import build_world
from autopilot.sitl.waves import breaking_height_m

GRID = 21
"""Sample points north and east for the current."""
TIMES = 13
"""Times, over :data:`LOOK_S`."""
LOOK_S = 600.0
AROUND_M = 10.0
"""Radius around start and goals in which the current is sampled in open water."""
TIGHT = 0.8
"""Share of the vehicle's speed from which a current is worth a word."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ScenarioFindings:
    facts: dict[str, str]
    problems: tuple[str, ...]
    """It cannot be simulated, or its plan not be flown."""
    remarks: tuple[str, ...]


def check_scenario(name_or_path: str, scenario: Scenario) -> ScenarioFindings:
    """All checks that need no flight. ``scenario``: the scenario loaded from there."""
    vehicle = load_vehicle(scenario.vehicle.model)
    facts = {"vehicle": f"{vehicle.name}, ball of {vehicle.radius_m:g} m", **_world_facts(scenario)}
    problems: list[str] = []
    remarks: list[str] = []
    steps: tuple[Step, ...] = ()
    with _noting(problems):
        steps = _check_plan(name_or_path, scenario, vehicle, facts, problems, remarks)
    with _noting(problems):
        build_plant(scenario, vehicle)
        remarks += _start_clearance(scenario, vehicle)
        remarks += _check_current(scenario, vehicle, steps, facts)
    yaw = scenario.vehicle.start_yaw_rad
    if abs(yaw) > 2.0 * math.pi:
        remarks.append(f"vehicle.start_yaw_rad = {yaw:g} is in radians, and more than a turn; 90 degrees are 1.5708")
    if scenario.spread:
        facts["spread"] = f"{len(scenario.spread)} keys: {', '.join(scenario.spread)}"
        if scenario.scenario.duration_s is None:
            remarks.append("a campaign needs scenario.duration_s or --duration, and there is none")
    return ScenarioFindings(facts=facts, problems=tuple(problems), remarks=tuple(remarks))


@contextmanager
def _noting(problems: list[str]) -> Iterator[None]:
    """What is raised goes to the problems."""
    try:
        yield
    except AutopilotError as error:
        problems.append(str(error))


def _world_facts(scenario: Scenario) -> dict[str, str]:
    tank = scenario.tank
    facts = {
        "world": "open water" if tank is None else f"tank of {len(tank.polygon_m)} walls, {tank.depth_m:g} m deep",
        "obstacles": f"{len(scenario.obstacle)}",
        "localised by": scenario.sensors.position,
        "told of the current": scenario.controller.currents,
    }
    if scenario.waves is not None:
        waves = scenario.waves
        highest_m = breaking_height_m(waves, None if tank is None else tank.depth_m)
        facts["waves"] = f"{waves.spectrum}, {waves.height_m:g} m, {waves.period_s:g} s (break at {highest_m:.2g} m)"
    if scenario.fault:
        kinds = (f"{fault.__struct_config__.tag} at {fault.at_s:g} s" for fault in scenario.fault)
        facts["faults"] = ", ".join(kinds)
    return facts


def _check_plan(
    name_or_path: str,
    scenario: Scenario,
    vehicle: Vehicle,
    facts: dict[str, str],
    problems: list[str],
    remarks: list[str],
) -> tuple[Step, ...]:
    """The plan against the fence as a vehicle judges them. AutopilotError if it cannot be read."""
    path = plan_path(name_or_path, scenario)
    if path is None:
        if scenario.scenario.fence is not None:
            remarks.append("scenario.fence draws the fence of a plan, and there is no plan; name one in scenario.plan")
        facts["plan"] = "none"
        return ()
    plan, warnings = scenario_plan(read_plan(path), scenario)
    remarks += warnings
    facts["plan"] = f"{path.name}, mission of {len(plan.mission)} items"
    facts["fence"] = f"{len(plan.fence)} items" + (f" {scenario.scenario.fence}" if scenario.scenario.fence else "")
    params = ParamSet()
    for name, value in scenario.params.items():
        params.set(name, value)
    place = scenario.origin
    origin = Origin(lat_deg=place.lat_deg, lon_deg=place.lon_deg, alt_m=place.alt_m)
    verdict = verdict_of(plan, origin, params, vehicle)
    problems += [problem.reason for problem in (*verdict.own, *verdict.joint)]
    no_path = verdict.path_problem(np.array(scenario.vehicle.start_m), 0)
    problems += [no_path] if no_path else []
    remarks += verdict.warnings
    if not verdict.own:
        remarks += unknown_obstacles(scenario, _fence(verdict.shapes, params))
    return verdict.steps


def _fence(shapes: tuple[FenceShape, ...], params: ParamSet) -> Fence:
    return build_fence(shapes, params)


def _start_clearance(scenario: Scenario, vehicle: Vehicle) -> list[str]:
    """Whether the vehicle's ball is free where it starts (the hull is, or there would be no plant)."""
    world = build_world(scenario)
    around = SolidGeometry(
        polygon_ned_m=world.polygon_ned_m,
        floor_m=None,
        solids=world.solids,
        hull_radius_m=vehicle.radius_m,
        hull_half_height_m=vehicle.hull_half_height_m,
    )
    found = around.touches(list(scenario.vehicle.start_m))
    return [f"the vehicle's ball is {touch.depth_m:.2f} m inside {touch.what} at the start" for touch in found]


def _check_current(scenario: Scenario, vehicle: Vehicle, steps: tuple[Step, ...], facts: dict[str, str]) -> list[str]:
    """Compare the strongest current in the workspace with the vehicle's speed."""
    field = build_world(scenario).current
    start = np.array(scenario.vehicle.start_m)
    if scenario.tank is not None:
        corners = np.array(scenario.tank.polygon_m)
    else:
        goals = [step.pos_ned_m[:2] for step in steps if isinstance(step, GoTo) and step.pos_ned_m is not None]
        around = np.array([start[:2], *goals])
        corners = np.vstack((around - AROUND_M, around + AROUND_M))
    north, east = (np.linspace(corners[:, axis].min(), corners[:, axis].max(), GRID) for axis in (0, 1))
    fastest_m_s = max(
        math.hypot(*field.velocity((float(x), float(y), float(start[2])), float(t))[:2])
        for x in north
        for y in east
        for t in (np.linspace(0.0, LOOK_S, TIMES) if not field.steady_uniform else (0.0,))
    )
    swims_m_s = next(axis.speed for axis in facts_of(vehicle).axes if axis.axis == "surge")
    facts["current"] = f"{scenario.current.__struct_config__.tag}, at most {fastest_m_s:.2f} m/s at the start's depth"
    if fastest_m_s > TIGHT * swims_m_s:
        return [f"the current reaches {fastest_m_s:.2f} m/s, and the vehicle swims {swims_m_s:.2f} m/s"]
    return []
