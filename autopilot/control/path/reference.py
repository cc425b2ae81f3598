"""Reference of the prediction: state per node along the route to the goal, and the thrust that holds it
(``data/native/reference.c``).
"""

import ctypes
import math
from dataclasses import dataclass

import numpy as np

from autopilot.control.nmpc.model_code import BUOYANCY, coefficients
from autopilot.control.path.path_tuning import REFERENCE
from autopilot.core import compiled
from autopilot.core.control_allocator import ControlAllocator
from autopilot.core.frames import FloatArray, unwrap_near, wrap_pi
from autopilot.core.model4 import AXES, NX
from autopilot.core.params import ParamSet


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
        self._nearest, self._distance = compiled.load().nearest_on_route, ctypes.c_double()
        self.table = (len(length), *(compiled.address(array) for array in (self._corner, self._tangent, self._s)))
        """Number of legs; addresses of corners (m + 1,), unit tangents of the legs (m,) and arc lengths of the corners
        (m + 1,), which live as long as the route."""

    def project(self, point: FloatArray, s_hint: float, window_m: float = 0.5) -> tuple[float, float]:
        """Arc length of the nearest point within a window round ``s_hint``, and the distance to it."""
        place = point.item(0), point.item(1), s_hint, window_m, ctypes.byref(self._distance)
        found_s: float = self._nearest(*self.table, *place)
        return found_s, self._distance.value

    def point(self, s: float) -> complex:
        return complex(np.interp(s, self._s, self._corner))

    def ahead(self, here: FloatArray, s: float) -> FloatArray:
        """``here`` (2,) and the corners that are still to come (m, 2)."""
        rest = self.points[min(int(self._s.searchsorted(s + 1e-6, side="right")), len(self._s) - 1) :]
        result = np.empty((len(rest) + 1, 2))
        result[0], result[1:] = here, rest
        return result


def unknown_speed_m_s(params: ParamSet) -> float:
    """Planar speed margin [m/s] while drag is unknown: a wrong ratio of drag to thrust falsifies the speed through the
    water by a share of it, so beyond 0.5 m/s MPC_SPEED_MARGIN grows with the limit."""
    return params["MPC_SPEED_MARGIN"] * max(1.0, params["SPD_PLANAR_MAX"] / REFERENCE.margin_at_m_s)


def water_speed_fraction(against_m_s: float, water_limit_m_s: float) -> float:
    """Fraction of the planar speed limit that is commanded in that opposing current."""
    span = REFERENCE.fast_current_fraction - REFERENCE.slow_current_fraction
    fast = (against_m_s / max(water_limit_m_s, 1e-6) - REFERENCE.slow_current_fraction) / span
    return REFERENCE.water_speed_fraction + min(max(fast, 0.0), 1.0) * (
        REFERENCE.upstream_speed_fraction - REFERENCE.water_speed_fraction
    )


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
    """Target and speed of the reference."""

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
    climb_at_once: bool = False
    """Depth changes as fast as heave allows, and not so that it arrives with the route."""


_DOUBLES = ("s0_m", "depth_m", "yaw_rad", "cruise_m_s", "speed_limit_m_s", "heave_limit_m_s", "yaw_rate_limit_rad_s")
_RULES = {
    "corner_ahead_m": REFERENCE.corner_ahead_m,
    "water_share": REFERENCE.water_speed_fraction,
    "upstream_share": REFERENCE.upstream_speed_fraction,
    "slow_current_share": REFERENCE.slow_current_fraction,
    "fast_current_share": REFERENCE.fast_current_fraction,
    "slowest_m_s": REFERENCE.slowest_m_s,
    "heave_share": REFERENCE.heave_fraction,
    "yaw_rate_share": REFERENCE.yaw_rate_fraction,
    "least_depth_time_s": REFERENCE.min_depth_time_s,
}
_DECELERATIONS = (
    REFERENCE.deceleration_m_s2,
    REFERENCE.heave_deceleration_m_s2,
    REFERENCE.yaw_deceleration_rad_s2,
)


