"""Attitude from raw gyros, accelerometers and magnetometer: a complementary filter in an almost-inertial frame.

After Laidig and Seel 2023 (VQF, Information Fusion 91). Gyro integration alone defines an almost-inertial frame, in
which the specific force is low-pass filtered twice: accelerations of the vehicle average out whatever its rotation,
and those of swell or handling far more than with the single integrator of a Mahony-type filter. The filtered force
gives the vertical, and a second rotation levels the frame. The magnetometer corrects the rotation about the vertical
only, so that magnetic disturbance never tilts the estimate, and not while the field is disturbed
(:mod:`.estimator.magnetic`). Both corrections together observe the gyro bias (:mod:`autopilot.estimator.gyro_bias`).
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from autopilot.core import operator_messages as notices
from autopilot.core.frames import FloatArray, wrap_pi
from autopilot.core.samples import AhrsSample, ImuSample
from autopilot.estimator.gyro_bias import WINDOW_S, GyroBias
from autopilot.estimator.inertial import GRAVITY_M_S2, MAX_ACCEL_M_S2, MAX_RATE_RAD_S, within
from autopilot.estimator.magnetic import FieldWatch
from autopilot.estimator.remarks import Remarks
from autopilot.estimator.rotation import (
    IDENTITY,
    Four,
    Three,
    of_tilt,
    product,
    roll_pitch_yaw,
    rotation_by,
    turn_between,
    turned,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class AttitudeTuning:
    """Constants chosen by `autopilot bench estimator --attitude` on recordings."""

    tilt_s: float = 3.0
    """Of the low-pass filter for the specific force (two stages of half of it)."""
    heading_s: float = 6.0
    """Within which the magnetometer's heading is followed."""
    tilt_noise_rad_s: float = math.radians(3.0)
    """How far the level attitude's corrections are from showing the gyros' bias, as a mean over 1 s. Not chosen by
    recordings, which begin at rest: believed more, a start under way goes into the bias (error of the position with the
    other estimator behind it: 16 mm instead of 10)."""
    heading_noise_rad_s: float = math.radians(5.0)
    """The same of the heading's corrections."""
    window_s: float = WINDOW_S
    """How long corrections are gathered before the gyros' bias learns from them."""


DEFAULT_TUNING = AttitudeTuning()

MAX_GAP_S = 0.5
"""Over a longer gap nothing is integrated: the filter starts anew from the sample behind it."""
MIN_HORIZONTAL = 0.05
"""Least horizontal share of the magnetic field that tells a heading (65 deg of dip leave 0.4)."""
MIN_FORCE_M_S2 = 0.5 * GRAVITY_M_S2
"""A smaller mean of the specific force tells no vertical."""

WATCH_EVERY_US = 35_000
"""An AHRS is watched by samples at least so far apart, every fourth one at 100 Hz: five degrees need no more."""
WATCH_TUNING = AttitudeTuning(window_s=0.5)
"""Nor do they need the gyros' bias ten times a second."""
APART_RAD = math.radians(5.0)
APART_US = 1_000_000
"""An AHRS whose tilt is so far from the filter's for so long disagrees with its own gyros and accelerometers."""
TURNING_RAD_S = 0.05
"""A gyro that shows less may show its bias only."""
FROZEN_RAD = 0.05
"""An AHRS whose heading stays the same to the last digit while its own gyro turns by so much gives no attitude."""
THAWED_SAMPLES = 50
"""Headings that have changed in a row, after which it gives one again."""


