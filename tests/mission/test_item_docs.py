"""The table of mission items for docs/mavlink.md has them all, and what a refusal names is in it."""

import re

import pytest

from autopilot.core.geodesy import Origin
from autopilot.core.plan import PlanItem
from autopilot.mission.decode import ItemRefusedError
from autopilot.mission.item_types import ITEM_TYPES, parse_step, table


def test_the_table_has_a_row_for_every_item() -> None:
    assert len(table().splitlines()) == 2 + len(ITEM_TYPES)


def test_a_refusal_of_an_unknown_command_names_only_what_is_flown() -> None:
    with pytest.raises(ItemRefusedError) as refusal:
        parse_step(PlanItem(seq=1, frame=3, command=9999), Origin(lat_deg=38.0, lon_deg=23.8))
    text = refusal.value.rejection.reason
    named = [int(number) for number in re.findall(r"[A-Z]_[A-Z_]+ (\d+)", text)]
    assert 1 <= len(named) <= 5 and len(f"Mission refused: {text}") <= 150
    assert all(number in ITEM_TYPES and not ITEM_TYPES[number].uses.startswith("refused") for number in named)
