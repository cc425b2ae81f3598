"""From when on there is a gap: sources of any rate and latency, and single pauses."""

from hypothesis import given
from hypothesis import strategies as st

from autopilot.estimator.engine import FixRhythm
from autopilot.estimator.estimator_tuning import ENGINE

TICK_US = 10_000


def ages(interval_us: int, latency_us: int, count: int) -> list[int]:
    """At every node, between ``count`` fixes."""
    return [latency_us + after_us for _ in range(count) for after_us in range(0, interval_us, TICK_US)]


@given(st.integers(2, 70), st.integers(0, 25))
def test_no_interval_of_a_regular_source_is_a_gap(interval: int, latency: int) -> None:
    rhythm = FixRhythm()
    seen = ages(interval * TICK_US, latency * TICK_US, 8)
    for age_us in seen:
        rhythm.note(age_us)
    peak_us = min(max(seen), ENGINE.longest_rhythm_us)
    assert rhythm.alone_after_us >= max(ENGINE.alone_after_us, peak_us)
    assert rhythm.coast_after_us >= max(ENGINE.coast_after_us, 1.4 * peak_us)
    assert rhythm.coast_after_us <= ENGINE.coast_rhythms * ENGINE.longest_rhythm_us


@given(st.integers(0, 5))
def test_pauses_of_a_quick_source_change_nothing(paused: int) -> None:
    rhythm = FixRhythm()
    for pause_us in [0, 0, 0, 0, 3_000_000, 0, 0, 3_000_000, 0, 0][: 5 + paused]:
        for age_us in [*ages(33_000, 80_000, 1), *range(120_000, pause_us, TICK_US)]:
            rhythm.note(age_us)
    assert (rhythm.alone_after_us, rhythm.coast_after_us) == (ENGINE.alone_after_us, ENGINE.coast_after_us)
