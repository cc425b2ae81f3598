"""The yardstick is a positive, repeatable number."""

from autopilot.bench.machine import slowness


def test_the_yardstick_measures_something() -> None:
    first, second = slowness(), slowness()
    assert 0.05 < first < 100.0
    assert 0.2 < first / second < 5.0
