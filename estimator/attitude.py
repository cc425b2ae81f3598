"""Attitude from raw gyros, accelerometers and magnetometer: an adaptive complementary filter on the rotation group.

    R' = R (w - b + kp s)x,   b' = -ki s,   s = sum of v x (R' v_ref)

(explicit complementary filter: Mahony, Hamel, Pflimlin 2008, eq. 32). The accelerometer tells down, with a gain that
shrinks while the vehicle accelerates: then | |f| - g | is large and f does not point up. The magnetometer turns the
estimate about the vertical only, so that magnetic disturbance never tilts it. Plain floats: at 100 Hz numpy's calls
would cost more than the arithmetic.
"""

import math
from dataclasses import replace

import numpy as np

from autopilot.core.frames import FloatArray, wrap_pi
from autopilot.core.samples import AhrsSample, ImuSample
from estimator.inertial import GRAVITY_M_S2, MAX_ACCEL_M_S2, MAX_RATE_RAD_S, cross

Three = tuple[float, float, float]

KP_TILT_RAD_S = 0.2
"""Correction per rad of tilt error at rest: time constant of 5 s, 0.61 deg rms on trial 10 of the BROAD data."""
KP_HEADING_RAD_S = 0.1
KI_S2 = 0.002
"""Gyro bias follows in 1.5 minutes; faster, and accelerations of the vehicle and magnetic fields leak into it."""
SWAY_M_S2 = 1.0
"""Excess | |f| - g | at which the gain for tilt is halved. Smaller ones leave the gyros alone for too long in steady
swaying: 1.7 deg at 0.5 m/s2, 4.6 deg at 0.2 m/s2 on the same trial, 0.9 deg without adaptation."""
SWAY_MEMORY_S = 0.5
"""How long an excess is remembered: |f| passes through g in every oscillation."""
REST_MEMORY_S = 20.0
"""The size of f at rest is not quite g (scale, bias): its slow mean is what an excess is counted from."""
QUICK_S = 2.0
QUICK_KP_RAD_S = 2.0
"""At first the gains are higher, so that the first sample's error does not last."""
MAX_BIAS_RAD_S = 0.1
MAX_GAP_S = 0.5
"""Over a longer gap nothing is integrated: the filter starts anew from the sample behind it."""
MIN_HORIZONTAL = 0.05
"""Least horizontal share of the magnetic field that tells a heading (65 deg of dip leave 0.4)."""

APART_RAD = math.radians(5.0)
APART_US = 1_000_000
"""An AHRS whose tilt is so far from the filter's for so long disagrees with its own gyros and accelerometers."""


