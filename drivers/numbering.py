"""MAVLink sequence numbers per client.

The service numbers its frames per link. On a link with several clients each receives the broadcasts and its own
frames, and would count the others as lost. Every frame is therefore renumbered per client.
"""

import binascii

from autopilot.core.clients import Verbatim
from autopilot.core.crc import MIRRORED

_STX = 0xFD
_OVERHEAD = 12
"""Bytes of a MAVLink 2 frame round its payload, without a signature."""
_FLAGS_AT, _NUMBER_AT, _CRC_BYTES = 2, 4, 2


class Numbering:
    """One client's. The first frame keeps its number."""

    __slots__ = ("_next",)

    def __init__(self) -> None:
        self._next: int | None = None

    def __call__(self, frame: bytes) -> bytes:
        """The frame with the client's sequence number; forwarded packets, and all but unsigned MAVLink 2 frames, are
        unchanged.
        """
        if isinstance(frame, Verbatim):
            return frame
        if len(frame) < _OVERHEAD or frame[0] != _STX or frame[_FLAGS_AT] or len(frame) != frame[1] + _OVERHEAD:
            return frame
        number = frame[_NUMBER_AT] if self._next is None else self._next
        self._next = (number + 1) & 0xFF
        return renumbered(frame, number)


def renumbered(frame: bytes, number: int) -> bytes:
    """An unsigned MAVLink 2 frame with another sequence number.

    A CRC is linear: the change of the checksum is the checksum (initial value 0) of the change of the bytes, so that
    CRC_EXTRA is not needed.
    """
    change = frame[_NUMBER_AT] ^ number
    if not change:
        return frame
    unchanged = len(frame) - _CRC_BYTES - _NUMBER_AT  # the bytes after the number, and CRC_EXTRA
    # The standard library has MAVLink's polynomial with the bits in the other order.
    mirrored = binascii.crc_hqx(MIRRORED[change : change + 1] + bytes(unchanged), 0)
    low, high = MIRRORED[mirrored >> 8], MIRRORED[mirrored & 0xFF]
    return (
        frame[:_NUMBER_AT] + bytes((number,)) + frame[_NUMBER_AT + 1 : -2] + bytes((frame[-2] ^ low, frame[-1] ^ high))
    )
