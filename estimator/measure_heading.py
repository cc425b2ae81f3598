"""Heading of the AHRS: magnetic, i.e. true heading plus a slowly varying offset, which is a filter state."""

from dataclasses import dataclass

import numpy as np

from autopilot.core.frames import FloatArray, wrap_pi
from autopilot.estimator.aiding import InertialAid
from autopilot.estimator.inertial import Inertial
from autopilot.estimator.measurement import Measurement, Moment
from autopilot.estimator.states import HEADING_OFFSET, NX, YAW, one

HEADING_EVERY_S = 0.2
"""5 Hz: its errors are slow."""
SIGMA_RAD = 0.026
"""1.5 degrees: the AHRS's short-term heading error, for 5 updates per second that share it."""

_JACOBIAN: FloatArray = np.zeros((1, NX))
_JACOBIAN[0, YAW] = _JACOBIAN[0, HEADING_OFFSET] = 1.0
_JACOBIAN.flags.writeable = False
_NOISE: FloatArray = np.array([[SIGMA_RAD**2]])
_NOISE.flags.writeable = False


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Heading(Measurement):
    """z = (1,) yaw of the AHRS [rad], at the very moment of its sample."""

    def predicted(self, x: FloatArray, moment: Moment, after_s: float) -> FloatArray:
        return np.array([x.item(YAW) + x.item(HEADING_OFFSET)])

    def jacobian(self, x: FloatArray, moment: Moment, after_s: float) -> FloatArray:
        return _JACOBIAN

    def residual(self, z: FloatArray, predicted: FloatArray) -> FloatArray:
        """z - h, wrapped."""
        return np.array([wrap_pi(float(z[0] - predicted[0]))])


def heading_of(inertial: Inertial) -> Heading:
    return Heading(sensor="heading", t_us=inertial.t_us, z=np.array([inertial.ahrs_yaw_rad]), noise=_NOISE)


class HeadingAid(InertialAid):
    """The compass of the AHRS: a few of its samples."""

    sensor = "heading"
    own = one(HEADING_OFFSET)
    every_s = HEADING_EVERY_S

    def measured(self, sample: Inertial) -> Heading:
        return heading_of(sample)
