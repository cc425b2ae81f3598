"""Results of flights in random worlds: one, the folder of a campaign of them, and their summary."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

import msgspec
import numpy as np

from autopilot import __version__
from autopilot.campaign.run_store import ResultStore, read_lines, settle_identity
from autopilot.campaign.summary import failure_bound
from autopilot.log.smoothness import BARS, Smoothness
from autopilot.run.provenance import revision

FORMAT = 1
IDENTITY, LINES = "rooms.json", "flights.jsonl"


class WorldOutcome(StrEnum):
    """How a flight ended, seen from outside."""

    REACHED = "reached"
    """Every goal, in time."""
    REFUSED = "refused rightly"
    """Before it began, for a reason that holds."""
    TOLD = "told rightly"
    """In flight: an unreachable goal was correctly reported as such."""
    MISREFUSED = "refused wrongly"
    NOT_REACHED = "not reached"
    ERROR = "error"


GOOD = (WorldOutcome.REACHED, WorldOutcome.REFUSED, WorldOutcome.TOLD)


class WorldResult(msgspec.Struct, frozen=True, kw_only=True):
    """One line of ``flights.jsonl``."""

    room: int
    """Number in the campaign, from 0."""
    mode: int
    """MPC_COST."""
    seed: int
    title: str = ""
    outcome: WorldOutcome = WorldOutcome.ERROR
    what: str = ""
    """One line: the reason that was given, or what went wrong."""
    goals: int = 0
    visited: int = 0
    """Number of goals that the plant reached, in order."""
    bound_s: float = 0.0
    """Longest that was waited."""
    simulated_s: float = 0.0
    cpu_s: float = 0.0
    length_m: float = 0.0
    """Flown over ground."""
    energy_j: float = 0.0
    contacts: int = 0
    failsafes: list[str] = []
    """That nothing justifies."""
    alarms: list[str] = []
    """Thrusters that were called weak and are not."""
    fallbacks: int = 0
    steps: int = 0
    broken: dict[str, float] = {}
    """Bounds broken by more than their tolerance -> by how much."""
    smoothness: Smoothness | None = None
    """Of the commands; None if there were too few of them."""
    first_fallback_s: float | None = None
    events: list[str] = []
    """Notices and worse, the first ones."""

    @property
    def flown(self) -> bool:
        """Whether it could be flown, or was refused."""
        return self.outcome is not WorldOutcome.ERROR

    @property
    def faults(self) -> list[str]:
        """All that is held against it."""
        found = [] if self.outcome in GOOD else [f"{self.outcome}: {self.what}"]
        if self.contacts:
            found.append(f"{self.contacts} contacts")
        if self.failsafes:
            found.append(f"failsafe {', '.join(self.failsafes)}")
        if self.fallbacks:
            found.append(f"{self.fallbacks} of {self.steps} steps by a fallback from {self.first_fallback_s:.1f} s on")
        if self.alarms:
            found.append(f"false alarm: {self.alarms[0]}")
        found += [f"{name} by {value:.3g}" for name, value in self.broken.items()]
        return found

    @property
    def rough(self) -> list[str]:
        """Bars of smooth commands that are not kept; they do not count as a failure."""
        return [] if self.smoothness is None else BARS.broken(self.smoothness)

    @property
    def failed(self) -> bool:
        return bool(self.faults)


@dataclass(frozen=True, slots=True, kw_only=True)
class ModeSummary:
    """Summary of the flights of all worlds, per mode."""

    mode: int
    flights: int
    reached: int
    refused: int
    told: int
    misrefused: int
    not_reached: int
    errors: int
    contacts: int
    """Flights with any, as the next four."""
    failsafes: int
    fallbacks: int
    alarms: int
    bounds: int
    failed: int
    failure_bound: float
    """Largest failure rate that this still allows with 95 % confidence."""
    rough: dict[str, int]
    """Flights that do not keep a bar of smooth commands, by its name."""
    median_cpu_s: float


def summarise(results: Sequence[WorldResult], mode: int) -> ModeSummary:
    mine = [result for result in results if result.mode == mode]

    def count(outcome: WorldOutcome) -> int:
        return sum(result.outcome is outcome for result in mine)

    failed = sum(result.failed for result in mine)
    rough = Counter(name for result in mine for name in result.rough)
    return ModeSummary(
        mode=mode,
        flights=len(mine),
        reached=count(WorldOutcome.REACHED),
        refused=count(WorldOutcome.REFUSED),
        told=count(WorldOutcome.TOLD),
        misrefused=count(WorldOutcome.MISREFUSED),
        not_reached=count(WorldOutcome.NOT_REACHED),
        errors=count(WorldOutcome.ERROR),
        contacts=sum(result.contacts > 0 for result in mine),
        failsafes=sum(bool(result.failsafes) for result in mine),
        fallbacks=sum(result.fallbacks > 0 for result in mine),
        alarms=sum(bool(result.alarms) for result in mine),
        bounds=sum(bool(result.broken) for result in mine),
        failed=failed,
        failure_bound=failure_bound(failed, len(mine)) if mine else 1.0,
        rough=dict(rough),
        median_cpu_s=round(float(np.median([result.cpu_s for result in mine])), 1) if mine else 0.0,
    )


class WorldsIdentity(msgspec.Struct, frozen=True, kw_only=True):
    """``rooms.json``: identical for all flights of one folder.

    ``rooms.json`` holds the identity, ``flights.jsonl`` one :class:`WorldResult` per line. ``room-0017-energy/`` holds
    the files of a world that was flown alone: scenario, plan, vehicle, log and figure."""

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
