"""A service in a child process in real time, and a client that sends it requests over a socket."""

import contextlib
import itertools
import math
import socket
import tempfile
import time
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from pymavlink.dialects.v20 import development as mav

from autopilot.core.errors import AutopilotError
from autopilot.mavlink.wire import LinkParser, Message
from autopilot.run.children import LOCAL, Child, autopilot_command, free_port

MAX_BYTES = 4096


@dataclass(frozen=True, slots=True, kw_only=True)
class LiveService:
    child: Child
    udp: int
    tcp: int
    log: Path


@contextlib.contextmanager
def live_service(
    *connections: str,
    arguments: Sequence[str] = (),
    scenario: str = "open-water",
    ends: Collection[int] = (0,),
) -> Iterator[LiveService]:
    """``autopilot sitl`` on a UDP and a TCP port and on further ``connections``, until the block ends.

    AutopilotError if its exit code is not in ``ends`` (3: contacts or warnings).
    """
    udp, tcp = free_port(), free_port(socket.SOCK_STREAM)
    with tempfile.TemporaryDirectory(prefix="autopilot-") as folder:
        log = Path(folder) / "run.mcap"
        links = (f"udpin:{LOCAL}:{udp}", f"tcpin:{LOCAL}:{tcp}", *connections)
        child = Child(
            autopilot_command(
                *("sitl", scenario, "--quiet", "--sensors", "pose", "--speed", "1", "--log", str(log)),
                *(part for link in links for part in ("--connect", link)),
                *arguments,
            ),
            {"AUTOPILOT_STATE_DIR": folder},
        )
        try:
            yield LiveService(child=child, udp=udp, tcp=tcp, log=log)
        finally:
            code = child.end()
        if code not in ends:
            raise AutopilotError(f"the service ended with exit code {code}")


@dataclass(slots=True)
class Station:
    """A ground station on a socket of its own. It records heartbeat times and texts."""

    socket: socket.socket
    sysid: int = 255
    compid: int = 190
    beats_s: list[float] = field(default_factory=list)
    """Real times of heartbeats."""
    texts: list[str] = field(default_factory=list)
    _seq: int = 0
    _parser: LinkParser = field(default_factory=LinkParser)

    @classmethod
    def udp(cls, port: int, sysid: int = 255) -> "Station":
        end = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        end.connect((LOCAL, port))
        return cls(end, sysid)

    @classmethod
    def tcp(cls, port: int) -> "Station":
        return cls(socket.create_connection((LOCAL, port)))

    def send(self, message: Message) -> None:
        codec = mav.MAVLink(None, srcSystem=self.sysid, srcComponent=self.compid)
        codec.seq, self._seq = self._seq, (self._seq + 1) & 0xFF
        with contextlib.suppress(ConnectionError, BlockingIOError):
            self.socket.send(message.pack(codec))

    def beat(self) -> None:
        self.send(mav.MAVLink_heartbeat_message(mav.MAV_TYPE_GCS, mav.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3))

    def receive(self, seconds: float = 0.05) -> list[Message]:
        """The first data within the timeout."""
        self.socket.settimeout(max(seconds, 1e-4))
        try:
            data = self.socket.recv(MAX_BYTES)
        except (TimeoutError, ConnectionError):
            return []
        now_s, found = time.monotonic(), self._parser.feed(data)
        for message in found:
            if message.get_type() == "HEARTBEAT":
                self.beats_s.append(now_s)
            elif message.get_type() == "STATUSTEXT":
                self.texts.append(message.text)
        return found

    def wait(self, service: LiveService, *names: str, request: Message | None = None) -> Message:
        """The next message of these names, as long as the service works; ``request`` is repeated until it arrives."""
        requested_s, working = 0.0, True
        while working:
            if request is not None and time.monotonic() - requested_s > 1.0:
                requested_s = time.monotonic()
                self.send(request)
            found = self.receive(0.2)
            for message in found:
                if message.get_type() in names:
                    return message
            working = bool(found) or service.child.at_work()
        raise AutopilotError(f"no {' or '.join(names)} from the service")

    def meet(self, service: LiveService) -> None:
        """Wait until the service has answered."""
        hello = mav.MAVLink_ping_message(0, 0, 0, 0)
        self.wait(service, "PING", request=hello)
        self.beat()

    def watch(self, seconds: float) -> float:
        """Listen. The longest time without a heartbeat [s]."""
        begin_s = time.monotonic()
        self.beats_s.clear()
        while time.monotonic() - begin_s < seconds:
            self.receive(0.002)
        times = [begin_s, *self.beats_s, time.monotonic()]
        return max(after - before for before, after in itertools.pairwise(times))

    def close(self) -> None:
        self.socket.close()


def waypoint(seq: int, total: int) -> Message:
    """Item ``seq`` of a circle of waypoints, radius 2 m, depth 0.5 m."""
    angle = 2.0 * math.pi * seq / total
    x, y = round(2e4 * math.cos(angle)), round(2e4 * math.sin(angle))
    return mav.MAVLink_mission_item_int_message(1, 1, seq, 1, 16, 0, 1, 0.0, 0.3, 0.0, math.nan, x, y, 0.5, 0)
