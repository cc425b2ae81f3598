"""Links of the service during ``doctor``: receive measurements only, answer nothing.

A ground station that saw a complete vehicle would read its parameters and might arm it. So only the heartbeat of an
onboard computer is sent, where a peer needs one before it transmits, and only measurements are passed to the
service. Senders are recorded.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

from autopilot.core.clients import EVERYONE
from autopilot.drivers.framing import FrameCutter
from autopilot.drivers.links import parse_connection
from autopilot.drivers.protocols import Link, Received

HEARTBEAT, GCS, NO_AUTOPILOT = 0, 6, 8
"""Message id, MAV_TYPE_GCS, MAV_AUTOPILOT_INVALID."""
ONBOARD_COMPUTER, COMPUTER_TYPE = 191, 18
"""MAV_COMP_ID_ONBOARD_COMPUTER, MAV_TYPE_ONBOARD_CONTROLLER."""
MEASURED = frozenset((HEARTBEAT, 2, 33, 102, 246, 301, 330, 331))
"""HEARTBEAT, SYSTEM_TIME, GLOBAL_POSITION_INT, VISION_POSITION_ESTIMATE, ADSB_VEHICLE, AIS_VESSEL, OBSTACLE_DISTANCE,
ODOMETRY."""
POSES = frozenset((102, 331))
STEERING = {
    69: "MANUAL_CONTROL",
    70: "RC_CHANNELS_OVERRIDE",
    82: "SET_ATTITUDE_TARGET",
    84: "SET_POSITION_TARGET_LOCAL_NED",
    86: "SET_POSITION_TARGET_GLOBAL_INT",
}
"""Messages that move a vehicle."""
MAX_SPEAKERS = 64


@dataclass(slots=True, eq=False)
class Speaker:
    system: int
    component: int
    senders: set[str] = field(default_factory=set)
    ground_station: bool = False
    autopilot: bool = False
    poses: int = 0
    steering: set[str] = field(default_factory=set)
    """Names of messages of his that move a vehicle."""

    @property
    def name(self) -> str:
        return f"system {self.system} at {', '.join(sorted(self.senders))}"


class ListeningLink:
    """A :class:`autopilot.drivers.protocols.Link` that only listens."""

    def __init__(self, link: Link, system: int, speakers: dict[tuple[int, int], Speaker]) -> None:
        """``system``: ours. ``speakers``: by system and component; of all links."""
        self._link = link
        self._calls = parse_connection(link.name).kind in ("udpout", "udpbcast", "tcpout", "serial")
        self._beat = _heartbeat(system)
        self._cutters: dict[int, FrameCutter] = {}
        self._speakers = speakers
        self.dropped_tx = 0

    @property
    def problem(self) -> str | None:
        return self._link.problem

    @property
    def name(self) -> str:
        return self._link.name

    def filenos(self) -> list[int]:
        return self._link.filenos()

    def close(self) -> None:
        self._link.close()

    def send(self, data: bytes, client: int = EVERYONE, beside: frozenset[int] = frozenset()) -> None:
        """Sends our heartbeat, as that of an onboard computer, and drops everything else."""
        if self._calls and data[:1] == b"\xfd" and data[7:10] == b"\0\0\0":
            self._link.send(self._beat)

    def recv(self, t_us: int) -> list[Received]:
        return [
            got._replace(data=frame)
            for got in self._link.recv(t_us)
            for frame in self._cutter(got.client).feed(got.data)
            if self._note(frame, got.sender) in MEASURED
        ]

    def _cutter(self, client: int) -> FrameCutter:
        return self._cutters.setdefault(client, FrameCutter())

    def _note(self, frame: bytes, sender: str) -> int:
        """Message id of a frame; records its sender."""
        if frame[0] == 0xFD:
            system, component, number, payload = frame[5], frame[6], int.from_bytes(frame[7:10], "little"), frame[10:]
        else:
            system, component, number, payload = frame[3], frame[4], frame[5], frame[6:]
        speaker = self._speakers.get((system, component))
        if speaker is None:
            if len(self._speakers) >= MAX_SPEAKERS:
                return number
            speaker = self._speakers[system, component] = Speaker(system, component)
        speaker.senders.add(sender)
        speaker.poses += number in POSES
        if number in STEERING:
            speaker.steering.add(STEERING[number])
        if number == HEARTBEAT and len(payload) > 5:
            speaker.ground_station = payload[4] == GCS
            speaker.autopilot = payload[4] != GCS and payload[5] != NO_AUTOPILOT
        return number


def _heartbeat(system: int) -> bytes:
    """HEARTBEAT of an onboard computer of a system."""
    from pymavlink.dialects.v20 import common

    codec = common.MAVLink(None, srcSystem=system, srcComponent=ONBOARD_COMPUTER)
    message = common.MAVLink_heartbeat_message(COMPUTER_TYPE, NO_AUTOPILOT, 0, 0, 4, 3)
    return bytes(message.pack(codec))


def company(speakers: Sequence[Speaker], ours: int) -> list[tuple[bool | None, str, str]]:
    """Other senders on the links: True = forbids flying, None = warning, False = fine; who, and the remedy."""
    found: list[tuple[bool | None, str, str]] = []
    for speaker in speakers:
        if speaker.autopilot and speaker.system == ours:
            found.append((True, f"another vehicle is {speaker.name}", "give one of the two another MAV_SYS_ID"))
        elif speaker.ground_station and len(speaker.senders) > 1:
            remedy = "give each an id of its own, or connect it once"
            found.append((None, f"ground stations of one id: {speaker.name}", remedy))
        elif speaker.ground_station:
            found.append((False, f"ground station: {speaker.name}", ""))
    steering = [speaker for speaker in speakers if speaker.steering]
    for speaker in steering:
        messages = ", ".join(sorted(speaker.steering))
        verdict = None if len(steering) > 1 else False
        found.append((verdict, f"{speaker.name} steers ({messages})", "let one steer" if len(steering) > 1 else ""))
    return found
