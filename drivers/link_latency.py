"""Latency of a flight controller's link, by TIMESYNC (https://mavlink.io/en/services/timesync.html).

Arrivals alone do not show a constant latency: it looks like another setting of the device's clock. A round trip does:
the clock's reading in the answer is taken half of it before the answer comes, wherever its latency lies within.
"""

from collections import deque
from typing import NamedTuple

EVERY_US, FIRST_EVERY_US = 500_000, 100_000
"""Between requests, and until there are enough."""
ENOUGH = 5
KEPT_US = 15_000_000
"""Quartzes drift by no more than 7 ms meanwhile."""
ANSWER_US = 2_000_000
"""A later answer does not count."""
PENDING = 32
SLACK_US = 20_000.0
"""Beyond half a round trip: two polls, rounding. What differs by more is another setting of the clock."""
DIRECT_US = 10_000.0
"""Latency of a cable, loop time included, which is part of the vehicle file's ``latency_s``."""


class _RoundTrip(NamedTuple):
    t_us: int
    took_us: int
    ahead_us: float
    """Our time minus the device's."""


class LinkLatency:
    def __init__(self, span_us: int) -> None:
        """``span_us``: the counter in the device's measurements begins anew after this."""
        self._span_us = span_us
        self._asked: deque[int] = deque(maxlen=PENDING)
        self._trips: deque[_RoundTrip] = deque()

    def due(self, t_us: int) -> bool:
        """Whether to send a request now, whose ts1 is this time [ns]."""
        every_us = EVERY_US if len(self._trips) >= ENOUGH else FIRST_EVERY_US
        if self._asked and t_us - self._asked[-1] < every_us:
            return False
        self._asked.append(t_us)
        return True

    def take(self, t_us: int, tc1_ns: int, ts1_ns: int) -> None:
        """A TIMESYNC of the flight controller: an answer to one of ours, or something else."""
        asked_us = ts1_ns // 1000
        if tc1_ns <= 0 or asked_us not in self._asked or not 0 <= t_us - asked_us <= ANSWER_US:
            return
        trip = _RoundTrip(t_us, t_us - asked_us, 0.5 * (asked_us + t_us) - 1e-3 * tc1_ns)
        best = self._best
        if best is not None and abs(best.ahead_us - trip.ahead_us) > 0.5 * (best.took_us + trip.took_us) + SLACK_US:
            self._trips.clear()
        self._trips.append(trip)
        while t_us - self._trips[0].t_us > KEPT_US:
            self._trips.popleft()

    @property
    def _best(self) -> _RoundTrip | None:
        return min(self._trips, key=lambda trip: trip.took_us) if self._trips else None

    @property
    def longest_us(self) -> int:
        """The longest of the last round trips."""
        return max((trip.took_us for trip in self._trips), default=0)

    def beyond_us(self, ahead_us: float) -> float:
        """Latency beyond that of a cable [us] that is part of a difference of clocks by arrivals (our time minus the
        device's). 0 while it is not known.
        """
        best = self._best
        if best is None:
            return 0.0
        half = 0.5 * self._span_us
        latency_us = (ahead_us - best.ahead_us + half) % self._span_us - half
        # Not of its last answer's clock (a restart): with the next one it is known again.
        if not -0.5 * best.took_us - SLACK_US <= latency_us <= ANSWER_US:
            return 0.0
        return max(0.0, latency_us - DIRECT_US)
