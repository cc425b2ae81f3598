"""Operator control: one ground station owns control after requesting it; others are read-only.

MAV_CMD_REQUEST_OPERATOR_CONTROL and CONTROL_STATUS of development.xml, single-owner mode. Without an owner every
station may command; with one, changes by others are refused (NOT_IN_CONTROL, DENIED, or a text). A ground station
is identified by its system id, which only signing authenticates.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

from autopilot.core import operator_messages as notices
from autopilot.mavlink.api import ACCEPTED, CommandReply, CommandResult
from autopilot.mavlink.commands import Call, CommandRow, Reply, denied
from autopilot.mavlink.context import Context, MavlinkPeer
from autopilot.mavlink.dialect import command_ids, extra, mav, message_ids
from autopilot.mavlink.wire import Message

REQUEST = int(extra.MAV_CMD_REQUEST_OPERATOR_CONTROL)
STATUS_ID = int(extra.MAVLINK_MSG_ID_CONTROL_STATUS)

OPEN = message_ids(
    "HEARTBEAT PING TIMESYNC SYSTEM_TIME COMMAND_LONG COMMAND_INT PARAM_REQUEST_LIST PARAM_REQUEST_READ"
    " PARAM_EXT_REQUEST_READ PARAM_EXT_REQUEST_LIST MISSION_REQUEST_LIST MISSION_REQUEST_INT MISSION_REQUEST"
    " MISSION_REQUEST_PARTIAL_LIST MISSION_ACK FILE_TRANSFER_PROTOCOL LOG_REQUEST_LIST LOG_REQUEST_DATA"
    " LOG_REQUEST_END REQUEST_DATA_STREAM REQUEST_EVENT VISION_POSITION_ESTIMATE ODOMETRY GLOBAL_POSITION_INT"
    " ADSB_VEHICLE AIS_VESSEL OBSTACLE_DISTANCE"
)
"""Messages accepted from everybody: reading, rates, time, measurements of others. Commands are checked one by one.
All others, unknown ones included, are reserved to the owner."""
GRAVE = message_ids("LOG_ERASE SETUP_SIGNING")
"""Irreversible messages. All clients are informed of the sender."""
GRAVE_COMMANDS = command_ids("PREFLIGHT_REBOOT_SHUTDOWN PREFLIGHT_STORAGE")
"""The same of commands."""
GUARD = "MAV_CTRL_NEEDED"
"""Parameter: whether irreversible changes need an owner, also while there is none. It guards itself."""
_PLAN = message_ids("MISSION_COUNT MISSION_ITEM_INT MISSION_ITEM MISSION_CLEAR_ALL MISSION_WRITE_PARTIAL_LIST")
_NO_PERMISSION = 3
"""MAV_PARAM_ERROR_PERMISSION_DENIED (common.xml)."""
_LEAST_S, _MOST_S = 3.0, 60.0
"""Range of the timeout that a request may name."""


class Operators:
    """Arbitrates which ground station is in control."""

    def __init__(self, ctx: Context, value: Callable[[str], Message | None]) -> None:
        """``value``: PARAM_VALUE of a parameter, None if it does not exist."""
        self._ctx = ctx
        self._value = value
        self.owner: MavlinkPeer | None = None
        """Last address of the owner, None = no owner."""
        self._takeover = False
        self._last_received_us = 0
        self._shown: tuple[int, bool] | None = None

    @property
    def in_control(self) -> int:
        """MAVLink system id, 0 = none."""
        return 0 if self.owner is None else self.owner.sysid

    def status(self) -> Message:
        flags = extra.GCS_CONTROL_STATUS_FLAGS_SYSTEM_MANAGER
        if self._takeover or self.owner is None:
            flags |= extra.GCS_CONTROL_STATUS_FLAGS_TAKEOVER_ALLOWED
        return extra.MAVLink_control_status_message(flags, self.in_control, [0] * 10)

    def note_message(self, peer: MavlinkPeer) -> None:
        if peer.sysid == self.in_control:
            self.owner, self._last_received_us = peer, self._ctx.t_us

    def tick(self) -> None:
        """Release control of an owner that has timed out; changes are reported at once."""
        ctx = self._ctx
        if self.owner is not None:
            age_s = (ctx.t_us - self._last_received_us) * 1e-6
            if age_s > ctx.params["FS_GCS_TIMEOUT"] * ctx.patience:
                ctx.say(notices.OPERATOR_SILENT(system=self.in_control))
                self.owner, self._takeover = None, False
        shown = (self.in_control, self._takeover)
        if self._shown is not None and shown != self._shown:
            ctx.broadcast(self.status())
        self._shown = shown

    def keeps_out(self, peer: MavlinkPeer) -> bool:
        return self.owner is not None and peer.sysid != self.owner.sysid

    def refusal(self, peer: MavlinkPeer, *, grave: bool) -> str:
        """Why this peer may not make changes now, "" = allowed. ``grave``: a change that needs an owner if the
        parameter GUARD is set.
        """
        if self.keeps_out(peer):
            return self.reason
        if grave and self.owner is None and self._ctx.params[GUARD] > 0.0:
            return f"Refused: take operator control first ({GUARD})"
        return ""

    def refused(self, peer: MavlinkPeer, msg: Message) -> bool:
        """Whether a message other than a command is reserved to the owner; its sender is notified."""
        kind = msg.get_msgId()
        if kind in OPEN:
            return False
        guard = kind == mav.MAVLINK_MSG_ID_PARAM_SET and msg.param_id == GUARD
        reason = self.refusal(peer, grave=kind in GRAVE or guard)
        if not reason:
            return False
        ctx = self._ctx
        if kind in _PLAN:
            ctx.send(
                peer,
                mav.MAVLink_mission_ack_message(
                    peer.sysid, peer.compid, mav.MAV_MISSION_DENIED, getattr(msg, "mission_type", 0)
                ),
            )
        elif kind == mav.MAVLINK_MSG_ID_PARAM_SET:
            name = msg.param_id.encode("ascii", errors="replace")[:16]
            ctx.send(peer, mav.MAVLink_param_error_message(peer.sysid, peer.compid, name, -1, _NO_PERMISSION))
            present = self._value(msg.param_id)
            if present is not None:
                ctx.send(peer, present)
        ctx.text(notices.REFUSED(reason=reason), peer)
        return True

    @property
    def reason(self) -> str:
        return f"Refused: system {self.in_control} is in control"

    def request(self, call: Call) -> Reply:
        """REQUEST_OPERATOR_CONTROL: param1 1 = request, 0 = release; param2 1 = allow takeover; param4 requester."""
        action, named = call.whole(1), call.whole(4) or 0
        if action not in (0, 1) or named not in (0, call.peer.sysid):
            return denied("operator control: param1 1 = take, 0 = release; for your own system id")
        if action == 0:
            if self.keeps_out(call.peer):
                return Reply(CommandReply(result=CommandResult.NOT_IN_CONTROL, reason=self.reason))
            if self.owner is not None:
                self._ctx.say(notices.OPERATOR_RELEASED(system=self.in_control))
            self.owner, self._takeover = None, False
            return Reply(ACCEPTED)
        if self.keeps_out(call.peer) and not self._takeover:
            self._notify_owner(call)
            return Reply(
                CommandReply(result=CommandResult.FAILED, reason=f"System {self.in_control} is in control: asked")
            )
        if call.peer.sysid != self.in_control:
            self._ctx.say(notices.OPERATOR_IN_CONTROL(system=call.peer.sysid))
        self.owner, self._last_received_us = call.peer, self._ctx.t_us
        self._takeover = call.param(2) == 1.0
        return Reply(ACCEPTED)

    def _notify_owner(self, call: Call) -> None:
        """Forward the request to the owner, as the same command."""
        owner = self.owner
        assert owner is not None
        timeout_s = min(max(call.param(3), _LEAST_S), _MOST_S)
        params = (1.0, call.param(2), timeout_s, float(call.peer.sysid), 0.0, 0.0, 0.0)
        message = mav.MAVLink_command_long_message(owner.sysid, owner.compid, REQUEST, 0, *params)
        self._ctx.send(owner, message)
        self._ctx.text(notices.OPERATOR_ASKS(system=call.peer.sysid), owner)


@dataclass(frozen=True, slots=True, kw_only=True)
class Rights:
    """Names of messages and commands by permitted senders."""

    anyone: tuple[tuple[str, ...], tuple[str, ...]]
    """Always: messages, commands."""
    control: tuple[tuple[str, ...], tuple[str, ...]]
    """Anyone while there is no owner, else the owner only."""
    grave: tuple[tuple[str, ...], tuple[str, ...]]
    """The same; with MAV_CTRL_NEEDED the owner only."""


def rights(messages: Iterable[int], commands: Mapping[int, CommandRow]) -> Rights:
    """Of the messages and commands that are handled."""

    def names(kind: Mapping[int, str], numbers: Iterable[int]) -> tuple[str, ...]:
        return tuple(sorted(kind[number] for number in numbers))

    called = {number: known.msgname for number, known in (*extra.mavlink_map.items(), *mav.mavlink_map.items())}
    ordered = {number: entry.name.removeprefix("MAV_CMD_") for number, entry in mav.enums["MAV_CMD"].items()}
    ordered[REQUEST] = "REQUEST_OPERATOR_CONTROL"
    handled = set(messages)
    open_commands = {number for number, entry in commands.items() if not entry.action}
    grave_commands = GRAVE_COMMANDS & set(commands)
    return Rights(
        anyone=(names(called, handled & OPEN), names(ordered, open_commands)),
        control=(
            names(called, handled - OPEN - GRAVE),
            names(ordered, set(commands) - open_commands - grave_commands),
        ),
        grave=(names(called, handled & GRAVE), names(ordered, grave_commands)),
    )
