"""The file writer beside the reference library's: the same calls give the same bytes."""

import random
from io import BytesIO
from pathlib import Path
from typing import Any

from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from autopilot.log.container import read_contents
from autopilot.log.mcap_file import McapFile

CHUNK_BYTES = 4096


def write_with(writer: Any, number_of_messages: int) -> None:
    """A file with everything in it; both writers take these calls."""
    ours = isinstance(writer, McapFile)
    rng = random.Random(3)
    writer.start("ros2", "tests")
    writer.add_metadata("run", {"version": "1", "seed": "2"})
    writer.add_attachment(5, 6, "a.txt", "text/plain", b"hello")
    schema = writer.register_schema("pkg/msg/A", "ros2msg", b"int8 a")
    channels = [writer.register_channel(f"/topic/{k}", "cdr", schema, {"k": str(k)}) for k in range(3)]
    for sequence in range(number_of_messages):
        channel, time_ns = rng.choice(channels), 10**18 + 1000 * sequence + rng.randrange(5000)
        data = rng.randbytes(rng.randrange(200))
        if ours:
            writer.add_message(channel, time_ns, data, sequence)
        else:
            writer.add_message(channel, time_ns, data, time_ns, sequence)
        if sequence == 50:
            channels.append(writer.register_channel("/late", "cdr", schema, {}))
        if sequence == 60:
            writer.flush()
        if sequence == 70:
            writer.add_attachment(7, 8, "b.json", "application/json", b"{}")
    writer.finish()


def test_bytes_are_those_of_the_reference_library() -> None:
    ours, theirs = BytesIO(), BytesIO()
    write_with(McapFile(ours, CHUNK_BYTES), 300)
    write_with(Writer(theirs, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD), 300)
    assert ours.getvalue() == theirs.getvalue()


def test_a_file_without_messages_is_sound(tmp_path: Path) -> None:
    path = tmp_path / "empty.mcap"
    with path.open("wb") as file:
        writer = McapFile(file, CHUNK_BYTES)
        writer.start("", "tests")
        writer.flush()
        writer.finish()
    contents = read_contents(path)
    assert contents.finished and contents.problems == [] and contents.counts.total() == 0
    with path.open("rb") as file:
        summary = make_reader(file, validate_crcs=True).get_summary()
        assert summary is not None and summary.statistics is not None and summary.statistics.message_count == 0


def test_a_long_log_holds_little_of_its_index() -> None:
    """A kilobyte for each second's chunk was 4 MB an hour; the same bytes come out at the end."""
    stream = BytesIO()
    writer = McapFile(stream, 1 << 20)
    writer.start("", "tests")
    schema = writer.register_schema("pkg/msg/A", "ros2msg", b"int8 a")
    channels = [writer.register_channel(f"/topic/{k}", "cdr", schema, {}) for k in range(90)]
    rng = random.Random(4)
    for second in range(400):
        for channel in channels:
            writer.add_message(channel, second * 10**9, rng.randbytes(rng.randrange(30)), second)
        writer.flush()
    whole = writer._chunks()
    held = len(writer._chunk_index) + sum(map(len, writer._packed_index))
    assert len(whole) > 380_000 and held < 0.5 * len(whole)
    writer.finish()
    stream.seek(0)
    summary = make_reader(stream, validate_crcs=True).get_summary()
    assert summary is not None and len(summary.chunk_indexes) == 400
    assert [chunk.message_start_time for chunk in summary.chunk_indexes] == [n * 10**9 for n in range(400)]
