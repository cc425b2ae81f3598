"""Records of an MCAP file (mcap.dev, format specification), tolerant of damage.

The file is scanned record by record; bodies of chunks are only read on request. When the scan fails (truncated, or
a damaged length) the chunk index at its end is used, if it is still there, or else the next whole chunk is sought.
"""

import io
import mmap
import struct
import zlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Metadata, Schema, Statistics
from numpy.typing import NDArray

from autopilot.core.errors import LogError
from autopilot.log.mcap_file import MAGIC

_SCHEMA, _CHANNEL, MESSAGE, _CHUNK = Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.CHUNK
_CHUNK_INDEX, _FOOTER, _ATTACHMENT = Opcode.CHUNK_INDEX, Opcode.FOOTER, Opcode.ATTACHMENT
_STATISTICS, _METADATA, _DATA_END = Opcode.STATISTICS, Opcode.METADATA, Opcode.DATA_END
_IN_FULL = (_SCHEMA, _CHANNEL, _CHUNK_INDEX, _ATTACHMENT, _STATISTICS, _METADATA, _FOOTER)
_LOOSE = (_SCHEMA, _CHANNEL, MESSAGE)

_PREFIX = struct.Struct("<BQ")
PREFIX_BYTES = _PREFIX.size
"""Opcode and length in front of every record."""
_CHUNK_HEAD = struct.Struct("<QQQII")
_FOOTER_CONTENT = 20
_FOOTER_BYTES = PREFIX_BYTES + _FOOTER_CONTENT + len(MAGIC)
MESSAGE_HEAD_BYTES = 22
"""Channel (2), sequence (4), log time (8), publish time (8) before a message's data."""
_TIME_START, _TIME_END = 6, 14
"""Of the log time in a message's head."""
LARGEST_CHUNK = 1 << 30
"""A chunk that claims to unpack to more than this is taken as damaged."""


class Damage(Exception):
    """A part of the file is unusable; the text names it and the reason."""


@dataclass(frozen=True, slots=True)
class ChunkRef:
    """Where a run of messages lies in the file."""

    offset: int
    """Of the record's prefix."""
    length: int
    """With the prefix."""
    packed: bool
    """False: plain records outside of any chunk."""


@dataclass(slots=True)
class Contents:
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    chunks: list[ChunkRef] = field(default_factory=list)
    attachments: dict[str, bytes] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    counts: Counter[int] = field(default_factory=Counter)
    """Messages per channel."""
    nameless: int = 0
    """Messages that are sound, but of a channel that no readable record names."""
    first_ns: int | None = None
    last_ns: int | None = None
    """Log times of the first and last message."""
    indexed: set[int] = field(default_factory=set)
    """Where chunks are, by the index at the end of the file."""
    finished: bool = False
    """The writer closed the file."""
    damaged: bool = False
    """Chunks, or bytes before further ones, are not readable."""
    problems: list[str] = field(default_factory=list)

    @property
    def duration_ns(self) -> int:
        """Time between the first and the last message."""
        return 0 if self.first_ns is None or self.last_ns is None else self.last_ns - self.first_ns

    def extend(self, first_ns: int, last_ns: int) -> None:
        """Widen the time to hold these."""
        self.first_ns = first_ns if self.first_ns is None else min(self.first_ns, first_ns)
        self.last_ns = last_ns if self.last_ns is None else max(self.last_ns, last_ns)


def read_contents(path: Path) -> Contents:
    """Scan a file. LogError if it cannot be opened or is no MCAP file; damage goes to ``problems``."""
    try:
        with path.open("rb") as file:
            return _read_contents(file, path)
    except OSError as error:
        raise LogError(f"{path}: cannot be read ({error.strerror}); check the name") from error


def _read_contents(file: IO[bytes], path: Path) -> Contents:
    size = file.seek(0, 2)
    file.seek(0)
    start = file.read(len(MAGIC))
    if start != MAGIC:
        what = "is empty" if not start else f"starts with {start.hex(' ')}"
        raise LogError(f"{path}: is not an MCAP log ({what}); give a .mcap file that the autopilot has written")
    contents = Contents()
    statistics = _walk_file(file, size, contents)
    if statistics is None:
        index_from_chunks(file, contents)
    else:
        contents.counts = statistics
    return contents


