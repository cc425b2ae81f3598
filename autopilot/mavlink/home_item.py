"""ArduPilot's convention that item 0 of a mission on the wire is the home position, as a shift of numbers.

The plan store holds missions without it. Under other profiles, and for fence and rally plans, nothing is shifted.
"""

from dataclasses import replace

from pymavlink.dialects.v20 import development as mav

from autopilot.core.plan import PlanItem, PlanKind
from autopilot.mavlink.context import Context, i32


def shift(ctx: Context, kind: PlanKind) -> int:
    """How many items the wire has before the store's first one."""
    return 1 if ctx.profile.home_is_item_0 and kind is PlanKind.MISSION else 0


def stored(item: PlanItem, by: int) -> PlanItem:
    """An item of the wire as the store numbers it."""
    return _renumbered(item, -by) if by else item


def wire_plan(ctx: Context, kind: PlanKind) -> tuple[PlanItem, ...]:
    """A plan as the wire numbers it; an empty plan stays empty."""
    items = ctx.plans.items(kind)
    by = shift(ctx, kind)
    if not by or not items:
        return items
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
