"""What the prediction is compared with: the goal as it is approached along the route, stage by stage."""

import ctypes
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from autopilot.control.way.way_tuning import REFERENCE
from autopilot.core import compiled
from autopilot.core.frames import FloatArray, unwrap_near, wrap_pi
from autopilot.core.model4 import NX, YAW, R, U, V, W, X, Y, Z

ComplexArray: TypeAlias = NDArray[np.complex128]


class Route:
    """A polyline with arc length, as complex numbers north + i east."""

    def __init__(self, points_ned_m: FloatArray) -> None:
        z = np.ascontiguousarray(points_ned_m, dtype=float).view(np.complex128)[:, 0]
        z = z[np.concatenate(([True], np.abs(np.diff(z)) > 1e-6))]
        if len(z) == 1:
            z = np.concatenate([z, z])
        length = np.abs(np.diff(z))
        self._corner = z
        self._s = np.concatenate(([0.0], np.cumsum(length)))
        self._tangent = np.diff(z) / np.maximum(length, 1e-9)
        self.length_m = float(self._s[-1])
        self.points = z.view(float).reshape(-1, 2).copy()
        """(m, 2)"""
        legs = (z[:-1].tolist(), self._tangent.tolist(), self._s[:-1].tolist(), length.tolist())
        self._legs: list[tuple[complex, complex, float, float]] = list(zip(*legs, strict=True))
        self._library, self._distance = compiled.library(), ctypes.c_double()
        self._table = (len(length), *(compiled.address(array) for array in self.arrays()))

    def arrays(self) -> tuple[ComplexArray, ComplexArray, FloatArray]:
        """Corners (m + 1,), unit tangents (m,) of the legs, arc lengths (m + 1,) of the corners, contiguous."""
        return self._corner, self._tangent, self._s

    def project(self, point: FloatArray, s_hint: float, window_m: float = 0.5) -> tuple[float, float]:
        """Arc length of the nearest point within a window round ``s_hint``, and the distance to it."""
        if self._library is not None:
            told = point.item(0), point.item(1), s_hint, window_m, ctypes.byref(self._distance)
            found_s: float = self._library.nearest_on_route(*self._table, *told)
            return found_s, self._distance.value
        p = complex(point[0], point[1])
        best_s, best = 0.0, math.inf
        first = max(0, int(self._s.searchsorted(s_hint - window_m)) - 1)
        for corner, tangent, s, length in self._legs[first:]:
            low, high = max(0.0, s_hint - window_m - s), min(length, s_hint + window_m - s)
            if low > high:
                break
            along = min(max(((p - corner) * tangent.conjugate()).real, low), high)
            distance = abs(p - corner - along * tangent)
            if distance < best:
                best_s, best = s + along, distance
        return best_s, best

    def at(self, s: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """Position and unit tangent (m,) at arc lengths (m,)."""
        leg = np.minimum(self._s[1:].searchsorted(s, side="right"), len(self._tangent) - 1)
        position: ComplexArray = np.interp(s, self._s, self._corner)
        tangent: ComplexArray = self._tangent[leg]
        return position, tangent

    def tangent(self, s: float) -> complex:
        """Unit tangent at one arc length; 0 for a route without length."""
        return self._legs[min(int(self._s[1:].searchsorted(s, side="right")), len(self._legs) - 1)][1]

    def point(self, s: float) -> complex:
        """Position at one arc length."""
        return complex(np.interp(s, self._s, self._corner))

    def ahead(self, here: FloatArray, s: float) -> FloatArray:
        """``here`` (2,) and the corners that are still to come (m, 2)."""
        rest = self.points[min(int(self._s.searchsorted(s + 1e-6, side="right")), len(self._s) - 1) :]
        result = np.empty((len(rest) + 1, 2))
        result[0], result[1:] = here, rest
        return result


def at_least(value: float, least: float) -> float:
    """The larger; NaN if either is, which max takes for the smaller."""
    return value if value > least or value != value else least


def at_most(value: float, most: float) -> float:
    """The smaller; NaN if either is."""
    return value if value < most or value != value else most


def approach(moves: Sequence[tuple[float, float, float]], t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Travel and speed (k, m) at times ``t_s`` (m,) of k points that move at a speed and stop after a distance.

    Each move is (distance, speed, deceleration), none negative, deceleration positive: v = sqrt(2 a d) at the end.
    """
    table = []
    for distance, speed, deceleration in moves:
        start = at_most(speed, math.sqrt(2.0 * deceleration * distance))
        brake_s = distance / start - 0.5 * start / deceleration if start != 0.0 else 0.0
        table.append((start, brake_s, deceleration, distance))
    start, brake_s, deceleration, distance = np.array(table).T[:, :, None]
    until_brake = brake_s - t_s
    now = np.minimum(np.maximum(until_brake * deceleration + start, 0.0), start)
    return distance - now * now / (2.0 * deceleration) - np.maximum(until_brake, 0.0) * start, now


def water_speed_share(against_m_s: float, water_limit_m_s: float) -> float:
    """Share of the limit on planar speed that is asked for with so much current against the way."""
    span = REFERENCE.fast_current_share - REFERENCE.slow_current_share
    against = (against_m_s / at_least(water_limit_m_s, 1e-6) - REFERENCE.slow_current_share) / span
    fast = at_most(at_least(against, 0.0), 1.0)
    return REFERENCE.water_speed_share + fast * (REFERENCE.upstream_speed_share - REFERENCE.water_speed_share)


def ground_speed(cruise_m_s: float, tangent: complex, current: complex, water_limit_m_s: float) -> float:
    """Speed along ``tangent`` that is asked for and that the limit on speed through the water allows."""
    along = (tangent.conjugate() * current).real
    room = along * along - abs(current) ** 2 + (water_speed_share(-along, water_limit_m_s) * water_limit_m_s) ** 2
    reachable = 0.0 if room <= 0.0 else along + math.sqrt(room)
    return at_least(at_most(cruise_m_s, reachable), REFERENCE.slowest_m_s)


def turn_target(yaw_rad: float, goal_yaw_rad: float, previous_rad: float | None) -> float:
    """The goal heading on the turn that is nearest.

    Where both ways round are about equal, the one that leads back towards the first turn is taken, because a tether
    winds up; a choice once made is kept.
    """
    nearest = unwrap_near(goal_yaw_rad, yaw_rad)
    other = nearest + math.copysign(2.0 * math.pi, yaw_rad - nearest)
    if abs(other - yaw_rad) < math.pi + REFERENCE.turn_tie_rad and abs(other) < abs(nearest):
        nearest = other
    if previous_rad is None or abs(wrap_pi(previous_rad - goal_yaw_rad)) > 1e-6:
        return nearest
    return previous_rad if abs(previous_rad - yaw_rad) < math.pi + REFERENCE.turn_hysteresis_rad else nearest


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ReferenceTarget:
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


def build_reference(
    t_s: FloatArray, x0: FloatArray, target: ReferenceTarget, current_ned_m_s: FloatArray
) -> FloatArray:
    """References (N+1, 8) at the times of the nodes.

    Position marches along the route at cruise speed over ground and stops at its end, depth arrives with it or as fast
    as heave allows, heading turns by the way given. Velocities are those through the water that this motion needs in
    the current, so that a goal in a current is a steady state of the reference and is held without offset.
    """
    route, rest = target.route, at_least(target.route.length_m - target.s0_m, 0.0)
    current = complex(current_ned_m_s[0], current_ned_m_s[1])
    tangent = route.tangent(target.s0_m + at_most(REFERENCE.corner_ahead_m, 0.5 * rest))
    speed = ground_speed(target.cruise_m_s, tangent, current, target.speed_limit_m_s)
    dz, turn = float(target.depth_m - x0[Z]), float(target.yaw_rad - x0[YAW])
    needed = at_least(abs(dz) / at_least(rest / speed, REFERENCE.min_depth_time_s), REFERENCE.slowest_m_s)
    climb = at_most(needed, REFERENCE.heave_share * target.heave_limit_m_s)
    turn_rate = REFERENCE.yaw_rate_share * target.yaw_rate_limit_rad_s
    moves = (
        (rest, speed, REFERENCE.deceleration_m_s2),
        (abs(dz), climb, REFERENCE.heave_deceleration_m_s2),
        (abs(turn), turn_rate, REFERENCE.yaw_deceleration_rad_s2),
    )
    travel, rate = approach(moves, t_s)

    ref = np.empty((len(t_s), NX))
    position, tangents = route.at(target.s0_m + travel[0])
    dz_sign, turn_sign = math.copysign(1.0, dz), math.copysign(1.0, turn)
    yaw = x0[YAW] + turn_sign * travel[2]
    water = (tangents * rate[0] - current) * np.exp(-1j * yaw)
    ref[:, X], ref[:, Y], ref[:, Z], ref[:, YAW] = position.real, position.imag, x0[Z] + dz_sign * travel[1], yaw
    ref[:, U], ref[:, V], ref[:, W] = water.real, water.imag, dz_sign * rate[1] - current_ned_m_s[2]
    ref[:, R] = turn_sign * rate[2]
    return ref


def climb_at_once(x: FloatArray, t_s: FloatArray, target: ReferenceTarget, current_down_m_s: float) -> None:
    """Let references (N+1, 8) change depth as fast as heave allows, and not so that they arrive with the route."""
    dz = target.depth_m - x.item(0, Z)
    travel, rate = approach(
        ((abs(dz), REFERENCE.heave_share * target.heave_limit_m_s, REFERENCE.heave_deceleration_m_s2),), t_s
    )
    x[:, Z] = x.item(0, Z) + math.copysign(1.0, dz) * travel[0]
    x[:, W] = math.copysign(1.0, dz) * rate[0] - current_down_m_s
