"""Which of several senders of one kind of message is believed."""

from autopilot.mavlink.context import MavlinkPeer


class FirstSender:
    """The first one until it has been silent for a while: a client of the same system and component id is another
    one."""

    def __init__(self, silent_us: int) -> None:
        self._silent_us = silent_us
        self.peer: MavlinkPeer | None = None
        """The one that is believed, None before any."""
        self._heard_us = 0

    def takes(self, peer: MavlinkPeer, t_us: int) -> bool:
        """Whether a message of ``peer`` is believed now."""
        if self.peer not in (None, peer) and t_us - self._heard_us <= self._silent_us:
            return False
        self.peer, self._heard_us = peer, t_us
        return True
