"""The environment of the vehicle: walls, floor, obstacles, current and tether entry, built from a scenario."""

from dataclasses import dataclass

from autopilot.core.errors import ConfigError
from autopilot.core.shapes import is_inside
from autopilot.core.toml_table import Vec2, Vec3
from autopilot.sitl.contact import Cylinder, MovingCylinder, MovingPath, Prism, Solid, Sphere
from autopilot.sitl.current_fields import STILL, CurrentField, current_field
from autopilot.sitl.scenario_tables import CylinderObstacle, MovingObstacle, PrismObstacle, Scenario
from autopilot.sitl.waves import WithWaves, breaking_height_m, wave_train


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SimulatedWaters:
    """The environment of the plant. The default is unbounded still water."""

    polygon_ned_m: tuple[Vec2, ...] | None = None
    """Corners of the walls (north, east), None = no walls."""
    floor_m: float | None = None
    """Depth of the flat floor, None = none."""
    solids: tuple[Solid, ...] = ()
    current: CurrentField = STILL
    tether_entry_ned_m: Vec3 | None = None
    """None = no tether."""


def moving_path(obstacle: MovingObstacle) -> MovingPath:
    """Path of a moving obstacle of a scenario."""
    return MovingPath(obstacle.path_m, obstacle.speed_m_s, obstacle.ends, obstacle.start_s)


def build_world(scenario: Scenario) -> SimulatedWaters:
    """The world that a scenario describes. ConfigError if the vehicle would start outside the water, or waves break."""
    solids: list[Solid] = []
    for number, obstacle in enumerate(scenario.obstacle, start=1):
        name = f"obstacle {number}"
        if isinstance(obstacle, CylinderObstacle):
            solids.append(Cylinder(name=name, center_ned_m=obstacle.center_m, radius_m=obstacle.radius_m))
        elif isinstance(obstacle, MovingObstacle):
            solids.append(MovingCylinder(name=name, path=moving_path(obstacle), radius_m=obstacle.radius_m))
        elif isinstance(obstacle, PrismObstacle):
            solids.append(Prism(name=name, polygon_ned_m=tuple(obstacle.polygon_m)))
        else:
            solids.append(Sphere(name=name, center_ned_m=obstacle.center_m, radius_m=obstacle.radius_m))
    tank = scenario.tank
    x, y, z = scenario.vehicle.start_m
    if tank is not None and not (is_inside(tank.polygon_m, x, y) and z <= tank.depth_m):
        raise ConfigError(
            f"scenario {scenario.scenario.name!r}: `$.vehicle.start_m` = [{x:g}, {y:g}, {z:g}] is outside the tank;"
            " move it inside"
        )
    if z < 0.0:
        raise ConfigError(
            f"scenario {scenario.scenario.name!r}: `$.vehicle.start_m` = [{x:g}, {y:g}, {z:g}] is above the water;"
            " its third number is the depth, positive down"
        )
    return SimulatedWaters(
        polygon_ned_m=tuple(tank.polygon_m) if tank is not None else None,
        floor_m=tank.depth_m if tank is not None else None,
        solids=tuple(solids),
        current=water_field(scenario),
        tether_entry_ned_m=scenario.vehicle.tether_entry_m,
    )


def water_field(scenario: Scenario) -> CurrentField:
    """Current and waves. ConfigError if the waves would break."""
    field, table = current_field(scenario.current), scenario.waves
    depth_m = None if scenario.tank is None else scenario.tank.depth_m
    waves = wave_train(table, depth_m)
    if waves is None or table is None:
        return field
    highest_m = breaking_height_m(table, depth_m)
    if table.height_m > highest_m:
        raise ConfigError(
            f"scenario {scenario.scenario.name!r}: `$.waves.height_m` = {table.height_m:g} breaks: waves of"
            f" {table.period_s:g} s are {highest_m:.2g} m high at most there; make them lower or longer"
        )
    return WithWaves(field=field, waves=waves)
