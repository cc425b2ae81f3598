"""Sequence numbers per client: gapless, and every frame still a good one."""

import random

from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import development as mav

from autopilot.drivers.numbering import Numbering, renumbered


def packed(rng: random.Random, number: int) -> bytes:
    sender = mav.MAVLink(None, srcSystem=1, srcComponent=1)
    sender.seq = number
    text = bytes(rng.randrange(32, 127) for _ in range(rng.randrange(1, 51)))
    message = rng.choice(
        (
            mav.MAVLink_statustext_message(3, text),
            mav.MAVLink_heartbeat_message(12, 12, rng.randrange(256), rng.randrange(2**32), 4, 3),
            mav.MAVLink_ping_message(rng.randrange(2**63), rng.randrange(2**32), 1, 2),
        )
    )
    return bytes(message.pack(sender))


@given(st.integers(0, 2**32 - 1), st.integers(0, 255), st.integers(0, 255))
def test_a_renumbered_frame_is_what_its_sender_would_have_packed(seed: int, before: int, after: int) -> None:
    frame = packed(random.Random(seed), before)
    assert renumbered(frame, after) == packed(random.Random(seed), after)


def test_a_client_that_gets_a_part_sees_no_gap() -> None:
    rng, numbering, reader = random.Random(5), Numbering(), mav.MAVLink(None)
    numbers = []
    for n in range(600):
        frame = packed(rng, n % 256)
        if n % 3 == 0 and n % 7:
            (message,) = reader.parse_buffer(numbering(frame)) or ()
            numbers.append(message.get_seq())
    assert numbers == [(numbers[0] + n) % 256 for n in range(len(numbers))]


@given(st.binary(max_size=300))
def test_what_is_no_frame_stays_as_it_is(data: bytes) -> None:
    numbering = Numbering()
    if data[:1] != b"\xfd":
        assert numbering(data) == data
    signed = b"\xfd\x01\x01" + data
    assert numbering(signed) == signed
