"""The leak probe of ArduSub, of which only warnings at intervals are heard."""

import random
from collections.abc import Iterator
from contextlib import closing

import pytest

from autopilot.core.samples import LeakSample
from autopilot.drivers.ardusub_leak import DRY_US, HOLD_US, REPEAT_US, LeakWatch
from tests.drivers.test_ardusub import Bench

S = 1_000_000
STEP_US = 250_000


@pytest.fixture
def bench() -> Iterator[Bench]:
    with closing(Bench()) as made:
        yield made


def leaks(bench: Bench) -> list[bool]:
    return [sample.wet for sample in bench.samples if isinstance(sample, LeakSample)]


def test_water_is_reported_at_once_and_stays_when_the_link_is_opened_again(bench: Bench) -> None:
    bench.ready()
    bench.below.wet = True
    bench.samples.clear()
    bench.run(1.5)
    assert leaks(bench) and all(leaks(bench))
    assert any("Leak" in text for _, text in bench.driver.take_notices())
    bench.driver.close()
    bench.driver.open()
    bench.samples.clear()
    bench.run(2.0)
    assert leaks(bench) and all(leaks(bench))


def test_a_service_that_starts_between_two_warnings_does_not_call_a_wet_probe_dry(bench: Bench) -> None:
    bench.below.wet = True
    bench.silent = True  # the service before it has heard the warning
    bench.run(1.0)
    bench.wire.recv(bench.t_us)
    bench.driver.close()
    bench.driver.open()
    bench.silent = False
    bench.run(22.0)
    assert leaks(bench) and all(leaks(bench))


@pytest.mark.parametrize("seed", range(60))
def test_what_is_called_dry_has_been_dry_and_what_is_wet_is_found(seed: int) -> None:
    """Random times of water, of the flight controller's restarts and of silences of its link."""
    rng = random.Random(seed)
    watch = LeakWatch()
    wet = audible = False
    wet_since_us = dry_since_us = heard_since_us = 0
    warned_us = -REPEAT_US
    for step in range(2400):
        t_us = step * STEP_US
        if rng.random() < 0.01:
            wet = not wet
            wet_since_us, dry_since_us = t_us, t_us
        if rng.random() < 0.01:
            audible = not audible
            heard_since_us = t_us
        if rng.random() < 0.002:
            warned_us = t_us  # it has started again: the first warning comes an interval later
            wet_since_us = t_us
        warns = wet and t_us - warned_us >= REPEAT_US
        if warns:
            warned_us = t_us
        if audible:
            watch.hear(t_us, "Leak Detected" if warns else "")
        for sample in watch.samples(t_us, silent=not audible):
            heard_us, wet_us, dry_us = t_us - heard_since_us, t_us - wet_since_us, t_us - dry_since_us
            if wet and audible and min(heard_us, wet_us) > DRY_US:
                assert sample.wet
            if not sample.wet:
                assert audible
            if not wet and audible and min(heard_us, dry_us) > HOLD_US + S:
                assert not sample.wet
