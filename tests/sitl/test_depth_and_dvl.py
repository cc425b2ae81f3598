"""The simulated pressure sensor and Doppler log: errors as declared, lever arms, reach, gaps."""

from typing import Any

import msgspec
import numpy as np
import pytest
from sensor_helpers import FLOOR_M, sampled

from autopilot.core.frames import r_ned_from_frd
from autopilot.core.samples import VelocityLock
from autopilot.core.vehicle import DepthMount, DvlMount
from autopilot.sitl.optional_sensors import SensedWorld, SimDepthSensor, SimDvl
from autopilot.sitl.scenario import load_scenario, scenario_path
from autopilot.sitl.scenario_tables import SensorSilence
from autopilot.sitl.sensor_tables import DepthSensor, DvlSensor, Outages

LEVER = (0.3, -0.2, 0.1)
EXACT_DEPTH = DepthSensor(sigma_m=0.0, bias_m=0.0, drift_m_rts=0.0)
EXACT_DVL = DvlSensor(sigma_m_s=0.0, bias_m_s=0.0, scale_error=0.0, drop_probability=0.0)


def depth(settings: DepthSensor = EXACT_DEPTH, faults: Any = (), seed: int = 1) -> SimDepthSensor:
    return SimDepthSensor(settings, DepthMount(position_frd_m=LEVER), SensedWorld(), faults, seed)


def dvl(settings: DvlSensor = EXACT_DVL, floor_m: float | None = FLOOR_M, faults: Any = (), seed: int = 1) -> SimDvl:
    return SimDvl(settings, DvlMount(position_frd_m=LEVER), SensedWorld(floor_depth_m=floor_m), faults, seed)


def test_depth_is_that_of_the_sensor_and_arrives_late() -> None:
    rpy = (0.2, -0.1, 1.0)
    samples = sampled(depth(), 10.0, rpy_rad=rpy)
    below = float((r_ned_from_frd(np.array(rpy)) @ np.array(LEVER))[2])
    assert len(samples) == pytest.approx(100, abs=2)
    for t_us, sample in samples:
        assert sample.depth_m == pytest.approx(0.4 + below)
        assert 0 <= t_us - sample.t_us <= 60_000


def test_depth_errors_are_as_declared() -> None:
    noisy = [s.depth_m for _, s in sampled(depth(msgspec.structs.replace(EXACT_DEPTH, sigma_m=0.01)), 60.0)]
    assert np.std(noisy) == pytest.approx(0.01, rel=0.15)
    offset = msgspec.structs.replace(EXACT_DEPTH, bias_m=0.05)
    first = [sampled(depth(offset, seed=seed), 0.3)[0][1].depth_m for seed in range(30)]
    assert np.std(first) == pytest.approx(0.05, rel=0.4)


def test_velocity_is_that_of_the_sensor() -> None:
    moving = {"vel_frd_m_s": np.array([0.3, 0.1, 0.0]), "rate_frd_rad_s": np.array([0.0, 0.0, 0.5])}
    _, sample = sampled(dvl(), 1.0, **moving)[0]
    np.testing.assert_allclose(sample.vel_frd_m_s, [0.3 + 0.1, 0.1 + 0.15, 0.0])
    assert sample.lock is VelocityLock.BOTTOM
    through = msgspec.structs.replace(EXACT_DVL, lock="water")
    _, sample = sampled(dvl(through), 1.0, vel_water_frd_m_s=np.array([0.2, 0.0, 0.0]))[0]
    np.testing.assert_allclose(sample.vel_frd_m_s, [0.2, 0.0, 0.0])
    assert sample.lock is VelocityLock.WATER


def test_velocity_errors_are_as_declared() -> None:
    settings = msgspec.structs.replace(EXACT_DVL, sigma_m_s=0.02)
    noise = np.array([s.vel_frd_m_s for _, s in sampled(dvl(settings), 60.0)])
    np.testing.assert_allclose(noise.std(axis=0), 0.02, rtol=0.15)
    scaled = msgspec.structs.replace(EXACT_DVL, scale_error=0.1)
    fast = {"vel_frd_m_s": np.array([1.0, 0.0, 0.0])}
    scales = [sampled(dvl(scaled, seed=seed), 0.5, **fast)[0][1].vel_frd_m_s[0] for seed in range(30)]
    assert np.std(scales) == pytest.approx(0.1, rel=0.4)


def test_no_bottom_lock_too_close_or_too_far() -> None:
    settings = msgspec.structs.replace(EXACT_DVL, least_altitude_m=0.5, most_altitude_m=0.9)
    assert sampled(dvl(settings), 1.0, pos_ned_m=(0.0, 0.0, 0.7))
    assert not sampled(dvl(settings), 1.0, pos_ned_m=(0.0, 0.0, 1.0))
    assert not sampled(dvl(settings), 1.0, pos_ned_m=(0.0, 0.0, 0.2))
    assert sampled(dvl(settings, None), 1.0, pos_ned_m=(0.0, 0.0, 0.2))
    water = msgspec.structs.replace(settings, lock="water")
    assert sampled(dvl(water), 1.0, pos_ned_m=(0.0, 0.0, 1.0))


def test_gaps_by_faults_and_by_chance() -> None:
    faults = [SensorSilence(at_s=2.0, duration_s=3.0, sensor="dvl")]
    silent = [s.t_us for _, s in sampled(dvl(faults=faults), 10.0)]
    assert not any(2_000_000 <= t < 5_000_000 for t in silent)
    assert len(sampled(depth(faults=faults), 10.0)) == pytest.approx(100, abs=2)
    gaps = msgspec.structs.replace(EXACT_DEPTH, outages=Outages(per_minute=20.0, min_s=1.0, max_s=2.0))
    assert len(sampled(depth(gaps), 60.0)) < 500
    lossy = msgspec.structs.replace(EXACT_DEPTH, drop_probability=0.5)
    assert 200 < len(sampled(depth(lossy), 60.0)) < 400


def test_they_come_with_their_tables(tmp_path: Any) -> None:
    assert load_scenario("paper-tank").sensors.dvl is None
    text = scenario_path("paper-tank").read_text(encoding="utf-8")
    file = tmp_path / "aided.toml"
    file.write_text(text + "\n[sensors.depth]\nrate_hz = 20.0\n[sensors.dvl]\nlock = 'water'\n", encoding="utf-8")
    sensors = load_scenario(str(file)).sensors
    assert sensors.depth is not None and sensors.depth.rate_hz == 20.0
    assert sensors.dvl is not None and sensors.dvl.lock == "water"
