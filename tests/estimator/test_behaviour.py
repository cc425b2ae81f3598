"""What the Kalman filter is for: late images, gaps, currents, a wrong model, a magnetic tank."""

import math

import numpy as np
import pytest
from conftest import Make
from truth import CurrentField, Faults, World, fly, no_current, rms, tank_jet, uniform_current

from estimator.options import EstimatorOptions


def test_latency_is_compensated(make_ekf: Make) -> None:
    """60 ms +- 20 ms cost almost nothing; with compensation off the same run is several times worse."""
    prompt = fly(make_ekf(), World(tank_jet, Faults(latency_us=0)), 15.0).after(4.0)
    late = fly(make_ekf(), World(tank_jet, Faults(jitter_us=20_000)), 15.0).after(4.0)
    naive_options = EstimatorOptions(compensate_latency=False)
    naive = fly(make_ekf(naive_options), World(tank_jet, Faults(jitter_us=20_000)), 15.0).after(4.0)
    assert rms(late.pos_error()) < 1.35 * rms(prompt.pos_error())
    assert math.degrees(rms(late.yaw_error())) < 0.2
    assert rms(naive.pos_error()) > 3.0 * rms(late.pos_error())
    assert rms(naive.yaw_error()) > 5.0 * rms(late.yaw_error())


@pytest.mark.parametrize(("gap_s", "limit_m"), [(1.0, 0.04), (2.0, 0.08), (5.0, 0.25)])
def test_drift_in_a_gap(make_ekf: Make, gap_s: float, limit_m: float) -> None:
    """Drift at the end of a vision gap, over seeds, and the covariance that covers it."""
    ends, covered = [], []
    for seed in range(4):
        world = World(tank_jet, Faults(seed=seed, vision_gap_s=(12.0, 12.0 + gap_s)))
        track = fly(make_ekf(), world, 12.0 + gap_s)
        error = track.pos_error()[-1, :2]
        ends.append(float(np.hypot(*error)))
        sigma = np.sqrt(track.nav[-1].variance[:2])
        covered.append(bool((np.abs(error) < 3.0 * sigma + 0.01).all()))
    assert np.sqrt(np.mean(np.square(ends))) < limit_m
    assert sum(covered) >= 3


def test_model_aid_is_what_carries_through_a_gap(make_ekf: Make) -> None:
    def drift(options: EstimatorOptions) -> float:
        ends = []
        for seed in range(3):
            track = fly(make_ekf(options), World(no_current, Faults(seed=seed, vision_gap_s=(8.0, 13.0))), 13.0)
            ends.append(float(np.hypot(*track.pos_error()[-1, :2])))
        return float(np.sqrt(np.mean(np.square(ends))))

    assert drift(EstimatorOptions(model_aid=False)) > 1.5 * drift(EstimatorOptions())


@pytest.mark.parametrize(
    ("field", "limit"), [(no_current, 0.03), (uniform_current, 0.03), (tank_jet, 0.035)], ids=["none", "uniform", "jet"]
)
def test_current_and_speed_through_the_water(make_ekf: Make, field: CurrentField, limit: float) -> None:
    track = fly(make_ekf(), World(field), 40.0).after(15.0)
    assert rms(track.current_error()[:, :2]) < limit
    assert rms(track.water_error()[:, :2]) < limit


def test_wrong_drag_and_a_tether_are_borne(make_ekf: Make) -> None:
    """20 % less drag than the model thinks and a constant pull: the current suffers, the position does not."""
    faults = Faults(drag_factor=0.8, mass_factor=1.1, tether_n=0.3)
    track = fly(make_ekf(), World(uniform_current, faults), 40.0).after(15.0)
    assert rms(track.pos_error()) < 0.008
    assert rms(track.current_error()[:, :2]) < 0.08


def test_magnetic_disturbance_stays_out_of_the_yaw(make_ekf: Make) -> None:
    faults = Faults(yaw_offset=math.radians(20.0), yaw_offset_swing=math.radians(10.0))
    track = fly(make_ekf(), World(tank_jet, faults), 25.0).after(5.0)
    assert math.degrees(rms(track.yaw_error())) < 0.3


def test_laser_carries_the_depth_when_vision_is_gone(make_ekf: Make) -> None:
    """The laser goes on while the pose is missing: depth stays good, with 30 % wrong ranges among them."""

    class LaserOnly(World):
        def _look(self, t: float) -> None:
            super()._look(t)
            if t > 8.0:
                kept = [p for p in self.pending if type(p[1]).__name__ != "PoseSample"]
                self.pending = kept

    def depth_error(laser: bool) -> float:
        track = fly(make_ekf(), LaserOnly(no_current, Faults(laser=laser)), 13.0)
        return float(np.abs(track.pos_error()[-200:, 2]).max())

    assert depth_error(True) < 0.03
    assert depth_error(False) > depth_error(True)
