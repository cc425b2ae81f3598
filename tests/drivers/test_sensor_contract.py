"""What every sensor driver keeps, whatever comes from its device: each on its emulator, steadied as in a vehicle."""

import math
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sensor_rigs import RIGS, Rig

from autopilot.core.messages import Severity
from autopilot.core.sensors import SENSOR_ROWS
from autopilot.drivers.registry import BACKENDS
from autopilot.drivers.retry import DeviceState

SENSORS = tuple(row.device for row in SENSOR_ROWS if row.drivers and row.device != "camera")


@pytest.fixture(params=RIGS)
def rig(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Rig]:
    made = RIGS[request.param](tmp_path)
    yield made
    made.close()


def test_every_sensor_driver_stands_in_this_suite() -> None:
    assert {f"{kind}/{name}" for kind in SENSORS for name in BACKENDS[kind]} == set(RIGS)


def well(rig: Rig, samples: list[Any], seconds: float) -> None:
    """All is right, often enough, in order, and not from the future."""
    assert all(rig.right(sample) for sample in samples)
    assert len(samples) >= rig.least_hz * seconds
    stamps = [sample.t_us for sample in samples]
    assert stamps == sorted(set(stamps))
    assert stamps[-1] <= rig.t_us


def sane(samples: list[Any]) -> None:
    """Nothing that is not a number gets through."""
    for sample in samples:
        for field in fields(sample):
            value = getattr(sample, field.name)
            if isinstance(value, float):
                assert math.isfinite(value)
            elif isinstance(value, np.ndarray):
                assert np.isfinite(value).all()


def recovered(rig: Rig) -> None:
    """It is there again within the longest pause, and all is right then."""
    for _ in range(22):
        rig.run(0.5)
        if rig.steady.state is DeviceState.UP and rig.run(0.5):
            break
    assert rig.steady.state is DeviceState.UP
    well(rig, rig.run(1.0), 1.0)


def test_gives_what_the_device_measures(rig: Rig) -> None:
    rig.run(0.5)
    assert rig.steady.state is DeviceState.UP
    well(rig, rig.run(2.0), 2.0)


def test_garbage_costs_no_more_than_what_it_hits(rig: Rig) -> None:
    rng = np.random.default_rng(5)
    rig.run(0.5)
    samples = rig.run(2.0, lambda: rig.garbage(rng.bytes(int(rng.integers(1, 60)))))
    rig.garbage(b"")
    sane(samples)
    if rig.checked:
        assert all(rig.right(sample) for sample in samples)
        assert len(samples) > 0.3 * rig.least_hz
    recovered(rig)


@pytest.mark.parametrize("stuck", [b"\x00", b"\xff"])
def test_a_line_that_is_stuck_gives_nothing_that_is_wrong(rig: Rig, stuck: bytes) -> None:
    rig.run(0.5)
    rig.silent = rig.checked
    samples = rig.run(2.0, lambda: rig.garbage(16 * stuck))
    rig.silent = False
    rig.garbage(b"")
    sane(samples)
    recovered(rig)


def test_half_frames_are_not_taken_for_whole_ones(rig: Rig) -> None:
    rig.run(0.5)
    rig.halve(True)
    samples = rig.run(2.0)
    rig.halve(False)
    sane(samples)
    assert all(rig.right(sample) for sample in samples)
    recovered(rig)


def test_silence_is_noticed_and_ends(rig: Rig) -> None:
    rig.run(0.5)
    rig.silent = True
    rig.run(0.2)
    assert rig.run(4.0) == []
    told = [text for severity, text in rig.steady.take_notices() if severity is Severity.WARNING]
    assert len(told) == 1
    assert told[0].startswith(("device: silent", "device: down"))
    rig.silent = False
    rig.plug()
    recovered(rig)


def test_ten_times_the_rate_leaves_no_backlog(rig: Rig) -> None:
    rig.run(0.5)
    rig.hurry(10)
    well(rig, rig.run(1.0), 1.0)
    rig.hurry(1)
    rig.run(0.2)
    samples = rig.run(0.5)
    assert all(rig.right(sample) for sample in samples)
    assert rig.t_us - samples[-1].t_us < 500_000


def test_unplugged_it_is_down_and_plugged_in_it_is_back(rig: Rig) -> None:
    rig.run(0.5)
    for _ in range(2):
        rig.unplug()
        rig.run(0.1)
        assert rig.run(3.5) == []
        assert rig.steady.state is DeviceState.DOWN
        assert rig.steady.problem
        rig.plug()
        recovered(rig)
    assert rig.steady.opened_count == 3


def test_absent_at_the_start_it_is_found_later(rig: Rig) -> None:
    rig.unplug()
    assert rig.run(1.0) == []
    assert rig.steady.state is DeviceState.DOWN
    rig.plug()
    recovered(rig)
