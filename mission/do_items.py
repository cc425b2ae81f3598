"""Mission items that change something in passing: DO_ commands and CONDITION_YAW (MAV_CMD, common.xml)."""

import math

import numpy as np

from autopilot.core.frames import wrap_pi
from autopilot.core.geodesy import Origin
from autopilot.core.plan import MissionResult, PlanItem
from mission.decode import horizontal_ned_m, number, refuse, whole
from mission.items import AMSL_FRAMES, ChangeSpeed, Frame, Jump, SetHeading, SetHome, Step


def jump(item: PlanItem, origin: Origin) -> Step:
    """DO_JUMP: p1 target item, p2 repeats (-1 = for ever). Whether the target exists is known with the whole plan."""
    target, count = whole(item, 1, "jump target"), whole(item, 2, "jump count")
    if target < 0:
        raise refuse(item, MissionResult.INVALID_PARAM1, f"jump target (param1) is {target}; give an item number")
    if target == item.seq:
        raise refuse(item, MissionResult.INVALID_PARAM1, "jumps to itself; give another item as target (param1)")
    if count < -1:
        text = f"jump count (param2) is {count}; use 0 or more, -1 for ever"
        raise refuse(item, MissionResult.INVALID_PARAM2, text)
    return Jump(seq=item.seq, target_seq=target, count=None if count == -1 else count)


def change_speed(item: PlanItem, origin: Origin) -> Step:
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


def set_heading(item: PlanItem, origin: Origin) -> Step:
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


def set_home(item: PlanItem, origin: Origin) -> Step:
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
