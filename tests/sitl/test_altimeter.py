"""The simulated sonar altimeter: errors as declared, its beam, multiples, losses, the blind zone."""

import math
from typing import Any

import msgspec
import numpy as np
import pytest
from sensor_helpers import FLOOR_M, sampled

from autopilot.core.frames import r_ned_from_frd
from autopilot.core.vehicle import AltimeterMount
from autopilot.sitl.optional_sensors import SensedWorld, SimAltimeter
from autopilot.sitl.scenario_tables import SensorSilence
from autopilot.sitl.sensor_tables import AltimeterSensor, Outages

LEVER = (0.1, -0.05, 0.08)
EXACT = AltimeterSensor(sigma_m=0.0, sigma_share=0.0, scale_error=0.0, drop_probability=0.0)
DEPTH_M = 0.4


def altimeter(
    settings: AltimeterSensor = EXACT, floor_m: float | None = FLOOR_M, faults: Any = (), seed: int = 1
) -> SimAltimeter:
    return SimAltimeter(
        settings, AltimeterMount(position_frd_m=LEVER), SensedWorld(floor_depth_m=floor_m), faults, seed
    )


def ranges(sensor: SimAltimeter, seconds: float = 10.0, **truth: Any) -> list[float]:
    return [sample.range_m for _, sample in sampled(sensor, seconds, **truth)]


@pytest.mark.parametrize("tilt_rad", [0.0, 0.1, 0.3])
def test_the_first_echo_comes_from_straight_below_while_that_is_in_the_beam(tilt_rad: float) -> None:
    rpy = (tilt_rad, 0.0, 1.0)
    below = float((r_ned_from_frd(np.array(rpy)) @ np.array(LEVER))[2])
    height = FLOOR_M - DEPTH_M - below
    beyond = max(0.0, tilt_rad - 0.5 * AltimeterMount().beam_width_rad)
    found = ranges(altimeter(), rpy_rad=rpy)
    assert len(found) == pytest.approx(100, abs=2)
    assert found == pytest.approx([height / math.cos(beyond)] * len(found))


def test_errors_are_as_declared() -> None:
    noisy = ranges(altimeter(msgspec.structs.replace(EXACT, sigma_m=0.02)), 60.0)
    assert np.std(noisy) == pytest.approx(0.02, rel=0.15)
    scaled = msgspec.structs.replace(EXACT, scale_error=0.02)
    exact = ranges(altimeter(), 0.3)[0]
    first = [ranges(altimeter(scaled, seed=seed), 0.3)[0] / exact for seed in range(30)]
    assert np.std(first) == pytest.approx(0.02, rel=0.4)


def test_multiples_losses_and_gaps() -> None:
    exact = ranges(altimeter(), 0.3)[0]
    often = ranges(altimeter(msgspec.structs.replace(EXACT, multiple_probability=0.2)), 60.0)
    doubles = sum(abs(found - 2.0 * exact) < 1e-9 for found in often)
    assert doubles / len(often) == pytest.approx(0.2, abs=0.06)
    lossy = ranges(altimeter(msgspec.structs.replace(EXACT, drop_probability=0.3)), 60.0)
    assert len(lossy) / 600 == pytest.approx(0.7, abs=0.06)
    gaps = msgspec.structs.replace(EXACT, outages=Outages(per_minute=20.0, min_s=1.0, max_s=1.0))
    assert len(ranges(altimeter(gaps), 60.0)) < 500
    silent = ranges(altimeter(faults=(SensorSilence(at_s=2.0, duration_s=3.0, sensor="altimeter"),)))
    assert len(silent) == pytest.approx(70, abs=2)


@pytest.mark.parametrize(
    ("floor_m", "rpy"),
    [(None, (0.0, 0.0, 0.0)), (DEPTH_M + 0.3, (0.0, 0.0, 0.0)), (FLOOR_M, (0.8, 0.0, 0.0))],
    ids=["open water", "too close", "grazing"],
)
def test_where_nothing_comes_back(floor_m: float | None, rpy: tuple[float, float, float]) -> None:
    assert ranges(altimeter(floor_m=floor_m), rpy_rad=rpy) == []
