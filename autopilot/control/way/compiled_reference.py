"""References along a route, with the thrust that holds them, by the compiled library (``data/native/reference.c``).

A tenth of the time of :mod:`autopilot.control.way.reference`, which says what the numbers mean.
"""

import ctypes
from typing import Any

import numpy as np

from autopilot.control.nmpc.model_code import BUOYANCY, coefficients
from autopilot.control.way.reference import ReferenceTarget, Route
from autopilot.control.way.way_tuning import REFERENCE
from autopilot.core import compiled
from autopilot.core.frames import FloatArray
from autopilot.core.model4 import AXES, NX
from autopilot.core.sharing import Sharing

_DOUBLES = ("s0_m", "depth_m", "yaw_rad", "cruise_m_s", "speed_limit_m_s", "heave_limit_m_s", "yaw_rate_limit_rad_s")
_RULES = {
    "corner_ahead_m": REFERENCE.corner_ahead_m,
    "water_share": REFERENCE.water_speed_share,
    "upstream_share": REFERENCE.upstream_speed_share,
    "slow_current_share": REFERENCE.slow_current_share,
    "fast_current_share": REFERENCE.fast_current_share,
    "slowest_m_s": REFERENCE.slowest_m_s,
    "heave_share": REFERENCE.heave_share,
    "yaw_rate_share": REFERENCE.yaw_rate_share,
    "least_depth_time_s": REFERENCE.min_depth_time_s,
}
_DECELERATIONS = (
    REFERENCE.deceleration_m_s2,
    REFERENCE.heave_deceleration_m_s2,
    REFERENCE.yaw_deceleration_rad_s2,
)


class ReferenceStruct(compiled.Mirror):
    """The struct of reference.c."""

    _fields_ = (
        ("thrusters", ctypes.c_long),
        ("clipped", ctypes.c_long),
        ("coefficients", ctypes.c_void_p),
        ("inverse", ctypes.c_void_p),
        ("limit_n", ctypes.c_void_p),
    )


class March(compiled.Mirror):
    """The struct of reference.c."""

    _fields_ = (
        ("nodes", ctypes.c_long),
        ("legs", ctypes.c_long),
        *((name, ctypes.c_double) for name in (*_DOUBLES, *_RULES)),
        ("deceleration", ctypes.c_double * 3),
        *((name, ctypes.c_void_p) for name in ("t_s", "x0", "current", "s", "corner", "tangent", "x", "thrust")),
    )


STRUCTS = ReferenceStruct, March


class QuickMarch:
    """References of one grid of nodes."""

    def __init__(self, library: Any, sharing: Sharing, t_s: FloatArray) -> None:
        model, self._sharing = sharing.model, sharing
        nodes, thrusters = len(t_s), model.thrusters
        self._t_s = np.ascontiguousarray(t_s, dtype=float)
        self._x0, self._current, self._limit_n = np.zeros(NX), np.zeros(3), np.zeros(thrusters)
        self._x, self._thrust = np.zeros((nodes, NX)), np.zeros((nodes - 1, thrusters))
        self._coefficients = np.array(coefficients(model))
        self._inverse: FloatArray | None = None
        self._route: Route | None = None
        self._steady = ReferenceStruct(
            thrusters=thrusters,
            clipped=sharing.square,
            coefficients=self._coefficients.ctypes.data,
            limit_n=self._limit_n.ctypes.data,
        )
        self._march = March(
            nodes=nodes,
            **_RULES,
            deceleration=_DECELERATIONS,
            t_s=self._t_s.ctypes.data,
            x0=self._x0.ctypes.data,
            current=self._current.ctypes.data,
            x=self._x.ctypes.data,
            thrust=self._thrust.ctypes.data,
        )
        self._told = ctypes.byref(self._march), ctypes.byref(self._steady)
        self._call = library.march

    def __call__(
        self, x0: FloatArray, target: ReferenceTarget, current_ned_m_s: FloatArray, limit_n: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """References (N+1, 8) as of :func:`autopilot.control.way.reference.build_reference` from the state ``x0`` (8,),
        and thrust (N, n) within ``limit_n`` (n,) that holds their velocities."""
        march = self._march
        if target.route is not self._route:
            self._tell(target.route)
        self._tell_inverse(limit_n)
        self._x0[:], self._current[:], self._limit_n[:] = x0, current_ned_m_s, limit_n
        self._coefficients[BUOYANCY] = self._sharing.buoyancy_excess_n
        march.s0_m, march.depth_m, march.yaw_rad = target.s0_m, target.depth_m, target.yaw_rad
        march.cruise_m_s, march.speed_limit_m_s = target.cruise_m_s, target.speed_limit_m_s
        march.heave_limit_m_s, march.yaw_rate_limit_rad_s = target.heave_limit_m_s, target.yaw_rate_limit_rad_s
        beyond = self._call(*self._told)
        x = self._x.copy()
        return x, (self._sharing.hold_n(x[:-1, 4:], limit_n) if beyond else self._thrust.copy())

    def _tell(self, route: Route) -> None:
        corner, tangent, s = self._arrays = route.arrays()
        self._route, march = route, self._march
        march.legs, march.s = len(tangent), s.ctypes.data
        march.corner, march.tangent = corner.ctypes.data, tangent.ctypes.data

    def _tell_inverse(self, limit_n: FloatArray) -> None:
        """Which thrusters make a force depends on those that are alive."""
        inverse = self._sharing.linear(limit_n)
        if inverse is not self._inverse:
            self._steady.inverse = compiled.fitting("inverse", inverse, AXES, len(limit_n))
            self._inverse = inverse
