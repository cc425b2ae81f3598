"""Velocity by a Doppler log (DVL): of the sensor, in the body frame, over ground or relative to the water."""

import math
from dataclasses import dataclass

import numpy as np

from autopilot.core import operator_messages as notices
from autopilot.core.frames import FloatArray, r_ned_from_frd
from autopilot.core.samples import VelocityLock, VelocitySample, possible_velocity
from autopilot.core.vehicle import DvlMount, Vehicle
from autopilot.estimator.aiding import REJECT_COUNT, START_COUNT, ScalarAid
from autopilot.estimator.inertial import Inertial, cross
from autopilot.estimator.measurement import Measurement, Moment
from autopilot.estimator.remarks import Remarks
from autopilot.estimator.states import (
    ACCEL_BIAS,
    BIAS_AHEAD,
    BIAS_DOWN,
    BIAS_RIGHT,
    CURRENT,
    CURRENT_DOWN,
    EAST,
    GYRO_BIAS,
    NORTH,
    NX,
    VEL,
    VEL_DOWN,
    VEL_EAST,
    VEL_NORTH,
    YAW,
)

MIN_SIGMA_M_S = 0.002
MAX_SIGMA_M_S = 5.0
ALIKE_S = 1.0
"""Errors that stay are taken for noise of so many more samples: the filter's memory of a velocity between fixes."""
Variance3 = tuple[float, float, float]


class LogDrift:
    """Position variance since the last fix by constant errors of a Doppler log, while nothing else shows the motion.

    A log whose heading is off turns the displacement that it measures, one that is off in scale stretches it, whatever
    the path between. Off in roll and pitch it takes a part of the path for a change of depth, and a constant error of
    its velocity adds itself times the time. White noise, which the filter holds, averages out; these do not."""

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


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class BodyVelocity(Measurement):
    """z = (3,) velocity of the sensor [m/s], FRD."""

    lock: VelocityLock
    mount_frd_m: tuple[float, float, float]
    """Where the sensor sits: it moves when the body turns."""

    def predicted(self, x: FloatArray, moment: Moment, after_s: float) -> FloatArray:
        """R' (v [- current]) + rate x lever arm."""
        inertial = moment.inertial
        frd_from_level = _frd_from_level(inertial)
        rate = inertial.rate_frd_rad_s - x[GYRO_BIAS] * frd_from_level[:, 2]
        h: FloatArray = frd_from_level @ self._level(x, moment, after_s)
        h += np.array(cross(rate.tolist(), self.mount_frd_m))
        return h

    def jacobian(self, x: FloatArray, moment: Moment, after_s: float) -> FloatArray:
        """Rows forward, right, down."""
        inertial = moment.inertial
        frd_from_level = _frd_from_level(inertial)
        c, s = _direction(x, inertial, after_s)
        jac = np.zeros((3, NX))
        jac[:, VEL] = frd_from_level @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        if self.lock is VelocityLock.WATER:
            jac[:, CURRENT] = -jac[:, VEL_NORTH : VEL_EAST + 1]
            jac[:, CURRENT_DOWN] = -jac[:, VEL_DOWN]
        forward, right, _ = self._level(x, moment, 0.0, (c, s)).tolist()
        jac[:, YAW] = frd_from_level @ np.array([right, -forward, 0.0])
        jac[:, GYRO_BIAS] = -after_s * jac[:, YAW]
        jac[:, GYRO_BIAS] -= cross(frd_from_level[:, 2].tolist(), self.mount_frd_m)
        jac[:, ACCEL_BIAS] = -after_s * frd_from_level
        return jac

    def _level(
        self, x: FloatArray, moment: Moment, after_s: float, direction: tuple[float, float] | None = None
    ) -> FloatArray:
        """Velocity in the level frame (3,), moved on by the acceleration."""
        c, s = _direction(x, moment.inertial, after_s) if direction is None else direction
        v = x[VEL].copy()
        if self.lock is VelocityLock.WATER:
            v[:2] -= x[CURRENT]
            v[2] -= x[CURRENT_DOWN]
        n, e, d = v.tolist()
        ax, ay, az = moment.inertial.accel_level_m_s2
        moved = (ax - x.item(BIAS_AHEAD), ay - x.item(BIAS_RIGHT), az - x.item(BIAS_DOWN))
        return np.array([c * n + s * e, c * e - s * n, d]) + after_s * np.array(moved)


