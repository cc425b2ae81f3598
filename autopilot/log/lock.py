"""Advisory locks: on a log that is being written, which a repair at start leaves alone, and on a folder of state."""

import sys
from typing import IO


def lock_exclusive(file: IO[bytes]) -> bool:
    """Lock an open file until it is closed; False if another process holds it, or it cannot be locked."""
    try:
        return lock_descriptor(file.fileno())
    except OSError:
        return False


def lock_descriptor(descriptor: int) -> bool:
    """The same of an open descriptor; False if another process holds it. No locking on systems without flock; OSError
    on a file system without it."""
    if sys.platform == "win32":
        return True
    import fcntl

    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True
