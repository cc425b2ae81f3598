"""Encodes snapshots of the loop as JSON for the page. Pure functions, on the view's thread."""

import base64
from collections.abc import Callable, Iterable
from enum import Enum
from functools import cache
from typing import Any, TypeVar, get_type_hints

import msgspec
import numpy as np

from autopilot.core.errors import AutopilotError
from autopilot.core.frames import FloatArray
from autopilot.core.geometry import Fence
from autopilot.core.messages import Event, Failsafe, NavHealth, NavState, Severity
from autopilot.core.samples import MarkerSighting
from autopilot.core.shapes import clearance_m
from autopilot.core.vehicle import Vehicle
from autopilot.log.description import Point2, Point3, RunDescription
from autopilot.log.scene import outline
from autopilot.view.ages import CONTROL_S, UNKNOWN_S, age_limits, sensor_limits_s
from autopilot.view.controls import Steered
from autopilot.view.feed import CapturedPicture as TakenPicture
from autopilot.view.feed import TickSnapshot
from autopilot.view.page_state import (
    BatteryView,
    Control,
    DeviceView,
    Estimate,
    GoalView,
    Limits,
    Loop,
    Measured,
    MessageView,
    ObstacleView,
    Outline,
    PictureView,
    ProgressView,
    SceneView,
    SensorView,
    Steerable,
    TrueState,
    ViewFrame,
)

DIGITS = 4
"""Decimals of numbers for the page: a tenth of a millimetre."""
JPEG_QUALITY = 70
BOUNDS = ("planar_speed_m_s", "heave_m_s", "yaw_rate_rad_s", "thrust_n")
_View = TypeVar("_View", bound=msgspec.Struct)


def scene_of(
    snapshot: TickSnapshot, vehicle: Vehicle, steerable: Steerable, *, simulated: bool, pictures: bool
) -> SceneView:
    run, camera = snapshot.description, vehicle.camera if pictures else None
    return SceneView(
        title=run.scenario,
        vehicle=run.vehicle,
        simulated=simulated,
        body_radius_m=run.body_radius_m,
        half_height_m=vehicle.hull_half_height_m,
        tank_m=tuple(run.tank_polygon_m),
        tank_depth_m=run.tank_depth_m,
        fence=tuple(
            Outline(inclusion=shape.inclusion, corners_m=tuple((_number(n), _number(e)) for n, e in outline(shape)))
            for shape in run.fence
        ),
        places=run.waypoints,
        limits=Limits(**{name: run.paper_bounds[name] for name in BOUNDS}, solve_ms=1e3 * CONTROL_S),
        ages=age_limits(vehicle),
        thrusters=tuple(thruster.name for thruster in vehicle.thrusters),
        camera_px=None if camera is None else (camera.width_px, camera.height_px),
        steerable=steerable,
        parameters=run.parameters,
        trail_ned_m=tuple(_point3(place) for place in snapshot.trail_ned_m),
    )


