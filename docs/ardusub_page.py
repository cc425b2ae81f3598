"""Writes the cases with a real ArduSub into docs/hardware.md: ``python docs/ardusub_page.py --write``.

The table stands between the lines ``ardusub:begin`` and ``ardusub:end`` and comes from the figures that ``python -m
tests.bench.ardusub --ardusub PATH --record`` keeps. Without ``--write`` the exit code says whether it is current.
"""

import argparse
import json
import re
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "hardware.md"
FIGURES = ROOT / "tests" / "data" / "ardusub_suite.json"
_BLOCK = re.compile(r"(<!-- ardusub:begin -->\n).*?(<!-- ardusub:end -->)", re.S)


def shown(seen: str) -> str:
    """Without what its column says, or every mission with a simulated compass."""
    for known in ("told after ", "neutral after ", "; FC: Compass performance degraded"):
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
    told = f"{good} of {len(cases)} cases; not shown: each mission's warning of the simulated compass."
    return "\n".join([f"ArduSub {recording['ardusub']}: {told}", "", *lines])


def written(text: str) -> str:
    """The page with the table as it should be."""
    found, count = _BLOCK.subn(lambda block: f"{block[1]}{table()}\n{block[2]}", text)
    if count != 1:
        raise SystemExit(f"{PAGE}: the lines ardusub:begin and ardusub:end are missing")
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
