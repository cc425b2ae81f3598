"""Broken files: never a traceback, never a wrong value, and everything readable is read."""

import errno
import io
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from log_synthetic import EPOCH_NS, Run, write_run
from mcap.reader import make_reader
from mcap.writer import Writer
from rosbags.rosbag2 import Reader

from autopilot.cli.log import log as log_command
from autopilot.core.errors import LogError
from autopilot.log.analysis import load_flight
from autopilot.log.check import acceptance_table
from autopilot.log.compare import compare_logs
from autopilot.log.container import MESSAGE, Damage, find_messages, index_from_chunks, read_contents, records, unpack
from autopilot.log.lock import lock_exclusive
from autopilot.log.mcap_file import MAGIC
from autopilot.log.reader import Log, open_log
from autopilot.log.recover import RECOVERED_RECORD, recover_unfinished
from autopilot.record.estimator_setup import read_vehicle
from autopilot.replay.service_inputs import ServiceInputs

CHECKED = ("/nav/state", "/sim/truth", "/out/thrusters")


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Several chunks: one per second of log time."""
    return write_run(tmp_path_factory.mktemp("damage") / "sound.mcap", Run(laps=1, step_us=500_000))


@pytest.fixture(scope="module")
def rows(sound: Path) -> dict[str, set[bytes]]:
    log = open_log(sound)
    return {topic: {body for _, body in log.raw_messages(topic)} for topic in CHECKED}


def read_all(path: Path, rows: dict[str, set[bytes]]) -> Log | None:
    """Open and read a damaged file; every message that comes out must be one that was written."""
    try:
        log = open_log(path)
    except LogError as error:
        assert str(path) in str(error)
        return None
    for topic in CHECKED:
        if topic in log.topics:
            assert {body for _, body in log.raw_messages(topic)} <= rows[topic]
    log.verify()
    try:
        acceptance_table(log)
    except LogError as error:
        assert str(path) in str(error)
    return log


def test_cut_off_anywhere(sound: Path, rows: dict[str, set[bytes]], tmp_path: Path) -> None:
    data = sound.read_bytes()
    path = tmp_path / "cut.mcap"
    ends = {
        offset + extra for chunk in read_contents(sound).chunks for offset in (chunk.offset,) for extra in (-1, 0, 9)
    }
    step = len(data) // 15
    readable = []
    for size in sorted({0, 1, 7, 8, 9, 20, len(data) - 1, len(data) - 8, *ends, *range(0, len(data), step)}):
        path.write_bytes(data[:size])
        log = read_all(path, rows)
        assert (log is None) == (size < 8)
        if log is not None:
            assert log.problems and not log.contents.finished
            readable.append(log.message_count)
    assert readable == sorted(readable) and readable[-1] == open_log(sound).message_count


def set_back(source: Path, target: Path, after_s: float, by_s: float) -> Path:
    """A log whose clock was set back."""
    with source.open("rb") as read, target.open("wb") as write:
        reader, writer = make_reader(read), Writer(write)
        writer.start("ros2", "")
        for attachment in reader.iter_attachments():
            writer.add_attachment(0, 0, attachment.name, attachment.media_type, attachment.data)
        for record in reader.iter_metadata():
            writer.add_metadata(record.name, record.metadata)
        channels: dict[int, int] = {}
        for schema, channel, message in reader.iter_messages():
            assert schema is not None
            if channel.id not in channels:
                number = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.id] = writer.register_channel(channel.topic, channel.message_encoding, number)
            late = message.log_time > EPOCH_NS + int(1e9 * after_s)
            t_ns = message.log_time - int(1e9 * by_s) * late
            writer.add_message(channels[channel.id], t_ns, message.data, t_ns, message.sequence)
        writer.finish()  # type: ignore[no-untyped-call]
    return target


def test_time_that_goes_back_is_named(sound: Path, tmp_path: Path) -> None:
    hurt = set_back(sound, tmp_path / "back.mcap", 12.0, 3.0)
    (problem,) = open_log(hurt).verify()
    assert "time goes back by 2.500 s after 12.000 s" in problem and problem.startswith("/in/tick")
    log = open_log(hurt)
    rows = {row.name: row for row in acceptance_table(log)}
    assert rows["log damage"].verdict.value == "warn" and "time goes back" in rows["log damage"].note
    for command in ("info", "report"):
        out = () if command == "info" else ("--out", str(tmp_path / f"{command}.html"))
        done = CliRunner().invoke(log_command, [command, str(hurt), *out])
        assert done.exit_code == 3 and "time goes back" in " ".join(done.output.split())
    assert open_log(set_back(sound, tmp_path / "same.mcap", 99.0, 0.0)).verify() == ()


@given(st.floats(0.0, 0.999999), st.integers(1, 255))
@settings(max_examples=35, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_one_byte_flipped(sound: Path, rows: dict[str, set[bytes]], tmp_path: Path, where: float, flip: int) -> None:
    data = bytearray(sound.read_bytes())
    data[int(where * len(data))] ^= flip
    path = tmp_path / "flipped.mcap"
    path.write_bytes(data)
    read_all(path, rows)


@given(st.data())
@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_stretch_overwritten(sound: Path, rows: dict[str, set[bytes]], tmp_path: Path, data: st.DataObject) -> None:
    raw = bytearray(sound.read_bytes())
    start = data.draw(st.integers(8, len(raw) - 1))
    noise = data.draw(st.binary(min_size=1, max_size=2000))
    raw[start : start + len(noise)] = noise[: len(raw) - start]
    path = tmp_path / "noise.mcap"
    path.write_bytes(raw)
    read_all(path, rows)


def test_a_damaged_chunk_costs_only_itself(sound: Path, tmp_path: Path) -> None:
    whole = open_log(sound)
    chunks = read_contents(sound).chunks
    assert len(chunks) > 5
    data = bytearray(sound.read_bytes())
    for name, at in (("content", chunks[3].offset + chunks[3].length // 2), ("opcode", chunks[3].offset)):
        broken = bytearray(data)
        broken[at] ^= 0xFF
        path = tmp_path / f"{name}.mcap"
        path.write_bytes(broken)
        log = open_log(path)
        kept = log["/nav/state"]
        assert 0 < len(whole["/nav/state"]) - len(kept) < 10
        assert f"byte {chunks[3].offset}" in log.verify()[0]
        assert log.message_count < whole.message_count


def test_a_damaged_length_is_bridged_by_the_index(sound: Path, tmp_path: Path) -> None:
    chunks = read_contents(sound).chunks
    broken = bytearray(sound.read_bytes())
    broken[chunks[2].offset + 8] = 0x7F
    path = tmp_path / "length.mcap"
    path.write_bytes(broken)
    log = open_log(path)
    assert compare_logs(open_log(sound), log) == []
    assert f"damaged at byte {chunks[2].offset}" in log.problems[0]


@pytest.mark.parametrize(
    ("content", "reason"),
    [(b"", "is empty"), (b"\x89PNG\r\n\x1a\n....", "not an MCAP log"), (b"\x89MCAP", "not an MCAP log")],
)
def test_other_files_are_refused_by_their_first_bytes(tmp_path: Path, content: bytes, reason: str) -> None:
    path = tmp_path / "x.mcap"
    path.write_bytes(content)
    with pytest.raises(LogError, match=reason):
        open_log(path)
    with pytest.raises(LogError, match="cannot be read"):
        open_log(tmp_path / "missing.mcap")
    with pytest.raises(LogError, match="cannot be read"):
        open_log(tmp_path)


@pytest.mark.parametrize("behind", [b"junk", None])
def test_what_is_behind_the_end_is_told(sound: Path, tmp_path: Path, behind: bytes | None) -> None:
    """A second log, say, of which nothing is read."""
    content = sound.read_bytes()
    joined = tmp_path / "joined.mcap"
    joined.write_bytes(content + (content if behind is None else behind))
    more = len(joined.read_bytes()) - len(content)
    assert [p for p in read_contents(joined).problems if p.startswith(f"{more} bytes behind the end")]
    done = CliRunner().invoke(log_command, ["info", str(joined)])
    assert f"{more} bytes behind" in done.output and done.exit_code == 3


def test_what_damage_has_taken_is_not_put_down_to_another_version(sound: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(sound.read_bytes()[: len(MAGIC)])
    for needs in (lambda log: load_flight(log).judged, ServiceInputs, read_vehicle):
        with pytest.raises(LogError, match=r"has n.*'log info' names the loss: the file was not closed"):
            needs(open_log(cut))


def test_the_name_does_not_matter(sound: Path, tmp_path: Path) -> None:
    path = tmp_path / "log.bin"
    path.write_bytes(sound.read_bytes())
    assert open_log(path).problems == ()


def test_recovery(sound: Path, tmp_path: Path) -> None:
    data = sound.read_bytes()
    folder = tmp_path / "2026-01-01"
    folder.mkdir()
    cut, fine, locked, junk = (folder / f"{name}.mcap" for name in ("a_cut", "b_fine", "c_locked", "d_junk"))
    cut.write_bytes(data[: len(data) * 2 // 3])
    fine.write_bytes(data)
    locked.write_bytes(data[: len(data) // 2])
    junk.write_bytes(b"nothing of the kind")
    copy = tmp_path / "copy"
    copy.write_bytes(cut.read_bytes())
    before = open_log(copy)
    with locked.open("r+b") as held:
        assert lock_exclusive(held)
        done = {recovery.path: recovery for recovery in recover_unfinished(tmp_path)}
    assert set(done) == {cut, junk}
    assert done[cut].repaired and done[cut].messages == before.message_count and "cut off" in done[cut].problem
    assert not done[junk].repaired and "not an MCAP log" in done[junk].problem
    assert junk.read_bytes() == b"nothing of the kind"
    assert fine.read_bytes() == data and locked.read_bytes() == data[: len(data) // 2]
    after = open_log(cut)
    assert after.verify() == () and RECOVERED_RECORD in after.metadata
    assert after.epoch_ns == EPOCH_NS and after.attachments == before.attachments
    assert compare_logs(before, after) == []
    with Reader(cut) as bag:
        assert sum(1 for _ in bag.messages()) == after.message_count
    assert not list(folder.glob(".*"))
    assert [r.path for r in recover_unfinished(tmp_path)] == [locked, junk]


@given(which=st.integers(0, 5), ending=st.sampled_from(["cut off", "index damaged"]))
@settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_damaged_chunk_of_a_log_without_index_costs_only_itself(
    sound: Path, tmp_path: Path, which: int, ending: str
) -> None:
    """Before: the first chunk alone named the topics, and all of their messages were lost with it."""
    data = bytearray(sound.read_bytes())
    chunk, last = read_contents(sound).chunks[which], read_contents(sound).chunks[-1]
    data[chunk.offset + chunk.length // 2] ^= 0xFF
    if ending == "cut off":
        del data[last.offset + last.length :]
    else:
        data[-100] ^= 0xFF
    path = tmp_path / "hurt.mcap"
    path.write_bytes(data)
    with sound.open("rb") as file:
        lost = len(find_messages(unpack(file, chunk)).starts)
    assert open_log(path).message_count == open_log(sound).message_count - lost


def test_a_log_that_is_gone_meanwhile_is_named(sound: Path, tmp_path: Path) -> None:
    path = tmp_path / "gone.mcap"
    path.write_bytes(sound.read_bytes())
    log = open_log(path)
    path.unlink()
    for read in (lambda: log["/nav/state"], log.verify, lambda: log.messages("/rosout")):
        with pytest.raises(LogError, match=r"gone\.mcap: cannot be read any more \(No such file or directory\)"):
            read()


def test_a_bad_sector_costs_its_chunk(sound: Path) -> None:
    """Before: the disk's error for one chunk ended the reading of all."""

    class Worn(io.BytesIO):
        def read(self, size: int | None = -1) -> bytes:
            if self.tell() == bad.offset:
                raise OSError(errno.EIO, os.strerror(errno.EIO))
            return super().read(size)

    contents = read_contents(sound)
    bad, count = contents.chunks[2], sum(contents.counts.values())
    lost = len(find_messages(unpack(io.BytesIO(sound.read_bytes()), bad)).starts)
    index_from_chunks(Worn(sound.read_bytes()), contents)
    assert sum(contents.counts.values()) == count - lost
    assert f"the chunk at byte {bad.offset} cannot be read (Input/output error)" in contents.problems[0]


