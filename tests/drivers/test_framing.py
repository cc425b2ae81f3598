"""Cutting a stream into frames: MAVLink's, and those of devices."""

from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from autopilot.drivers import ping1d
from autopilot.drivers.framing import FrameCutter, FrameParser
from autopilot.drivers.ig500_protocol import Ig500Frame, Ig500Parser, encode_frame
from autopilot.drivers.ping1d import PingFrame, PingParser


def v1(payload: bytes) -> bytes:
    return bytes([0xFE, len(payload), 0, 1, 1, 0]) + payload + b"\x12\x34"


def v2(payload: bytes, signed: bool = False) -> bytes:
    head = bytes([0xFD, len(payload), int(signed), 0, 0, 1, 1, 0, 0, 0])
    return head + payload + b"\x12\x34" + (bytes(13) if signed else b"")


FRAMES = st.one_of(st.builds(v1, st.binary(max_size=255)), st.builds(v2, st.binary(max_size=255), st.booleans()))


def fed(parser: FrameCutter | FrameParser[Any], stream: bytes, data: st.DataObject) -> list[Any]:
    """What comes out of a stream that arrives in pieces."""
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=6)))
    return [out for start, end in zip([0, *cuts], [*cuts, None], strict=True) for out in parser.feed(stream[start:end])]


@settings(deadline=None)
@given(st.lists(FRAMES, max_size=6), st.data())
def test_whole_frames_come_out_however_the_stream_is_cut(frames: list[bytes], data: st.DataObject) -> None:
    cutter = FrameCutter()
    assert fed(cutter, b"".join(frames), data) == frames
    assert cutter.skipped == 0


@settings(deadline=None)
@given(st.lists(st.binary(max_size=400), max_size=6))
def test_any_bytes_never_raise_and_little_is_kept(chunks: list[bytes]) -> None:
    cutter = FrameCutter()
    out = sum(len(frame) for chunk in chunks for frame in cutter.feed(chunk))
    assert out + cutter.skipped + len(cutter._buffer) == sum(map(len, chunks))
    assert len(cutter._buffer) <= 280


@settings(deadline=None)
@given(st.binary(max_size=40), st.binary(max_size=255))
def test_finds_its_way_back_after_noise(noise: bytes, payload: bytes) -> None:
    frame = v2(payload.replace(b"\xfd", b"-").replace(b"\xfe", b"-"))
    cutter = FrameCutter()
    out = cutter.feed(noise + 30 * frame)  # longer than any frame that the noise may seem to begin
    assert out[-1] == frame


def test_text_is_skipped() -> None:
    cutter = FrameCutter()
    assert cutter.feed(b"GET / HTTP/1.1\r\n\r\n") == []
    assert cutter.skipped == 18


DEVICES = pytest.mark.parametrize(
    ("kind", "frame", "encode"),
    [
        (Ig500Parser, Ig500Frame, encode_frame),
        (PingParser, lambda number, data: PingFrame(message=number, payload=data), ping1d.encode),
    ],
)
MESSAGES = st.tuples(st.integers(0, 255), st.binary(max_size=80))
Kind = Callable[[], FrameParser[Any]]
Make = Callable[[int, bytes], Any]


@DEVICES
@settings(deadline=None)
@given(messages=st.lists(MESSAGES, max_size=5), data=st.data())
def test_frames_of_devices_survive_any_cut(
    kind: Kind, frame: Make, encode: Make, messages: list[tuple[int, bytes]], data: st.DataObject
) -> None:
    parser = kind()
    stream = b"".join(encode(*message) for message in messages)
    assert fed(parser, stream, data) == [frame(*message) for message in messages]
    assert parser.skipped == parser.bad_frames == 0


@DEVICES
@settings(deadline=None)
@given(chunks=st.lists(st.binary(max_size=700), max_size=6))
def test_any_bytes_of_devices_never_raise_and_memory_is_bounded(
    kind: Kind, frame: Make, encode: Make, chunks: list[bytes]
) -> None:
    parser = kind()
    for chunk in chunks:
        parser.feed(chunk)
    assert len(parser._buffer) <= 600


@DEVICES
@settings(deadline=None)
@given(message=MESSAGES, noise=st.binary(max_size=60), data=st.data())
def test_a_damaged_frame_is_dropped_and_the_next_one_is_not(
    kind: Kind, frame: Make, encode: Make, message: tuple[int, bytes], noise: bytes, data: st.DataObject
) -> None:
    damaged = bytearray(encode(*message))
    damaged[data.draw(st.integers(0, len(damaged) - 1))] ^= data.draw(st.integers(1, 255))
    parser = kind()
    # A run of zeros pushes the frame through whatever size the noise has announced.
    frames = parser.feed(noise + bytes(damaged) + encode(0x90, b"good") + bytes(600))
    assert frame(0x90, b"good") in frames
    assert all(found == frame(0x90, b"good") or found != frame(*message) for found in frames)
    assert parser.skipped > 0
