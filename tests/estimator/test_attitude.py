"""The attitude filter: on real sensors with optical truth, on hostile ones, in the place of an AHRS's attitude."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from makers import Make
from truth import Faults, World, fly, uniform_current

from autopilot.core.frames import FloatArray, r_ned_from_frd, wrap_pi
from autopilot.core.messages import NavCounters
from autopilot.core.samples import AhrsSample, ImuSample, Sample
from autopilot.estimator.attitude import APART_RAD, AttitudeFilter, AttitudeSource
from autopilot.estimator.estimator_tuning import MAGNETIC
from autopilot.estimator.gyro_bias import MAX_RAD_S
from autopilot.estimator.protocol import Estimator
from autopilot.log.packing.records import pack_record
from autopilot.log.schemas import layout
from tests.bench.attitude import AttitudeErrors, errors_of
from tests.bench.attitude_fixed import FixedGainFilter, FixedGains
from tests.bench.attitude_motions import FAMILIES, record
from tests.bench.attitude_recordings import load_trials

DIP = math.tan(math.radians(60.0))


def still(t_us: int, rpy_rad: FloatArray, bias_rad_s: FloatArray | float = 0.0) -> ImuSample:
    """A device at rest."""
    down = r_ned_from_frd(rpy_rad).T
    return ImuSample(
        t_us=t_us,
        rate_frd_rad_s=np.zeros(3) + bias_rad_s,
        accel_frd_m_s2=down @ np.array([0.0, 0.0, -9.81]),
        mag_frd=down @ np.array([20.0, 0.0, 20.0 * DIP]),
    )


@pytest.fixture(scope="module")
def broad() -> dict[str, AttitudeErrors]:
    """Errors of the filter in the trials of BROAD."""
    return {trial.name: errors_of(trial, AttitudeFilter()) for trial in load_trials()}


def test_real_sensors(broad: dict[str, AttitudeErrors]) -> None:
    """Slow and fast motion, a magnet in a place and one on the device; bars a third above what was measured."""
    bars = {
        "02 slow rotation": (0.8, 2.2),
        "10 slow translation": (0.7, 2.1),
        "15 fast translation": (0.9, 2.3),
        "30 stationary magnet": (2.0, 3.0),
        "33 attached magnet": (0.9, 3.6),
    }
    assert set(broad) == set(bars)
    for name, found in broad.items():
        print(f"BROAD {name}: inclination {found.inclination:.2f}, heading {found.heading:.2f} deg rms")
        assert found.inclination <= bars[name][0], name
        assert found.heading <= bars[name][1], name
    assert np.median([found.inclination for found in broad.values()]) <= 1.0


@pytest.mark.parametrize("name", ["10 slow translation", "15 fast translation"])
def test_real_sensors_no_worse_than_with_fixed_gains(name: str, broad: dict[str, AttitudeErrors]) -> None:
    """Where the field is clean a fixed gain has its best chance."""
    trial = next(trial for trial in load_trials() if trial.name == name)
    fixed = errors_of(trial, FixedGainFilter(FixedGains()))
    assert broad[name].inclination <= 1.1 * fixed.inclination
    assert broad[name].heading <= 1.1 * fixed.heading
    assert broad[name].total <= 1.1 * fixed.total


@settings(max_examples=10, deadline=None)
@given(family=st.sampled_from(sorted(FAMILIES)), seed=st.integers(0, 10**6))
def test_any_motion_keeps_the_vertical(family: str, seed: int) -> None:
    motion = record(family, seed, 30.0)
    attitude = AttitudeFilter()
    found = errors_of(motion, attitude)
    assert found.inclination < 4.0
    assert np.abs(attitude.bias_rad_s).max() <= MAX_RAD_S


def test_pushes_to_and_fro_average_out() -> None:
    """4 m/s2 with a period of 2 s tilt the apparent vertical by 22 degrees, and a filter of fixed gain by more."""
    worst = []
    for attitude in (AttitudeFilter(), FixedGainFilter(FixedGains())):
        tilts = []
        for n in range(1, 4000):
            push = 4.0 * math.sin(math.pi * 0.01 * n)
            sample = ImuSample(t_us=10_000 * n, rate_frd_rad_s=np.zeros(3), accel_frd_m_s2=np.array([push, 0.0, -9.81]))
            tilts.append(abs(float(attitude.step(sample)[1])))
        worst.append(math.degrees(max(tilts[1000:])))
    assert worst[0] < 2.0
    assert worst[0] < 0.6 * worst[1]


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


def test_a_slow_turn_is_no_bias() -> None:
    """Hovering and turning at a degree per second looks like a device at rest with a bias, except to the magnet."""
    rate_rad_s = math.radians(1.0)
    attitude = AttitudeFilter()
    for n in range(1, 6000):
        true = np.array([0.0, 0.0, wrap_pi(0.01 * n * rate_rad_s)])
        rpy = attitude.step(still(10_000 * n, true, np.array([0.0, 0.0, rate_rad_s])))
        assert abs(float(wrap_pi(rpy[2] - true[2]))) < math.radians(1.5)
    assert np.abs(attitude.bias_rad_s).max() < math.radians(0.1)


def magnet(sample: ImuSample, field: list[float]) -> ImuSample:
    """The sample with another field, body axes."""
    return replace(sample, mag_frd=np.array(field))


def test_a_magnet_neither_tilts_nor_turns() -> None:
    """While it is near the gyros hold the heading; half of their bias is known by then."""
    attitude, true = AttitudeFilter(), np.array([0.1, -0.2, 0.5])
    bias = np.array([0.0, 0.0, math.radians(0.2)])
    for n in range(1, 12_000):
        sample = still(10_000 * n, true, bias)
        near = 9000 < n < 10_500
        rpy = attitude.step(magnet(sample, [-30.0, 50.0, 10.0]) if near else sample)
        assert attitude.field_disturbed == (9000 < n < 10_500 + 50) or abs(n - 9000) < 20 or abs(n - 10_500) < 80
        assert np.abs(rpy[:2] - true[:2]).max() < math.radians(0.5)
        if n > 6000:
            assert abs(float(wrap_pi(rpy[2] - 0.5))) < math.radians(3.5)  # 5 without rejection or bias


def turning(n: int, extra: FloatArray) -> ImuSample:
    """A level device that turns at 10 degrees per second, with a field that is added in NED."""
    rate_rad_s = math.radians(10.0)
    down = r_ned_from_frd(np.array([0.0, 0.0, 0.01 * n * rate_rad_s])).T
    return ImuSample(
        t_us=10_000 * n,
        rate_frd_rad_s=np.array([0.0, 0.0, rate_rad_s]),
        accel_frd_m_s2=np.array([0.0, 0.0, -9.81]),
        mag_frd=down @ (np.array([20.0, 0.0, 20.0 * DIP]) + extra),
    )


def test_a_field_that_stays_becomes_the_known_one() -> None:
    """Another pool: its walls turn north by 45 degrees and make the field stronger. After 20 s it is believed."""
    attitude = AttitudeFilter()
    errors = []
    for n in range(1, 9000):
        there = np.array([0.0, 20.0, 10.0]) if n > 2000 else np.zeros(3)
        rpy = attitude.step(turning(n, there))
        errors.append(math.degrees(float(wrap_pi(rpy[2] - 0.01 * n * math.radians(10.0)))))
    assert abs(errors[3900]) < 3.0  # still the gyros alone
    assert errors[-1] == pytest.approx(-45.0, abs=2.0)
    assert not attitude.field_disturbed


@pytest.mark.parametrize("believed", [False, True])
def test_iron_that_turns_with_the_device_is_not_taken_for_a_field(
    believed: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its size and dip change as the device turns, so it is never alike for long enough."""
    if believed:
        monkeypatch.setattr("autopilot.estimator.magnetic.MAGNETIC", replace(MAGNETIC, size_fraction=1e9))
        monkeypatch.setattr("autopilot.estimator.magnetic.DIP_RAD", math.pi)
    attitude = AttitudeFilter()
    errors = []
    for n in range(1, 6000):
        sample = turning(n, np.zeros(3))
        if n > 2000:
            assert sample.mag_frd is not None
            sample = magnet(sample, (sample.mag_frd + np.array([25.0, 10.0, 0.0])).tolist())
        rpy = attitude.step(sample)
        errors.append(abs(math.degrees(float(wrap_pi(rpy[2] - 0.01 * n * math.radians(10.0))))))
    assert attitude.field_disturbed != believed
    assert (max(errors) < 40.0) != believed


