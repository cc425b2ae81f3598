"""Additions to the run description of a simulated run: world and acceptance bounds."""

from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any

from autopilot import __version__
from autopilot.command.service_parts import ServiceParts
from autopilot.core.plugins import Plugin, find_plugin
from autopilot.core.shipped_parts import SHIPPED_PARTS
from autopilot.log.description import AcceptBounds, Obstacle, PartOrigin, RunDescription
from autopilot.run.config import EffectiveSettings, chosen_part
from autopilot.run.describe import describe_service
from autopilot.sitl.scenario_tables import MovingObstacle, PrismObstacle, Scenario, SphereObstacle
from autopilot.sitl.scenario_tables import Obstacle as SolidTable


def describe_run(
    scenario: Scenario, parts: ServiceParts, *, seed: int, speed: float, origins: Mapping[str, PartOrigin] | None = None
) -> RunDescription:
    """The description of a simulated run as things stand now. ``origins``: of controller, estimator and plant."""
    tank = scenario.tank
    service = describe_service(parts, scenario.scenario.name)
    return replace(
        service,
        parts=dict(origins or {}),
        seed=seed,
        speed=speed,
        # The plant's power holds the hotel load already.
        hotel_power_w=0.0,
        tank_polygon_m=() if tank is None else tuple(tank.polygon_m),
        tank_depth_m=None if tank is None else tank.depth_m,
        # Logs know round obstacles; a prism is judged and drawn as what the fence holds.
        obstacles=tuple(
            _obstacle(obstacle, number)
            for number, obstacle in enumerate(scenario.obstacle, start=1)
            if not isinstance(obstacle, PrismObstacle)
        ),
        accept=replace(service.accept, **_accept_bounds(scenario)),
    )


def _accept_bounds(scenario: Scenario) -> dict[str, Any]:
    """Bounds that the scenario gives; the others are the run's own limits."""
    names = [field.name for field in fields(AcceptBounds) if field.name != "laps"]
    return {name: value for name in names if (value := getattr(scenario.accept, name)) is not None}


def _obstacle(obstacle: SolidTable, number: int) -> Obstacle:
    assert not isinstance(obstacle, PrismObstacle)
    if isinstance(obstacle, MovingObstacle):
        return Obstacle(
            center_m=tuple(obstacle.path_m[0]),
            radius_m=obstacle.radius_m,
            name=f"moving {number}",
            path_m=tuple(obstacle.path_m),
            speed_m_s=obstacle.speed_m_s,
            ends=obstacle.ends,
            start_s=obstacle.start_s,
        )
    kind = "sphere" if isinstance(obstacle, SphereObstacle) else "cylinder"
    return Obstacle(center_m=tuple(obstacle.center_m), radius_m=obstacle.radius_m, name=f"{kind} {number}")


def part_origins(settings: EffectiveSettings, scenario: Scenario) -> dict[str, PartOrigin]:
    """By role. ConfigError for an unknown part."""
    plugins = scenario.plugins
    return {
        kind: _origin(find_plugin(kind, *chosen_part(settings, kind, getattr(plugins, kind)))) for kind in SHIPPED_PARTS
    }


def _origin(part: Plugin) -> PartOrigin:
    shipped = not part.version and not part.sha256
    version = f"underwater-autopilot {__version__}" if shipped else part.version
    return PartOrigin(name=part.name, target=part.target, version=version, sha256=part.sha256)