class AttitudeFilter:
    """Samples in the order of time go in, attitudes come out. Bad samples must be kept away (:meth:`usable`)."""

    def __init__(self, kp_rad_s: float = KP_TILT_RAD_S, kp_heading_rad_s: float = KP_HEADING_RAD_S) -> None:
        self._kp_rad_s, self._kp_heading_rad_s = kp_rad_s, kp_heading_rad_s
        self._t_us = -1
        self._age_s = 0.0
        self._q = (1.0, 0.0, 0.0, 0.0)
        self._rate: Three = (0.0, 0.0, 0.0)
        self._bias: Three = (0.0, 0.0, 0.0)
        self._sway_m_s2 = 0.0
        self._rest_m_s2 = GRAVITY_M_S2

    @property
    def bias_rad_s(self) -> FloatArray:
        """(3,) of the gyros, body axes."""
        return np.array(self._bias)

    @property
    def rpy_rad(self) -> FloatArray:
        """(3,) roll, pitch, yaw of now."""
        w, x, y, z = self._q
        return np.array(
            [
                math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)),
                math.asin(max(-1.0, min(1.0, 2.0 * (w * y - z * x)))),
                math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)),
            ]
        )

    def step(self, sample: ImuSample) -> FloatArray:
        """Take in one sample; the attitude (3,) roll, pitch, yaw at its time (yaw 0 at the start without a magnet)."""
        rate: Three = tuple(sample.rate_frd_rad_s.tolist())
        force: Three = tuple(sample.accel_frd_m_s2.tolist())
        magnet: Three | None = None if sample.mag_frd is None else tuple(sample.mag_frd.tolist())
        dt_s = 1e-6 * (sample.t_us - self._t_us)
        if self._t_us < 0 or dt_s > MAX_GAP_S:
            self._start(force, magnet)
        elif dt_s > 0.0:
            self._advance(dt_s, rate, force, magnet)
        self._t_us, self._rate = sample.t_us, rate
        return self.rpy_rad

    def _start(self, force: Three, magnet: Three | None) -> None:
        """Level by this sample alone; the heading stays what it was (0 at first) without a magnetometer."""
        yaw = float(self.rpy_rad[2])
        fx, fy, fz = force
        roll, pitch = math.atan2(-fy, -fz), math.atan2(fx, math.hypot(fy, fz))
        self._q = _quaternion(roll, pitch, yaw)
        self._age_s = 0.0
        if magnet is not None:
            self._q = _quaternion(roll, pitch, yaw - (self._heading_error(magnet) or 0.0))

    def _advance(self, dt_s: float, rate: Three, force: Three, magnet: Three | None) -> None:
        self._age_s += dt_s
        quick = self._age_s < QUICK_S
        down = self._down()
        size = math.sqrt(force[0] ** 2 + force[1] ** 2 + force[2] ** 2)
        tilt: Three = (0.0, 0.0, 0.0)
        if size > 0.5 * GRAVITY_M_S2:
            felt = (-force[0] / size, -force[1] / size, -force[2] / size)
            gain = (QUICK_KP_RAD_S if quick else self._kp_rad_s) * self._trust(size, dt_s)
            ex, ey, ez = cross(felt, down)
            tilt = (gain * ex, gain * ey, gain * ez)
        error = None if magnet is None else self._heading_error(magnet)
        turn = 0.0 if error is None else -(QUICK_KP_RAD_S if quick else self._kp_heading_rad_s) * math.sin(error)
        push = (tilt[0] + turn * down[0], tilt[1] + turn * down[1], tilt[2] + turn * down[2])
        if not quick:
            follow = KI_S2 / self._kp_rad_s * dt_s
            self._bias = (
                _within(self._bias[0] - follow * push[0]),
                _within(self._bias[1] - follow * push[1]),
                _within(self._bias[2] - follow * push[2]),
            )
        bx, by, bz = self._bias
        self._turn(
            dt_s * (0.5 * (rate[0] + self._rate[0]) - bx + push[0]),
            dt_s * (0.5 * (rate[1] + self._rate[1]) - by + push[1]),
            dt_s * (0.5 * (rate[2] + self._rate[2]) - bz + push[2]),
        )

    def _trust(self, size_m_s2: float, dt_s: float) -> float:
        """1 at rest, 1/2 at SWAY_M_S2; an excess fades out over SWAY_MEMORY_S."""
        self._rest_m_s2 += dt_s / (REST_MEMORY_S + dt_s) * (size_m_s2 - self._rest_m_s2)
        excess_m_s2 = abs(size_m_s2 - self._rest_m_s2)
        self._sway_m_s2 = max(excess_m_s2, self._sway_m_s2 * math.exp(-dt_s / SWAY_MEMORY_S))
        return 1.0 / (1.0 + (self._sway_m_s2 / SWAY_M_S2) ** 2)

    def _down(self) -> Three:
        """The world's down in body axes."""
        w, x, y, z = self._q
        return 2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)

    def _heading_error(self, magnet: Three) -> float | None:
        """By how much our heading is too large by the magnetometer; None where the field is vertical or missing."""
        w, x, y, z = self._q
        mx, my, mz = magnet
        north = (1.0 - 2.0 * (y * y + z * z)) * mx + 2.0 * (x * y - w * z) * my + 2.0 * (x * z + w * y) * mz
        east = 2.0 * (x * y + w * z) * mx + (1.0 - 2.0 * (x * x + z * z)) * my + 2.0 * (y * z - w * x) * mz
        size = math.sqrt(mx * mx + my * my + mz * mz)
        flat = math.hypot(north, east)
        return math.atan2(east, north) if flat > MIN_HORIZONTAL * size else None

    def _turn(self, ax: float, ay: float, az: float) -> None:
        """Turn by a small rotation vector in body axes."""
        angle = math.sqrt(ax * ax + ay * ay + az * az)
        share = 0.5 if angle < 1e-9 else math.sin(0.5 * angle) / angle
        c, i, j, k = math.cos(0.5 * angle), share * ax, share * ay, share * az
        w, x, y, z = self._q
        w, x, y, z = (
            w * c - x * i - y * j - z * k,
            w * i + x * c + y * k - z * j,
            w * j - x * k + y * c + z * i,
            w * k + x * j - y * i + z * c,
        )
        norm = math.sqrt(w * w + x * x + y * y + z * z)
        self._q = (w / norm, x / norm, y / norm, z / norm)


