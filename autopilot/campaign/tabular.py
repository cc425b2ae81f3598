"""All runs of a campaign as one table: ``runs.csv``, and ``runs.parquet`` if pyarrow is installed."""

import csv
import math
from collections.abc import Sequence
from pathlib import Path

from autopilot.campaign.results import RunResult
from autopilot.core.disk import in_place_of

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
