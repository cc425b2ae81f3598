"""Trim of the AHRS's roll and pitch by the tilt from vision.

An AHRS of this class has a slowly varying error of half a degree, which leaks 0.09 m/s^2 of gravity into the
horizontal acceleration: more than drag and thrust errors together. A pose from many markers gives the tilt to a
twentieth of a degree against the camera's mounting. The low-pass filtered difference, by the share that the mounting is
surer than the AHRS, is subtracted from later samples; without vision it decays.
"""

import math

from autopilot.core.samples import AhrsSample
from autopilot.estimator.inertial import Inertial

AHRS_SIGMA_RAD = math.radians(0.5)
"""Standard deviation of roll and pitch of an AHRS of this class."""
GAIN = 0.1
"""Share of the difference per fix (30 Hz): follows within 0.3 s and averages the noise of ten fixes."""
MAX_SIGMA_RAD = math.radians(0.4)
"""Fixes whose tilt is less certain (few markers: it is the AHRS's own then) are not used."""
MAX_DIFFERENCE_RAD = math.radians(5.0)
"""Larger differences are wrong fixes."""
FADE_TIME_S = 20.0
"""Correlation time of the AHRS's error: without vision the estimate decays with it."""
HELD_US = 500_000
"""After so long without a fix the trim does not count as fresh."""


def trimmed_share(mounting_sigma_rad: float) -> float:
    """Share of the difference between AHRS and camera that is the AHRS's, as far as is known."""
    return AHRS_SIGMA_RAD**2 / (AHRS_SIGMA_RAD**2 + mounting_sigma_rad**2)


class TiltTrim:
    """Correction of roll and pitch of the AHRS [rad]."""

    def __init__(self, mounting_sigma_rad: float = 0.0) -> None:
        self._share = trimmed_share(mounting_sigma_rad)
        self._roll = 0.0
        self._pitch = 0.0
        self._at_us = -1
        self.last_fix_us: int | None = None
        """Time of the newest fix that was used."""

    def fresh(self, t_us: int) -> bool:
        """Whether the tilt at ``t_us`` is vision's."""
        return self.last_fix_us is not None and t_us - self.last_fix_us <= HELD_US

    def learn(self, raw: Inertial, roll_rad: float, pitch_rad: float, sigma_rad: float, t_us: int) -> None:
        """A fix at ``t_us`` saw this tilt while the AHRS, untrimmed, showed ``raw``."""
        d_roll, d_pitch = raw.raw_tilt_rad[0] - roll_rad, raw.raw_tilt_rad[1] - pitch_rad
        if not (sigma_rad <= MAX_SIGMA_RAD and max(abs(d_roll), abs(d_pitch)) <= MAX_DIFFERENCE_RAD):
            return
        gain = GAIN if self.fresh(t_us) else 0.5
        self._roll += gain * (self._share * d_roll - self._roll)
        self._pitch += gain * (self._share * d_pitch - self._pitch)
        self.last_fix_us = t_us

    def at(self, sample: AhrsSample) -> tuple[float, float]:
        """Roll and pitch to be taken off ``sample``."""
        if not self.fresh(sample.t_us):
            fade = math.exp(-1e-6 * max(0, sample.t_us - self._at_us) / FADE_TIME_S)
            self._roll, self._pitch = fade * self._roll, fade * self._pitch
        self._at_us = sample.t_us
        return self._roll, self._pitch
