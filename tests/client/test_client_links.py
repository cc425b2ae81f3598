"""Sockets and connection strings of the client."""

import socket
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import development as mav

from autopilot.client.client_links import TcpLink, UdpLink, open_link, parse_connection
from autopilot.client.texts import TextCollector
from autopilot.core.errors import DriverError


@pytest.mark.parametrize(
    ("text", "meaning"),
    [
        ("udpout:127.0.0.1:14540", ("udpout", "127.0.0.1", 14540)),
        ("udpin:0.0.0.0:14550", ("udpin", "0.0.0.0", 14550)),
        ("udp:0.0.0.0:14550", ("udpin", "0.0.0.0", 14550)),
        ("udpout://10.0.0.2:14540", ("udpout", "10.0.0.2", 14540)),
        ("udp://:14540", ("udpin", "127.0.0.1", 14540)),
        ("tcp:localhost:5760", ("tcp", "localhost", 5760)),
        ("tcpout://localhost:5760", ("tcp", "localhost", 5760)),
    ],
)
def test_connection_strings(text: str, meaning: tuple[str, str, int]) -> None:
    assert parse_connection(text) == meaning


@pytest.mark.parametrize("text", ["", "14550", "udp", "udpout:host", "udpout:host:99999", "ftp:host:21", "udpin:h:x"])
def test_other_strings_are_refused_with_what_to_use(text: str) -> None:
    with pytest.raises(DriverError, match="use udpout:HOST:PORT"):
        parse_connection(text)


def test_datagrams_find_their_way_back() -> None:
    vehicle = UdpLink("127.0.0.1", 0, listen=True)
    port = vehicle._socket.getsockname()[1]
    client = open_link(f"udpout:127.0.0.1:{port}")
    try:
        vehicle.send(b"nobody has spoken yet")
        client.send(b"hello")
        assert vehicle.receive(2.0) == b"hello"
        vehicle.send(b"yes")
        assert client.receive(2.0) == b"yes"
        assert client.receive(0.0) == b""
    finally:
        client.close()
        vehicle.close()


def test_nobody_at_the_other_end_is_silence() -> None:
    probe = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    probe.bind(("127.0.0.1", 0))
    port = probe.getsockname()[1]
    probe.close()
    client = open_link(f"udpout:127.0.0.1:{port}")
    try:
        for _ in range(3):
            client.send(b"hello")
            assert client.receive(0.02) == b""
    finally:
        client.close()


def test_a_port_in_use_is_said_in_one_line() -> None:
    taken = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    taken.bind(("127.0.0.1", 0))
    port = taken.getsockname()[1]
    try:
        with pytest.raises(DriverError, match=rf"udpin:127.0.0.1:{port}.*another program"):
            open_link(f"udpin:127.0.0.1:{port}")
    finally:
        taken.close()


def test_tcp_there_and_back_and_its_end() -> None:
    server = socket.create_server(("127.0.0.1", 0))
    port = server.getsockname()[1]
    client = open_link(f"tcp:127.0.0.1:{port}")
    assert isinstance(client, TcpLink)
    peer, _ = server.accept()
    try:
        client.send(b"abc")
        assert peer.recv(10) == b"abc"
        peer.sendall(b"def")
        assert client.receive(2.0) == b"def"
        assert client.receive(0.0) == b""
        peer.close()
        with pytest.raises(DriverError, match="closed by the vehicle"):
            client.receive(2.0)
    finally:
        client.close()
        peer.close()
        server.close()
    with pytest.raises(DriverError, match="is the vehicle running"):
        open_link(f"tcp:127.0.0.1:{port}")


def _chunks(text: str, text_id: int) -> list[Any]:
    pieces = [text[k : k + 50] for k in range(0, len(text), 50)]
    if len(text) % 50 == 0:
        pieces.append("")
    return [mav.MAVLink_statustext_message(4, p.encode(), text_id, k) for k, p in enumerate(pieces)]


def _decoded(message: Any) -> Any:
    message.text = message.text.decode() if isinstance(message.text, bytes) else message.text
    return message


@given(st.text(alphabet="abc de", min_size=51, max_size=240), st.randoms(use_true_random=False))
def test_chunks_in_any_order_and_doubled_give_the_text_once(text: str, rng: Any) -> None:
    messages = [_decoded(m) for m in _chunks(text, 7) * 2]
    rng.shuffle(messages)
    collector = TextCollector()
    found = [t.text for k, m in enumerate(messages) for t in collector.feed(m, 0.001 * k)]
    assert found == [text]


def test_a_lost_chunk_leaves_a_mark() -> None:
    messages = [_decoded(m) for m in _chunks("x" * 120, 3)]
    collector = TextCollector()
    assert collector.feed(messages[0], 0.0) == []
    assert collector.feed(messages[2], 0.1) == []
    assert collector.flush(0.2) == []
    (text,) = collector.flush(0.5)
    assert text.text == "x" * 50 + "[...]" + "x" * 20
