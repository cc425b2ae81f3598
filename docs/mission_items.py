"""Writes the table of mission items into docs/mavlink.md: ``python docs/mission_items.py --write``.

The table stands between the lines ``items:begin`` and ``items:end`` and comes from :mod:`.mission.item_types`. Without
``--write`` the exit code says whether it is current.
"""

import sys
from pathlib import Path

from generated_block import GeneratedBlock

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "mavlink.md"


def _table() -> str:
    from autopilot.mission.item_types import table

    return table()


BLOCK = GeneratedBlock(PAGE, "items", _table)


if __name__ == "__main__":
    sys.path.insert(0, str(ROOT))
    sys.exit(BLOCK.main(__doc__))
