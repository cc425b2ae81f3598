"""Sources of one to fifty fixes a second: three that agree start the filter, outliers do not."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from autopilot.estimator.measure_pose import PoseFix
from autopilot.estimator.relocation import Relocation
from autopilot.estimator.startup import StartUp

RATES_HZ = st.floats(0.9, 50.0)


def fix(t_s: float, north_m: float = 0.0) -> PoseFix:
    return PoseFix(
        sensor="external", t_us=round(1e6 * t_s), z=np.array([north_m, 0.0, 0.5, 0.0]), noise=1e-4 * np.eye(4)
    )


@given(RATES_HZ, st.floats(-0.5, 0.5))
def test_the_third_fix_of_a_moving_vehicle_starts(rate_hz: float, speed_m_s: float) -> None:
    start = StartUp()
    times_s = [k / rate_hz for k in range(3)]
    assert [start.offer(fix(t_s, speed_m_s * t_s)) for t_s in times_s] == [False, False, True]


@pytest.mark.parametrize(("rate_hz", "reported"), [(0.7, True), (1.0, False)])
def test_a_source_that_is_too_slow_is_told_so_once(rate_hz: float, reported: bool) -> None:
    """*No position yet* for good, and nothing that said why."""
    start = StartUp()
    started = [start.offer(fix(k / rate_hz)) for k in range(12)]
    assert any(started) is not reported
    assert start.take_texts() == (("Fixes 1.4 s apart: one a second is needed",) if reported else ())


@given(RATES_HZ, st.lists(st.integers(0, 1000), min_size=3, max_size=12, unique=True))
def test_fixes_from_everywhere_start_nothing(rate_hz: float, places: list[int]) -> None:
    start = StartUp()
    assert not any(start.offer(fix(k / rate_hz, 10.0 * place)) for k, place in enumerate(places))


@pytest.mark.parametrize("pause_s", [2.6, 10.0])
def test_what_is_long_ago_does_not_count(pause_s: float) -> None:
    start = StartUp()
    assert not any(start.offer(fix(k * pause_s)) for k in range(3))


@given(RATES_HZ)
def test_a_lost_filter_moves_to_three_fixes_that_agree(rate_hz: float) -> None:
    relocation = Relocation()
    moved = [relocation.rejected(fix(k / rate_hz, 3.0), lost=True) is not None for k in range(3)]
    assert moved == [False, False, True]
