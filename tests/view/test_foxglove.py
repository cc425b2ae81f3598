"""``--foxglove``: a viewer that speaks the Foxglove WebSocket protocol is sent what a log holds."""

import base64
import importlib.util
import json
import math
import os
import socket
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from viewers import PATIENCE_S, run

from autopilot.cli.sitl_command import sitl
from autopilot.core.errors import ConfigError
from autopilot.log.cdr import decode, parse_definition
from autopilot.log.topics import TOPICS

needs_sdk = pytest.mark.skipif(importlib.util.find_spec("foxglove") is None, reason="the extra foxglove is optional")


class Viewer:
    """A WebSocket client (RFC 6455), as much of one as this takes."""

    def __init__(self, port: int) -> None:
        self._socket = socket.create_connection(("127.0.0.1", port), PATIENCE_S)
        key = base64.b64encode(os.urandom(16)).decode()
        self._socket.sendall(
            f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            f"Sec-WebSocket-Key: {key}\r\nSec-WebSocket-Version: 13\r\n"
            "Sec-WebSocket-Protocol: foxglove.sdk.v1\r\n\r\n".encode()
        )
        self._stream = self._socket.makefile("rb")
        assert b" 101 " in self._stream.readline()
        while self._stream.readline() != b"\r\n":
            pass

    def send(self, message: dict[str, Any]) -> None:
        data, mask = json.dumps(message).encode(), os.urandom(4)
        head = b"\x81" + (
            struct.pack(">B", 0x80 | len(data)) if len(data) < 126 else struct.pack(">BH", 0xFE, len(data))
        )
        self._socket.sendall(head + mask + bytes(byte ^ mask[i % 4] for i, byte in enumerate(data)))

    def messages(self) -> Iterator[dict[str, Any] | bytes]:
        """Text as JSON, bytes as they are."""
        while True:
            kind, length = struct.unpack(">BB", self._stream.read(2))
            if length >= 126:
                (length,) = struct.unpack(">H" if length == 126 else ">Q", self._stream.read(2 if length == 126 else 8))
            data = self._stream.read(length)
            if kind & 15 == 1:
                yield json.loads(data)
            elif kind & 15 == 2:
                yield data

    def close(self) -> None:
        self._socket.close()


@needs_sdk
def test_a_viewer_gets_the_topics_of_the_log(tmp_path: Path) -> None:
    with run(tmp_path, "paper-tank", "--start", "--sensors", "pose", "--foxglove", "0") as made:
        viewer = Viewer(int(made.printed(r"foxglove: ws://127\.0\.0\.1:(\d+)\n")))
        channels: dict[str, dict[str, Any]] = {}
        stream = viewer.messages()
        while not set(TOPICS) <= set(channels):
            message = next(stream)
            if isinstance(message, dict) and message["op"] == "advertise":
                channels.update({each["topic"]: each for each in message["channels"]})
        wanted = ["/nav/state", "/sim/truth", "/out/thrusters", "/viz/markers"]
        asked = [{"id": number, "channelId": channels[topic]["id"]} for number, topic in enumerate(wanted)]
        viewer.send({"op": "subscribe", "subscriptions": asked})
        heard: dict[str, Any] = {}
        while set(heard) != set(wanted):
            message = next(stream)
            if isinstance(message, dict):
                continue
            kind, number, _ = struct.unpack_from("<BIQ", message)
            assert kind == 1
            channel = channels[wanted[number]]
            assert channel["encoding"] == "cdr" and channel["schemaEncoding"] == "ros2msg"
            types = parse_definition(channel["schemaName"], channel["schema"])
            heard[wanted[number]] = decode(types, channel["schemaName"], message[13:])
        viewer.close()
        assert made.end() == 0
    nav, truth = heard["/nav/state"], heard["/sim/truth"]
    assert math.dist(nav["pos_ned_m"], truth["pos_ned_m"]) < 0.5  # not of the same moment
    assert len(heard["/out/thrusters"]["pwm_us"]) == 8
    assert len(heard["/viz/markers"]["markers"]) > 3


@needs_sdk
def test_a_port_that_is_taken_is_named() -> None:
    from autopilot.view.foxglove import FoxgloveServer

    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        with pytest.raises(ConfigError, match=r"cannot be had.*give another"):
            FoxgloveServer(taken.getsockname()[1])


def test_without_the_library_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "foxglove", None)
    done = CliRunner().invoke(sitl, ["--foxglove", "--duration", "1"])
    assert isinstance(done.exception, ConfigError) and "pip install 'underwater-autopilot[foxglove]'" in str(
        done.exception
    )
