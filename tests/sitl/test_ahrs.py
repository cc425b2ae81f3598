"""The AHRS emulator, always read through the real driver: bytes in between."""

from typing import Any

import numpy as np
import pytest
from sensor_helpers import VEHICLE, truth_at

from autopilot.core.frames import wrap_pi
from autopilot.core.samples import AhrsSample
from autopilot.drivers.ig500 import Ig500
from autopilot.drivers.ig500_protocol import ACKNOWLEDGE, CONTINUOUS_OUTPUT, Ig500Parser, encode_continuous_mode
from autopilot.sitl.ahrs import Ig500Emulator
from autopilot.sitl.plant import Truth
from autopilot.sitl.scenario_tables import AhrsFreeze, Fault
from autopilot.sitl.sensor_tables import AhrsSensor

PERFECT = AhrsSensor(
    latency_jitter_s=0.0,
    gyro_noise_rad_s_rthz=0.0,
    gyro_bias_rad_s=0.0,
    gyro_bias_walk_rad_s_rts=0.0,
    accel_noise_m_s2_rthz=0.0,
    accel_bias_m_s2=0.0,
    accel_bias_walk_m_s2_rts=0.0,
    tilt_error_rad=0.0,
    yaw_error_rad=0.0,
    yaw_offset_rad=0.0,
    yaw_field_rad=0.0,
)


def device(settings: AhrsSensor = PERFECT, seed: int = 1, faults: list[Fault] | None = None) -> Ig500Emulator:
    return Ig500Emulator(settings, VEHICLE.ahrs, faults or [], seed)


def fly(emulator: Ig500Emulator, duration_s: float, **truth: Any) -> tuple[list[AhrsSample], Ig500]:
    """What the driver makes of ``duration_s`` of that truth, polled at 100 Hz."""
    driver = Ig500(emulator, VEHICLE.ahrs.latency_s)
    driver.open()
    samples = []
    for t_us in range(0, round(duration_s * 1e6), 10_000):
        while emulator.next_us <= t_us:
            emulator.observe(truth_at(t_us=emulator.next_us, **truth))
        samples += driver.poll(t_us)
    return samples, driver


def values(samples: list[AhrsSample]) -> np.ndarray:
    return np.array([[*s.rpy_rad, *s.rate_frd_rad_s, *s.accel_frd_m_s2] for s in samples])


def test_without_errors_the_driver_sees_the_truth() -> None:
    samples, driver = fly(
        device(),
        1.0,
        rpy_rad=(0.1, -0.2, 2.5),
        rate_frd_rad_s=np.array([0.1, 0.2, -0.7]),
        accel_frd_m_s2=np.array([0.5, -0.25, -9.7]),
    )
    assert [s.t_us for s in samples] == list(range(0, 980_000, 10_000))
    np.testing.assert_allclose(
        values(samples), np.tile([0.1, -0.2, 2.5, 0.1, 0.2, -0.7, 0.5, -0.25, -9.7], (98, 1)), atol=2e-6
    )
    assert driver.bad_frames == driver.bad_samples == 0


def test_nothing_comes_before_the_latency_is_over() -> None:
    emulator = device()
    driver = Ig500(emulator, VEHICLE.ahrs.latency_s)
    driver.open()
    emulator.observe(truth_at())
    assert driver.poll(14_999) == []
    assert len(driver.poll(15_000)) == 1


def test_silent_until_told_to_send_and_acknowledges() -> None:
    emulator = device()
    emulator.observe(truth_at())
    assert emulator.read(1_000_000) == []
    emulator.write(encode_continuous_mode(2)[:5])
    emulator.write(encode_continuous_mode(2)[5:] + b"noise")
    (acknowledgement,) = Ig500Parser().feed(b"".join(data for _, data in emulator.read(0)))
    assert acknowledgement.command == ACKNOWLEDGE
    for k in range(1, 9):
        emulator.observe(truth_at(t_us=10_000 * k))
    frames = Ig500Parser().feed(b"".join(data for _, data in emulator.read(1_000_000)))
    assert [frame.command for frame in frames] == 4 * [CONTINUOUS_OUTPUT]  # every second one


