"""Unit of a tick's CPU time: filterpy's ``predict()`` with 16 states, in the same run.

Machines differ, and one machine from minute to minute; a ratio to a small fixed piece of similar work (numpy on
small matrices, called from Python) is comparable between days.
"""

import time
from collections.abc import Sequence

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter

from autopilot.core.marks import LoopPart

STATES = 16
EVERY_TICKS, CALLS = 25, 10


class PredictClock:
    """Called once per tick, measures periodically; averages the stages of the ticks."""

    def __init__(self) -> None:
        self._filter = ExtendedKalmanFilter(STATES, 4)
        self._filter.x = np.zeros(STATES)
        self._spent_s: list[float] = []
        self._parts_s = np.zeros(len(LoopPart))
        self._ticks = 0

    def tick(self, part_s: Sequence[float]) -> None:
        """Add the stage times of a tick."""
        self._parts_s += part_s
        if self._ticks % EVERY_TICKS == 0:
            begin_s = time.thread_time()
            for _ in range(CALLS):
                self._filter.predict()
            self._spent_s.append((time.thread_time() - begin_s) / CALLS)
        self._ticks += 1

    @property
    def predict_us(self) -> float:
        """Mean CPU time of one ``predict()``."""
        return 1e6 * float(np.mean(self._spent_s))

    @property
    def parts_ms(self) -> dict[LoopPart, float]:
        """Mean per tick, the largest first; parts that take nothing left out."""
        mean_ms = 1e3 * self._parts_s / max(self._ticks, 1)
        parts = {part: float(mean_ms[part]) for part in LoopPart if mean_ms[part] > 0.0}
        return dict(sorted(parts.items(), key=lambda each: -each[1]))