def test_messages_whose_topics_are_lost_are_told_and_kept(sound: Path, tmp_path: Path) -> None:
    """Every chunk that holds names of topics is damaged."""
    data = bytearray(sound.read_bytes())
    with sound.open("rb") as file:
        for chunk in read_contents(sound).chunks:
            if find_messages(unpack(file, chunk)).others:
                data[chunk.offset + chunk.length // 2] ^= 0xFF
    path = tmp_path / "cut.mcap"
    path.write_bytes(data[: len(data) * 2 // 3])
    before = path.read_bytes()
    log = open_log(path)
    log.verify()
    (told,) = (problem for problem in log.problems if "what names their topics" in problem)
    (recovery,) = recover_unfinished(tmp_path)
    assert recovery.repaired and recovery.messages == log.message_count == open_log(path).message_count
    assert told in recovery.problem and "cut.mcap.damaged" in recovery.problem
    kept = tmp_path / "cut.mcap.damaged"
    assert kept.read_bytes() == before and recover_unfinished(tmp_path) == []
    path.write_bytes(before)
    (again,) = recover_unfinished(tmp_path)
    assert not again.repaired and "would be overwritten" in again.problem and path.read_bytes() == before


@pytest.mark.parametrize("zeros", [False, True])
def test_an_unfinished_log_is_read_and_repaired_beyond_a_hole(sound: Path, tmp_path: Path, zeros: bool) -> None:
    """A power failure leaves blocks of zeros; a chunk of another program may be packed as we cannot read."""
    chunks = read_contents(sound).chunks
    data = bytearray(sound.read_bytes())[: len(sound.read_bytes()) * 2 // 3]
    hole = chunks[3]
    if zeros:
        data[hole.offset - 20 : hole.offset + 30] = bytes(50)
    else:
        data = data.replace(b"zstd", b"lz4x")
    path = tmp_path / "hole.mcap"
    path.write_bytes(data)
    (recovery,) = recover_unfinished(tmp_path)
    assert recovery.repaired and "hole.mcap.damaged" in recovery.problem
    assert (tmp_path / "hole.mcap.damaged").read_bytes() == data
    if zeros:
        assert "the file is damaged at byte" in recovery.problem
        assert open_log(path)["/nav/state"]["t_us"][-1] > open_log(sound)["/nav/state"]["t_us"][-1] // 2


_VICTIM = """
import sys, time
from pathlib import Path
from autopilot.log.packing.records import pack_record
from autopilot.log.writer import LogWriter
log = LogWriter(Path(sys.argv[1]), epoch_ns=10**18, metadata={}, attachments={"a": b"b"})
t_us = 0
while True:
    log.write("/sim/contact", t_us, pack_record("/sim/contact", 10**18 + t_us * 1000, (t_us // 1000, 0.0)))
    t_us += 1000
    time.sleep(0.001)
    if t_us == 1_500_000:
        print("half", flush=True)
"""


def test_killed_while_writing(tmp_path: Path) -> None:
    """What was flushed before a kill -9 is there, without a gap, and is repaired at the next start."""
    path = tmp_path / "killed.mcap"
    with subprocess.Popen([sys.executable, "-c", _VICTIM, str(path)], stdout=subprocess.PIPE) as victim:
        assert victim.stdout is not None
        victim.stdout.readline()
        try:
            while os.path.getsize(path) < 2000:
                assert victim.poll() is None
                time.sleep(0.05)
        finally:
            victim.kill()
    log = open_log(path)
    assert log.problems and log.attachments == {"a": b"b"}
    count = log["/sim/contact"]["count"]
    assert len(count) > 100
    np.testing.assert_array_equal(count, np.arange(len(count)))
    (recovery,) = recover_unfinished(tmp_path)
    assert recovery.repaired and recovery.messages == len(count)
    assert open_log(path).verify() == ()


def test_messages_of_a_chunk_are_found_as_its_records_say(sound: Path) -> None:
    with sound.open("rb") as file:
        chunks = [unpack(file, chunk) for chunk in read_contents(sound).chunks]
    assert chunks
    for data in chunks:
        found = find_messages(data)
        messages = [(start, length) for opcode, start, length in records(data) if opcode == MESSAGE]
        assert list(zip(found.starts.tolist(), found.lengths.tolist(), strict=True)) == messages
        assert found.channels.tolist() == [int.from_bytes(data[at : at + 2], "little") for at, _ in messages]
        assert found.log_times_ns.tolist() == [int.from_bytes(data[at + 6 : at + 14], "little") for at, _ in messages]
        for cut in (1, 5, 13):
            with pytest.raises(Damage):
                find_messages(data[:-cut])
    assert len(find_messages(b"").starts) == 0
