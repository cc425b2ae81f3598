"""Writes the cases with a real ArduSub into docs/hardware.md: ``python docs/ardusub_page.py --write``.

The table stands between the lines ``ardusub:begin`` and ``ardusub:end`` and comes from the figures that ``python -m
tests.bench.ardusub --ardusub PATH --record`` keeps. Without ``--write`` the exit code says whether it is current.
"""

import json
import sys
from pathlib import Path
from typing import Any

from generated_block import GeneratedBlock

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "hardware.md"
FIGURES = ROOT / "tests" / "data" / "ardusub_suite.json"
SIMULATED = ("Backup location parameters are missing or zero", "Compass performance degraded")


def shown(seen: str) -> str:
    """Without what its column says, or every mission of a simulation."""
    for known in ("told after ", "neutral after ", *(f"; FC: {text}" for text in SIMULATED)):
        seen = seen.replace(known, "")
    return seen.replace("|", "/")


def table() -> str:
    """One row per case."""
    recording: dict[str, Any] = json.loads(FIGURES.read_text(encoding="utf-8"))
    cases = recording["cases"]
    lines = ["case|must|seen|verdict", "---|---|---|---"]
    lines += [
        f"{name}|{one['must']}|{shown(one['seen'])}|{'ok' if one['good'] else '**no**'}" for name, one in cases.items()
    ]
    good = sum(one["good"] for one in cases.values())
    told = f"{good} of {len(cases)} cases; not shown: each mission's warnings of compass and origin."
    return "\n".join([f"ArduSub {recording['ardusub']}: {told}", "", *lines])


BLOCK = GeneratedBlock(PAGE, "ardusub", table)
written = BLOCK.written


if __name__ == "__main__":
    sys.exit(BLOCK.main(__doc__))
