"""What the frames of SBG Systems' references have in common: sync, ids, size, data, checksum, end."""

import binascii
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, Literal, TypeVar

F = TypeVar("F")

_SIZE_BYTES, _CRC_BYTES = 2, 2
_REVERSED = bytes(int(f"{value:08b}"[::-1], 2) for value in range(256))


def crc16(data: bytes) -> int:
    """CRC-16/KERMIT: the standard library's CRC-CCITT on mirrored bytes, mirrored back."""
    plain = binascii.crc_hqx(data.translate(_REVERSED), 0)
    return _REVERSED[plain & 0xFF] << 8 | _REVERSED[plain >> 8]


@dataclass(frozen=True, slots=True, kw_only=True)
class Framing:
    """How one family of devices does it."""

    sync: bytes
    end: int
    """The last byte."""
    id_bytes: int
    """Between sync and size: what the frame is."""
    max_data: int
    """Bytes of data that a frame may carry."""
    order: Literal["little", "big"]
    """Of the bytes of size and checksum, which covers ids, size and data."""


class SbgParser(Generic[F]):
    """Bytes in, frames out, however the bytes are cut. Never raises; the counters say what was thrown away."""

    def __init__(self, framing: Framing, make: Callable[[bytes, bytes], F]) -> None:
        """``make``: a frame of its ids and its data."""
        self._framing, self._make = framing, make
        self._size_at = len(framing.sync) + framing.id_bytes
        self._data_at = self._size_at + _SIZE_BYTES
        self._buffer = bytearray()
        self.skipped = 0
        """Bytes outside of any good frame."""
        self.bad_frames = 0
        """Frames with a wrong size, checksum or end."""

    def feed(self, data: bytes) -> list[F]:
        framing = self._framing
        sync = framing.sync
        self._buffer += data
        buffer, frames, at = self._buffer, [], 0
        while True:
            start = buffer.find(sync, at)
            if start < 0:
                keep = 1 if buffer[-1:] == sync[:1] and len(buffer) > at else 0
                self.skipped += len(buffer) - at - keep
                at = len(buffer) - keep
                break
            self.skipped += start - at
            at = start
            if len(buffer) < at + self._data_at:
                break
            size = int.from_bytes(buffer[at + self._size_at : at + self._data_at], framing.order)
            crc_at = at + self._data_at + size
            end = crc_at + _CRC_BYTES + 1
            if size <= framing.max_data and len(buffer) < end:
                break
            if size > framing.max_data or not self._good(at, crc_at):
                self.bad_frames += 1
                self.skipped += len(sync)
                at += len(sync)  # not the whole frame: the size itself may be what is damaged
                continue
            ids = bytes(buffer[at + len(sync) : at + self._size_at])
            frames.append(self._make(ids, bytes(buffer[at + self._data_at : crc_at])))
            at = end
        del buffer[:at]
        return frames

    def _good(self, at: int, crc_at: int) -> bool:
        buffer, framing = self._buffer, self._framing
        crc = int.from_bytes(buffer[crc_at : crc_at + _CRC_BYTES], framing.order)
        covered = bytes(buffer[at + len(framing.sync) : crc_at])
        return buffer[crc_at + _CRC_BYTES] == framing.end and crc == crc16(covered)
