"""The whole service on real sockets and lines: floods, transfers between ticks, waiting at a desk, what unplugs."""

import os
import pty
import random
import socket
import threading
import time
import tty
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import development as mav
from system_harness import OpenSession
from wire_client import Harbour, hear_all

from autopilot.bench.live_service import Station, waypoint
from autopilot.core.background import Cancel
from autopilot.core.clients import Reach
from autopilot.core.clock import TICK_US
from autopilot.core.errors import DriverError
from autopilot.core.guard import Guard
from autopilot.core.messages import Inputs, MavlinkFrame, Outputs
from autopilot.core.samples import CameraFrame
from autopilot.drivers.links import open_link
from autopilot.drivers.protocols import Received
from autopilot.drivers.udp import reach_of
from autopilot.log.reader import open_log
from autopilot.run.children import free_port
from autopilot.run.clocks import LockstepClock
from autopilot.run.recorder import NullRecorder
from autopilot.run.runtime import Runtime
from autopilot.run.sitl_session import SitlSession
from autopilot.run.transport import Transport

LOCAL = "127.0.0.1"
PATIENCE_S = 60.0
"""For threads: only a test that fails waits so long."""


@pytest.fixture(name="opened")
def opened_fixture(session: OpenSession) -> OpenSession:
    """Sessions on real links."""

    def make(*connections: str, **given: Any) -> SitlSession:
        return session(connections=connections, **{"scenario": "open-water", "sensors": "pose", **given})

    return make


class TurnClock(LockstepClock):
    """Vehicle time in which a client is as quick as it likes: a tick begins when the client has nothing to say."""

    def __init__(self, client: Callable[[], bool]) -> None:
        super().__init__()
        self._client = client

    def left_s(self, t_us: int) -> float:
        return 0.01 if self._client() else 0.0


class Frames(NullRecorder):
    """Keeps what the log would get."""

    def __init__(self) -> None:
        self.rx: list[MavlinkFrame] = []
        self.tx: list[MavlinkFrame] = []

    def record(self, inputs: Inputs, outputs: Outputs, frames: Sequence[CameraFrame]) -> None:
        self.rx += inputs.mavlink_rx
        self.tx += outputs.mavlink_tx


@pytest.mark.parametrize("kind", ["udpin", "udpout", "tcpin"])
def test_a_transfer_goes_on_between_ticks_and_is_logged(opened: OpenSession, kind: str) -> None:
    """At revision 0501193 every item cost a tick each way."""
    session = opened(f"udpin:{LOCAL}:{free_port(socket.SOCK_DGRAM)}", speed=1.0)
    count = 500 if kind == "udpin" else 120
    if kind == "udpout":
        end = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        end.bind((LOCAL, 0))
        link = open_link(f"udpout:{LOCAL}:{end.getsockname()[1]}")
        link.send(b"hello")
        end.connect(end.recvfrom(10)[1])
        station = Station(end)
    else:
        port = free_port(socket.SOCK_DGRAM if kind == "udpin" else socket.SOCK_STREAM)
        link = open_link(f"{kind}:{LOCAL}:{port}")
        station = Station.udp(port) if kind == "udpin" else Station.tcp(port)
    sent: list[int] = []
    got: list[int] = []
    acks: list[int] = []

    def client() -> bool:
        """Answer what is there; whether there was anything to answer."""
        before = len(sent) + len(got)
        for message in hear_all(station):
            if message.get_type() == "MISSION_REQUEST_INT":
                sent.append(message.seq)
                station.send(waypoint(message.seq, count))
            elif message.get_type() == "MISSION_ACK":
                acks.append(message.type)
            elif message.get_type() == "MISSION_COUNT" or (message.get_type() == "MISSION_ITEM_INT"):
                got.append(getattr(message, "seq", -1))
                if len(got) <= count:
                    station.send(mav.MAVLink_mission_request_int_message(1, 1, len(got) - 1, 0))
        return len(sent) + len(got) > before

    frames = Frames()
    runtime = Runtime(session.service, session.device, None, [link], frames, TurnClock(client), paced=True)
    harbour = Harbour(session, runtime)
    harbour.run(0.05)
    station.send(mav.MAVLink_mission_count_message(1, 1, count, 0))
    while len(sent) < count and harbour.ticks < 300:
        harbour.tick()
    assert sent == list(range(count))
    assert harbour.ticks < 100
    while not acks:  # the check of the plan takes its time beside the loop
        harbour.tick()
    assert acks == [mav.MAV_MISSION_ACCEPTED]
    begin = harbour.ticks
    station.send(mav.MAVLink_mission_request_list_message(1, 1, 0))
    while len(got) <= count and harbour.ticks < begin + 300:
        harbour.tick()
    assert got == list(range(-1, count))
    assert harbour.ticks < begin + 100

    def logged(found: list[MavlinkFrame], message_id: int) -> int:
        number = message_id.to_bytes(3, "little")
        return sum(frame.data[7:10] == number for frame in found)

    assert logged(frames.rx, mav.MAVLINK_MSG_ID_MISSION_ITEM_INT) == count
    assert logged(frames.tx, mav.MAVLINK_MSG_ID_MISSION_REQUEST_INT) == count
    assert logged(frames.rx, mav.MAVLINK_MSG_ID_MISSION_REQUEST_INT) == count
    assert logged(frames.tx, mav.MAVLINK_MSG_ID_MISSION_ITEM_INT) == count
    link.close()
    station.close()