def test_noise_has_the_declared_density() -> None:
    settings = AhrsSensor(gyro_bias_rad_s=0.0, accel_bias_m_s2=0.0, yaw_offset_rad=0.0, yaw_field_rad=0.0)
    samples, _ = fly(device(settings, seed=3), 40.0)
    table = values(samples)
    assert table[:, 3:6].std(axis=0) == pytest.approx(settings.gyro_noise_rad_s_rthz * 10.0, rel=0.06)  # / sqrt(0.01 s)
    assert table[:, 6:9].std(axis=0) == pytest.approx(settings.accel_noise_m_s2_rthz * 10.0, rel=0.15)


def test_biases_and_slow_errors_scatter_as_declared_over_runs() -> None:
    settings = AhrsSensor(latency_jitter_s=0.0, yaw_error_rad=0.0, yaw_field_rad=0.0)
    first = np.array([values(fly(device(settings, seed), 0.03)[0])[0] for seed in range(300)])
    expected = [settings.tilt_error_rad] * 2 + [settings.yaw_offset_rad] + [settings.gyro_bias_rad_s] * 3
    noise = np.array([0, 0, 0, 1, 1, 1]) * settings.gyro_noise_rad_s_rthz * 10.0
    np.testing.assert_allclose(first[:, :6].std(axis=0), np.hypot(expected, noise), rtol=0.15)
    assert abs(first[:, :6].mean(axis=0) / np.hypot(expected, noise)).max() < 0.2


def test_tilt_error_is_slow() -> None:
    samples, _ = fly(device(AhrsSensor(), seed=5), 30.0)
    roll = values(samples)[:, 0]
    change = np.abs(np.diff(roll))
    assert change.max() < 0.002
    assert 0.001 < roll.std() < 0.03


def test_heading_depends_on_the_place_and_stays_within_the_amplitude() -> None:
    settings = AhrsSensor(yaw_error_rad=0.0, yaw_offset_rad=0.0)
    places = [(n, e, 0.5) for n in np.linspace(-2, 2, 9) for e in np.linspace(-1, 1, 5)]
    errors = [
        values(fly(device(settings), 0.03, pos_ned_m=place, rpy_rad=(0, 0, 3.0))[0])[0, 2] - 3.0 for place in places
    ]
    errors = [wrap_pi(error) for error in errors]
    assert max(np.abs(errors)) <= settings.yaw_field_rad + 1e-6
    assert max(errors) - min(errors) > settings.yaw_field_rad


def test_a_frozen_device_repeats_itself_in_good_frames() -> None:
    freeze = AhrsFreeze(at_s=0.2, duration_s=0.3)
    samples, driver = fly(device(AhrsSensor(latency_jitter_s=0.0), faults=[freeze]), 1.0)
    by_time = {s.t_us: s for s in samples}
    frozen = values([by_time[t] for t in range(190_000, 500_000, 10_000)])
    assert (frozen == frozen[0]).all()
    assert (by_time[500_000].rate_frd_rad_s != frozen[0, 3:6]).any()
    assert len(samples) == 98
    assert driver.bad_frames == 0


def test_damaged_and_lost_frames_are_missing_and_nothing_else_changes() -> None:
    clean, _ = fly(device(AhrsSensor(latency_jitter_s=0.0)), 10.0)
    settings = AhrsSensor(latency_jitter_s=0.0, corrupt_probability=0.05, drop_probability=0.05)
    rough, driver = fly(device(settings), 10.0)
    assert 0.85 < len(rough) / len(clean) < 0.95
    assert 30 < driver.bad_frames < 70
    by_time = {s.t_us: s for s in clean}
    for sample in rough:
        assert (sample.rate_frd_rad_s == by_time[sample.t_us].rate_frd_rad_s).all()


def test_jittering_arrivals_keep_their_order_and_their_stamps() -> None:
    samples, _ = fly(device(AhrsSensor()), 10.0)
    stamps = np.array([s.t_us for s in samples])
    assert (np.diff(stamps) > 0).all()
    late = stamps[300:] - 10_000 * np.rint(stamps[300:] / 10_000)
    assert abs(late).max() < 1_500  # 2 ms of jitter, averaged


def test_other_rates_are_kept_without_drift() -> None:
    emulator = device(AhrsSensor(rate_hz=160.0))
    times = []
    for _ in range(161):
        times.append(emulator.next_us)
        truth: Truth = truth_at(t_us=emulator.next_us)
        emulator.observe(truth)
    assert times[-1] == 1_000_000
