"""Files that clients may read: metadata in memory and, under ``@MAV_LOG``, the logs."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

from autopilot.core.background import BackgroundTask
from autopilot.core.log_directory import LogDirectory, LogDirectoryEntry

LOGS = "@MAV_LOG"
"""The folder of logs that clients ask for by this name, whatever it is called on the disk."""
BLOCK_BYTES = 1 << 16
"""A file on the disk is read in pieces of this size."""
MOST_READ = 256
"""More than a client gets in one message: blocks overlap by this, so that each message is from one block."""


class FolderEntry(NamedTuple):
    name: str
    size: int | None
    """Bytes, None for a folder."""


@dataclass(slots=True)
class OpenFile:
    """A file that one client reads. ``content`` is that of a file in memory."""

    path: str
    size: int
    content: bytes | None = None
    log_directory: LogDirectory | None = None
    failed: bool = False
    """The disk did not give what was there when it was opened."""
    _start: int = 0
    _block: bytes = b""
    _task: BackgroundTask[bytes] | None = None
    _wanted: int = 0
    """Where the block that is being read begins."""
    _ahead: bytes | None = None
    """That block, once it is there."""

    def data(self, tick: int, offset: int, size: int) -> bytes | None:
        """``size`` bytes from ``offset``, fewer at the end only; None while the read is pending. Of a file on the disk
        the next block is read ahead."""
        if self.content is not None:
            return self.content[offset : offset + size]
        size = min(size, self.size - offset)
        if size <= 0 or self.log_directory is None:
            return b""
        self._take(tick)
        if not self._holds(offset, size) and self._ahead is not None:
            self._start, self._block, self._ahead = self._wanted, self._ahead, None
        if self._holds(offset, size):
            following = self._start + len(self._block) - MOST_READ
            if self._task is None and self._ahead is None and 0 < following < self.size - MOST_READ:
                self._read(tick, self.log_directory, following)
            at = offset - self._start
            return self._block[at : at + size]
        if self.failed:
            return b""
        if self._task is None or not self._wanted <= offset <= self._wanted + BLOCK_BYTES - size:
            self.close()
            self._read(tick, self.log_directory, offset)
        return None

    def close(self) -> None:
        if self._task is not None:
            self._task.cancel()
            self._task = None

    def _holds(self, offset: int, size: int) -> bool:
        return self._start <= offset and offset + size <= self._start + len(self._block)

    def _read(self, tick: int, log_directory: LogDirectory, offset: int) -> None:
        self._wanted, self._ahead = offset, None
        self._task = log_directory.read(tick, self.path, offset, min(BLOCK_BYTES, self.size - offset))

    def _take(self, tick: int) -> None:
        answer = None if self._task is None else self._task.poll(tick)
        if answer is None:
            return
        self._task, self._ahead = None, answer.value or b""
        self.failed = answer.error is not None or len(self._ahead) < min(BLOCK_BYTES, self.size - self._wanted)


def parts_of(path: str) -> tuple[str, ...] | None:
    """The names that a path is made of; None for one that leads upwards or is no text."""
    parts = tuple(part for part in path.split("/") if part not in ("", "."))
    return None if ".." in parts or "\0" in path else parts


def folder_entries(
    files: Mapping[str, bytes], logs: tuple[LogDirectoryEntry, ...], path: str
) -> list[FolderEntry] | None:
    """Entries of a folder in a fixed order; None if it does not exist."""
    parts = parts_of(path)
    if parts is None:
        return None
    if not parts:
        return [FolderEntry(LOGS, None), *(FolderEntry(name, len(data)) for name, data in sorted(files.items()))]
    if parts[0] != LOGS:
        return None
    inside, below = parts[1:], len(parts) - 1
    folders: dict[str, None] = {}
    entries = []
    for log in logs:
        names = tuple(log.path.split("/"))
        if names[:below] != inside or len(names) <= below:
            continue
        if len(names) == below + 1:
            entries.append(FolderEntry(names[-1], log.size))
        else:
            folders[names[below]] = None
    if inside and not entries and not folders:
        return None
    return [*(FolderEntry(name, None) for name in sorted(folders)), *sorted(entries)]