@pytest.mark.parametrize("kind", ["udpin", "tcpin", "serial"])
def test_a_flood_is_named_to_the_others_and_they_are_served(opened: OpenSession, kind: str, tmp_path: Path) -> None:
    port, tcp, log = free_port(), free_port(socket.SOCK_STREAM), tmp_path / "flood.mcap"
    connections, close = [f"udpin:{LOCAL}:{port}", f"tcpin:{LOCAL}:{tcp}"], []
    if kind == "serial":
        device, line = pty.openpty()
        tty.setraw(device)
        os.set_blocking(device, False)
        connections.append(f"{os.ttyname(line)}:921600")
        close = [device, line]
    session = opened(*connections, log=log)
    harbour, station = Harbour(session), Station.udp(port)
    rng = random.Random(3)
    if kind == "serial":
        name = os.ttyname(line)

        def send(data: bytes) -> object:
            return os.write(device, data)
    else:
        loud = (Station.udp(port) if kind == "udpin" else Station.tcp(tcp)).socket
        loud.setblocking(False)
        name, send = "{}:{}".format(*loud.getsockname()), loud.send
    station.beat()
    answered = 0
    for n in range(150):
        for _ in range(4):
            try:
                send(rng.choice((b"\xfe", b"\xfd", b"\xfe\x09\x00")) * 680 if n % 2 else rng.randbytes(2048))
            except BlockingIOError:
                continue
        station.send(mav.MAVLink_ping_message(n, n, 0, 0))
        harbour.tick()
        answered += sum(message.get_type() == "PING" for message in hear_all(station))
    harbour.run(0.05)
    answered += sum(message.get_type() == "PING" for message in hear_all(station))
    assert answered == 150
    named = [text for text in station.texts if text == f"{name} floods its link: throttled"]
    assert len(named) == 1, station.texts
    session.runtime.close()
    session.recorder.close()
    lines = [message.value["msg"] for message in open_log(log).messages("/rosout")]
    assert any(line.startswith(name) and "bytes dropped" in line for line in lines), lines
    for number in close:
        os.close(number)


def test_a_loop_that_waits_at_a_desk_is_not_silent(opened: OpenSession) -> None:
    """The work ends when the ground station has heard the vehicle twice while the loop was waiting for it."""
    session = opened(f"udpin:{LOCAL}:{(port := free_port())}")
    harbour, station = Harbour(session), Station.udp(port)
    station.beat()
    harbour.run(0.03)
    hear_all(station)
    heard, stop = threading.Event(), threading.Event()

    def listen() -> None:
        begin = len(station.beats_s)
        while not stop.is_set():
            station.receive(0.05)
            if len(station.beats_s) >= begin + 2:
                heard.set()
                return

    listener = threading.Thread(target=listen)

    def work(_: None, cancel: Cancel) -> bool:
        return heard.wait(PATIENCE_S)

    for worker in session.parts.workers:
        assert worker.blocking
    task = session.parts.workers[0].submit(0, work, None)
    listener.start()
    answer = task.poll(0)
    stop.set()
    listener.join()
    assert answer is not None and answer.get()


