"""From the wire's meaning to typed steps: command numbers, parameters, frames and degrees are known only here.

An item that cannot be taken is refused with the MAV_MISSION_RESULT that points at the wrong field and a line for the
operator (MAVLink mission protocol, common.xml).
"""

import math
from collections.abc import Callable

import numpy as np

from autopilot.core.errors import PlanError
from autopilot.core.frames import wrap_pi
from autopilot.core.geodesy import (
    MAX_RANGE_M,
    Origin,
    deg_from_e7,
    m_from_local_e4,
    ned_from_geodetic,
    surface_distance_m,
)
from autopilot.core.plan import MissionResult, PlanItem, PlanRejection
from mission.items import (
    AMSL_FRAMES,
    GLOBAL_FRAMES,
    TERRAIN_FRAMES,
    ChangeSpeed,
    Command,
    Frame,
    GoTo,
    Jump,
    ReturnHome,
    SetHeading,
    SetHome,
    Step,
    Surface,
    Wait,
)

INVALID_INT32 = 2147483647
"""MAVLink's "not a number" of an integer coordinate."""
DIVED_M = 0.1
"""NAV_TAKEOFF is done within this distance of its depth."""

SURFACE_TOLERANCE_M = 1e-3
"""Altitudes arrive as 32-bit floats: a millimetre above the surface still is the surface."""
MIN_ACCEPT_RADIUS_M = 0.02
"""A smaller acceptance ball is below what any estimate can tell."""
_PARAM_RESULT = (
    MissionResult.INVALID_PARAM1,
    MissionResult.INVALID_PARAM2,
    MissionResult.INVALID_PARAM3,
    MissionResult.INVALID_PARAM4,
)


class ItemRefusedError(PlanError):
    """An item that cannot be taken; carries the answer for the uploader."""

    def __init__(self, rejection: PlanRejection) -> None:
        super().__init__(rejection.reason)
        self.rejection = rejection


def refuse(item: PlanItem, result: MissionResult, text: str, label: str = "item") -> ItemRefusedError:
    """The error for ``item``: ``label seq: text``."""
    return ItemRefusedError(PlanRejection(seq=item.seq, result=result, reason=f"{label} {item.seq}: {text}"))


def item_params(item: PlanItem) -> tuple[float, float, float, float]:
    """The four free parameters."""
    return item.param1, item.param2, item.param3, item.param4


def number(item: PlanItem, index: int, name: str, label: str = "item") -> float | None:
    """Parameter 1..4, None when it is NaN ("not given"); infinity is refused."""
    value = item_params(item)[index - 1]
    if math.isinf(value):
        raise refuse(item, _PARAM_RESULT[index - 1], f"{name} (param{index}) is infinite; give a number", label)
    return None if math.isnan(value) else value


def _whole(item: PlanItem, index: int, name: str) -> int:
    value = number(item, index, name)
    if value is None or value != int(value):
        shown = "not given" if value is None else f"{value:g}"
        raise refuse(item, _PARAM_RESULT[index - 1], f"{name} (param{index}) is {shown}; give a whole number")
    return int(value)


def _seconds(item: PlanItem, name: str) -> float:
    value = number(item, 1, name) or 0.0
    if value < 0.0:
        raise refuse(item, MissionResult.INVALID_PARAM1, f"{name} (param1) is {value:g} s; give 0 s or more")
    return value


def _yaw(item: PlanItem) -> float | None:
    """Heading from p4 [deg], None = free."""
    value = number(item, 4, "yaw")
    if value is None:
        return None
    if abs(value) > 360.0:
        text = f"yaw (param4) is {value:g} deg; use -360 to 360 deg, or NaN for a free heading"
        raise refuse(item, MissionResult.INVALID_PARAM4, text)
    return wrap_pi(math.radians(value))


def check_frame(item: PlanItem, label: str = "item") -> None:
    """Refuse frames in which a position cannot be given."""
    if item.frame in GLOBAL_FRAMES or item.frame == Frame.LOCAL_NED:
        return
    if item.frame in TERRAIN_FRAMES:
        text = f"frame {item.frame} (altitude above terrain) is not supported; use relative altitude (frame 3)"
    elif item.frame == Frame.MISSION:
        text = f"frame 2 (MISSION) has no position but command {item.command} needs one; use frame 3, 0 or 1"
    else:
        text = f"frame {item.frame} is not supported; use 3 (relative altitude), 0 (AMSL) or 1 (LOCAL_NED)"
    raise refuse(item, MissionResult.UNSUPPORTED_FRAME, text, label)


