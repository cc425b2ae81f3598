"""AHRS processing: validation, rotation to the level frame, and integration to steps between two times."""

import math
from collections.abc import Sequence
from dataclasses import replace
from enum import IntEnum, StrEnum
from typing import NamedTuple

import numpy as np

from autopilot.core.frames import FloatArray
from autopilot.core.samples import AhrsSample

GRAVITY_M_S2 = 9.81
"""At rest the AHRS reads (0, 0, -9.81), see AhrsSample."""

FUTURE_TOLERANCE_US = 2_000
"""A sample may be this far ahead of the clock (rounding of the driver's time stamps)."""

STUCK_SAMPLES = 20
"""So many samples in a row (0.2 s) that do not move mean that the AHRS hangs: real gyros are never that quiet."""
STILL_RAD, STILL_RAD_S, STILL_M_S2 = 1e-6, 1.5e-4, 1e-3
"""A value that stays this near does not move: the last bit of a MEMS sensor, a quarter of its noise; the attitude is
computed and has more digits."""
MOST_MOVING = 2
"""Of the nine values of one that hangs: the bits of a loose contact."""

MAX_RATE_RAD_S = 20.0
MAX_ACCEL_M_S2 = 80.0
"""Beyond these a sample is a transmission fault: the IG-500 measures up to 5 g and 5 rad/s in its usual version."""


MOUNT_GAP_S = 0.1
"""Beyond this gap between two samples the angular acceleration is not taken from their difference."""

TURN = 2.0 * math.pi


class ProcessNoiseMode(IntEnum):
    """Which process noise a step has."""

    NOMINAL = 0
    COASTING = 1
    """No vision for a while: the current is held."""
    BLIND = 2
    """No AHRS: the acceleration is the vehicle model's."""
    TRIMMED = 3
    """Vision, and its tilt keeps gravity out of the acceleration."""
    MODEL = 4
    """The accelerometer is suspect: the acceleration is the vehicle model's."""
    COMPASS = 5
    """The gyro is suspect: the turning is the AHRS heading's."""
    MODEL_COMPASS = 6
    """Both are suspect."""


class Inertial(NamedTuple):
    """One moment of the AHRS, ready for the filter."""

    t_us: int
    roll_rad: float
    pitch_rad: float
    ahrs_yaw_rad: float
    yaw_rate_rad_s: float
    """d yaw / dt from the gyros and the tilt (Fossen 2011, section 2.2.1)."""
    accel_level_m_s2: tuple[float, float, float]
    """Acceleration without gravity, forward/right/down in the level frame that turns with the heading."""
    rate_frd_rad_s: FloatArray
    """(3,)"""
    raw_tilt_rad: tuple[float, float]
    """Roll and pitch as the AHRS shows them."""
    real: bool
    """False = made up because no AHRS data came."""


class InertialStep(NamedTuple):
    """Input of one prediction step: means over the step."""

    dt_s: float
    yaw_rate_rad_s: float
    accel_level_m_s2: tuple[float, float, float]
    mode: ProcessNoiseMode
    slope: FloatArray | None = None
    """(3, 21) d acceleration / d state when the vehicle model makes it, None when it is measured."""
    current_variance_per_s: float = 0.0
    """By which north and east of the current become uncertain beyond the mode's process noise [m^2/s^2 / s]."""
    yaw_variance_rad2: float = 0.0
    """By which the heading becomes uncertain beyond it,"""
    position_variance_m2: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """and north, east and down."""


class SampleVerdict(StrEnum):
    """Result of the validation of a sample."""

    GOOD = "good"
    MALFORMED = "malformed"
    FUTURE = "future"
    OLD = "old"
    """Duplicate or out of order."""
    STUCK = "stuck"


