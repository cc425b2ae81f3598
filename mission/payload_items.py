"""Mission items for the payload: camera, its tilt, servos, relays, gripper (MAV_CMD, common.xml)."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from autopilot.core.geodesy import Origin
from autopilot.core.plan import MissionResult, PlanItem
from autopilot.mission.decode import INVALID_INT32, number, refuse, whole, wrong
from autopilot.mission.items import Order, Step

GRIPPER_ACTIONS = (0, 1)
"""Open, close."""
MOUNT_BY_ANGLE = 2.0
"""MAV_MOUNT_MODE_MAVLINK_TARGETING."""
STILLS_MODES = (0, 2)
"""CAMERA_MODE_IMAGE, CAMERA_MODE_IMAGE_SURVEY."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Shoot(Order):
    """Stills by time (IMAGE_START_CAPTURE, DO_SET_CAM_TRIGG_INTERVAL, DO_DIGICAM_CONTROL)."""

    count: int | None
    """None = until they are stopped."""
    interval_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class ShootEvery(Order):
    """Stills by distance (DO_SET_CAM_TRIGG_DIST); 0 = stop."""

    distance_m: float
    now: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class StopShooting(Order):
    """No more stills (IMAGE_STOP_CAPTURE)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MoveServo(Order):
    """A pulse for an output, or to it and back (DO_SET_SERVO, DO_REPEAT_SERVO)."""

    channel: int
    pulse_us: float
    count: int = 0
    """Repetitions, 0 = it stays there."""
    cycle_s: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class SwitchRelay(Order):
    """A relay on, off, to the other side (None), or to and fro (DO_SET_RELAY, DO_REPEAT_RELAY)."""

    number: int
    on: bool | None
    count: int = 0
    cycle_s: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Grip(Order):
    """A gripper (DO_GRIPPER)."""

    number: int
    close: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class MoveActuators(Order):
    """Actuators by number, -1 to 1 (DO_SET_ACTUATOR)."""

    values: tuple[tuple[int, float], ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class TiltCamera(Order):
    """The camera's tilt (DO_MOUNT_CONTROL, DO_GIMBAL_MANAGER_PITCHYAW)."""

    angle_rad: float | None
    """Against the body, upwards positive; None = its start."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NothingToDo(Order):
    """Requests the camera's only mode (SET_CAMERA_MODE 0)."""


BY_TIME, BY_DISTANCE, TILT = "photos by time", "photos by distance", "tilt"
"""Kinds of orders that stay in force; pulses and relays are not given again, as they may move things."""


def stays(order: Order) -> Mapping[str, bool]:
    """Kinds that an order changes, and whether it stays in force there."""
    match order:
        case Shoot(count=1):
            return {}
        case Shoot():
            return {BY_TIME: order.count is None}
        case ShootEvery():
            return {BY_DISTANCE: order.distance_m > 0.0}
        case StopShooting():
            return {BY_TIME: False, BY_DISTANCE: False}
        case TiltCamera():
            return {TILT: True}
    return {}


def start_capture(item: PlanItem, origin: Origin) -> Step:
    """IMAGE_START_CAPTURE: p2 interval [s], p3 count."""
    interval_s, count = _least(item, 2, "interval", 0.0), whole(item, 3, "count")
    if count < 0:
        raise wrong(item, 3, "count", "use 0 (until stopped) or more")
    if count != 1 and interval_s == 0.0:
        raise refuse(item, MissionResult.INVALID_PARAM2, "interval (param2) is 0 s; give the time between stills")
    return Shoot(seq=item.seq, count=count or None, interval_s=interval_s)


def stop_capture(item: PlanItem, origin: Origin) -> Step:
    return StopShooting(seq=item.seq)


def trigger_by_distance(item: PlanItem, origin: Origin) -> Step:
    """DO_SET_CAM_TRIGG_DIST: p1 distance between stills [m], 0 = stop; p3 1 = one at once."""
    return ShootEvery(seq=item.seq, distance_m=_least(item, 1, "distance", 0.0), now=number(item, 3, "trigger") == 1.0)


def trigger_by_time(item: PlanItem, origin: Origin) -> Step:
    """DO_SET_CAM_TRIGG_INTERVAL: p1 [ms], 0 = stop."""
    interval_ms = _least(item, 1, "interval", 0.0)
    if interval_ms == 0.0:
        return StopShooting(seq=item.seq)
    return Shoot(seq=item.seq, count=None, interval_s=1e-3 * interval_ms)


def digicam_control(item: PlanItem, origin: Origin) -> Step:
    """DO_DIGICAM_CONTROL: p5 above 0 takes a still."""
    shoots = 0 < item.x < INVALID_INT32
    return Shoot(seq=item.seq, count=1, interval_s=0.0) if shoots else NothingToDo(seq=item.seq)


