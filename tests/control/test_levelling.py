"""Levelling on the plant: pushing ahead tilts a heavy frame over; the inner loop holds it and leaves the axes alone."""

import math
from collections.abc import Callable
from dataclasses import replace

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from autopilot.control.thrust.actuation import Actuation
from autopilot.control.thrust.attitude_stabilisation import AttitudeStabilizer
from autopilot.control.thrust.thrust_tuning import ATTITUDE_STABILISATION
from autopilot.core.control_allocator import ControlAllocator
from autopilot.core.frames import FloatArray, r_ned_from_frd
from autopilot.core.messages import NavState
from autopilot.core.params import ParamSet
from autopilot.core.thrusters import wrench_matrix
from autopilot.core.vehicle import Vehicle, load_vehicle
from autopilot.sitl.plant import Plant, Truth
from autopilot.sitl.simulated_waters import SimulatedWaters
from tests.bench.energy.flight import nav_state

HEAVY = load_vehicle("bluerov2-heavy")
TICK_US = 10_000


def without(vehicle: Vehicle) -> Vehicle:
    return msgspec.structs.replace(vehicle, levelling=None)


BOTH = (load_vehicle("bluerov2"), without(load_vehicle("bluerov2")))


def nav_of(truth: Truth) -> NavState:
    return replace(nav_state(truth), variance=np.full(12, 1e-4))


def tilts(vehicle: Vehicle, force: FloatArray, seconds: float = 12.0, lost: int | None = None) -> tuple[float, Truth]:
    """Largest tilt [rad] after the first two seconds with a steady force X, Y, Z [N], N [N m], by way of the pulses."""
    params = ParamSet() if lost is None else ParamSet({f"THR{lost + 1}_HEALTH": 0.0})
    actuation = Actuation(vehicle, params)
    plant = Plant(vehicle, SimulatedWaters(), start_pos_ned_m=(0.0, 0.0, 20.0), start_rpy_rad=(0.1, -0.1, 0.0))
    if lost is not None:
        plant.set_thruster_loss(vehicle.thrusters[lost].name, 1.0)
    most, allocator, thrust = 0.0, ControlAllocator.of(vehicle), np.zeros(len(vehicle.thrusters))
    for tick in range(round(seconds * 1e6 / TICK_US)):
        t_us, truth = tick * TICK_US, plant.truth
        nav = nav_of(truth)
        actuation.learn(t_us, nav, actuation.send(t_us), None, armed=True, reached=True)
        thrust = allocator.thrust_n(force, actuation.limit_n) if tick % 5 == 0 else thrust
        command = actuation.command(t_us, thrust, armed=True)
        plant.advance(t_us + TICK_US, command.pwm_us[: len(vehicle.thrusters)])
        if t_us > 2_000_000:
            most = max(most, float(np.abs(truth.rpy_rad[:2]).max()))
    return most, plant.truth


AHEAD = np.array([25.0, 0.0, 1.0, 0.0])


def test_a_heavy_pushed_ahead_tilts_over_without_it_and_stays_level_with_it() -> None:
    tilted, wild = tilts(without(HEAVY), AHEAD)
    level, straight = tilts(HEAVY, AHEAD)
    assert tilted > math.radians(40.0)
    assert level < math.radians(6.0)
    assert straight.vel_frd_m_s[0] > 0.3
    assert np.linalg.norm(straight.pos_ned_m[:2]) > np.linalg.norm(wild.pos_ned_m[:2])


def test_pushed_aside_and_turning_with_a_vertical_thruster_lost() -> None:
    level, _ = tilts(HEAVY, np.array([0.0, 15.0, 1.0, 1.0]), seconds=8.0, lost=4)
    assert level < math.radians(12.0)


