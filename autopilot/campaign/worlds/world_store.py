"""The folder of a rooms campaign: what it is, and one line per finished flight.

``rooms.json`` holds the identity, ``flights.jsonl`` one :class:`WorldResult` per line. ``room-0017-energy/`` holds what
a room that was flown alone leaves: scenario, plan, vehicle, log and picture.
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
    """``rooms.json``: flights of one folder agree in all of it."""

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
            prepare=lambda place: settle_identity(place / IDENTITY, mine),
        )


def read_flights(folder: Path) -> dict[tuple[int, int], WorldResult]:
    """Finished flights of a folder by room and mode, in order. LogError names a line that is damaged."""
    found = read_lines([folder / LINES], WorldResult, lambda result: (result.room, result.mode))
    return dict(sorted(found.items()))
