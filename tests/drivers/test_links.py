"""One contract, every link: what a MAVLink connection owes the service, over real sockets and a pseudo-terminal."""

import contextlib
import os
import pty
import select
import socket
import tty
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from autopilot.core.clients import ClientRecord
from autopilot.core.errors import ConfigError, DriverError
from autopilot.drivers.admission import KEEP_US
from autopilot.drivers.links import open_link
from autopilot.drivers.protocols import Link, Received
from autopilot.drivers.serial_port import REOPEN_US
from autopilot.drivers.tcp import GRACE_US, MAX_CLIENTS, RECONNECT_US, TcpServer
from autopilot.drivers.udp import FORGET_UNPROVEN_US, FORGET_US, MAX_CLIENT_BYTES, MAX_PEERS, UdpIn
from autopilot.mavlink.dialect import mav
from autopilot.run.children import LOCAL, free_port

PATIENT_S = 600.0
"""Against a hang only: what is waited for has been sent."""
KINDS = ("udpin", "udpout", "tcpin", "tcp", "serial")


def frame(number: int) -> bytes:
    """Bytes with the shape of a MAVLink frame (of version 1: links do not number those)."""
    return bytes([0xFE, 1, 0, 1, 1, 0, number % 256, 0x12, 0x34])


def entries(link: Link, count: int, t_us: int = 0) -> list[Received]:
    """Poll until ``count`` entries came or nothing comes any more."""
    out: list[Received] = []
    for _ in range(200):
        out += link.recv(t_us)
        if len(out) >= count:
            break
        select.select(link.filenos(), [], [], 0.005)
    return out


def receive(link: Link, count: int, t_us: int = 0) -> list[bytes]:
    """What came, whoever sent it."""
    return [entry.data for entry in entries(link, count, t_us)]


class Peer:
    """The other end: raw bytes through a file descriptor or socket."""

    def __init__(self, send: Callable[[bytes], object], read: Callable[[], bytes]) -> None:
        self.send = send
        self.read = read


def udp(port: int | None = None) -> socket.socket:
    """Bound to any port, or connected to that one."""
    end = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    end.settimeout(PATIENT_S)
    if port is None:
        end.bind((LOCAL, 0))
    else:
        end.connect((LOCAL, port))
    return end


def tcp(port: int) -> socket.socket:
    """Connected to that port."""
    return socket.create_connection((LOCAL, port), PATIENT_S)


def terminal() -> tuple[int, int]:
    """A pseudo-terminal: the device's end and the line."""
    device, line = pty.openpty()
    tty.setraw(device)
    return device, line


def socket_peer(end: socket.socket) -> Peer:
    end.settimeout(PATIENT_S)
    return Peer(end.send, lambda: end.recv(4096))


@contextlib.contextmanager
def connected(kind: str) -> Iterator[tuple[Link, Peer]]:
    """An open link of that kind and its other end, which has been heard once."""
    with contextlib.ExitStack() as stack:
        if kind == "udpin":
            port = free_port()
            link = open_link(f"udpin:{LOCAL}:{port}")
            peer = socket_peer(stack.enter_context(udp(port)))
        elif kind == "udpout":
            end = stack.enter_context(udp())
            link = open_link(f"udpout:{LOCAL}:{end.getsockname()[1]}")
            link.send(b"hello")
            _, address = end.recvfrom(100)
            end.connect(address)
            peer = socket_peer(end)
        elif kind == "tcpin":
            port = free_port(socket.SOCK_STREAM)
            link = open_link(f"tcpin:{LOCAL}:{port}")
            peer = socket_peer(stack.enter_context(tcp(port)))
        elif kind == "tcp":
            server = stack.enter_context(socket.create_server((LOCAL, 0)))
            link = open_link(f"tcp:{LOCAL}:{server.getsockname()[1]}")
            peer = socket_peer(stack.enter_context(server.accept()[0]))
        else:
            device, line = terminal()
            stack.callback(os.close, device)
            stack.callback(os.close, line)
            link = open_link(f"{os.ttyname(line)}:115200")
            peer = Peer(lambda data: os.write(device, data), lambda: os.read(device, 4096))
        stack.callback(link.close)
        peer.send(frame(0))
        assert receive(link, 1) == [frame(0)]
        yield link, peer


@pytest.fixture(params=KINDS)
def ends(request: pytest.FixtureRequest) -> Iterator[tuple[Link, Peer]]:
    with connected(request.param) as both:
        yield both