class AttitudeFilter:
    """Samples in the order of time go in, attitudes come out. Bad samples must be kept away (:meth:`usable`)."""

    def __init__(self, tuning: AttitudeTuning = DEFAULT_TUNING) -> None:
        self._tuning = tuning
        self._bias = GyroBias(tuning.tilt_s, tuning.tilt_noise_rad_s, tuning.heading_noise_rad_s, tuning.window_s)
        self._field = FieldWatch()
        self._t_us = self._magnet_us = -1
        self._age_s = 0.0
        self._heading_age_s = 0.0
        self._rate: Three = (0.0, 0.0, 0.0)
        self._carried: Four = IDENTITY
        """Body to the frame that the gyros carry along."""
        self._levelling: Four = IDENTITY
        """From there to a level frame."""
        self._level: Four = IDENTITY
        """Both."""
        self._yaw_rad = 0.0
        """From the level frame to north."""
        self._slow: tuple[Three, Three] = ((0.0, 0.0, -GRAVITY_M_S2),) * 2
        """Stages of the low-pass filter, m/s2."""

    @property
    def bias_rad_s(self) -> FloatArray:
        """(3,) of the gyros, body axes."""
        return np.array(self._bias.rad_s)

    @property
    def field_disturbed(self) -> bool:
        return self._field.disturbed

    @property
    def rpy_rad(self) -> FloatArray:
        """(3,) roll, pitch, yaw of now."""
        roll, pitch, yaw = roll_pitch_yaw(self._level)
        return np.array([roll, pitch, wrap_pi(yaw + self._yaw_rad)])

    def step(self, sample: ImuSample) -> FloatArray:
        """Take in one sample; the attitude (3,) roll, pitch, yaw at its time (yaw 0 at the start without a magnet)."""
        rate: Three = tuple(sample.rate_frd_rad_s.tolist())
        force: Three = tuple(sample.accel_frd_m_s2.tolist())
        dt_s = 1e-6 * (sample.t_us - self._t_us)
        if self._t_us < 0 or dt_s > MAX_GAP_S:
            self._start(force)
        elif dt_s > 0.0:
            self._carry(dt_s, rate)
            self._keep_level(dt_s, force)
        if sample.mag_frd is not None:
            since_s = dt_s if self._magnet_us < 0 else 1e-6 * (sample.t_us - self._magnet_us)
            self._turn_north(min(max(since_s, 0.0), MAX_GAP_S), rate, tuple(sample.mag_frd.tolist()))
            self._magnet_us = sample.t_us
        self._bias.update(self._level, self._tuning.heading_s)
        self._t_us, self._rate = sample.t_us, rate
        return self.rpy_rad

    def _start(self, force: Three) -> None:
        """Level by this sample alone; the heading is kept (0 at first) until the magnetometer corrects it."""
        self._yaw_rad = float(self.rpy_rad[2])
        fx, fy, fz = force
        self._carried = self._level = of_tilt(math.atan2(-fy, -fz), math.atan2(fx, math.hypot(fy, fz)))
        self._levelling = IDENTITY
        self._slow = (turned(self._carried, force),) * 2
        self._age_s = self._heading_age_s = 0.0
        self._magnet_us = -1
        self._bias.restart()

    def _carry(self, dt_s: float, rate: Three) -> None:
        x, y, z = turn_between(self._rate, rate, dt_s)
        bx, by, bz = self._bias.rad_s
        self._carried = product(self._carried, rotation_by((x - bx * dt_s, y - by * dt_s, z - bz * dt_s)))

    def _keep_level(self, dt_s: float, force: Three) -> None:
        """At first the mean of all there is, then a low-pass filter."""
        self._age_s += dt_s
        gain = max(1.0 - math.exp(-2.0 * dt_s / self._tuning.tilt_s), dt_s / (dt_s + self._age_s))
        first = _nearer(self._slow[0], turned(self._carried, force), gain)
        second = _nearer(self._slow[1], first, gain)
        self._slow = (first, second)
        north, east, down = turned(self._levelling, second)
        size = math.sqrt(north * north + east * east + down * down)
        if size > MIN_FORCE_M_S2:
            # The rotation that aligns the measured vertical (-down) with the axis.
            half = math.sqrt(max(0.0, 0.5 - 0.5 * down / size))
            if half > 1e-6:
                x, y = -0.5 * east / (size * half), 0.5 * north / (size * half)
                turn: Four = (half, x, y, 0.0)
            else:
                x, y, turn = 1.0, 0.0, (0.0, 1.0, 0.0, 0.0)
            self._levelling = product(turn, self._levelling)
            self._bias.add_tilt(dt_s, 2.0 * x, 2.0 * y)
        self._level = product(self._levelling, self._carried)

    def _turn_north(self, dt_s: float, rate: Three, magnet: Three) -> None:
        north, east, down = turned(self._level, magnet)
        flat = math.hypot(north, east)
        size = math.hypot(flat, down)
        if not (MIN_HORIZONTAL * size < flat < math.inf):
            return
        turning_rad_s = math.sqrt(rate[0] ** 2 + rate[1] ** 2 + rate[2] ** 2)
        trust = self._field.trust(dt_s, size, math.asin(down / size), turning_rad_s)
        if trust == 0.0:
            return
        error = wrap_pi(-math.atan2(east, north) - self._yaw_rad)
        if self._heading_age_s == 0.0:
            self._yaw_rad += error
            self._heading_age_s = max(dt_s, 1e-3)
            return
        self._heading_age_s += dt_s
        gain = max(trust * (1.0 - math.exp(-dt_s / self._tuning.heading_s)), dt_s / self._heading_age_s)
        self._yaw_rad = wrap_pi(self._yaw_rad + gain * error)
        self._bias.add_heading(dt_s, gain * error, gain)


