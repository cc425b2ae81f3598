"""Collision detection from the accelerometer."""

import math

import numpy as np

from autopilot.command.command_tuning import COLLISION
from autopilot.core.frames import FloatArray
from autopilot.core.model4 import Model4
from autopilot.core.samples import AhrsSample, ImuSample


class CollisionDetector:
    """Detects accelerations larger than thrust can cause."""

    def __init__(self, model: Model4) -> None:
        self._per_n = np.array(model.allocation)[:2] / np.array(model.mass_kg)[:2, None]
        """(2, n) acceleration ahead and sideways by each newton of each thruster."""
        self._base: tuple[float, float] | None = None
        self._began_us: int | None = None
        self._peak = 0.0

    def update(self, sample: AhrsSample | ImuSample, thrust_n: FloatArray | None, least_m_s2: float) -> bool:
        """Whether a jolt of at least that size has just ended."""
        ax, ay, _ = sample.accel_frd_m_s2.tolist()
        if self._base is None:
            self._base = (ax, ay)
            return False
        bx, by = self._base
        dx, dy = ax - bx, ay - by
        size = math.sqrt(dx * dx + dy * dy)
        if not size < 1e6:  # no reading
            return False
        if self._began_us is None:
            if size < least_m_s2:
                factor = 0.01 / COLLISION.base_time_s
                self._base = (bx + factor * dx, by + factor * dy)
                return False
            self._began_us, self._peak = sample.t_us, 0.0
        self._peak = max(self._peak, size - self._commanded(thrust_n))
        if size >= 0.5 * least_m_s2 and sample.t_us - self._began_us < COLLISION.jolt_us:
            return False
        ended = size < 0.5 * least_m_s2
        self._began_us = None
        if not ended:
            self._base = (ax, ay)
        return ended and self._peak >= least_m_s2

    def _commanded(self, thrust_n: FloatArray | None) -> float:
        """Twice the acceleration by thrust: it may have reversed within the filter's delay."""
        if thrust_n is None:
            return 0.0
        ax, ay = (self._per_n @ thrust_n).tolist()
        return 2.0 * math.hypot(ax, ay)
