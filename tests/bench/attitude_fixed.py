"""What the attitude filter is measured against: the explicit complementary filter with gains that never change.

    R' = R (w - b + kp s)x,   b' = -ki s,   s = sum of v x (R' v_ref)

(Mahony, Hamel and Pflimlin 2008, eq. 32), the magnetometer turning about the vertical only.
"""

import math
from dataclasses import dataclass

import numpy as np

from autopilot.core.frames import FloatArray
from autopilot.core.samples import ImuSample
from autopilot.estimator.inertial import cross
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

QUICK_S, QUICK_GAIN_S = 2.0, 2.0
"""At first the gains are higher, so that the first sample's error does not last."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FixedGains:
    """1/s, 1/s, 1/s2"""

    tilt: float = 0.4
    heading: float = 0.05
    bias: float = 0.002


class FixedGainFilter:
    """Samples in the order of time go in, attitudes come out."""

    def __init__(self, gains: FixedGains) -> None:
        self._gains = gains
        self._q: Four = IDENTITY
        self._t_us = self._magnet_us = -1
        self._begin_us = 0
        self._rate: Three = (0.0, 0.0, 0.0)
        self._bias: Three = (0.0, 0.0, 0.0)

    def step(self, sample: ImuSample) -> FloatArray:
        """The attitude (3,) roll, pitch, yaw at the sample's time."""
        rate: Three = tuple(sample.rate_frd_rad_s.tolist())
        force: Three = tuple(sample.accel_frd_m_s2.tolist())
        magnet: Three | None = None if sample.mag_frd is None else tuple(sample.mag_frd.tolist())
        if self._t_us < 0:
            self._start(sample.t_us, force, magnet)
        else:
            self._advance(1e-6 * (sample.t_us - self._t_us), sample.t_us, rate, force, magnet)
        self._t_us, self._rate = sample.t_us, rate
        return np.array(roll_pitch_yaw(self._q))

    def _start(self, t_us: int, force: Three, magnet: Three | None) -> None:
        fx, fy, fz = force
        self._begin_us = self._magnet_us = t_us
        self._q = of_tilt(math.atan2(-fy, -fz), math.atan2(fx, math.hypot(fy, fz)))
        if magnet is not None:
            self._q = product(rotation_by((0.0, 0.0, self._heading_error(magnet))), self._q)

    def _heading_error(self, magnet: Three) -> float:
        north, east, _ = turned(self._q, magnet)
        return -math.atan2(east, north)

    def _advance(self, dt_s: float, t_us: int, rate: Three, force: Three, magnet: Three | None) -> None:
        gains = self._gains
        quick = t_us - self._begin_us < 1e6 * QUICK_S
        size = math.sqrt(force[0] ** 2 + force[1] ** 2 + force[2] ** 2)
        w, x, y, z = self._q
        down = turned((w, -x, -y, -z), (0.0, 0.0, 1.0))
        measured = (-force[0] / size, -force[1] / size, -force[2] / size)
        gain = dt_s * (QUICK_GAIN_S if quick else gains.tilt)
        ex, ey, ez = cross(measured, down)
        about = 0.0
        if magnet is not None:
            since_s = 1e-6 * (t_us - self._magnet_us)
            about = since_s * (QUICK_GAIN_S if quick else gains.heading) * math.sin(self._heading_error(magnet))
            self._magnet_us = t_us
        px, py, pz = gain * ex + about * down[0], gain * ey + about * down[1], gain * ez + about * down[2]
        if not quick:
            follow = gains.bias / gains.tilt
            bx, by, bz = self._bias
            self._bias = (bx - follow * px, by - follow * py, bz - follow * pz)
        bx, by, bz = self._bias
        tx, ty, tz = turn_between(self._rate, rate, dt_s)
        turn = (tx - bx * dt_s + px, ty - by * dt_s + py, tz - bz * dt_s + pz)
        self._q = product(self._q, rotation_by(turn))
