"""The loop between optimiser steps: follows the last plan with the ancillary feedback, once per tick.

The plan begins one thruster lag ahead of now (:mod:`autopilot.control.nmpc.lag`); so does the state it is compared
with.
"""

import ctypes
import math
from typing import Any

import numpy as np

from autopilot.control.nmpc.grid import TimeGrid
from autopilot.control.robust.ancillary import SURGES_M_S, Ancillary
from autopilot.control.robust.error_model import error_of
from autopilot.core import compiled
from autopilot.core.frames import FloatArray
from autopilot.core.model4 import NX, YAW, U, V, W


class InnerLoop:
    """Thrust at any time of a plan."""

    def __init__(self, ancillary: Ancillary, grid: TimeGrid) -> None:
        self._ancillary, self._grid = ancillary, grid
        thrusters = ancillary.gains.shape[1]
        self._t_s = grid.t_s.tolist()
        self._x, self._u = np.zeros((grid.n + 1, NX)), np.zeros((grid.n, thrusters))
        self._k = np.zeros((thrusters, NX))
        self._current = np.zeros(3)
        self._begin_us = 0
        self.active = False
        """There is a plan to follow."""
        library = compiled.library(_Inner)
        self._quick = (
            None if library is None else _CompiledThrust(library, ancillary, grid, self._x, self._u, self._current)
        )

    def start(self, t_us: int, x: FloatArray, thrust_n: FloatArray, current_ned_m_s: FloatArray) -> None:
        """Follow the plan x (N+1, 8), thrust (N, n) that begins now and believes in this current (3,)."""
        self._x[:], self._u[:], self._current[:] = x, thrust_n, current_ned_m_s
        if self._quick is None:
            self._k = self._ancillary.gain(float(x[0, U]))
        self._begin_us, self.active = t_us, True

    def stop(self) -> None:
        """There is no plan any more."""
        self.active = False

    def thrust(self, t_us: int, x: FloatArray, current_ned_m_s: FloatArray, limit_n: FloatArray) -> FloatArray:
        """Thrust (n,) for the state ``x`` (8,), cut to ``limit_n`` (n,)."""
        if self._quick is not None:
            return self._quick.thrust((t_us - self._begin_us) * 1e-6, x, current_ned_m_s, limit_n)
        after_s = min(max((t_us - self._begin_us) * 1e-6, 0.0), self._t_s[-1])
        k = 0
        while after_s > self._t_s[k + 1]:
            k += 1
        share = (after_s - self._t_s[k]) / (self._t_s[k + 1] - self._t_s[k])
        z = self._x[k] + share * (self._x[k + 1] - self._x[k])
        gain = self._k if k < 2 else self._ancillary.gain(float(z[U]))
        thrust = self._u[k] + gain @ plan_error(x, z, current_ned_m_s, self._current)
        result: FloatArray = np.minimum(np.maximum(thrust, -limit_n), limit_n)
        return result


class _Inner(compiled.Mirror):
    """The struct of follow.c."""

    _fields_ = (
        ("n", ctypes.c_long),
        ("thrusters", ctypes.c_long),
        ("surges", ctypes.c_long),
        ("first_m_s", ctypes.c_double),
        ("step_m_s", ctypes.c_double),
        *((name, ctypes.c_void_p) for name in ("t_s", "gains", "plan", "plan_thrust", "x", "current")),
        *((name, ctypes.c_void_p) for name in ("planned_current", "limit_n", "thrust")),
    )


class _CompiledThrust:
    """:meth:`InnerLoop.thrust` by the compiled library (``data/native/follow.c``), of these arrays."""

    def __init__(
        self,
        library: Any,
        ancillary: Ancillary,
        grid: TimeGrid,
        x: FloatArray,
        thrust_n: FloatArray,
        current_ned_m_s: FloatArray,
    ) -> None:
        surges, thrusters, _ = ancillary.gains.shape
        self._state, self._current = np.zeros(NX), np.zeros(3)
        self._limit_n, self._thrust_n = np.zeros(thrusters), np.zeros(thrusters)
        self._gains, self._t_s = np.ascontiguousarray(ancillary.gains), np.ascontiguousarray(grid.t_s)
        self._arrays = {
            "t_s": (self._t_s, (grid.n + 1,)),
            "gains": (self._gains, (surges, thrusters, NX)),
            "plan": (x, (grid.n + 1, NX)),
            "plan_thrust": (thrust_n, (grid.n, thrusters)),
            "x": (self._state, (NX,)),
            "current": (self._current, (3,)),
            "planned_current": (current_ned_m_s, (3,)),
            "limit_n": (self._limit_n, (thrusters,)),
            "thrust": (self._thrust_n, (thrusters,)),
        }
        self._told = _Inner(
            n=grid.n,
            thrusters=thrusters,
            surges=surges,
            first_m_s=float(SURGES_M_S[0]),
            step_m_s=float(SURGES_M_S[1] - SURGES_M_S[0]),
            **{name: compiled.fitting(name, array, *shape) for name, (array, shape) in self._arrays.items()},
        )
        self._reference, self._call = ctypes.byref(self._told), library.inner_thrust

    def thrust(self, after_s: float, x: FloatArray, current_ned_m_s: FloatArray, limit_n: FloatArray) -> FloatArray:
        self._state[:], self._current[:], self._limit_n[:] = x, current_ned_m_s, limit_n
        self._call(self._reference, after_s)
        return self._thrust_n.copy()


def plan_error(x: FloatArray, z: FloatArray, current_ned_m_s: FloatArray, planned_ned_m_s: FloatArray) -> FloatArray:
    """Error (8,) of ``x`` against the planned ``z``, velocities over ground: a change of the believed current between
    the two is no motion."""
    e = error_of(x, z)
    north, east, down = (current_ned_m_s - planned_ned_m_s).tolist()
    c, s = math.cos(x[YAW]), math.sin(x[YAW])
    e[U] += c * north + s * east
    e[V] += c * east - s * north
    e[W] += down
    return e
