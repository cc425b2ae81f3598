"""MAVLink while the service is loading: HEARTBEAT in MAV_STATE_BOOT, and answers that need no vehicle."""

from collections.abc import Hashable
from dataclasses import dataclass

from autopilot.core.clients import EVERYONE, Reach
from autopilot.mavlink.api import FlightMode
from autopilot.mavlink.boot_identity import BootFiles, BootIdentity
from autopilot.mavlink.bounded_table import LatestUsed
from autopilot.mavlink.context import COMPID, MISSION_COMPID
from autopilot.mavlink.dialect import command_ids, mav, message_ids
from autopilot.mavlink.profiles import profile_by_name
from autopilot.mavlink.signing import is_signed_with, signed
from autopilot.mavlink.wire import LinkEncoder, LinkParser, Message

MAX_PARSERS = 64
"""Clients of a link whose unfinished messages are kept."""
STARTING = "Service is starting; try again in a few seconds"

_REQUESTS = command_ids(
    "REQUEST_MESSAGE SET_MESSAGE_INTERVAL GET_MESSAGE_INTERVAL REQUEST_AUTOPILOT_CAPABILITIES"
    " REQUEST_PROTOCOL_VERSION GET_HOME_POSITION"
)
"""Requests of clients at their connect. Data not known yet are answered later by the service."""

_KEPT = message_ids(
    "HEARTBEAT COMMAND_LONG COMMAND_INT SET_MODE SET_GPS_GLOBAL_ORIGIN PARAM_REQUEST_LIST PARAM_REQUEST_READ"
    " PARAM_SET MISSION_COUNT MISSION_CLEAR_ALL MISSION_REQUEST_LIST MISSION_REQUEST_INT MISSION_REQUEST"
    " MISSION_SET_CURRENT FILE_TRANSFER_PROTOCOL LOG_REQUEST_LIST LOG_REQUEST_DATA REQUEST_DATA_STREAM SETUP_SIGNING"
)
"""Requests that may be left for the service. Others (sticks, positions of others) are outdated when it starts."""


_SIGNED_AS = 0x40
"""Added to a link's number: frames signed during the start are a stream of their own, so that their timestamps do
not interfere with the service's."""


@dataclass(slots=True)
class BootSigning:
    """The signing key while the service starts, for all links."""

    key: bytes
    stamp: int
    """Signing time of the last frame; incremented by one per frame, independent of the clock."""
    local_may_be_silent: bool
    """Programs of this machine need not sign (SIGN_LOCAL)."""

    def sign(self, frame: bytes, crc_extra: int, link: int) -> bytes:
        self.stamp += 1
        return signed(frame, crc_extra, self.key, _SIGNED_AS | link & 0x3F, self.stamp)

    def answers(self, frame: bytes, reach: Reach) -> bool:
        """Whether to answer the sender of a frame. No command is executed here, so a replayed frame does no harm."""
        return is_signed_with(self.key, frame) or (self.local_may_be_silent and reach is Reach.MACHINE)


class BootLink:
    """One link of a service that is starting: heartbeats in MAV_STATE_BOOT and identity; actions are rejected for
    now. ConfigError for an unknown profile. Never raises on received bytes.
    """

    def __init__(
        self,
        sysid: int,
        profile: str,
        identity: BootIdentity,
        signing: BootSigning | None = None,
        number: int = 0,
    ) -> None:
        """``number``: of the link; ``signing``: None without a key."""
        self._sysid = sysid
        self._profile = profile_by_name(profile)
        self._identity, self._signing = identity, signing
        self._parsers: LatestUsed[int, LinkParser] = LatestUsed(MAX_PARSERS)
        self._encoder = LinkEncoder(sysid, COMPID)
        if signing is not None:
            self._encoder.sign = lambda frame, crc_extra, counted: signing.sign(frame, crc_extra, number)
        self._answers: list[tuple[int, bytes]] = []
        self._files = BootFiles(identity, self._send)

    def tick(self, t_us: int) -> list[tuple[int, bytes]]:
        """Messages due without a request (FTP bursts), each with its client. The time may start anywhere."""
        self._files.t_us = t_us
        self._files.tick()
        return self._take_answers()

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

    def answer(
        self, data: bytes, client: int = EVERYONE, reach: Reach = Reach.NETWORK
    ) -> tuple[list[bytes], dict[Hashable, bytes]]:
        """Answers to a client's bytes, and the requests left for the service: key -> message. Actions are
        TEMPORARILY_REJECTED with a text and not left.
        """
        left: dict[Hashable, bytes] = {}
        for msg in self._parser_of(client).feed(data):
            if not self._is_known(client, msg, reach) and not self._put_off(client, msg):
                left[_request_key(msg)] = bytes(msg.get_msgbuf())
        return [answer for _, answer in self._take_answers()], left

    def _is_known(self, client: int, msg: Message, reach: Reach) -> bool:
        """Whether a message requests data known already, which is sent then."""
        if not self._is_for_us(msg):
            return False
        if self._signing is not None and not self._signing.answers(bytes(msg.get_msgbuf()), reach):
            return False
        if msg.get_type() == "FILE_TRANSFER_PROTOCOL":
            return self._files.take(client, msg)
        answers = self._identity.answer(msg)
        for answer in answers:
            self._send(client, answer)
        return bool(answers)

    def _put_off(self, client: int, msg: Message) -> bool:
        """Whether a message is an action, which is rejected for now with a text."""
        if not self._is_action(msg):
            return False
        self._send(client, mav.MAVLink_statustext_message(mav.MAV_SEVERITY_WARNING, STARTING.encode()))
        if msg.get_type() != "SET_MODE":  # has no acknowledgement
            asker = msg.get_srcSystem(), msg.get_srcComponent()
            later = mav.MAV_RESULT_TEMPORARILY_REJECTED
            self._send(client, mav.MAVLink_command_ack_message(msg.command, later, 0, 0, *asker))
        return True

    def _send(self, client: int, message: Message) -> None:
        self._answers.append((client, self._encoder.pack(message)))

    def _take_answers(self) -> list[tuple[int, bytes]]:
        answers, self._answers = self._answers, []
        return answers

    def _parser_of(self, client: int) -> LinkParser:
        """Every client has its own: half a message of one must not meet another's."""
        return self._parsers.touch(client, lambda: LinkParser(_KEPT))

    def _is_for_us(self, msg: Message) -> bool:
        return getattr(msg, "target_system", 0) in (0, self._sysid) and (
            getattr(msg, "target_component", 0) in (0, COMPID, MISSION_COMPID)
        )

    def _is_action(self, msg: Message) -> bool:
        """Whether a message requests an action of the vehicle."""
        kind = msg.get_type()
        if kind == "SET_MODE":
            return msg.target_system in (0, self._sysid)
        return kind in ("COMMAND_LONG", "COMMAND_INT") and msg.command not in _REQUESTS and self._is_for_us(msg)


def _request_key(msg: Message) -> Hashable:
    """Key of a request: a repeated one replaces the first. Fields may be arrays, so that all are compared as text."""
    what = tuple(repr(getattr(msg, field, None)) for field in ("mission_type", "command", "param1", "param_id", "seq"))
    return msg.get_srcSystem(), msg.get_srcComponent(), msg.get_msgId(), what
