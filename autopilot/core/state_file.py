"""Crash-safe state files: written atomically, with the previous version kept.

There is a complete file at every moment: the new content is on disk under a temporary name before it replaces the old
file, which has been linked to its backup name by then. A damaged file is set aside and not overwritten.
"""

import contextlib
import os
import re
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

T = TypeVar("T")

_LEFT_OVER = re.compile(r"[a-z0-9_]{8}")
"""What earlier versions' temporary names ended with."""


@dataclass(frozen=True, slots=True, eq=False)
class Loss:
    """Something that earlier runs have kept and that is not in force."""

    text: str
    """For the operator, without a path."""
    accept: Callable[[int], None]
    """The operator has consented to continue without it (at this tick): not asked again at the next start."""


class StateFile:
    """One file and its copy. Not thread-safe: one writer."""

    def __init__(self, path: Path, *, copies: bool = True, private: bool = False) -> None:
        """``copies``: keep the previous version; ``private``: readable by its owner only."""
        self.path = path
        self._copies = copies
        self._mode = 0o600 if private else 0o666
        self.previous = path.with_name(path.name + ".previous")
        """The content before the last."""
        self.damaged = path.with_name(path.name + ".damaged")
        """The last content that could not be used."""
        self.accepted = path.with_name(path.name + ".accepted")
        """The same, once an operator knows of it."""
        self._new = path.with_name(path.name + ".new")
        self._unread = False
        """Whether there is a file that could not be read: it is not overwritten but set aside."""

    @property
    def lost(self) -> bool:
        """Whether content was set aside that no operator has accepted to be without."""
        try:
            return self.damaged.exists()
        except OSError:
            return False

    def accept(self) -> None:
        """Operator's consent to continue without a file that was set aside, is unreadable or missing; if it cannot be
        renamed he is asked again at the next start.
        """
        for path in (self.path, self.damaged) if self._unread else (self.damaged,):
            with contextlib.suppress(OSError):
                os.replace(path, self.accepted)
        self._unread = False
        with contextlib.suppress(OSError):
            if not self.path.exists():
                os.replace(self.previous, self.path)

    def clean(self) -> None:
        """Remove partly written files of a killed service; on a read-only disk they remain, without effect."""
        with contextlib.suppress(OSError):
            self._new.unlink(missing_ok=True)
            for found in self.path.parent.glob(f"{self.path.name}????????"):
                if _LEFT_OVER.fullmatch(found.name.removeprefix(self.path.name)):
                    found.unlink(missing_ok=True)

    def read(self, parse: Callable[[bytes], T], *, set_aside: bool = True) -> tuple[T | None, list[str]]:
        """The content, else that of the previous version; None if there is neither. With it the problems found.

        ``parse`` raises ValueError with the reason for unusable content.
        """
        problems: list[str] = []
        for path in (self.path, self.previous):
            try:
                content = parse(path.read_bytes())
                if path is self.previous and not problems and not self.lost:
                    problems.append(f"{self.path}: is missing, the copy before is in force")
                return content, problems
            except FileNotFoundError:
                continue
            except OSError as error:
                problems.append(f"{path}: cannot be read ({error.strerror})")
                self._unread |= path is self.path
            except ValueError as error:
                problems.append(f"{path}: {error}")
                if path is self.path and set_aside:
                    with contextlib.suppress(OSError):  # a disk that takes no writes: it stays where it is
                        os.replace(path, self.damaged)
        return None, problems

    def set_aside(self) -> Path:
        """Rename the version that :meth:`read` returned, because it is not in use; returns the new name."""
        os.replace(self.path if self.path.exists() else self.previous, self.damaged)
        return self.damaged

    def write(self, data: bytes) -> None:
        """Replace the content. After an OSError the old content is intact."""
        self.path.parent.mkdir(parents=True, exist_ok=True)
        if self._unread:
            with contextlib.suppress(FileNotFoundError):
                os.replace(self.path, self.damaged)
            self._unread = False
        try:
            self._new.unlink(missing_ok=True)
            with open(os.open(self._new, os.O_WRONLY | os.O_CREAT | os.O_EXCL, self._mode), "wb") as stream:
                stream.write(data)
                stream.flush()
                os.fsync(stream.fileno())
            if self._copies and self.path.exists():
                self._keep_previous()
            os.replace(self._new, self.path)
        except OSError:
            self._new.unlink(missing_ok=True)
            raise
        _sync_folder(self.path.parent)

    def remove(self) -> None:
        """Have no such file any more, nor its copies. OSError when it stays."""
        for path in (self.path, self.previous, self.damaged, self.accepted, self._new):
            path.unlink(missing_ok=True)
        if self.path.parent.is_dir():
            _sync_folder(self.path.parent)

    def _keep_previous(self) -> None:
        self.previous.unlink(missing_ok=True)
        try:
            os.link(self.path, self.previous)
        except OSError:  # a file system without links
            shutil.copyfile(self.path, self.previous)


def _sync_folder(folder: Path) -> None:
    """Make a rename last, where folders can be synced."""
    if os.name != "posix":
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