def test_a_serial_link_that_goes_is_named_once_and_comes_back(opened: OpenSession, tmp_path: Path) -> None:
    name = tmp_path / "ttyROV"

    def plug() -> tuple[int, int]:
        device, line = pty.openpty()
        tty.setraw(device)
        name.unlink(missing_ok=True)
        name.symlink_to(os.ttyname(line))
        return device, line

    device, line = plug()
    session = opened(f"udpin:{LOCAL}:{(port := free_port())}", f"{name}:115200")
    os.close(line)
    harbour, station = Harbour(session), Station.udp(port)
    station.beat()
    harbour.run(0.3)
    os.close(device)
    name.unlink()
    harbour.run(2)
    hear_all(station)
    told = [text for text in station.texts if "device gone" in text]
    assert len(told) == 1
    device, line = plug()
    harbour.run(2.5)
    hear_all(station)
    assert len(os.read(device, 4096)) > 0
    assert sum("device gone" in text for text in station.texts) == 1
    os.close(line)
    os.close(device)


@pytest.mark.parametrize(("kind", "sort"), [("udpin", socket.SOCK_DGRAM), ("tcpin", socket.SOCK_STREAM)])
def test_a_client_of_this_machine_is_known_as_such(kind: str, sort: socket.SocketKind) -> None:
    """It may give the vehicle a signing key."""
    port = free_port(sort)
    link = open_link(f"{kind}:{LOCAL}:{port}")
    station = Station.udp(port) if kind == "udpin" else Station.tcp(port)
    heard: list[Received] = []
    begin_s = time.monotonic()
    while not heard and time.monotonic() - begin_s < PATIENCE_S:
        station.beat()
        heard += link.recv(0)
    assert {one.reach for one in heard} == {Reach.MACHINE}
    assert [reach_of(host) for host in ("127.0.0.9", "192.168.2.1")] == [Reach.MACHINE, Reach.NETWORK]
    link.close()
    station.close()


class Broken:
    """A link whose driver breaks its promise never to raise."""

    name = "broken"
    problem = None
    dropped_tx = 0

    def recv(self, t_us: int) -> list[Received]:
        raise DriverError("no such device")

    def send(self, data: bytes, client: int = 0) -> None:
        raise OSError("no such device")

    def filenos(self) -> list[int]:
        return []

    def close(self) -> None:
        pass


class Fickle(Broken):
    """Raises what it is told to, at everything."""

    name = "fickle"
    error: Exception | None = None

    def _work(self) -> None:
        if self.error is not None:
            raise self.error

    @property
    def problem(self) -> None:  # type: ignore[override]
        return self._work()

    def recv(self, t_us: int) -> list[Received]:
        self._work()
        return [Received(b"data", 1, "somebody")]

    def send(self, data: bytes, client: int = 0) -> None:
        self._work()

    def filenos(self) -> list[int]:
        self._work()
        return []

    def close(self) -> None:
        self._work()


@pytest.mark.parametrize("error", [OSError(), DriverError("no such device"), ValueError("a fault"), IndexError()])
def test_whatever_a_driver_raises_ends_nothing_and_the_link_may_come_back(error: Exception) -> None:
    link, guard = Fickle(), Guard(raises=False)
    transport = Transport([link, Fickle()], guard=guard)
    notices: list[str] = []
    for tick in range(1, 2001):
        link.error = error if 100 <= tick < 1000 else None
        frames = transport.receive(tick * TICK_US) + (transport.wait(tick * TICK_US, 0.0) if tick % 100 == 0 else [])
        assert (0 in {frame.link for frame in frames}) is (link.error is None)
        assert 1 in {frame.link for frame in frames}, "the other link goes on"
        transport.send([MavlinkFrame(link=-1, data=b"anything")])
        notices += [notice.text for notice in transport.take_notices(tick * TICK_US)]
    ours = isinstance(error, OSError | DriverError)
    text = (str(error) or "OSError") if ours else f"internal fault ({type(error).__name__})"
    assert notices == [f"fickle: {text}", "fickle: back"]
    faults = guard.take()
    assert bool(faults) is not ours and all(fault.part == "link fickle" for fault in faults)
    link.error = error
    transport.close()


