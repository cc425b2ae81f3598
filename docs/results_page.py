"""Writes the reference flights into docs/results.md: ``python docs/results_page.py --write``.

The table stands between the lines ``reference:begin`` and ``reference:end`` and comes from the figures that
``autopilot bench reference`` compares with. Without ``--write`` the exit code says whether it is current.
"""

import json
import sys
from pathlib import Path
from typing import Any

from generated_block import GeneratedBlock

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "results.md"
FIGURES = ROOT / "tests" / "bench" / "reference_flights.json"
COLUMNS: dict[str, tuple[str, float, str]] = {
    "distance to fence, m": ("distance to fence, m", 1.0, ".2f"),
    "estimate rms, mm": ("estimate position rms, m", 1000.0, ".1f"),
    "1 s prediction error x, y, mm": ("1 s prediction error, {} rms, m", 1000.0, ".0f"),
}
"""Heading -> figure, factor, format."""


def _laps(flight: dict[str, float], kind: str, unit: str, form: str) -> str:
    return ", ".join(f"{flight[f'{kind} lap {n}, {unit}']:{form}}" for n in range(1, int(flight.get("laps", 0)) + 1))


def _cell(flight: dict[str, float], figure: str, factor: float, form: str) -> str:
    names = [figure.format(axis) for axis in "xy"] if "{}" in figure else [figure]
    return ", ".join(f"{factor * flight[name]:{form}}" for name in names if name in flight)


def table() -> str:
    """One row a flight."""
    release: dict[str, Any] = json.loads(FIGURES.read_text(encoding="utf-8"))
    heads = ["flight", "laps, s", "J a lap", *COLUMNS]
    lines = [f"| {' | '.join(heads)} |", f"|{' --- |' * len(heads)}"]
    for name, flight in release["flights"].items():
        cells = [name, _laps(flight, "time", "s", ".1f"), _laps(flight, "energy", "J", ".0f")]
        cells += [_cell(flight, *column) for column in COLUMNS.values()]
        lines.append(f"| {' | '.join(cells)} |")
    worst = {
        name: max(flight[name] for flight in release["flights"].values()) for name in ("contacts", "NMPC fallbacks")
    }
    lines += [
        "",
        f"Contacts: {worst['contacts']:g}. Fallback steps: {worst['NMPC fallbacks']:g}. ({release['revision']})",
    ]
    return "\n".join(lines)


BLOCK = GeneratedBlock(PAGE, "reference", table)
written = BLOCK.written


if __name__ == "__main__":
    sys.exit(BLOCK.main(__doc__))
