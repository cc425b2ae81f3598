"""Request commands: REQUEST_MESSAGE, message intervals, capabilities, home."""

from collections.abc import Mapping

from pymavlink.dialects.v20 import development as mav

from autopilot.core.clock import TICK_US
from autopilot.mavlink.api import ACCEPTED, CommandReply, CommandResult
from autopilot.mavlink.commands import UNSUPPORTED, Call, CommandRow, Reply, denied, request, setting
from autopilot.mavlink.context import Context
from autopilot.mavlink.status import MSG_ID_PROTOCOL_VERSION, available_mode
from autopilot.mavlink.streams import Streams

LATER = Reply(CommandReply(result=CommandResult.TEMPORARILY_REJECTED))
"""A known message without data yet."""


class Requests:
    """Answers to requests; retransmissions are answered again."""

    def __init__(self, ctx: Context, streams: Streams) -> None:
        self._ctx = ctx
        self._streams = streams

    def table(self) -> Mapping[int, CommandRow]:

        def fixed(msg_id: int) -> CommandRow:
            return request(lambda call: self._message(msg_id))

        return {
            mav.MAV_CMD_REQUEST_MESSAGE: request(self.request_message),
            mav.MAV_CMD_SET_MESSAGE_INTERVAL: setting(self.set_message_interval),
            mav.MAV_CMD_GET_MESSAGE_INTERVAL: request(self.get_message_interval),
            mav.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: fixed(mav.MAVLINK_MSG_ID_AUTOPILOT_VERSION),
            mav.MAV_CMD_REQUEST_PROTOCOL_VERSION: fixed(MSG_ID_PROTOCOL_VERSION),
            mav.MAV_CMD_REQUEST_FLIGHT_INFORMATION: fixed(mav.MAVLINK_MSG_ID_FLIGHT_INFORMATION),
            mav.MAV_CMD_GET_HOME_POSITION: fixed(mav.MAVLINK_MSG_ID_HOME_POSITION),
        }

    def request_message(self, call: Call) -> Reply:
        """REQUEST_MESSAGE: the acknowledgement, then the message."""
        msg_id = call.whole(1)
        if msg_id is None:
            return UNSUPPORTED_REPLY
        if msg_id == mav.MAVLINK_MSG_ID_AVAILABLE_MODES:
            return self._available_modes(call)
        if msg_id == mav.MAVLINK_MSG_ID_MESSAGE_INTERVAL:
            return self._interval_of(call, call.whole(2))
        return self._message(msg_id)

    def _available_modes(self, call: Call) -> Reply:
        index, profile = call.whole(2), self._ctx.profile
        count = len(profile.listed)
        if index is None or not 0 <= index <= count:
            return denied(f"mode {call.param(2):g} does not exist: use 1 to {count}, 0 for all")
        wanted = (index,) if index else range(1, count + 1)
        return Reply(ACCEPTED, tuple(available_mode(profile, number) for number in wanted))

    def _message(self, msg_id: int) -> Reply:
        if not self._streams.knows(msg_id):
            return UNSUPPORTED_REPLY
        messages = self._streams.build(msg_id)
        return Reply(ACCEPTED, messages) if messages else LATER

    def set_message_interval(self, call: Call) -> Reply:
        """SET_MESSAGE_INTERVAL on the client's link: microseconds, -1 = off, 0 = default."""
        msg_id = call.whole(1)
        if msg_id is None or not self._streams.knows(msg_id):
            return UNSUPPORTED_REPLY
        if not self._streams.set_interval(call.peer.link, msg_id, call.params[1]):
            if msg_id == mav.MAVLINK_MSG_ID_HEARTBEAT:
                return denied("HEARTBEAT comes once a second: its interval cannot be set")
            interval = f"message {msg_id}: interval {call.params[1]:g} us"
            return denied(f"{interval}, use {TICK_US} up to {2**31 - 1}, -1 (off) or 0 (default)")
        return Reply(ACCEPTED)

    def get_message_interval(self, call: Call) -> Reply:
        """GET_MESSAGE_INTERVAL: MESSAGE_INTERVAL with 0 for a message that does not exist here."""
        return self._interval_of(call, call.whole(1))

    def _interval_of(self, call: Call, msg_id: int | None) -> Reply:
        if msg_id is None or not 0 <= msg_id <= 0xFFFF:
            return denied("message id is no number of a message: use 0 to 65535")
        interval_us = self._streams.interval_us(call.peer.link, msg_id)
        return Reply(ACCEPTED, (mav.MAVLink_message_interval_message(msg_id, interval_us),))


UNSUPPORTED_REPLY = Reply(UNSUPPORTED)