def level(sample: AhrsSample, trim_rad: tuple[float, float] = (0.0, 0.0)) -> Inertial:
    """The sample in the level frame: take the trim off roll and pitch, rotate by them, take gravity away."""
    raw_roll, raw_pitch, yaw = sample.rpy_rad.tolist()
    roll, pitch = raw_roll - trim_rad[0], raw_pitch - trim_rad[1]
    _, q, r = sample.rate_frd_rad_s.tolist()
    fx, fy, fz = sample.accel_frd_m_s2.tolist()
    cr, sr = math.cos(roll), math.sin(roll)
    cp, sp = math.cos(pitch), math.sin(pitch)
    down = sr * fy + cr * fz
    return Inertial(
        sample.t_us,
        roll,
        pitch,
        yaw,
        (sr * q + cr * r) / max(cp, 0.1),
        (cp * fx + sp * down, cr * fy - sr * fz, -sp * fx + cp * down + GRAVITY_M_S2),
        sample.rate_frd_rad_s,
        (raw_roll, raw_pitch),
        True,
    )


def tilt_rates(inertial: Inertial) -> FloatArray:
    """(2,) rates of roll and pitch [rad/s] (Fossen 2011, eq. 2.28)."""
    p, q, r = inertial.rate_frd_rad_s.tolist()
    sr, cr = math.sin(inertial.roll_rad), math.cos(inertial.roll_rad)
    return np.array((p + (sr * q + cr * r) * math.tan(inertial.pitch_rad), cr * q - sr * r))


def down_of(inertial: Inertial, point_frd_m: tuple[float, float, float]) -> float:
    """Depth of a body point below the centre of gravity [m]."""
    sr, cr = math.sin(inertial.roll_rad), math.cos(inertial.roll_rad)
    sp, cp = math.sin(inertial.pitch_rad), math.cos(inertial.pitch_rad)
    x, y, z = point_frd_m
    return -sp * x + cp * (sr * y + cr * z)


def made_up(
    t_us: int, last: Inertial, accel_level_m_s2: tuple[float, float, float], decay: float, turn_rad_s: float
) -> Inertial:
    """A stand-in for a missing AHRS sample: tilt fades out with ``decay``, the yaw rate grows by ``turn_rad_s``."""
    yaw_rate = last.yaw_rate_rad_s + turn_rad_s
    return Inertial(
        t_us=t_us,
        roll_rad=decay * last.roll_rad,
        pitch_rad=decay * last.pitch_rad,
        ahrs_yaw_rad=last.ahrs_yaw_rad,
        yaw_rate_rad_s=yaw_rate,
        accel_level_m_s2=accel_level_m_s2,
        rate_frd_rad_s=np.array([0.0, 0.0, yaw_rate]),
        raw_tilt_rad=last.raw_tilt_rad,
        real=False,
    )


def step_between(
    a: Inertial,
    b: Inertial,
    mode: ProcessNoiseMode,
    slope: FloatArray | None = None,
    current_variance_per_s: float = 0.0,
) -> InertialStep:
    """The step from ``a`` to ``b`` with the means of both ends."""
    (ax, ay, az), (bx, by, bz) = a.accel_level_m_s2, b.accel_level_m_s2
    return InertialStep(
        1e-6 * (b.t_us - a.t_us),
        0.5 * (a.yaw_rate_rad_s + b.yaw_rate_rad_s),
        (0.5 * (ax + bx), 0.5 * (ay + by), 0.5 * (az + bz)),
        mode,
        slope,
        current_variance_per_s,
    )


def hold(last: Inertial, t_us: int, mode: ProcessNoiseMode) -> InertialStep:
    """The step from ``last`` to a later time without samples: inputs held."""
    return InertialStep(
        dt_s=1e-6 * (t_us - last.t_us),
        yaw_rate_rad_s=last.yaw_rate_rad_s,
        accel_level_m_s2=last.accel_level_m_s2,
        mode=mode,
    )


