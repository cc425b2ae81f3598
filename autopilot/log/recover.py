"""Repair of unfinished logs: everything readable is copied to a new file that replaces the old one.

The service calls :func:`recover_unfinished` on its log folder at start. A log that another service is writing is
locked and left alone; the repaired file is opened and counted again before it replaces the original. An original
with messages that the copy lacks (damaged, of unknown compression or of unknown topic) is kept as ``*.damaged``.
"""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from autopilot.core.errors import LogError
from autopilot.log.container import MESSAGE, Contents, Damage, read_contents, records, unpack
from autopilot.log.lock import lock_exclusive
from autopilot.log.mcap_file import REPEAT_CHUNKS, McapFile
from autopilot.log.reader import open_log
from autopilot.log.schemas import PROFILE
from autopilot.log.writer import CHUNK_BYTES, LIBRARY, QOS_PROFILES

DAMAGED = ".damaged"
"""Added to the name of an original that is kept."""
RECOVERED_RECORD = "recovered"
"""Metadata record of a repaired log: its damage."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Recovery:
    path: Path
    messages: int
    """Messages that were saved."""
    problem: str
    """Damage, and if ``repaired`` is False why it is not repaired."""
    repaired: bool


def recover_unfinished(folder: Path) -> list[Recovery]:
    """Repair every unfinished ``*.mcap`` under a folder, by name. Finished and locked ones stay as they are."""
    found = []
    for path in sorted(folder.rglob("*.mcap")):
        try:
            recovery = recover_log(path)
        except (LogError, OSError) as error:
            recovery = Recovery(path=path, messages=0, problem=str(error), repaired=False)
        if recovery is not None:
            found.append(recovery)
    return found


def recover_log(path: Path) -> Recovery | None:
    """Repair an unfinished log in place.

    Parameters
    ----------
    path
        The log.

    Returns
    -------
    Recovery or None
        None if it needs no repair or is being written.

    Raises
    ------
    LogError
        It is no log, not accessible, or there is no room for the copy.
    """
    try:
        opened = path.open("r+b")
    except OSError as error:
        raise LogError(f"{path}: cannot be opened for repair ({error.strerror or error})") from error
    with opened as file:
        if not lock_exclusive(file):
            return None
        contents = read_contents(path)
        if contents.finished:
            return None
        kept = path.with_name(path.name + DAMAGED) if contents.nameless or contents.damaged else None
        problem = "; ".join((*contents.problems, *([f"the original is kept as {kept.name}"] if kept else ())))
        if kept is not None and kept.exists():
            raise LogError(f"{path}: not repaired, {kept} would be overwritten; move it away")
        copy = path.with_name(f".{path.name}.recovering")
        try:
            written = _copy(file, contents, copy, problem)
            check = read_contents(copy)
            if not check.finished or sum(check.counts.values()) != written:
                return Recovery(
                    path=path, messages=0, problem=f"{problem}; the repaired copy is not sound", repaired=False
                )
            if kept is not None:
                os.replace(path, kept)
            os.replace(copy, path)
        except OSError as error:
            raise LogError(f"{path}: not repaired, {copy} cannot be written ({error.strerror}); make room") from error
        finally:
            copy.unlink(missing_ok=True)
    return Recovery(path=path, messages=written, problem=problem, repaired=True)


def damage_within(path: Path) -> Recovery | None:
    """Damage of a finished log, None without any. Finished logs are not repaired: their readable part is read in
    place.
    """
    log = open_log(path)
    log.verify()
    if not log.problems or not read_contents(path).finished:  # the latter is being written
        return None
    problem = f"{'; '.join(log.problems)}; it was finished: export and the others read what is left of it"
    return Recovery(path=path, messages=log.message_count, problem=problem, repaired=False)


def _copy(source: IO[bytes], contents: Contents, target: Path, problem: str) -> int:
    """Write everything readable to a new file; the number of messages."""
    written = 0
    with target.open("wb") as file:
        writer = McapFile(file, CHUNK_BYTES, repeat_chunks=REPEAT_CHUNKS)
        writer.start(PROFILE, LIBRARY)
        for name, values in contents.metadata.items():
            writer.add_metadata(name, values)
        writer.add_metadata(RECOVERED_RECORD, {"problem": problem})
        for name, data in contents.attachments.items():
            writer.add_attachment(0, 0, name, "application/octet-stream", data)
        channels: dict[int, int] = {}
        schemas: dict[int, int] = {}
        for chunk in contents.chunks:
            try:
                data = unpack(source, chunk)
                for opcode, start, length in records(data):
                    number = int.from_bytes(data[start : start + 2], "little")
                    if opcode != MESSAGE or number not in contents.channels:
                        continue
                    if number not in channels:
                        channels[number] = _register(writer, contents, number, schemas)
                    sequence = int.from_bytes(data[start + 2 : start + 6], "little")
                    log_time = int.from_bytes(data[start + 6 : start + 14], "little")
                    body = data[start + 22 : start + length]
                    writer.add_message(channels[number], log_time, body, sequence)
                    written += 1
            except Damage:
                continue
        writer.finish()
        file.flush()
        os.fsync(file.fileno())
    return written


def _register(writer: McapFile, contents: Contents, number: int, schemas: dict[int, int]) -> int:
    """Channel number in the new file of a channel of the old one."""
    channel = contents.channels[number]
    schema = contents.schemas.get(channel.schema_id)
    if schema is None:
        return writer.register_channel(channel.topic, channel.message_encoding, 0, {})
    if channel.schema_id not in schemas:
        schemas[channel.schema_id] = writer.register_schema(schema.name, schema.encoding, schema.data)
    metadata = {"offered_qos_profiles": QOS_PROFILES}
    return writer.register_channel(channel.topic, channel.message_encoding, schemas[channel.schema_id], metadata)
