"""Life cycle and counts of one aiding sensor."""

from collections.abc import Iterator

import numpy as np

from autopilot.core.frames import FloatArray
from autopilot.core.messages import AidState, AidStatus
from estimator.core import Innovation

START_COUNT = 5
"""Measurements used in a row before a sensor counts as active."""
REJECT_COUNT = 12
"""Measurements rejected in a row before a sensor counts as rejecting (0.4 s of camera)."""
TIMEOUT_US = 1_000_000
"""Silence after which a sensor counts as stopped."""

_COUNTS = ("received", "fused", "rejected", "late", "duplicate", "future", "malformed")


class Aid:
    """Bookkeeping of one sensor."""

    def __init__(self, sensor: str) -> None:
        self.sensor = sensor
        self.counts = dict.fromkeys(_COUNTS, 0)
        self.rejected_in_row = 0
        self.last_fused_us: int | None = None
        """Time of validity of the newest measurement that was used."""
        self._fused_in_row = 0
        self._state = AidState.STOPPED
        self._last_us: int | None = None

    def state(self, now_us: int) -> AidState:
        """Where the sensor is in its life cycle."""
        if self._last_us is None or now_us - self._last_us > TIMEOUT_US:
            self._state = AidState.STOPPED
            self._fused_in_row = 0
        return self._state

    def judged(self, t_us: int, now_us: int, innovation: Innovation, fused: bool) -> AidStatus:
        """Count one measurement that met its gate or did not, and report it."""
        self.state(now_us)
        self._last_us = now_us
        if fused:
            self.counts["fused"] += 1
            self.rejected_in_row = 0
            self._fused_in_row += 1
            self.last_fused_us = t_us if self.last_fused_us is None else max(t_us, self.last_fused_us)
        else:
            self.counts["rejected"] += 1
            self.rejected_in_row += 1
            self._fused_in_row = 0
        if self.rejected_in_row >= REJECT_COUNT:
            self._state = AidState.REJECTING
        elif self._fused_in_row >= START_COUNT:
            self._state = AidState.ACTIVE
        elif self._state is AidState.STOPPED:
            self._state = AidState.STARTING
        return AidStatus(
            t_us=t_us,
            sensor=self.sensor,
            innovation=_three(innovation.y),
            innovation_var=_three(innovation.variance),
            test_ratio=innovation.test_ratio,
            fused=fused,
            state=self._state,
            age_s=1e-6 * (now_us - t_us),
        )

    def named_counts(self) -> Iterator[tuple[str, int]]:
        """Counts as ``sensor.what``."""
        for what, count in self.counts.items():
            yield f"{self.sensor}.{what}", count


def _three(values: FloatArray) -> FloatArray:
    """First three components (3,), missing ones 0."""
    result = np.zeros(3)
    n = min(3, len(values))
    result[:n] = values[:n]
    return result