def test_a_gap_does_not_lose_heading_or_bias() -> None:
    attitude, true = AttitudeFilter(), np.array([0.1, 0.2, 1.0])
    bias = np.array([math.radians(0.4), 0.0, 0.0])
    for n in range(1, 6000):
        attitude.step(replace(still(10_000 * n, true, bias), mag_frd=None if n > 3000 else still(1, true).mag_frd))
    known = attitude.bias_rad_s
    after = attitude.step(replace(still(80_000_000, true, bias), mag_frd=None))
    assert np.abs(after[:2] - true[:2]).max() < 1e-9
    assert abs(float(after[2] - true[2])) < math.radians(4.0)
    assert attitude.bias_rad_s.tolist() == known.tolist()


numbers = st.one_of(st.floats(allow_nan=True, allow_infinity=True), st.sampled_from([0.0, 1e-300, -1e308, 50.0]))
triples = st.lists(numbers, min_size=3, max_size=3).map(np.array)
wild = st.tuples(
    st.one_of(st.integers(-(10**7), 10**7), st.just(10_000)), triples, triples, st.one_of(st.none(), triples)
)


@settings(max_examples=60, deadline=None)
@given(samples=st.lists(wild, max_size=12))
def test_wild_samples_do_no_lasting_harm(samples: list[tuple[int, FloatArray, FloatArray, FloatArray | None]]) -> None:
    """What cannot be is passed on as NaN, and sound samples behind it make an attitude again."""
    source, true, t_us = AttitudeSource(), np.array([0.1, -0.2, 0.5]), 10**8
    for step_us, rate, accel, field in samples:
        t_us += step_us
        source.attitude(ImuSample(t_us=t_us, rate_frd_rad_s=rate, accel_frd_m_s2=accel, mag_frd=field))
    t_us = max(t_us, 10**8) + 10**9
    for n in range(100):
        # Sensors' noise: samples that repeat are taken for a hung device.
        sound = still(t_us + 10_000 * n, true, 1e-6 * (n % 7))
        rpy = source.attitude(replace(sound, mag_frd=None)).rpy_rad
    assert np.abs(rpy[:2] - true[:2]).max() < math.radians(3.0)
    assert np.isfinite(rpy).all()


