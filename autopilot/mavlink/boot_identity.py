"""Identity requests answered during the start: version, capabilities, protocol, modes and parameter files.

Ground stations request these once when they connect and take silence for missing capabilities (QGroundControl: no
fence, no rally points). None of the answers needs loaded modules, and all equal those of the running service.
"""

from collections.abc import Callable, Sequence
from functools import cached_property

from autopilot.core.params import ParamSet
from autopilot.mavlink.context import COMMANDS, MavlinkPeer, VehicleIdentity
from autopilot.mavlink.dialect import extra, mav
from autopilot.mavlink.ftp import FileTransfer, Op, request_of
from autopilot.mavlink.metadata import Metadata, component_information, component_metadata, make_metadata
from autopilot.mavlink.profiles import Profile
from autopilot.mavlink.status import MSG_ID_PROTOCOL_VERSION, autopilot_version, available_mode, protocol_version
from autopilot.mavlink.stubs import stubs_of
from autopilot.mavlink.wire import Message

_FIXED = {
    mav.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: mav.MAVLINK_MSG_ID_AUTOPILOT_VERSION,
    mav.MAV_CMD_REQUEST_PROTOCOL_VERSION: MSG_ID_PROTOCOL_VERSION,
}
"""Older commands that ask for one message."""


class BootIdentity:
    """One per service. Values are computed on first use, so that the first heartbeat is not delayed."""

    def __init__(self, profile: Profile, identity: Callable[[], VehicleIdentity]) -> None:
        self._profile, self._find = profile, identity

    @cached_property
    def _identity(self) -> VehicleIdentity:
        return self._find()

    @cached_property
    def metadata(self) -> Metadata:
        """Files about the parameters; as the service has them."""
        params, stubs = ParamSet(), stubs_of(self._profile)
        names = sorted((*params, *stubs))
        specs = [stubs[name].spec if name in stubs else params.spec(name) for name in names]
        return make_metadata(specs, self._profile, name=self._identity.name, version=self._identity.version)

    def answer(self, msg: Message) -> Sequence[Message]:
        """Answers to a request for data known already; empty for anything else."""
        if msg.get_msgId() not in COMMANDS:
            return ()
        wanted = _FIXED.get(msg.command)
        if msg.command == mav.MAV_CMD_REQUEST_MESSAGE and float(msg.param1).is_integer():
            wanted = int(msg.param1)
        messages = () if wanted is None else self._messages(wanted, msg.param2)
        if not messages:
            return ()
        asker = msg.get_srcSystem(), msg.get_srcComponent()
        return (mav.MAVLink_command_ack_message(msg.command, mav.MAV_RESULT_ACCEPTED, 0, 0, *asker), *messages)

    def _messages(self, wanted: int, index: float) -> Sequence[Message]:
        if wanted == MSG_ID_PROTOCOL_VERSION:
            return (protocol_version(),)
        match wanted:
            case mav.MAVLINK_MSG_ID_AUTOPILOT_VERSION:
                return (autopilot_version(self._identity, self._profile),)
            case extra.MAVLINK_MSG_ID_COMPONENT_METADATA:
                return (component_metadata(self.metadata, 0),)
            case extra.MAVLINK_MSG_ID_COMPONENT_INFORMATION:
                return (component_information(self.metadata, 0),)
            case mav.MAVLINK_MSG_ID_AVAILABLE_MODES:
                count = len(self._profile.listed)
                chosen = range(1, count + 1) if index == 0.0 else (index,)
                return tuple(available_mode(self._profile, int(n)) for n in chosen if n in range(1, count + 1))
        return ()


class BootFiles:
    """Reads of the files about the parameters, on one link. A file of another name is left for the service."""

    links = frozenset((0,))

    def __init__(self, identity: BootIdentity, send: Callable[[int, Message], None]) -> None:
        """``send`` takes a link and a message."""
        self._identity, self._send = identity, send
        self.t_us = 0

    @cached_property
    def _transfer(self) -> FileTransfer:
        return FileTransfer(self, self._identity.metadata.files, None)

    def take(self, client: int, msg: Message) -> bool:
        """Handle FILE_TRANSFER_PROTOCOL; False for what only the service can answer (logs, folders)."""
        request = request_of(bytes(msg.payload))
        by_path = request.opcode in (Op.LIST, Op.OPEN_READ, Op.CRC32)
        if by_path and request.path.strip("/") not in self._identity.metadata.files:
            return False
        self._transfer.on_message(MavlinkPeer(0, msg.get_srcSystem(), msg.get_srcComponent(), client), msg)
        return True

    def tick(self) -> None:
        if "_transfer" in self.__dict__:
            self._transfer.tick()

    def send(self, to: MavlinkPeer, message: Message) -> None:
        self._send(to.client, message)

    def has_capacity(self, link: int, fraction: float) -> bool:
        """Always true: nothing else is sent during the start."""
        return True
