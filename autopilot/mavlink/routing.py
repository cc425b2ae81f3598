"""Message routing between clients (https://mavlink.io/en/guide/routing.html), on the links of MAV_FORWARD.

Routes are learned from received packets. Broadcasts go to all other clients, addressed messages only to links on
which the target has been seen. Packets are not changed, never sent back to their source, and not forwarded twice if
they return through a network loop. SETUP_SIGNING is never forwarded.
"""

import struct
from collections.abc import Callable

from autopilot.core.clients import EVERYONE, Verbatim
from autopilot.core.messages import MavlinkFrame
from autopilot.mavlink.bounded_table import LatestUsed, RecentKeys
from autopilot.mavlink.budget import LISTS
from autopilot.mavlink.context import COMPID, Context
from autopilot.mavlink.dialect import mav
from autopilot.mavlink.inbox import Address
from autopilot.mavlink.wire import SIGNATURE_BYTES, V1, is_signed, message_id

AGAIN_US = 500_000
"""The same packet within this time is a duplicate that arrived by another route."""
MAX_KNOWN = 256
"""Components whose routes are remembered; beyond that the one silent for longest is dropped."""
MAX_PLACES = 4
"""Routes per component."""

Component = tuple[int, int]
"""System and component id."""

_SIZES = {"char": 1, "float": 4, "double": 8, **{f"{sign}int{8 * n}_t": n for n in (1, 2, 4, 8) for sign in ("", "u")}}


class Router:
    """Queues forwarded packets with all other outgoing data."""

    def __init__(self, ctx: Context, *, ours: Callable[[int], bool]) -> None:
        """``ours``: whether a component of our system is the service itself."""
        self._ctx, self._ours = ctx, ours
        self._places: LatestUsed[Component, LatestUsed[Address, None]] = LatestUsed(MAX_KNOWN)
        self._passed: RecentKeys[bytes] = RecentKeys(AGAIN_US * ctx.patience)

    def note_frame(self, address: Address, frame: bytes) -> None:
        """A complete packet with a valid checksum from an accepted sender."""
        ctx = self._ctx
        if ctx.params["MAV_FORWARD"] <= 0.0:
            return
        old = frame[0] == V1
        at = 3 if old else 5
        source, number = (frame[at], frame[at + 1]), message_id(frame)
        if source == (ctx.sysid, COMPID) or source[0] == 0:
            return
        kind = _TARGETS.get(number)
        if kind is None or number == mav.MAVLINK_MSG_ID_SETUP_SIGNING:
            return
        packet = frame[:-SIGNATURE_BYTES] if is_signed(frame) else frame
        if self._passed.knows(packet, ctx.t_us):
            return
        self._passed.add(packet, ctx.t_us)
        self._learn(source, address)
        payload = frame[6 : 6 + frame[1]] if old else frame[10 : 10 + frame[1]]
        target = tuple(payload[i] if i is not None and i < len(payload) else 0 for i in kind)
        self._pass_on(address, (target[0], target[1]), frame, old=old)

    def _learn(self, source: Component, address: Address) -> None:
        places: LatestUsed[Address, None] = self._places.touch(source, lambda: LatestUsed(MAX_PLACES))
        places[address] = None

    def _pass_on(self, address: Address, target: Component, frame: bytes, *, old: bool) -> None:
        system, component = target
        if system == 0:
            for link in tuple(self._ctx.links):
                if link != address[0]:
                    self._send(link, EVERYONE, frame, old=old)
                elif address[1] != EVERYONE:
                    self._send(link, EVERYONE, frame, old=old, beside=frozenset((address[1],)))
            return
        if system == self._ctx.sysid and component and self._ours(component):
            return
        receivers: dict[Address, None] = {}
        for known, places in self._places.items():
            if known[0] == system and component in (0, known[1]):
                receivers.update(places)
        receivers.pop(address, None)
        for link, client in receivers:
            self._send(link, client, frame, old=old)

    def _send(self, link: int, client: int, frame: bytes, *, old: bool, beside: frozenset[int] = frozenset()) -> None:
        ctx = self._ctx
        if link not in ctx.links or not ctx.has_capacity(link, LISTS) or (client == EVERYONE and link in ctx.quiet):
            return
        if not old:
            speak_old = ctx.old.get(link, frozenset())
            if client in speak_old:
                return
            beside |= speak_old
        if link in ctx.budgets:
            ctx.budgets[link].spend(len(frame))
        ctx.tx.append(MavlinkFrame(link=link, client=client, data=Verbatim(frame), beside=beside))


def _targets() -> dict[int, tuple[int | None, int | None]]:
    """Message id -> where in the payload target system and component stand, None = not in it."""
    found: dict[int, tuple[int | None, int | None]] = {}
    for number, kind in mav.mavlink_map.items():
        types = dict(zip(kind.fieldnames, kind.fieldtypes, strict=True))
        places: dict[str, int] = {}
        at = 0
        for name, length in zip(kind.ordered_fieldnames, kind.array_lengths, strict=True):
            places[name] = at
            at += _SIZES[types[name].removesuffix("_mavlink_version")] * max(length, 1)
        assert at == struct.calcsize(kind.unpacker.format), kind.msgname
        found[number] = (places.get("target_system", places.get("target")), places.get("target_component"))
    return found


_TARGETS = _targets()
