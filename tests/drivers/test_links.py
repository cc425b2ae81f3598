"""One contract, every link: what a MAVLink connection owes the service, over real sockets and a pseudo-terminal."""

import contextlib
import os
import pty
import select
import socket
import tty
from collections.abc import Callable, Iterator

import pytest

from autopilot.core.errors import DriverError
from drivers.links import open_link
from drivers.protocols import Link
from drivers.tcp import MAX_CLIENTS, RECONNECT_AFTER_CALLS
from drivers.udp import FORGET_AFTER_CALLS, MAX_PEERS, UdpIn

LOCAL = "127.0.0.1"
PATIENT_S = 600.0
"""Against a hang only: what is waited for has been sent."""
KINDS = ("udpin", "udpout", "tcpin", "tcp", "serial")


def frame(number: int) -> bytes:
    """Bytes with the shape of a MAVLink 2 frame."""
    return bytes([0xFD, 1, 0, 0, number % 256, 1, 1, 0, 0, 0, number % 256, 0x12, 0x34])


def free_port(kind: int = socket.SOCK_DGRAM) -> int:
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind((LOCAL, 0))
        return int(probe.getsockname()[1])


def receive(link: Link, count: int) -> list[bytes]:
    """Poll until ``count`` entries came or nothing comes any more."""
    out: list[bytes] = []
    for _ in range(200):
        out += link.recv()
        if len(out) >= count:
            break
        select.select([], [], [], 0.005)
    return out


class Peer:
    """The other end: raw bytes through a file descriptor or socket."""

    def __init__(self, send: Callable[[bytes], object], read: Callable[[], bytes]) -> None:
        self.send = send
        self.read = read


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
            end = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            end.connect((LOCAL, port))
            peer = socket_peer(end)
        elif kind == "udpout":
            end = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            end.bind((LOCAL, 0))
            end.settimeout(PATIENT_S)
            link = open_link(f"udpout:{LOCAL}:{end.getsockname()[1]}")
            link.send(b"hello")
            _, address = end.recvfrom(100)
            end.connect(address)
            peer = socket_peer(end)
        elif kind == "tcpin":
            port = free_port(socket.SOCK_STREAM)
            link = open_link(f"tcpin:{LOCAL}:{port}")
            peer = socket_peer(stack.enter_context(socket.create_connection((LOCAL, port))))
        elif kind == "tcp":
            server = stack.enter_context(socket.create_server((LOCAL, 0)))
            link = open_link(f"tcp:{LOCAL}:{server.getsockname()[1]}")
            peer = socket_peer(stack.enter_context(server.accept()[0]))
        else:
            device, line = pty.openpty()
            stack.callback(os.close, device)
            stack.callback(os.close, line)
            tty.setraw(device)
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
    assert link.recv() == []


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
    assert link.recv() == []
    link.send(frame(1))
    assert link.recv() == []


@pytest.mark.parametrize("kind", ["udpin", "tcpin"])
def test_a_port_in_use_is_one_clear_line(kind: str) -> None:
    with connected(kind) as (link, _), pytest.raises(DriverError) as refusal:
        open_link(link.name)
    text = str(refusal.value)
    assert "\n" not in text
    assert f"port {link.name.rpartition(':')[2]} is already in use; stop the program" in text


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
        assert link.recv() == []
    link.close()


def test_udpin_answers_everyone_it_has_heard_up_to_a_limit() -> None:
    link = UdpIn("test", LOCAL, port := free_port())
    with contextlib.ExitStack() as stack:
        ends = [stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) for _ in range(MAX_PEERS + 2)]
        for number, end in enumerate(ends):
            end.settimeout(PATIENT_S)
            end.sendto(frame(number), (LOCAL, port))
            assert receive(link, 1) == [frame(number)]
        assert len(link.peers) == MAX_PEERS
        link.send(frame(99))
        assert [end.recv(100) for end in ends[2:]] == [frame(99)] * MAX_PEERS
        ends[0].setblocking(False)
        with pytest.raises(BlockingIOError):
            ends[0].recv(100)
    link.close()


def test_udpin_forgets_who_is_silent_and_keeps_who_speaks() -> None:
    link = UdpIn("test", LOCAL, port := free_port())
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as silent,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as lively,
    ):
        silent.sendto(b"1", (LOCAL, port))
        lively.sendto(b"2", (LOCAL, port))
        receive(link, 2)
        for _ in range(FORGET_AFTER_CALLS // 2):
            link.recv()
        lively.sendto(b"3", (LOCAL, port))
        receive(link, 1)
        for _ in range(FORGET_AFTER_CALLS // 2 + 1):
            link.recv()
        assert [port for _, port in link.peers] == [lively.getsockname()[1]]
    link.close()


def test_tcp_clients_do_not_mix_and_all_get_everything() -> None:
    link = open_link(f"tcpin:{LOCAL}:{(port := free_port(socket.SOCK_STREAM))}")
    with socket.create_connection((LOCAL, port)) as one, socket.create_connection((LOCAL, port)) as two:
        one.settimeout(PATIENT_S)
        two.settimeout(PATIENT_S)
        one.send(frame(1)[:5])
        two.send(frame(2)[:7])
        assert receive(link, 1) == []
        one.send(frame(1)[5:])
        two.send(frame(2)[7:])
        assert sorted(receive(link, 2)) == [frame(1), frame(2)]
        link.send(frame(9))
        assert one.recv(100) == two.recv(100) == frame(9)
        two.close()
        one.send(frame(3))
        assert receive(link, 1) == [frame(3)]
        link.send(frame(10))
        assert one.recv(100) == frame(10)
    link.close()


def test_tcp_server_turns_further_clients_away() -> None:
    link = open_link(f"tcpin:{LOCAL}:{(port := free_port(socket.SOCK_STREAM))}")
    with contextlib.ExitStack() as stack:
        for number in range(MAX_CLIENTS):
            client = stack.enter_context(socket.create_connection((LOCAL, port)))
            client.send(frame(number))
            assert receive(link, 1) == [frame(number)]
        late = stack.enter_context(socket.create_connection((LOCAL, port)))
        late.settimeout(PATIENT_S)
        for _ in range(20):
            link.recv()
            select.select([], [], [], 0.002)
        assert late.recv(10) == b""
    link.close()


def test_tcp_server_cuts_off_a_client_that_does_not_read() -> None:
    link = open_link(f"tcpin:{LOCAL}:{(port := free_port(socket.SOCK_STREAM))}")
    with socket.create_connection((LOCAL, port)) as lazy:
        lazy.send(frame(1))
        receive(link, 1)
        for _ in range(20_000):
            link.send(bytes(280))
            if link.dropped_tx:  # type: ignore[attr-defined]
                break
        assert link.clients == 0  # type: ignore[attr-defined]
    link.close()


def test_tcp_client_connects_again() -> None:
    with socket.create_server((LOCAL, 0)) as server:
        server.settimeout(PATIENT_S)
        link = open_link(f"tcp:{LOCAL}:{server.getsockname()[1]}")
        first, _ = server.accept()
        first.send(frame(1))
        assert receive(link, 1) == [frame(1)]
        first.close()
        for _ in range(3 * RECONNECT_AFTER_CALLS):
            link.recv()
        second, _ = server.accept()
        second.send(frame(2))
        assert receive(link, 1) == [frame(2)]
        link.send(frame(3))
        second.settimeout(PATIENT_S)
        assert second.recv(100) == frame(3)
        second.close()
        link.close()
