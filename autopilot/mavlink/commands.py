"""Command protocol: COMMAND_LONG and COMMAND_INT, each with a COMMAND_ACK.

https://mavlink.io/en/services/command.html. Commands are answered at once, except those that complete later: these
get IN_PROGRESS until the final result. A retransmitted action gets the first answer again and is not executed
twice; requests are answered again. Unused parameters may be 0 or NaN.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from pymavlink.dialects.v20 import development as mav

from autopilot.core import operator_messages as notices
from autopilot.mavlink.api import CommandReply, CommandResult
from autopilot.mavlink.bounded_table import LatestUsed
from autopilot.mavlink.context import COMPID, Context, MavlinkPeer
from autopilot.mavlink.wire import Message

REPEAT_US = 10_000_000
"""Time for which a COMMAND_LONG with confirmation > 0 counts as a retransmission of the first."""
FIRST_PROGRESS_US = 300_000
PROGRESS_US = 1_000_000
"""Delay after the command, and interval, of IN_PROGRESS to a waiting client."""
MAX_REMEMBERED = 64
"""Clients whose last command is remembered; beyond that the oldest is dropped."""

UNSUPPORTED = CommandReply(result=CommandResult.UNSUPPORTED)

_FRAME_NOT_GIVEN = mav.MAV_FRAME_GLOBAL
_DEG_E7_FRAMES = frozenset(
    (
        mav.MAV_FRAME_GLOBAL,
        mav.MAV_FRAME_GLOBAL_INT,
        mav.MAV_FRAME_GLOBAL_RELATIVE_ALT,
        mav.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT,
    )
)
_INT_UNKNOWN = frozenset((0x7FFF_FFFF, -0x8000_0000))
"""COMMAND_INT's "no position" (INT32_MAX; MAVSDK casts NaN to INT32_MIN on some platforms)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Call:
    """A received command, independent of its message type and scaling."""

    peer: MavlinkPeer
    command: int
    params: tuple[float, float, float, float]
    x: float
    """Latitude [deg] or local north [m]; NaN = not given."""
    y: float
    z: float
    frame: int
    """MAV_FRAME; GLOBAL for COMMAND_LONG."""
    exact: bool
    """COMMAND_INT: positions are not rounded to float32 degrees."""

    def param(self, number: int) -> float:
        """param1..param4; NaN reads as 0 (both mean "not used")."""
        value = self.params[number - 1]
        return value if value == value else 0.0

    @property
    def param5(self) -> float:
        """param5 of a command without a place, which COMMAND_INT has as it is; NaN reads as 0."""
        value = round(self.x * _scale(self.frame)) if self.exact and self.x == self.x else self.x
        return value if value == value else 0.0

    def whole(self, number: int) -> int | None:
        """param1..param4 as a 32-bit integer, None if it is none."""
        value = self.param(number)
        if not -(2.0**31) <= value < 2.0**32 or value != int(value):
            return None
        return int(value)


@dataclass(frozen=True, slots=True)
class Reply:
    """An answer, and messages that follow it."""

    answer: CommandReply
    messages: tuple[Message, ...] = ()
    later: Callable[[], CommandReply] | None = None
    """Called on every tick for the final result while ``answer`` and its result are IN_PROGRESS."""


Handler = Callable[[Call], Reply]


@dataclass(frozen=True, slots=True, kw_only=True)
class CommandRow:
    handler: Handler
    action: bool
    """Changes something: not to be executed twice."""
    setting: bool = False
    """A query that sets something for its client: a late copy of an earlier one is ignored."""
    carrier: CommandResult | None = None
    """COMMAND_INT_ONLY when COMMAND_LONG will not do."""


@dataclass(frozen=True, slots=True)
class _Remembered:
    key: tuple[object, ...]
    at_us: int
    answer: CommandReply


@dataclass(slots=True)
class _Waiting:
    """A client whose command is in progress."""

    later: Callable[[], CommandReply]
    reported_us: int
    """Time of the next IN_PROGRESS."""


def denied(reason: str) -> Reply:
    return Reply(CommandReply(result=CommandResult.DENIED, reason=reason))


def action(handler: Handler) -> CommandRow:
    """Row of a command that changes state (in contrast to a query)."""
    return CommandRow(handler=handler, action=True)


def request(handler: Handler) -> CommandRow:
    """Row of a command without side effects; a retransmission is answered again."""
    return CommandRow(handler=handler, action=False)


def setting(handler: Handler) -> CommandRow:
    """Row of a command with which a client arranges something for itself, whoever is in control."""
    return CommandRow(handler=handler, action=False, setting=True)


def refused(reason: str) -> CommandRow:
    """A command that the vehicle never carries out."""
    return action(lambda call: denied(reason))


