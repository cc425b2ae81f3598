"""The yardstick is a sane number."""

import math

from autopilot.bench.machine import slowness


def test_the_yardstick_measures_something() -> None:
    value = slowness()
    assert math.isfinite(value)
    assert value > 0.0
