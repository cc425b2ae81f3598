"""Numbers of mission items in texts, as the protocol counts and as QGroundControl shows them."""

import pytest

from autopilot.core.item_numbers import counted


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("Reached item 0", "Reached item 0 (QGC 1)"),
        ("Reached items 3, 4, 5", "Reached items 3, 4, 5 (QGC 4, 5, 6)"),
        ("the mission has items 0 to 3", "the mission has items 0 to 3 (QGC 1 to 4)"),
        (
            "no free path from item 1 to item 2: move item 2",
            "no free path from item 1 (QGC 2) to item 2 (QGC 3): move item 2",
        ),
        (
            "item 1 is 0.05 m inside exclusion circle (fence item 5)",
            "item 1 (QGC 2) is 0.05 m inside exclusion circle (fence item 5)",
        ),
        ("widen the gap of fence items 4 and 8", "widen the gap of fence items 4 and 8"),
        ("Mission plan accepted: 9 items", "Mission plan accepted: 9 items"),
    ],
)
def test_a_number_is_given_in_both_ways_once(text: str, shown: str) -> None:
    assert counted(text) == shown


def test_where_home_is_item_0_both_ways_are_one() -> None:
    assert counted("No start: item 0 is 0.1 m inside", shift=1, ahead=0) == "No start: item 1 is 0.1 m inside"
    assert counted("Reached item 2", ahead=0) == "Reached item 2"
