"""What failsafes go by: jolts that are collisions, sensors that freeze, tether and energy of a plan."""

import math

import numpy as np
import pytest

from autopilot.command.environment import CollisionDetector
from autopilot.command.vehicle_status import VehicleStatus
from autopilot.core.messages import Inputs
from autopilot.core.samples import AhrsSample, DepthSample, HullSample, PowerSample
from autopilot.core.vehicle import load_vehicle
from autopilot.run.outside import HandsBack, WeightRelease


def felt(accel: np.ndarray, thrust_n: np.ndarray | None = None) -> bool:
    """Whether 2 s of rest and then these accelerations ahead (n,) are a collision."""
    detector, found = CollisionDetector(load_vehicle("lbv150").to_model()), False
    for tick, ahead in enumerate([*np.zeros(200), *accel, *np.zeros(100)]):
        zero = np.zeros(3)
        sample = AhrsSample(
            t_us=tick * 10_000, rpy_rad=zero, rate_frd_rad_s=zero, accel_frd_m_s2=np.array([ahead, 0.0, -9.81])
        )
        found |= detector.update(sample, thrust_n, 3.0)
    return found


@pytest.mark.parametrize("size", [3.5, -6.0, 40.0])
@pytest.mark.parametrize("ticks", [1, 5, 20])
def test_a_push_that_comes_and_goes_is_a_collision(size: float, ticks: int) -> None:
    assert felt(np.full(ticks, size))


def test_what_stays_what_is_small_and_what_is_no_number_is_none() -> None:
    assert not felt(np.full(150, 10.0))
    assert not felt(np.full(5, 2.5))
    assert not felt(np.full(5, np.nan))


def test_what_thrust_can_make_is_none() -> None:
    assert not felt(np.full(5, 4.0), np.full(4, 50.0))


def test_a_frozen_depth_is_a_silent_sensor() -> None:
    status = VehicleStatus()
    for tick in range(60):
        depth_m = 1.0 + 1e-4 * min(tick, 20)
        status.note_sample(tick * 100_000, DepthSample(t_us=tick * 100_000, depth_m=depth_m, sigma_m=0.01))
    age_s, name = status.silent(5_900_000)
    assert name == "depth sensor" and age_s == pytest.approx(2.0, abs=0.15)


def power_age_s(status: VehicleStatus, amperes: np.ndarray, thrust_n: np.ndarray, period_us: int) -> float:
    """How long the monitor has been silent after these readings and commands of one thruster."""
    for number, (ampere, newton) in enumerate(zip(amperes.tolist(), thrust_n.tolist(), strict=True)):
        status.thrust_n, t_us = np.array([newton]), number * period_us
        sample = PowerSample(t_us=t_us, voltage_v=16.0, current_a=ampere, energy_used_j=t_us * 1e-4, remaining=0.9)
        status.note_sample(t_us, sample)
    return status.silent((len(amperes) - 1) * period_us)[0]


@pytest.mark.parametrize("flicker_a", [0.0, 0.01, 0.04])
@pytest.mark.parametrize("period_us", [100_000, 500_000])
def test_a_power_monitor_that_repeats_itself_while_the_thrust_changes_is_frozen(
    period_us: int, flicker_a: float
) -> None:
    """Nothing was told, and the battery ran down at the charge of before."""
    thrust_n = 6.0 + 5.0 * np.sin(np.arange(120) / 7.0)
    live_a = 0.6 + 0.07 * thrust_n**1.5
    frozen_a = np.where(np.arange(120) < 60, live_a, live_a[60] + flicker_a * (np.arange(120) % 2))
    assert power_age_s(VehicleStatus(), frozen_a, thrust_n, period_us) > 3.0
    assert power_age_s(VehicleStatus(), live_a, thrust_n, period_us) == 0.0
    steady_n = np.full(120, 6.0)
    assert power_age_s(VehicleStatus(), np.full(120, 1.6), steady_n, period_us) == 0.0, "at rest it repeats itself"
    assert power_age_s(VehicleStatus(), np.zeros(120), thrust_n, period_us) == 0.0, "it measures no current"


def test_a_power_monitor_that_has_rested_is_not_frozen_when_the_thrust_begins() -> None:
    thrust_n = np.where(np.arange(100) < 95, 0.0, 12.0)
    amperes = np.where(np.arange(100) < 97, 0.6, 3.5)
    assert power_age_s(VehicleStatus(), amperes, thrust_n, 500_000) == 0.0
    assert power_age_s(VehicleStatus(), amperes[:97], thrust_n[:97], 500_000) <= 1.0


def test_half_a_hull_sensor_is_a_fault_and_its_other_half_counts() -> None:
    status = VehicleStatus()
    status.note_sample(0, HullSample(t_us=0, pressure_pa=90_000.0, temperature_c=20.0))
    for tick in range(1, 40):
        t_us = tick * 100_000
        status.note_sample(t_us, HullSample(t_us=t_us, pressure_pa=95_000.0, temperature_c=math.nan))
    assert (status.hull_pa, status.hull_c) == (95_000.0, 20.0)
    age_s, name = status.silent(3_900_000)
    assert (name, status.how_silent(name)) == ("hull sensor", "implausible") and age_s == pytest.approx(3.9)


def test_late_ticks_are_a_share_of_the_last_second() -> None:
    status = VehicleStatus()
    status.note(Inputs(t_us=1_000_000, overruns=0))
    status.note(Inputs(t_us=2_000_000, overruns=30))
    assert status.late_fraction == pytest.approx(0.3)
    status.note(Inputs(t_us=3_000_000, overruns=30, clock_jump_s=0.4))
    assert status.late_fraction == 0.0 and not status.jumped_us >= 0.0
    status.note(Inputs(t_us=3_010_000, clock_jump_s=-3600.0))
    assert status.jumped_us == 3_010_000


def test_a_device_offers_effects_by_having_them() -> None:
    class Rov:
        def release_weight(self, t_us: int) -> None: ...

    assert isinstance(Rov(), WeightRelease) and not isinstance(Rov(), HandsBack)
