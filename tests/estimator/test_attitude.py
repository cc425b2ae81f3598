"""The attitude filter: on real sensors with optical truth, on hostile ones, in the place of an AHRS's attitude."""

import math
from pathlib import Path

import numpy as np
import pytest
from makers import Make
from truth import Faults, World, fly, rms, uniform_current

from autopilot.core.frames import FloatArray, r_ned_from_frd, wrap_pi
from autopilot.core.samples import AhrsSample, ImuSample, Sample
from estimator.attitude import APART_RAD, AttitudeFilter, AttitudeSource
from estimator.protocol import Estimator

TRIAL = Path(__file__).resolve().parents[1] / "data" / "broad" / "trial_10_slow_translation.npz"
DIP = math.tan(math.radians(60.0))
EAST_UP = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
"""ENU from NED, and the other way round."""
FLIP = np.diag([1.0, -1.0, -1.0])
"""FRD from forward, left, up."""


def still(t_us: int, rpy_rad: FloatArray, bias_rad_s: FloatArray | float = 0.0) -> ImuSample:
    """A device at rest."""
    down = r_ned_from_frd(rpy_rad).T
    return ImuSample(
        t_us=t_us,
        rate_frd_rad_s=np.zeros(3) + bias_rad_s,
        accel_frd_m_s2=down @ np.array([0.0, 0.0, -9.81]),
        mag_frd=down @ np.array([20.0, 0.0, 20.0 * DIP]),
    )


