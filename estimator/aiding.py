"""Life cycle and counts of one aiding sensor: it starts, goes on, stops when silent, is reset when it must be.

Every source goes through the same: gate, counts, report. What a reset means is the only difference. A source with an
offset that is a state of the filter (heading, laser, depth) or that measures one kind of state alone (velocity) has
these states reopened, when it has been rejected for a while and its residuals agree among themselves. A source of
positions moves the whole filter (:mod:`autopilot.estimator.relocation`).
"""

from collections import deque
from collections.abc import Iterator

import numpy as np

from autopilot.core.frames import FloatArray
from autopilot.core.messages import AidState, AidStatus, MarkerFit
from autopilot.estimator.filter_core import Innovation

START_COUNT = 5
"""Measurements used in a row before a sensor counts as active."""
REJECT_COUNT = 12
"""Measurements rejected in a row before a sensor counts as rejecting (0.4 s of camera)."""
TIMEOUT_US = 1_000_000
"""Silence after which a sensor counts as stopped."""

AGREE_SIGMA = 3.0
"""Rejected residuals agree when they lie within so many of their expected deviations of their mean."""

COUNTS = ("received", "fused", "rejected", "late", "duplicate", "future", "malformed", "resets")
"""What is counted of every sensor."""


class Aid:
    """Bookkeeping of one sensor."""

    def __init__(self, sensor: str, own: slice | None = None) -> None:
        """``own``: states that are reopened when the sensor is reset, None = it is not reset here."""
        self.sensor = sensor
        self.own = own
        self.counts = dict.fromkeys(COUNTS, 0)
        self.rejected_in_row = 0
        self.last_fused_us: int | None = None
        """Time of validity of the newest measurement that was used."""
        self._fused_in_row = 0
        self._state = AidState.STOPPED
        self._last_us: int | None = None
        self._rejected: deque[FloatArray] = deque(maxlen=REJECT_COUNT)

    def state(self, now_us: int) -> AidState:
        """Where the sensor is in its life cycle."""
        if self._last_us is None or now_us - self._last_us > TIMEOUT_US:
            self._state = AidState.STOPPED
            self._fused_in_row = 0
        return self._state

    def judged(
        self, t_us: int, now_us: int, innovation: Innovation, fused: bool, fit: MarkerFit | None = None
    ) -> AidStatus:
        """Count one measurement that met its gate or did not, and report it; ``fit``: of one that is of markers."""
        self.state(now_us)
        self._last_us = now_us
        if fused:
            self.counts["fused"] += 1
            if self.rejected_in_row:
                self.rejected_in_row = 0
                self._rejected.clear()
            self._fused_in_row += 1
            if self.last_fused_us is None or t_us > self.last_fused_us:
                self.last_fused_us = t_us
        else:
            self.counts["rejected"] += 1
            self.rejected_in_row += 1
            self._rejected.append(innovation.y)
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
            fit=fit,
        )

    def agreed_miss(self, innovation: Innovation) -> float | None:
        """Mean square of the residuals if the sensor counts as rejecting and they agree, None if there is no case."""
        if self.own is None or self.rejected_in_row < REJECT_COUNT:
            return None
        residuals = np.array(self._rejected)
        mean = residuals.mean(axis=0)
        if (np.abs(residuals - mean) > AGREE_SIGMA * np.sqrt(innovation.variance)).any():
            return None
        return float((mean * mean).max())

    def reset(self, now_us: int) -> None:
        """Begin anew: what follows is judged afresh."""
        self.counts["resets"] += 1
        self.rejected_in_row = self._fused_in_row = 0
        self._rejected.clear()
        self._state = AidState.STARTING
        self._last_us = now_us

    def named_counts(self) -> Iterator[tuple[str, int]]:
        """Counts as ``sensor.what``."""
        for what, count in self.counts.items():
            yield f"{self.sensor}.{what}", count


def _three(values: FloatArray) -> FloatArray:
    """First three components (3,), missing ones 0."""
    result = np.zeros(3)
    result[: len(values)] = values[:3]
    return result
