"""Splits a byte stream (TCP, serial) into frames: MAVLink's without knowing any message, and those of devices.

A MAVLink frame is identified by its start byte and length (https://mavlink.io/en/guide/serialization.html); checksums
are left to the reader. A false start byte is detected when no other one follows its frame.
"""

from abc import ABC, abstractmethod
from typing import ClassVar, Generic, TypeVar

F = TypeVar("F")

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
    """Index of the next possible start of a frame, or the end."""
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


class FrameParser(ABC, Generic[F]):
    """Parser of frames with sync bytes and a length field. Never raises, however the stream is cut; dropped data is
    counted.
    """

    sync: ClassVar[bytes]
    head_bytes: ClassVar[int]
    """Bytes from the sync on that tell how long the frame is."""

    def __init__(self) -> None:
        self._buffer = bytearray()
        self.skipped = 0
        """Bytes outside of any good frame."""
        self.bad_frames = 0
        """Frames with a wrong size, checksum or end."""

    @abstractmethod
    def _size(self, head: bytes) -> int | None:
        """Bytes of the frame that begins so, None if no frame does."""

    @abstractmethod
    def _frame(self, data: bytes) -> F | None:
        """The frame of these bytes, None if they are damaged."""

    def restart(self) -> None:
        """Forget a frame that is not complete yet."""
        self._buffer.clear()

    def feed(self, data: bytes) -> list[F]:
        """The frames that are complete now, oldest first."""
        self._buffer += data
        buffer, sync, frames, at = self._buffer, self.sync, [], 0
        while True:
            start = buffer.find(sync, at)
            if start < 0:
                keep = 1 if buffer[-1:] == sync[:1] and len(buffer) > at else 0
                self.skipped += len(buffer) - at - keep
                at = len(buffer) - keep
                break
            self.skipped += start - at
            at = start
            if len(buffer) < at + self.head_bytes:
                break
            size = self._size(bytes(buffer[at : at + self.head_bytes]))
            if size is not None and len(buffer) < at + size:
                break
            frame = None if size is None else self._frame(bytes(buffer[at : at + size]))
            if size is None or frame is None:
                self.bad_frames += 1
                self.skipped += len(sync)
                at += len(sync)  # not the whole frame: the size itself may be damaged
                continue
            frames.append(frame)
            at += size
        del buffer[:at]
        return frames