class ReferenceStruct(compiled.Mirror):
    """ctypes layout of the struct in reference.c."""

    _fields_ = (
        ("thrusters", ctypes.c_long),
        ("clipped", ctypes.c_long),
        ("coefficients", ctypes.c_void_p),
        ("inverse", ctypes.c_void_p),
        ("limit_n", ctypes.c_void_p),
    )


class RolloutArguments(compiled.Mirror):
    """ctypes layout of the struct in reference.c."""

    _fields_ = (
        ("nodes", ctypes.c_long),
        ("legs", ctypes.c_long),
        ("climb_at_once", ctypes.c_long),
        *((name, ctypes.c_double) for name in (*_DOUBLES, *_RULES)),
        ("deceleration", ctypes.c_double * 3),
        *((name, ctypes.c_void_p) for name in ("t_s", "x0", "current", "s", "corner", "tangent", "x", "thrust")),
    )


class ReferenceRollout:
    """References of one grid of nodes."""

    def __init__(self, allocator: ControlAllocator, t_s: FloatArray) -> None:
        model, self._allocator = allocator.model, allocator
        nodes, thrusters = len(t_s), model.thrusters
        self._t_s = np.ascontiguousarray(t_s, dtype=float)
        self._x0, self._current, self._limit_n = np.zeros(NX), np.zeros(3), np.zeros(thrusters)
        self._x, self._thrust = np.zeros((nodes, NX)), np.zeros((nodes - 1, thrusters))
        self._coefficients = np.array(coefficients(model))
        self._inverse: FloatArray | None = None
        self._route: Route | None = None
        self._steady = ReferenceStruct(
            thrusters=thrusters,
            clipped=allocator.square,
            coefficients=self._coefficients.ctypes.data,
            limit_n=self._limit_n.ctypes.data,
        )
        self._rollout = RolloutArguments(
            nodes=nodes,
            **_RULES,
            deceleration=_DECELERATIONS,
            t_s=self._t_s.ctypes.data,
            x0=self._x0.ctypes.data,
            current=self._current.ctypes.data,
            x=self._x.ctypes.data,
            thrust=self._thrust.ctypes.data,
        )
        self._structs = ctypes.byref(self._rollout), ctypes.byref(self._steady)
        self._call = compiled.load(ReferenceStruct, RolloutArguments).rollout

    def __call__(
        self, x0: FloatArray, target: ReferenceTarget, current_ned_m_s: FloatArray, limit_n: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """References (N+1, 8) from the state ``x0`` (8,), and thrust (N, n) within ``limit_n`` (n,) that holds their
        velocities.

        Position moves along the route at cruise speed over ground and stops at its end, depth arrives with it or at
        the heave limit, heading turns in the given direction. Velocities are relative to the water, as this motion
        needs in the current, so that a goal in a current is a steady state of the reference and is held without
        offset.
        """
        rollout = self._rollout
        if target.route is not self._route:
            self._route = target.route
            rollout.legs, rollout.corner, rollout.tangent, rollout.s = target.route.table
        inverse = self._allocator.linear(limit_n)
        if inverse is not self._inverse:  # which thrusters make a force depends on those that are alive
            self._steady.inverse = compiled.fitting("inverse", inverse, AXES, len(limit_n))
            self._inverse = inverse
        self._x0[:], self._current[:], self._limit_n[:] = x0, current_ned_m_s, limit_n
        self._coefficients[BUOYANCY] = self._allocator.buoyancy_excess_n
        rollout.s0_m, rollout.depth_m, rollout.yaw_rad = target.s0_m, target.depth_m, target.yaw_rad
        rollout.cruise_m_s, rollout.speed_limit_m_s = target.cruise_m_s, target.speed_limit_m_s
        rollout.heave_limit_m_s, rollout.yaw_rate_limit_rad_s = target.heave_limit_m_s, target.yaw_rate_limit_rad_s
        rollout.climb_at_once = target.climb_at_once
        beyond = self._call(*self._structs)
        x = self._x.copy()
        return x, (self._allocator.hold_n(x[:-1, 4:], limit_n) if beyond else self._thrust.copy())
