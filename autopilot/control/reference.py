"""What the prediction is compared with: the goal as it is approached along the route, stage by stage."""

import math
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from autopilot.core.frames import FloatArray, unwrap_near, wrap_pi
from autopilot.core.model4 import NX, YAW, R, U, V, W, X, Y, Z

ComplexArray: TypeAlias = NDArray[np.complex128]

DECELERATIONS = np.array([[0.12], [0.10], [0.4]])
"""Of the approach in the plane [m/s^2], in depth [m/s^2] and in heading [rad/s^2]: v = sqrt(2 a d)."""

YAW_RATE_SHARE = 0.55
"""Share of the yaw rate limit that a planned turn uses."""

HEAVE_SHARE = 0.6
"""Share of the heave limit that a planned change of depth uses."""

MIN_DEPTH_TIME_S = 1.0
TURN_AHEAD_M = 0.6
"""Free heading looks along the route this far ahead."""

CORNER_AHEAD_M = 0.2
"""The speed is chosen for the direction of the route this far ahead."""

WATER_SPEED_SHARE = 0.95
"""Share of the planar speed limit that the reference asks for."""

SLOWEST_M_S = 0.02

TURN_HYSTERESIS_RAD = 0.5
"""A half turn keeps its direction until the other way is shorter by this much."""


