"""Summary of the flights of all worlds, per mode."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from autopilot.campaign.summary import failure_bound
from autopilot.campaign.worlds.world_results import WorldOutcome, WorldResult


@dataclass(frozen=True, slots=True, kw_only=True)
class ModeSummary:
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
