"""Advisory lock on a log that is being written, so that a repair at start leaves another service's log alone."""

import sys
from typing import IO


def lock_exclusive(file: IO[bytes]) -> bool:
    """Lock an open file until it is closed; False if another process holds it. No locking on systems without flock."""
    if sys.platform == "win32":
        return True
    import fcntl

    try:
        fcntl.flock(file.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True
