"""Bytes to messages and back: MAVLink 1 and 2 in, MAVLink 2 out. One parser per link; input never raises.

Framing is done here and not by pymavlink's stream parser, because that one skips a whole bogus frame length after a
checksum error and so loses the good message behind it. Decoding a complete frame is pymavlink's.
"""

from dataclasses import dataclass
from typing import Any, TypeAlias

from pymavlink.dialects.v20 import development as mav

Message: TypeAlias = Any
"""A generated pymavlink message (the dialect is untyped)."""

MAX_CHUNK_BYTES = 65_536
"""Longest piece of input taken at once: one UDP datagram or one socket read. What is beyond is dropped."""

_V1, _V2 = mav.PROTOCOL_MARKER_V1, mav.PROTOCOL_MARKER_V2
_CRC_BYTES = 2


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
        crc = mav.x25crc(body + payload + bytes((self.crc_extra,))).crc
        return bytes((_V2,)) + body + payload + int(crc).to_bytes(2, "little")


class LinkParser:
    """Cuts one link's bytes into messages. Damaged bytes are counted in ``dropped`` and skipped."""

    def __init__(self) -> None:
        self._decoder = mav.MAVLink(None)
        self._pending = b""
        self.dropped = 0
        """Stretches of damaged input so far."""
        self.received = 0
        """Good frames so far."""
        self._in_junk = False

    def feed(self, data: bytes) -> list[Message]:
        """Messages completed by ``data`` (a datagram or any piece of a stream)."""
        if len(data) > MAX_CHUNK_BYTES:
            self.dropped += 1
            data = data[:MAX_CHUNK_BYTES]
        if self._pending and self._decode_at(data, 0)[0] is not None:
            # A whole good frame at the start: what was pending is a truncated datagram, never to be completed.
            self._pending = b""
            self.dropped += 1
        data = self._pending + data
        out: list[Message] = []
        pos, size = 0, len(data)
        while pos < size:
            message, used = self._decode_at(data, pos)
            if message is not None:
                self._in_junk = False
                self.received += 1
                out.append(message)
                pos += used
            elif used:
                if not self._in_junk:
                    self.dropped += 1
                    self._in_junk = True
                pos = _next_marker(data, pos + 1)
            else:
                break
        self._pending = data[pos:]
        return out

    def _decode_at(self, data: bytes, pos: int) -> tuple[Message | None, int]:
        """(message, its length), (None, 1) when there is no good frame here, (None, 0) when more bytes are needed."""
        left = len(data) - pos
        if left == 0 or data[pos] not in (_V1, _V2):
            return None, min(left, 1)
        if left < 3:
            return None, 0
        is_v2 = data[pos] == _V2
        flags = data[pos + 2] if is_v2 else 0
        if flags & ~mav.MAVLINK_IFLAG_SIGNED:
            return None, 1
        size = data[pos + 1] + _CRC_BYTES + (mav.HEADER_LEN_V2 if is_v2 else mav.HEADER_LEN_V1)
        if flags:
            size += mav.MAVLINK_SIGNATURE_BLOCK_LEN
        if left < size:
            return None, 0
        try:
            message = self._decoder.decode(bytearray(data[pos : pos + size]))
        except mav.MAVError:
            return None, 1
        end = pos + size
        if message.get_msgId() < 0 and end < len(data) and data[end] not in (_V1, _V2):
            # An id without known checksum seed: believe it only if the next frame follows right behind.
            return None, 1
        return message, size


def _next_marker(data: bytes, start: int) -> int:
    """Index of the next possible start of a frame, or the end."""
    found = [i for i in (data.find(_V1, start), data.find(_V2, start)) if i >= 0]
    return min(found, default=len(data))


class LinkEncoder:
    """Packs messages for one link, counting the sequence number of that link."""

    def __init__(self, sysid: int, compid: int) -> None:
        self._state = mav.MAVLink(None, srcSystem=sysid, srcComponent=compid)

    def pack(self, message: Message) -> bytes:
        """One MAVLink 2 frame."""
        frame: bytes = message.pack(self._state)
        self._state.seq = (self._state.seq + 1) & 0xFF
        return frame
