"""Description of a run in its log (``run.json``): geometry, plan, bounds and parameters; common to all vehicles."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import msgspec

from autopilot.command.service_parts import ServiceParts
from autopilot.core.camera import CameraModel
from autopilot.core.plan import PlanItem, PlanKind
from autopilot.log.description import AcceptBounds, CameraView, RunDescription, Waypoint, fence_shapes
from autopilot.mavlink.api import FlightMode
from autopilot.mission.items import GoTo, Jump, Step, flown_order
from autopilot.mission.store import Plans

MOST_STEPS = 1000
"""Of a mission, with its jumps made, that a log is judged by."""


def describe_service(parts: ServiceParts, place: str) -> RunDescription:
    """The service's part of the run description at this time; ``place``: site or scenario."""
    params = parts.params
    tour = tour_of(parts.plans.steps(), params)
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
        waypoints=tour.waypoints,
        closed_tour=tour.closed,
        tour=tour.order,
        accept=AcceptBounds.of_limits(params, tour.laps),
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Tour:
    """What a mission visits, as :class:`autopilot.log.description.RunDescription` has it."""

    waypoints: tuple[Waypoint, ...]
    laps: int | None = None
    """None = it is no tour of laps."""
    closed: bool = False
    order: tuple[int, ...] = ()


def tour_of(steps: Sequence[Step], params: Mapping[str, float]) -> Tour:
    """What a mission of these steps visits."""
    places = [step for step in steps if isinstance(step, GoTo) and step.pos_ned_m is not None]
    waypoints = tuple(_waypoint(number, step, params) for number, step in enumerate(places))
    jumps = [step for step in steps if isinstance(step, Jump)]
    if not jumps:
        return Tour(waypoints=waypoints)
    jump = jumps[0]
    repeated = len(jumps) == 1 and all(step.seq < jump.seq for step in places)
    laps = jump.count + 1 if repeated and jump.count is not None else None
    before = sum(step.seq < jump.target_seq for step in places)
    if laps is not None and before == 0:
        return Tour(waypoints=waypoints, laps=laps)
    if laps is not None and before == 1 and waypoints[-1].pos_ned_m == waypoints[0].pos_ned_m:
        # A-B-A with a jump back to B: the last place closes the lap at the first one.
        return Tour(waypoints=waypoints[:-1], laps=laps, closed=True)
    endless = [step.seq for step in jumps if step.count is None and step.target_seq <= step.seq]
    numbers = {step.seq: number for number, step in enumerate(places) if step.seq < min(endless, default=len(steps))}
    order = (numbers.get(step.seq) for step in flown_order(steps, MOST_STEPS))
    return Tour(waypoints=waypoints, order=tuple(number for number in order if number is not None))


def _waypoint(number: int, step: GoTo, params: Mapping[str, float]) -> Waypoint:
    assert step.pos_ned_m is not None
    north, east, down = step.pos_ned_m.tolist()
    return Waypoint(
        name=chr(ord("A") + number) if number < 26 else str(number),
        pos_ned_m=(north, east, down),
        yaw_rad=step.yaw_rad,
        accept_radius_m=step.accept_radius_m or params["WP_ACCEPT_RADIUS"],
        accept_yaw_rad=params["WP_ACCEPT_YAW"],
    )