def _matrix(quat: FloatArray) -> FloatArray:
    w, x, y, z = quat
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def broad_errors() -> tuple[float, float]:
    """Inclination and heading error [deg, rms] over the moving part of BROAD's trial 10, as its authors define them."""
    trial = np.load(TRIAL)
    rate, accel, magnet = (trial[name].astype(float) for name in ("rate_frd_rad_s", "accel_frd_m_s2", "mag_frd_ut"))
    step_us = 1e6 / float(trial["rate_hz"])
    attitude = AttitudeFilter()
    inclination, heading = [], []
    for n in range(len(rate)):
        field = magnet[n // 3] if n % 3 == 0 else None
        sample = ImuSample(
            t_us=round((n + 1) * step_us), rate_frd_rad_s=rate[n], accel_frd_m_s2=accel[n], mag_frd=field
        )
        rpy_rad = attitude.step(sample)
        if n % 5 or not trial["moving"][n // 5]:
            continue
        true = trial["quat_enu_from_flu"][n // 5].astype(float)
        if np.isfinite(true).all():
            # Of the error's rotation: the angle between the two verticals, and the turn about the vertical.
            error = _matrix(true) @ (EAST_UP @ r_ned_from_frd(rpy_rad) @ FLIP).T
            inclination.append(math.acos(min(1.0, error[2, 2])))
            heading.append(math.atan2(error[1, 0] - error[0, 1], error[0, 0] + error[1, 1]))
    return math.degrees(rms(np.array(inclination))), math.degrees(rms(np.array(heading)))


def test_real_sensors_in_slow_translation() -> None:
    inclination_deg, heading_deg = broad_errors()
    print(f"BROAD trial 10: inclination {inclination_deg:.2f} deg, heading {heading_deg:.2f} deg rms")
    assert inclination_deg <= 1.2
    assert heading_deg <= 3.0


def test_sways_are_trusted_less() -> None:
    """A swing of 3 m/s2 tilts the apparent vertical by 17 degrees; the same filter at a fixed gain follows it more."""
    worst = []
    for sway_m_s2 in (1.0, 1e6):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("estimator.attitude.SWAY_M_S2", sway_m_s2)
            attitude, tilt = AttitudeFilter(), []
            for n in range(1, 4000):
                push = 4.0 if 2000 < n < 2400 else 0.0
                rest = ImuSample(
                    t_us=10_000 * n, rate_frd_rad_s=np.zeros(3), accel_frd_m_s2=np.array([push, 0.0, -9.81])
                )
                tilt.append(abs(float(attitude.step(rest)[1])))
        worst.append(math.degrees(max(tilt)))
    assert worst[0] < 0.75 * worst[1]
    assert worst[1] > 5.0


@pytest.mark.parametrize(
    ("roll", "pitch", "yaw", "bias"), [(0.3, -0.2, 3.0, [0.01, -0.01, 0.01]), (-1.0, 0.8, -2.0, [0.0, 0.008, -0.01])]
)
def test_finds_attitude_and_bias_at_rest(roll: float, pitch: float, yaw: float, bias: list[float]) -> None:
    attitude, true = AttitudeFilter(), np.array([roll, pitch, yaw])
    first = attitude.step(still(10_000, true, np.array(bias)))
    assert np.abs([wrap_pi(float(a)) for a in first - true]).max() < 1e-9
    for n in range(2, 4500):
        last = attitude.step(still(200_000 * n, true, np.array(bias)))
    assert np.abs([wrap_pi(float(a)) for a in last - true]).max() < math.radians(0.1)
    assert np.abs(attitude.bias_rad_s - bias).max() < 5e-4


def test_a_magnet_never_tilts() -> None:
    attitude, true = AttitudeFilter(), np.array([0.1, -0.2, 0.5])
    for n in range(1, 1000):
        sample = still(10_000 * n, true)
        if n > 300:
            sample = ImuSample(
                t_us=sample.t_us,
                rate_frd_rad_s=sample.rate_frd_rad_s,
                accel_frd_m_s2=sample.accel_frd_m_s2,
                mag_frd=np.array([-30.0, 50.0, 10.0]),
            )
        rpy = attitude.step(sample)
    assert abs(float(wrap_pi(rpy[2] - 0.5))) > 0.1
    assert np.abs(rpy[:2] - true[:2]).max() < 1e-3


class WithoutAttitude:
    """An estimator behind a device whose attitude is thrown away."""

    def __init__(self, inner: Estimator) -> None:
        self.inner = inner
        self.spoil: FloatArray | None = None

    def step(self, t_us: int, samples: list[Sample], thrust_n: FloatArray) -> object:
        return self.inner.step(t_us, [self._raw(s) if isinstance(s, AhrsSample) else s for s in samples], thrust_n)

    def _raw(self, sample: AhrsSample) -> ImuSample:
        field = r_ned_from_frd(sample.rpy_rad).T @ np.array([20.0, 0.0, 20.0 * DIP])
        return ImuSample(
            t_us=sample.t_us,
            rate_frd_rad_s=sample.rate_frd_rad_s,
            accel_frd_m_s2=sample.accel_frd_m_s2,
            mag_frd=field,
        )

    def __getattr__(self, name: str) -> object:
        return getattr(self.inner, name)


def test_the_estimator_flies_on_raw_sensors(make: Make) -> None:
    track = fly(WithoutAttitude(make()), World(uniform_current, Faults()), 12.0)  # type: ignore[arg-type]
    steady = track.after(5.0)
    assert float(np.sqrt((steady.pos_error() ** 2).sum(axis=1).mean())) < 0.012
    assert math.degrees(float(np.sqrt((steady.yaw_error() ** 2).mean()))) < 0.4


def test_bad_raw_samples_are_counted(make: Make) -> None:
    estimator = make()
    level = np.zeros(3)
    good = [still(10_000 * n, level, 1e-4 * (n % 3)) for n in range(1, 30)]
    nan = ImuSample(t_us=300_000, rate_frd_rad_s=np.array([np.nan, 0, 0]), accel_frd_m_s2=good[0].accel_frd_m_s2)
    stuck = [still(10_000 * n, level, 0.5) for n in range(31, 61)]
    for sample in [*good, nan, *stuck, still(50_000, level)]:
        estimator.step(max(sample.t_us, estimator.ahrs_us or 0) + 3000, (sample,), np.zeros(4))
    counts = estimator.counters()
    assert counts["ahrs.malformed"] == 1
    assert counts["ahrs.stuck"] >= 10
    assert counts["ahrs.old"] + counts["clock.backwards"] >= 1


def test_an_ahrs_whose_tilt_leaves_its_own_sensors_is_noticed() -> None:
    source = AttitudeSource()
    for n in range(1, 1200):
        off = 1.5 * APART_RAD if n > 600 else 0.3 * APART_RAD
        sample = AhrsSample(
            t_us=10_000 * n,
            rpy_rad=np.array([off, 0.0, 1.0]),
            rate_frd_rad_s=np.zeros(3),
            accel_frd_m_s2=np.array([0.0, 0.0, -9.81]),
        )
        source.watch(sample)
        assert source.disagrees == (n > 700)
    assert source.disagreements == 1
