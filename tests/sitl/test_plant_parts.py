"""Thrusters, battery and tether against closed forms."""

import math

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plant_helpers import NEUTRAL, VEHICLE, plant

from autopilot.core.errors import ConfigError
from autopilot.core.thrusters import ThrusterDrive, thrusters_of
from autopilot.sitl.battery import SimulatedBattery
from autopilot.sitl.simulated_waters import SimulatedWaters
from autopilot.sitl.tether import WATER_DENSITY_KG_M3, make_tether
from autopilot.sitl.thruster_models import Thrusters, duty_from_pwm, held

DRIVE = VEHICLE.drive


def steady_thrust_n(drive: ThrusterDrive, pwm_us: float, supply_v: float) -> float:
    return held(drive, pwm_us).at(supply_v)


@pytest.mark.parametrize("pwm_us", [0, 1500, 1525, 1526, 1474, 1475])
def test_no_thrust_without_pulses_and_inside_the_deadband(pwm_us: int) -> None:
    assert steady_thrust_n(DRIVE, pwm_us, 19.0) == 0.0


def test_thrust_jumps_at_the_edge_of_the_deadband() -> None:
    assert steady_thrust_n(DRIVE, 1527, 19.0) == pytest.approx(0.04005 * (19.0 * 27 / 400) ** 2)
    assert steady_thrust_n(DRIVE, 1473, 19.0) == pytest.approx(-0.03457 * (19.0 * 27 / 400) ** 2)


def test_thrust_is_stronger_forward_and_saturates_at_full_duty() -> None:
    assert steady_thrust_n(DRIVE, 1900, 19.0) == pytest.approx(14.458, abs=1e-3)
    assert steady_thrust_n(DRIVE, 1100, 19.0) == pytest.approx(-12.480, abs=1e-3)
    assert steady_thrust_n(DRIVE, 2300, 19.0) == steady_thrust_n(DRIVE, 1900, 19.0)
    assert steady_thrust_n(DRIVE, 700, 19.0) == steady_thrust_n(DRIVE, 1100, 19.0)


def test_pulses_count_in_whole_microseconds() -> None:
    assert duty_from_pwm(DRIVE, 1700.4) == duty_from_pwm(DRIVE, 1700) == 0.5
    assert duty_from_pwm(DRIVE, 1700.6) == duty_from_pwm(DRIVE, 1701)


@given(st.integers(1100, 1899), st.floats(10.0, 20.0))
def test_thrust_never_falls_with_the_pulse_and_grows_with_the_square_of_the_supply(pwm_us: int, volt: float) -> None:
    assert steady_thrust_n(DRIVE, pwm_us, volt) <= steady_thrust_n(DRIVE, pwm_us + 1, volt)
    doubled = steady_thrust_n(DRIVE, pwm_us, 2.0 * volt)
    assert doubled == pytest.approx(4.0 * steady_thrust_n(DRIVE, pwm_us, volt))


def test_thrust_follows_with_its_time_constant() -> None:
    thrusters = Thrusters(VEHICLE.thrusters)
    final = steady_thrust_n(DRIVE, 1800, 19.0)
    for _ in range(30):
        thrusters.step((1800, 1500, 1500, 1500), 19.0, 0.005)
    assert thrusters.thrust_n[0] == pytest.approx(final * (1.0 - math.exp(-0.15 / DRIVE.time_constant_s)), rel=1e-12)
    assert thrusters.thrust_n[1:] == [0.0, 0.0, 0.0]


@given(st.floats(0.001, 0.5))
def test_mean_thrust_of_a_step_is_the_integral_of_the_lag(dt_s: float) -> None:
    coarse, fine = Thrusters(VEHICLE.thrusters[:1]), Thrusters(VEHICLE.thrusters[:1])
    coarse.step((1700,), 19.0, dt_s)
    total = 0.0
    for _ in range(8):
        fine.step((1700,), 19.0, dt_s / 8)
        total += fine.mean_n[0] / 8
    assert coarse.thrust_n == pytest.approx(fine.thrust_n, rel=1e-9)
    assert coarse.mean_n[0] == pytest.approx(total, rel=1e-9)


def test_without_lag_thrust_is_there_at_once() -> None:
    quick = msgspec.structs.replace(VEHICLE.drive, time_constant_s=1e-9)
    thrusters = Thrusters(thrusters_of(VEHICLE.thruster_tables[:1], quick))
    thrusters.step((1700,), 19.0, 0.005)
    assert thrusters.thrust_n[0] == pytest.approx(steady_thrust_n(DRIVE, 1700, 19.0))
    still = plant(mismatch={"lag": 0.0})
    still.advance(5_000, (1700, 0, 0, 0))
    assert still.truth.thrust_n[0] == pytest.approx(steady_thrust_n(DRIVE, 1700, still.truth.voltage_v), rel=0.01)


def test_power_grows_with_thrust_to_the_power_of_one_and_a_half() -> None:
    thrusters = Thrusters(VEHICLE.thrusters[:2])
    thrusters.step((1900, 1100), 19.0, 10.0)
    forward, reverse = thrusters.thrust_n
    assert thrusters.power_w == pytest.approx(1.2 * (forward**1.5 + abs(reverse) ** 1.5))


def test_a_lost_thruster_gives_less_and_takes_the_same_power() -> None:
    hull, sound = plant(), plant()
    hull.set_thruster_loss("starboard", 0.5)
    for each in (hull, sound):
        each.advance(1_000_000, (1700, 1700, 1500, 1500))
    assert hull.truth.thrust_n[1] == pytest.approx(0.5 * sound.truth.thrust_n[1])
    assert hull.truth.thrust_n[0] == sound.truth.thrust_n[0]
    assert hull.truth.power_w == sound.truth.power_w
    assert hull.truth.rate_frd_rad_s[2] > 0.1
    with pytest.raises(ConfigError, match=r"thruster 'bow' does not exist; use one of port, starboard"):
        hull.set_thruster_loss("bow", 1.0)
    with pytest.raises(ValueError, match="not between 0 and 1"):
        hull.set_thruster_loss("port", 1.5)


