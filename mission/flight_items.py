"""Mission items that fly: NAV_ commands with a position or a wait, and DO_ and CONDITION_ (MAV_CMD, common.xml)."""

import math

import numpy as np

from autopilot.core.frames import wrap_pi
from autopilot.core.geodesy import Origin
from autopilot.core.plan import MissionResult, PlanItem
from autopilot.mission.decode import (
    SURFACE_TOLERANCE_M,
    depth_m,
    heading_rad,
    horizontal_ned_m,
    is_here,
    number,
    pos_ned_m,
    refuse,
    seconds,
    whole,
    wrong,
)
from autopilot.mission.items import (
    AMSL_FRAMES,
    ChangeSpeed,
    Command,
    Gate,
    GoTo,
    Jump,
    LoiterTurns,
    MavFrame,
    Near,
    NoOp,
    RegionOfInterest,
    ReturnHome,
    SetHeading,
    SetHome,
    Step,
    Surface,
    Wait,
)
from autopilot.mission.mission_tuning import NAV_ITEMS


def goto(item: PlanItem, origin: Origin) -> Step:
    """NAV_WAYPOINT: p1 hold [s], p2 acceptance radius [m] (0 = default), p3 pass-by radius, p4 yaw [deg]."""
    hold = seconds(item, "hold time")
    radius = number(item, 2, "acceptance radius") or None
    # In the precision of the wire: the least radius of a file arrives as less.
    if radius is not None and np.float32(radius) < np.float32(NAV_ITEMS.min_accept_radius_m):
        advice = f"use {NAV_ITEMS.min_accept_radius_m:g} m or more, 0 for the default"
        raise wrong(item, 2, "acceptance radius", advice, " m")
    if number(item, 3, "pass-by radius"):
        raise wrong(item, 3, "pass-by radius", "set it to 0", " m, which is not supported")
    yaw = heading_rad(item)
    return GoTo(
        seq=item.seq,
        pos_ned_m=pos_ned_m(item, origin),
        yaw_rad=yaw,
        hold_s=hold,
        accept_radius_m=radius,
        autocontinue=item.autocontinue != 0,
    )


def loiter(item: PlanItem, origin: Origin) -> Step:
    """NAV_LOITER_UNLIM (p4 yaw) and NAV_LOITER_TIME (p1 [s]). Radii are for vehicles that cannot stop: not used."""
    for_ever = item.command == Command.NAV_LOITER_UNLIM
    hold = None if for_ever else seconds(item, "loiter time")
    yaw = heading_rad(item) if for_ever else None
    pos = None if is_here(item) else pos_ned_m(item, origin)
    return GoTo(
        seq=item.seq,
        pos_ned_m=pos,
        yaw_rad=yaw,
        hold_s=hold,
        accept_radius_m=None,
        autocontinue=item.autocontinue != 0,
    )


def circuit(item: PlanItem, origin: Origin) -> Step:
    """NAV_LOITER_TURNS: p1 turns, p3 radius [m] (negative = to port, 0 = CIRCLE_RADIUS). p2 and p4 are for aircraft."""
    turns = number(item, 1, "turns")
    if turns is None or not 0.0 < turns <= NAV_ITEMS.max_turns:
        raise wrong(item, 1, "turns", f"use above 0, up to {NAV_ITEMS.max_turns}")
    radius = number(item, 3, "radius") or 0.0
    least, most = NAV_ITEMS.min_ring_m, NAV_ITEMS.max_ring_m
    if radius and not least <= abs(radius) <= most:
        raise wrong(item, 3, "radius", f"use {least:g} to {most:g} m (negative = to port), 0 = CIRCLE_RADIUS", " m")
    centre = None if is_here(item) else pos_ned_m(item, origin)
    return LoiterTurns(
        seq=item.seq,
        centre_ned_m=centre,
        radius_m=abs(radius) or None,
        clockwise=radius >= 0.0,
        turns=turns,
        autocontinue=item.autocontinue != 0,
    )


def take_off(item: PlanItem, origin: Origin) -> Step:
    """NAV_TAKEOFF means "dive here": p4 yaw; the position is not used. A negative altitude is the depth; a missing
    or positive one, as ground stations put it into every plan, means TKOFF_DEPTH.
    """
    if item.frame == MavFrame.LOCAL_NED:
        depth = item.z
    elif item.frame in AMSL_FRAMES:
        depth = origin.alt_m - item.z
    else:
        depth = math.nan if item.frame == MavFrame.MISSION else -item.z
    return GoTo(
        seq=item.seq,
        pos_ned_m=None,
        yaw_rad=heading_rad(item),
        hold_s=0.0,
        accept_radius_m=NAV_ITEMS.dived_m,
        autocontinue=item.autocontinue != 0,
        dives=True,
        dive_m=depth if depth > SURFACE_TOLERANCE_M else None,
    )


def surface(item: PlanItem, origin: Origin) -> Step:
    """NAV_LAND means "surface": p4 yaw; the altitude has no meaning."""
    yaw = heading_rad(item)
    pos = None
    if not is_here(item):
        pos = np.array([*horizontal_ned_m(item, origin), 0.0])
    return Surface(seq=item.seq, pos_ned_m=pos, yaw_rad=yaw)


def wait(item: PlanItem, origin: Origin) -> Step:
    """NAV_DELAY and CONDITION_DELAY: p1 [s]. A time of day (NAV_DELAY p1 = -1) is refused."""
    return Wait(seq=item.seq, duration_s=seconds(item, "delay"), reported=item.command == Command.NAV_DELAY)


