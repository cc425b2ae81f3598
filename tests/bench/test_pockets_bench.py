"""Local minima, short form: every world from the starts where both sides pull alike."""

import pytest

from autopilot.control.constraints.obstacles import clearance_m
from tests.bench.pockets import WORLDS, bench_pockets, starts


@pytest.mark.long
def test_all_goals_are_reached_from_the_hardest_starts() -> None:
    for row in bench_pockets(2):
        assert row.reached == row.starts == 2, row
        assert row.nearest_m >= 0.0, row
        assert row.waits == 0, row


@pytest.mark.parametrize("world", WORLDS)
def test_starts_are_free_and_repeatable(world: str) -> None:
    chosen = starts(world, 60)
    assert len(set(chosen)) == 60
    assert chosen == starts(world, 60)
    assert clearance_m(WORLDS[world], [[x, y] for x, y, _ in chosen]).min() > 0.33
