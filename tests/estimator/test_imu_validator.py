"""Which AHRS hangs: whichever two values still move, and with the last bit of all flickering; never a live one."""

from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from autopilot.core.samples import AhrsSample
from autopilot.estimator.inertial import STUCK_SAMPLES, ImuValidator

PERIOD_US = 10_000
GYRO_LSB_RAD_S, ACCEL_LSB_M_S2 = 1.3e-4, 6e-4
"""16 bits over 250 deg/s and 2 g."""
GYRO_NOISE_RAD_S, ACCEL_NOISE_M_S2, TILT_NOISE_RAD = 3e-4, 4e-3, 2e-5
"""The quietest MEMS sensors (0.0025 deg/s and 57 ug per root hertz) at 100 Hz, and their attitude."""


def sample(t_us: int, nine: np.ndarray) -> AhrsSample:
    return AhrsSample(t_us=t_us, rpy_rad=nine[:3], rate_frd_rad_s=nine[3:6], accel_frd_m_s2=nine[6:])


def accepted(rows: np.ndarray) -> list[bool]:
    validator = ImuValidator()
    return [validator.let_in(sample(PERIOD_US * n, row), PERIOD_US * n, -1) for n, row in enumerate(rows, 1)]


@given(st.sets(st.integers(0, 8), max_size=2), st.booleans(), st.integers(0, 1000))
@settings(max_examples=60)
def test_a_device_hangs_when_at_most_two_values_move(moving: set[int], flickers: bool, seed: int) -> None:
    rng = np.random.default_rng(seed)
    rows = np.tile(np.concatenate((rng.normal(0.0, 0.3, 6), (0.1, 0.2, -9.8))), (60, 1))
    if flickers:
        last_bit = np.repeat((3e-7, GYRO_LSB_RAD_S, ACCEL_LSB_M_S2), 3)
        rows += last_bit * rng.integers(0, 2, rows.shape)
    for place in moving:
        rows[:, place] += 0.05 * rng.standard_normal(60)
    good = accepted(rows)
    assert not any(good[3 * STUCK_SAMPLES // 2 :]), "however it begins"


def test_the_quietest_device_at_rest_never_hangs() -> None:
    rng = np.random.default_rng(5)
    noise = np.repeat((TILT_NOISE_RAD, GYRO_NOISE_RAD_S, ACCEL_NOISE_M_S2), 3)
    rows = noise * rng.standard_normal((20_000, 9)) + (0, 0, 1, 0, 0, 0, 0, 0, -9.8)
    assert all(accepted(rows))


def test_a_coarse_imu_at_rest_lives_by_its_attitude() -> None:
    """ArduSub's RAW_IMU: whole milli-g and milli-radians per second, which repeat at rest; its attitude is finer."""
    rng = np.random.default_rng(6)
    rows = np.tile((0.0, 0.0, 1.0, 0.001, 0.0, 0.0, 0.0, 0.0, -9.81), (5_000, 1))
    rows[:, :3] += np.cumsum(1e-5 * rng.standard_normal((5_000, 3)), axis=0)
    assert all(accepted(rows))


def test_one_that_moves_again_is_used_again() -> None:
    rng = np.random.default_rng(7)
    live = rng.normal(0.0, 0.1, (30, 9))
    good = accepted(np.concatenate((np.tile(live[0], (60, 1)), live)))
    assert not good[50] and all(good[61:])
    assert not ImuValidator().let_in(replace(sample(1, live[0]), t_us=10**9), 1, -1)
