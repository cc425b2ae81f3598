"""First-order response of the thrusters, each with its own time constant."""

import math
from collections.abc import Iterable, Sequence

import numpy as np

from autopilot.core.frames import FloatArray
from autopilot.core.thrusters import Thruster


class Response:
    """F' = (command - F) / T per thruster."""

    def __init__(self, time_constants_s: Iterable[float]) -> None:
        self.time_constants_s = tuple(time_constants_s)
        self._alike = len(set(self.time_constants_s)) == 1
        self.mean_s = self.time_constants_s[0] if self._alike else float(np.mean(self.time_constants_s))
        """What one number can say of all."""

    @classmethod
    def of(cls, thrusters: Iterable[Thruster]) -> "Response":
        return cls(thruster.drive.time_constant_s for thruster in thrusters)

    def fraction(self, dt_s: float) -> float | FloatArray:
        """1 - exp(-dt / T), the fraction of a step that is reached after ``dt_s``; scalar or (n,)."""
        if self._alike:
            return 1.0 - math.exp(-dt_s / self.mean_s)
        return np.array([1.0 - math.exp(-dt_s / each) for each in self.time_constants_s])

    def after(self, dt_s: float, acting: Sequence[float], command: Sequence[float]) -> list[float]:
        """Thrust (n,) after that time from the present (n,) and the command (n,); lists are faster than arrays here."""
        fraction = self.fraction(dt_s)
        fractions = [fraction] * len(acting) if isinstance(fraction, float) else fraction.tolist()
        return [f + s * (to - f) for f, to, s in zip(acting, command, fractions, strict=True)]
