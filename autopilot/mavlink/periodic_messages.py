"""Periodic messages: identity, HEARTBEAT, home, and notices about ignored clients."""

from collections import deque
from dataclasses import replace

from autopilot.core import operator_messages as notices
from autopilot.core.geodesy import GeodeticPosition
from autopilot.mavlink.api import FlightMode
from autopilot.mavlink.bounded_table import LatestUsed
from autopilot.mavlink.context import Context, MavlinkPeer
from autopilot.mavlink.inbox import MessageInbox
from autopilot.mavlink.signing import Refusals
from autopilot.mavlink.status import StatusMessages
from autopilot.mavlink.telemetry import NavigationMessages

FLOOD_SAY_US = 1_000_000
"""Minimum interval between reports of floods, over all clients."""
REFUSALS_SAY_US = 10_000_000
"""Interval of reports of rejected frames."""
HEARTBEAT_US = 1_000_000
"""HEARTBEAT at 1 Hz (https://mavlink.io/en/services/heartbeat.html)."""
GREET_AFTER_US = 2_000_000
"""A ground station does not listen yet at the moment in which it has found a vehicle (QGroundControl)."""
MAX_PEERS = 64
"""Clients remembered as greeted; beyond that the oldest is dropped."""


class PeriodicMessages:
    """Messages sent periodically, one method per kind."""

    def __init__(
        self, ctx: Context, status: StatusMessages, telemetry: NavigationMessages, intake: MessageInbox
    ) -> None:
        self._ctx, self._status, self._telemetry, self._intake = ctx, status, telemetry, intake
        self._reported_refusals = Refusals()
        self._refusals_us: int | None = None
        self._flood_us: int | None = None
        self._greeted: LatestUsed[MavlinkPeer, None] = LatestUsed(MAX_PEERS)
        self._to_greet: deque[tuple[int, MavlinkPeer]] = deque()
        """When a greeting is due, and whose."""
        self._heartbeat_us = 0
        self._mode_shown: tuple[bool, FlightMode, FlightMode] | None = None
        self._place_shown: tuple[GeodeticPosition, GeodeticPosition] | None = None

    def forget(self, link: int) -> None:
        """A link has been closed; the next client on it is greeted again."""
        for peer in [peer for peer in self._greeted if peer.link == link]:
            del self._greeted[peer]

    def greet(self, peer: MavlinkPeer) -> None:
        """The true name, once to every client, a moment after its first word."""
        if peer in self._greeted:
            return
        self._greeted[peer] = None
        if len(self._to_greet) < MAX_PEERS:
            self._to_greet.append((self._ctx.t_us + round(GREET_AFTER_US * self._ctx.patience), peer))

    def greetings(self) -> None:
        """Greet new clients, and report arming reasons that no other message shows."""
        identity = self._ctx.identity
        while self._to_greet and self._ctx.t_us >= self._to_greet[0][0]:
            _, peer = self._to_greet.popleft()
            if peer.link in self._ctx.quiet:
                continue
            greeting = notices.GREETING(name=identity.name, version=identity.version, note=self._ctx.profile.note)
            self._ctx.text(greeting, peer)
            for reason in self._ctx.view.refusals:
                self._ctx.text(notices.GREETING_REFUSAL(reason=reason), peer)

    def heartbeat(self) -> None:
        """1 Hz, and at once when armed state or mode change."""
        ctx, view = self._ctx, self._ctx.view
        shown = (view.armed, view.mode, view.intended_mode)
        if shown == self._mode_shown and ctx.t_us < self._heartbeat_us:
            return
        ctx.broadcast(self._status.heartbeat())
        if shown != self._mode_shown:
            ctx.broadcast(self._status.current_mode())
        self._mode_shown = shown
        self._heartbeat_us = ctx.t_us + HEARTBEAT_US

    def place_again(self) -> None:
        """Send origin and home again on request."""
        self._place_shown = None

    def place(self) -> None:
        """Origin and home when they change."""
        view = self._ctx.view
        place = (view.origin, view.home)
        if place == self._place_shown:
            return
        self._place_shown = place
        self._ctx.broadcast(self._telemetry.gps_global_origin())
        self._ctx.broadcast(self._telemetry.home_position())

    def refusals(self) -> None:
        """Report rejected frames with the remedy, rate-limited."""
        ctx, now, reported = self._ctx, self._ctx.signing.refused, self._reported_refusals
        reported.ahead = now.ahead
        if now == reported or (self._refusals_us is not None and ctx.t_us < self._refusals_us + REFUSALS_SAY_US):
            return
        self._refusals_us = ctx.t_us
        self._reported_refusals = replace(now)
        if now.unknown_key > reported.unknown_key:
            ctx.say(notices.KEY_UNKNOWN())
        elif now.unsigned > reported.unsigned:
            ctx.say(notices.UNSIGNED())
        else:
            ctx.say(notices.SIGNED_TOO_OLD())
        ctx.log(notices.FRAMES_REFUSED(counts=now))

    def flood(self) -> None:
        """Report clients that send too much, rate-limited."""
        ctx = self._ctx
        if self._flood_us is not None and ctx.t_us < self._flood_us + FLOOD_SAY_US:
            return
        flood = self._intake.take_flood(ctx.t_us)
        if flood is None:
            return
        self._flood_us = ctx.t_us
        ctx.say(notices.FLOODED(sender=flood.sender))
        ctx.log(
            notices.FLOODED_BYTES(sender=flood.sender, link=flood.link, lost=flood.dropped, total=flood.dropped_total)
        )
