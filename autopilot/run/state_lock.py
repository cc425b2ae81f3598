"""Lock of a state folder: two services in one would overwrite each other's plans and parameters."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from autopilot.core.errors import ConfigError
from autopilot.log.lock import lock_descriptor


@contextmanager
def locked_state(folder: Path) -> Iterator[None]:
    """Keep other services off; the lock ends with the process, however that ends. ConfigError if one has it."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        handle = os.open(folder, os.O_RDONLY)
    except OSError:  # nothing can be kept there: the arming checks say so
        yield
        return
    try:
        _lock(handle, folder)
        yield
    finally:
        os.close(handle)


def _lock(handle: int, folder: Path) -> None:
    try:
        free = lock_descriptor(handle)
    except OSError:  # a file system without locks
        return
    if not free:
        raise ConfigError(
            f"{folder}: another service keeps its state there; stop it, or use another --instance or state_dir"
        )
