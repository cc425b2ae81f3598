"""Plans for tests, in local metres."""

import math
from collections.abc import Sequence

import numpy as np

from autopilot.core.geodesy import Origin
from autopilot.core.messages import NavHealth, NavState
from autopilot.core.params import ParamSet
from autopilot.core.plan import PlanItem
from autopilot.mission.items import Command, MavFrame
from autopilot.mission.validation import PlanContext

ORIGIN = Origin(lat_deg=37.9755, lon_deg=23.7790)
RADIUS_M = 0.3
NAN = math.nan


def context(**overrides: float) -> PlanContext:
    params = ParamSet(overrides)
    return PlanContext(origin=ORIGIN, params=params, radius_m=RADIUS_M, goal_margin_m=params["MPC_MARGIN"])


def local(seq: int, command: int, x: float, y: float, z: float = 0.0, p: Sequence[float] = (0, 0, 0, NAN)) -> PlanItem:
    return PlanItem(
        seq=seq,
        frame=MavFrame.LOCAL_NED,
        command=command,
        param1=p[0],
        param2=p[1],
        param3=p[2],
        param4=p[3],
        x=round(x * 1e4),
        y=round(y * 1e4),
        z=z,
    )


def waypoint(seq: int, x: float, y: float, depth: float = 0.5, yaw_deg: float = NAN, hold_s: float = 0.0) -> PlanItem:
    return local(seq, Command.NAV_WAYPOINT, x, y, depth, (hold_s, 0.0, 0.0, yaw_deg))


def plain(seq: int, command: int, *p: float) -> PlanItem:
    p1, p2, p3, p4 = (*p, *(0.0,) * (4 - len(p)))
    return PlanItem(seq=seq, frame=MavFrame.MISSION, command=command, param1=p1, param2=p2, param3=p3, param4=p4, z=NAN)


def circle(seq: int, x: float, y: float, radius: float, inclusion: bool = False) -> PlanItem:
    command = Command.FENCE_CIRCLE_INCLUSION if inclusion else Command.FENCE_CIRCLE_EXCLUSION
    return local(seq, command, x, y, 0.0, (radius, 0, 0, 0))


def polygon(seq: int, points: Sequence[tuple[float, float]], inclusion: bool = False) -> list[PlanItem]:
    command = Command.FENCE_POLYGON_VERTEX_INCLUSION if inclusion else Command.FENCE_POLYGON_VERTEX_EXCLUSION
    return [local(seq + k, command, x, y, 0.0, (len(points), 0, 0, 0)) for k, (x, y) in enumerate(points)]


def box(seq: int, north: float, east: float, half_north: float, half_east: float, inclusion: bool) -> list[PlanItem]:
    corners = [(-1, -1), (1, -1), (1, 1), (-1, 1)]
    return polygon(seq, [(north + a * half_north, east + b * half_east) for a, b in corners], inclusion)


def tank(seq: int = 0) -> list[PlanItem]:
    return box(seq, 0.0, 0.0, 2.5, 1.5, inclusion=True)


def nav(x: float, y: float, z: float, yaw: float = 0.0, t_us: int = 0, health: NavHealth = NavHealth.GOOD) -> NavState:
    zero = np.zeros(3)
    return NavState(
        t_us=t_us,
        health=health,
        pos_ned_m=np.array([x, y, z], dtype=np.float64),
        rpy_rad=np.array([0.0, 0.0, yaw]),
        vel_frd_m_s=zero,
        vel_water_frd_m_s=zero,
        rate_frd_rad_s=zero,
        current_ned_m_s=zero,
        variance=np.zeros(12),
    )
