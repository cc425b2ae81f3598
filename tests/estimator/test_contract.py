"""What every estimator must do, whatever is inside."""

import math
from dataclasses import replace

import numpy as np
import pytest
from makers import Make
from truth import Faults, Track, World, fly, no_current, rms, tank_jet, uniform_current

from autopilot.core.errors import ConfigError
from autopilot.core.messages import AidState, NavHealth
from autopilot.core.samples import AhrsSample, LaserSample, MarkerSighting, PoseSample, Sample
from autopilot.core.vehicle import Vehicle
from autopilot.estimator.create import create_estimator

ZERO = np.zeros(4)


def assert_finite(track: Track) -> None:
    for nav in track.nav:
        for values in (
            nav.pos_ned_m,
            nav.rpy_rad,
            nav.vel_frd_m_s,
            nav.vel_water_frd_m_s,
            nav.rate_frd_rad_s,
            nav.current_ned_m_s,
            nav.variance,
        ):
            assert np.isfinite(values).all()
        assert nav.variance.shape == (12,)
        assert (nav.variance >= 0.0).all()


def test_factory_knows_both_and_refuses_others(vehicle: Vehicle) -> None:
    for name in ("ekf", "complementary"):
        assert create_estimator(name, vehicle, None).step(10_000, (), ZERO) is None
    with pytest.raises(ConfigError, match=r"ukf.*use one of ekf, complementary"):
        create_estimator("ukf", vehicle, None)


def test_nothing_before_vision_then_follows(make: Make) -> None:
    estimator = make()
    track = fly(estimator, World(tank_jet, Faults(laser=True)), 20.0)
    assert 60_000 <= track.nav[0].t_us <= 400_000
    assert_finite(track)
    steady = track.after(5.0)
    assert rms(steady.pos_error()[:, :2]) < 0.010
    assert rms(steady.pos_error()[:, 2]) < 0.005
    assert math.degrees(rms(steady.yaw_error())) < 0.3
    assert rms(steady.vel_error()) < 0.03
    assert all(nav.health is NavHealth.GOOD for nav in steady.nav)
    assert steady.nav[-1].reset_count == 0
    assert [nav.t_us for nav in track.nav] == [truth.t_us for truth in track.truth]


def test_reports_every_sensor(make: Make) -> None:
    estimator = make()
    fly(estimator, World(no_current, Faults(laser=True)), 3.0)
    aids = estimator.take_aids()
    assert {aid.sensor for aid in aids} == {"markers", "laser", "heading", "model"}
    for aid in aids:
        assert aid.innovation.shape == aid.innovation_var.shape == (3,)
        assert aid.fused == (aid.test_ratio <= 1.0)
        assert -0.001 <= aid.age_s < 0.2
    last = {aid.sensor: aid for aid in aids}
    assert all(aid.state is AidState.ACTIVE for aid in last.values())
    assert estimator.take_aids() == ()


def test_never_initialises_without_vision(make: Make) -> None:
    estimator = make()
    assert fly(estimator, World(no_current, Faults(vision=False)), 2.0).nav == []
    assert estimator.counters()["ahrs.good"] > 150


def test_never_initialises_without_ahrs(make: Make) -> None:
    assert fly(make(), World(no_current, Faults(ahrs_gap_s=(0.0, 1e9))), 1.0).nav == []


NAN = float("nan")
BAD_ARRAYS = (np.full(3, NAN), np.array([math.inf, 0.0, 0.0]), np.full(3, 1e300), np.zeros(2), np.zeros((3, 1)))


def test_malformed_samples_are_counted_and_change_nothing(make: Make) -> None:
    """The same run with and without bad samples thrown in gives the same states bit for bit."""

    def spoil(t_us: int, samples: list[Sample]) -> list[Sample]:
        bad: list[Sample] = []
        ok = np.zeros(3)
        for array in BAD_ARRAYS:
            bad += [
                AhrsSample(t_us=t_us - 15_000, rpy_rad=array, rate_frd_rad_s=ok, accel_frd_m_s2=ok),
                AhrsSample(t_us=t_us - 15_000, rpy_rad=ok, rate_frd_rad_s=array, accel_frd_m_s2=ok),
                AhrsSample(t_us=t_us - 15_000, rpy_rad=ok, rate_frd_rad_s=ok, accel_frd_m_s2=array),
            ]
        k = t_us // 10_000
        if k % 7 == 0:
            for n, array in enumerate((np.full(3, NAN), np.zeros(2))):
                t = t_us - 61_003 - n
                sigma = np.full(3, 0.003)
                bad.append(PoseSample(t_us=t, pos_ned_m=array, yaw_rad=0.0, sigma_pos_m=sigma, sigma_yaw_rad=0.01))
            bad.append(LaserSample(t_us=t_us - 61_003, range_m=NAN, sigma_m=0.01))
            bad.append(LaserSample(t_us=t_us - 61_005, range_m=1.0, sigma_m=-1.0))
        return bad + samples

    clean, dirty = make(), make()
    a = fly(clean, World(tank_jet), 3.0)
    b = fly(dirty, World(tank_jet), 3.0, spoil)
    assert len(a.nav) == len(b.nav)
    for x, y in zip(a.nav, b.nav, strict=True):
        np.testing.assert_array_equal(x.pos_ned_m, y.pos_ned_m)
        np.testing.assert_array_equal(x.variance, y.variance)
    counts = dirty.counters()
    assert counts["ahrs.malformed"] == 300 * 15
    assert counts["markers.malformed"] >= 80
    assert counts["laser.malformed"] >= 80


