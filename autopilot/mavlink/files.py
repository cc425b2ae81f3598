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

    def data(self, tick: int, offset: int, size: int) -> bytes | None:
        """``size`` bytes from ``offset``, fewer at the end only; None while the read is pending."""
        if self.content is not None:
            return self.content[offset : offset + size]
        size = min(size, self.size - offset)
        if size <= 0 or self.log_directory is None:
            return b""
        self._take(tick)
        at = offset - self._start
        if at >= 0 and at + size <= len(self._block):
            return self._block[at : at + size]
        if self.failed:
            return b""
        if self._task is None or self._wanted != offset:
            self.close()
            self._wanted = offset
            self._task = self.log_directory.read(tick, self.path, offset, min(BLOCK_BYTES, self.size - offset))
        return None

    def close(self) -> None:
        if self._task is not None:
            self._task.cancel()
            self._task = None

    def _take(self, tick: int) -> None:
        answer = None if self._task is None else self._task.poll(tick)
        if answer is None:
            return
        self._task = None
        self._start, self._block = self._wanted, answer.value or b""
        expected = min(BLOCK_BYTES, self.size - self._start)
        self.failed = answer.error is not None or len(self._block) < expected


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
