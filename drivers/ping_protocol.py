"""Ping Protocol of Blue Robotics' echosounders: frames in and out. https://docs.bluerobotics.com/ping-protocol/

A frame is ``BR``, length of the payload (u16), number of the message (u16), sender and receiver (u8), payload, and the
sum of all bytes before it (u16); little endian.
"""

import struct
from dataclasses import dataclass

from autopilot.drivers.framing import FrameParser

GENERAL_REQUEST = 6
SET_RANGE, SET_SPEED_OF_SOUND, SET_MODE_AUTO, SET_PING_INTERVAL = 1001, 1002, 1003, 1004
DISTANCE_SIMPLE = 1211
CONTINUOUS_START = 1400
"""Message numbers of the Ping1D."""

START = b"BR"
HEADER = struct.Struct("<2sHHBB")
CHECKSUM_BYTES = 2
MAX_PAYLOAD = 512
"""The longest message (a profile) has 200 points and some numbers."""
_SIMPLE = struct.Struct("<IB")
LENGTHS = {DISTANCE_SIMPLE: _SIMPLE.size}
"""Of payloads that are always as long. A damaged length shows at once by that: waited for, it would hold up the
frames of seconds, which would be stamped too late."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PingFrame:
    message: int
    payload: bytes


@dataclass(frozen=True, slots=True, kw_only=True)
class Distance:
    """DISTANCE_SIMPLE."""

    range_m: float
    confidence: float
    """0..1"""


def encode(message: int, payload: bytes = b"", *, sender: int = 0, receiver: int = 0) -> bytes:
    frame = HEADER.pack(START, len(payload), message, sender, receiver) + payload
    return frame + (sum(frame) & 0xFFFF).to_bytes(CHECKSUM_BYTES, "little")


def encode_distance(distance: Distance) -> bytes:
    return encode(
        DISTANCE_SIMPLE, _SIMPLE.pack(round(1e3 * distance.range_m), round(100.0 * distance.confidence)), sender=1
    )


def decode_distance(payload: bytes) -> Distance | None:
    """None = these are not its bytes."""
    if len(payload) != _SIMPLE.size:
        return None
    range_mm, percent = _SIMPLE.unpack(payload)
    return Distance(range_m=1e-3 * range_mm, confidence=0.01 * percent) if percent <= 100 else None


class PingParser(FrameParser[PingFrame]):
    sync, head_bytes = START, HEADER.size

    def _size(self, head: bytes) -> int | None:
        _, length, message, _, _ = HEADER.unpack(head)
        if not LENGTHS.get(message, 0) <= length <= LENGTHS.get(message, MAX_PAYLOAD):
            return None
        return HEADER.size + int(length) + CHECKSUM_BYTES

    def _frame(self, data: bytes) -> PingFrame | None:
        body, checksum = data[:-CHECKSUM_BYTES], int.from_bytes(data[-CHECKSUM_BYTES:], "little")
        if checksum != sum(body) & 0xFFFF:
            return None
        return PingFrame(message=HEADER.unpack_from(body)[2], payload=body[HEADER.size :])
