"""Common frame format of SBG Systems' references: sync, ids, size, data, checksum, end."""

import binascii
import struct
from typing import ClassVar, Literal

from autopilot.drivers.framing import F, FrameParser

_SIZE_BYTES, _TAIL_BYTES = 2, 3
"""Of the size, and of checksum and end."""
_REVERSED = bytes(int(f"{value:08b}"[::-1], 2) for value in range(256))


def crc16(data: bytes) -> int:
    """CRC-16/KERMIT: the standard library's CRC-CCITT on mirrored bytes, mirrored back."""
    plain = binascii.crc_hqx(data.translate(_REVERSED), 0)
    return _REVERSED[plain & 0xFF] << 8 | _REVERSED[plain >> 8]


class SbgParser(FrameParser[F]):
    """Frames of one family of devices. The checksum covers ids, size and data."""

    end: ClassVar[int]
    """The last byte."""
    max_data: ClassVar[int]
    """Bytes of data that a frame may carry."""
    order: ClassVar[Literal["<", ">"]]
    """Of the bytes of size and checksum, as :mod:`struct` writes it."""

    def _make(self, ids: bytes, data: bytes) -> F:
        """A frame from its header (between sync and size) and its data."""
        raise NotImplementedError

    @classmethod
    def encoded(cls, ids: bytes, data: bytes) -> bytes:
        """The bytes of one frame. ValueError if the data do not fit."""
        if len(data) > cls.max_data:
            raise ValueError(f"{len(data)} bytes do not fit in a frame, at most {cls.max_data} do")
        body = ids + struct.pack(f"{cls.order}H", len(data)) + data
        return cls.sync + body + struct.pack(f"{cls.order}HB", crc16(body), cls.end)

    def _size(self, head: bytes) -> int | None:
        (size,) = struct.unpack_from(f"{self.order}H", head, self.head_bytes - _SIZE_BYTES)
        return self.head_bytes + size + _TAIL_BYTES if size <= self.max_data else None

    def _frame(self, data: bytes) -> F | None:
        crc, end = struct.unpack_from(f"{self.order}HB", data, len(data) - _TAIL_BYTES)
        if end != self.end or crc != crc16(data[len(self.sync) : -_TAIL_BYTES]):
            return None
        ids = data[len(self.sync) : self.head_bytes - _SIZE_BYTES]
        return self._make(ids, data[self.head_bytes : -_TAIL_BYTES])
