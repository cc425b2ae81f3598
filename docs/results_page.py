"""Writes the reference flights into docs/results.md: ``python docs/results_page.py --write``.

The table stands between the lines ``reference:begin`` and ``reference:end`` and comes from the figures that
``autopilot bench reference`` compares with. Without ``--write`` the exit code says whether it is current.
"""

import argparse
import json
import re
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "results.md"
FIGURES = ROOT / "tests" / "bench" / "reference_flights.json"
_BLOCK = re.compile(r"(<!-- reference:begin -->\n).*?(<!-- reference:end -->)", re.S)
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


def written(text: str) -> str:
    """The page with the table as it should be."""
    found, count = _BLOCK.subn(lambda block: f"{block[1]}{table()}\n{block[2]}", text)
    if count != 1:
        raise SystemExit(f"{PAGE}: the lines reference:begin and reference:end are missing")
    return found


def main() -> int:
    """0 = current (or written)."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help="bring the page in line")
    write = parser.parse_args().write
    before = PAGE.read_text(encoding="utf-8")
    after = written(before)
    if write:
        PAGE.write_text(after, encoding="utf-8")
    return 0 if write or before == after else 1


if __name__ == "__main__":
    sys.exit(main())