class Route:
    """A polyline with arc length, as complex numbers north + i east."""

    def __init__(self, points_ned_m: FloatArray) -> None:
        z = np.ascontiguousarray(points_ned_m, dtype=float).view(complex)[:, 0]
        z = z[np.concatenate(([True], np.abs(np.diff(z)) > 1e-6))]
        if len(z) == 1:
            z = np.concatenate([z, z])
        length = np.abs(np.diff(z))
        self._start, self._s = z[0], np.concatenate(([0.0], np.cumsum(length)))
        self._length = length
        self._tangent = np.diff(z) / np.maximum(length, 1e-9)
        self.length_m = float(self._s[-1])
        self.points = z.view(float).reshape(-1, 2).copy()
        """(m, 2)"""
        self._legs = list(
            zip(z[:-1].tolist(), self._tangent.tolist(), self._s[:-1].tolist(), length.tolist(), strict=True)
        )

    def project(self, point: FloatArray, s_hint: float, window_m: float = 1.0) -> tuple[float, float]:
        """Arc length of the nearest point within a window round ``s_hint``, and the distance to it."""
        p = complex(point[0], point[1])
        best_s, best = 0.0, math.inf
        for corner, tangent, s, length in self._legs:
            low, high = max(0.0, s_hint - window_m - s), min(length, s_hint + window_m - s)
            if low > high:
                continue
            along = min(max(((p - corner) * tangent.conjugate()).real, low), high)
            distance = abs(p - corner - along * tangent)
            if distance < best:
                best_s, best = s + along, distance
        return best_s, best

    def at(self, s: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """Position and unit tangent (m,) at arc lengths (m,)."""
        position = self._start + np.minimum(np.maximum(s[:, None] - self._s[:-1], 0.0), self._length) @ self._tangent
        leg = np.minimum(self._s[1:].searchsorted(s, side="right"), len(self._length) - 1)
        return position, self._tangent[leg]

    def tangent(self, s: float) -> complex:
        """Unit tangent at one arc length; 0 for a route without length."""
        for _, tangent, start, length in self._legs:
            if s < start + length:
                return complex(tangent)
        return complex(self._legs[-1][1])

    def point(self, s: float) -> complex:
        """Position at one arc length."""
        for corner, tangent, start, length in self._legs:
            if s <= start + length:
                return complex(corner + (s - start) * tangent)
        return complex(self.points[-1, 0], self.points[-1, 1])

    def ahead(self, here: FloatArray, s: float) -> FloatArray:
        """``here`` (2,) and the corners that are still to come (m, 2)."""
        first = min(int(self._s.searchsorted(s + 1e-6, side="right")), len(self._s) - 1)
        result: FloatArray = np.vstack((here, self.points[first:]))
        return result


def approach(
    distance: FloatArray, speed: FloatArray, deceleration: FloatArray, t_s: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Travel and speed (k, m) at times ``t_s`` (m,) of points that move at ``speed`` (k, 1) and stop after ``distance``.

    All arguments but the time are (k, 1) and not negative, deceleration is positive.
    """
    start = np.minimum(speed, np.sqrt(2.0 * deceleration * distance))
    braking = start * start / (2.0 * deceleration)
    t_brake = (distance - braking) / np.maximum(start, 1e-9)
    until_brake = np.maximum(t_brake - t_s, 0.0)
    now = np.minimum(np.maximum(t_brake * deceleration + start - deceleration * t_s, 0.0), start)
    return distance - now * now / (2.0 * deceleration) - until_brake * start, now


def ground_speed(cruise_m_s: float, tangent: complex, current: complex, water_limit_m_s: float) -> float:
    """Speed along ``tangent`` that is asked for and that the limit on speed through the water allows."""
    along = (tangent.conjugate() * current).real
    room = along * along - abs(current) ** 2 + (WATER_SPEED_SHARE * water_limit_m_s) ** 2
    reachable = along + math.sqrt(room) if room > 0.0 else 0.0
    return max(SLOWEST_M_S, min(cruise_m_s, reachable))


def turn_target(yaw_rad: float, goal_yaw_rad: float, previous_rad: float | None) -> float:
    """The goal heading on the turn that is nearest; a choice once made is kept while the two ways are about equal."""
    nearest = unwrap_near(goal_yaw_rad, yaw_rad)
    if previous_rad is None or abs(wrap_pi(previous_rad - goal_yaw_rad)) > 1e-6:
        return nearest
    return previous_rad if abs(previous_rad - yaw_rad) < math.pi + TURN_HYSTERESIS_RAD else nearest


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Target:
    """Where the reference goes and how fast."""

    route: Route
    s0_m: float
    """Arc length at which the vehicle is."""
    depth_m: float
    yaw_rad: float
    """On the turn by which it is to be reached."""
    cruise_m_s: float
    speed_limit_m_s: float
    heave_limit_m_s: float
    yaw_rate_limit_rad_s: float


def build_reference(t_s: FloatArray, x0: FloatArray, target: Target, current_ned_m_s: FloatArray) -> FloatArray:
    """References (N+1, 8) at the times of the nodes.

    Position marches along the route at cruise speed over ground and stops at its end, depth arrives with it or as fast
    as heave allows, heading turns by the way given. Velocities are those through the water that this motion needs in the
    current, so that a goal in a current is a steady state of the reference and is held without offset.
    """
    route, rest = target.route, max(0.0, target.route.length_m - target.s0_m)
    current = complex(current_ned_m_s[0], current_ned_m_s[1])
    tangent = route.tangent(target.s0_m + min(CORNER_AHEAD_M, 0.5 * rest))
    speed = ground_speed(target.cruise_m_s, tangent, current, target.speed_limit_m_s)
    dz, turn = float(target.depth_m - x0[Z]), float(target.yaw_rad - x0[YAW])
    climb = min(HEAVE_SHARE * target.heave_limit_m_s, max(abs(dz) / max(rest / speed, MIN_DEPTH_TIME_S), SLOWEST_M_S))
    distance = np.array([[rest], [abs(dz)], [abs(turn)]])
    speeds = np.array([[speed], [climb], [YAW_RATE_SHARE * target.yaw_rate_limit_rad_s]])
    travel, rate = approach(distance, speeds, DECELERATIONS, t_s)

    ref = np.empty((len(t_s), NX))
    position, tangents = route.at(target.s0_m + travel[0])
    dz_sign, turn_sign = math.copysign(1.0, dz), math.copysign(1.0, turn)
    yaw = x0[YAW] + turn_sign * travel[2]
    water = (tangents * rate[0] - current) * np.exp(-1j * yaw)
    ref[:, X], ref[:, Y], ref[:, Z], ref[:, YAW] = position.real, position.imag, x0[Z] + dz_sign * travel[1], yaw
    ref[:, U], ref[:, V], ref[:, W] = water.real, water.imag, dz_sign * rate[1] - current_ned_m_s[2]
    ref[:, R] = turn_sign * rate[2]
    return ref