def test_frames_arrive_whole_and_in_order(ends: tuple[Link, Peer]) -> None:
    link, peer = ends
    for number in range(1, 20):
        peer.send(frame(number))
    assert receive(link, 19) == [frame(number) for number in range(1, 20)]
    assert link.recv(0) == []


def test_what_is_sent_arrives(ends: tuple[Link, Peer]) -> None:
    link, peer = ends
    link.send(frame(7))
    assert peer.read() == frame(7)


def test_garbage_does_not_raise_and_good_frames_still_pass(ends: tuple[Link, Peer]) -> None:
    link, peer = ends
    peer.send(b"\x00garbage\xff")
    peer.send(frame(3))
    peer.send(frame(4))
    assert receive(link, 2)[-2:] == [frame(3), frame(4)]


def test_a_link_knows_its_name(ends: tuple[Link, Peer]) -> None:
    assert ":" in ends[0].name


def test_closed_links_are_silent(ends: tuple[Link, Peer]) -> None:
    link, _ = ends
    link.close()
    link.close()
    assert link.recv(0) == []
    link.send(frame(1))
    assert link.recv(0) == []


@pytest.fixture
def server() -> Iterator[TcpServer]:
    link = open_link(f"tcpin:{LOCAL}:{free_port(socket.SOCK_STREAM)}")
    assert isinstance(link, TcpServer)
    with contextlib.closing(link):
        yield link


def port_of(link: Link) -> int:
    return int(link.name.rpartition(":")[2])


@pytest.mark.parametrize("kind", ["udpin", "tcpin"])
def test_a_port_in_use_is_one_clear_line(kind: str) -> None:
    with connected(kind) as (link, _), pytest.raises(DriverError) as refusal:
        open_link(link.name)
    text = str(refusal.value)
    assert "\n" not in text
    assert f"port {port_of(link)} is already in use; stop the program" in text


def test_a_server_that_is_not_there_is_named() -> None:
    with pytest.raises(DriverError, match=r"nobody answers at 127\.0\.0\.1:\d+ .*; start the server"):
        open_link(f"tcp:{LOCAL}:{free_port(socket.SOCK_STREAM)}")


def test_an_unknown_host_is_named() -> None:
    with pytest.raises(DriverError, match=r"host 'no-such-host\.invalid' cannot be found"):
        open_link("udpout:no-such-host.invalid:14550")


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("/dev/tty-that-is-not:57600", "cannot be opened"),
        ("/dev/null:57600", "is not a serial line"),
        ("/dev/null:12345", "12345 baud"),
    ],
)
def test_a_serial_line_that_cannot_be_had_is_named(name: str, message: str) -> None:
    with pytest.raises(DriverError, match=message):
        open_link(name)


def test_udpout_survives_a_receiver_that_is_not_there() -> None:
    link = open_link(f"udpout:{LOCAL}:{free_port()}")
    for number in range(5):
        link.send(frame(number))
        assert link.recv(0) == []
    link.close()


def test_udpin_answers_everyone_it_has_heard_up_to_a_limit() -> None:
    """One place more than MAX_PEERS; all say something valid all the time but the last, who may take no place."""
    link = UdpIn("test", LOCAL, port := free_port())
    link.standing = lambda client: ClientRecord(valid_us=0)
    with contextlib.ExitStack() as stack:
        ends = [stack.enter_context(udp()) for _ in range(MAX_PEERS + 3)]
        for number, end in enumerate(ends):
            end.sendto(frame(number), (LOCAL, port))
            known = number < MAX_PEERS + 1
            assert receive(link, 1) == ([frame(number)] if known else [])
        assert link.take_news() == (
            True,
            f"{LOCAL}:{ends[-2].getsockname()[1]} turned away: 17 clients are served (1 more)",
        )
        link.send(frame(99))
        assert [end.recv(100) for end in ends[: MAX_PEERS + 1]] == [frame(99)] * (MAX_PEERS + 1)
        # Who has been silent makes room, who speaks stays: any number of others cannot push him out.
        link.standing = lambda client: ClientRecord(valid_us=KEEP_US if client == 1 else client)
        ends[0].sendto(frame(1), (LOCAL, port))
        assert receive(link, 1, KEEP_US) == [frame(1)]
        ends[-1].sendto(frame(2), (LOCAL, port))
        assert receive(link, 1, KEEP_US + 100) == [frame(2)]
        ports = [number for _, number in link.peers]
        assert ends[-1].getsockname()[1] in ports and ends[0].getsockname()[1] in ports
        assert ends[1].getsockname()[1] not in ports
        assert link.take_news() == (False, f"{LOCAL}:{ends[1].getsockname()[1]} lost its place: silent for 5 s")
    link.close()


