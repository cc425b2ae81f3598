"""Echoes from the floor: multiples come back after twice the range."""

from collections import deque
from typing import NamedTuple

LEAST_CONFIDENCE = 0.5
ECHOES_MOST, ECHOES_US = 8, 4_000_000
"""An echo is compared with so many before it, of so long."""
TWICE_FRACTION = 0.2
"""An echo is a multiple when it lies this near to twice another one: share of its range, for noise and what the vehicle
has climbed in between."""


class Compared(NamedTuple):
    """An echo beside those before it."""

    before: int
    """Number of them."""
    at_half: int
    """How many of them lie at half its range."""


class RecentEchoes:
    def __init__(self) -> None:
        self._received: deque[tuple[int, float]] = deque(maxlen=ECHOES_MOST)
        """Time and range."""

    def add(self, t_us: int, range_m: float) -> Compared:
        """One more, first echo or not."""
        lately = [other_m for then_us, other_m in self._received if 0 <= t_us - then_us <= ECHOES_US]
        self._received.append((t_us, range_m))
        near_m = TWICE_FRACTION * range_m
        return Compared(len(lately), sum(abs(range_m - 2.0 * other_m) < near_m for other_m in lately))