class AttitudeSource:
    """Makes :class:`AhrsSample` of raw ones, and watches the tilt of an AHRS that gives its own."""

    def __init__(self) -> None:
        self._raw = AttitudeFilter()
        self._watch = AttitudeFilter()
        self._last: ImuSample | None = None
        self._watched_us = -1
        self._apart_since_us: int | None = None
        self.disagreements = 0
        """How often the AHRS's tilt left its own gyros' and accelerometers'."""
        self.disagrees = False

    def attitude(self, sample: ImuSample) -> AhrsSample:
        """The sample with an attitude. A bad one goes through with NaN; one that repeats repeats the attitude, too, so
        that whoever judges AHRS samples sees what is wrong with it."""
        if not usable(sample.rate_frd_rad_s, sample.accel_frd_m_s2):
            rpy_rad = np.full(3, np.nan)
        elif self._last is not None and (sample.t_us <= self._last.t_us or _same(sample, self._last)):
            rpy_rad = self._raw.rpy_rad
        else:
            magnet = sample.mag_frd
            if magnet is not None and not (magnet.shape == (3,) and bool(np.isfinite(magnet).all())):
                sample = replace(sample, mag_frd=None)
            rpy_rad = self._raw.step(sample)
            self._last = sample
        return AhrsSample(
            t_us=sample.t_us,
            rpy_rad=rpy_rad,
            rate_frd_rad_s=sample.rate_frd_rad_s,
            accel_frd_m_s2=sample.accel_frd_m_s2,
        )

    def watch(self, sample: AhrsSample) -> None:
        """Compare a good sample's tilt with what its gyros and accelerometers say."""
        if sample.t_us <= self._watched_us:
            return
        self._watched_us = sample.t_us
        own = self._watch.step(
            ImuSample(t_us=sample.t_us, rate_frd_rad_s=sample.rate_frd_rad_s, accel_frd_m_s2=sample.accel_frd_m_s2)
        )
        roll, pitch, _ = (own - sample.rpy_rad).tolist()
        apart = max(abs(wrap_pi(roll)), abs(pitch)) > APART_RAD
        if not apart:
            self._apart_since_us, self.disagrees = None, False
            return
        if self._apart_since_us is None:
            self._apart_since_us = sample.t_us
        if not self.disagrees and sample.t_us - self._apart_since_us >= APART_US:
            self.disagrees = True
            self.disagreements += 1


def usable(rate_frd_rad_s: FloatArray, accel_frd_m_s2: FloatArray) -> bool:
    """Whether gyros and accelerometers read what they can read (comparisons with NaN are false)."""
    return (
        rate_frd_rad_s.shape == accel_frd_m_s2.shape == (3,)
        and all(-MAX_RATE_RAD_S <= a <= MAX_RATE_RAD_S for a in rate_frd_rad_s.tolist())
        and all(-MAX_ACCEL_M_S2 <= a <= MAX_ACCEL_M_S2 for a in accel_frd_m_s2.tolist())
    )


def _same(a: ImuSample, b: ImuSample) -> bool:
    return bool((a.rate_frd_rad_s == b.rate_frd_rad_s).all() and (a.accel_frd_m_s2 == b.accel_frd_m_s2).all())


def _within(bias_rad_s: float) -> float:
    return max(-MAX_BIAS_RAD_S, min(MAX_BIAS_RAD_S, bias_rad_s))


def _quaternion(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    cr, sr = math.cos(0.5 * roll), math.sin(0.5 * roll)
    cp, sp = math.cos(0.5 * pitch), math.sin(0.5 * pitch)
    cy, sy = math.cos(0.5 * yaw), math.sin(0.5 * yaw)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )
