"""Detection of magnetic disturbance.

The check of Laidig and Seel 2023 (VQF) with their limits: norm and dip angle of the field are compared with the
reference. Another field becomes the reference after it has been constant for some time with rotation.
"""

import math

from autopilot.estimator.estimator_tuning import MAGNETIC

DIP_RAD = math.radians(10.0)
"""Up to so much it is the same field."""
NEW_RATE_RAD_S = math.radians(5.0)
"""So long another field has to stay alike while the device turns at this rate or faster; time of slower turning counts
for less. Iron that turns with the device shows another size and dip in every direction."""

Field = tuple[float, float]
"""Size in any unit, dip [rad]."""


class FieldWatch:
    """Readings in the order of time go in; how far to trust each comes out."""

    def __init__(self) -> None:
        self._now: Field | None = None
        self._known: Field = (0.0, 0.0)
        self._candidate: Field | None = None
        self._known_s = 0.0
        self._same_s = MAGNETIC.same_after_s
        self._alike_s = 0.0
        self._other_s = 0.0

    @property
    def disturbed(self) -> bool:
        """Whether the last reading differs from the reference field."""
        return self._same_s < MAGNETIC.same_after_s

    def trust(self, dt_s: float, size: float, dip_rad: float, rate_rad_s: float) -> float:
        """1 for the reference field, 0 for another one; ``rate_rad_s``: angular rate of the device."""
        if self._now is None:
            self._now = self._known = (size, dip_rad)
        reading = (min(size, MAGNETIC.most_ratio * self._known[0]), dip_rad)
        now = self._now = _nearer(self._now, reading, 1.0 - math.exp(-dt_s / MAGNETIC.smooth_s))
        self._same_s = self._same_s + dt_s if _alike(now, self._known) else 0.0
        if self.disturbed:
            return self._other(dt_s, now, rate_rad_s)
        self._candidate = None
        self._known_s += dt_s
        gain = max(1.0 - math.exp(-dt_s / MAGNETIC.known_s), dt_s / max(self._known_s, dt_s, 1e-9))
        self._known = _nearer(self._known, now, gain)
        self._other_s = max(0.0, self._other_s - 2.0 * dt_s)
        return 1.0

    def _other(self, dt_s: float, now: Field, rate_rad_s: float) -> float:
        self._other_s += dt_s
        if self._candidate is None or not _alike(now, self._candidate):
            self._candidate, self._alike_s = now, 0.0
        self._candidate = _nearer(self._candidate, now, 1.0 - math.exp(-dt_s / MAGNETIC.known_s))
        self._alike_s += dt_s * min(1.0, rate_rad_s / NEW_RATE_RAD_S)
        if self._alike_s >= MAGNETIC.new_after_s:
            self._known, self._same_s = self._candidate, MAGNETIC.same_after_s
            return 1.0
        return MAGNETIC.impatient_trust if self._other_s >= MAGNETIC.patience_s else 0.0


def _alike(a: Field, b: Field) -> bool:
    return abs(a[0] - b[0]) <= MAGNETIC.size_fraction * b[0] and abs(a[1] - b[1]) <= DIP_RAD


def _nearer(a: Field, b: Field, gain: float) -> Field:
    return a[0] + gain * (b[0] - a[0]), a[1] + gain * (b[1] - a[1])
