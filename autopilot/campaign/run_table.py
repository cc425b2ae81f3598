"""Comparison of campaigns: one row per folder, proportions and medians with confidence intervals, paired by run.

The unit is the run: laps of one run share vehicle and water. Proportions have the interval of Clopper and Pearson
(1934), medians the distribution-free interval between order statistics, both two-sided.
"""

import csv
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from autopilot.campaign.definition import CampaignIdentity
from autopilot.campaign.results import RunResult
from autopilot.campaign.run_store import read_identity, read_results
from autopilot.campaign.summary import CONFIDENCE, failure_interval
from autopilot.core.disk import in_place_of
from autopilot.core.params import ParamSet
from autopilot.sitl.scenario_tables import Plugins

MODE = "MPC_COST"
MODES = {0.0: "quadratic", 1.0: "least energy"}
ALARM = "Thruster "
"""Start of the warning of a weak thruster; a false alarm in R1 to R4, where all are sound."""
Cell = float | int | bool | str | None
FIRST_COLUMNS = (
    *("run", "seed", "failed", "error", "simulated_s", "cpu_s", "laps", "laps_asked", "completed", "contacts"),
    "penetration_m",
)
FURTHER_COLUMNS = (
    *("pos_rms_m", "pos_max_m", "yaw_rms_rad", "current_rms_m_s", "inside_share", "nees", "steps", "fallbacks"),
    "slack_max",
)
"""Attributes of a result that are columns as they are, before those of its laps and behind them."""


@dataclass(frozen=True, slots=True)
class Proportion:
    """Count of a total, with its confidence interval."""

    hits: int
    count: int
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.hits} of {self.count} ({100.0 * self.low:.1f} to {100.0 * self.high:.1f} %)"


@dataclass(frozen=True, slots=True)
class MedianInterval:
    """A median over runs and its interval, None if there are too few."""

    median: float | None
    low: float | None = None
    high: float | None = None

    def text(self, digits: int) -> str:
        if self.median is None:
            return ""
        if self.low is None or self.high is None:
            return f"{self.median:.{digits}f}"
        return f"{self.median:.{digits}f} ({self.low:.{digits}f} to {self.high:.{digits}f})"