class AttitudeSource(Remarks):
    """Makes :class:`AhrsSample` of raw ones, and watches the tilt of an AHRS that gives its own."""

    def __init__(self) -> None:
        super().__init__()
        self._raw = AttitudeFilter()
        self._watch = AttitudeFilter(WATCH_TUNING)
        self._last: ImuSample | None = None
        self._watched_us = -WATCH_EVERY_US
        self._apart_since_us: int | None = None
        self.disagreements = 0
        """Number of times the AHRS's tilt differed from that of its gyros and accelerometers."""
        self.field_disturbances = 0
        """How often the magnetometer of a device without an attitude of its own was rejected."""
        self.disagrees = False
        self._heading_rad = math.nan
        """The AHRS's, as it was when it changed last."""
        self._turned_rad = 0.0
        """By which the gyro has turned since."""
        self._seen_us = 0
        self._off_rad = (0.0, 0.0)
        """Roll and pitch of the filter minus the living AHRS's: no step when one replaces the other."""
        self._thawed = 0
        self._frozen: tuple[float, float] | None = None
        """Headings of AHRS and filter when the AHRS's attitude froze, None while it lives."""

    def attitude(self, sample: ImuSample) -> AhrsSample:
        """The sample with an attitude. A bad one has NaN, a repeated one a repeated attitude, so that the validation
        of AHRS samples detects the cause.
        """
        if not usable(sample.rate_frd_rad_s, sample.accel_frd_m_s2):
            rpy_rad = np.full(3, np.nan)
        elif self._last is not None and (sample.t_us <= self._last.t_us or _same(sample, self._last)):
            rpy_rad = self._raw.rpy_rad
        else:
            magnet = sample.mag_frd
            if magnet is not None and not (magnet.shape == (3,) and bool(np.isfinite(magnet).all())):
                sample = replace(sample, mag_frd=None)
            disturbed = self._raw.field_disturbed
            rpy_rad = self._raw.step(sample)
            self.field_disturbances += self._raw.field_disturbed and not disturbed
            self._last = sample
        return AhrsSample(
            t_us=sample.t_us,
            rpy_rad=rpy_rad,
            rate_frd_rad_s=sample.rate_frd_rad_s,
            accel_frd_m_s2=sample.accel_frd_m_s2,
        )

    def watch(self, sample: AhrsSample) -> AhrsSample:
        """Compare the attitude of a valid AHRS sample with that from its gyros and accelerometers. The sample; with an
        attitude of the filter while its own is frozen.
        """
        frozen = self._watch_heading(sample)
        if frozen is None and sample.t_us < self._watched_us + WATCH_EVERY_US:
            return sample
        self._watched_us = sample.t_us
        own = self._watch.step(
            ImuSample(t_us=sample.t_us, rate_frd_rad_s=sample.rate_frd_rad_s, accel_frd_m_s2=sample.accel_frd_m_s2)
        )
        if frozen is not None:
            ahrs_rad, filter_rad = frozen
            (roll, pitch, yaw), (more_roll, more_pitch) = own.tolist(), self._off_rad
            turned = wrap_pi(ahrs_rad + yaw - filter_rad)
            return replace(sample, rpy_rad=np.array([roll - more_roll, pitch - more_pitch, turned]))
        roll, pitch, _ = (own - sample.rpy_rad).tolist()
        if self._thawed:
            self._off_rad = (roll, pitch)
        apart = max(abs(wrap_pi(roll)), abs(pitch)) > APART_RAD
        if not apart:
            self._apart_since_us, self.disagrees = None, False
            return sample
        if self._apart_since_us is None:
            self._apart_since_us = sample.t_us
        if not self.disagrees and sample.t_us - self._apart_since_us >= APART_US:
            self.disagrees = True
            self.disagreements += 1
        return sample

    def _watch_heading(self, sample: AhrsSample) -> tuple[float, float] | None:
        """Headings of AHRS and filter when the AHRS's attitude froze, None while it lives."""
        yaw = sample.rpy_rad.item(2)
        if yaw != self._heading_rad:
            self._heading_rad, self._turned_rad, self._seen_us = yaw, 0.0, sample.t_us
            self._thawed += 1
            if self._frozen is not None and self._thawed >= THAWED_SAMPLES:
                self._frozen = None
                self._texts.append(notices.AHRS_ATTITUDE_BACK().text)
            return self._frozen
        rate, dt_s = sample.rate_frd_rad_s.item(2), 1e-6 * (sample.t_us - self._seen_us)
        self._thawed, self._seen_us = 0, sample.t_us
        if self._frozen is None and abs(rate) > TURNING_RAD_S and dt_s < MAX_GAP_S:
            self._turned_rad += rate * dt_s
            if abs(self._turned_rad) > FROZEN_RAD:
                self._frozen = yaw + self._turned_rad, self._watch.rpy_rad.item(2)
                self._texts.append(notices.AHRS_ATTITUDE_FROZEN().text)
        return self._frozen


def usable(rate_frd_rad_s: FloatArray, accel_frd_m_s2: FloatArray) -> bool:
    """Whether gyro and accelerometer readings are within their ranges (comparisons with NaN are false)."""
    return (
        rate_frd_rad_s.shape == accel_frd_m_s2.shape == (3,)
        and within(rate_frd_rad_s.tolist(), MAX_RATE_RAD_S)
        and within(accel_frd_m_s2.tolist(), MAX_ACCEL_M_S2)
    )


def _same(a: ImuSample, b: ImuSample) -> bool:
    return bool((a.rate_frd_rad_s == b.rate_frd_rad_s).all() and (a.accel_frd_m_s2 == b.accel_frd_m_s2).all())


def _nearer(a: Three, b: Three, gain: float) -> Three:
    return a[0] + gain * (b[0] - a[0]), a[1] + gain * (b[1] - a[1]), a[2] + gain * (b[2] - a[2])
