"""Position drift by constant errors of a Doppler log, while nothing else shows the motion over ground.

A log whose heading is off turns the displacement that it measures, one that is off in scale stretches it, whatever the
path between. Off in roll and pitch it takes a part of the path for a change of depth, and a constant error of its
velocity adds itself times the time. White noise, which the filter holds, averages out; these do not.
"""

import math

import numpy as np

from autopilot.core.frames import FloatArray
from autopilot.core.vehicle import DvlMount
from autopilot.estimator.states import EAST, NORTH, NX, VEL_EAST, VEL_NORTH

Variance3 = tuple[float, float, float]


class LogDrift:
    """Variance since the last fix."""

    def __init__(self, dvl: DvlMount) -> None:
        self._turn, self._scale, self._bias_m_s = dvl.heading_sigma_rad, dvl.scale_sigma, dvl.bias_sigma_m_s
        self._start: tuple[int, FloatArray] = (0, np.zeros(NX))
        """Time and state at the last fix,"""
        self._path_m = 0.0
        """the way since,"""
        self._grown: Variance3 = (0.0, 0.0, 0.0)
        """and by what the position has become uncertain since [m^2]."""

    def fixed(self, t_us: int, x: FloatArray) -> None:
        """Fixes show the position."""
        self._start, self._path_m, self._grown = (t_us, x), 0.0, (0.0, 0.0, 0.0)

    def growth(self, t_us: int, dt_s: float, x: FloatArray) -> Variance3:
        """By which north, east and down become uncertain in the step of ``dt_s`` to ``t_us`` with state (21,) [m^2]. A
        vehicle that comes back undoes what the turn has done, which is not counted: its path is not known that well."""
        start_us, start = self._start
        north, east = x.item(NORTH) - start.item(NORTH), x.item(EAST) - start.item(EAST)
        self._path_m += dt_s * math.hypot(x.item(VEL_NORTH), x.item(VEL_EAST))
        along, across = self._scale**2, self._turn**2
        steady = (1e-6 * (t_us - start_us) * self._bias_m_s) ** 2
        before = self._grown
        n2, e2 = north * north, east * east
        self._grown = (
            max(before[0], along * n2 + across * e2 + steady),
            max(before[1], along * e2 + across * n2 + steady),
            max(before[2], across * self._path_m**2 + steady),
        )
        after = self._grown
        return after[0] - before[0], after[1] - before[1], after[2] - before[2]
