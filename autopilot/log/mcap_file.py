"""MCAP file writer: as ``mcap.writer.Writer``, at a tenth of the cost per message.

A log takes a thousand small messages per second. They are packed straight into the chunk; everything else (schemas,
indexes, statistics) is rare and is written by the library's records (mcap.dev, format specification).
"""

import struct
import zlib
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import IO, Any

import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

MAGIC = b"\x89MCAP0\r\n"
COMPRESSION = "zstd"
REPEAT_CHUNKS = 60
"""Chunks of a log, a minute of them, after which what names its topics is written again."""
PACKED_BYTES = 64 * 1024
"""Size of the index records of chunks that are compressed at a time: a minute of them."""
_MESSAGE = struct.Struct("<BQHIQQ")
"""Opcode, length, channel, sequence, log time, publish time; the data follow."""
_MESSAGE_HEAD = 22
"""Bytes of a message's content in front of its data."""
_CHUNK = struct.Struct("<BQQQQII4sQ")
"""Opcode, length, first and last time, size and CRC of the records, name of the compression, packed size."""
_PREFIX_BYTES = 9
_INDEX = struct.Struct("<BQHI")
"""Opcode, length, channel, bytes of the entries; the entries (time, offset in the chunk) follow."""


class McapFile:
    """Writes records in the order of the calls. Exceptions of the stream are passed on."""

    def __init__(self, stream: IO[bytes], chunk_bytes: int, *, repeat_chunks: int | None = None) -> None:
        """``repeat_chunks``: schemas and channels are written again after so many chunks, and after one with new ones,
        so that a damaged chunk of a log without its index costs only itself; None = never.
        """
        self._stream = stream
        self._chunk_bytes = chunk_bytes
        self._repeat_chunks = repeat_chunks
        self._named = 0
        """Channels that stand in two chunks at least."""
        self._chunk = bytearray()
        self._entries: dict[int, list[int]] = {}
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._chunk_index = bytearray()
        """Records of the last chunks: as objects they would take ten times that, 30 MB an hour."""
        self._packed_index: list[bytes] = []
        """Those before them, compressed: they are wanted at the end of the file only."""
        self._chunk_count = 0
        self._first_ns: int | None = None
        self._last_ns = 0
        self._attachments: list[AttachmentIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._counts: Counter[int] = Counter()
        self._compressor = zstandard.ZstdCompressor()

    def start(self, profile: str, library: str) -> None:
        self._stream.write(MAGIC)
        self._put(Header(profile, library))

    def add_metadata(self, name: str, data: Mapping[str, str]) -> None:
        offset = self._stream.tell()
        length = self._put(Metadata(name=name, metadata=dict(data)))
        self._metadata.append(MetadataIndex(offset=offset, length=length, name=name))

    def add_attachment(self, create_ns: int, log_ns: int, name: str, media_type: str, data: bytes) -> None:
        offset = self._stream.tell()
        attachment = Attachment(create_time=create_ns, log_time=log_ns, name=name, media_type=media_type, data=data)
        self._attachments.append(
            AttachmentIndex(
                offset=offset,
                length=self._put(attachment),
                create_time=create_ns,
                log_time=log_ns,
                data_size=len(data),
                name=name,
                media_type=media_type,
            )
        )

    def register_schema(self, name: str, encoding: str, data: bytes) -> int:
        """Number of a new schema, from 1 on."""
        self._schemas.append(Schema(id=len(self._schemas) + 1, name=name, encoding=encoding, data=data))
        self._chunk += _record(self._schemas[-1])
        return len(self._schemas)

    def register_channel(self, topic: str, encoding: str, schema_id: int, metadata: Mapping[str, str]) -> int:
        """Number of a new channel, from 1 on; ``schema_id`` 0 = none."""
        number = len(self._channels) + 1
        self._channels.append(
            Channel(id=number, topic=topic, message_encoding=encoding, schema_id=schema_id, metadata=dict(metadata))
        )
        self._chunk += _record(self._channels[-1])
        return number

    def add_message(self, channel: int, time_ns: int, data: bytes, sequence: int) -> None:
        """A message, logged and published at ``time_ns``."""
        chunk = self._chunk
        entries = self._entries.get(channel)
        if entries is None:
            entries = self._entries[channel] = []
        entries += (time_ns, len(chunk))
        chunk += _MESSAGE.pack(Opcode.MESSAGE, _MESSAGE_HEAD + len(data), channel, sequence, time_ns, time_ns)
        chunk += data
        if len(chunk) > self._chunk_bytes:
            self._end_chunk()

    def flush(self) -> None:
        """End the chunk, if there is a message in it, and hand everything to the operating system."""
        self._end_chunk()
        self._stream.flush()

    def finish(self) -> None:
        """The last chunk, indexes, statistics and footer. The stream stays open."""
        self._end_chunk()
        self._put(DataEnd(0))
        start = self._stream.tell()
        summary = bytearray()
        offsets = bytearray()
        groups: tuple[tuple[Opcode, bytes | bytearray], ...] = (
            (Opcode.SCHEMA, _records(self._schemas)),
            (Opcode.CHANNEL, _records(self._channels)),
            (Opcode.STATISTICS, _record(self._statistics())),
            (Opcode.CHUNK_INDEX, self._chunks()),
            (Opcode.ATTACHMENT_INDEX, _records(self._attachments)),
            (Opcode.METADATA_INDEX, _records(self._metadata)),
        )
        for opcode, group in groups:
            if group:
                offsets += _record(
                    SummaryOffset(group_opcode=opcode, group_start=start + len(summary), group_length=len(group))
                )
                summary += group
        offset_start = start + len(summary)
        summary += offsets
        head = struct.pack("<BQQQ", Opcode.FOOTER, 20, start, offset_start)
        crc = zlib.crc32(head, zlib.crc32(summary))
        self._stream.write(summary)
        self._put(Footer(summary_start=start, summary_offset_start=offset_start, summary_crc=crc))
        self._stream.write(MAGIC)

    def _end_chunk(self) -> None:
        if not self._entries:
            return
        records, self._chunk = bytes(self._chunk), bytearray()
        entries, self._entries = self._entries, {}
        first_ns = min(min(flat[::2]) for flat in entries.values())
        last_ns = max(max(flat[::2]) for flat in entries.values())
        packed = self._compressor.compress(records)
        length = _CHUNK.size - _PREFIX_BYTES + len(packed)
        name, crc = COMPRESSION.encode(), zlib.crc32(records)
        offset = self._stream.tell()
        self._stream.write(
            _CHUNK.pack(Opcode.CHUNK, length, first_ns, last_ns, len(records), crc, len(name), name, len(packed))
        )
        self._stream.write(packed)
        index, places = bytearray(), dict[int, int]()
        index_offset = offset + _CHUNK.size + len(packed)
        for channel, flat in entries.items():
            self._counts[channel] += len(flat) // 2
            places[channel] = index_offset + len(index)
            index += _INDEX.pack(Opcode.MESSAGE_INDEX, 6 + 8 * len(flat), channel, 8 * len(flat))
            index += struct.pack(f"<{len(flat)}Q", *flat)
        self._stream.write(index)
        about = ChunkIndex(
            chunk_length=_CHUNK.size + len(packed),
            chunk_start_offset=offset,
            compression=COMPRESSION,
            compressed_size=len(packed),
            message_end_time=last_ns,
            message_index_length=len(index),
            message_index_offsets=places,
            message_start_time=first_ns,
            uncompressed_size=len(records),
        )
        self._note_chunk(_record(about))
        if self._repeat_chunks and (self._chunk_count % self._repeat_chunks == 0 or self._named < len(self._channels)):
            self._named = len(self._channels)
            self._chunk += _records(self._schemas) + _records(self._channels)
        self._first_ns = first_ns if self._first_ns is None else min(self._first_ns, first_ns)
        self._last_ns = max(self._last_ns, last_ns)

    def _note_chunk(self, record: bytes) -> None:
        """Keep the index record of a chunk for the summary."""
        self._chunk_count += 1
        self._chunk_index += record
        if len(self._chunk_index) >= PACKED_BYTES:
            self._packed_index.append(self._compressor.compress(bytes(self._chunk_index)))
            self._chunk_index.clear()

    def _chunks(self) -> bytes:
        """The index records of all chunks."""
        unpack = zstandard.ZstdDecompressor().decompress
        return b"".join((*(unpack(part) for part in self._packed_index), self._chunk_index))

    def _statistics(self) -> Statistics:
        return Statistics(
            attachment_count=len(self._attachments),
            channel_count=len(self._channels),
            channel_message_counts=dict(self._counts),
            chunk_count=self._chunk_count,
            message_count=self._counts.total(),
            message_end_time=self._last_ns,
            message_start_time=self._first_ns or 0,
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )

    def _put(self, record: Any) -> int:
        """Write a record; its length with its prefix."""
        data = _record(record)
        self._stream.write(data)
        return len(data)


def _records(records: Sequence[Any]) -> bytes:
    return b"".join(_record(record) for record in records)


def _record(record: Any) -> bytes:
    """The bytes of one of the library's records (Any: some of their methods carry no types)."""
    builder = RecordBuilder()
    record.write(builder)
    data: bytes = builder.end()  # type: ignore[no-untyped-call]
    return data
