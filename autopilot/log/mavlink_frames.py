"""Splits a byte stream into MAVLink packets for the log, without key material.

No dialect is needed: length and message id are in the packet header (mavlink.io, Packet Serialization). Bytes
between packets are kept too, so that a replay sees the same stream.
"""

from dataclasses import dataclass

from autopilot.core.crc import checksum

STX_V1 = 0xFE
STX_V2 = 0xFD
SETUP_SIGNING = 256
"""Message that carries the secret signing key (mavlink.io, Message Signing): never logged."""
MAX_BYTES = 280
_SIGNED = 0x01
_ID_AT, _ID_END = 7, 10
"""Offset of the message id in a MAVLink 2 header."""
_CRC_EXTRA = bytes((71,))
"""Of SETUP_SIGNING (common.xml)."""
_KEY_AT = 20
"""Where the key begins in a packet of it: after header, time and target."""
_SETUP_SIGNING_ID = SETUP_SIGNING.to_bytes(3, "little")
_KEY_PACKET_BYTES = 67
"""Of a SETUP_SIGNING with signature."""


@dataclass(frozen=True, slots=True)
class Piece:
    """A run of bytes of the stream, at most MAX_BYTES long."""

    data: bytes
    is_packet: bool
    """False for bytes between packets."""


@dataclass(frozen=True, slots=True)
class Removed:
    """Bytes removed from the stream by one call."""

    count: int = 0
    """Bytes of this call's data, and of what had waited from earlier ones."""
    keys: tuple[tuple[int, bytes], ...] = ()
    """Packets that were whole, with the bytes of this call's data before them; the key itself is another."""


NOTHING_REMOVED = Removed()


class StreamCutter:
    """Splits one direction of one link. Incomplete packets are kept until the next call."""

    def __init__(self) -> None:
        self.removed = NOTHING_REMOVED
        """By the last call."""
        self._rest = b""
        """A packet that is not complete yet."""
        self._history = b""
        """The last bytes, so that the header of a key is recognised across pieces."""
        self._skip = 0
        """Bytes of a key still to come."""

    def cut(self, data: bytes) -> list[Piece]:
        """Pieces that ``data`` completes, in order. Packets of SETUP_SIGNING are left out, in sync or not."""
        clean = self._without_keys(data)
        stream = self._rest + clean
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
            pieces.append(Piece(stream[start:end], True))
            start = noise = end
        _add_noise(pieces, stream[noise:start])
        self._rest = stream[start:]
        return pieces

    def _without_keys(self, data: bytes) -> bytes:
        """``data`` without the bytes of any packet whose header says SETUP_SIGNING, at any offset. The header has
        passed before its message id is known; it is removed from ``_rest``. The key follows it.
        """
        window, old = self._history + data, len(self._history)
        self._history = window[1 - _ID_END :]
        skipped = min(self._skip, len(data))
        self._skip -= skipped
        taken_back = 0
        at = old + skipped
        out = bytearray()
        keys: list[tuple[int, bytes]] = []
        start = window.find(STX_V2, at if skipped else 0)
        while start != -1 and start + _ID_END <= len(window):
            if start + _ID_END <= old or window[start + _ID_AT : start + _ID_END] != _SETUP_SIGNING_ID:
                start = window.find(STX_V2, start + 1)
                continue
            passed = old - start
            if passed > 0:
                self._rest = self._rest[:-passed]
                taken_back += passed
            else:
                out += window[at:start]
            end = start + 12 + window[start + 1] + _signature_bytes(window[start + 2])
            if passed <= 0 and end <= len(window):
                keys.append((len(out), _with_another_key(window[start:end])))
            at, self._skip = min(end, len(window)), max(end - len(window), 0)
            start = window.find(STX_V2, at)
        out += window[at:]
        if len(out) == len(data):
            self.removed = NOTHING_REMOVED
            return data
        self.removed = Removed(len(data) - len(out) + taken_back, tuple(keys))
        return bytes(out)

    def lose_track(self) -> None:
        """Bytes before the next ones are missing, perhaps the beginning of a key, whose rest could not be
        recognised. So as many bytes as that may be are removed.
        """
        self._rest = self._history = b""
        self._skip = _KEY_PACKET_BYTES - 1

    def rest(self) -> list[Piece]:
        """The incomplete rest at the end of the stream."""
        pieces: list[Piece] = []
        _add_noise(pieces, self._rest)
        self._rest = b""
        return pieces


def _with_another_key(packet: bytes) -> bytes:
    """A whole SETUP_SIGNING with a key that is not its own, all zero if that was, and without signature. Its checksum
    is good if it was."""
    end = 10 + packet[1]
    key, signature = packet[_KEY_AT:end], packet[end + 2 :]
    other = bytes(len(key)) if not any(key) else b"\xa5" * len(key)
    body = packet[:_KEY_AT][:end] + other
    good = int.from_bytes(packet[end : end + 2], "little") == _checksum(packet[:end])
    crc = _checksum(body) ^ (0 if good else 0xFFFF)
    return body + crc.to_bytes(2, "little") + signature[:-6] + bytes(min(6, len(signature)))


def _checksum(body: bytes) -> int:
    return checksum(body[1:] + _CRC_EXTRA)


def _signature_bytes(incompatibility_flags: int) -> int:
    return 13 if incompatibility_flags & _SIGNED else 0


def _packet_end(stream: bytes, start: int) -> int | None:
    """Where the packet at ``start`` ends; None = its header is not complete."""
    if stream[start] == STX_V1:
        return start + 8 + stream[start + 1] if len(stream) > start + 1 else None
    if len(stream) <= start + 2:
        return None
    return start + 12 + stream[start + 1] + _signature_bytes(stream[start + 2])


def _add_noise(pieces: list[Piece], noise: bytes) -> None:
    pieces.extend(Piece(noise[i : i + MAX_BYTES], False) for i in range(0, len(noise), MAX_BYTES))
