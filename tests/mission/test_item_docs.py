"""The table of mission items in docs/mavlink.md is the program's."""

from pathlib import Path

from autopilot.mission.item_types import ITEM_TYPES, table

DOCS = Path(__file__).parents[2] / "docs" / "mavlink.md"


def test_documented_items_are_the_programs() -> None:
    text = DOCS.read_text(encoding="utf-8")
    block = text.partition("<!-- items:begin -->\n")[2].partition("<!-- items:end -->")[0]
    assert block == table() + "\n", "run python docs/mission_items.py --write"
    assert len(table().splitlines()) == 2 + len(ITEM_TYPES)
