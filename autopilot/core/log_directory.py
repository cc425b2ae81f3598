"""The log directory for clients: list of files, and blocks of them. All reads are in the background."""

from dataclasses import dataclass
from typing import Protocol

from autopilot.core.background import BackgroundTask


@dataclass(frozen=True, slots=True, kw_only=True)
class LogDirectoryEntry:
    path: str
    """Below the folder, with "/" between its parts."""
    size: int
    """Bytes, when it was looked at."""
    modified_s: int
    """Unix time."""


class LogDirectory(Protocol):
    """A folder that is read and, by :meth:`erase` alone, emptied. Results are polled with the tick count.

    Paths outside of the folder are refused with a LogError, as are files that do not exist.
    """

    def list(self, tick: int) -> BackgroundTask[tuple[LogDirectoryEntry, ...]]:
        """All files, oldest first: a file keeps its place while others are added behind it."""
        ...

    def read(self, tick: int, path: str, offset: int, size: int) -> BackgroundTask[bytes]:
        """At most ``size`` bytes from ``offset``; fewer at the end."""
        ...

    def crc32(self, tick: int, path: str) -> BackgroundTask[int]:
        """Checksum of a whole file, as :func:`autopilot.core.crc.file_crc32` has it."""
        ...

    def erase(self, tick: int) -> BackgroundTask[int]:
        """Remove all finished flights; how many."""
        ...
