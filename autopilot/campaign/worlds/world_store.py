"""Folder of a campaign of random worlds: identity, and one line per finished flight.

``rooms.json`` holds the identity, ``flights.jsonl`` one :class:`WorldResult` per line. ``room-0017-energy/`` holds
the files of a world that was flown alone: scenario, plan, vehicle, log and figure.
"""

from pathlib import Path

import msgspec

from autopilot import __version__
from autopilot.campaign.run_store import ResultStore, read_lines, settle_identity
from autopilot.campaign.worlds.world_results import WorldResult
from autopilot.run.provenance import revision

FORMAT = 1
IDENTITY, LINES = "rooms.json", "flights.jsonl"


class WorldsIdentity(msgspec.Struct, frozen=True, kw_only=True):
    """``rooms.json``: identical for all flights of one folder."""

    format: int
    version: str
    revision: str
    seed: int


class WorldStore(ResultStore[WorldResult]):
    """A folder that is open for one process."""

    def __init__(self, folder: Path, seed: int) -> None:
        mine = WorldsIdentity(format=FORMAT, version=__version__, revision=revision(), seed=seed)
        super().__init__(
            folder / LINES,
            lambda flight: f"room {flight.room}",
            option="--out",
            prepare=lambda place: settle_identity(place / IDENTITY, mine, LINES),
        )


def read_flights(folder: Path) -> dict[tuple[int, int], WorldResult]:
    """Finished flights of a folder by world and mode, in order. LogError names a damaged line."""
    found = read_lines([folder / LINES], WorldResult, lambda result: (result.room, result.mode))
    return dict(sorted(found.items()))
