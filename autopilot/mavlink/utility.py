"""PING, TIMESYNC, SYSTEM_TIME."""

from autopilot.mavlink.context import Context, MavlinkPeer
from autopilot.mavlink.dialect import extra, mav
from autopilot.mavlink.first_sender import FirstSender
from autopilot.mavlink.wire import Message

EARLIEST_US, LATEST_US = 1_420_070_400_000_000, 4_102_444_800_000_000
"""2015 and 2100, Unix time: a ground station that gives another time has none itself."""
STALE_US = 10_000_000
"""After so long without a word from the one that gave the time another one may."""


class Utility:
    """Handlers of messages that need no state but the time of day."""

    def __init__(self, ctx: Context) -> None:
        self._ctx = ctx
        self.utc_offset_us: int | None = None
        """Unix time minus the service's time [us], as a ground station gave it; None before."""
        self._timed_by = FirstSender(STALE_US)

    def on_ping(self, peer: MavlinkPeer, msg: Message) -> None:
        """PING: target 0/0 is a request; an addressed one is an answer and must not be answered."""
        if msg.target_system == 0 and msg.target_component == 0:
            self._ctx.send(peer, mav.MAVLink_ping_message(msg.time_usec, msg.seq, peer.sysid, peer.compid))

    def on_timesync(self, peer: MavlinkPeer, msg: Message) -> None:
        """TIMESYNC: tc1 = 0 is a request, answered with our time in nanoseconds."""
        if msg.tc1 == 0:
            answer = extra.MAVLink_timesync_message(self._now_ns(), msg.ts1, peer.sysid, peer.compid)
            self._ctx.send(peer, answer)

    def timesync(self) -> Message | None:
        """TIMESYNC: a request. Its answer is not needed here; a reader of the log learns how long it took."""
        return extra.MAVLink_timesync_message(0, self._now_ns())

    def _now_ns(self) -> int:
        """The service's time as TIMESYNC carries it (int64); never 0, which would make a request of an answer."""
        return min(max(self._ctx.t_us * 1000, 1), (1 << 63) - 1)

    def on_system_time(self, peer: MavlinkPeer, msg: Message) -> None:
        """SYSTEM_TIME of a ground station: kept for boards without a clock. Of two the first is believed, and no other
        vehicle, which tells its own."""
        if not EARLIEST_US <= msg.time_unix_usec < LATEST_US or peer.compid == mav.MAV_COMP_ID_AUTOPILOT1:
            return
        if self._timed_by.takes(peer, self._ctx.t_us):
            self.utc_offset_us = msg.time_unix_usec - self._ctx.t_us

    def system_time(self) -> Message | None:
        """SYSTEM_TIME: Unix time is 0 while unknown."""
        unix_us = 0 if self.utc_offset_us is None else self.utc_offset_us + self._ctx.t_us
        return mav.MAVLink_system_time_message(unix_us, self._ctx.boot_ms)
