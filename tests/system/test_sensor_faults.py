"""Sensors that are wrong and do not say so, through the whole service: the estimate stays honest and nothing is hit."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import pytest

from autopilot.core.samples import PowerSample, Sample
from tests.bench.fault_campaign import FAULTS
from tests.bench.sensor_faults import FaultFlight, fly_fault

AT_S, DURATION_S = 10.0, 16.0


def flight(name: str, gap_s: float, seed: int, **more: Any) -> FaultFlight:
    faults = (FAULTS[name],) if FAULTS[name] else ()
    return FaultFlight(faults=faults, gap_s=gap_s, seed=seed, at_s=AT_S, duration_s=DURATION_S, **more)


@pytest.mark.parametrize(
    ("name", "gap_s", "seed"),
    [
        ("accelerometer +1 m/s2 forward", 3.0, 61),
        ("accelerometer +10 m/s2 forward", 3.0, 62),
        ("wrong tilt 0.3 rad", 3.0, 64),
        ("gyro -0.3 rad/s", 3.0, 65),
    ],
)
def test_the_estimate_does_not_believe_what_its_evidence_denies(name: str, gap_s: float, seed: int) -> None:
    result = fly_fault(flight(name, gap_s, seed))
    assert result.contacts == 0
    assert not result.thrusters_blamed, "detectors wait while the estimate is in doubt"
    assert result.unflagged_s <= 1.0
    assert result.inside >= 0.9, "six seconds, of which the first 0.3 are the time to notice"
    assert result.worst_m < 0.3
    told = [text for text in result.texts if "wrong" in text]
    assert len(told) >= 1 and all(len(text) <= 50 for text in told), "the operator hears of it"
    assert len(told) == len(set(told))


@pytest.mark.parametrize(
    ("name", "gap_s", "seed"),
    [
        ("gyro -0.3 rad/s", 3.0, 66),
        ("gyro -0.3 rad/s", 3.0, 70),
        ("gyro +3 rad/s", 0.0, 81),
        ("wrong tilt 0.3 rad", 0.0, 82),
    ],
)
def test_inertial_sensors_that_step_are_no_jump_of_stamps(name: str, gap_s: float, seed: int) -> None:
    result = fly_fault(flight(name, gap_s, seed))
    assert not [text for text in result.texts if "stamps" in text]
    assert any("wrong" in text for text in result.texts)
    assert result.inside >= 0.9


def test_a_sound_flight_with_a_gap_raises_no_doubt() -> None:
    """Wrong mass and drag, thrust missing: that is the vehicle's error, not the sensors'."""
    mismatch = {"mass": 1.2, "drag": 0.8, "linear_drag": 0.8}
    result = fly_fault(flight("none", 3.0, 67, changes={"vehicle": {"mismatch": mismatch}}))
    assert result.contacts == 0 and not result.thrusters_blamed and result.resets == 0
    assert not [text for text in result.texts if any(word in text for word in ("wrong", "disagree", "rejected"))]


def test_a_mended_accelerometer_is_believed_again() -> None:
    """A second of wrong readings with the markers in view: some seconds later the estimate is what it was before."""
    result = fly_fault(flight("accelerometer -2 m/s2 sideways", 0.0, 68, lasts_s=1.0))
    assert result.good > 0.6
    assert result.worst_m < 0.1 and result.contacts == 0


def test_moved_markers_are_told_and_a_wrong_lens_shows_in_sigma() -> None:
    moved = fly_fault(flight("markers moved by 0.3 m", 0.0, 69))
    assert any(text.startswith(("Poses disagree", "Poses wrong")) for text in moved.texts)
    assert moved.unflagged_s <= 1.0 and moved.good < 0.5
    lens = fly_fault(flight("lens 0.9", 0.0, 70))
    assert lens.inside >= 0.95 and lens.unflagged_s <= 1.0, lens
    assert any(text.startswith("Laser and pose height") for text in lens.texts)


@pytest.mark.parametrize("flicker", [0.0, 0.01])
@pytest.mark.parametrize("seed", [71, 72])
def test_a_frozen_power_monitor_is_told_in_flight(seed: int, flicker: float) -> None:
    held: list[PowerSample] = []

    def change(t_us: int, samples: Sequence[Sample]) -> Sequence[Sample]:
        powers = [sample for sample in samples if isinstance(sample, PowerSample)]
        if t_us < 10_000_000 or not powers:
            held[:] = powers or held
            return samples
        again = replace(held[0], t_us=t_us, voltage_v=held[0].voltage_v + flicker * (t_us // 500_000 % 2))
        return [again if isinstance(sample, PowerSample) else sample for sample in samples]

    frozen = fly_fault(FaultFlight(at_s=10.0, duration_s=30.0, seed=seed), change)
    assert "Failsafe: power monitor silent or frozen" in frozen.texts
    sound = fly_fault(FaultFlight(at_s=10.0, duration_s=30.0, seed=seed))
    assert not [text for text in sound.texts if "power monitor" in text]
