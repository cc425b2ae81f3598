"""Position and heading of the vehicle from markers or from a pose sensor."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from autopilot.core.frames import FloatArray, wrap_pi
from autopilot.core.messages import MarkerFit
from autopilot.core.samples import PoseSample
from autopilot.estimator.inertial import within
from autopilot.estimator.measurement import Measurement, Moment
from autopilot.estimator.states import GYRO_BIAS, NX, VEL_DOWN, VEL_EAST, VEL_NORTH

MIN_SIGMA_POS_M = 5e-5
MIN_SIGMA_YAW_RAD = 5e-5
"""Floors: the part of the error that is the same from frame to frame, so that averaging does not take it away. On
rendered flights 0.05 mm of the height and 0.004 degrees stay alike for a second. Errors of a vehicle's calibration and
of its map come on top: they are constant, no floor of the noise describes them."""

MAX_DISTANCE_M = 1e5
"""From the local origin, which lies near the vehicle."""
MAX_YAW_RAD = 1e3
MAX_SIGMA_POS_M = 1.0
"""Fixes with a larger standard deviation are not used."""


_AT_ONCE: FloatArray = np.eye(4, NX)
_AT_ONCE.flags.writeable = False
"""Jacobian of a pose that is measured at the very moment of its node."""


class SheetDependence(NamedTuple):
    """Dependence of a measurement on sheets."""

    sheets: tuple[int, ...]
    """Numbers of the sheets."""
    sigma: FloatArray
    """(n, 4) how well they were laid: prior standard deviations of a sheet that is first seen."""
    jacobian: FloatArray
    """(m, 4n) d prediction / d offsets."""
    at: FloatArray
    """(4n,) the offsets at which the prediction holds."""
    learns: bool = False
    """Whether the offsets are to be corrected; otherwise they are only taken into account."""


class MarkerOutlier(NamedTuple):
    """A marker seen where the map does not have it, or otherwise turned."""

    code: int
    """Its id, see :data:`autopilot.core.markers.ID_SPAN`."""
    marker: int
    """The marker of the map that it was taken for, -1 = none."""
    north_m: float
    east_m: float
    """Where it is seen."""
    quarters: int = 0
    """Quarters of a turn, 1 or 2, that it is turned by at its place."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PoseFix(Measurement):
    """Pose of the centre of gravity: z = (4,) (north, east, down [m], yaw [rad])."""

    stamp_sigma_s: float = 0.0
    """Standard deviation of its time: what it is worth in position and heading depends on the motion."""
    tilt_rad: tuple[float, float] | None = None
    """Roll and pitch that the same image shows."""
    sigma_tilt_rad: float = 0.0
    ground: SheetDependence | None = None
    """Dependence of the pose on sheet offsets, None = the map is exact."""
    ties: Callable[[], Measurement | None] | None = None
    """What the same image says of its sheets among each other: made when it is asked for, which is not every time."""
    focal: tuple[float, float] | None = None
    """Share by which the image says that the focal length is too long, and its standard deviation; None = nothing."""
    strained: tuple[int, ...] = ()
    """Sheets of the image that do not fit to the others; left out of the pose."""
    outliers: tuple[MarkerOutlier, ...] = ()
    """Its markers that do not lie where the map has them."""
    print_error: tuple[float, float] | None = None
    """Share by which its markers are larger than the map has them, and its standard deviation; None = too few."""
    fit: MarkerFit | None = None
    """Reprojection residuals, None = not from markers."""

    def predicted(self, x: FloatArray, moment: Moment, after_s: float) -> FloatArray:
        """Position moved on with the velocity, yaw with the rate."""
        n, e, d, yaw, vn, ve, vd, gyro_bias = x[: GYRO_BIAS + 1].tolist()
        rate = moment.inertial.yaw_rate_rad_s - gyro_bias
        return np.array([n + after_s * vn, e + after_s * ve, d + after_s * vd, yaw + after_s * rate])

    def jacobian(self, x: FloatArray, moment: Moment, after_s: float) -> FloatArray:
        """Rows north, east, down, yaw."""
        jac = _AT_ONCE.copy()
        jac[0, VEL_NORTH] = jac[1, VEL_EAST] = jac[2, VEL_DOWN] = after_s
        jac[3, GYRO_BIAS] = -after_s
        return jac

    def residual(self, z: FloatArray, predicted: FloatArray) -> FloatArray:
        """z - h with yaw wrapped."""
        y: FloatArray = z - predicted
        y[3] = wrap_pi(float(y[3]))
        return y


def fix_from_sample(sample: PoseSample, sensor: str) -> PoseFix | None:
    """The measurement of a pose sensor's sample; None if it is malformed (shape, NaN, negative sigma, useless)."""
    pos = np.asarray(sample.pos_ned_m, dtype=float)
    sigma = np.asarray(sample.sigma_pos_m, dtype=float)
    if pos.shape != (3,) or sigma.shape != (3,):
        return None
    place, sigmas = pos.tolist(), sigma.tolist()
    # Comparisons with NaN are false, so a NaN anywhere is malformed as well.
    if not within(place, MAX_DISTANCE_M) or not abs(sample.yaw_rad) <= MAX_YAW_RAD:
        return None
    if not (within(sigmas, MAX_SIGMA_POS_M) and min(sigmas) >= 0.0) or not 0.0 <= sample.sigma_yaw_rad <= math.pi:
        return None
    noise = np.zeros((4, 4))
    sigmas = [max(value, MIN_SIGMA_POS_M) for value in sigmas] + [max(sample.sigma_yaw_rad, MIN_SIGMA_YAW_RAD)]
    noise.flat[::5] = [value * value for value in sigmas]
    z = np.array([*place, sample.yaw_rad])
    return PoseFix(sensor=sensor, t_us=sample.t_us, z=z, noise=noise)
