"""Gyro bias from the corrections of the attitude: a Kalman filter with three states.

With a bias b of which b_known is subtracted the attitude drifts by R (b - b_known), and the corrections compensate
that behind a low-pass filter L. They turn by c = -L(R (b - b_known)), hence

    L(R) b = L(R b_known) - c

with c about north and east from the specific force and about down from the magnetometer. The form is that of Laidig
and Seel 2023 (VQF), whose vertical bias is estimated at rest only; a vehicle in the water is never at rest, and a slow
turn while hovering must not be taken for bias.
"""

import math

import numpy as np

from autopilot.core.frames import FloatArray
from autopilot.estimator.rotation import Four, Three, rows

WINDOW_S = 0.1
"""Corrections are gathered for so long, unless told otherwise."""
SIGMA_RAD_S = math.radians(0.5)
"""Of a gyro of which nothing is known."""
WALK_RAD_S_RTS = math.radians(0.02)
"""How fast it may change; what nothing tells becomes no less known than at the start."""
MAX_RAD_S = math.radians(2.0)
UNOBSERVED = 1e6
"""Variance [rad2/s2] of a correction that there was not."""


class GyroBias:
    """Gyro bias, body axes [rad/s]."""

    def __init__(self, tilt_s: float, tilt_noise: float, heading_noise: float, window_s: float = WINDOW_S) -> None:
        """``tilt_s``: of the low-pass filter for the specific force (two stages). Noises: rad/s, of means over 1 s."""
        self._window_s = window_s
        self._stage_s = 0.5 * tilt_s
        self._wait_s = tilt_s
        self._tilt_noise, self._heading_noise = tilt_noise, heading_noise
        self._p = SIGMA_RAD_S**2 * np.eye(3)
        self.rad_s: Three = (0.0, 0.0, 0.0)
        self.restart()

    def restart(self) -> None:
        """After a gap: keep the estimate, restart the low-pass filters."""
        self._age_s = 0.0
        self._slow: list[FloatArray] = []
        self._slow_heading: FloatArray | None = None
        self._heading_age_s = 0.0
        self._forget_gathered()

    def _forget_gathered(self) -> None:
        self._time_s = self._north_rad = self._east_rad = 0.0
        self._heading_s, self._heading_rad, self._heading_keep = 0.0, 0.0, 1.0

    def add_tilt(self, dt_s: float, north_rad: float, east_rad: float) -> None:
        """The level attitude was turned by so much."""
        self._time_s += dt_s
        self._north_rad += north_rad
        self._east_rad += east_rad

    def add_heading(self, dt_s: float, down_rad: float, gain: float) -> None:
        """The heading was turned by so much: by that fraction of its error."""
        self._heading_s += dt_s
        self._heading_rad += down_rad
        self._heading_keep *= 1.0 - gain

    def update(self, level_from_body: Four, heading_settled_s: float) -> None:
        """Update from the accumulated corrections if they cover enough time. The heading is used from
        ``heading_settled_s`` on.
        """
        if self._time_s < self._window_s:
            return
        self._age_s += self._time_s
        turn = np.array(rows(level_from_body))
        # Beside each row of the rotation its product with the subtracted bias.
        now = np.column_stack([turn, turn @ self.rad_s])
        gain = max(1.0 - math.exp(-self._time_s / self._stage_s), self._time_s / self._age_s)
        first, second = self._slow or (now[:2], now[:2])
        first = first + gain * (now[:2] - first)
        self._slow = [first, second + gain * (first - second)]
        correction = np.array([self._north_rad / self._time_s, self._east_rad / self._time_s, 0.0])
        variance = np.full(3, UNOBSERVED)
        if self._age_s > self._wait_s:
            variance[:2] = self._tilt_noise**2 / self._time_s
        down = now[2] if self._slow_heading is None else self._slow_heading
        if self._heading_s > 0.0:
            down = self._slow_heading = down + (1.0 - self._heading_keep) * (now[2] - down)
            self._heading_age_s += self._heading_s
            correction[2] = self._heading_rad / self._heading_s
            if self._heading_age_s > heading_settled_s:
                variance[2] = self._heading_noise**2 / self._heading_s
        self._learn(np.vstack([self._slow[1], down]), correction, variance)
        self._forget_gathered()

    def _learn(self, slow: FloatArray, correction: FloatArray, variance: FloatArray) -> None:
        below_limit = self._p.diagonal() < SIGMA_RAD_S**2
        p = self._p + np.diag(WALK_RAD_S_RTS**2 * self._time_s * below_limit)
        h, noise = slow[:, :3], np.diag(variance)
        surprise = np.clip(slow[:, 3] - correction - h @ self.rad_s, -MAX_RAD_S, MAX_RAD_S)
        spread = p @ h.T
        gain = spread @ np.linalg.inv(h @ spread + noise)
        kept = np.eye(3) - gain @ h
        self._p = kept @ p @ kept.T + gain @ noise @ gain.T  # Joseph form
        x, y, z = np.clip(self.rad_s + gain @ surprise, -MAX_RAD_S, MAX_RAD_S).tolist()
        self.rad_s = (x, y, z)
