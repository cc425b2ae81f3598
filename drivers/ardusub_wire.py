"""MAVLink layer of the ArduSub driver: parser and encoder."""

import importlib
from collections.abc import Iterator
from typing import Any

from autopilot.core.errors import DriverError
from autopilot.drivers.framing import FrameCutter
from autopilot.drivers.protocols import Link

AUTOPILOT = 1
"""MAV_COMP_ID_AUTOPILOT1."""
US_COMPONENT = 190
"""MAV_COMP_ID_MISSIONPLANNER: what counts as a ground station."""

GCS, INVALID_AUTOPILOT, ACTIVE = 6, 8, 4
"""MAV_TYPE_GCS, MAV_AUTOPILOT_INVALID, MAV_STATE_ACTIVE."""

ARM_DISARM, SET_INTERVAL, REQUEST_MESSAGE = 400, 511, 512
"""MAV_CMD_COMPONENT_ARM_DISARM, MAV_CMD_SET_MESSAGE_INTERVAL, MAV_CMD_REQUEST_MESSAGE."""

FORCE_DISARM = 21196.0
"""COMPONENT_ARM_DISARM.param2: whatever it checks, it disarms."""

KEEP_US = 65535
"""In an override: this channel is not ours."""

SEND_EVERY_US, HEARTBEAT_US = 20_000, 1_000_000
"""It reads its channels at 50 Hz, and misses its ground station's heartbeat after seconds."""
REST_SENDS = 3
"""How often 1500 is sent after the last command."""
SERVO_ID, SERVO_HZ = 36, 50.0
"""SERVO_OUTPUT_RAW, and how often it is asked for."""
ENOUGH = 0.7
"""Share of a rate below which it is asked for anew."""


class Wire:
    """Talks to one flight controller over one link. Whatever else is on the link is passed over."""

    def __init__(self, link: Link, *, system: int, ours: int) -> None:
        """``system``: its id. ``ours``: the id that it takes for its ground station (MAV_GCS_SYSID)."""
        try:
            self._dialect: Any = importlib.import_module("pymavlink.dialects.v20.ardupilotmega")
        except ModuleNotFoundError as error:
            raise DriverError("the driver needs the Python module 'pymavlink', which is not installed") from error
        self._link = link
        self._system, self._ours = system, ours
        self._cutters: dict[int, FrameCutter] = {}
        self._reader: Any = self._dialect.MAVLink(None)
        self._mav: Any = self._dialect.MAVLink(None, srcSystem=ours, srcComponent=US_COMPONENT)
        self.bad_frames = 0
        """Frames that were damaged, or unknown."""
        self.other_systems: set[int] = set()
        """Flight controllers that are not ours."""
        self.rivals: set[int] = set()
        """Components that speak as the ground station that it obeys, beside us."""

    def receive(self, t_us: int) -> Iterator[Any]:
        """Its messages since the last call."""
        for data, client, *_ in self._link.recv(t_us):
            cutter = self._cutters.get(client)
            if cutter is None:
                if len(self._cutters) >= 16:
                    self._cutters.clear()
                cutter = self._cutters[client] = FrameCutter()
            for frame in cutter.feed(data):
                message = self._decoded(frame)
                if message is None:
                    self.bad_frames += 1
                elif (message.get_srcSystem(), message.get_srcComponent()) == (self._system, AUTOPILOT):
                    yield message
                elif message.get_type() == "HEARTBEAT":
                    self._note_other(message)

    def _note_other(self, message: Any) -> None:
        system, component = message.get_srcSystem(), message.get_srcComponent()
        if message.autopilot != INVALID_AUTOPILOT and component == AUTOPILOT:
            self.other_systems.add(system)
        elif message.type == GCS and system == self._ours:
            self.rivals.add(component)

    def _decoded(self, frame: bytes) -> Any | None:
        try:
            return self._reader.decode(bytearray(frame))
        except self._dialect.MAVError:
            return None

    def heartbeat(self) -> None:
        """We are here: its failsafe counts from the last one."""
        self._send(self._mav.heartbeat_encode(GCS, INVALID_AUTOPILOT, 0, 0, ACTIVE))

    def override(self, channels_us: tuple[int, ...]) -> None:
        """Pulses of the first channels; the others are left alone."""
        pulses = channels_us + (KEEP_US,) * (8 - len(channels_us))
        self._send(self._mav.rc_channels_override_encode(self._system, AUTOPILOT, *pulses))

    def arm(self, *, armed: bool) -> None:
        """Arm by its own checks, or disarm in any case."""
        self._command(ARM_DISARM, float(armed), 0.0 if armed else FORCE_DISARM)

    def interval(self, message_id: int, rate_hz: float) -> None:
        self._command(SET_INTERVAL, float(message_id), 1e6 / rate_hz)

    def request_message(self, message_id: int) -> None:
        self._command(REQUEST_MESSAGE, float(message_id))

    def request_time(self, t_us: int) -> None:
        self._send(self._mav.timesync_encode(0, 1000 * t_us))

    def order(self, command: int, *params: float) -> None:
        self._command(command, *params)

    def read_parameter(self, name: str) -> None:
        self._send(self._mav.param_request_read_encode(self._system, AUTOPILOT, name.encode(), -1))

    def _command(self, command: int, *params: float) -> None:
        seven = (*params, *(0.0,) * (7 - len(params)))
        self._send(self._mav.command_long_encode(self._system, AUTOPILOT, command, 0, *seven))

    def _send(self, message: Any) -> None:
        self._link.send(bytes(message.pack(self._mav)))

    def close(self) -> None:
        self._link.close()
