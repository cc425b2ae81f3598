"""The folder of a rooms campaign: what it is, and one line per finished flight.

``rooms.json`` holds the identity, ``flights.jsonl`` one :class:`RoomResult` per line, written at once and synced.
``room-0017-energy/`` holds what a room that was flown alone leaves: scenario, plan, vehicle, log and picture.
"""

from pathlib import Path
from typing import IO

import msgspec

from autopilot import __version__
from autopilot.campaign.rooms.results import RoomResult
from autopilot.campaign.rooms.room import files_of, make_room
from autopilot.campaign.store import append_line, drop_cut_line, settle_identity
from autopilot.core.errors import ConfigError, LogError
from autopilot.log.lock import lock_exclusive
from autopilot.run.provenance import revision
from autopilot.sitl.spread import run_seed

FORMAT = 1
IDENTITY, LINES = "rooms.json", "flights.jsonl"
MODES = {"quadratic": 0, "energy": 1}
"""Name -> MPC_COST."""


class Identity(msgspec.Struct, frozen=True, kw_only=True):
    """``rooms.json``: flights of one folder agree in all of it."""

    format: int
    version: str
    revision: str
    seed: int


def room_seed(seed: int, room: int) -> int:
    """Seed of room number ``room`` (from 0) of a campaign."""
    return run_seed(seed, room)


class RoomStore:
    """A folder that is open for one process."""

    def __init__(self, folder: Path, seed: int) -> None:
        """ConfigError: another campaign lives there, or another process flies it. LogError: damaged."""
        self._folder = folder
        path = folder / LINES
        mine = Identity(format=FORMAT, version=__version__, revision=revision(), seed=seed)
        try:
            folder.mkdir(parents=True, exist_ok=True)
            settle_identity(folder / IDENTITY, mine)
            self._file: IO[bytes] = path.open("ab")
        except OSError as error:
            raise ConfigError(f"{folder}: cannot be written ({error.strerror}); choose another --out") from error
        if not lock_exclusive(self._file):
            self._file.close()
            raise ConfigError(f"{path}: another process flies these rooms now; wait for it or take another --out")
        drop_cut_line(path)

    def close(self) -> None:
        """Give the folder free."""
        self._file.close()

    def results(self) -> dict[tuple[int, int], RoomResult]:
        """Finished flights by room and mode."""
        return read_flights(self._folder)

    def append(self, result: RoomResult) -> None:
        """Keep a finished flight: one write, then on disk. LogError if the disk does not take it."""
        append_line(self._file, msgspec.json.encode(result) + b"\n", f"room {result.room}")


def read_flights(folder: Path) -> dict[tuple[int, int], RoomResult]:
    """Finished flights of a folder, in order. LogError names a line that is damaged."""
    path = folder / LINES
    found: dict[tuple[int, int], RoomResult] = {}
    if path.exists():
        whole, _, _ = path.read_bytes().rpartition(b"\n")
        for number, line in enumerate(whole.splitlines(), 1):
            try:
                result = msgspec.json.decode(line, type=RoomResult)
            except msgspec.MsgspecError as error:
                raise LogError(f"{path}:{number}: damaged ({error}); delete that line to fly it again") from error
            found.setdefault((result.room, result.mode), result)
    return dict(sorted(found.items()))


def write_files(folder: Path, seed: int, *, mode: int, duration_s: float) -> Path:
    """Scenario, plan and vehicle of a room in a folder of their own, to be flown by ``autopilot sitl``."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, data in files_of(make_room(seed), mode=mode, duration_s=duration_s).items():
        (folder / name).write_bytes(data)
    return folder
