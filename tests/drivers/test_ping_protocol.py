"""Ping Protocol: what is written is read again, however it is cut, and nothing else is."""

import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from autopilot.core.vehicle import load_vehicle
from autopilot.drivers import ping1d as wire
from autopilot.drivers.base import AlwaysOpen
from autopilot.drivers.ping1d import Ping1d, Ping1dOptions


def test_the_bytes_are_those_of_the_documentation() -> None:
    """The documentation's example: a general request for protocol_version."""
    request = wire.encode(wire.GENERAL_REQUEST, struct.pack("<H", 5))
    assert request == bytes([0x42, 0x52, 0x02, 0x00, 0x06, 0x00, 0x00, 0x00, 0x05, 0x00, 0xA1, 0x00])


@pytest.mark.parametrize("bit", range(16))
def test_a_damaged_length_holds_up_no_range_after_it(bit: int) -> None:
    one, other = (wire.encode_distance(wire.Distance(range_m=range_m, confidence=1.0)) for range_m in (2.0, 3.0))
    damaged = bytearray(one)
    damaged[2 + bit // 8] ^= 1 << bit % 8
    parser = wire.PingParser()
    assert parser.feed(bytes(damaged)) == []
    (frame,) = parser.feed(other)
    assert wire.decode_distance(frame.payload) == wire.Distance(range_m=3.0, confidence=1.0)
    assert parser.bad_frames == 1


@given(st.floats(0.0, 100.0), st.floats(0.0, 1.0))
@settings(max_examples=60, deadline=None)
def test_a_distance_is_read_as_it_was_written(range_m: float, confidence: float) -> None:
    (frame,) = wire.PingParser().feed(wire.encode_distance(wire.Distance(range_m=range_m, confidence=confidence)))
    read = wire.decode_distance(frame.payload)
    assert read is not None
    assert abs(read.range_m - range_m) <= 0.5e-3 + 1e-9 and abs(read.confidence - confidence) <= 0.005 + 1e-9


class Line(AlwaysOpen):
    """A port that says what it is told to."""

    def __init__(self) -> None:
        self.said: list[bytes] = []
        self.written: list[wire.PingFrame] = []
        self._parser = wire.PingParser()

    def read(self, t_us: int) -> list[tuple[int, bytes]]:
        said, self.said = self.said, []
        return [(t_us, data) for data in said]

    def write(self, data: bytes) -> None:
        self.written += self._parser.feed(data)


def test_weak_echoes_and_impossible_ranges_are_counted_and_silence_sets_it_up_again() -> None:
    line = Line()
    device = Ping1d(load_vehicle("lbv150"), Ping1dOptions(port="x", most_range_m=20.0), port=line)
    device.open()
    told = [frame.message for frame in line.written]
    assert told == [
        wire.SET_SPEED_OF_SOUND,
        wire.SET_MODE_AUTO,
        wire.SET_RANGE,
        wire.SET_PING_INTERVAL,
        wire.CONTINUOUS_START,
    ]
    said = [(2.0, 0.9), (0.1, 0.5), (0.1, 1.0), (3.0, 0.8)]
    line.said = [wire.encode_distance(wire.Distance(range_m=r, confidence=c)) for r, c in said[:3]]
    first = device.poll(1_000_000)
    line.said = [wire.encode_distance(wire.Distance(range_m=said[3][0], confidence=said[3][1]))]
    second = device.poll(1_100_000)
    assert [sample.range_m for sample in (*first, *second)] == [2.0, 3.0]
    assert (device.weak, device.bad_samples) == (1, 1)
    device.poll(2_000_000)
    assert len(line.written) == len(told)
    device.poll(2_200_000)
    assert len(line.written) == 2 * len(told)
