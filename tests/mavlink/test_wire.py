"""Framing: whatever the bytes, no exception, no good frame lost, damage counted."""

import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mavlink_harness import mav

from autopilot.mavlink.wire import MAX_CHUNK_BYTES, LinkEncoder, LinkParser, RawMessage


def frames(count: int, force_v1: bool = False) -> list[bytes]:
    sender = mav.MAVLink(None, srcSystem=255, srcComponent=190)
    out = []
    for n in range(count):
        sender.seq = n % 256
        out.append(bytes(mav.MAVLink_ping_message(n * 1000, n, 0, 0).pack(sender, force_mavlink1=force_v1)))
    return out


def seqs(messages: list) -> list[int]:
    return [m.seq for m in messages if m.get_type() == "PING"]


@pytest.mark.parametrize("force_v1", [False, True])
def test_both_protocol_versions_are_read(force_v1: bool) -> None:
    assert seqs(LinkParser().feed(b"".join(frames(5, force_v1)))) == [0, 1, 2, 3, 4]


@given(st.lists(st.integers(1, 40), min_size=1, max_size=20), st.randoms(use_true_random=False))
@settings(max_examples=50, deadline=None)
def test_a_stream_in_pieces_gives_every_message_once(sizes: list[int], rng: object) -> None:
    data, parser, got = b"".join(frames(12)), LinkParser(), []
    pos = n = 0
    while pos < len(data):
        step = sizes[n % len(sizes)]
        got += parser.feed(data[pos : pos + step])
        pos, n = pos + step, n + 1
    assert seqs(got) == list(range(12))
    assert parser.dropped == 0


@given(st.binary(max_size=300), st.binary(max_size=60))
@settings(max_examples=150, deadline=None)
def test_frames_behind_junk_are_found(junk: bytes, more: bytes) -> None:
    parser = LinkParser()
    parser.feed(junk)
    good = frames(3)
    parser.feed(more)
    # Each datagram begins with a good frame: no earlier rubbish may swallow it.
    got = [m for data in good for m in parser.feed(data)]
    assert seqs(got)[-3:] == [0, 1, 2]


@given(st.integers(0, 10_000), st.integers(1, 255))
@settings(max_examples=150, deadline=None)
def test_a_flipped_byte_loses_only_its_own_frame(where: int, flip: int) -> None:
    good = frames(5)
    hit = where % len(good[2])
    bad = bytearray(good[2])
    bad[hit] ^= flip
    parser = LinkParser()
    got = seqs([m for data in (good[0], good[1], bytes(bad), good[3], good[4]) for m in parser.feed(data)])
    assert [n for n in got if n in (0, 1, 3, 4)] == [0, 1, 3, 4]


def test_a_truncated_datagram_does_not_hold_up_the_next_one() -> None:
    parser = LinkParser()
    one, two = frames(2)
    assert parser.feed(one[:-3]) == []
    assert seqs(parser.feed(two)) == [1]
    assert parser.dropped == 1


def test_damage_is_counted_by_stretch_not_by_byte() -> None:
    parser = LinkParser()
    parser.feed(b"\x00" * 50 + frames(1)[0] + b"garbage" * 3 + frames(1)[0])
    assert parser.dropped == 2
    assert parser.received == 2


def test_unknown_message_ids_are_skipped_whole() -> None:
    parser, encoder = LinkParser(), LinkEncoder(7, 1)
    unknown = encoder.pack(RawMessage(60_000, 3, b"\xfd" * 20))
    got = parser.feed(unknown + frames(1)[0])
    assert [m.get_type() for m in got] == ["UNKNOWN_60000", "PING"]
    assert parser.dropped == 0


def test_frames_with_unknown_incompatibility_flags_are_dropped() -> None:
    parser = LinkParser()
    bad = bytearray(frames(1)[0])
    bad[2] = 0x02
    assert parser.feed(bytes(bad)) == []
    assert parser.dropped == 1


def test_a_flood_in_one_piece_is_cut() -> None:
    parser = LinkParser()
    parser.feed(b"\0" * (MAX_CHUNK_BYTES * 2))
    assert parser.dropped == 2


def test_sequence_numbers_count_per_link_and_wrap() -> None:
    a, b = LinkEncoder(1, 1), LinkEncoder(1, 1)
    message = mav.MAVLink_heartbeat_message(12, 12, 1, 0, 3, 3)
    numbers = [a.pack(message)[4] for _ in range(257)]
    assert numbers == [*range(256), 0]
    assert b.pack(message)[4] == 0


def test_a_hand_made_message_has_the_checksum_of_its_definition() -> None:
    """PROTOCOL_VERSION is not in the packaged dialect; CRC_EXTRA follows from its fields (serialization guide)."""
    crc = mav.x25crc()
    crc.accumulate(b"PROTOCOL_VERSION uint16_t version uint16_t min_version uint16_t max_version ")
    for name in (b"spec_version_hash", b"library_version_hash"):
        crc.accumulate(b"uint8_t " + name + b" ")
        crc.accumulate(bytes((8,)))
    seed = (crc.crc & 0xFF) ^ (crc.crc >> 8)
    frame = LinkEncoder(1, 1).pack(RawMessage(300, seed, struct.pack("<HHH", 200, 100, 200) + bytes(16)))
    assert seed == 217
    assert frame[:10] == bytes((0xFD, 5, 0, 0, 0, 1, 1, 0x2C, 0x01, 0x00))
    checked = mav.x25crc(frame[1:-2] + bytes((217,))).crc
    assert frame[-2:] == int(checked).to_bytes(2, "little")
