"""The study of random legs: repeatable draws, and its figures."""

import numpy as np
import pytest

from autopilot.control.constraints.obstacles import clearance_m
from tests.bench.energy.legs import FREE_M, bench_legs, random_leg


def test_legs_are_free_and_repeatable() -> None:
    for leg in range(20):
        request, again = random_leg(leg), random_leg(leg)
        assert np.array_equal(request.x0, again.x0) and np.array_equal(request.goal.pos_ned_m, again.goal.pos_ned_m)
        ends = [request.x0[:2].tolist(), request.goal.pos_ned_m[:2].tolist()]
        assert clearance_m(request.fence, ends).min() > FREE_M


@pytest.mark.long
def test_every_leg_has_a_row_per_kind_of_plan() -> None:
    quick, search = bench_legs(2)
    assert quick.legs == search.legs == 2 and quick.without == search.without == 0
    assert 0.0 < quick.cpu_p50_s <= quick.cpu_max_s