def test_one_wild_reading_of_the_field_is_soon_forgotten() -> None:
    attitude, true = AttitudeFilter(), np.array([0.0, 0.0, 0.5])
    for n in range(1, 1000):
        sample = still(10_000 * n, true)
        attitude.step(magnet(sample, [1e200, -1e200, 1e200]) if n == 500 else sample)
        if n > 500:
            assert attitude.field_disturbed == (n < 575) or 555 < n < 580
    assert abs(float(attitude.rpy_rad[2]) - 0.5) < math.radians(0.5)


class WithoutAttitude:
    """An estimator behind a device whose attitude is thrown away."""

    def __init__(self, inner: Estimator) -> None:
        self.inner = inner

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


def test_a_magnet_beside_raw_sensors_reaches_the_counters_and_the_log(make: Make) -> None:
    estimator = make()
    for n in range(1, 2200):
        sample = still(10_000 * n, np.array([0.0, 0.0, 0.5]), 1e-4 * (n % 3))
        if 1200 < n < 1500 or n > 1900:
            assert sample.mag_frd is not None
            sample = magnet(sample, (sample.mag_frd + np.array([30.0, 0.0, -20.0])).tolist())
        estimator.step(sample.t_us + 3000, (sample,), np.zeros(4))
    counts = estimator.counters()
    assert counts["ahrs.field_disturbances"] == 2
    packed = pack_record("/nav/counters", 0, NavCounters(t_us=22_000_000, counts=counts))
    kind = layout("autopilot_msgs/NavCounters").dtype
    (row,) = np.frombuffer(packed[len(packed) - kind.itemsize :], kind)
    assert row["ahrs_field_disturbances"] == 2
    assert row["other"] == 0


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
