"""Disks that take no writes and files that are damaged, for what is kept between runs."""

import errno
import os
from pathlib import Path
from typing import Any

import pytest


class Disk:
    """Everything below a folder; ``break_with`` makes each change there fail, as the system's calls do."""

    def __init__(self, patch: pytest.MonkeyPatch, folder: Path) -> None:
        self._folder, self._error = str(folder), 0
        for name in ("replace", "unlink", "link", "rename", "mkdir"):
            patch.setattr(os, name, self._changing(getattr(os, name)))
        self._fsync, self._open = os.fsync, os.open
        patch.setattr(os, "open", self._opening)
        patch.setattr(os, "fsync", self._syncing)

    def break_with(self, error: int) -> None:
        """EROFS: nothing is changed; ENOSPC: a name is made, its content is not kept; 0: the disk is sound again."""
        self._error = error

    def _hits(self, path: object) -> bool:
        return self._error != 0 and isinstance(path, (str, Path)) and str(path).startswith(self._folder)

    def _changing(self, call: Any) -> Any:
        def changed(*paths: Any, **given: Any) -> Any:
            if self._error == errno.EROFS and any(self._hits(path) for path in paths):
                raise OSError(errno.EROFS, os.strerror(errno.EROFS))
            return call(*paths, **given)

        return changed

    def _opening(self, path: Any, flags: int, *more: Any, **given: Any) -> int:
        if self._error == errno.EROFS and flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT) and self._hits(path):
            raise OSError(errno.EROFS, os.strerror(errno.EROFS))
        return self._open(path, flags, *more, **given)

    def _syncing(self, descriptor: int) -> None:
        if self._error == errno.ENOSPC and self._hits(os.readlink(f"/proc/self/fd/{descriptor}")):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        self._fsync(descriptor)
