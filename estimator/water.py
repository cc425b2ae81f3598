"""How much the current changes along the vehicle's track: met while fixes show it, expected where they are missing."""

import math

from autopilot.core.frames import FloatArray
from autopilot.estimator.estimator_tuning import WATER
from autopilot.estimator.states import CURRENT_EAST, CURRENT_NORTH, VEL_EAST, VEL_NORTH


class WaterVariation:
    """Mean square change of the current's north and east components per second of a random walk."""

    def __init__(self) -> None:
        self._square = WATER.first_per_m**2
        """Mean square of what spans show: large changes count for more than quiet water [(m^2/s^2 / m)^2]."""
        self._spans = WATER.first_spans
        self._start: tuple[int, float, float] | None = None
        """Time and current at the beginning of a span,"""
        self._track_m = 0.0
        """and the way since."""

    def meet(self, t_us: int, dt_s: float, x: FloatArray) -> None:
        """A moment with fixes: state (21,), ``dt_s`` after the last one."""
        north, east = x.item(CURRENT_NORTH), x.item(CURRENT_EAST)
        self._track_m += dt_s * _speed(x)
        if self._start is None:
            self._start, self._track_m = (t_us, north, east), 0.0
            return
        start_us, start_north, start_east = self._start
        if t_us - start_us < WATER.span_us:
            return
        change = 0.5 * ((north - start_north) ** 2 + (east - start_east) ** 2)
        self._spans = min(self._spans + 1.0, WATER.most_spans)
        self._square += ((change / self._track_m) ** 2 - self._square) / self._spans
        self._start = None

    def lose(self) -> None:
        """No fixes: what the current does now is not seen."""
        self._start = None

    def variance_per_s(self, x: FloatArray) -> float:
        """By which each component becomes uncertain per second [m^2/s^2 / s]."""
        return math.sqrt(self._square) * _speed(x)


def _speed(x: FloatArray) -> float:
    """Over ground [m/s]; the water itself is never at rest."""
    return WATER.least_m_s + math.hypot(x.item(VEL_NORTH), x.item(VEL_EAST))