@given(st.integers(0, 10_000))
@settings(max_examples=50)
def test_the_axes_are_left_alone_and_the_reserve_is_enough(seed: int) -> None:
    rng, vehicle = np.random.default_rng(seed), HEAVY
    loop = AttitudeStabilizer(vehicle)
    wrench = wrench_of(vehicle)
    limit = rng.uniform(5.0, 30.0, 8) * (np.arange(8) != rng.integers(4, 12))
    reserve = loop.reserve_n(limit)
    assert (
        (reserve >= 0.0).all()
        and (reserve <= ATTITUDE_STABILISATION.most * limit + 1e-12).all()
        and not reserve[:4].any()
    )
    wanted = rng.uniform(-1.0, 1.0, 8) * (limit - reserve)
    thrust = loop.thrust_n(wanted, limit, limit, np.zeros(3), rng.normal(size=3) * 0.5)
    assert (np.abs(thrust) <= limit + 1e-9).all()
    assert np.allclose(wrench[[0, 1, 2, 5]] @ (thrust - wanted), 0.0, atol=1e-9)


def wrench_of(vehicle: Vehicle) -> FloatArray:
    thrusters = vehicle.thrusters
    return np.array(wrench_matrix([t.position_frd_m for t in thrusters], [t.direction_frd for t in thrusters]))


def test_without_levelling_thrust_stays_as_it_is() -> None:
    loop, limit, wanted = AttitudeStabilizer(load_vehicle("lbv150")), np.full(4, 10.0), np.linspace(-3.0, 3.0, 4)
    turned = loop.thrust_n(wanted, limit, limit, np.array([0.0, 0.4, 0.0]), np.array([0.0, 0.3, 0.0]))
    assert np.array_equal(turned, wanted) and not loop.reserve_n(limit).any()


@given(st.integers(0, 10_000))
@settings(max_examples=100)
def test_a_tilt_that_swings_freely_is_damped_by_surge_alone_within_the_limit_and_turns_no_thruster(seed: int) -> None:
    rng, vehicle = np.random.default_rng(seed), load_vehicle("bluerov2")
    wanted, rates = rng.uniform(-12.0, 12.0, 6), np.array([0.0, rng.normal() * 0.5, 0.0])
    limit, loop, level = np.full(6, 12.0), AttitudeStabilizer(vehicle), np.zeros(3)
    more = loop.thrust_n(wanted, np.full(6, 30.0), limit, level, rates)
    more -= loop.thrust_n(wanted, np.full(6, 30.0), limit, level, np.zeros(3))
    _, y, z, roll, pitch, yaw = wrench_of(vehicle) @ more
    assert np.allclose((y, z, roll, yaw), 0.0, atol=1e-9)
    assert pitch * rates[1] <= 0.0
    assert (np.abs(wanted + more)[:4] <= 12.0 + 1e-9).all() and (wanted * (wanted + more) >= -1e-9)[:4].all()


@given(st.integers(0, 10_000))
@settings(max_examples=100)
def test_a_tilted_vehicle_is_pushed_as_a_level_one(seed: int) -> None:
    rng, vehicle = np.random.default_rng(seed), load_vehicle("bluerov2")
    tilt, limit, loop = rng.uniform(-0.5, 0.5, 3), np.full(6, 1e3), AttitudeStabilizer(vehicle)
    force, turned = np.array([*rng.normal(size=3) * 5.0, rng.normal()]), r_ned_from_frd(np.array([*tilt[:2], 0.0]))
    thrust = loop.thrust_n(ControlAllocator.of(vehicle).thrust_n(force, limit), limit, limit, tilt, np.zeros(3))
    pushed = wrench_of(vehicle) @ thrust
    assert np.allclose(turned @ pushed[:3], force[:3]) and pushed[5] == pytest.approx(force[3])


def test_a_bluerov2_that_goes_ahead_nose_up_keeps_its_depth() -> None:
    rose_m = [
        abs(float(tilts(vehicle, np.array([6.0, 0.0, 1.0, 0.0]), 12.0)[1].pos_ned_m[2]) - 20.0) for vehicle in BOTH
    ]
    assert rose_m[0] < 0.3 * rose_m[1], rose_m


