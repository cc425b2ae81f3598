"""Folders and files for results, and operator messages for disk errors."""

import contextlib
import errno
import os
from collections.abc import Iterator
from pathlib import Path

from autopilot.core.errors import ConfigError

_CAUSES = {
    errno.ENOSPC: "disk full",
    errno.EDQUOT: "disk full",
    errno.EFBIG: "file too large",
    errno.EROFS: "disk read-only",
    errno.EACCES: "no right to write",
    errno.EPERM: "no right to write",
    errno.ENOENT: "folder gone",
    errno.ENOTDIR: "folder gone",
    errno.EEXIST: "folder gone",
    errno.EIO: "disk broken",
}


def cause_of(error: Exception) -> str:
    """A failure of the disk, or an error that comes from one, in two or three words."""
    found = error if isinstance(error, OSError) else error.__cause__
    if isinstance(found, OSError):
        return _CAUSES.get(found.errno or 0, str(found.strerror).lower())
    return str(error)


def make_folder(folder: Path) -> None:
    """A folder for results, with those above it. OSError if that is not possible."""
    if folder.exists() and not folder.is_dir():
        raise NotADirectoryError(errno.ENOTDIR, "is not a folder")
    folder.mkdir(parents=True, exist_ok=True)


@contextlib.contextmanager
def in_place_of(path: Path) -> Iterator[Path]:
    """A file to write, of the same ending: complete it replaces ``path``, after an error that is as it was."""
    if path.exists() and not path.is_file():  # a device or a pipe: nothing can take its place
        yield path
        return
    path = path.resolve()  # a link stays one
    part = path.with_name(f".part.{path.name}")
    try:
        yield part
        os.replace(part, path)
    except BaseException:  # Ctrl-C, too
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)
        raise


def write_whole(path: Path, content: str | bytes) -> None:
    """Write a file that is there as a whole or, when the disk fails, as it was. OSError then."""
    with in_place_of(path) as part:
        part.write_bytes(content.encode() if isinstance(content, str) else content)


def write_result(path: Path, content: str | bytes, *, folder: bool = False) -> None:
    """:func:`write_whole` for a command, with ``folder`` also its folder. ConfigError if it cannot be written."""
    try:
        if folder:
            make_folder(path.parent)
        write_whole(path, content)
    except OSError as error:
        raise ConfigError(
            f"{path}: cannot be written ({error.strerror}); check folder and rights, or choose another place"
        ) from error
