"""Plans in local metres (TOML): what one writes by hand for a tank.

::

    description = "..."                     # optional
    [origin]                                # where north = east = 0 lies on the map; altitude of the water surface
    lat_deg = 37.9755
    lon_deg = 23.7790
    alt_m = 0.0
    [[waypoint]]                            # in the order in which they are flown
    x_m = -1.60                             # north
    y_m = -0.35                             # east
    depth_m = 0.45                          # down from the surface, positive
    yaw_rad = 0.0                           # optional, without it the heading is free
    hold_s = 0.0                            # optional
    accept_m = 0.3                          # optional, without it the vehicle's parameter holds
    speed_m_s = 0.35                        # optional, from this leg on
    [repeat]                                # optional: waypoints from first_waypoint (counted from 0) to the last ...
    first_waypoint = 1
    laps = 3                                # ... are visited so many times
    [end]                                   # optional: what follows, "hold" (default), "return" or "surface"
    action = "hold"
    [[fence.polygon]]
    points_m = [[-2.5, -1.5], [2.5, -1.5], [2.5, 1.5], [-2.5, 1.5]]
    inclusion = true                        # the vehicle stays inside; false = outside
    [[fence.circle]]
    x_m = -0.625
    y_m = -0.625
    radius_m = 0.16
    inclusion = false
    [[rally]]
    x_m = 0.0
    y_m = 0.0
"""

import math
from typing import Annotated, Literal

import msgspec
import numpy as np

from autopilot.core.errors import ConfigError, PlanError
from autopilot.core.geodesy import Origin, geodetic_from_ned
from autopilot.core.plan import PlanItem
from autopilot.core.toml_table import Table, convert, parse_toml
from autopilot.mission.items import Command, MavFrame
from autopilot.mission.plan_model import PlanFile, make_item

NAN = math.nan
_GROUND_SPEED = 1.0
_NO_CHANGE = -1.0


class OriginTable(Table, frozen=True, kw_only=True):
    """Geodetic position of the local origin."""

    lat_deg: float
    lon_deg: float
    alt_m: float = 0.0


class WaypointTable(Table, frozen=True, kw_only=True):
    x_m: float
    y_m: float
    depth_m: float
    yaw_rad: float | None = None
    hold_s: float = 0.0
    accept_m: float = 0.0
    speed_m_s: float | None = None


class RepeatTable(Table, frozen=True, kw_only=True):
    """Which waypoints are visited how often."""

    first_waypoint: Annotated[int, msgspec.Meta(ge=0)] = 0
    laps: Annotated[int, msgspec.Meta(ge=1, le=65535)]


class EndTable(Table, frozen=True, kw_only=True):
    """Action after the last waypoint."""

    action: Literal["hold", "return", "surface"] = "hold"


class PolygonTable(Table, frozen=True, kw_only=True):
    """A vertical prism."""

    points_m: Annotated[list[tuple[float, float]], msgspec.Meta(min_length=3)]
    inclusion: bool = False


class CircleTable(Table, frozen=True, kw_only=True):
    """A vertical cylinder."""

    x_m: float
    y_m: float
    radius_m: float
    inclusion: bool = False


class FenceTable(Table, frozen=True, kw_only=True):
    polygon: list[PolygonTable] = msgspec.field(default_factory=list)
    circle: list[CircleTable] = msgspec.field(default_factory=list)


class SurfacePoint(Table, frozen=True, kw_only=True):
    x_m: float
    y_m: float


class LocalPlan(Table, frozen=True, kw_only=True):
    description: str = ""
    origin: OriginTable
    waypoint: list[WaypointTable] = msgspec.field(default_factory=list)
    repeat: RepeatTable | None = None
    end: EndTable = EndTable()
    fence: FenceTable = FenceTable()
    rally: list[SurfacePoint] = msgspec.field(default_factory=list)


def read_local_plan(text: str, name: str) -> PlanFile:
    """Parse a plan in local metres (TOML).

    Parameters
    ----------
    text
        Content of the file; x north, y east, depth down [m], yaw [rad].
    name
        Name of the file, for error messages.

    Returns
    -------
    PlanFile
        In wire units.

    Raises
    ------
    PlanError
        The message names file, key and remedy.
    """
    try:
        local: LocalPlan = convert(parse_toml(text, name), LocalPlan, name)
    except ConfigError as error:
        raise PlanError(str(error)) from error
    return plan_of_local(local, name)