@dataclass(frozen=True, slots=True, kw_only=True)
class TableRow:
    scenario: str
    mode: str
    params: dict[str, float]
    """Set in all runs, without the mode."""
    revision: str
    runs: int
    errors: int
    """Runs that could not be flown."""
    arrived: Proportion
    """Runs with all laps."""
    failed: Proportion
    """Runs that break what the scenario holds against a run."""
    alarmed: Proportion
    """Runs in which a thruster was called weak."""
    contacts: int
    """Runs that touched anything."""
    beyond: int
    """Runs that broke a bound by more than its tolerance."""
    least_m: float | None
    """Least distance that is left to a cylinder, a wall, the fence or the depth band, of all runs."""
    failsafes: tuple[str, ...]
    rough: Proportion
    """Runs that miss a bar of smooth commands (:data:`autopilot.log.smoothness.BARS`)."""
    lap_j: MedianInterval
    """Of the mean lap of each run."""
    lap_s: MedianInterval
    pos_mm: MedianInterval
    """Root mean square error of the estimated position until the mission is complete,"""
    worst_mm: float | None
    """and the largest of all runs."""
    fallbacks_pct: MedianInterval
    cpu_s: MedianInterval
    """Of a whole run."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Pairing:
    """Two modes of one set: run k of both has the same vehicle in the same water."""

    scenario: str
    ratio: MedianInterval
    """Least energy over quadratic, of the mean laps of runs that arrived in both."""
    cheaper: Proportion


def proportion(hits: int, count: int) -> Proportion:
    """With the two-sided interval at CONFIDENCE; all of 0 to 1 without runs."""
    return Proportion(hits, count, *failure_interval(hits, count))


def median_interval(values: Sequence[float]) -> MedianInterval:
    """The median between the order statistics whose ranks a binomial variable of 1/2 leaves with CONFIDENCE."""
    from scipy.stats import binom

    ordered = sorted(values)
    count = len(ordered)
    if not count:
        return MedianInterval(None)
    rank = int(binom.ppf(0.5 * (1.0 - CONFIDENCE), count, 0.5))
    bounds = (ordered[rank - 1], ordered[count - rank]) if rank else ()
    return MedianInterval(float(np.median(ordered)), *bounds)


def row_of(identity: CampaignIdentity, results: Iterable[RunResult]) -> TableRow:
    """Statistics of one campaign so far."""
    runs = list(results)
    flown = [each for each in runs if each.flown]
    return TableRow(
        scenario=identity.scenario["scenario"]["name"],
        mode=", ".join((_cost(identity), *own_parts(identity).values())),
        params={name: value for name, value in identity.params.items() if name != MODE},
        revision=identity.revision,
        runs=len(runs),
        errors=len(runs) - len(flown),
        arrived=proportion(sum(each.arrived for each in runs), len(runs)),
        failed=proportion(sum(each.failed for each in runs), len(runs)),
        alarmed=proportion(sum(any(ALARM in event for event in each.events) for each in flown), len(flown)),
        contacts=sum(each.contacts > 0 for each in flown),
        beyond=sum(bool(each.beyond) for each in flown),
        least_m=min((each.least_m for each in flown if each.least_m is not None), default=None),
        failsafes=tuple(sorted({name for each in flown for name in each.failsafes})),
        rough=proportion(sum(bool(each.rough) for each in flown), len(flown)),
        lap_j=_laps(flown, lambda each: each.energy_j),
        lap_s=_laps(flown, lambda each: each.lap_s),
        pos_mm=median_interval([1e3 * each.pos_rms_m for each in flown]),
        worst_mm=max((1e3 * each.pos_max_m for each in flown), default=None),
        fallbacks_pct=median_interval([100.0 * each.fallbacks / each.steps for each in flown if each.steps]),
        cpu_s=median_interval([each.cpu_s for each in flown]),
    )


def pairing(scenario: str, quadratic: dict[int, RunResult], least: dict[int, RunResult]) -> Pairing | None:
    """Runs that arrived in both modes and flew the same draw; None without any."""
    ratios = [
        float(np.mean(least[run].energy_j) / np.mean(quadratic[run].energy_j))
        for run in sorted({*quadratic} & {*least})
        if all(each.arrived and each.energy_j for each in (quadratic[run], least[run]))
        if (quadratic[run].seed, quadratic[run].drawn) == (least[run].seed, least[run].drawn)
    ]
    if not ratios:
        return None
    return Pairing(
        scenario=scenario,
        ratio=median_interval(ratios),
        cheaper=proportion(sum(each < 1.0 for each in ratios), len(ratios)),
    )


def table_of(folders: Sequence[Path]) -> tuple[list[TableRow], list[Pairing]]:
    """Rows of campaigns in their folders, as they were named. ConfigError: one holds no campaign."""
    read = [(read_identity(folder), read_results(folder)) for folder in folders]
    rows = [row_of(identity, results.values()) for identity, results in read]
    pairs = []
    compared: dict[tuple[str, ...], dict[float, dict[int, RunResult]]] = {}
    for (identity, results), row in zip(read, rows, strict=True):
        parts = own_parts(identity)
        if "controller" not in parts:  # another one has no cost of ours
            compared.setdefault((row.scenario, *parts.values()), {})[_mode(identity)] = results
    for (scenario, *_), mine in compared.items():
        pair = pairing(scenario, mine.get(0.0, {}), mine.get(1.0, {}))
        if pair is not None:
            pairs.append(pair)
    return rows, pairs


HEADS = (
    *(
        "set",
        "mode",
        "runs",
        "all laps",
        "failed",
        "contacts",
        "bound broken",
        "least distance kept",
        "thruster alarms",
    ),
    *("failsafes", "not smooth", "lap [J]", "lap [s]", "estimate rms [mm]", "largest error [mm]"),
    *("fallbacks [%]", "CPU per run [s]"),
)


def cells(row: TableRow) -> tuple[str, ...]:
    extra = "".join(f", {name} {value:g}" for name, value in row.params.items())
    return (
        *(row.scenario, row.mode + extra, str(row.runs), str(row.arrived), str(row.failed)),
        *(str(row.contacts), str(row.beyond), "" if row.least_m is None else f"{1000.0 * row.least_m:.0f} mm"),
        *(str(row.alarmed), ", ".join(row.failsafes) or "none", str(row.rough)),
        *(row.lap_j.text(0), row.lap_s.text(1), row.pos_mm.text(1)),
        *("" if row.worst_mm is None else f"{row.worst_mm:.0f}", row.fallbacks_pct.text(1), row.cpu_s.text(0)),
    )


def markdown(rows: Sequence[TableRow], pairs: Sequence[Pairing]) -> str:
    lines = [_line(HEADS), _line(["---"] * len(HEADS)), *(_line(cells(row)) for row in rows)]
    for pair in pairs:
        lines += ["", pair_text(pair)]
    lines += ["", f"Flown at {', '.join(dict.fromkeys(row.revision or 'no revision' for row in rows))}."]
    return "\n".join(lines) + "\n"


def pair_text(pair: Pairing) -> str:
    return (
        f"{pair.scenario}: a lap of least energy takes {pair.ratio.text(2)} of the quadratic one with the same vehicle"
        f" in the same water; cheaper in {pair.cheaper}."
    )


def _line(texts: Iterable[str]) -> str:
    return f"| {' | '.join(texts)} |"


def own_parts(identity: CampaignIdentity) -> dict[str, str]:
    """Controller, estimator and plant by kind, where they are not the default."""
    given = {**identity.scenario.get("plugins", {}), "estimator": identity.estimator}
    usual = msgspec.structs.asdict(Plugins())
    return {kind: given[kind] for kind in usual if given.get(kind, usual[kind]) != usual[kind]}


def _cost(identity: CampaignIdentity) -> str:
    if "controller" in own_parts(identity):
        return "own cost"
    return MODES.get(_mode(identity), f"{MODE} {_mode(identity):g}")


def _mode(identity: CampaignIdentity) -> float:
    """MPC_COST that the runs flew with: given, of the scenario, or the default."""
    given = identity.params.get(MODE, identity.scenario.get("params", {}).get(MODE))
    return float(ParamSet()[MODE] if given is None else given)


def _laps(flown: Sequence[RunResult], of: Callable[[RunResult], list[float]]) -> MedianInterval:
    return median_interval([float(np.mean(of(each))) for each in flown if of(each)])


def rows_of(results: Sequence[RunResult]) -> list[dict[str, Cell]]:
    """One flat row per run: drawn values, results, and the margin to each bound, SI."""
    rows: list[dict[str, Cell]] = []
    for result in results:
        laps = len(result.energy_j)
        row: dict[str, Cell] = {
            **{name: getattr(result, name) for name in FIRST_COLUMNS},
            "lap_energy_j": sum(result.energy_j) / laps if laps else None,
            "lap_s": sum(result.lap_s) / laps if laps else None,
            **{name: getattr(result, name) for name in FURTHER_COLUMNS},
            "failsafes": " ".join(result.failsafes),
            "broken": " ".join(name.replace(" ", "_") for name in result.broken),
        }
        row |= {f"margin.{name.replace(' ', '_')}": margin.margin for name, margin in result.margins.items()}
        row |= {f"drawn.{key}": value for key, value in result.drawn.items()}
        rows.append(row)
    return rows


MOST = 2**63 - 1
"""Whole number in a Parquet file."""


def write_tables(results: Sequence[RunResult], folder: Path) -> list[Path]:
    """``runs.csv``, and ``runs.parquet`` if pyarrow is installed; nothing without runs."""
    if not results:
        return []
    rows = rows_of(results)
    names = list(dict.fromkeys(name for row in rows for name in row))
    written = [folder / "runs.csv"]
    with in_place_of(written[0]) as part, part.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, names, restval="")
        writer.writeheader()
        writer.writerows(rows)
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        return written
    columns = {name: _column([row.get(name) for row in rows]) for name in names}
    written.append(folder / "runs.parquet")
    with in_place_of(written[1]) as part:
        pyarrow.parquet.write_table(pyarrow.table(columns), part, compression="zstd")
    return written


def _column(values: list[Cell]) -> list[Cell]:
    """Of one type: a key that draws numbers and texts is text, as are seeds of more than 64 bits; whole numbers beside
    others are floating point.
    """
    kinds = {type(value) for value in values if value is not None}
    long = any(isinstance(value, int) and value > MOST for value in values)
    if len(kinds) <= 1 and not long:
        return values
    if str in kinds or long:
        return [None if value is None else str(value) for value in values]
    return [math.nan if value is None else float(value) for value in values]