def horizontal_ned_m(item: PlanItem, origin: Origin, label: str = "item") -> tuple[float, float]:
    """North and east [m] of an item with a position; refuses bad frames, coordinates and far-away points."""
    check_frame(item, label)
    for value, result, name in (
        (item.x, MissionResult.INVALID_PARAM5_X, "latitude or x (param5)"),
        (item.y, MissionResult.INVALID_PARAM6_Y, "longitude or y (param6)"),
    ):
        if abs(value) >= INVALID_INT32:
            raise refuse(item, result, f"{name} is not a number; give a position", label)
    if item.frame == Frame.LOCAL_NED:
        north, east = m_from_local_e4(item.x), m_from_local_e4(item.y)
    else:
        lat, lon = deg_from_e7(item.x), deg_from_e7(item.y)
        if abs(lat) > 90.0:
            text = f"latitude {lat:.7f} deg is out of range; use -90 to 90"
            raise refuse(item, MissionResult.INVALID_PARAM5_X, text, label)
        if abs(lon) > 180.0:
            text = f"longitude {lon:.7f} deg is out of range; use -180 to 180"
            raise refuse(item, MissionResult.INVALID_PARAM6_Y, text, label)
        if item.x == 0 and item.y == 0:
            text = "latitude and longitude are both 0, the position is not set; give a position"
            raise refuse(item, MissionResult.INVALID_PARAM5_X, text, label)
        if surface_distance_m(origin, lat, lon) > 2.0 * MAX_RANGE_M:
            north, east = math.radians(lat - origin.lat_deg) * 6.4e6, math.inf
        else:
            pos = ned_from_geodetic(origin, lat, lon, origin.alt_m)
            north, east = float(pos[0]), float(pos[1])
    if math.hypot(north, east) > MAX_RANGE_M:
        result = MissionResult.INVALID_PARAM5_X if abs(north) > MAX_RANGE_M else MissionResult.INVALID_PARAM6_Y
        text = (
            f"position is more than {MAX_RANGE_M / 1e3:.0f} km from the local origin "
            f"({origin.lat_deg:.6f}, {origin.lon_deg:.6f}); move the item, or set the origin near the plan"
        )
        raise refuse(item, result, text, label)
    return north, east


def depth_m(item: PlanItem, origin: Origin, label: str = "item") -> float:
    """Depth [m] of an item; refuses what is not finite or above the surface, naming the sign rule."""
    if not math.isfinite(item.z):
        raise refuse(item, MissionResult.INVALID_PARAM7, f"altitude (param7) is {item.z}; give a number <= 0", label)
    if item.frame == Frame.LOCAL_NED:
        depth, rule = item.z, "z in LOCAL_NED is depth: 0.4 m under the surface is z = 0.4"
    elif item.frame in AMSL_FRAMES:
        depth = origin.alt_m - item.z
        rule = f"altitude must be <= {origin.alt_m:g} (AMSL of the surface): depth 0.4 m is {origin.alt_m - 0.4:g}"
    else:
        depth, rule = -item.z, "altitude must be <= 0: depth 0.4 m is altitude -0.4"
    if depth < -SURFACE_TOLERANCE_M:
        raise refuse(item, MissionResult.INVALID_PARAM7, f"{-depth:.2f} m above the surface; {rule}", label)
    return max(0.0, depth)


def _here_if_unset(item: PlanItem) -> bool:
    """Whether the item means "where the vehicle is then": no position frame, or latitude and longitude 0."""
    return item.frame == Frame.MISSION or (item.frame in GLOBAL_FRAMES and item.x == 0 and item.y == 0)