def test_a_link_that_hears_but_cannot_send_stays_named() -> None:
    class Mute(Fickle):
        def send(self, data: bytes, client: int = 0) -> None:
            raise OSError("no route")

    transport, notices = Transport([Mute()]), []
    for tick in range(1, 2001):
        assert transport.receive(tick * TICK_US)
        transport.send([MavlinkFrame(link=-1, data=b"anything")])
        notices += [notice.text for notice in transport.take_notices(tick * TICK_US)]
    assert notices == ["fickle: no route"]


def test_a_heartbeat_is_due_by_real_time() -> None:
    now_s = [0.0]
    transport = Transport([Broken()], now_s=lambda: now_s[0])
    beat = MavlinkFrame(link=0, data=bytes((0xFD, 9, 0, 0, 0, 1, 1, 0, 0, 0)) + bytes(11))
    other = MavlinkFrame(link=0, data=bytes((0xFD, 9, 0, 0, 0, 1, 1, 30, 0, 0)) + bytes(11))
    assert not transport.beat_due
    now_s[0] = 1.15
    transport.send([other])
    assert transport.beat_due
    transport.send([beat])
    assert not transport.beat_due
    now_s[0] = 2.3
    assert transport.beat_due
    assert not Transport([], now_s=lambda: now_s[0]).beat_due


def heartbeat(link: int, component: int, *, client: int = 0, old: bool = False) -> MavlinkFrame:
    """HEARTBEAT of one of our components."""
    head = (0xFE, 9, 0, 1, component, 0) if old else (0xFD, 9, 0, 0, 0, 1, component, 0, 0, 0)
    return MavlinkFrame(link=link, client=client, data=bytes(head) + bytes(11))


@pytest.mark.parametrize("seed", range(20))
def test_every_component_s_heartbeat_is_due_on_every_link_by_real_time(seed: int) -> None:
    """Whatever else goes out, and wherever: no link waits longer for any component than for the autopilot."""
    draw = random.Random(seed)
    now_s, last_s = 0.0, {(link, component): 0.0 for link in (0, 1) for component in (1, 100)}
    transport = Transport([Broken(), Broken()], now_s=lambda: now_s)
    transport.send([heartbeat(link, component) for link, component in last_s])
    for _ in range(400):
        now_s += draw.uniform(0.0, 0.05)
        if transport.beat_due:
            transport.beat([heartbeat(link, component) for link, component in last_s])
            last_s = dict.fromkeys(last_s, now_s)
        key, client = draw.choice(list(last_s)), draw.choice((0, 5))
        if draw.random() < 0.5:
            transport.send([heartbeat(*key, client=client, old=draw.random() < 0.3)])
            if client == 0:
                last_s[key] = now_s
        assert all(now_s - then_s <= 1.16 for then_s in last_s.values())


def test_a_link_that_gets_no_heartbeats_makes_none_due() -> None:
    now_s = [0.0]
    transport = Transport([Broken(), Broken()], now_s=lambda: now_s[0])
    now_s[0] = 1.15
    assert transport.beat_due
    transport.beat([heartbeat(0, 1)])
    for _ in range(30):
        now_s[0] += 0.1
        transport.send([heartbeat(0, 1)])
        assert not transport.beat_due


def test_the_camera_s_heartbeat_does_not_wait_for_the_vehicle_s_clock(opened: OpenSession) -> None:
    """A run that is slower than real time: each turn of waiting takes a second of it, and no vehicle time."""
    session = opened(f"udpin:{LOCAL}:{free_port()}", scenario="paper-tank", sensors="camera")
    now_s = [0.0]
    sent: list[tuple[float, int]] = []

    class Listening(Broken):
        """Writes down whose heartbeats come when."""

        def send(self, data: bytes, client: int = 0, beside: frozenset[int] = frozenset()) -> None:
            if data[:1] == b"\xfd" and data[7:10] == b"\0\0\0":
                sent.append((now_s[0], data[6]))

    transport = Transport([Listening()], now_s=lambda: now_s[0])
    session.runtime._transport.close()
    session.runtime._transport = transport
    session.runtime.tick(0)
    for _ in range(20):
        now_s[0] += 0.2
        session.runtime.attend()
    for component in (1, 100):
        times = [then_s for then_s, who in sent if who == component]
        assert times and max(b - a for a, b in zip(times, [*times[1:], now_s[0]], strict=True)) <= 1.31
