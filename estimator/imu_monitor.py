"""Monitors accelerometer and gyro, and substitutes the suspect one.

The substitute of the acceleration is the vehicle model with the commanded thrust; that of the yaw rate is the AHRS's
heading. When a sensor is rejected, the recent history is recomputed without it: the fault precedes its detection.
"""

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from autopilot.core.frames import FloatArray, wrap_pi
from autopilot.core.messages import NavDoubt
from autopilot.estimator.estimator_tuning import INERTIAL_MONITOR
from autopilot.estimator.fix_trust import FixTrust
from autopilot.estimator.history import Node, Reopening
from autopilot.estimator.inertial import Inertial, InertialStep, ProcessNoiseMode, step_between
from autopilot.estimator.inertial_monitors import AccelMonitor, GyroMonitor
from autopilot.estimator.measure_model import VehicleAcceleration, idle
from autopilot.estimator.monitor import NOTHING, Monitor
from autopilot.estimator.states import ACCEL_BIAS, GYRO_BIAS, HEADING_OFFSET, YAW, one
from autopilot.estimator.water import WaterVariation

TURN_MAX_RAD_S = 2.0
"""No vehicle of this class turns faster: beyond it the compass has jumped."""


class Verdicts(NamedTuple):
    doubted: bool = False
    """A sensor has become suspect: compute the last moments again."""
    apart_rad: float = 0.0
    """So far have gyro and compass come apart, and which of them is wrong is not known; 0 = no news."""
    jump_rad: float = 0.0
    """So far has the compass jumped; 0 = no news."""
    accel_offset: tuple[float, ...] | None = None
    gyro_offset: tuple[float, ...] | None = None
    """Not None: trusted again with this offset."""


NOTHING_NEW = Verdicts()


