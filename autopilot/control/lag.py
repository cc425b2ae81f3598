"""Thruster lag: which thrust acts now, and where it takes the vehicle before a new command counts.

A thruster with first-order lag T that acts with F and is commanded G delivers the same momentum as one that keeps F
for T and then jumps to G. So the plan starts T ahead, from where the acting thrust takes the vehicle, and needs no
thrust states.
"""

import math

import casadi as ca
import numpy as np

from autopilot.control.ocp import bind, discrete_dynamics
from autopilot.core.frames import FloatArray
from autopilot.core.model4 import NU, NX, Model4


class ThrusterLag:
    """Follows the acting thrust and predicts the state one lag ahead."""

    def __init__(self, model: Model4, lag_s: float) -> None:
        self._lag_s = lag_s
        interval = discrete_dynamics(model, lag_s, 2)
        x, u, c = ca.SX.sym("x", NX), ca.SX.sym("u", NU), ca.SX.sym("c", 3)
        function = ca.Function("ahead", [x, u, c], [interval(x, u, c)[0]])
        self._x, self._u, self._c, self._out = np.zeros(NX), np.zeros(NU), np.zeros(3), np.zeros(NX)
        self._owner, self._evaluate = bind(function, (self._x, self._u, self._c), (self._out,))
        self.acting_n = np.zeros(NU)
        """(4,) thrust that acts now."""

    def reset(self) -> None:
        """The thrusters stand still."""
        self.acting_n[:] = 0.0

    def follow(self, command_n: FloatArray, elapsed_s: float) -> None:
        """``command_n`` (4,) has been commanded for the last ``elapsed_s``."""
        self.acting_n += (1.0 - math.exp(-max(elapsed_s, 0.0) / self._lag_s)) * (command_n - self.acting_n)

    def ahead(self, x: FloatArray, current_ned_m_s: FloatArray) -> FloatArray:
        """State (8,) one lag after the state ``x`` (8,)."""
        self._x[:], self._u[:], self._c[:] = x, self.acting_n, current_ned_m_s
        self._evaluate()
        return self._out.copy()
