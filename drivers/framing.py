"""Cuts a byte stream (TCP, serial) into whole MAVLink frames, without knowing any message.

A frame is known by its start byte and length alone (https://mavlink.io/en/guide/serialization.html); checksums are the
reader's business. A start byte that was none is noticed when no other follows its frame.
"""

_V1, _V2 = 0xFE, 0xFD
_V1_OVERHEAD, _V2_OVERHEAD, _SIGNATURE = 8, 12, 13
_SIGNED = 0x01
"""Bit of the incompatibility flags."""


class FrameCutter:
    """Collects the bytes of one peer. ``skipped`` counts the bytes that belonged to no frame."""

    def __init__(self) -> None:
        self._buffer = bytearray()
        self.skipped = 0

    def feed(self, data: bytes) -> list[bytes]:
        self._buffer += data
        buffer, frames, at = self._buffer, [], 0
        while at < len(buffer):
            if buffer[at] not in (_V1, _V2):
                start, at = at, _next_start(buffer, at)
                self.skipped += at - start
                continue
            size = _frame_size(buffer, at)
            if size is None or at + size > len(buffer):
                break
            if at + size < len(buffer) and buffer[at + size] not in (_V1, _V2):
                at += 1
                self.skipped += 1
                continue
            frames.append(bytes(buffer[at : at + size]))
            at += size
        del buffer[:at]
        return frames


def _next_start(buffer: bytearray, at: int) -> int:
    """Where a frame may begin next, or the end."""
    found = [i for i in (buffer.find(_V1, at), buffer.find(_V2, at)) if i >= 0]
    return min(found, default=len(buffer))


def _frame_size(buffer: bytearray, at: int) -> int | None:
    """Bytes of the frame that starts at ``at``; None while its header is incomplete."""
    if len(buffer) < at + 3:
        return None
    length = buffer[at + 1]
    if buffer[at] == _V1:
        return length + _V1_OVERHEAD
    return length + _V2_OVERHEAD + (_SIGNATURE if buffer[at + 2] & _SIGNED else 0)
