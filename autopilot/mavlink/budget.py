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
FIRST, MOST = 16, 112
"""Packets per tick and client, at about 40 us of a tick each, half of that in the socket. With 239 bytes (MAVFTP)
380 kB/s to 2.7 MB/s."""
BUSY = 0.6
"""Load of the loop above which a client gets fewer packets per tick."""
LOAD_US = 1_000_000
"""Time in which the load shows what a change of pace costs."""


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


@dataclass(slots=True)
class Pace:
    """How many packets of a file a client gets per tick.

    Few at first, twice as many with every part that has arrived whole, half as many while the loop is busy, few again
    when the client asks for a part again, and while the vehicle is armed: its control comes first."""

    packets: int = FIRST
    """Per tick."""
    _eased_us: int | None = None
    """When it was lowered for the load last."""

    def start(self) -> None:
        self.packets = FIRST

    def go_on(self, load: float, now_us: int) -> None:
        """The last part has arrived. ``load``: of the loop, 0 to 1 (no time to spare)."""
        if load <= BUSY and not self._settles(now_us):
            self.packets = min(2 * self.packets, MOST)
        else:
            self.ease(load, now_us)

    def ease(self, load: float, now_us: int) -> None:
        """Slower if the loop is busy."""
        if load >= 1.0:
            self.packets = FIRST
        elif load > BUSY and not self._settles(now_us):
            self.packets, self._eased_us = max(self.packets // 2, FIRST), now_us

    def _settles(self, now_us: int) -> bool:
        return self._eased_us is not None and now_us - self._eased_us < LOAD_US
