"""What the prediction is compared with: the goal as it is approached along the route, stage by stage."""

import math

import numpy as np

from autopilot.core.frames import FloatArray, unwrap_near, wrap_pi
from autopilot.core.model4 import NX, YAW, R, U, V, W, X, Y, Z

DECELERATION_M_S2 = 0.12
"""Approach to the goal: v = sqrt(2 a d)."""

YAW_RATE_SHARE = 0.55
"""Share of the yaw rate limit that a planned turn uses."""

YAW_DECELERATION_RAD_S2 = 0.4
HEAVE_SHARE = 0.6
"""Share of the heave limit that a planned change of depth uses."""

MIN_DEPTH_TIME_S = 1.0
TURN_AHEAD_M = 0.6
"""Free heading looks along the route this far ahead."""

WATER_SPEED_SHARE = 0.95
"""Share of the planar speed limit that the reference asks for."""

SLOWEST_M_S = 0.02

TURN_HYSTERESIS_RAD = 0.5
"""A half turn keeps its direction until the other way is shorter by this much."""


class Route:
    """A polyline with arc length."""

    def __init__(self, points_ned_m: FloatArray) -> None:
        steps = np.diff(points_ned_m, axis=0)
        lengths = np.hypot(steps[:, 0], steps[:, 1])
        keep = np.concatenate(([True], lengths > 1e-6))
        self.points = points_ned_m[keep]
        self._steps = np.diff(self.points, axis=0)
        self._lengths = np.hypot(self._steps[:, 0], self._steps[:, 1])
        self.s = np.concatenate(([0.0], np.cumsum(self._lengths)))
        self._tangents = self._steps / self._lengths[:, None] if len(self._lengths) else np.zeros((0, 2))
        self._px, self._py = self.points[:, 0].copy(), self.points[:, 1].copy()

    @property
    def length_m(self) -> float:
        """Total length."""
        return float(self.s[-1])

    def project(self, point: FloatArray, s_hint: float, window_m: float = 1.0) -> tuple[float, float]:
        """Arc length of the nearest point within a window round ``s_hint``, and the distance to it."""
        if len(self._lengths) == 0:
            return 0.0, math.hypot(point[0] - self._px[0], point[1] - self._py[0])
        low, high = max(0.0, s_hint - window_m), min(self.length_m, s_hint + window_m)
        along = ((point - self.points[:-1]) * self._tangents).sum(axis=1)
        s = np.clip(self.s[:-1] + np.clip(along, 0.0, self._lengths), low, high)
        x, y = np.interp(s, self.s, self._px), np.interp(s, self.s, self._py)
        d2 = (x - point[0]) ** 2 + (y - point[1]) ** 2
        k = int(d2.argmin())
        return float(s[k]), math.sqrt(d2[k])

    def at(self, s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """x, y, tangent north, tangent east at arc lengths (m,)."""
        if len(self._lengths) == 0:
            one = np.ones_like(s)
            return one * self._px[0], one * self._py[0], 0.0 * one, 0.0 * one
        k = np.minimum(np.searchsorted(self.s, s, side="right"), len(self._lengths)) - 1
        k = np.maximum(k, 0)
        tangents = self._tangents[k]
        rest = s - self.s[k]
        tx, ty = tangents[:, 0], tangents[:, 1]
        return self._px[k] + rest * tx, self._py[k] + rest * ty, tx, ty

    def ahead(self, s: float) -> FloatArray:
        """The rest of the route (m, 2) from arc length ``s``."""
        x, y, _, _ = self.at(np.array([s]))
        later = self.points[self.s > s + 1e-6]
        first = np.array([[x[0], y[0]]])
        return np.concatenate([first, later]) if len(later) else np.concatenate([first, self.points[-1:]])


def approach(distance: float, speed: float, deceleration: float, t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Travel (m,) and speed (m,) at times ``t_s`` of a point that moves at ``speed`` and stops after ``distance``."""
    if distance <= 0.0:
        return np.zeros_like(t_s), np.zeros_like(t_s)
    speed = min(speed, math.sqrt(2.0 * deceleration * distance))
    braking = 0.5 * speed * speed / deceleration
    t_brake = (distance - braking) / speed
    rest = np.maximum(t_brake + speed / deceleration - t_s, 0.0)
    cruising = t_s < t_brake
    travel = np.where(cruising, speed * t_s, distance - 0.5 * deceleration * rest * rest)
    return travel, np.where(cruising, speed, deceleration * rest)


def ground_speed(cruise_m_s: float, tangent: tuple[float, float], current: FloatArray, water_limit_m_s: float) -> float:
    """Speed along ``tangent`` that is asked for and that the limit on speed through the water allows."""
    along = tangent[0] * current[0] + tangent[1] * current[1]
    room = along * along - current[0] ** 2 - current[1] ** 2 + (WATER_SPEED_SHARE * water_limit_m_s) ** 2
    reachable = along + math.sqrt(room) if room > 0.0 else 0.0
    return max(SLOWEST_M_S, min(cruise_m_s, reachable))


def turn_target(yaw_rad: float, goal_yaw_rad: float, previous_rad: float | None) -> float:
    """The goal heading on the turn that is nearest; a choice once made is kept while the two ways are about equal."""
    nearest = unwrap_near(goal_yaw_rad, yaw_rad)
    if previous_rad is None or abs(wrap_pi(previous_rad - goal_yaw_rad)) > 1e-6:
        return nearest
    return previous_rad if abs(previous_rad - yaw_rad) < math.pi + TURN_HYSTERESIS_RAD else nearest


def build_reference(
    *,
    t_s: FloatArray,
    x0: FloatArray,
    route: Route,
    s0: float,
    depth_m: float,
    yaw_target_rad: float,
    cruise_m_s: float,
    current_ned_m_s: FloatArray,
    speed_limit_m_s: float,
    heave_limit_m_s: float,
    yaw_rate_limit_rad_s: float,
) -> FloatArray:
    """References (N+1, 8) at the times of the nodes.

    Position marches along the route at cruise speed over ground and stops at its end, depth arrives with it or as fast as
    heave allows, heading turns by the way given. Velocities are those through the water that this motion needs in the
    current, so that a goal in a current is a steady state of the reference and is held without offset.
    """
    rest = route.length_m - s0
    _, _, tx, ty = route.at(np.array([s0 + min(0.2, 0.5 * rest)]))
    speed = ground_speed(cruise_m_s, (float(tx[0]), float(ty[0])), current_ned_m_s, speed_limit_m_s)
    travel, along = approach(rest, speed, DECELERATION_M_S2, t_s)
    ref = np.empty((len(t_s), NX))
    ref[:, X], ref[:, Y], tangent_n, tangent_e = route.at(s0 + travel)

    dz = depth_m - x0[Z]
    climb = min(HEAVE_SHARE * heave_limit_m_s, abs(dz) / max(MIN_DEPTH_TIME_S, rest / speed))
    climb = max(climb, min(HEAVE_SHARE * heave_limit_m_s, abs(dz) / MIN_DEPTH_TIME_S) if rest < 0.1 else 0.0)
    done = np.minimum(climb * t_s, abs(dz))
    sign = 1.0 if dz >= 0.0 else -1.0
    ref[:, Z] = x0[Z] + sign * done
    heave = np.where(done < abs(dz), sign * climb, 0.0)

    turn = yaw_target_rad - x0[YAW]
    turned, rate = approach(abs(turn), YAW_RATE_SHARE * yaw_rate_limit_rad_s, YAW_DECELERATION_RAD_S2, t_s)
    sign = 1.0 if turn >= 0.0 else -1.0
    yaw = x0[YAW] + sign * turned
    ref[:, YAW], ref[:, R] = yaw, sign * rate

    water_n = tangent_n * along - current_ned_m_s[0]
    water_e = tangent_e * along - current_ned_m_s[1]
    cos, sin = np.cos(yaw), np.sin(yaw)
    ref[:, U], ref[:, V] = cos * water_n + sin * water_e, cos * water_e - sin * water_n
    ref[:, W] = heave - current_ned_m_s[2]
    return ref
