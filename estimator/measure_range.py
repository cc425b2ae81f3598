"""Range from a sensor to a level floor, as lasers and sonars measure it."""

import math
from abc import abstractmethod
from dataclasses import dataclass

import numpy as np

from autopilot.core.frames import FloatArray
from autopilot.estimator.inertial import Inertial, down_of
from autopilot.estimator.measurement import Measurement, Moment
from autopilot.estimator.states import DOWN, NX, VEL_DOWN

LEAST_COSINE = 0.2
"""Of a tilt: beyond it a range says nothing of the height."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FloorRange(Measurement):
    """z = (1,) range [m]."""

    floor_depth_m: float
    mount_frd_m: tuple[float, float, float]
    """Where the beam starts."""
    beam_frd: tuple[float, float, float]
    """Where it goes, of length 1."""

    @abstractmethod
    def cosine(self, inertial: Inertial) -> float:
        """Cosine of the angle between the beam and the vertical."""
        ...

    def predicted(self, x: FloatArray, moment: Moment, after_s: float) -> FloatArray:
        """(floor - depth of the sensor) / cosine."""
        below = down_of(moment.inertial, self.mount_frd_m)
        height_m = self.floor_depth_m - x.item(DOWN) - after_s * x.item(VEL_DOWN) - below
        return np.array([height_m / self.cosine(moment.inertial)])

    def jacobian(self, x: FloatArray, moment: Moment, after_s: float) -> FloatArray:
        """d/d depth and heave speed."""
        cosine = self.cosine(moment.inertial)
        jac = np.zeros((1, NX))
        jac[0, DOWN] = -1.0 / cosine
        jac[0, VEL_DOWN] = -after_s / cosine
        return jac


def unit(direction: tuple[float, float, float]) -> tuple[float, float, float]:
    """The direction with length 1."""
    x, y, z = direction
    length = math.sqrt(x * x + y * y + z * z)
    return (x / length, y / length, z / length)
