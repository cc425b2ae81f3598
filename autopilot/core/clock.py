"""Time is an input: the runtime passes the time of each tick, and no other module reads a clock."""

from typing import Protocol

TICK_US = 10_000
"""Base tick: 100 Hz, the rate of the AHRS."""

DECISION_TICKS = 5
"""Interval of the NMPC, of decisions and of clients: 20 Hz, counted in ticks, not timed."""


class Clock(Protocol):
    def now_us(self) -> int:
        """Microseconds since the clock started, never going back."""
        ...

    def left_s(self, t_us: int) -> float:
        """Real seconds until ``t_us``, 0 when it has passed or time does not wait."""
        ...

    def wait_until(self, t_us: int) -> int:
        """Return at ``t_us`` (at once when it has passed); the result is now_us()."""
        ...