def test_malformed_thrust_is_counted(make: Make) -> None:
    estimator = make()
    nav = None
    for truth, samples, _ in World(no_current).run(2.0):
        nav = estimator.step(truth.t_us, samples, np.array([NAN, math.inf, 0.0, 0.0]))
    assert nav is not None and np.isfinite(nav.vel_water_frd_m_s).all()
    assert estimator.counters()["thrust.malformed"] == 200


def test_duplicates_are_used_once(make: Make) -> None:
    def twice(t_us: int, samples: list[Sample]) -> list[Sample]:
        return samples + samples

    once, doubled = make(), make()
    a = fly(once, World(tank_jet, Faults(laser=True)), 3.0)
    b = fly(doubled, World(tank_jet, Faults(laser=True)), 3.0, twice)
    for x, y in zip(a.nav, b.nav, strict=True):
        np.testing.assert_array_equal(x.pos_ned_m, y.pos_ned_m)
    counts = doubled.counters()
    assert counts["markers.duplicate"] > 80
    assert counts["laser.duplicate"] > 80
    assert counts["ahrs.old"] > 290


def test_late_and_unordered_samples_end_in_nearly_the_same_state(make: Make) -> None:
    """Vision that arrives in bundles, newest first, is put where it belongs."""
    held: list[Sample] = []

    def bundle(t_us: int, samples: list[Sample]) -> list[Sample]:
        held.extend(s for s in samples if not isinstance(s, AhrsSample))
        out: list[Sample] = [s for s in samples if isinstance(s, AhrsSample)]
        if t_us % 200_000 == 0:
            out += reversed(held)
            held.clear()
        return out

    track = fly(make(), World(tank_jet), 12.0, bundle).after(4.0)
    assert rms(track.pos_error()[:, :2]) < 0.015
    assert track.nav[-1].reset_count == 0


def test_samples_from_the_future_and_the_far_past_are_dropped(make: Make) -> None:
    def shift(t_us: int, samples: list[Sample]) -> list[Sample]:
        extra: list[Sample] = []
        for s in samples:
            if isinstance(s, PoseSample):
                extra.append(replace(s, t_us=s.t_us + 500_000, pos_ned_m=s.pos_ned_m + 1.0))
                extra.append(replace(s, t_us=s.t_us - 2_000_001, pos_ned_m=s.pos_ned_m + 1.0))
            elif isinstance(s, AhrsSample):
                extra.append(replace(s, t_us=s.t_us + 500_000))
        return extra + samples

    estimator = make()
    track = fly(estimator, World(tank_jet), 5.0, shift)
    assert rms(track.after(3.0).pos_error()) < 0.015
    counts = estimator.counters()
    assert counts["markers.future"] > 100
    assert counts["ahrs.future"] > 400
    assert counts["markers.late"] > 50


def test_clock_that_stands_still_or_goes_back(make: Make) -> None:
    estimator = make()
    track = fly(estimator, World(no_current), 1.0)
    last = track.nav[-1]
    assert estimator.step(last.t_us, (), ZERO) is last
    assert estimator.step(last.t_us - 500_000, (), ZERO) is last
    assert estimator.counters()["clock.backwards"] == 2


@pytest.mark.parametrize("latency_us", [0, 200_000])
def test_any_latency_of_vision(make: Make, latency_us: int) -> None:
    track = fly(make(), World(tank_jet, Faults(latency_us=latency_us)), 8.0).after(3.0)
    assert rms(track.pos_error()[:, :2]) < 0.015


def test_stuck_ahrs_is_noticed_and_survived(make: Make) -> None:
    """The AHRS repeats itself for three seconds while vision goes on."""
    estimator = make()
    track = fly(estimator, World(tank_jet, Faults(ahrs_stuck_s=(6.0, 9.0))), 14.0)
    assert_finite(track)
    assert estimator.counters()["ahrs.stuck"] > 200
    assert estimator.counters()["ahrs.blind_steps"] > 100
    during = track.after(6.5, 9.0)
    assert all(nav.health is NavHealth.DEAD_RECKONING for nav in during.nav)
    assert rms(during.pos_error()[:, :2]) < 0.08
    after = track.after(11.0)
    assert all(nav.health is NavHealth.GOOD for nav in after.nav)
    assert rms(after.pos_error()[:, :2]) < 0.02