def camera_mode(item: PlanItem, origin: Origin) -> Step:
    """SET_CAMERA_MODE: only stills are supported."""
    mode = whole(item, 2, "camera mode")
    if mode not in STILLS_MODES:
        raise wrong(item, 2, "camera mode", "the camera takes stills only, use 0")
    return NothingToDo(seq=item.seq)


def set_servo(item: PlanItem, origin: Origin) -> Step:
    """DO_SET_SERVO: p1 output, p2 pulse [us]."""
    return MoveServo(seq=item.seq, channel=whole(item, 1, "servo"), pulse_us=_least(item, 2, "pulse", 1.0))


def repeat_servo(item: PlanItem, origin: Origin) -> Step:
    """DO_REPEAT_SERVO: p1 output, p2 pulse [us], p3 count, p4 cycle [s]."""
    return MoveServo(
        seq=item.seq,
        channel=whole(item, 1, "servo"),
        pulse_us=_least(item, 2, "pulse", 1.0),
        count=round(_least(item, 3, "count", 1.0)),
        cycle_s=_least(item, 4, "cycle", 0.1),
    )


def set_relay(item: PlanItem, origin: Origin) -> Step:
    """DO_SET_RELAY: p1 relay from 0, p2 1 = on, 0 = off, -1 = the other side."""
    setting = whole(item, 2, "setting")
    if setting not in (-1, 0, 1):
        raise wrong(item, 2, "setting", "use 1 = on, 0 = off")
    return SwitchRelay(seq=item.seq, number=whole(item, 1, "relay"), on=None if setting == -1 else setting == 1)


def repeat_relay(item: PlanItem, origin: Origin) -> Step:
    """DO_REPEAT_RELAY: p1 relay, p2 count, p3 cycle [s]."""
    return SwitchRelay(
        seq=item.seq,
        number=whole(item, 1, "relay"),
        on=None,
        count=round(_least(item, 2, "count", 1.0)),
        cycle_s=_least(item, 3, "cycle", 0.1),
    )


def gripper(item: PlanItem, origin: Origin) -> Step:
    """DO_GRIPPER: p1 gripper from 1, p2 0 = open, 1 = close."""
    action = whole(item, 2, "action")
    if action not in GRIPPER_ACTIONS:
        raise wrong(item, 2, "action", "use 0 = open, 1 = close")
    return Grip(seq=item.seq, number=whole(item, 1, "gripper"), close=action == 1)


def set_actuator(item: PlanItem, origin: Origin) -> Step:
    """DO_SET_ACTUATOR: p1 to p4 -1 to 1, NaN = unchanged. The fifth and sixth are integers on the wire: not used."""
    group = 0.0 if math.isnan(item.z) else item.z
    if not 0.0 <= group < 100.0 or group != int(group):
        raise refuse(item, MissionResult.INVALID_PARAM7, f"index (param7) is {item.z:g}; use 0")
    values = []
    for index in range(1, 5):
        value = number(item, index, "actuator")
        if value is not None and not -1.0 <= value <= 1.0:
            raise refuse(item, MissionResult.INVALID, f"actuator (param{index}) is {value:g}; use -1 to 1")
        if value is not None:
            values.append((int(group) * 6 + index, value))
    return MoveActuators(seq=item.seq, values=tuple(values))


def mount_control(item: PlanItem, origin: Origin) -> Step:
    """DO_MOUNT_CONTROL: p1 angle [deg], p7 mode 2 (angle), 0 or 1 (its start)."""
    if item.z in (0.0, 1.0):
        return TiltCamera(seq=item.seq, angle_rad=None)
    if item.z != MOUNT_BY_ANGLE and not math.isnan(item.z):
        raise refuse(item, MissionResult.INVALID_PARAM7, f"mode (param7) is {item.z:g}; use 2 = angle, 1 = neutral")
    return TiltCamera(seq=item.seq, angle_rad=math.radians(number(item, 1, "angle") or 0.0))


def gimbal_pitch(item: PlanItem, origin: Origin) -> Step:
    """DO_GIMBAL_MANAGER_PITCHYAW: p1 angle [deg], p2 yaw 0."""
    angle_deg = number(item, 1, "angle")
    if angle_deg is None:
        raise refuse(item, MissionResult.INVALID_PARAM1, "angle (param1) is missing; the camera takes no rate")
    if number(item, 2, "yaw"):
        raise wrong(item, 2, "yaw", "the camera does not pan, use 0")
    return TiltCamera(seq=item.seq, angle_rad=math.radians(angle_deg))


def refused(why: str) -> Callable[[PlanItem, Origin], Step]:
    """An item that no equipment can execute."""

    def parse(item: PlanItem, origin: Origin) -> Step:
        raise refuse(item, MissionResult.UNSUPPORTED, f"command {item.command}: {why}; leave it out")

    return parse


def _least(item: PlanItem, index: int, name: str, least: float) -> float:
    """A parameter with a minimum; a missing one counts as 0."""
    value = number(item, index, name) or 0.0
    if value < least:
        raise wrong(item, index, name, f"use {least:g} or more")
    return value
