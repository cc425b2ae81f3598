"""Conversion of plan items to MISSION_ITEM_INT and back."""

from dataclasses import fields
from typing import Any

from pymavlink.dialects.v20 import development as mav

from autopilot.core.plan import PlanItem, PlanKind

_SENT = tuple(field.name for field in fields(PlanItem) if field.name != "is_home")
"""Fields of an item that the message has, by the same names."""


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
    return PlanItem(**{name: getattr(message, name) for name in _SENT})
