"""Inner loop between optimiser steps: tracks the last plan with the ancillary feedback, once per tick.

The plan starts one thruster lag ahead of now (:mod:`autopilot.control.nmpc.lag`); the state is predicted to the same
time for the comparison.
"""

import ctypes
import math

import numpy as np

from autopilot.control.nmpc.grid import TimeGrid
from autopilot.control.robust.ancillary import SURGES_M_S, Ancillary
from autopilot.control.robust.error_model import error_of
from autopilot.core import compiled
from autopilot.core.frames import FloatArray
from autopilot.core.model4 import NX, YAW, U, V, W


class _Inner(compiled.Mirror):
    """ctypes layout of the struct in follow.c."""

    _fields_ = (
        ("n", ctypes.c_long),
        ("thrusters", ctypes.c_long),
        ("surges", ctypes.c_long),
        ("first_m_s", ctypes.c_double),
        ("step_m_s", ctypes.c_double),
        *((name, ctypes.c_void_p) for name in ("t_s", "gains", "plan", "plan_thrust", "x", "current")),
        *((name, ctypes.c_void_p) for name in ("planned_current", "limit_n", "thrust")),
    )


class InnerLoop:
    """Thrust at any time of a plan: the plan's, and the ancillary feedback of the error. Gains are those of the plan's
    surge; of its first two intervals those of its begin."""

    def __init__(self, ancillary: Ancillary, grid: TimeGrid) -> None:
        surges, thrusters, _ = ancillary.gains.shape
        self._begin_us = 0
        self.active = False
        """There is a plan to follow."""
        self._plan, self._plan_n, self._plan_current = (
            np.zeros((grid.n + 1, NX)),
            np.zeros((grid.n, thrusters)),
            np.zeros(3),
        )
        self._x, self._current = np.zeros(NX), np.zeros(3)
        self._limit_n, self._thrust_n = np.zeros(thrusters), np.zeros(thrusters)
        self._gains, self._t_s = np.ascontiguousarray(ancillary.gains), np.ascontiguousarray(grid.t_s)
        self._struct = _Inner(
            n=grid.n,
            thrusters=thrusters,
            surges=surges,
            first_m_s=float(SURGES_M_S[0]),
            step_m_s=float(SURGES_M_S[1] - SURGES_M_S[0]),
            t_s=compiled.fitting("t_s", self._t_s, grid.n + 1),
            gains=compiled.fitting("gains", self._gains, surges, thrusters, NX),
            plan=self._plan.ctypes.data,
            plan_thrust=self._plan_n.ctypes.data,
            x=self._x.ctypes.data,
            current=self._current.ctypes.data,
            planned_current=self._plan_current.ctypes.data,
            limit_n=self._limit_n.ctypes.data,
            thrust=self._thrust_n.ctypes.data,
        )
        self._reference, self._call = ctypes.byref(self._struct), compiled.load(_Inner).inner_thrust

    def start(self, t_us: int, x: FloatArray, thrust_n: FloatArray, current_ned_m_s: FloatArray) -> None:
        """Track the plan x (N+1, 8), thrust (N, n) that starts now and was made for this current (3,)."""
        self._plan[:], self._plan_n[:], self._plan_current[:] = x, thrust_n, current_ned_m_s
        self._begin_us, self.active = t_us, True

    def stop(self) -> None:
        """There is no plan any more."""
        self.active = False

    def thrust(self, t_us: int, x: FloatArray, current_ned_m_s: FloatArray, limit_n: FloatArray) -> FloatArray:
        """Thrust (n,) for the state ``x`` (8,), cut to ``limit_n`` (n,)."""
        self._x[:], self._current[:], self._limit_n[:] = x, current_ned_m_s, limit_n
        self._call(self._reference, (t_us - self._begin_us) * 1e-6)
        return self._thrust_n.copy()


def plan_error(x: FloatArray, z: FloatArray, current_ned_m_s: FloatArray, planned_ned_m_s: FloatArray) -> FloatArray:
    """Error (8,) of ``x`` relative to the planned ``z``, velocities over ground: a change of the estimated current
    between the two is not a motion.
    """
    e = error_of(x, z)
    north, east, down = (current_ned_m_s - planned_ned_m_s).tolist()
    c, s = math.cos(x[YAW]), math.sin(x[YAW])
    e[U] += c * north + s * east
    e[V] += c * east - s * north
    e[W] += down
    return e
