"""Bandwidth budget of a slow link: telemetry and lists use what commands and their answers leave.

A serial line of 57,600 baud carries 5,760 bytes a second. Anything beyond that waits in the line's buffer and
delays every answer behind it. Sent bytes are therefore counted; telemetry is held back until the budget allows it,
the most overdue first, so that all streams slow down together and none stops.
"""

from dataclasses import dataclass

DEPTH_S = 0.1
"""Maximum backlog in the line's buffer, as time."""
DEBT_S = 0.5
"""Maximum debt by answers; more is forgotten, because the buffer will have lost it."""
LISTS = 0.25
"""Lists (parameters) continue above this share of the budget ..."""
TELEMETRY = 0.5
"""... telemetry above this one ..."""
FILES = 0.75
"""... and files and logs take what telemetry leaves."""


@dataclass(slots=True)
class Budget:
    """One link's. ``bytes_per_s`` in the service's time."""

    bytes_per_s: float
    _level: float = 0.0
    _t_us: int = 0

    def tick(self, t_us: int) -> None:
        """Refill the budget by the time passed."""
        carried = self.bytes_per_s * max(0, t_us - self._t_us) * 1e-6
        self._level, self._t_us = min(self._level + carried, self.bytes_per_s * DEPTH_S), t_us

    def spend(self, count: int) -> None:
        self._level = max(self._level - count, -self.bytes_per_s * DEBT_S)

    def has_capacity(self, fraction: float) -> bool:
        """Whether the budget allows a message of this priority share."""
        return self._level >= fraction * self.bytes_per_s * DEPTH_S