def _scale(frame: int) -> float:
    """Of COMMAND_INT's x and y, per degree or metre."""
    return 1e7 if frame in _DEG_E7_FRAMES else 1e4


def call_of(peer: MavlinkPeer, msg: Message) -> Call:
    """A COMMAND_LONG or COMMAND_INT as a call."""
    params = (msg.param1, msg.param2, msg.param3, msg.param4)
    if msg.get_msgId() == mav.MAVLINK_MSG_ID_COMMAND_LONG:
        return Call(
            peer=peer,
            command=msg.command,
            params=params,
            x=msg.param5,
            y=msg.param6,
            z=msg.param7,
            frame=_FRAME_NOT_GIVEN,
            exact=False,
        )
    x, y = (float("nan") if v in _INT_UNKNOWN else v / _scale(msg.frame) for v in (msg.x, msg.y))
    return Call(peer=peer, command=msg.command, params=params, x=x, y=y, z=msg.z, frame=msg.frame, exact=True)


class CommandProtocol:
    def __init__(
        self,
        ctx: Context,
        table: Mapping[int, CommandRow],
        keeps_out: Callable[[Call], str] = lambda call: "",
        source: int = COMPID,
    ) -> None:
        """``keeps_out``: why a caller may not change anything now, "" = he may. ``source``: which of our components
        answers."""
        self._ctx = ctx
        self._source = source
        self._keeps_out = keeps_out
        self.table = table
        self._last: LatestUsed[MavlinkPeer, _Remembered] = LatestUsed(MAX_REMEMBERED)
        self._waiting: LatestUsed[tuple[MavlinkPeer, int], _Waiting] = LatestUsed(MAX_REMEMBERED)
        """By client and command."""

    def on_command(self, peer: MavlinkPeer, msg: Message) -> None:
        call = call_of(peer, msg)
        entry = self.table.get(call.command)
        if entry is None:
            self._ack(peer, call.command, UNSUPPORTED)
            return
        if entry.carrier is not None and not call.exact:
            self._ack(peer, call.command, CommandReply(result=entry.carrier))
            return
        copy = (entry.action or entry.setting) and self._ctx.is_copy(peer, msg)
        if not entry.action:
            if not copy:
                self._reply(peer, call.command, entry.handler(call))
            return
        kept_out = self._keeps_out(call)
        if kept_out:
            self._reply(peer, call.command, Reply(CommandReply(result=CommandResult.NOT_IN_CONTROL, reason=kept_out)))
            return
        key = (call.command, repr((call.params, call.x, call.y, call.z)), call.frame, call.exact)
        before = self._last.get(peer)
        if before is not None and before.key == key and (copy or self._is_repeat(before, msg)):
            self._ack(peer, call.command, before.answer)
            return
        if copy:
            return
        reply = entry.handler(call)
        self._waiting.pop((peer, call.command), None)
        self._last[peer] = _Remembered(key, self._ctx.t_us, reply.answer)
        if reply.later is not None and reply.answer.result is CommandResult.IN_PROGRESS:
            self._waiting[peer, call.command] = _Waiting(reply.later, self._ctx.t_us + FIRST_PROGRESS_US)
            return
        self._reply(peer, call.command, reply)

    def tick(self) -> None:
        """Answer commands whose result was pending."""
        for (peer, command), waiting in list(self._waiting.items()):
            answer = waiting.later()
            if answer.result is not CommandResult.IN_PROGRESS:
                del self._waiting[peer, command]
                self._remember(peer, command, answer)
                self._reply(peer, command, Reply(answer))
            elif self._ctx.t_us >= waiting.reported_us:
                waiting.reported_us = self._ctx.t_us + PROGRESS_US
                self._ack(peer, command, answer)

    def _remember(self, peer: MavlinkPeer, command: int, answer: CommandReply) -> None:
        """Keep the final answer for retransmissions."""
        before = self._last.get(peer)
        if before is not None and before.key[0] == command:
            self._last[peer] = replace(before, answer=answer)

    def _is_repeat(self, before: _Remembered, msg: Message) -> bool:
        age_us = self._ctx.t_us - before.at_us
        return getattr(msg, "confirmation", 0) > 0 and age_us <= REPEAT_US * self._ctx.patience

    def _reply(self, peer: MavlinkPeer, command: int, reply: Reply) -> None:
        self._ack(peer, command, reply.answer)
        for message in reply.messages:
            self._ctx.send(peer, message, self._source)
        if reply.answer.reason and reply.answer.result is not CommandResult.ACCEPTED:
            self._ctx.say(notices.REFUSED(reason=reply.answer.reason), peer)

    def _ack(self, peer: MavlinkPeer, command: int, answer: CommandReply) -> None:
        self._ctx.send(
            peer,
            mav.MAVLink_command_ack_message(command, answer.result, 0, 0, peer.sysid, peer.compid),
            self._source,
        )