def _direction(x: FloatArray, inertial: Inertial, after_s: float) -> tuple[float, float]:
    """Cosine and sine of the heading at the time of the measurement."""
    yaw = x.item(YAW) + after_s * (inertial.yaw_rate_rad_s - x.item(GYRO_BIAS))
    return float(np.cos(yaw)), float(np.sin(yaw))


def _frd_from_level(inertial: Inertial) -> FloatArray:
    """(3, 3) by roll and pitch."""
    return r_ned_from_frd(np.array([inertial.roll_rad, inertial.pitch_rad, 0.0])).T


def velocity_from_sample(sample: VelocitySample, dvl: DvlMount) -> BodyVelocity | None:
    """The measurement of a DVL's sample; None if it is malformed."""
    vel, sigma = np.asarray(sample.vel_frd_m_s, dtype=float), np.asarray(sample.sigma_m_s, dtype=float)
    if vel.shape != (3,) or sigma.shape != (3,):
        return None
    # Comparisons with NaN are false, so a NaN anywhere is malformed as well.
    if not possible_velocity(vel) or not ((sigma >= 0.0) & (sigma <= MAX_SIGMA_M_S)).all():
        return None
    if sample.lock not in tuple(VelocityLock):
        return None
    across = dvl.heading_sigma_rad**2 * (float(vel @ vel) - vel**2)
    constant = dvl.bias_sigma_m_s**2 + (dvl.scale_sigma * vel) ** 2 + across
    noise = np.diag(np.maximum(sigma, MIN_SIGMA_M_S) ** 2 + ALIKE_S * dvl.rate_hz * constant)
    lock = VelocityLock(sample.lock)
    mount_frd_m = dvl.position_frd_m
    return BodyVelocity(sensor="velocity", t_us=sample.t_us, z=vel, noise=noise, lock=lock, mount_frd_m=mount_frd_m)


class VelocityAid(Remarks, ScalarAid[VelocitySample]):
    sensor = "velocity"
    samples = (VelocitySample,)
    own = VEL

    def __init__(self, vehicle: Vehicle) -> None:
        Remarks.__init__(self)
        ScalarAid.__init__(self, vehicle.dvl.time_offset_s)
        self._dvl = vehicle.dvl
        self.drift = LogDrift(vehicle.dvl)
        self.ground_us: int | None = None
        """Time of validity of the newest velocity over ground that has been used, None before the first."""

    def measured(self, sample: VelocitySample) -> BodyVelocity | None:
        return self.counted(velocity_from_sample(sample, self._dvl))

    def reopened(self, measurement: BodyVelocity, *, fixed: bool) -> slice | None:
        """See :class:`ScalarAid`: through the water the current is reset; over ground fixes determine the velocity
        better.
        """
        through_water = measurement.lock is VelocityLock.WATER
        if through_water:
            return CURRENT
        return None if fixed else self.own

    def used(self, measurement: BodyVelocity) -> None:
        if self.contradicted and self._fused_in_row >= START_COUNT:
            self.contradicted = False
            self._texts.append(notices.VELOCITY_LOG_AGREES().text)
        over_ground = measurement.lock is VelocityLock.BOTTOM
        if over_ground:
            self.ground_us = max(measurement.t_us, -1 if self.ground_us is None else self.ground_us)

    def denied(self, measurement: BodyVelocity) -> None:
        """See :class:`ScalarAid`: that of the water is not known by fixes."""
        over_ground = measurement.lock is VelocityLock.BOTTOM
        if over_ground and not self.contradicted and self.rejected_in_row >= REJECT_COUNT:
            self.contradicted = True
            self._texts.append(notices.VELOCITY_LOG_DISAGREES().text)
