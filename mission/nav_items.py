"""Mission items with a position or a wait: NAV_ commands (MAV_CMD, common.xml)."""

import math

import numpy as np

from autopilot.core.geodesy import Origin
from autopilot.core.plan import PlanItem
from autopilot.mission.decode import (
    SURFACE_TOLERANCE_M,
    heading_rad,
    horizontal_ned_m,
    is_here,
    number,
    pos_ned_m,
    seconds,
    wrong,
)
from autopilot.mission.items import AMSL_FRAMES, Command, GoTo, LoiterTurns, MavFrame, ReturnHome, Step, Surface, Wait
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
