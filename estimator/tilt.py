"""Trim of the AHRS's roll and pitch by the tilt from vision.

An AHRS of this class has a slowly varying error of half a degree, which leaks 0.09 m/s^2 of gravity into the
horizontal acceleration: more than drag and thrust errors together. A pose from many markers gives the tilt to a
twentieth of a degree against the camera's mounting, which is constant. A Kalman filter per axis, with both errors as
states, tells them apart: at first by their variances, then by their change. The AHRS's is taken off later samples;
without vision it decays.
"""

import math

import numpy as np

from autopilot.core.samples import AhrsSample
from autopilot.estimator.inertial import Inertial, tilt_rates

AHRS_SIGMA_RAD = math.radians(0.5)
"""Standard deviation of roll and pitch of an AHRS of this class."""
FIX_SIGMA_RAD = math.radians(0.2)
"""Added to a fix's own: errors of one picture and the next are alike. The trim then follows within 0.3 s."""
MAX_SIGMA_RAD = math.radians(0.4)
"""Fixes whose tilt is less certain (few markers: it is the AHRS's own then) are not used."""
LASTING = 2.0
"""What a wrong stamp makes of a swing is alike for half of it: so much more than an error of one picture."""
MAX_DIFFERENCE_RAD = math.radians(5.0)
"""Larger differences are wrong fixes."""
FADE_TIME_S = 20.0
"""Correlation time of the AHRS's error: without vision the estimate decays with it."""
HELD_US = 500_000
"""After so long without a fix the trim does not count as fresh."""


class TiltTrim:
    """Correction of roll and pitch of the AHRS [rad]."""

    def __init__(self, mounting_sigma_rad: float = 0.0) -> None:
        """``mounting_sigma_rad``: of the camera's roll and pitch against the AHRS's axes."""
        self._errors = np.zeros((2, 2))
        """Rows: of the AHRS, of the mounting; columns: roll, pitch."""
        self._p = np.diag([AHRS_SIGMA_RAD**2, mounting_sigma_rad**2])
        """Covariance of the rows, the same for both columns."""
        self.last_fix_us: int | None = None
        """Time of the newest fix that was used."""

    @property
    def difference_rad(self) -> float:
        """Tilt of the camera against the AHRS, whosever error it is."""
        return float(math.hypot(*self._errors.sum(axis=0)))

    def fresh(self, t_us: int) -> bool:
        """Whether the tilt at ``t_us`` is vision's."""
        return self.last_fix_us is not None and t_us - self.last_fix_us <= HELD_US

    def learn(
        self,
        raw: Inertial,
        roll_rad: float,
        pitch_rad: float,
        sigma_rad: float,
        t_us: int,
        stamp_sigma_s: float = 0.0,
    ) -> None:
        """A fix at ``t_us``, as far as is known, saw this tilt shortly after the AHRS, untrimmed, showed ``raw``."""
        rates, after_s = tilt_rates(raw), 1e-6 * (t_us - raw.t_us)
        seen = np.array([raw.raw_tilt_rad[0] - roll_rad, raw.raw_tilt_rad[1] - pitch_rad]) + after_s * rates
        sigma_rad = math.hypot(sigma_rad, LASTING * stamp_sigma_s * float(np.abs(rates).max()))
        if not (sigma_rad <= MAX_SIGMA_RAD and float(np.abs(seen).max()) <= MAX_DIFFERENCE_RAD):
            return
        fade = self._fade(t_us)
        self._errors[0] *= fade
        keep = np.diag([fade, 1.0])
        p = keep @ self._p @ keep
        p[0, 0] += (1.0 - fade * fade) * AHRS_SIGMA_RAD**2
        across = p.sum(axis=1)
        gain = across / (across.sum() + sigma_rad**2 + FIX_SIGMA_RAD**2)
        self._errors += np.outer(gain, seen - self._errors.sum(axis=0))
        self._p = p - np.outer(gain, across)
        self.last_fix_us = t_us if self.last_fix_us is None else max(t_us, self.last_fix_us)

    def at(self, sample: AhrsSample) -> tuple[float, float]:
        """Roll and pitch to be taken off ``sample``."""
        fade = self._fade(sample.t_us)
        return fade * self._errors.item(0, 0), fade * self._errors.item(0, 1)

    def _fade(self, t_us: int) -> float:
        """What is left at ``t_us`` of the AHRS's error at the newest fix."""
        since_us = 0 if self.last_fix_us is None else max(0, t_us - self.last_fix_us)
        return math.exp(-1e-6 * since_us / FADE_TIME_S)