def pitches(vehicle: Vehicle, ticks: int, surge_n: Callable[[int], float]) -> FloatArray:
    """Of a vehicle that is pushed ahead so, tick by tick."""
    actuation, allocator = Actuation(vehicle, ParamSet()), ControlAllocator.of(vehicle)
    plant, pitch = Plant(vehicle, SimulatedWaters(), start_pos_ned_m=(0.0, 0.0, 20.0)), []
    for tick in range(ticks):
        t_us, nav = tick * TICK_US, nav_of(plant.truth)
        actuation.learn(t_us, nav, actuation.send(t_us), None, armed=True, reached=True)
        ahead = allocator.thrust_n(np.array([surge_n(tick), 0.0, 1.0, 0.0]), actuation.limit_n)
        plant.advance(t_us + TICK_US, actuation.command(t_us, ahead, armed=True).pwm_us[:6])
        pitch.append(plant.truth.rpy_rad[1])
    return np.array(pitch)


def test_a_bluerov2_that_starts_ahead_hardly_swings_past_its_pitch() -> None:
    """By so much does its pitch go on beyond the steady one; the hull's own damping is 4 % of the critical one."""
    damped, free = (
        max(np.abs(pitch)) - abs(np.mean(pitch[-250:]))
        for pitch in (pitches(vehicle, 2000, lambda _: 6.0) for vehicle in BOTH)
    )
    assert damped < 0.25 * free and free > math.radians(3.0), (damped, free)


@pytest.mark.parametrize(("first_n", "then_n"), [(8.0, 2.0), (6.0, -6.0)])
def test_thrust_that_changes_in_step_with_the_swing_of_a_bluerov2_swings_it_less(first_n: float, then_n: float) -> None:
    """The worst that a controller can do, which does not know of pitch: its swing takes 2.2 s."""
    half, mean = 110, np.full(201, 1.0 / 201.0)
    damped, free = (
        float(np.std((pitch[100:-100] - np.convolve(pitch, mean, "valid"))[400:]))
        for pitch in (pitches(vehicle, 1600, lambda tick: then_n if tick // half % 2 else first_n) for vehicle in BOTH)
    )
    assert damped < 0.7 * free and free > math.radians(5.0), (damped, free)


@pytest.mark.parametrize("name", ["bluerov2", "bluerov2-heavy"])
def test_the_noise_of_rates_and_of_the_controller_turns_no_thruster_to_and_fro(name: str) -> None:
    """Two verticals share a weight of 1 N and level what a slow sway tilts: pulses changed sides six to eight times a
    second."""
    vehicle, rng, seconds = load_vehicle(name), np.random.default_rng(1), 12.0
    actuation, allocator = Actuation(vehicle, ParamSet()), ControlAllocator.of(vehicle)
    plant = Plant(vehicle, SimulatedWaters(), start_pos_ned_m=(0.0, 0.0, 20.0))
    count, pulses, most = len(vehicle.thrusters), [], np.zeros(2)
    for tick in range(round(100 * seconds)):
        t_us, nav = tick * TICK_US, nav_of(plant.truth)
        nav = replace(nav, rate_frd_rad_s=nav.rate_frd_rad_s + rng.normal(0.0, 0.008, 3))
        actuation.learn(t_us, nav, actuation.send(t_us), None, armed=True, reached=True)
        force = np.array([2.0, 2.0 * math.sin(0.006 * tick), 1.0 + math.sin(0.002 * tick), 0.0])
        wanted = allocator.thrust_n(force, actuation.limit_n) + rng.normal(0.0, 0.1, count)
        command = actuation.command(t_us, wanted, armed=True)
        plant.advance(t_us + TICK_US, command.pwm_us[:count])
        pulses.append(command.pwm_us[4:count])
        most = np.maximum(most, np.abs(plant.truth.rpy_rad[:2]))
    sides = [np.sign(column[column != 1500] - 1500.0) for column in np.array(pulses).T]
    assert max(np.count_nonzero(np.diff(side)) for side in sides) < 1.0 * seconds
    assert most[0] < math.radians(3.0)
