"""What a service says before it can do anything: that it is there, and starting."""

from pymavlink.dialects.v20 import development as mav

from autopilot.mavlink.api import FlightMode
from autopilot.mavlink.context import COMPID
from autopilot.mavlink.profiles import profile_by_name
from autopilot.mavlink.wire import LinkEncoder, LinkParser

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
        self._parser = LinkParser()
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

    def answer(self, data: bytes) -> list[bytes]:
        """Answers to what was received: actions are temporarily rejected, with a text that says why."""
        out: list[bytes] = []
        for msg in self._parser.feed(data):
            if msg.get_type() not in ("COMMAND_LONG", "COMMAND_INT") or msg.command in _REQUESTS:
                continue
            if msg.target_system not in (0, self._sysid) or msg.target_component not in (0, COMPID):
                continue
            later = mav.MAV_RESULT_TEMPORARILY_REJECTED
            asker = msg.get_srcSystem(), msg.get_srcComponent()
            out.append(self._encoder.pack(mav.MAVLink_statustext_message(mav.MAV_SEVERITY_WARNING, STARTING.encode())))
            out.append(self._encoder.pack(mav.MAVLink_command_ack_message(msg.command, later, 0, 0, *asker)))
        return out