def test_thrusters_push_where_they_sit() -> None:
    """Ratio of yaw to surge and of yaw to sway after the first step, from arms, masses and inertia."""
    hull = plant()
    hull.advance(5_000, (1800, 1300, 1500, 1500))
    port, starboard = hull.truth.thrust_n[:2]
    ratio = 0.12 * (port - starboard) / 0.30 / ((port + starboard) / 16.5)
    assert port > 0.0 > starboard
    assert hull.truth.rate_frd_rad_s[2] == pytest.approx(ratio * hull.truth.vel_frd_m_s[0], rel=1e-2)
    hull = plant()
    hull.advance(5_000, (1500, 1500, 1500, 1900))
    assert hull.truth.rate_frd_rad_s[2] == pytest.approx(0.02 / 0.30 * 22.0 * hull.truth.vel_frd_m_s[1], rel=1e-2)
    hull.advance(300_000, (1500, 1500, 1900, 1500))
    assert hull.truth.vel_frd_m_s[2] > 0.0


def test_voltage_sags_with_current_and_with_energy() -> None:
    table = VEHICLE.battery
    battery = SimulatedBattery(table)
    battery.load(100.0)
    volt = battery.voltage_v
    assert battery.current_a * volt == pytest.approx(100.0)
    assert volt == pytest.approx(table.open_circuit_v - battery.current_a * table.internal_resistance_ohm)
    while battery.remaining > 0.5:
        battery.step(100.0, 100.0, 10.0)
    battery.load(0.0)
    assert battery.voltage_v == pytest.approx(0.5 * (table.open_circuit_v + table.empty_v), rel=1e-3)
    lost = table.internal_resistance_ohm * (100.0 / 18.0) ** 2 / 100.0
    assert battery.used_j * (1.0 + lost) == pytest.approx(0.5 * table.capacity_j, rel=0.01)


def test_an_overload_does_not_break_the_battery() -> None:
    battery = SimulatedBattery(msgspec.structs.replace(VEHICLE.battery, internal_resistance_ohm=2.0))
    battery.step(1e4, 1e4, 1.0)
    assert battery.voltage_v == pytest.approx(9.5)


def test_an_empty_battery_turns_nothing() -> None:
    vehicle = msgspec.structs.replace(
        VEHICLE, battery=msgspec.structs.replace(VEHICLE.battery, capacity_j=200.0), hotel_power_w=100.0
    )
    hull = plant(vehicle)
    hull.advance(1_000_000, (1900, 1900, 1500, 1500))
    assert hull.truth.thrust_n[0] > 10.0
    hull.advance(5_000_000, (1900, 1900, 1500, 1500))
    assert hull.truth.energy_remaining == 0.0
    assert hull.truth.thrust_n[0] < 0.01


def test_energy_used_is_the_integral_of_the_power() -> None:
    hull = plant()
    hull.advance(10_000_000, NEUTRAL)
    assert hull.truth.energy_used_j == pytest.approx(10.0 * VEHICLE.hotel_power_w)
    hull.advance(12_000_000, (1800, 1800, 1500, 1500))
    before = hull.truth
    hull.advance(22_000_000, (1800, 1800, 1500, 1500))
    mean_power_w = 0.5 * (before.power_w + hull.truth.power_w)
    assert hull.truth.energy_used_j - before.energy_used_j == pytest.approx(10.0 * mean_power_w, rel=1e-3)
    assert hull.truth.current_a * hull.truth.voltage_v == pytest.approx(hull.truth.power_w, rel=1e-6)


def test_tether_pulls_towards_its_entry_and_drags_against_the_motion() -> None:
    tether = VEHICLE.tether
    force_ned_n = make_tether(tether, (1.0, 0.0, 0.0))
    pull = force_ned_n((4.0, 4.0, 0.0), (0.0, 0.0, 0.0))
    np.testing.assert_allclose(pull, [-0.6 * tether.pull_n, -0.8 * tether.pull_n, 0.0], atol=1e-12)
    both = force_ned_n((4.0, 4.0, 0.0), (0.0, 0.0, 0.5))
    drag = 0.5 * WATER_DENSITY_KG_M3 * tether.drag_coefficient * tether.diameter_m * tether.length_in_flow_m * 0.25
    assert drag == pytest.approx(1.7, abs=0.05)
    np.testing.assert_allclose(np.subtract(both, pull), [0.0, 0.0, -drag], atol=1e-12)
    assert force_ned_n((1.0, 0.0, 0.0), (0.0, 0.0, 0.0)) == (0.0, 0.0, 0.0)


def test_tether_slows_the_plant_down() -> None:
    free, tied = plant(), plant(world=SimulatedWaters(tether_entry_ned_m=(-2.0, 0.0, 50.0)))
    for hull in (free, tied):
        hull.advance(10_000_000, (1700, 1700, 1500, 1500))
    tether = VEHICLE.tether
    drag = 0.5 * WATER_DENSITY_KG_M3 * tether.drag_coefficient * tether.diameter_m * tether.length_in_flow_m
    thrust = float(tied.truth.thrust_n.sum()) - tether.pull_n
    speed = tied.truth.vel_frd_m_s[0]
    assert speed < free.truth.vel_frd_m_s[0]
    assert thrust == pytest.approx(4.0 * speed + (30.0 + drag) * speed * speed, rel=0.02)
