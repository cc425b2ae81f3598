"""MAVLink codec: versions 1 and 2 in, version 2 out. One parser per client; input never raises.

Framing is done here and not by pymavlink's stream parser, because that one skips a whole bogus frame length after a
checksum error and loses the valid message behind it. Complete frames are decoded by pymavlink. Parsing is limited
by a work budget (:class:`Work`): excess input is queued, and dropped and counted when the queue is full. Work is
counted, not timed, so that a run does not depend on the machine. Corrupt bytes are rejected cheaply: header first,
then checksum, decoding last.
"""

from collections import deque
from collections.abc import Callable, Container
from dataclasses import dataclass
from typing import Any, TypeAlias

from autopilot.core.crc import checksum
from autopilot.mavlink.dialect import mav
from autopilot.mavlink.mavlink1_sizes import MAVLINK1_SIZES

Message: TypeAlias = Any
"""A generated pymavlink message (the dialect is untyped)."""

MAX_CHUNK_BYTES = 65_536
"""Longest piece of input: one UDP datagram or one socket read. The rest is dropped."""
MAX_BACKLOG_BYTES = 16_384
"""Queue of one client: half a second of a fast serial line, 300 messages."""

JUNK_WORK = 1
"""Work per byte outside of frames; about a microsecond if it looks like a start of frame."""
CHECKSUM_WORK = 2
"""Work of a frame's checksum."""
DECODE_WORK = 8
"""Work of decoding a wanted message."""

V1, _V2 = mav.PROTOCOL_MARKER_V1, mav.PROTOCOL_MARKER_V2
SIGNATURE_BYTES: int = mav.MAVLINK_SIGNATURE_BLOCK_LEN
_CRC_BYTES = 2
_V1_OVERHEAD = mav.HEADER_LEN_V1 + _CRC_BYTES
_V2_OVERHEAD = mav.HEADER_LEN_V2 + _CRC_BYTES
_KNOWN = {msg_id: (kind.crc_extra, kind.unpacker.size) for msg_id, kind in mav.mavlink_map.items()}
"""Message id -> CRC_EXTRA, longest payload. MAVLink 1 has no longer one; in MAVLink 2 newer fields may follow."""


@dataclass(slots=True)
class Work:
    """How much may still be done."""

    left: int


@dataclass(frozen=True, slots=True)
class RawMessage:
    """A message that the packaged dialect does not know, as id, CRC_EXTRA and payload (little endian, wire order)."""

    msg_id: int
    crc_extra: int
    payload: bytes

    def pack(self, link: Any, force_mavlink1: bool = False) -> bytes:
        """The MAVLink 2 frame; the same signature as pymavlink's messages."""
        payload = self.payload.rstrip(b"\0") or b"\0"
        body = bytes((len(payload), 0, 0, link.seq, link.srcSystem, link.srcComponent)) + self.msg_id.to_bytes(
            3, "little"
        )
        crc = checksum(body + payload + bytes((self.crc_extra,)))
        return bytes((_V2,)) + body + payload + crc.to_bytes(_CRC_BYTES, "little")


class LinkParser:
    """Splits one client's bytes into messages.

    Damaged bytes are counted in ``dropped`` and skipped. ``wanted``: ids of messages to decode (None = all); others
    are only checked. ``admits`` is called for every valid frame of a known message; rejected frames are counted in
    ``refused``.
    """

    def __init__(self, wanted: Container[int] | None = None, admits: Callable[[bytes], bool] | None = None) -> None:
        self._decoder = mav.MAVLink(None)
        self._wanted = wanted
        self._admits = admits
        self.refused = 0
        """Good frames that were not admitted so far."""
        self._queue: deque[bytes] = deque()
        """Not parsed yet."""
        self._queued = 0
        """Its bytes."""
        self._data, self._pos = b"", 0
        """Being parsed, and the offset."""
        self.dropped = 0
        """Stretches of damaged input so far."""
        self.overflow = 0
        """Bytes that found no place to wait so far."""
        self.received = 0
        """Good frames so far."""
        self._in_junk = False

    @property
    def backlog(self) -> int:
        """Bytes not parsed yet."""
        return self._queued + len(self._data) - self._pos

    def push(self, data: bytes) -> bool:
        """Queue a datagram or a piece of a stream; False when the queue is full."""
        if self.backlog + len(data) > MAX_BACKLOG_BYTES:
            self.overflow += len(data)
            return False
        self._queue.append(data)
        self._queued += len(data)
        return True

    def take(self, work: Work) -> Message | None:
        """The next message; None when none is complete, or ``work`` is used up."""
        while True:
            data, size = self._data, len(self._data)
            while self._pos < size:
                if work.left <= 0:
                    return None
                pos = self._pos
                used = _frame_at(data, pos, work)
                if used > 0:
                    self._pos = pos + used
                    self._in_junk = False
                    self.received += 1
                    frame = data[pos : pos + used]
                    if not self._is_admitted(frame, work):
                        self.refused += 1
                        continue
                    message = self._decoded(frame, work)
                    if message is not None:
                        return message
                elif used < 0:
                    if not self._in_junk:
                        self.dropped += 1
                        self._in_junk = True
                    # No further than the work reaches, in steps of a byte counted.
                    self._pos = _next_marker(data, pos + 1, min(size, pos + max(work.left, 1)))
                    work.left -= JUNK_WORK * (self._pos - pos)
                else:
                    break
            if not self._queue:
                return None
            self._next_piece()

    def feed(self, data: bytes) -> list[Message]:
        """All messages completed by ``data``, at once, whatever the work."""
        if len(data) > MAX_CHUNK_BYTES:
            self.dropped += 1
            data = data[:MAX_CHUNK_BYTES]
        self._queue.append(data)
        self._queued += len(data)
        work, out = Work(1 << 62), []
        while (message := self.take(work)) is not None:
            out.append(message)
        return out

    def _is_admitted(self, frame: bytes, work: Work) -> bool:
        if self._admits is None:
            return True
        work.left -= CHECKSUM_WORK
        return self._admits(frame)

    def _next_piece(self) -> None:
        """Append the next piece to the incomplete frame."""
        piece = self._queue.popleft()
        self._queued -= len(piece)
        if self._pos < len(self._data):
            if _frame_at(piece, 0, Work(0)) > 0:
                # A complete valid frame at the start: the pending data are a truncated datagram, never to be completed.
                self.dropped += 1
            else:
                piece = self._data[self._pos :] + piece
        self._data, self._pos = piece, 0

    def _decoded(self, frame: bytes, work: Work) -> Message | None:
        """Message of a valid frame; None if it is not wanted."""
        if self._wanted is not None and message_id(frame) not in self._wanted:
            return None
        work.left -= DECODE_WORK
        try:
            return self._decoder.decode(bytearray(frame))
        except mav.MAVError:
            return None