class ImuMonitor(Monitor):
    """Both inertial monitors of one estimator."""

    def __init__(self, vehicle: VehicleAcceleration, witness: FixTrust, water: WaterVariation) -> None:
        """``witness``: the fixes that isolate the faulty sensor; ``water``: what may explain a difference."""
        super().__init__()
        self._water = water
        self._vehicle, self._witness = vehicle, witness
        self.accel = AccelMonitor()
        self.gyro = GyroMonitor()

    @property
    def since_us(self) -> int | None:
        """When the later of the suspicions began, None without any."""
        accel_us, gyro_us = self.accel.since_us, self.gyro.since_us
        if accel_us is None or gyro_us is None:
            return gyro_us if accel_us is None else accel_us
        return max(accel_us, gyro_us)

    def doubts(self, t_us: int, newest: Node) -> Iterator[NavDoubt]:
        """See :class:`Monitor`: without isolation no sensor is named."""
        for sensor, name in ((self.accel, NavDoubt.ACCELEROMETER), (self.gyro, NavDoubt.GYRO)):
            if sensor.since_us is not None and self._witness.can_isolate(sensor.since_us):
                yield name

    def systematic_variance(self, t_us: int, newest: Node) -> FloatArray:
        """See :class:`Monitor`."""
        yaw = self.gyro.heading_variance
        return np.array((0.0, 0.0, 0.0, yaw)) if yaw else NOTHING

    def counts(self) -> dict[str, int]:
        return {
            "doubt.accel": self.accel.count,
            "doubt.gyro": self.gyro.count,
            "doubt.compass_jumps": self.gyro.jumps,
        }

    def forgive(self) -> None:
        self.accel.reinstate()
        self.gyro.reinstate()

    def forgive_unwitnessed(self) -> None:
        """Fixes are available again: use sensors whose fault was not isolated."""
        for sensor in (self.accel, self.gyro):
            if sensor.since_us is not None and not self._witness.can_isolate(sensor.since_us):
                sensor.reinstate()

    def reopenings(self, found: Verdicts, t_us: int) -> Iterator[Reopening]:
        """States to be reset after these verdicts; recovered sensors are used again."""
        forgotten: list[tuple[slice, float, tuple[float, ...] | None]] = []
        if found.apart_rad:
            forgotten += [(part, found.apart_rad**2, None) for part in (one(YAW), one(HEADING_OFFSET))]
        if found.jump_rad:
            forgotten.append((one(HEADING_OFFSET), found.jump_rad**2, None))
        if found.accel_offset is not None:
            self.accel.reinstate()
            forgotten.append((ACCEL_BIAS, INERTIAL_MONITOR.steady_m_s2**2, found.accel_offset))
        if found.gyro_offset is not None:
            self.gyro.reinstate()
            forgotten.append((one(GYRO_BIAS), INERTIAL_MONITOR.steady_rad_s**2, found.gyro_offset))
        for part, variance, value in forgotten:
            yield Reopening("imu", t_us, part, variance, value)

    def drive(self, before: Node, inertial: Inertial) -> tuple[Inertial, InertialStep]:
        """The moment after ``before`` without the suspect sensors, and the step to it."""
        last = before.moment.inertial
        if not inertial.real:
            return inertial, step_between(
                last, inertial, ProcessNoiseMode.BLIND, None, self._water.variance_per_s(before.state.x)
            )
        x, slope = before.state.x, None
        by_model, by_compass = self.accel.since_us is not None, self.gyro.since_us is not None
        if by_compass:
            rate = self._compass_rate(last, inertial) + x.item(GYRO_BIAS)
            rates = inertial.rate_frd_rad_s.copy()
            rates[2] = rate
            inertial = inertial._replace(yaw_rate_rad_s=rate, rate_frd_rad_s=rates)
        if by_model:
            bias = x[ACCEL_BIAS].tolist()
            if idle(before.moment, x):
                ax, ay, az = 0.0, 0.0, 0.0
            else:
                ax, ay, az, _ = self._vehicle.at(x, before.moment)
                slope = self._vehicle.slope(x, before.moment)
            inertial = inertial._replace(accel_level_m_s2=(ax + bias[0], ay + bias[1], az + bias[2]))
        mode = (
            ProcessNoiseMode.MODEL_COMPASS
            if by_model and by_compass
            else ProcessNoiseMode.MODEL
            if by_model
            else ProcessNoiseMode.COMPASS
        )
        return inertial, step_between(last, inertial, mode, slope, self._water.variance_per_s(x))

    def check(
        self,
        before: Node,
        node: Node,
        raw: Inertial,
        *,
        model_dt_s: float,
        anchored: bool,
        denied: bool,
        heading_denied: bool,
        model_rejected: int,
        compass_rejected: int,
    ) -> Verdicts:
        """Check the sample ``raw`` between ``before`` and ``node``; see :class:`AccelMonitor` and GyroMonitor.

        ``model_dt_s``: time since the last comparison with the model, 0 = no comparison with this sample.
        """
        last, x, dt_s = before.moment.inertial, node.state.x, 1e-6 * (node.t_us - before.t_us)
        if not last.real:
            return NOTHING_NEW
        turn = wrap_pi(raw.ahrs_yaw_rad - last.ahrs_yaw_rad)
        rate = raw.yaw_rate_rad_s - x.item(GYRO_BIAS)
        jump = self.gyro.jumped_rad(dt_s, turn, rate)
        gyro = jump == 0.0 and self.gyro.check(
            node.t_us,
            dt_s,
            turn,
            rate,
            anchored=anchored,
            heading_denied=heading_denied,
            compass_rejected=compass_rejected,
        )
        apart = self.gyro.apart_rad if gyro and not anchored else 0.0
        accel = False
        accel_offset = gyro_offset = None
        if model_dt_s > 0.0 and not idle(node.moment, x):
            expected = self._vehicle.at(x, node.moment)
            over = [a - e for a, e in zip(raw.accel_level_m_s2, expected, strict=False)]
            accel = self.accel.check(
                node.t_us,
                model_dt_s,
                [o - b for o, b in zip(over, x[ACCEL_BIAS].tolist(), strict=True)],
                lambda: self._model_variance(node),
                anchored=anchored,
                denied=denied,
                rejected=model_rejected,
            )
            if self.accel.since_us is not None and not accel:
                accel_offset = self.accel.steady_offset(model_dt_s, over, anchored=anchored and not denied)
        if self.gyro.since_us is not None and not gyro:
            unexplained = raw.yaw_rate_rad_s - (turn / dt_s if jump == 0.0 else rate)
            gyro_offset = self.gyro.steady_offset(dt_s, (unexplained,), anchored=anchored and not denied)
        if not (accel or gyro or jump) and accel_offset is None and gyro_offset is None:
            return NOTHING_NEW
        return Verdicts(
            doubted=accel or gyro,
            apart_rad=apart,
            jump_rad=jump,
            accel_offset=None if accel_offset is None else tuple(accel_offset),
            gyro_offset=None if gyro_offset is None else tuple(gyro_offset),
        )

    def _model_variance(self, node: Node) -> Sequence[float]:
        """(3,) of the model's acceleration by what is not known of velocity and current [m^2/s^4]."""
        slope, p = self._vehicle.slope(node.state.x, node.moment), node.state.p
        spread: FloatArray = slope**2 @ p if p.ndim == 1 else ((slope @ p) * slope).sum(axis=1)
        variance: list[float] = spread.tolist()
        return variance

    def _compass_rate(self, last: Inertial, inertial: Inertial) -> float:
        """Turning by the AHRS's heading [rad/s]; none when it jumps."""
        dt_s = 1e-6 * (inertial.t_us - last.t_us)
        rate = wrap_pi(inertial.ahrs_yaw_rad - last.ahrs_yaw_rad) / dt_s
        return rate if math.fabs(rate) < TURN_MAX_RAD_S else 0.0