def _goto(item: PlanItem, origin: Origin) -> Step:
    """NAV_WAYPOINT: p1 hold [s], p2 acceptance radius [m] (0 = default), p3 pass-by radius, p4 yaw [deg]."""
    hold = _seconds(item, "hold time")
    radius = number(item, 2, "acceptance radius") or None
    if radius is not None and radius < MIN_ACCEPT_RADIUS_M:
        text = f"acceptance radius (param2) is {radius:g} m; use {MIN_ACCEPT_RADIUS_M:g} m or more, 0 for the default"
        raise refuse(item, MissionResult.INVALID_PARAM2, text)
    if number(item, 3, "pass-by radius"):
        text = f"pass-by radius (param3) is {item.param3:g} m, which is not supported; set it to 0"
        raise refuse(item, MissionResult.INVALID_PARAM3, text)
    yaw = _yaw(item)
    north, east = horizontal_ned_m(item, origin)
    return GoTo(
        seq=item.seq,
        pos_ned_m=np.array([north, east, depth_m(item, origin)]),
        yaw_rad=yaw,
        hold_s=hold,
        accept_radius_m=radius,
        autocontinue=item.autocontinue != 0,
    )


def _loiter(item: PlanItem, origin: Origin) -> Step:
    """NAV_LOITER_UNLIM (p4 yaw) and NAV_LOITER_TIME (p1 [s]). Radii are for vehicles that cannot stop: not used."""
    for_ever = item.command == Command.NAV_LOITER_UNLIM
    hold = None if for_ever else _seconds(item, "loiter time")
    yaw = _yaw(item) if for_ever else None
    pos = None
    if not _here_if_unset(item):
        north, east = horizontal_ned_m(item, origin)
        pos = np.array([north, east, depth_m(item, origin)])
    return GoTo(
        seq=item.seq,
        pos_ned_m=pos,
        yaw_rad=yaw,
        hold_s=hold,
        accept_radius_m=None,
        autocontinue=item.autocontinue != 0,
    )


def _take_off(item: PlanItem, origin: Origin) -> Step:
    """NAV_TAKEOFF means "dive here": p4 yaw; the place is not used. An altitude in the water is the depth;
    one above it, as ground stations put it into every plan, or none, means TKOFF_DEPTH."""
    if item.frame == Frame.LOCAL_NED:
        depth = item.z
    elif item.frame in AMSL_FRAMES:
        depth = origin.alt_m - item.z
    else:
        depth = math.nan if item.frame == Frame.MISSION else -item.z
    return GoTo(
        seq=item.seq,
        pos_ned_m=None,
        yaw_rad=_yaw(item),
        hold_s=0.0,
        accept_radius_m=DIVED_M,
        autocontinue=item.autocontinue != 0,
        dives=True,
        dive_m=depth if depth > SURFACE_TOLERANCE_M else None,
    )


def _surface(item: PlanItem, origin: Origin) -> Step:
    """NAV_LAND means "surface": p4 yaw; the altitude has no meaning."""
    yaw = _yaw(item)
    pos = None
    if not _here_if_unset(item):
        pos = np.array([*horizontal_ned_m(item, origin), 0.0])
    return Surface(seq=item.seq, pos_ned_m=pos, yaw_rad=yaw)


def _wait(item: PlanItem, origin: Origin) -> Step:
    """NAV_DELAY and CONDITION_DELAY: p1 [s]. A time of day (NAV_DELAY p1 = -1) is refused."""
    return Wait(seq=item.seq, duration_s=_seconds(item, "delay"), reported=item.command == Command.NAV_DELAY)


def _jump(item: PlanItem, origin: Origin) -> Step:
    """DO_JUMP: p1 target item, p2 repeats (-1 = for ever). Whether the target exists is known with the whole plan."""
    target, count = _whole(item, 1, "jump target"), _whole(item, 2, "jump count")
    if target < 0:
        raise refuse(item, MissionResult.INVALID_PARAM1, f"jump target (param1) is {target}; give an item number")
    if target == item.seq:
        raise refuse(item, MissionResult.INVALID_PARAM1, "jumps to itself; give another item as target (param1)")
    if count < -1:
        text = f"jump count (param2) is {count}; use 0 or more, -1 for ever"
        raise refuse(item, MissionResult.INVALID_PARAM2, text)
    return Jump(seq=item.seq, target_seq=target, count=None if count == -1 else count)


