"""Cutting a byte stream into what the log keeps of it: MAVLink packets, without key material.

No dialect is needed: length and message id stand in the packet header (mavlink.io, Packet Serialization). Bytes between
packets are kept too, so that a replay sees the same stream.
"""

from dataclasses import dataclass

STX_V1 = 0xFE
STX_V2 = 0xFD
SETUP_SIGNING = 256
"""Message that carries the secret signing key (mavlink.io, Message Signing): never logged."""
MAX_BYTES = 280
_SIGNED = 0x01
_SETUP_SIGNING_ID = SETUP_SIGNING.to_bytes(3, "little")


@dataclass(frozen=True, slots=True)
class Piece:
    """A run of bytes of the stream, at most MAX_BYTES long."""

    data: bytes
    is_packet: bool
    """False for bytes between packets."""


class StreamCutter:
    """Cuts one direction of one link. What is incomplete waits for the next call."""

    def __init__(self) -> None:
        self._rest = b""

    def cut(self, data: bytes) -> list[Piece]:
        """Pieces that ``data`` completes, in order. Packets of SETUP_SIGNING are left out."""
        stream = self._rest + data
        pieces: list[Piece] = []
        start = noise = 0
        while start < len(stream):
            if stream[start] not in (STX_V1, STX_V2):
                start += 1
                continue
            end = _packet_end(stream, start)
            if end is None or end > len(stream):
                break
            _add_noise(pieces, stream[noise:start])
            if not _carries_key(stream, start, end):
                pieces.append(Piece(stream[start:end], True))
            start = noise = end
        _add_noise(pieces, stream[noise:start])
        self._rest = stream[start:]
        return pieces


def _packet_end(stream: bytes, start: int) -> int | None:
    """Where the packet at ``start`` ends; None = its header is not complete."""
    if stream[start] == STX_V1:
        return start + 8 + stream[start + 1] if len(stream) > start + 1 else None
    if len(stream) <= start + 2:
        return None
    signature = 13 if stream[start + 2] & _SIGNED else 0
    return start + 12 + stream[start + 1] + signature


def _carries_key(stream: bytes, start: int, end: int) -> bool:
    """True if a SETUP_SIGNING packet begins anywhere in the piece (also inside one whose start was noise)."""
    at = start
    while at != -1:
        if stream[at + 7 : at + 10] == _SETUP_SIGNING_ID:
            return True
        at = stream.find(STX_V2, at + 1, end)
    return False


def _add_noise(pieces: list[Piece], noise: bytes) -> None:
    pieces.extend(Piece(noise[i : i + MAX_BYTES], False) for i in range(0, len(noise), MAX_BYTES))
