"""ArduPilot's convention that item 0 of a mission on the wire is the home position.

The home item stays in the plan as an item that is not flown, so that all numbers equal those of the operator's
file. With the ArduPilot profile item 0 always is home, and a mission stored without it is numbered from 1 on the
wire. With other profiles item 0 is home when :func:`autopilot.core.plan.begins_with_home` holds.
"""

from collections.abc import Sequence
from dataclasses import replace

from pymavlink.dialects.v20 import development as mav

from autopilot.core.plan import PlanItem, PlanKind, begins_with_home, in_water, may_be_home
from autopilot.mavlink.context import Context, i32


def shift(ctx: Context, kind: PlanKind) -> int:
    """How many items the wire has before the store's first one."""
    return ctx.wire_shift if kind is PlanKind.MISSION else 0


def may_be(ctx: Context, kind: PlanKind, item: PlanItem) -> bool:
    """Whether an item of an upload is, or could turn out to be, home."""
    if kind is not PlanKind.MISSION or item.seq != 0:
        return False
    return ctx.profile.home_is_item_0 or (may_be_home(item) and not in_water(item, ctx.view.origin.alt_m, ctx.params))


def received(ctx: Context, kind: PlanKind, items: Sequence[PlanItem]) -> tuple[PlanItem, ...]:
    """An upload as it is stored; an upload of home alone is an empty mission."""
    if not items or not may_be(ctx, kind, items[0]):
        return tuple(items)
    if not ctx.profile.home_is_item_0 and not begins_with_home(items):
        return tuple(items)
    return () if len(items) == 1 else (replace(items[0], is_home=True), *items[1:])


def wire_plan(ctx: Context, kind: PlanKind) -> tuple[PlanItem, ...]:
    """A plan as the wire numbers it; an empty plan stays empty."""
    items = ctx.plans.items(kind)
    by = shift(ctx, kind)
    if not items:
        return items
    if not by:
        return (_home(ctx), *items[1:]) if ctx.profile.home_is_item_0 and items[0].is_home else items
    return (_home(ctx), *(_renumbered(item, by) for item in items))


def _renumbered(item: PlanItem, by: int) -> PlanItem:
    jump = item.command == mav.MAV_CMD_DO_JUMP
    return replace(item, seq=item.seq + by, param1=item.param1 + by if jump else item.param1)


def _home(ctx: Context) -> PlanItem:
    home = ctx.view.home
    return PlanItem(
        seq=0,
        frame=mav.MAV_FRAME_GLOBAL,
        command=mav.MAV_CMD_NAV_WAYPOINT,
        param4=0.0,
        x=i32(home.lat_deg * 1e7),
        y=i32(home.lon_deg * 1e7),
        z=home.alt_m,
    )
