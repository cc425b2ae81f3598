"""Disk quota of a log folder: the oldest flights are deleted for new ones.

A flight is a ``.mcap`` below a folder of a day (:func:`autopilot.log.log_session.log_path`) and its companion files
of the same name. Locked logs (being written) and files that this service did not name are kept.
"""

import contextlib
import re
import shutil
from dataclasses import dataclass
from pathlib import Path

from autopilot.log.lock import lock_exclusive

DAY = re.compile(r"\d{4}-\d{2}-\d{2}")
TIME = re.compile(r"\d{2}_\d{2}_\d{2}(_\d+)?")
TIME_CHARS = len("HH_MM_SS")

KEEP_FREE_BYTES = 256 * 1024 * 1024
"""With a quota as much of the disk stays free: an hour of flight with pictures."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FlightFiles:
    log: Path
    files: tuple[Path, ...]
    bytes: int
    order: tuple[str, str, int]
    """Day, time of day and number: older ones are less."""


def flights(folder: Path) -> list[FlightFiles]:
    """Flights below a log folder, oldest first. Files deleted meanwhile are left out."""
    found = []
    for log in folder.glob("*/*.mcap"):
        if not (DAY.fullmatch(log.parent.name) and TIME.fullmatch(log.stem)):
            continue
        files = (log, *(path for path in sorted(log.parent.glob(f"{log.stem}.*")) if path != log))
        size = 0
        for path in files:
            with contextlib.suppress(OSError):
                size += path.stat().st_size
        order = (log.parent.name, log.stem[:TIME_CHARS], int(log.stem[TIME_CHARS + 1 :] or 1))
        found.append(FlightFiles(log=log, files=files, bytes=size, order=order))
    return sorted(found, key=lambda flight: flight.order)


def remove_old_logs(folder: Path, quota_bytes: int, *, keep_free_bytes: int = KEEP_FREE_BYTES) -> list[Path]:
    """Delete the oldest flights until all take ``quota_bytes`` at most and the disk has free space. Returns the
    deleted logs. Files that cannot be deleted (locked, no permission) are left; nothing raises, because a new
    log is started in any case.
    """
    if not folder.is_dir():
        return []
    there = flights(folder)
    total = sum(flight.bytes for flight in there)
    removed = []
    for flight in there:
        if total <= quota_bytes and _free_bytes(folder) >= keep_free_bytes:
            break
        if remove_flight(flight):
            total -= flight.bytes
            removed.append(flight.log)
    return removed


def _free_bytes(folder: Path) -> int:
    try:
        return shutil.disk_usage(folder).free
    except OSError:
        return 0


def remove_flight(flight: FlightFiles) -> bool:
    """Delete a flight; whether it is deleted."""
    try:
        with flight.log.open("r+b") as file:
            if not lock_exclusive(file):
                return False
            for path in flight.files:
                path.unlink(missing_ok=True)
    except OSError:
        return False
    with contextlib.suppress(OSError):  # the day has more flights
        flight.log.parent.rmdir()
    return True