def _walk_file(file: IO[bytes], size: int, contents: Contents) -> Counter[int] | None:
    """Fill ``contents``; the messages per channel if the file has its statistics."""
    offset, in_data = len(MAGIC), True
    statistics: Counter[int] | None = None
    seen: set[int] = set()
    while offset < size:
        file.seek(offset)
        prefix = file.read(PREFIX_BYTES)
        opcode, length = _PREFIX.unpack(prefix) if len(prefix) == PREFIX_BYTES else (0, size)
        end = offset + PREFIX_BYTES + length
        if end > size or opcode == 0:
            resumed = _resume_from_index(file, size, contents, seen)
            further = None if resumed else _next_chunk(file, offset)
            within = resumed or further is not None
            contents.damaged |= within
            contents.problems.append(f"the file is {'damaged' if within else 'cut off'} at byte {offset} of {size}")
            if further is None:
                return None
            offset = further
            continue
        if opcode == _CHUNK:
            seen.add(offset)
            contents.chunks.append(ChunkRef(offset, end - offset, True))
        elif in_data and opcode in _LOOSE:
            _add_loose(contents, offset, end)
        elif opcode == _FOOTER and length != _FOOTER_CONTENT:
            contents.problems.append(f"the file is damaged at byte {offset} of {size}")
            return None
        elif opcode in _IN_FULL:
            try:
                found = _take(opcode, file.read(length), contents)
            except Damage as damage:
                contents.problems.append(f"record at byte {offset}: {damage}")
                found = None
            statistics = found if found is not None else statistics
        in_data = in_data and opcode != _DATA_END
        if opcode == _FOOTER:
            contents.finished = file.read(len(MAGIC)) == MAGIC
            break
        offset = end
    if not contents.finished:
        contents.problems.append("the file was not closed (the service was killed or is still writing)")
        return None
    if not _summary_is_intact(file, offset):
        contents.problems.append("the index at the end of the file is damaged")
        contents.schemas.clear()
        contents.channels.clear()
        return None
    for missed in sorted(contents.indexed - seen):
        contents.problems.append(f"the chunk at byte {missed} is damaged; its messages are left out")
    behind = size - offset - _FOOTER_BYTES
    if behind > 0:
        contents.problems.append(f"{behind} bytes behind the end of the log are left out (another log joined to it?)")
    return statistics


def _summary_is_intact(file: IO[bytes], footer: int) -> bool:
    """Check the CRC of everything between the data and the end, which the footer at an offset holds."""
    file.seek(footer + PREFIX_BYTES)
    summary, _, crc = struct.unpack("<QQI", file.read(20))
    if not 0 < summary <= footer:
        return False
    file.seek(summary)
    return crc in (0, zlib.crc32(file.read(footer + PREFIX_BYTES + 16 - summary)))


def _add_loose(contents: Contents, offset: int, end: int) -> None:
    last = contents.chunks[-1] if contents.chunks else None
    if last is not None and not last.packed and last.offset + last.length == offset:
        contents.chunks[-1] = ChunkRef(last.offset, end - last.offset, False)
    else:
        contents.chunks.append(ChunkRef(offset, end - offset, False))


