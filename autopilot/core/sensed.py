"""Latest sample of each sensor, for displays of raw measurements."""

import math
from dataclasses import dataclass, field
from typing import Any, TypeVar

from autopilot.core.frames import FloatArray
from autopilot.core.samples import AhrsSample, ImuSample

T = TypeVar("T")

_SLOW, _FAST = 0.2, 0.1
"""Shares of a new sample at 100 Hz: about 4 Hz for what is motion, 2 Hz for the mean square of the rest."""

MOST_M_S2 = 1e4
"""A thousand g: more than any accelerometer's range."""


@dataclass(slots=True, eq=False)
class Vibration:
    """RMS of the specific force above about 4 Hz, per axis [m/s2]."""

    _mean: list[float] = field(default_factory=lambda: [math.nan] * 3)
    _square: list[float] = field(default_factory=lambda: [0.0] * 3)

    def note(self, accel_frd_m_s2: FloatArray) -> None:
        """One sample of 100 Hz; one that no sensor can measure is left out."""
        for axis, value in enumerate(accel_frd_m_s2.tolist()):
            if not abs(value) < MOST_M_S2:
                continue
            mean = self._mean[axis]
            mean = value if mean != mean else mean + _SLOW * (value - mean)
            self._mean[axis] = mean
            self._square[axis] += _FAST * ((value - mean) ** 2 - self._square[axis])

    @property
    def rms_m_s2(self) -> tuple[float, float, float]:
        """Forward, right, down."""
        x, y, z = (math.sqrt(square) for square in self._square)
        return x, y, z


@dataclass(slots=True, eq=False)
class Sensed:
    """Changed in place; None = none has come."""

    inertial: AhrsSample | ImuSample | None = None
    newest: dict[type, Any] = field(default_factory=dict)
    """Of each other kind of sample, see :meth:`of`."""
    vibration: Vibration = field(default_factory=Vibration)
    power_w: float | None = None
    """Of the battery, over half a minute."""

    def of(self, kind: type[T]) -> T | None:
        """The newest sample of a kind."""
        return self.newest.get(kind)
