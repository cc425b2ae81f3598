"""Description of a run in its log (``run.json``): geometry, plan, bounds and parameters; common to all vehicles."""

from collections.abc import Mapping

import msgspec

from autopilot.command.service_parts import ServiceParts
from autopilot.core.camera import CameraModel
from autopilot.core.plan import PlanItem, PlanKind
from autopilot.log.description import AcceptBounds, CameraView, RunDescription, Waypoint, fence_shapes
from autopilot.mavlink.api import FlightMode
from autopilot.mission.items import GoTo, Jump
from autopilot.mission.store import Plans


def describe_service(parts: ServiceParts, place: str) -> RunDescription:
    """The service's part of the run description at this time; ``place``: site or scenario."""
    params = parts.params
    waypoints, laps = _tour(parts)
    return RunDescription(
        scenario=place,
        vehicle=parts.vehicle.name,
        solver=parts.controller.solver,
        origin_lat_deg=parts.plans.origin.lat_deg,
        origin_lon_deg=parts.plans.origin.lon_deg,
        origin_alt_m=parts.plans.origin.alt_m,
        body_radius_m=parts.vehicle.radius_m,
        hull_m=(parts.vehicle.hull_radius_m, parts.vehicle.hull_half_height_m),
        camera=None if parts.vehicle.camera is None else _camera(CameraModel.of_vehicle(parts.vehicle)),
        thruster_names=tuple(thruster.name for thruster in parts.vehicle.thrusters),
        fence=fence_shapes(parts.commander.fence),
        waypoints=waypoints,
        closed_tour=laps is not None,
        accept=AcceptBounds.of_limits(params, laps),
        paper_bounds={
            "planar_speed_m_s": params["SPD_PLANAR_MAX"],
            "heave_m_s": params["SPD_HEAVE_MAX"],
            "yaw_rate_rad_s": params["SPD_YAW_MAX"],
            "thrust_n": params["THR_LIMIT"],
        },
        mode_names={str(parts.server.custom_mode(mode)): mode.name for mode in FlightMode},
        parameters=dict(params),
    )


def _camera(model: CameraModel) -> CameraView:
    north, east, down = model.position_frd_m.tolist()
    return CameraView(
        width_px=model.width_px,
        height_px=model.height_px,
        focal_px=model.focal_px,
        center_px=model.center_px,
        distortion=model.distortion[:4] if model.fisheye else model.distortion,
        fisheye=model.fisheye,
        position_frd_m=(north, east, down),
        r_frd_from_cam=tuple(model.r_frd_from_cam.ravel().tolist()),
    )


def plan_items(plans: Plans) -> dict[PlanKind, tuple[PlanItem, ...]]:
    return {kind: plans.items(kind) for kind in PlanKind}


def plans_json(items: Mapping[PlanKind, tuple[PlanItem, ...]]) -> bytes:
    """Mission, fence and rally points in wire units, NaN as null (attachment ``plans.json``)."""
    return msgspec.json.encode({kind.name.lower(): items[kind] for kind in PlanKind})


def _tour(parts: ServiceParts) -> tuple[tuple[Waypoint, ...], int | None]:
    """Positions of one lap, and number of laps (None = no tour of laps)."""
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
