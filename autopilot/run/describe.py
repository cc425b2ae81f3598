"""What a log says of its run: scenario, geometry, plan, bounds and parameters (``run.json``)."""

from collections.abc import Mapping

import msgspec

from autopilot.command.parts import Parts
from autopilot.core.plan import PlanItem, PlanKind
from autopilot.log.description import AcceptBounds, Obstacle, PartOrigin, RunDescription, Waypoint, fence_shapes
from autopilot.mavlink.api import FlightMode
from mission.items import GoTo, Jump
from mission.store import Plans
from sitl.scenario import Scenario
from sitl.scenario_tables import MovingObstacle, PrismObstacle, SphereObstacle
from sitl.scenario_tables import Obstacle as SolidTable


def describe_run(
    scenario: Scenario, parts: Parts, *, seed: int, speed: float, origins: Mapping[str, PartOrigin] | None = None
) -> RunDescription:
    """The description of a simulated run as things stand now. ``origins``: of controller, estimator and plant."""
    params = parts.params
    tank = scenario.tank
    waypoints, laps = _tour(parts)
    accept = scenario.accept
    return RunDescription(
        scenario=scenario.scenario.name,
        vehicle=parts.vehicle.name,
        parts=dict(origins or {}),
        seed=seed,
        speed=speed,
        origin_lat_deg=parts.plans.origin.lat_deg,
        origin_lon_deg=parts.plans.origin.lon_deg,
        origin_alt_m=parts.plans.origin.alt_m,
        body_radius_m=parts.vehicle.radius_m,
        # The plant's power holds the hotel load already.
        hotel_power_w=0.0,
        thruster_names=tuple(thruster.name for thruster in parts.vehicle.thrusters),
        tank_polygon_m=() if tank is None else tuple(tank.polygon_m),
        tank_depth_m=None if tank is None else tank.depth_m,
        # Logs know round obstacles; a prism is judged and drawn as what the fence holds.
        obstacles=tuple(
            _obstacle(obstacle, number)
            for number, obstacle in enumerate(scenario.obstacle, start=1)
            if not isinstance(obstacle, PrismObstacle)
        ),
        fence=fence_shapes(parts.commander.fence),
        waypoints=waypoints,
        closed_tour=laps is not None,
        accept=AcceptBounds(
            laps=laps,
            cylinder_clearance_m=accept.cylinder_clearance_m,
            wall_clearance_m=accept.wall_clearance_m,
            tolerance_m=accept.tolerance_m,
            depth_min_m=accept.depth_min_m,
            depth_max_m=accept.depth_max_m,
            planar_speed_m_s=accept.planar_speed_m_s,
            heave_m_s=accept.heave_m_s,
            yaw_rate_rad_s=accept.yaw_rate_rad_s,
            thrust_n=accept.thrust_n,
            pos_rms_m=accept.pos_rms_m,
            yaw_rms_deg=accept.yaw_rms_deg,
        ),
        paper_bounds={
            "planar_speed_m_s": params["SPD_PLANAR_MAX"],
            "heave_m_s": params["SPD_HEAVE_MAX"],
            "yaw_rate_rad_s": params["SPD_YAW_MAX"],
            "thrust_n": params["THR_LIMIT"],
        },
        mode_names={str(parts.server.custom_mode(mode)): mode.name for mode in FlightMode},
        parameters=dict(params),
    )


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


def plan_items(plans: Plans) -> dict[PlanKind, tuple[PlanItem, ...]]:
    """The plans in force; what is given does not change any more."""
    return {kind: plans.items(kind) for kind in PlanKind}


def plans_json(items: Mapping[PlanKind, tuple[PlanItem, ...]]) -> bytes:
    """Mission, fence and rally points as they came over the wire, NaN as null (attachment ``plans.json``)."""
    return msgspec.json.encode({kind.name.lower(): items[kind] for kind in PlanKind})


def _tour(parts: Parts) -> tuple[tuple[Waypoint, ...], int | None]:
    """The places of one lap, and the laps that the mission asks for (None = it is not a tour of laps)."""
    steps = parts.plans.steps()
    params = parts.params
    places = [(step, step.pos_ned_m) for step in steps if isinstance(step, GoTo) and step.pos_ned_m is not None]
    jump = next((step for step in steps if isinstance(step, Jump)), None)
    laps = None if jump is None or jump.count is None else jump.count + 1
    if jump is not None:
        places = [(step, pos) for step, pos in places if step.seq < jump.seq]
        # A-B-A with a jump back to B: the last place closes the lap at the first one.
        if len(places) > 1 and bool((places[-1][1] == places[0][1]).all()):
            places = places[:-1]
    waypoints = []
    for index, (step, pos_ned_m) in enumerate(places):
        north, east, down = pos_ned_m.tolist()
        waypoints.append(
            Waypoint(
                name=chr(ord("A") + index) if index < 26 else str(index),
                pos_ned_m=(north, east, down),
                yaw_rad=step.yaw_rad,
                accept_radius_m=step.accept_radius_m or params["WP_ACCEPT_RADIUS"],
                accept_yaw_rad=params["WP_ACCEPT_YAW"],
            )
        )
    return tuple(waypoints), laps
