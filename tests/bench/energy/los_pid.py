"""The usual way to fly a route: line of sight along the planner's way, and PID loops for speed, heading and depth.

The vehicle points at a place on the way a look-ahead distance in front of it; the integral of the cross-track error
moves that place against the drift (integral LOS, Fossen 2011, ch. 10). Near the goal it holds place and heading
with PID loops on both axes. Integrators stop while a thruster is at its limit.
"""

import math
from dataclasses import dataclass

import numpy as np

from autopilot.control.path.planner import Planner
from autopilot.core.control_allocator import ControlAllocator
from autopilot.core.frames import FloatArray, wrap_pi
from autopilot.core.geometry import Fence
from autopilot.core.messages import Goal, NavState
from autopilot.core.model4 import Model4

EXTRA_M = 0.05
"""The way keeps so much beyond the body radius: what the loops need."""

NEAR_M = 0.45
"""Closer than this to the goal place and heading are held."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LosGains:
    """The defaults were found by a coordinate search for least energy on B1 (factors 0.6 and 1.6 on each gain; flights
    that touched or were late refused)."""

    cruise_m_s: float = 0.3
    lookahead_m: float = 1.536
    speed_1_s: float = 2.4
    speed_integral_1_s2: float = 0.64
    yaw_1_s2: float = 4.0
    yaw_rate_1_s: float = 3.0
    yaw_integral_1_s3: float = 0.144
    place_1_s: float = 0.36
    """Speed asked for per metre to the goal."""
    track_1_s: float = 0.1
    """Growth of the correction of the cross-track error."""
    depth_1_s2: float = 0.216
    depth_rate_1_s: float = 1.2
    depth_integral_1_s3: float = 0.1
    across_1_s: float = 0.18
    """Sideways speed per metre of cross-track error."""


class LosPid:
    """Called every ``dt_s``."""

    def __init__(self, model: Model4, radius_m: float, gains: LosGains, dt_s: float = 0.05) -> None:
        self._model, self._radius_m, self._gains, self._dt_s = model, radius_m, gains, dt_s
        self._allocator, self._no_limit = ControlAllocator(model), np.full(model.thrusters, np.inf)
        self._goal: Goal | None = None
        self._planner: Planner | None = None
        self._integral = np.zeros(4)
        self._track = 0.0
        self._route = np.zeros((1, 2))

    def thrust(self, nav: NavState, goal: Goal, fence: Fence, limit_n: float) -> FloatArray:
        """(4,) [N] for the next interval."""
        gains, place = self._gains, np.asarray(nav.pos_ned_m[:2], dtype=float)
        if goal is not self._goal:
            self._goal = goal
            self._planner = self._planner or Planner(fence, self._radius_m + EXTRA_M)
            route = self._planner.path(place, goal.pos_ned_m[:2])
            self._route = np.stack([place, goal.pos_ned_m[:2]]) if route is None else route
            self._track = 0.0
        yaw, rate = float(nav.rpy_rad[2]), float(nav.rate_frd_rad_s[2])
        u, v, w = nav.vel_frd_m_s.tolist()
        distance = math.hypot(*(goal.pos_ned_m[:2] - place))
        error, ahead = self._sight(place)
        c, s = math.cos(yaw), math.sin(yaw)
        if distance < NEAR_M:
            aim = yaw if goal.yaw_rad is None else goal.yaw_rad
            demand = gains.place_1_s * (goal.pos_ned_m[:2] - place)
            demand_u, demand_v = c * demand[0] + s * demand[1], c * demand[1] - s * demand[0]
        else:
            self._track += gains.track_1_s * error * self._dt_s if abs(error) < 0.3 else 0.0
            self._track = max(-0.5, min(0.5, self._track))
            aim = ahead - math.atan2(error + self._track, gains.lookahead_m)
            turn = wrap_pi(aim - yaw)
            demand_u = gains.cruise_m_s * max(0.0, math.cos(turn)) ** 2
            demand_v = -gains.across_1_s * error * math.cos(ahead - yaw)
        errors = np.array([demand_u - u, demand_v - v, float(goal.pos_ned_m[2] - nav.pos_ned_m[2]), wrap_pi(aim - yaw)])
        proportional = np.array(
            [
                gains.speed_1_s * errors[0],
                gains.speed_1_s * errors[1],
                gains.depth_1_s2 * errors[2] - gains.depth_rate_1_s * w,
                gains.yaw_1_s2 * errors[3] - gains.yaw_rate_1_s * rate,
            ]
        )
        integral = np.array(
            [
                gains.speed_integral_1_s2,
                gains.speed_integral_1_s2,
                gains.depth_integral_1_s3,
                gains.yaw_integral_1_s3,
            ]
        )
        mass = np.array(self._model.mass_kg)
        wanted = self._allocator.thrust_n(mass * (proportional + self._integral), self._no_limit)
        if float(np.abs(wanted).max()) < limit_n:
            self._integral = np.clip(self._integral + integral * errors * self._dt_s, -0.6, 0.6)
        return np.clip(wanted, -limit_n, limit_n)

    def _sight(self, place: FloatArray) -> tuple[float, float]:
        """Cross-track error [m], positive to starboard of the way, and direction of the way [rad] there."""
        begin, step = self._route[:-1], np.diff(self._route, axis=0)
        length2 = np.maximum((step * step).sum(axis=1), 1e-12)
        fraction = np.clip(((place - begin) * step).sum(axis=1) / length2, 0.0, 1.0)
        off = place - (begin + fraction[:, None] * step)
        k = int((off * off).sum(axis=1).argmin())
        direction = math.atan2(step[k, 1], step[k, 0])
        # The next piece of the way counts when the look-ahead distance reaches into it.
        rest = (1.0 - fraction[k]) * math.sqrt(float(length2[k]))
        if rest < 0.5 * self._gains.lookahead_m and k + 1 < len(step):
            direction = math.atan2(step[k + 1, 1], step[k + 1, 0])
        error = -math.sin(direction) * off[k, 0] + math.cos(direction) * off[k, 1]
        return float(error), direction