def return_home(item: PlanItem, origin: Origin) -> Step:
    return ReturnHome(seq=item.seq)


def jump(item: PlanItem, origin: Origin) -> Step:
    """DO_JUMP: p1 target item, p2 repeats (-1 = for ever). Whether the target exists is known with the whole plan."""
    target, count = whole(item, 1, "jump target"), whole(item, 2, "jump count")
    if target < 0:
        raise wrong(item, 1, "jump target", "give an item number")
    if target == item.seq:
        raise refuse(item, MissionResult.INVALID_PARAM1, "jumps to itself; give another item as target (param1)")
    if count < -1:
        raise wrong(item, 2, "jump count", "use 0 or more, -1 for ever")
    return Jump(seq=item.seq, target_seq=target, count=None if count == -1 else count)


def change_speed(item: PlanItem, origin: Origin) -> Step:
    """DO_CHANGE_SPEED: p1 type (0 or 1 = planar), p2 [m/s] (-2 = default). Throttle (p3) has no meaning here."""
    kind = number(item, 1, "speed type") or 0.0
    if kind not in (0.0, 1.0):
        raise wrong(item, 1, "speed type", "use 1 (ground speed), heave follows the vehicle's limits")
    speed = number(item, 2, "speed")
    if speed == -2.0:
        return ChangeSpeed(seq=item.seq, speed_m_s=None)
    if speed is None or speed <= 0.0:
        raise wrong(item, 2, "speed", "give a speed above 0 m/s, or -2 for the default", " m/s")
    return ChangeSpeed(seq=item.seq, speed_m_s=speed)


def set_heading(item: PlanItem, origin: Origin) -> Step:
    """CONDITION_YAW: p1 angle [deg], p3 direction of a relative turn (-1 = to port), p4 1 = relative."""
    angle = number(item, 1, "heading")
    if angle is None or abs(angle) > 360.0:
        raise wrong(item, 1, "heading", "use -360 to 360 deg", " deg")
    relative = number(item, 4, "relative flag") or 0.0
    if relative not in (0.0, 1.0):
        raise wrong(item, 4, "relative flag", "use 0 (absolute) or 1 (relative)")
    direction = number(item, 3, "direction") or 0.0
    if relative and direction < 0.0:
        angle = -angle
    return SetHeading(seq=item.seq, yaw_rad=wrap_pi(math.radians(angle)), relative=relative == 1.0)


def set_home(item: PlanItem, origin: Origin) -> Step:
    """DO_SET_HOME: p1 1 = here, else the item's position (a home above the surface is taken at the surface)."""
    if number(item, 1, "use-current flag") == 1.0:
        return SetHome(seq=item.seq, pos_ned_m=None)
    north, east = horizontal_ned_m(item, origin)
    depth = item.z if item.frame == MavFrame.LOCAL_NED else -item.z
    if item.frame in AMSL_FRAMES:
        depth += origin.alt_m
    if not math.isfinite(depth):
        raise refuse(item, MissionResult.INVALID_PARAM7, f"altitude (param7) is {item.z}; give a number")
    return SetHome(seq=item.seq, pos_ned_m=np.array([north, east, max(0.0, depth)]))


def near(item: PlanItem, origin: Origin) -> Step:
    """CONDITION_DISTANCE: p1 distance to the next position [m]."""
    distance = number(item, 1, "distance")
    if distance is None or distance < 0.0:
        raise wrong(item, 1, "distance", "give 0 m or more", " m")
    return Near(seq=item.seq, distance_m=distance)


def gate(item: PlanItem, origin: Origin) -> Step:
    """CONDITION_GATE: p1 0 = perpendicular to the path, p2 1 = the altitude counts; a point in the gate."""
    if number(item, 1, "geometry"):
        raise wrong(item, 1, "geometry", "use 0 (across the way)")
    counts = number(item, 2, "altitude flag") or 0.0
    if counts not in (0.0, 1.0):
        raise wrong(item, 2, "altitude flag", "use 0 (ignored) or 1")
    place = horizontal_ned_m(item, origin)
    depth = depth_m(item, origin) if counts else 0.0
    return Gate(seq=item.seq, pos_ned_m=np.array([*place, depth]), upright=counts == 0.0)


def look_at(item: PlanItem, origin: Origin) -> Step:
    """DO_SET_ROI_LOCATION, DO_SET_ROI (a position, or 0, 0 = none), DO_SET_ROI_NONE. The altitude is not used: the
    vehicle yaws, it does not pitch.
    """
    if item.command == Command.DO_SET_ROI_NONE:
        return RegionOfInterest(seq=item.seq, place_ned_m=None)
    if item.command == Command.DO_SET_ROI:
        mode = number(item, 1, "ROI mode") or 0.0
        if mode not in (ROI_NONE, ROI_LOCATION):
            raise wrong(item, 1, "ROI mode", "use 3 (a place) or 0 (none)")
        if is_here(item):
            return RegionOfInterest(seq=item.seq, place_ned_m=None)
    return RegionOfInterest(seq=item.seq, place_ned_m=np.array(horizontal_ned_m(item, origin)))


ROI_NONE, ROI_LOCATION = 0.0, 3.0
"""MAV_ROI. Missions of older ground stations leave it 0 and give a place."""


def fence_on(item: PlanItem, origin: Origin) -> Step:
    """DO_FENCE_ENABLE: the fence cannot be disabled."""
    if number(item, 1, "enable flag") != 1.0:
        text = "the fence cannot be switched off (param1): use 1, or clear the fence before the mission"
        raise refuse(item, MissionResult.INVALID_PARAM1, text)
    return NoOp(seq=item.seq)