def _resume_from_index(file: IO[bytes], size: int, contents: Contents, seen: set[int]) -> bool:
    """Take chunks that a failed scan has not reached from the index at the file's end; False without an index."""
    file.seek(max(size - _FOOTER_BYTES, 0))
    footer = file.read(_FOOTER_BYTES)
    if len(footer) < _FOOTER_BYTES or footer[-len(MAGIC) :] != MAGIC or footer[0] != _FOOTER:
        return False
    (summary,) = struct.unpack_from("<Q", footer, PREFIX_BYTES)
    if not 0 < summary < size:
        return False
    file.seek(summary)
    data = file.read(size - summary)
    try:
        for opcode, start, length in records(data):
            if opcode == _CHUNK_INDEX:
                offset, chunk_length = struct.unpack_from("<QQ", data, start + 16)
                if offset not in seen and offset + chunk_length <= size:
                    contents.chunks.append(ChunkRef(offset, chunk_length, True))
            elif opcode in (_SCHEMA, _CHANNEL):
                _take(opcode, data[start : start + length], contents)
            elif opcode == _FOOTER:
                break
    except (Damage, struct.error):
        return False
    contents.chunks.sort(key=lambda chunk: chunk.offset)
    return True


def _next_chunk(file: IO[bytes], damaged: int) -> int | None:
    """Where the next whole chunk begins behind a damaged record; None if there is none."""
    with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        name = damaged + PREFIX_BYTES + _CHUNK_HEAD.size
        while (name := data.find(b"zstd", name + 1)) >= 0:
            start = name - PREFIX_BYTES - _CHUNK_HEAD.size
            opcode, length = _PREFIX.unpack_from(data, start)
            if opcode == _CHUNK and start + PREFIX_BYTES + length <= len(data):
                return int(start)
    return None


def index_from_chunks(file: IO[bytes], contents: Contents) -> None:
    """Schemas, channels and counts out of the chunks themselves; chunks that are damaged are taken from the list."""
    contents.counts.clear()
    usable = []
    for chunk in contents.chunks:
        try:
            found = find_messages(unpack(file, chunk))
            for opcode, body in found.others:
                if opcode in (_SCHEMA, _CHANNEL):
                    _take(opcode, body, contents)
            if len(found.starts):
                numbers, times = np.unique(found.channels, return_counts=True)
                contents.counts.update(dict(zip(numbers.tolist(), times.tolist(), strict=True)))
                contents.extend(int(found.log_times_ns.min()), int(found.log_times_ns.max()))
        except Damage as damage:
            contents.damaged = True
            contents.problems.append(f"{damage}; its messages are left out")
        else:
            usable.append(chunk)
    contents.chunks = usable
    nameless = {number: contents.counts.pop(number) for number in [*contents.counts] if number not in contents.channels}
    contents.nameless = sum(nameless.values())
    told = f"{contents.nameless} messages are left out: what names their topics is damaged"
    if contents.nameless and told not in contents.problems:
        contents.problems.append(told)


def unpack(file: IO[bytes], chunk: ChunkRef) -> bytes:
    """Records of a chunk, checked against its CRC. Damage if that fails."""
    where = f"the chunk at byte {chunk.offset}"
    try:
        file.seek(chunk.offset)
        raw = file.read(chunk.length)
    except OSError as error:  # of a disk that wears out: others may be sound
        raise Damage(f"{where} cannot be read ({error.strerror})") from error
    if not chunk.packed:
        return raw
    if len(raw) < PREFIX_BYTES + _CHUNK_HEAD.size or raw[0] != _CHUNK:
        raise Damage(f"{where} is damaged")
    _, _, size, crc, name_length = _CHUNK_HEAD.unpack_from(raw, PREFIX_BYTES)
    start = PREFIX_BYTES + _CHUNK_HEAD.size + name_length
    name, packed = raw[PREFIX_BYTES + _CHUNK_HEAD.size : start], raw[start + 8 :]
    if start + 8 > len(raw) or size > LARGEST_CHUNK:
        raise Damage(f"{where} is damaged")
    if name == b"":
        data = packed
    elif name == b"zstd":
        try:
            data = zstandard.ZstdDecompressor().decompress(packed, max_output_size=size)
        except zstandard.ZstdError as error:
            raise Damage(f"{where} is damaged ({error})") from error
    else:
        raise Damage(f"{where} has compression {name!r}, which is not supported; write it with zstd")
    if len(data) != size or (crc != 0 and zlib.crc32(data) != crc):
        raise Damage(f"{where} is damaged (checksum)")
    return data


