"""Reader of ground stations' .tlog files, tolerant of damage.

A record is the time of arrival (us since 1970, eight bytes, big endian) and a packet of MAVLink 1 or 2
(https://mavlink.io/en/guide/serialization.html). The framing is done here and not by pymavlink, which loses
synchronisation after a damaged length and does not name the sender of a damaged packet; packets are decoded by
pymavlink.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from autopilot.core.errors import LogError
from autopilot.log.mavlink_frames import STX_V1 as V1
from autopilot.log.mavlink_frames import STX_V2 as V2

STAMP_BYTES = 8
HEADER_BYTES = {V1: 6, V2: 10}
CHECKSUM_BYTES, SIGNATURE_BYTES, SIGNED = 2, 13, 0x01
EARLIEST_US, LATEST_US = 946_684_800_000_000, 4_102_444_800_000_000
"""Range of plausible stamps: 2000 to 2100."""
APART_US = 3 * 86_400_000_000
"""Maximum difference from the previous stamp."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PacketOrigin:
    system: int
    component: int
    sequence: int
    message_id: int
    message: str
    """Its name, "" where the dialect has none."""

    def __str__(self) -> str:
        return f"{self.message or f'message {self.message_id}'} of component {self.system}/{self.component}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Packet:
    """A whole packet. ``message`` is None when the dialect does not know it."""

    at_us: int
    origin: PacketOrigin
    message: Any


@dataclass(frozen=True, slots=True, kw_only=True)
class DamagedPiece:
    """Bytes that are no message, as many as there are in a row."""

    at_us: int | None
    """Of the record before, None for the first."""
    size: int
    origin: PacketOrigin | None
    """Header at the beginning, None without one."""
    whole: bool
    """Whether just the packet of that header: its checksum is wrong, as it also is when sender and reader do not mean
    the same by that message."""

    def __str__(self) -> str:
        if self.origin is None:
            return f"{self.size} bytes that belong to no message"
        what = "checksum wrong (damaged, or of another dialect)" if self.whole else "damaged"
        return f"{self.origin}: {what}"


def read_tlog(path: Path) -> Iterator[Packet | DamagedPiece]:
    """All of a file in order. LogError if it cannot be read."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise LogError(f"{path}: cannot be read as .tlog ({error}); check the name") from error
    return _TlogReader(data).records()


class _TlogReader:
    def __init__(self, data: bytes) -> None:
        from pymavlink.dialects.v20 import ardupilotmega

        self._data = data
        self._dialect = ardupilotmega
        self._decoder = ardupilotmega.MAVLink(None)
        self._last_us: int | None = None
        self._near_us: int | None = None
        """Reference for the next stamp: the last one, unless no following stamp is near it."""

    def records(self) -> Iterator[Packet | DamagedPiece]:
        begin = 0
        while begin < len(self._data):
            packet, end = self._packet(begin)
            if packet is None and (end is None or not self._begins_record(end)):
                found = self._next_packet(begin + 1)
                if found == len(self._data) and self._near_us is not None:
                    self._near_us = None  # a sound packet's own stamp may be what is damaged
                    continue
                yield self._damaged(begin, found, whole=False)
                begin = found
                continue
            assert end is not None, "a packet has an end"
            if packet is None:
                yield self._damaged(begin, end, whole=True)
            else:
                self._last_us = self._near_us = packet.at_us
                yield packet
            begin = end

    def _packet(self, begin: int) -> tuple[Packet | None, int | None]:
        """Packet of the record at this offset, None if it is damaged; its end, None if it cannot be one."""
        frame = self._frame(begin)
        if frame is None:
            return None, None
        origin, end = frame
        at_us = self._stamp_us(begin)
        try:
            message = self._decoder.decode(bytearray(self._data[begin + STAMP_BYTES : end]))
        except self._dialect.MAVError:
            return None, end
        known = origin.message != ""
        if not known and not self._begins_record(end):
            return None, None  # nothing checks the bytes of an unknown message, except that another record follows
        return Packet(at_us=at_us, origin=origin, message=message if known else None), end

    def _frame(self, begin: int) -> tuple[PacketOrigin, int] | None:
        """Header at this offset and end of its packet, None without one, or if the file ends first."""
        data, at = self._data, begin + STAMP_BYTES
        origin = self._origin(begin)
        if origin is None:
            return None
        signed = data[at] == V2 and data[at + 2] & SIGNED
        end = at + HEADER_BYTES[data[at]] + data[at + 1] + CHECKSUM_BYTES + (SIGNATURE_BYTES if signed else 0)
        return (origin, end) if end <= len(data) else None

    def _origin(self, begin: int) -> PacketOrigin | None:
        data, at = self._data, begin + STAMP_BYTES
        if not self._begins_record(begin) or at >= len(data) or at + HEADER_BYTES[data[at]] > len(data):
            return None
        if data[at] == V1:
            sequence, system, component, message_id = data[at + 2 : at + 6]
        else:
            sequence, system, component = data[at + 4 : at + 7]
            message_id = int.from_bytes(data[at + 7 : at + 10], "little")
        known = self._dialect.mavlink_map.get(message_id)
        name = "" if known is None else str(known.msgname)
        return PacketOrigin(system=system, component=component, sequence=sequence, message_id=message_id, message=name)

    def _stamp_us(self, begin: int) -> int:
        return int.from_bytes(self._data[begin : begin + STAMP_BYTES], "big")

    def _begins_record(self, begin: int) -> bool:
        """Whether a plausible stamp and a packet's first byte are at this offset, or the file ends here."""
        at = begin + STAMP_BYTES
        if at >= len(self._data):
            return begin == len(self._data)
        stamp_us = self._stamp_us(begin)
        near = self._near_us is None or abs(stamp_us - self._near_us) <= APART_US
        return near and EARLIEST_US <= stamp_us <= LATEST_US and self._data[at] in HEADER_BYTES

    def _next_packet(self, begin: int) -> int:
        """From there on, where the next sound record begins; the end of the file if none does."""
        for found in re.finditer(rb"[\xfd\xfe]", self._data[begin + STAMP_BYTES :]):
            place = begin + found.start()
            if self._packet(place)[0] is not None:
                return place
        return len(self._data)

    def _damaged(self, begin: int, end: int, *, whole: bool) -> DamagedPiece:
        return DamagedPiece(at_us=self._last_us, size=end - begin, origin=self._origin(begin), whole=whole)
