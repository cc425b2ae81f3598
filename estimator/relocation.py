"""When to give in: fixes that are rejected one after the other but agree among themselves mean that we are wrong."""

from collections import deque

import numpy as np

from autopilot.core.frames import FloatArray
from estimator.aiding import REJECT_COUNT

SPREAD_M = 0.15
SPREAD_RAD = 0.15
"""Rejected fixes agree if their distances from the prediction lie within these."""
WINDOW_US = 3_000_000
"""Older rejections do not count."""


class Relocation:
    """Watches the residuals of rejected fixes."""

    def __init__(self) -> None:
        self._residuals: deque[tuple[int, FloatArray]] = deque(maxlen=REJECT_COUNT)

    def accepted(self) -> None:
        """A fix passed the gate."""
        self._residuals.clear()

    def rejected(self, t_us: int, residual: FloatArray) -> bool:
        """A fix with this residual (4,) did not pass. True: believe it and move there."""
        self._residuals.append((t_us, residual))
        if len(self._residuals) < REJECT_COUNT or abs(t_us - self._residuals[0][0]) > WINDOW_US:
            return False
        values = np.array([r for _, r in self._residuals])
        spread = values.max(axis=0) - values.min(axis=0)
        return bool(spread[:3].max() <= SPREAD_M and spread[3] <= SPREAD_RAD)
