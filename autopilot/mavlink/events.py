"""MAVLink events: EVENT, CURRENT_EVENT_SEQUENCE, REQUEST_EVENT (https://mavlink.io/en/services/events.html).

Every client gets every event once; one that has lost some asks for them again, in its own time.
"""

from functools import reduce
from operator import or_

from autopilot.core.arming_reasons import ALL_MODES, COMPONENT_OF, ArmingReason, HealthComponent
from autopilot.core.messages import Failsafe
from autopilot.mavlink.bounded_table import LatestUsed
from autopilot.mavlink.budget import TELEMETRY
from autopilot.mavlink.context import MAX_TEXT_CHARS, Context, MavlinkPeer
from autopilot.mavlink.dialect import extra
from autopilot.mavlink.event_metadata import (
    ARMING_CHECK_LAYOUT,
    ARMING_CHECK_SUMMARY,
    ARMING_REASON,
    HEALTH_LAYOUT,
    HEALTH_SUMMARY,
    REASON_LAYOUT,
    TEXT_CODES,
)
from autopilot.mavlink.event_text import spelled
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
FIRST_US = 1_500_000
"""First report after the start: until then clients of the run before learn that numbers begin anew."""
NEWS_US = 500_000
"""Least interval of reports: that in which the reasons are found (:mod:`autopilot.command.commander`)."""
SAME_RESULT_US = 2_000_000
"""Least interval of reports that change words and numbers only, which may flicker; PX4's reports keep it too."""
MOST_REASONS = 16
"""Of a report; vehicles with more have larger worries."""
LINES = 3
"""Events that a long reason takes at most."""
ERROR, PROTOCOL = 3, 8
"""Log levels of libevents; events of the second are not shown."""
_CHUNK = 0
"""A report is in one piece."""


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


class ArmingEvents:
    """Reports reasons against arming as MAVLink events, by the health and arming check protocol of libevents.

    A report is a summary of the arming checks, the reasons and a summary of the components' health. A new one is sent
    when what it says has changed, and on request."""

    def __init__(self, ctx: Context, events: Events) -> None:
        self._ctx, self._events = ctx, events
        self._reported: tuple[tuple[ArmingReason, ...], int, bool] | None = None
        """Reasons, failsafes and whether there is a power monitor, as of the last report."""
        self._result: tuple[int, ...] = ()
        """Its bits."""
        self._due_us = round(FIRST_US * ctx.patience)
        self._words_us = 0
        self._asked = False

    def report(self) -> None:
        """Send a report at the next opportunity, though nothing has changed."""
        self._asked = True

    def tick(self) -> None:
        ctx, view = self._ctx, self._ctx.view
        state = view.arming_reasons, view.failsafes, view.power is None
        if ctx.t_us < self._due_us or (state == self._reported and not self._asked):
            return
        result = self._bits()
        if result == self._result and not self._asked:
            words = self._reported is None or view.arming_reasons != self._reported[0]
            if not words or ctx.t_us < self._words_us:
                return
        self._asked, self._reported, self._result = False, state, result
        self._due_us, self._words_us = (ctx.t_us + round(us * ctx.patience) for us in (NEWS_US, SAME_RESULT_US))
        self._send(view.arming_reasons[:MOST_REASONS], *result)

    def _bits(self) -> tuple[int, int, int, int]:
        """Modes that can be armed and run; components with reasons, that are present, with active failsafes."""
        view = self._ctx.view
        modes = reduce(or_, (reason.modes for reason in view.arming_reasons), ALL_MODES & 0)
        failing = {COMPONENT_OF[rule] for rule in Failsafe if view.failsafes >> rule & 1}
        present = set(HealthComponent) - {HealthComponent.NONE}
        if view.power is None:
            present.discard(HealthComponent.BATTERY)
        reasons = {reason.component for reason in view.arming_reasons}
        return int(ALL_MODES & ~modes), _set(reasons), _set(present), _set(failing)

    def _send(self, reasons: tuple[ArmingReason, ...], able: int, wrong: int, present: int, failing: int) -> None:
        emit = self._events.emit
        emit(ARMING_CHECK_SUMMARY, PROTOCOL, ARMING_CHECK_LAYOUT.pack(_CHUNK, wrong, 0, able, able))
        for reason in reasons:
            for text in spelled(self._ctx.numbered(reason.text)[:MAX_TEXT_CHARS], TEXT_CODES, LINES):
                emit(ARMING_REASON, ERROR, REASON_LAYOUT.pack(reason.modes, reason.component, text))
        emit(HEALTH_SUMMARY, PROTOCOL, HEALTH_LAYOUT.pack(_CHUNK, present, failing, 0))


def _set(components: set[HealthComponent]) -> int:
    return sum(1 << component for component in components)
