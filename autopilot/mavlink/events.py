"""MAVLink events: EVENT, CURRENT_EVENT_SEQUENCE, REQUEST_EVENT (https://mavlink.io/en/services/events.html).

Every client gets every event once; one that has lost some asks for them again, in its own time.
"""

from autopilot.mavlink.bounded_table import LatestUsed
from autopilot.mavlink.budget import TELEMETRY
from autopilot.mavlink.context import Context, MavlinkPeer
from autopilot.mavlink.dialect import extra
from autopilot.mavlink.wire import Message

KEPT = 128
"""Events that can be asked for again: several reports of arming checks."""
MAX_CLIENTS = 16
"""Clients whose requests wait; beyond that those of the oldest are dropped."""
RESENT_PER_TICK = 4
"""To each client."""
RESET_EVERY_US = 500_000
"""Interval of the announcement that numbers begin anew, until the first event."""
_ARGUMENT_BYTES = 40
"""EVENT.arguments."""
_RESET = 1
"""MAV_EVENT_CURRENT_SEQUENCE_FLAGS_RESET."""
_NUMBERS = 0xFFFF


class Events:
    """Sends events and keeps the last ones."""

    def __init__(self, ctx: Context) -> None:
        self._ctx = ctx
        self._kept: dict[int, Message] = {}
        """By sequence number, the oldest first."""
        self._latest = 0
        self._resend: LatestUsed[MavlinkPeer, dict[int, None]] = LatestUsed(MAX_CLIENTS)
        """Numbers that clients wait for, in order."""
        self._reset_us = 0

    def emit(self, event: int, log_level: int, arguments: bytes) -> None:
        """Send an event to all clients. A link without capacity goes without: its clients will ask for it."""
        ctx = self._ctx
        self._latest = (self._latest + 1) & _NUMBERS
        packed = list(arguments.ljust(_ARGUMENT_BYTES, b"\0"))
        levels = log_level << 4 | log_level
        message = extra.MAVLink_event_message(0, 0, event, ctx.boot_ms, self._latest, levels, packed)
        self._kept[self._latest] = message
        if len(self._kept) > KEPT:
            del self._kept[next(iter(self._kept))]
        for link in ctx.links:
            if link not in ctx.quiet and ctx.has_capacity(link, TELEMETRY):
                ctx.send(link, message)

    def current_sequence(self) -> Message:
        """CURRENT_EVENT_SEQUENCE. Before the first event it says that numbers begin anew: a client goes on from 0."""
        return extra.MAVLink_current_event_sequence_message(self._latest, 0 if self._kept else _RESET)

    def on_request(self, peer: MavlinkPeer, msg: Message) -> None:
        """REQUEST_EVENT: events are sent on the following ticks. One answer says that the first of them is not there
        any more (or never was); the next event to come is not missing."""
        first, following = msg.first_sequence, (self._latest + 1) & _NUMBERS
        count = (msg.last_sequence - first & _NUMBERS) + 1
        wanted = [number for number in self._kept if (number - first & _NUMBERS) < count]
        if first not in self._kept and first != following:
            oldest = next(iter(self._kept), following)
            unavailable = extra.MAV_EVENT_ERROR_REASON_UNAVAILABLE
            self._ctx.send(
                peer,
                extra.MAVLink_response_event_error_message(peer.sysid, peer.compid, first, oldest, unavailable),
            )
        if wanted:
            self._resend.touch(peer, dict).update(dict.fromkeys(wanted))

    @property
    def sending(self) -> bool:
        """Whether a client waits for events."""
        return bool(self._resend)

    def tick(self) -> None:
        ctx = self._ctx
        if not self._kept and ctx.t_us >= self._reset_us:
            self._reset_us = ctx.t_us + RESET_EVERY_US
            ctx.broadcast(self.current_sequence())
        for peer, waiting in tuple(self._resend.items()):
            for number in tuple(waiting)[:RESENT_PER_TICK]:
                if not ctx.has_capacity(peer.link, TELEMETRY):
                    break
                del waiting[number]
                if number in self._kept:
                    ctx.send(peer, self._kept[number])
            if not waiting or peer.link not in ctx.links:
                del self._resend[peer]