def _change_speed(item: PlanItem, origin: Origin) -> Step:
    """DO_CHANGE_SPEED: p1 type (0 or 1 = planar), p2 [m/s] (-2 = default). Throttle (p3) has no meaning here."""
    kind = number(item, 1, "speed type") or 0.0
    if kind not in (0.0, 1.0):
        text = f"speed type (param1) is {kind:g}; use 1 (ground speed), heave follows the vehicle's limits"
        raise refuse(item, MissionResult.INVALID_PARAM1, text)
    speed = number(item, 2, "speed")
    if speed == -2.0:
        return ChangeSpeed(seq=item.seq, speed_m_s=None)
    if speed is None or speed <= 0.0:
        shown = "not given" if speed is None else f"{speed:g} m/s"
        text = f"speed (param2) is {shown}; give a speed above 0 m/s, or -2 for the default"
        raise refuse(item, MissionResult.INVALID_PARAM2, text)
    return ChangeSpeed(seq=item.seq, speed_m_s=speed)


def _set_heading(item: PlanItem, origin: Origin) -> Step:
    """CONDITION_YAW: p1 angle [deg], p3 direction of a relative turn (-1 = to port), p4 1 = relative."""
    angle = number(item, 1, "heading")
    if angle is None or abs(angle) > 360.0:
        shown = "not given" if angle is None else f"{angle:g} deg"
        text = f"heading (param1) is {shown}; use -360 to 360 deg"
        raise refuse(item, MissionResult.INVALID_PARAM1, text)
    relative = number(item, 4, "relative flag") or 0.0
    if relative not in (0.0, 1.0):
        text = f"relative flag (param4) is {relative:g}; use 0 (absolute) or 1 (relative)"
        raise refuse(item, MissionResult.INVALID_PARAM4, text)
    direction = number(item, 3, "direction") or 0.0
    if relative and direction < 0.0:
        angle = -angle
    return SetHeading(seq=item.seq, yaw_rad=wrap_pi(math.radians(angle)), relative=relative == 1.0)


def _set_home(item: PlanItem, origin: Origin) -> Step:
    """DO_SET_HOME: p1 1 = here, else the item's position (a home above the surface is taken at the surface)."""
    if number(item, 1, "use-current flag") == 1.0:
        return SetHome(seq=item.seq, pos_ned_m=None)
    north, east = horizontal_ned_m(item, origin)
    depth = item.z if item.frame == Frame.LOCAL_NED else -item.z
    if item.frame in AMSL_FRAMES:
        depth += origin.alt_m
    if not math.isfinite(depth):
        raise refuse(item, MissionResult.INVALID_PARAM7, f"altitude (param7) is {item.z}; give a number")
    return SetHome(seq=item.seq, pos_ned_m=np.array([north, east, max(0.0, depth)]))


POSITIONAL = frozenset({Command.NAV_WAYPOINT, Command.NAV_LOITER_UNLIM, Command.NAV_LOITER_TIME, Command.NAV_LAND})
"""Commands whose frame is judged together with their position."""
_PARSERS: dict[int, Callable[[PlanItem, Origin], Step]] = {
    Command.NAV_WAYPOINT: _goto,
    Command.NAV_LOITER_UNLIM: _loiter,
    Command.NAV_LOITER_TIME: _loiter,
    Command.NAV_LAND: _surface,
    Command.NAV_TAKEOFF: _take_off,
    Command.NAV_DELAY: _wait,
    Command.CONDITION_DELAY: _wait,
    Command.CONDITION_YAW: _set_heading,
    Command.DO_JUMP: _jump,
    Command.DO_CHANGE_SPEED: _change_speed,
    Command.DO_SET_HOME: _set_home,
}


def parse_step(item: PlanItem, origin: Origin) -> Step:
    """The step that a mission item asks for; ItemRefusedError if it cannot be flown."""
    if item.command != Command.NAV_RETURN_TO_LAUNCH and item.command not in _PARSERS:
        known = ", ".join(str(int(c)) for c in (*_PARSERS, Command.NAV_RETURN_TO_LAUNCH))
        text = f"command {item.command} is not supported in a mission; use one of {known}"
        raise refuse(item, MissionResult.UNSUPPORTED, text)
    if item.command not in POSITIONAL and item.frame not in GLOBAL_FRAMES | {Frame.LOCAL_NED, Frame.MISSION}:
        text = f"frame {item.frame} is not supported for command {item.command}; use frame 2 (MISSION)"
        raise refuse(item, MissionResult.UNSUPPORTED_FRAME, text)
    if item.command == Command.NAV_RETURN_TO_LAUNCH:
        return ReturnHome(seq=item.seq)
    return _PARSERS[item.command](item, origin)