def test_ahrs_dropouts(make: Make) -> None:
    """One AHRS sample in three is lost."""

    def drop(t_us: int, samples: list[Sample]) -> list[Sample]:
        return [s for s in samples if not (isinstance(s, AhrsSample) and (t_us // 10_000) % 3 == 0)]

    track = fly(make(), World(tank_jet), 8.0, drop).after(3.0)
    assert rms(track.pos_error()[:, :2]) < 0.015
    assert all(nav.health is NavHealth.GOOD for nav in track.nav)


def test_outliers_are_rejected(make: Make) -> None:
    estimator = make()
    track = fly(estimator, World(tank_jet, Faults(outliers=0.2)), 20.0).after(4.0)
    assert rms(track.pos_error()[:, :2]) < 0.015
    assert np.abs(track.pos_error()[:, :2]).max() < 0.05
    assert estimator.counters()["markers.rejected"] > 80
    assert track.nav[-1].reset_count == 0


def test_gap_is_flagged_and_left_again(make: Make) -> None:
    track = fly(make(), World(tank_jet, Faults(vision_gap_s=(5.0, 12.0))), 15.0)
    assert_finite(track)
    assert track.after(4.0, 5.9).nav[-1].health is NavHealth.GOOD
    assert {n.health for n in track.after(6.2, 9.0).nav} <= {NavHealth.DEAD_RECKONING, NavHealth.INVALID}
    assert track.after(6.2, 6.5).nav[0].health is NavHealth.DEAD_RECKONING
    assert track.after(11.0, 12.0).nav[-1].health is NavHealth.INVALID
    assert all(n.health is NavHealth.GOOD for n in track.after(13.5).nav)
    assert rms(track.after(13.5).pos_error()[:, :2]) < 0.03


def test_believes_a_consistent_shift_after_a_while(make: Make) -> None:
    """Kidnap: all fixes lie half a metre off, in agreement. The estimate moves there within a second."""
    estimator = make()
    track = fly(estimator, World(no_current, Faults(shift_s=6.0)), 9.0)
    shift = np.array([0.5, 0.0, 0.0])
    assert rms(track.after(7.1).pos_error() - shift) < 0.03
    assert track.nav[-1].reset_count == 1
    assert estimator.counters()["resets"] == 1
    assert rms(track.after(4.0, 6.0).pos_error()) < 0.015


def test_found_again_by_rare_fixes(make: Make) -> None:
    """Carried away during a gap, and then only five fixes per second: back within a second and a half."""

    class Carried(World):
        def _look(self, t: float) -> None:
            if t < 3.0 or (t > 9.0 and (self.t_us // 10_000) % 20 == 0):
                super()._look(t)

    world = Carried(no_current)
    estimator = make()
    nav = None
    for truth, samples, command in world.run(11.0):
        if truth.t_us == 6_000_000:
            world.n, world.e = 1.0, 1.0
        nav = estimator.step(truth.t_us, samples, command)
    assert nav is not None and nav.health is NavHealth.GOOD and nav.reset_count == 1
    assert np.abs(nav.pos_ned_m - truth.pos).max() < 0.05


def test_pause_of_the_whole_service(make: Make) -> None:
    """Nothing is called for eight seconds: the estimator goes on, says that it is lost, and finds back."""
    estimator, world = make(), World(uniform_current)
    for truth, samples, command in world.run(20.0):
        if 4.0 < truth.t_us * 1e-6 < 12.0:
            continue
        nav = estimator.step(truth.t_us, samples, command)
        if abs(truth.t_us * 1e-6 - 12.0) < 0.005:
            assert nav is not None and nav.health is not NavHealth.GOOD
    assert nav is not None and nav.health is NavHealth.GOOD
    assert np.abs(nav.pos_ned_m - truth.pos).max() < 0.03


def test_deterministic(make: Make) -> None:
    faults = Faults(laser=True, outliers=0.1, jitter_us=20_000)
    runs = [fly(make(), World(tank_jet, faults), 4.0) for _ in range(2)]
    for a, b in zip(runs[0].nav, runs[1].nav, strict=True):
        assert a.health == b.health
        for name in ("pos_ned_m", "rpy_rad", "vel_frd_m_s", "vel_water_frd_m_s", "current_ned_m_s", "variance"):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name))


def test_sightings_without_a_map_are_ignored(make: Make) -> None:
    sighting = MarkerSighting(t_us=5_000, ids=(3,), corners_px=np.zeros((1, 4, 2)), laser_px=None)
    estimator = make()
    for k in range(1, 50):
        assert estimator.step(k * 10_000, (replace(sighting, t_us=k * 10_000 - 5_000),), ZERO) is None
