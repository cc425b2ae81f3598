"""``fence = "from tank and obstacles"``: generates the fence of a plan from the scenario's geometry."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from autopilot.core.errors import ConfigError
from autopilot.core.geodesy import Origin
from autopilot.core.geometry import Circle, Shape
from autopilot.core.plan import PlanItem
from autopilot.mission.fence import FenceShape, read_fence
from autopilot.mission.local_plan import CircleTable, FenceTable, LocalPlan, OriginTable, PolygonTable, plan_of_local
from autopilot.mission.plan_model import PlanFile
from autopilot.sitl.scenario_tables import CylinderObstacle, MovingObstacle, PrismObstacle, Scenario

SAME_M = 0.03
"""Corners and radii of two fences that differ by less are the same: plans lie on a grid of 11 mm."""


def scenario_plan(plan: PlanFile, scenario: Scenario) -> tuple[PlanFile, tuple[str, ...]]:
    """The plan, with the scenario's generated fence if it asks for one, and a message to the operator. ConfigError
    if there is no geometry for it.
    """
    if scenario.scenario.fence is None:
        return plan, ()
    drawn = drawn_fence(scenario)
    warnings: tuple[str, ...] = ()
    if plan.fence and not _same(plan.fence, drawn, _origin(scenario)):
        warnings = (
            f"the plan's own fence ({len(plan.fence)} items) is left out: scenario.fence draws it from tank and"
            " obstacles",
        )
    return replace(plan, fence=drawn), warnings


def drawn_fence(scenario: Scenario) -> tuple[PlanItem, ...]:
    """Tank = inclusion; cylinders, spheres (through the whole depth) and prisms = exclusions. Obstacles seen by
    the obstacle sensor, unknown and moving ones are left out. ConfigError if nothing is left.
    """
    name = scenario.scenario.name
    polygons = [] if scenario.tank is None else [PolygonTable(points_m=list(scenario.tank.polygon_m), inclusion=True)]
    circles = []
    for obstacle in scenario.obstacle:
        if isinstance(obstacle, PrismObstacle):
            polygons.append(PolygonTable(points_m=list(obstacle.polygon_m)))
        elif not isinstance(obstacle, MovingObstacle) and not (
            isinstance(obstacle, CylinderObstacle) and obstacle.surprise
        ):
            north, east = obstacle.center_m[:2]
            circles.append(CircleTable(x_m=north, y_m=east, radius_m=obstacle.radius_m))
    if not polygons and not circles:
        raise ConfigError(
            f"scenario {name!r}: `$.scenario.fence` = {scenario.scenario.fence!r}, and there is neither; add [tank] or"
            " [[obstacle]], or leave the fence to the plan"
        )
    origin = scenario.origin
    local = LocalPlan(
        origin=OriginTable(lat_deg=origin.lat_deg, lon_deg=origin.lon_deg, alt_m=origin.alt_m),
        fence=FenceTable(polygon=polygons, circle=circles),
    )
    return plan_of_local(local, f"fence of scenario {name!r}").fence


def _origin(scenario: Scenario) -> Origin:
    place = scenario.origin
    return Origin(lat_deg=place.lat_deg, lon_deg=place.lon_deg, alt_m=place.alt_m)


def _same(one: Sequence[PlanItem], other: Sequence[PlanItem], origin: Origin) -> bool:
    """Whether two fences hold the same shapes, in any order."""
    (mine, wrong), (left, _) = read_fence(one, origin), read_fence(other, origin)
    if wrong or len(mine) != len(left):
        return False
    rest = list(left)
    for shape in mine:
        match = next((each for each in rest if _alike(shape, each)), None)
        if match is None:
            return False
        rest.remove(match)
    return True


def _alike(one: FenceShape, other: FenceShape) -> bool:
    return one.inclusion == other.inclusion and _near(one.shape, other.shape)


def _near(one: Shape, other: Shape) -> bool:
    if isinstance(one, Circle) or isinstance(other, Circle):
        return (
            isinstance(one, Circle)
            and isinstance(other, Circle)
            and bool(np.abs(one.center_ned_m - other.center_ned_m).max() < SAME_M)
            and abs(one.radius_m - other.radius_m) < SAME_M
        )
    mine, theirs = one.vertices_ned_m, other.vertices_ned_m
    return mine.shape == theirs.shape and any(
        np.abs(mine - np.roll(turned, shift, axis=0)).max() < SAME_M
        for turned in (theirs, theirs[::-1])
        for shift in range(len(theirs))
    )