def message_id(frame: bytes) -> int:
    return frame[5] if frame[0] == V1 else int.from_bytes(frame[7:10], "little")


def is_signed(frame: bytes) -> bool:
    """Whether a whole frame has a signature, of whatever key."""
    return frame[0] != V1 and bool(frame[2] & mav.MAVLINK_IFLAG_SIGNED)


def _frame_at(data: bytes, pos: int, work: Work) -> int:
    """Length of the valid frame at ``pos``; 0 when more bytes are needed, -1 when there is none."""
    left = len(data) - pos
    if left == 0:
        return 0
    if data[pos] == _V2:
        if left >= 3 and data[pos + 2] & ~mav.MAVLINK_IFLAG_SIGNED:
            return -1
        if left < mav.HEADER_LEN_V2:
            return 0
        signature = SIGNATURE_BYTES if data[pos + 2] else 0
        size = data[pos + 1] + _V2_OVERHEAD + signature
        known = _KNOWN.get(data[pos + 7] | data[pos + 8] << 8 | data[pos + 9] << 16)
    elif data[pos] == V1:
        if left < mav.HEADER_LEN_V1:
            return 0
        signature, size = 0, data[pos + 1] + _V1_OVERHEAD
        known = _KNOWN.get(data[pos + 5])
        if known is not None and data[pos + 1] > known[1]:
            return -1
    else:
        return -1
    if left < size:
        return 0
    end = pos + size
    if known is None:
        # An id without known CRC_EXTRA: accept it only if the next frame follows immediately.
        return size if left == size or data[end] in (V1, _V2) else -1
    work.left -= CHECKSUM_WORK
    crc_at = end - signature - _CRC_BYTES
    good = checksum(data[pos + 1 : crc_at] + bytes((known[0],))) == data[crc_at] | data[crc_at + 1] << 8
    return size if good else -1


def _next_marker(data: bytes, start: int, stop: int) -> int:
    """Index of the next possible start of a frame before ``stop``, or ``stop``."""
    found = [i for i in (data.find(V1, start, stop), data.find(_V2, start, stop)) if i >= 0]
    return min(found, default=stop)


Sign = Callable[[bytes, int, bool], bytes]
"""Signs a frame: the frame, its CRC_EXTRA, whether it is counted."""


class LinkEncoder:
    """Packs messages for one link, counting its sequence number. ``sign``: None = frames go out unsigned."""

    def __init__(self, sysid: int, compid: int) -> None:
        self._state = mav.MAVLink(None, srcSystem=sysid, srcComponent=compid)
        self.sign: Sign | None = None

    def pack(self, message: Message, *, counted: bool = True) -> bytes:
        """One MAVLink 2 frame; one that is not counted has the number of the frame after it."""
        frame: bytes = message.pack(self._state)
        self._count(counted)
        return frame if self.sign is None else self.sign(frame, message.crc_extra, counted)

    def pack_old(self, message: Message, *, counted: bool = True) -> bytes | None:
        """One MAVLink 1 frame, without extension fields; None for a message that MAVLink 1 does not have."""
        number = message.get_msgId() if not isinstance(message, RawMessage) else message.msg_id
        size = MAVLINK1_SIZES.get(number)
        if size is None:
            return None
        frame: bytes = message.pack(self._state)
        self._count(counted)
        payload = frame[_V2_OVERHEAD - _CRC_BYTES : -_CRC_BYTES].ljust(size, b"\0")[:size]
        body = bytes((size, frame[4], frame[5], frame[6], number)) + payload
        crc = checksum(body + bytes((message.crc_extra,)))
        return bytes((V1,)) + body + crc.to_bytes(_CRC_BYTES, "little")

    def _count(self, counted: bool) -> None:
        if counted:
            self._state.seq = (self._state.seq + 1) & 0xFF
