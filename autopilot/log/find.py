"""Search a folder for logs by the metadata of their runs; reads headers and indexes only."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from autopilot.core.errors import LogError
from autopilot.core.names import unknown
from autopilot.log.reader import open_log


@dataclass(frozen=True, slots=True, kw_only=True)
class Found:
    path: Path
    duration_s: float
    messages: int
    size_bytes: int
    facts: Mapping[str, str]
    """Metadata of its run: scenario, vehicle, seed, started, revision ..."""
    problem: str
    """Why it cannot be read, or what is missing; "" for a whole one."""


def find_logs(folder: Path, wanted: Mapping[str, str] | None = None) -> Iterator[Found]:
    """Logs below a folder, sorted by path.

    Parameters
    ----------
    folder
        Searched recursively for ``*.mcap``.
    wanted
        Metadata key -> prefix that its value must begin with (case-insensitive); None = all logs.

    Yields
    ------
    Found
        One per log, damaged ones included.

    Raises
    ------
    LogError
        There is no such folder.
    UnknownNameError
        None of the logs has a key that is wanted.
    """
    if not folder.is_dir():
        raise LogError(f"{folder}: is no folder; give one that holds logs")
    keys: dict[str, None] = {}
    for path in sorted(folder.rglob("*.mcap")):
        found = _inspect(path)
        keys.update(dict.fromkeys(found.facts))
        if all(found.facts.get(key, "").lower().startswith(value.lower()) for key, value in (wanted or {}).items()):
            yield found
    for key in wanted or {}:
        if keys and key not in keys:
            raise unknown("--where", key, tuple(keys))


def _inspect(path: Path) -> Found:
    try:
        size = path.stat().st_size
        log = open_log(path)
    except (LogError, OSError) as error:
        return Found(path=path, duration_s=0.0, messages=0, size_bytes=0, facts={}, problem=str(error))
    return Found(
        path=path,
        duration_s=log.duration_s,
        messages=log.message_count,
        size_bytes=size,
        facts=log.run,
        problem="; ".join(log.problems),
    )
