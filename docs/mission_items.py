"""Writes the table of mission items into docs/mavlink.md: ``python docs/mission_items.py --write``.

The table stands between the lines ``items:begin`` and ``items:end`` and comes from :mod:`.mission.item_types`. Without
``--write`` the exit code says whether it is current.
"""

import argparse
import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "mavlink.md"
_BLOCK = re.compile(r"(<!-- items:begin -->\n).*?(<!-- items:end -->)", re.S)


def written(text: str) -> str:
    """The page with the table as it should be."""
    from autopilot.mission.item_types import table

    found, count = _BLOCK.subn(lambda block: f"{block[1]}{table()}\n{block[2]}", text)
    if count != 1:
        raise SystemExit(f"{PAGE}: the lines items:begin and items:end are missing")
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
    sys.path.insert(0, str(ROOT))
    sys.exit(main())