def plan_of_local(local: LocalPlan, name: str = "plan") -> PlanFile:
    """The same plan as MAVLink items: positions in GLOBAL_RELATIVE_ALT, so that every ground station can read them."""
    table = local.origin
    try:
        origin = Origin(lat_deg=table.lat_deg, lon_deg=table.lon_deg, alt_m=table.alt_m)
    except ConfigError as error:
        raise PlanError(f"{name}: {error}") from error
    rally = tuple(
        _placed(origin, f"{name}: rally[{k}]", k, Command.RALLY_POINT, (0.0, 0.0, 0.0, 0.0), (p.x_m, p.y_m, 0.0))
        for k, p in enumerate(local.rally)
    )
    return PlanFile(mission=_mission(local, origin, name), fence=_fence(local, origin, name), rally=rally, home=origin)


def _placed(
    origin: Origin,
    where: str,
    seq: int,
    command: Command,
    params: tuple[float, float, float, float],
    pos_ned_m: tuple[float, float, float],
    frame: MavFrame = MavFrame.GLOBAL_RELATIVE_ALT,
) -> PlanItem:
    """An item at a local position; in the relative frame its altitude is minus the depth."""
    try:
        lat, lon, _ = geodetic_from_ned(origin, np.array(pos_ned_m))
    except ConfigError as error:
        raise PlanError(f"{where}: {error}") from error
    return make_item(where, seq, frame, command, (*params, lat, lon, 0.0 - pos_ned_m[2]))


def _mission(local: LocalPlan, origin: Origin, name: str) -> tuple[PlanItem, ...]:
    items: list[PlanItem] = []
    first_seq: list[int] = []
    for k, w in enumerate(local.waypoint):
        first_seq.append(len(items))
        where = f"{name}: waypoint[{k}]"
        if w.speed_m_s is not None:
            params = (_GROUND_SPEED, w.speed_m_s, _NO_CHANGE, 0.0, 0.0, 0.0, 0.0)
            items.append(make_item(where, len(items), MavFrame.MISSION, Command.DO_CHANGE_SPEED, params))
        yaw_deg = NAN if w.yaw_rad is None else math.degrees(w.yaw_rad)
        free = (w.hold_s, w.accept_m, 0.0, yaw_deg)
        items.append(_placed(origin, where, len(items), Command.NAV_WAYPOINT, free, (w.x_m, w.y_m, w.depth_m)))
    if local.repeat is not None:
        if local.repeat.first_waypoint >= len(first_seq):
            raise PlanError(
                f"{name}: repeat.first_waypoint {local.repeat.first_waypoint} does not exist; "
                f"there are {len(first_seq)} waypoints, counted from 0"
            )
        target = float(first_seq[local.repeat.first_waypoint])
        params = (target, local.repeat.laps - 1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        items.append(make_item(f"{name}: repeat", len(items), MavFrame.MISSION, Command.DO_JUMP, params))
    if local.end.action != "hold":
        surface = local.end.action == "surface"
        command = Command.NAV_LAND if surface else Command.NAV_RETURN_TO_LAUNCH
        params = (0.0, 0.0, 0.0, NAN, 0.0, 0.0, 0.0)
        items.append(make_item(f"{name}: end", len(items), MavFrame.MISSION, command, params))
    return tuple(items)


def _fence(local: LocalPlan, origin: Origin, name: str) -> tuple[PlanItem, ...]:
    """Polygons, then circles: the order in which a .plan file gives them back."""
    items: list[PlanItem] = []
    for k, p in enumerate(local.fence.polygon):
        vertex = Command.FENCE_POLYGON_VERTEX_INCLUSION if p.inclusion else Command.FENCE_POLYGON_VERTEX_EXCLUSION
        for north, east in p.points_m:
            params = (float(len(p.points_m)), 0.0, 0.0, 0.0)
            where = f"{name}: fence.polygon[{k}]"
            items.append(_placed(origin, where, len(items), vertex, params, (north, east, 0.0), MavFrame.GLOBAL))
    for k, c in enumerate(local.fence.circle):
        command = Command.FENCE_CIRCLE_INCLUSION if c.inclusion else Command.FENCE_CIRCLE_EXCLUSION
        params = (c.radius_m, 0.0, 0.0, 0.0)
        where = f"{name}: fence.circle[{k}]"
        items.append(_placed(origin, where, len(items), command, params, (c.x_m, c.y_m, 0.0), MavFrame.GLOBAL))
    return tuple(items)
