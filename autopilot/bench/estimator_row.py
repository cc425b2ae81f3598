"""Estimation errors on this vehicle's tour, against the truth of the simulation.

The study with gaps, outliers, haze and wrong calibrations is ``autopilot bench estimator`` of a source checkout.
"""

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from autopilot.bench.sitl_row import paper_flight
from autopilot.log.check import acceptance_table
from autopilot.log.reader import open_log

SEEDS = (1, 2, 3)
FLIGHT_S = 30.0
"""About one lap."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EstimateRow:
    seed: int
    figure: str
    measured: float | None
    asked: float | None
    unit: str
    verdict: str


def bench_estimator(seeds: Sequence[int] = SEEDS, sensors: str = "pose") -> list[EstimateRow]:
    """Estimation errors of ``log check``, per seed."""
    return [row for seed in seeds for row in _flown(seed, sensors)]


def _flown(seed: int, sensors: str) -> list[EstimateRow]:
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "run.mcap"
        paper_flight(Path(folder), log, sensors=sensors, duration_s=FLIGHT_S, seed=seed).run()
        return [
            EstimateRow(
                seed=seed,
                figure=row.name,
                measured=row.worst,
                asked=row.limit,
                unit=row.unit,
                verdict=row.verdict.value,
            )
            for row in acceptance_table(open_log(log))
            if row.subject == "Estimate" and row.limit is not None
        ]