def frame_of(snapshot: TickSnapshot, vehicle: Vehicle, steered: Steered, *, now_s: float, viewers: int) -> ViewFrame:
    out, mode, done = snapshot.outputs, snapshot.outputs.mode, snapshot.outputs.progress
    t_us, count = out.t_us, len(vehicle.thrusters)
    health, limits_s = snapshot.latest.thrusters, sensor_limits_s(vehicle)
    return ViewFrame(
        scene=snapshot.scene,
        sent_s=round(now_s, 3),
        t_s=1e-6 * t_us,
        stale_s=round(max(0.0, now_s - snapshot.wall_s), 2),
        paused=steered.paused,
        speed=steered.speed,
        viewers=viewers,
        armed=mode.armed,
        mode=snapshot.description.mode_names.get(str(mode.custom_mode), str(mode.custom_mode)),
        failsafes=tuple(failsafe.name for failsafe in Failsafe if mode.failsafes >> failsafe & 1),
        estimate=None if out.nav is None else _estimate(out.nav, _age_s(t_us, _newest_us(snapshot, out.nav))),
        measured=_measured(snapshot, limits_s),
        truth=None
        if snapshot.truth is None
        else _shown(
            TrueState,
            snapshot.truth,
            thrust_n=_numbers(snapshot.truth.thrust_n[:count]),
            contacts=snapshot.truth.contact_count,
        ),
        solids=snapshot.solids,
        extra_current_ned_m_s=steered.extra_current_ned_m_s,
        tracks=tuple(
            _shown(ObstacleView, track, number=number, age_s=_age_s(t_us, track.t_us))
            for number, track in snapshot.latest.tracks.items()
        ),
        clearance_m=None if out.nav is None else _clearance_m(snapshot.fence, out.nav),
        goal=None if out.goal is None else _shown(GoalView, out.goal, item=out.goal.seq),
        progress=None
        if done is None
        else ProgressView(state=done.state.name, item=done.current_seq, reached=done.reached_seq, lap=done.lap),
        control=_control(snapshot),
        thrust_n=_numbers(out.command.thrust_n[:count]),
        pwm_us=tuple(out.command.pwm_us[:count]),
        effectiveness=() if health is None else _numbers(health.effectiveness),
        sensors=tuple(
            _shown(
                SensorView,
                aid,
                name=aid.sensor,
                age_s=_age_s(t_us, aid.t_us),
                limit_s=limits_s.get(aid.sensor, UNKNOWN_S),
            )
            for aid in snapshot.latest.aids.values()
        ),
        devices=tuple(
            DeviceView(name=name, age_s=_age_s(t_us, received_us), limit_s=limits_s.get(name, UNKNOWN_S))
            for name, received_us in snapshot.latest.received_us.items()
        ),
        battery=_battery(snapshot),
        loop=_loop(snapshot),
        messages=tuple(message_of(number, event) for number, event in snapshot.messages),
    )


def message_of(number: int, event: Event) -> MessageView:
    return MessageView(
        number=number,
        t_s=_number(1e-6 * event.t_us),
        severity=Severity(min(max(event.severity, 0), 7)).name,
        text=event.text,
    )


def plan_points_m(run: RunDescription, pos_ned_m: FloatArray) -> FloatArray:
    """(n, 2) what the plan has to show: the vehicle, walls, fence and waypoints."""
    points = [tuple(pos_ned_m[:2]), *run.tank_polygon_m, *(place.pos_ned_m[:2] for place in run.waypoints)]
    for shape in run.fence:
        points += outline(shape)
    return np.array(points, dtype=float)