def records(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Opcode, start and length of the content of each record. Damage if the last one is cut off."""
    offset, size = 0, len(data)
    while offset < size:
        if offset + PREFIX_BYTES > size:
            raise Damage("a record is cut off")
        opcode, length = _PREFIX.unpack_from(data, offset)
        offset += PREFIX_BYTES
        if offset + length > size:
            raise Damage("a record is cut off")
        yield opcode, offset, length
        offset += length


@dataclass(frozen=True, slots=True, eq=False)
class ChunkIndex:
    """Where the messages of a chunk lie in its records, in order; (n,) arrays."""

    starts: NDArray[np.int64]
    """Of their content."""
    lengths: NDArray[np.int64]
    channels: NDArray[np.int64]
    log_times_ns: NDArray[np.uint64]
    others: list[tuple[int, bytes]]
    """Opcode and content of the records that are no messages."""


def find_messages(data: bytes) -> ChunkIndex:
    """Index the messages of a chunk.

    A log has thousands of messages a second, so there are few operations for each. Messages without a complete
    header are left out. Damage if the last record is truncated.
    """
    starts: list[int] = []
    lengths: list[int] = []
    others: list[tuple[int, bytes]] = []
    offset, size, prefix = 0, len(data), _PREFIX.unpack_from
    last = size - PREFIX_BYTES
    while offset <= last:
        opcode, length = prefix(data, offset)
        offset += PREFIX_BYTES
        if opcode != MESSAGE:
            others.append((opcode, data[offset : offset + length]))
        elif length >= MESSAGE_HEAD_BYTES:
            starts.append(offset)
            lengths.append(length)
        offset += length
    if offset != size:
        raise Damage("a record is cut off")
    at = np.array(starts, dtype=np.int64)
    heads = np.frombuffer(data, np.uint8)[at[:, None] + np.arange(_TIME_END)]
    channels = np.ascontiguousarray(heads[:, :2]).view("<u2")[:, 0].astype(np.int64)
    times = np.ascontiguousarray(heads[:, _TIME_START:]).view("<u8")[:, 0]
    return ChunkIndex(at, np.array(lengths, dtype=np.int64), channels, times, others)


class _WholeFields(ReadDataStream):
    """The content of a record, of which no field is cut off."""

    def __init__(self, body: bytes) -> None:
        super().__init__(io.BytesIO(body))
        self._size = len(body)

    def read(self, length: int) -> bytes:
        """EndOfFile where it ends too early."""
        if self.count + length > self._size:
            raise EndOfFile
        return super().read(length)


def _take(opcode: int, body: bytes, contents: Contents) -> Counter[int] | None:
    """Enter a schema, channel, attachment or metadata record; the counts of a statistics record."""
    stream = _WholeFields(body)
    try:
        if opcode == _SCHEMA:
            schema = Schema.read(stream)
            schema.data.decode()
            contents.schemas[schema.id] = schema
        elif opcode == _CHANNEL:
            channel = Channel.read(stream)
            contents.channels[channel.id] = channel
        elif opcode == _METADATA:
            metadata = Metadata.read(stream)
            contents.metadata[metadata.name] = metadata.metadata
        elif opcode == _ATTACHMENT:
            attachment = Attachment.read(stream)
            if int.from_bytes(body[-4:], "little") not in (0, zlib.crc32(body[:-4])):
                raise Damage(f"attachment {attachment.name} is damaged (checksum)")
            contents.attachments[attachment.name] = attachment.data
        elif opcode == _CHUNK_INDEX:  # of an hour 3600, with 60 entries each that nobody needs
            contents.indexed.add(*struct.unpack_from("<Q", body, 16))
        elif opcode == _STATISTICS:
            statistics = Statistics.read(stream)
            contents.extend(statistics.message_start_time, statistics.message_end_time)
            return Counter(statistics.channel_message_counts)
    except (EndOfFile, struct.error) as error:
        raise Damage("a record is too short") from error
    except UnicodeDecodeError as error:
        raise Damage("a text is not UTF-8") from error
    return None
