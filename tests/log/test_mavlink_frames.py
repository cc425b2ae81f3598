"""Cutting streams into packets without knowing a dialect."""

from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common

from autopilot.log.mavlink_frames import MAX_BYTES, StreamCutter

MAV = common.MAVLink(None, srcSystem=7, srcComponent=9)
SECRET = list(range(100, 132))


def packet(index: int) -> bytes:
    kinds = [
        MAV.heartbeat_encode(12, 12, 0, 0, 4),
        MAV.param_set_encode(1, 1, b"MPC_MARGIN", 0.05, 9),
        MAV.statustext_encode(6, b"x" * 50),
    ]
    return bytes(kinds[index % 3].pack(MAV))


def key() -> bytes:
    return bytes(MAV.setup_signing_encode(1, 1, SECRET, 0).pack(MAV))


@given(st.lists(st.integers(0, 2), max_size=8), st.lists(st.integers(1, 60), max_size=20))
@settings(deadline=None, max_examples=60)
def test_packets_come_whole_however_the_stream_is_cut(kinds: list[int], cuts: list[int]) -> None:
    packets = [packet(kind) for kind in kinds]
    stream = b"".join(packets)
    cutter, found = StreamCutter(), []
    while stream:
        size = cuts.pop() if cuts else len(stream)
        found += cutter.cut(stream[:size])
        stream = stream[size:]
    assert [piece.data for piece in found] == packets
    assert all(piece.is_packet for piece in found)


@given(st.binary(max_size=900))
@settings(deadline=None, max_examples=80)
def test_noise_keeps_its_bytes_and_order(noise: bytes) -> None:
    cutter = StreamCutter()
    pieces = cutter.cut(noise) + cutter.cut(bytes(MAX_BYTES))
    whole = b"".join(piece.data for piece in pieces)
    assert whole == (noise + bytes(MAX_BYTES))[: len(whole)] or b"\x00\x01\x00" in noise
    assert all(0 < len(piece.data) <= MAX_BYTES for piece in pieces)


def test_version_1_and_signed_packets() -> None:
    first = bytes([0xFE, 9, 0, 1, 1, 0]) + bytes(9) + b"\1\2"
    assert [p.data for p in StreamCutter().cut(first + first)] == [first, first]
    signed = bytearray(packet(0))
    signed[2] |= 1
    whole = bytes(signed) + bytes(13)
    assert [p.data for p in StreamCutter().cut(whole + packet(1))] == [whole, packet(1)]


@given(st.binary(max_size=40), st.integers(1, 30))
@settings(deadline=None, max_examples=80)
def test_keys_never_pass(noise: bytes, size: int) -> None:
    """Not even behind noise that looks like the start of a packet, and what follows is still cut as before."""
    stream = noise + key() + packet(0) + packet(1) + bytes(2 * MAX_BYTES)
    cutter, out = StreamCutter(), b""
    for start in range(0, len(stream), size):
        out += b"|".join(piece.data for piece in cutter.cut(stream[start : start + size]))
    assert bytes(SECRET) not in out
    assert bytes(SECRET[:8]) not in out


@given(st.integers(1, 30))
@settings(deadline=None, max_examples=30)
def test_what_surrounds_a_key_stays(size: int) -> None:
    stream = packet(0) + key() + packet(1) + key() + packet(2)
    cutter, found = StreamCutter(), []
    for start in range(0, len(stream), size):
        found += cutter.cut(stream[start : start + size])
    kept = [piece.data[10:-2] for piece in found]
    assert len(kept) == 3 and all(piece.is_packet for piece in found)
    assert kept[2].endswith(b"x" * 50)