@pytest.mark.parametrize("proven", [True, False])
def test_udpin_forgets_who_is_silent_and_keeps_who_speaks(proven: bool) -> None:
    forget_us = FORGET_US if proven else FORGET_UNPROVEN_US
    link = UdpIn("test", LOCAL, port := free_port())
    link.standing = lambda client: ClientRecord(valid_us=0 if proven else None)
    with udp() as silent, udp() as lively:
        silent.sendto(b"1", (LOCAL, port))
        lively.sendto(b"2", (LOCAL, port))
        receive(link, 2)
        lively.sendto(b"3", (LOCAL, port))
        receive(link, 1, forget_us // 2)
        assert len(link.peers) == 2
        link.recv(forget_us + 1)
        assert [port for _, port in link.peers] == [lively.getsockname()[1]]
    link.close()


@pytest.mark.parametrize("kind", ["udpin", "tcpin"])
def test_clients_of_a_port_are_told_apart_and_answered_apart(kind: str) -> None:
    port = free_port(socket.SOCK_DGRAM if kind == "udpin" else socket.SOCK_STREAM)
    link = open_link(f"{kind}:{LOCAL}:{port}")
    with contextlib.ExitStack() as stack:
        ends = [stack.enter_context((udp if kind == "udpin" else tcp)(port)) for _ in range(3)]
        numbers = []
        for n, end in enumerate(ends):
            end.send(frame(n))
            (entry,) = entries(link, 1)
            assert entry.sender == f"{LOCAL}:{end.getsockname()[1]}"
            numbers.append(entry.client)
        assert len(set(numbers)) == 3 and 0 not in numbers
        ends[1].send(frame(5))
        assert [entry.client for entry in entries(link, 1)] == [numbers[1]]
        for n in (2, 0, 1):
            link.send(frame(10 + n), numbers[n])
        link.send(frame(20))
        link.send(frame(21), 999)  # nobody
        for n, end in enumerate(ends):
            got = b""
            while len(got) < 2 * len(frame(0)):
                got += end.recv(2048)
            assert got == frame(10 + n) + frame(20)
    link.close()


def test_a_flood_on_one_address_leaves_room_for_the_others() -> None:
    link = UdpIn("test", LOCAL, port := free_port())
    with udp() as loud, udp() as quiet:
        for _ in range(20):
            loud.sendto(b"\xfe" * 1024, (LOCAL, port))
        quiet.sendto(frame(1), (LOCAL, port))
        got = entries(link, 1 + MAX_CLIENT_BYTES // 1024)
        assert got[-1].data == frame(1)
        assert sum(len(entry.data) for entry in got[:-1]) == MAX_CLIENT_BYTES
    link.close()


def open_ports(kind: str) -> set[tuple[str, int]]:
    """Local addresses of this machine's sockets, as the system shows them."""
    lines = Path(f"/proc/net/{kind}").read_text().splitlines()[1:]
    pairs = [line.split()[1].split(":") for line in lines]
    return {(socket.inet_ntoa(bytes.fromhex(host)[::-1]), int(port, 16)) for host, port in pairs}


@pytest.mark.skipif(not Path("/proc/net/udp").exists(), reason="needs Linux's list of sockets")
@pytest.mark.parametrize("text", ["udpout:127.0.0.1:{}", "udpin::{}", "udpin:127.0.0.1:{}", "tcpin::{}", "udp://:{}"])
def test_nothing_is_open_beyond_the_loopback_unless_it_is_asked_for(text: str) -> None:
    kind = "tcp" if text.startswith("tcp") else "udp"
    port = free_port(socket.SOCK_STREAM if kind == "tcp" else socket.SOCK_DGRAM)
    before = open_ports(kind)
    link = open_link(text.format(port))
    link.send(frame(1))
    opened = open_ports(kind) - before
    link.close()
    assert (LOCAL, port) in opened or text.startswith("udpout")
    assert not any(host == "0.0.0.0" for host, _ in opened), opened


def test_udpout_hears_its_target_and_no_other_host() -> None:
    with udp() as target, udp() as sibling, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        try:
            stranger.bind(("127.0.0.9", 0))
        except OSError:
            pytest.skip("one loopback address only")
        link = open_link(f"udpout:{LOCAL}:{target.getsockname()[1]}")
        link.send(frame(1))
        _, vehicle = target.recvfrom(100)
        stranger.sendto(frame(2), vehicle)
        target.sendto(frame(3), vehicle)
        sibling.sendto(frame(4), vehicle)
        first, second = entries(link, 2)
        assert (first.data, second.data) == (frame(3), frame(4))
        # The same host on another port is a client of its own: it is answered, and gets nothing else.
        link.send(frame(5), second.client)
        link.send(frame(6))
        assert sibling.recv(100) == frame(5)
        assert target.recv(100) == frame(6)
        link.close()


def test_a_serial_device_that_goes_is_named_and_opened_again(tmp_path: Path) -> None:
    """The device's name is a link, as udev makes one: it is gone while the device is."""
    name = tmp_path / "ttyROV"
    device, line = terminal()
    name.symlink_to(os.ttyname(line))
    link = open_link(f"{name}:115200")
    os.close(line)
    os.write(device, frame(1))
    assert receive(link, 1) == [frame(1)]
    assert link.problem is None
    os.close(device)
    name.unlink()
    for n in range(300):
        link.send(frame(2))
        assert link.recv(n * 10_000) == []
    assert link.problem == "device gone, check the cable"
    assert link.filenos() == []
    assert link.dropped_tx > 0
    device, line = terminal()
    name.symlink_to(os.ttyname(line))
    assert link.recv(3_000_000 + REOPEN_US) == []
    assert link.problem is None
    os.write(device, frame(3))
    assert receive(link, 1) == [frame(3)]
    link.send(frame(4))
    assert os.read(device, 100) == frame(4)
    link.close()
    assert link.problem is None and link.recv(10**9) == []
    os.close(line)
    os.close(device)


def test_a_serial_line_whose_close_fails_is_let_go_of_and_opened_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    device, line = terminal()
    name = tmp_path / "ttyROV"
    name.symlink_to(os.ttyname(line))
    link = open_link(f"{name}:115200")
    (opened,) = link.filenos()
    really_close, closed = os.close, []

    def unplugged(fd: int) -> None:
        really_close(fd)
        closed.append(fd)
        raise OSError(5, "Input/output error")

    with monkeypatch.context() as patch:
        patch.setattr(os, "close", unplugged)
        patch.setattr(os, "read", lambda *_: b"")
        assert link.recv(0) == []
        assert link.problem is not None and link.filenos() == []
        assert link.recv(1) == []
    assert closed == [opened], "once: the number may be another file's by now"
    assert link.recv(2 * REOPEN_US) == []
    assert link.problem is None
    os.write(device, frame(1))
    assert receive(link, 1) == [frame(1)]
    link.close()
    os.close(line)
    os.close(device)


def test_tcp_clients_do_not_mix_and_all_get_everything(server: TcpServer) -> None:
    with tcp(port_of(server)) as one, tcp(port_of(server)) as two:
        one.send(frame(1)[:5])
        two.send(frame(2)[:7])
        assert receive(server, 1) == []
        one.send(frame(1)[5:])
        two.send(frame(2)[7:])
        assert sorted(receive(server, 2)) == [frame(1), frame(2)]
        server.send(frame(9))
        assert one.recv(100) == two.recv(100) == frame(9)
        two.close()
        one.send(frame(3))
        assert receive(server, 1) == [frame(3)]
        server.send(frame(10))
        assert one.recv(100) == frame(10)


def test_a_tcp_connection_whose_other_end_is_gone_is_noticed(server: TcpServer) -> None:
    """A cut tether says no goodbye: the system asks, and ends the connection within half a minute."""
    with tcp(port_of(server)) as end:
        end.send(frame(1))
        receive(server, 1)
        (number,) = [number for number in server.filenos() if number != server.filenos()[-1]]
        with socket.socket(fileno=os.dup(number)) as accepted:
            assert accepted.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE)
            idle, gap, count, unacknowledged_ms = (
                accepted.getsockopt(socket.IPPROTO_TCP, option)
                for option in (
                    socket.TCP_KEEPIDLE,
                    socket.TCP_KEEPINTVL,
                    socket.TCP_KEEPCNT,
                    socket.TCP_USER_TIMEOUT,
                )
            )
            assert idle + gap * count <= 30 and 0 < unacknowledged_ms <= 30_000


def test_tcp_clients_that_say_nothing_make_room(server: TcpServer) -> None:
    """In the order in which they came; who came last and has not had his time stays, and others wait meanwhile."""
    with contextlib.ExitStack() as stack:
        silent = [stack.enter_context(tcp(port_of(server))) for _ in range(MAX_CLIENTS + 1)]
        for _ in range(4):
            server.recv(0)
        assert server.clients == MAX_CLIENTS + 1
        late = stack.enter_context(tcp(port_of(server)))
        late.send(frame(7))
        assert entries(server, 1, GRACE_US - 1) == []
        assert server.take_news() == (True, "a client waits for a place: 9 are served (199 more)")
        assert receive(server, 1, GRACE_US) == [frame(7)]
        name = f"{LOCAL}:{silent[0].getsockname()[1]}"
        assert server.take_news() == (False, f"{name} lost its place: sent nothing valid")
        assert silent[0].recv(10) == b""


def test_tcp_clients_that_are_heard_keep_their_places_and_one_is_kept_for_the_operator(server: TcpServer) -> None:
    now_us, operator = 0, 0
    server.standing = lambda client: ClientRecord(valid_us=now_us, in_control=client == operator)
    with contextlib.ExitStack() as stack:
        for _ in range(MAX_CLIENTS + 1):
            stack.enter_context(tcp(port_of(server))).send(frame(1))
        entries(server, MAX_CLIENTS + 1, 0)
        now_us = KEEP_US
        station = stack.enter_context(tcp(port_of(server)))
        station.send(frame(2))
        (heard,) = entries(server, 1, now_us)
        operator = heard.client
        now_us *= 10
        another = stack.enter_context(tcp(port_of(server)))
        another.send(frame(3))
        assert [entry.data for entry in entries(server, 1, now_us)] == [frame(3)]
        station.send(frame(4))
        assert [entry.client for entry in entries(server, 1, now_us)] == [operator]


def test_tcp_server_cuts_off_a_client_that_does_not_read(server: TcpServer) -> None:
    with tcp(port_of(server)) as lazy:
        lazy.send(frame(1))
        receive(server, 1)
        for _ in range(20_000):
            server.send(bytes(280))
            if server.dropped_tx:
                break
        assert server.clients == 0
        assert server.take_news() == (True, f"{LOCAL}:{lazy.getsockname()[1]} cut off: it does not read")


def test_tcp_client_connects_again() -> None:
    with socket.create_server((LOCAL, 0)) as server:
        server.settimeout(PATIENT_S)
        link = open_link(f"tcp:{LOCAL}:{server.getsockname()[1]}")
        first, _ = server.accept()
        first.send(frame(1))
        assert receive(link, 1) == [frame(1)]
        first.close()
        assert entries(link, 1) == []
        assert link.problem == "server gone, connecting again"
        for n in range(300):
            link.recv(RECONNECT_US + n * 10_000)
        assert link.problem is None
        second, _ = server.accept()
        second.send(frame(2))
        assert receive(link, 1) == [frame(2)]
        link.send(frame(3))
        second.settimeout(PATIENT_S)
        assert second.recv(100) == frame(3)
        second.close()
        link.close()


def test_a_vehicle_that_calls_is_found_and_then_speaks_to_who_has_answered() -> None:
    """Heartbeats to everyone on the network until a ground station answers; everything to it from then on."""
    with contextlib.ExitStack() as stack:
        station = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        station.bind(("0.0.0.0", 0))
        station.settimeout(PATIENT_S)
        link = open_link(f"udpbcast:127.255.255.255:{station.getsockname()[1]}")
        stack.callback(link.close)
        packer = mav.MAVLink(None, srcSystem=1, srcComponent=1)
        beat = mav.MAVLink_heartbeat_message(12, 12, 0, 0, 4, 3).pack(packer)
        telemetry = mav.MAVLink_attitude_message(0, 0, 0, 0, 0, 0, 0).pack(packer)
        assert link.recv(0) == []
        link.send(telemetry)
        link.send(beat)
        data, address = station.recvfrom(300)
        assert data[7:10] == b"\0\0\0", "only heartbeats are called out"
        station.sendto(b"answer", address)
        assert receive(link, 1, 10_000) == [b"answer"]
        for message in (telemetry, beat):
            link.send(message)
            assert station.recv(300)[7:10] == message[7:10]
        select.select([station], [], [], 0.05)
        station.setblocking(False)
        with pytest.raises(BlockingIOError):
            station.recv(300)  # once, and not called out as well
        link.recv(10_000 + KEEP_US + 1)
        link.send(beat)
        station.settimeout(PATIENT_S)
        assert {station.recv(300)[7:10] for _ in range(2)} == {b"\0\0\0"}, "silent for long: called out again"


def test_calling_needs_an_address_to_call_to() -> None:
    with pytest.raises(ConfigError, match="names no host"):
        open_link("udpbcast::14550")
