"""The marker-pose sensor and the laser range of fast studies."""

from typing import Any

import msgspec
import numpy as np
import pytest
from sensor_helpers import FLOOR_M, VEHICLE, height, sampled, truth_at

from autopilot.core.samples import LaserSample, PoseSample
from autopilot.sitl.delayed import OutageClock
from autopilot.sitl.pose_sensor import SimPoseSensor
from autopilot.sitl.scenario_tables import CameraBlackout
from autopilot.sitl.sensor_tables import LaserSensor, Outages, PoseSensor

POSE = PoseSensor(drop_probability=0.0)
LATENCY_US = round(VEHICLE.camera.latency_s * 1e6)


def run(
    pose: PoseSensor = POSE,
    laser: LaserSensor | None = None,
    *,
    floor_m: float | None = FLOOR_M,
    duration_s: float = 20.0,
    faults: Any = (),
    seed: int = 1,
    **truth: Any,
) -> tuple[list[PoseSample], list[LaserSample], list[int]]:
    """Pose samples, laser samples and the delay [us] of every one, polled at 100 Hz."""
    sensor = SimPoseSensor(pose, laser or LaserSensor(), VEHICLE, floor_m, faults, seed)
    found = sampled(sensor, duration_s, **truth)
    poses = [sample for _, sample in found if isinstance(sample, PoseSample)]
    lasers = [sample for _, sample in found if isinstance(sample, LaserSample)]
    return poses, lasers, [t_us - sample.t_us for t_us, sample in found]


@pytest.mark.parametrize("camera_height_m", [0.5, 1.0])
def test_errors_are_as_declared_and_grow_with_the_height(camera_height_m: float) -> None:
    place = (0.5, -0.4, height(camera_height_m))
    poses, _, _ = run(pos_ned_m=place, rpy_rad=(0.0, 0.0, 3.141))
    error = np.array([s.pos_ned_m for s in poses]) - place
    expected = camera_height_m * np.array([POSE.sigma_xy_m, POSE.sigma_xy_m, POSE.sigma_z_m])
    np.testing.assert_allclose(poses[0].sigma_pos_m, expected)
    np.testing.assert_allclose(error.std(axis=0), expected, rtol=0.1)
    assert abs(error.mean(axis=0) / expected).max() < 0.2
    yaw = np.angle(np.exp(1j * (np.array([s.yaw_rad for s in poses]) - 3.141)))
    assert yaw.std() == pytest.approx(poses[0].sigma_yaw_rad, rel=0.1)
    assert max(abs(s.yaw_rad) for s in poses) <= np.pi


def test_laser_range_runs_along_the_beam() -> None:
    rpy = (0.2, -0.1, 1.0)
    truth = truth_at((0.0, 0.0, 0.4), rpy)
    _, lasers, _ = run(laser=LaserSensor(sigma_m=0.0), pos_ned_m=(0.0, 0.0, 0.4), rpy_rad=rpy)
    down = np.cos(0.2) * np.cos(-0.1)
    offset = np.array([0.0, 0.05, 0.10])
    third_row = np.array([-np.sin(-0.1), np.cos(-0.1) * np.sin(0.2), down])
    assert lasers[0].range_m == pytest.approx((FLOOR_M - truth.pos_ned_m[2] - third_row @ offset) / down, abs=1e-9)


def test_laser_noise_and_limits() -> None:
    _, lasers, _ = run(pos_ned_m=(0.0, 0.0, height(1.0)))
    ranges = np.array([s.range_m for s in lasers])
    assert ranges.std() == pytest.approx(lasers[0].sigma_m, rel=0.1)
    assert not run(pos_ned_m=(0.0, 0.0, height(0.1)))[1]
    assert not run(laser=LaserSensor(enabled=False))[1]
    assert not run(floor_m=None)[1]
    assert not run(rpy_rad=(3.1, 0.0, 0.0))[1]


def test_samples_come_after_their_latency_at_their_rate() -> None:
    poses, _, delays = run()
    assert np.mean(delays) == pytest.approx(LATENCY_US + 5_000, abs=2_500)  # polled every 10 ms
    assert min(delays) >= LATENCY_US - 5 * 10_000
    assert [s.t_us for s in poses[:4]] == [0, 33_333, 66_667, 100_000]
    assert len(poses) == pytest.approx(600, abs=4)


def test_wrong_fixes_have_the_declared_share_and_size() -> None:
    poses, _, _ = run(msgspec.structs.replace(POSE, outlier_probability=0.2, outlier_m=0.5), duration_s=30.0)
    distance = np.linalg.norm(np.array([s.pos_ned_m for s in poses]) - [0.0, 0.0, 0.4], axis=1)
    wrong = distance > 0.1
    assert wrong.mean() == pytest.approx(0.2, abs=0.05)
    np.testing.assert_allclose(distance[wrong], 0.5, atol=0.02)


def test_lost_samples_and_blackout() -> None:
    assert len(run(msgspec.structs.replace(POSE, drop_probability=0.5))[0]) == pytest.approx(300, abs=45)
    poses, lasers, _ = run(faults=[CameraBlackout(at_s=5.0, duration_s=2.0)])
    for samples in (poses, lasers):
        times = np.array([s.t_us for s in samples])
        assert not ((times >= 5_000_000) & (times < 7_000_000)).any()
        assert ((times >= 7_000_000) & (times < 7_040_000)).any()


def test_random_gaps_are_as_frequent_and_as_long_as_declared() -> None:
    clock = OutageClock(Outages(per_minute=6.0, min_s=0.5, max_s=1.5), [], np.random.default_rng(2))
    silent = np.array([clock.silent(t) for t in range(0, 3_600_000_000, 50_000)])
    gaps = int((np.diff(silent.astype(int)) == 1).sum())
    assert gaps == pytest.approx(3600 / 11.0, rel=0.15)  # 10 s on average in between, 1 s long
    assert silent.mean() == pytest.approx(1.0 / 11.0, rel=0.15)
    quiet = OutageClock(Outages(), [], np.random.default_rng(2))
    assert not any(quiet.silent(t) for t in range(0, 10_000_000, 50_000))
