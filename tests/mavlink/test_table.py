"""A table of so many entries."""

from collections import OrderedDict

from hypothesis import given
from hypothesis import strategies as st

from autopilot.mavlink.bounded_table import LatestUsed

MOST = 3


@given(st.lists(st.tuples(st.integers(0, 6), st.sampled_from(("touch", "set", "look", "drop"))), max_size=60))
def test_the_one_used_least_lately_makes_room_and_is_told(steps: list[tuple[int, str]]) -> None:
    gone: list[int] = []
    table: LatestUsed[int, int] = LatestUsed(MOST, gone.append)
    order: OrderedDict[int, int] = OrderedDict()
    expected: list[int] = []
    for count, (key, way) in enumerate(steps):
        if way == "look":
            assert table.get(key) == order.get(key)
            continue
        if way == "drop":
            assert table.pop(key, None) == order.pop(key, None)
            continue
        if way == "set":
            table[key] = value = count
        else:
            value = order.get(key, count)
            assert table.touch(key, lambda made=count: made) == value
        order.pop(key, None)
        order[key] = value
        if len(order) > MOST:
            expected.append(order.pop(next(iter(order))))
        assert list(table.items()) == list(order.items())
    assert gone == expected
