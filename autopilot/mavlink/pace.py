"""How many packets of a file a client gets per tick.

Few at first, twice as many with every part that has arrived whole, half as many while the loop is busy, few again when
the client asks for a part again, and while the vehicle is armed: its control comes first.
"""

from dataclasses import dataclass

FIRST, MOST = 16, 112
"""Packets per tick and client, at about 40 us of a tick each, half of that in the socket. With 239 bytes (MAVFTP)
380 kB/s to 2.7 MB/s."""
BUSY = 0.6
"""Load of the loop above which a client gets fewer packets per tick."""
LOAD_US = 1_000_000
"""Time in which the load shows what a change of pace costs."""


@dataclass(slots=True)
class Pace:
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
