"""Which of several senders of one kind of message is believed."""

from autopilot.mavlink.context import MavlinkPeer


class FirstSender:
    """The first one, by whichever link, until it has been silent for a while."""

    def __init__(self, silent_us: int) -> None:
        self._silent_us = silent_us
        self.name = ""
        """Of the one that is believed, "" before any."""
        self._heard_us = 0

    def takes(self, peer: MavlinkPeer, t_us: int) -> bool:
        """Whether a message of ``peer`` is believed now."""
        if self.name not in ("", peer.name) and t_us - self._heard_us <= self._silent_us:
            return False
        self.name, self._heard_us = peer.name, t_us
        return True
