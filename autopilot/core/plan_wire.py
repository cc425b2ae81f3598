"""Conversion of plan items to MISSION_ITEM_INT and back."""

from typing import Any

from pymavlink.dialects.v20 import development as mav

from autopilot.core.plan import PlanItem, PlanKind


def item_message(
    item: PlanItem, kind: PlanKind, *, system: int = 1, component: int = 1, current: bool = False
) -> mav.MAVLink_mission_item_int_message:
    """MISSION_ITEM_INT to a system and component (by default to the first vehicle). ``current``: it is flown now, or
    the first of a mission."""
    params = (item.param1, item.param2, item.param3, item.param4)
    return mav.MAVLink_mission_item_int_message(
        *(system, component, item.seq, item.frame, item.command, int(current), item.autocontinue),
        *(*params, item.x, item.y, item.z, int(kind)),
    )


def item_of(message: Any) -> PlanItem:
    return PlanItem(
        seq=message.seq,
        frame=message.frame,
        command=message.command,
        param1=message.param1,
        param2=message.param2,
        param3=message.param3,
        param4=message.param4,
        x=message.x,
        y=message.y,
        z=message.z,
        autocontinue=message.autocontinue,
    )
