"""Log directory for clients that download, read in the background."""

import fnmatch
import glob
import re
from pathlib import Path, PurePosixPath

from autopilot.core.background import BackgroundTask, BackgroundWorker, Cancel
from autopilot.core.crc import file_crc32
from autopilot.core.errors import LogError
from autopilot.core.log_directory import LogDirectoryEntry
from autopilot.log.quota import flights, remove_flight

DUE_TICKS = 1
"""In lockstep an answer is there on the next tick."""
MAX_FILES = 4096
"""Maximum number of files listed, the newest ones."""
PIECE_BYTES = 1 << 20
"""Block size of checksums, which can be cancelled between blocks."""
SUFFIXES = (".mcap", ".tlog", ".png")
"""Suffixes of logs and their companion files; others are not listed."""

STILLS = ".still-*.png"
"""How the stills of a log end, behind its name."""


class LogDirectoryReader:
    """The logs below ``folder``, and the one at ``single`` (``--log``), if any."""

    def __init__(self, folder: Path, worker: BackgroundWorker, single: Path | None = None) -> None:
        self._folder, self.worker, self._single = folder, worker, single

    def list(self, tick: int) -> BackgroundTask[tuple[LogDirectoryEntry, ...]]:
        """All files by their names, which tell when they were begun; files deleted meanwhile are left out."""
        return self.worker.submit(tick + DUE_TICKS, lambda _, cancel: self._listed(cancel), None)

    def read(self, tick: int, path: str, offset: int, size: int) -> BackgroundTask[bytes]:
        def work(_: None, cancel: Cancel) -> bytes:
            cancel.check()
            with self._found(path).open("rb") as file:
                file.seek(offset)
                return file.read(size)

        return self.worker.submit(tick + DUE_TICKS, work, None)

    def crc32(self, tick: int, path: str) -> BackgroundTask[int]:
        def work(_: None, cancel: Cancel) -> int:
            crc = 0
            with self._found(path).open("rb") as file:
                while piece := file.read(PIECE_BYTES):
                    cancel.check()
                    crc = file_crc32(piece, crc)
            return crc

        return self.worker.submit(tick + DUE_TICKS, work, None)

    def erase(self, tick: int) -> BackgroundTask[int]:
        """Delete all flights of the folder except those being written; a log with a custom name is kept."""
        return self.worker.submit(
            tick + DUE_TICKS, lambda _, cancel: sum(remove_flight(flight) for flight in flights(self._folder)), None
        )

    def _listed(self, cancel: Cancel) -> tuple[LogDirectoryEntry, ...]:
        found: list[LogDirectoryEntry] = []
        root = self._folder.resolve()
        candidates = [(path, path.relative_to(root).as_posix()) for path in root.glob("**/*")]
        if self._single is not None:
            single = self._single
            siblings = [single, single.with_suffix(".tlog"), *single.parent.glob(f"{glob.escape(single.stem)}{STILLS}")]
            candidates += [(path, path.name) for path in siblings if path.parent.resolve() != root]
        for path, name in candidates:
            cancel.check()
            try:
                if path.suffix in SUFFIXES and not path.is_symlink() and path.is_file():
                    stat = path.stat()
                    found.append(LogDirectoryEntry(path=name, size=stat.st_size, modified_s=int(stat.st_mtime)))
            except OSError:
                continue
        return tuple(sorted(found, key=_by_name)[-MAX_FILES:])

    def _found(self, path: str) -> Path:
        """The file of that name. LogError for one that is not there, is no log, or lies outside of the folder."""
        parts = PurePosixPath(path).parts
        single = self._single
        if single is not None and len(parts) == 1 and self._is_of_single(parts[0], single):
            inside = single.with_name(parts[0])
            if inside.is_file() and not inside.is_symlink():
                return inside
        root = self._folder.resolve()
        inside = root.joinpath(*parts).resolve() if parts and "\0" not in path else root
        if not inside.is_relative_to(root) or inside.suffix not in SUFFIXES or not inside.is_file():
            raise LogError(f"there is no log {path!r}; list the folder for those that there are")
        return inside

    @staticmethod
    def _is_of_single(name: str, single: Path) -> bool:
        """Whether a file is the single log (``--log``) or one of its companions."""
        stills = f"{glob.escape(single.stem)}{STILLS}"
        return name in (single.name, single.with_suffix(".tlog").name) or fnmatch.fnmatchcase(name, stills)


def _by_name(file: LogDirectoryEntry) -> list[str | int]:
    """For the order of files: numbers in names by their value. Times of files change when they are copied."""
    return [int(part) if part.isdecimal() else part for part in re.split(r"(\d+)", file.path)]