def picture_of(taken: TakenPicture) -> PictureView:
    """A camera picture as JPEG with its detections. AutopilotError if it cannot be compressed."""
    import cv2  # expensive: imported only while pictures are viewed

    done, jpeg = cv2.imencode(".jpg", taken.pixels, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    if not done:
        raise AutopilotError("a camera picture cannot be compressed as JPEG")
    return picture_view(
        t_us=taken.t_us,
        width_px=taken.width_px,
        height_px=taken.height_px,
        jpeg=base64.b64encode(jpeg.tobytes()).decode(),
        sighting=taken.sighting,
    )


def picture_view(
    *, t_us: int, width_px: int, height_px: int, jpeg: str, sighting: MarkerSighting | None
) -> PictureView:
    laser = None if sighting is None else sighting.laser_px
    return PictureView(
        t_s=1e-6 * t_us,
        width_px=width_px,
        height_px=height_px,
        jpeg=jpeg,
        markers=()
        if sighting is None
        else tuple(
            (number, tuple(_point2(corner, 1) for corner in corners))
            for number, corners in zip(sighting.ids, sighting.corners_px, strict=True)
        ),
        laser_px=None if laser is None else _point2(laser, 1),
    )


def _number(value: float) -> float:
    """A number valid in JSON, rounded; NaN and infinities are -1."""
    return round(float(value), DIGITS) if np.isfinite(value) else -1.0


def _age_s(t_us: int, since_us: int) -> float:
    """Age in vehicle time."""
    return _number(1e-6 * max(t_us - since_us, 0))


def _newest_us(snapshot: TickSnapshot, nav: NavState) -> int:
    """Of when an estimate is: its attitude is no newer than the AHRS."""
    return min(nav.t_us, snapshot.latest.received_us.get("ahrs", nav.t_us))


def _numbers(values: Iterable[float]) -> tuple[float, ...]:
    return tuple(_number(value) for value in values)


def _point2(values: FloatArray, digits: int = DIGITS) -> Point2:
    first, second = values[:2].tolist()
    return round(first, digits), round(second, digits)


def _point3(values: FloatArray) -> Point3:
    first, second, third = values.tolist()
    return _number(first), _number(second), _number(third)


def _shown(kind: type[_View], of: object, **named: object) -> _View:
    """A view with the fields of ``of`` of the same names, rounded, but for those that are ``named``."""
    taken = {name: _plain(getattr(of, name), hint) for name, hint in _hints(kind).items() if name not in named}
    return kind(**taken, **named)


_hints = cache(get_type_hints)
_ROUNDED: dict[object, Callable[[Any], object]] = {
    float: _number,
    float | None: _number,
    Point2: _point2,
    Point3: _point3,
}
"""By the type that a field of a view has."""


def _plain(value: Any, hint: object) -> object:
    if value is None:
        return None
    if isinstance(value, Enum):
        return value.name
    rounded = _ROUNDED.get(hint)
    return value if rounded is None else rounded(value)


def _estimate(nav: NavState, age_s: float) -> Estimate:
    sigma = np.sqrt(np.maximum(nav.variance, 0.0))
    return _shown(
        Estimate,
        nav,
        age_s=age_s,
        sigma_pos_m=_point3(sigma[0:3]),
        sigma_yaw_rad=_number(sigma[5]),
        resets=nav.reset_count,
        doubts=tuple(sorted(doubt.value for doubt in nav.doubts)),
    )


def _clearance_m(fence: Fence, nav: NavState) -> float | None:
    """Smallest distance of the vehicle's centre to the forbidden area."""
    place = nav.pos_ned_m[None, :2]
    gaps = [float(clearance_m(shape, place)[0]) for shape in fence.exclusions]
    gaps += [-float(clearance_m(shape, place)[0]) for shape in fence.inclusions]
    return _number(min(gaps)) if gaps else None


def _control(snapshot: TickSnapshot) -> Control | None:
    control, plan, goal = snapshot.latest.control, snapshot.latest.plan, snapshot.outputs.goal
    if control is None:
        return None
    if plan is not None and (goal is None or plan.seq != goal.seq):
        plan = None  # of the goal before
    status, tubed = control.status, len(control.horizon_ned_m) == len(control.tube_m)
    return _shown(
        Control,
        status,
        age_s=_age_s(snapshot.outputs.t_us, status.t_us),
        solve_ms=_number(1e3 * status.solve_s),
        slack=_number(status.slack_max),
        tube_now_m=_number(status.tube_m),
        horizon_ned_m=tuple(_point3(place) for place in control.horizon_ned_m),
        route_ned_m=tuple(_point2(place) for place in control.route_ned_m),
        tube_m=_numbers(control.tube_m) if tubed else (),
        eta_s=None if plan is None else _number(plan.eta_s),
        energy_j=None if plan is None else _number(plan.energy_j),
        plan_age_s=None if plan is None else _age_s(snapshot.outputs.t_us, snapshot.latest.plan_us),
    )


def _measured(snapshot: TickSnapshot, limits_s: dict[str, float]) -> Measured | None:
    nav, rpy_rad, depth_m = snapshot.outputs.nav, snapshot.latest.ahrs_rpy_rad, snapshot.latest.depth_m
    if nav is not None and nav.health is not NavHealth.INVALID:
        return None

    def fresh(device: str) -> bool:
        received_us = snapshot.latest.received_us.get(device)
        return received_us is not None and _age_s(snapshot.outputs.t_us, received_us) <= limits_s.get(device, UNKNOWN_S)

    return Measured(
        rpy_rad=_point3(rpy_rad) if rpy_rad is not None and fresh("ahrs") else None,
        depth_m=_number(depth_m) if depth_m is not None and fresh("depth") else None,
    )


def _battery(snapshot: TickSnapshot) -> BatteryView | None:
    power = snapshot.latest.power
    if power is None:
        return None
    received_us = snapshot.latest.received_us.get("battery", power.t_us)
    return _shown(BatteryView, power, age_s=_age_s(snapshot.outputs.t_us, received_us))


def _loop(snapshot: TickSnapshot) -> Loop | None:
    stats = snapshot.latest.loop
    if stats is None:
        return None
    return _shown(
        Loop,
        stats,
        age_s=_age_s(snapshot.outputs.t_us, stats.t_us),
        longest_tick_ms=_number(1e3 * stats.tick_s),
        cpu_share=_number(stats.cpu_s),
        lost_messages=stats.dropped_log,
        lost_pictures=stats.dropped_frames,
        late_part=stats.late_part.name.lower(),
    )