class AhrsMount:
    """Lever-arm correction of the accelerometer to the centre of gravity.

    a_center = a_sensor - rate' x r - rate x (rate x r), with the angular acceleration by differences of samples: its
    noise cancels in the integral.
    """

    def __init__(self, position_frd_m: tuple[float, float, float]) -> None:
        self._lever = position_frd_m
        self._away = any(position_frd_m)
        self._t_us = -1
        self._rate = (0.0, 0.0, 0.0)

    def at_center(self, sample: AhrsSample) -> AhrsSample:
        """The sample as if measured at the centre of gravity. To be called in the order of time."""
        if not self._away:
            return sample
        p, q, r = sample.rate_frd_rad_s.tolist()
        dt = 1e-6 * (sample.t_us - self._t_us)
        known = self._t_us >= 0 and dt <= MOUNT_GAP_S
        turn = tuple((new - old) / dt for new, old in zip((p, q, r), self._rate, strict=True)) if known else (0.0,) * 3
        self._t_us, self._rate = sample.t_us, (p, q, r)
        swing = cross((p, q, r), cross((p, q, r), self._lever))
        extra = [a + b for a, b in zip(cross(turn, self._lever), swing, strict=True)]
        return replace(sample, accel_frd_m_s2=sample.accel_frd_m_s2 - np.array(extra))


def cross(a: Sequence[float], b: Sequence[float]) -> tuple[float, float, float]:
    """a x b; for one pair ten times faster than numpy's."""
    ax, ay, az = a
    bx, by, bz = b
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


def within(values: Sequence[float], most: float) -> bool:
    """Whether three values are numbers of at most that size: a comparison with NaN is false."""
    a, b, c = values
    return -most <= a <= most and -most <= b <= most and -most <= c <= most


class ImuValidator:
    """Lets good AHRS samples in and counts the others."""

    def __init__(self) -> None:
        self.counts = dict.fromkeys(SampleVerdict, 0)
        self._held: tuple[list[float], list[float], list[float]] | None = None
        """Attitude, rates and forces that the samples since have stayed near."""
        self._repeats = 0

    def let_in(self, sample: AhrsSample, now_us: int, newest_us: int) -> bool:
        """Whether the sample is good at ``now_us`` when everything up to ``newest_us`` has been used."""
        verdict = self._check(sample, now_us, newest_us)
        self.counts[verdict] += 1
        return verdict is SampleVerdict.GOOD

    def _check(self, sample: AhrsSample, now_us: int, newest_us: int) -> SampleVerdict:
        rpy, rate, accel = sample.rpy_rad, sample.rate_frd_rad_s, sample.accel_frd_m_s2
        if not rpy.shape == rate.shape == accel.shape == (3,):
            return SampleVerdict.MALFORMED
        tilt, speeds, forces = rpy.tolist(), rate.tolist(), accel.tolist()
        # Comparisons with NaN are false, so a NaN anywhere is malformed as well.
        if not (
            within(tilt, TURN)
            and -0.25 * TURN <= tilt[1] <= 0.25 * TURN
            and within(speeds, MAX_RATE_RAD_S)
            and within(forces, MAX_ACCEL_M_S2)
        ):
            return SampleVerdict.MALFORMED
        if sample.t_us > now_us + FUTURE_TOLERANCE_US:
            return SampleVerdict.FUTURE
        if sample.t_us <= newest_us:
            return SampleVerdict.OLD
        if self._held is None or self._moved(self._held, tilt, speeds, forces):
            self._held, self._repeats = (tilt, speeds, forces), 0
            return SampleVerdict.GOOD
        self._repeats += 1
        return SampleVerdict.STUCK if self._repeats >= STUCK_SAMPLES else SampleVerdict.GOOD

    @staticmethod
    def _moved(
        held: tuple[list[float], list[float], list[float]], tilt: list[float], speeds: list[float], forces: list[float]
    ) -> bool:
        """Whether more values have moved than of a device that hangs; the forces of a live one nearly always do."""
        moving = _moving(held[2], forces, STILL_M_S2)
        if moving <= MOST_MOVING:
            moving += _moving(held[1], speeds, STILL_RAD_S) + _moving(held[0], tilt, STILL_RAD)
        return moving > MOST_MOVING


def _moving(a: Sequence[float], b: Sequence[float], still: float) -> int:
    """How many of three values differ by more than ``still``."""
    (ax, ay, az), (bx, by, bz) = a, b
    return (abs(bx - ax) > still) + (abs(by - ay) > still) + (abs(bz - az) > still)
