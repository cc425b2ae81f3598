"""What a service says before it can do anything: that it is there, and starting."""

from collections.abc import Hashable

from pymavlink.dialects.v20 import development as mav

from autopilot.core.clients import EVERYONE
from autopilot.mavlink.api import FlightMode
from autopilot.mavlink.context import COMPID
from autopilot.mavlink.profiles import profile_by_name
from autopilot.mavlink.table import LatestUsed
from autopilot.mavlink.wire import LinkEncoder, LinkParser, Message

MAX_PARSERS = 64
"""Clients of a link whose unfinished messages are kept."""
STARTING = "Service is starting; try again in a few seconds"

_REQUESTS = frozenset(
    (
        mav.MAV_CMD_REQUEST_MESSAGE,
        mav.MAV_CMD_SET_MESSAGE_INTERVAL,
        mav.MAV_CMD_GET_MESSAGE_INTERVAL,
        mav.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES,
        mav.MAV_CMD_REQUEST_PROTOCOL_VERSION,
        mav.MAV_CMD_GET_HOME_POSITION,
    )
)
"""What every client asks for at its connect. They go unanswered until the service answers them."""


class BootLink:
    """One link of a service that is starting: heartbeats in MAV_STATE_BOOT, and actions are put off.

    ConfigError for an unknown profile. Never raises on received bytes.
    """

    def __init__(self, sysid: int, profile: str) -> None:
        self._sysid = sysid
        self._profile = profile_by_name(profile)
        self._parsers: LatestUsed[int, LinkParser] = LatestUsed(MAX_PARSERS)
        self._encoder = LinkEncoder(sysid, COMPID)

    def heartbeat(self) -> bytes:
        """HEARTBEAT of a disarmed vehicle that is starting."""
        return self._encoder.pack(
            mav.MAVLink_heartbeat_message(
                mav.MAV_TYPE_SUBMARINE,
                self._profile.autopilot,
                mav.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED,
                self._profile.custom_modes[FlightMode.HOLD],
                mav.MAV_STATE_BOOT,
                3,
            )
        )

    def answer(self, data: bytes, client: int = EVERYONE) -> tuple[list[bytes], dict[Hashable, bytes]]:
        """Answers to what a client sent, and what of it is left for the service: what it asks -> the message.

        Actions are temporarily rejected, with a text that says why; they are not left.
        """
        out: list[bytes] = []
        left: dict[Hashable, bytes] = {}
        for msg in self._parser_of(client).feed(data):
            if not self._is_action(msg):
                left[_asked(msg)] = bytes(msg.get_msgbuf())
                continue
            out.append(self._encoder.pack(mav.MAVLink_statustext_message(mav.MAV_SEVERITY_WARNING, STARTING.encode())))
            if msg.get_type() != "SET_MODE":  # that one knows no acknowledgement
                asker = msg.get_srcSystem(), msg.get_srcComponent()
                later = mav.MAV_RESULT_TEMPORARILY_REJECTED
                out.append(self._encoder.pack(mav.MAVLink_command_ack_message(msg.command, later, 0, 0, *asker)))
        return out, left

    def _parser_of(self, client: int) -> LinkParser:
        """Every client has its own: half a message of one must not meet another's."""
        return self._parsers.touch(client, LinkParser)

    def _is_action(self, msg: Message) -> bool:
        """Whether a message wants the vehicle to do something that it cannot do yet."""
        kind = msg.get_type()
        if kind == "SET_MODE":
            return msg.target_system in (0, self._sysid)
        return (
            kind in ("COMMAND_LONG", "COMMAND_INT")
            and msg.command not in _REQUESTS
            and msg.target_system in (0, self._sysid)
            and msg.target_component in (0, COMPID)
        )


def _asked(msg: Message) -> Hashable:
    """Who asks for what: the same again takes the place of what has been asked before."""
    what = (getattr(msg, field, None) for field in ("mission_type", "command", "param1", "param_id", "seq"))
    return msg.get_srcSystem(), msg.get_srcComponent(), msg.get_msgId(), *what
