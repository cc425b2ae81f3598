"""The hull against closed forms."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plant_helpers import DEEP, NEUTRAL, NO_DRAG, VEHICLE, body_with, kinetic_energy_j, plant, terminal_speed

from autopilot.core.frames import r_ned_from_frd
from autopilot.sitl.current_fields import Shear, Uniform, Vortex
from autopilot.sitl.simulated_waters import SimulatedWaters
from autopilot.sitl.sitl_tuning import PLANT
from autopilot.sitl.thruster_models import wrench_of

BODY = VEHICLE.body
TRIMMED = body_with(buoyancy_excess_n=0.0)
INERTIA = np.array(BODY.inertia_kg_m2) + np.array(BODY.added_inertia_kg_m2)
MASS = BODY.mass_kg + np.array(BODY.added_mass_kg)
small = st.floats(-0.5, 0.5)
triples = st.tuples(small, small, small)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_terminal_speed_of_translation(axis: int) -> None:
    force = [0.0, 0.0, 0.0]
    force[axis] = 9.0
    hull = plant(TRIMMED)
    hull.set_external_wrench(force_frd_n=tuple(force))
    hull.advance(40_000_000, NEUTRAL)
    expected = np.zeros(3)
    expected[axis] = terminal_speed(9.0, BODY.linear_drag_n_s_m[axis], BODY.quadratic_drag_n_s2_m2[axis])
    np.testing.assert_allclose(hull.truth.vel_frd_m_s, expected, rtol=1e-9, atol=1e-9)


def test_terminal_yaw_rate() -> None:
    hull = plant(TRIMMED)
    hull.set_external_wrench(moment_frd_n_m=(0.0, 0.0, 1.5))
    hull.advance(10_000_000, NEUTRAL)
    expected = terminal_speed(1.5, BODY.angular_linear_drag_n_m_s[2], BODY.angular_quadratic_drag_n_m_s2[2])
    np.testing.assert_allclose(hull.truth.rate_frd_rad_s, [0.0, 0.0, expected], rtol=1e-9, atol=1e-9)


def test_terminal_speed_under_the_thrusters() -> None:
    hull = plant(TRIMMED)
    hull.advance(40_000_000, (1800, 1800, 1500, 1500))
    truth = hull.truth
    speed = terminal_speed(float(truth.thrust_n.sum()), BODY.linear_drag_n_s_m[0], BODY.quadratic_drag_n_s2_m2[0])
    assert truth.thrust_n[0] > 5.0
    np.testing.assert_allclose(truth.vel_frd_m_s, [speed, 0.0, 0.0], rtol=1e-4, atol=1e-9)


def test_untrimmed_hull_rises_at_its_terminal_speed_and_floats_on_the_surface() -> None:
    hull = plant(start_pos_ned_m=(0.0, 0.0, 5.0))
    hull.advance(30_000_000, NEUTRAL)
    speed = terminal_speed(BODY.buoyancy_excess_n, BODY.linear_drag_n_s_m[2], BODY.quadratic_drag_n_s2_m2[2])
    assert hull.truth.vel_frd_m_s[2] == pytest.approx(-speed, rel=1e-6)
    hull.advance(200_000_000, NEUTRAL)
    height = 2.0 * VEHICLE.hull_half_height_m
    emerged = height * BODY.buoyancy_excess_n / (BODY.weight_n + BODY.buoyancy_excess_n)
    assert hull.truth.emerged_m == pytest.approx(emerged, abs=1e-6)
    assert hull.truth.contact_count == 0


@pytest.mark.parametrize(("axis", "force"), [(0, 5.0), (1, -3.0), (2, 8.0)])
def test_a_force_accelerates_hull_and_added_mass(axis: int, force: float) -> None:
    hull = plant(TRIMMED)
    wrench = [0.0, 0.0, 0.0]
    wrench[axis] = force
    hull.set_external_wrench(force_frd_n=tuple(wrench))
    expected = np.array([0.0, 0.0, -PLANT.gravity_m_s2])
    expected[axis] += force / MASS[axis]
    np.testing.assert_allclose(hull.truth.accel_frd_m_s2, expected, atol=1e-12)
    hull.advance(5_000, NEUTRAL)
    assert hull.truth.vel_frd_m_s[axis] == pytest.approx(force / MASS[axis] * 0.005, rel=2e-3)


@pytest.mark.parametrize("axis", [0, 1])
def test_roll_and_pitch_swing_with_the_period_of_a_pendulum(axis: int) -> None:
    vehicle = body_with(buoyancy_excess_n=0.0, **NO_DRAG)
    tilt = [0.0, 0.0, 0.0]
    tilt[axis] = 0.02
    hull = plant(vehicle, start_rpy_rad=tilt)
    stiffness = BODY.weight_n * abs(BODY.center_of_buoyancy_frd_m[2])
    period = 2.0 * math.pi * math.sqrt(INERTIA[axis] / stiffness)
    crossings = []
    before = 0.02
    for k in range(1, round(3.2 * period / 0.005)):
        hull.advance(k * 5_000, NEUTRAL)
        now = hull.truth.rpy_rad[axis]
        if before < 0.0 <= now:
            crossings.append((k - now / (now - before)) * 0.005)
        before = now
    assert np.diff(crossings) == pytest.approx([period] * (len(crossings) - 1), rel=1e-4)
    assert len(crossings) == 3


def test_work_of_the_thrusters_becomes_kinetic_and_potential_energy_and_heat() -> None:
    hull = plant(start_rpy_rad=(0.1, -0.1, 0.3))
    wrench = np.array(wrench_of(VEHICLE)).T
    directions, arms = wrench[:, :3], wrench[:, 3:]

    def energy_and_power() -> tuple[float, float, float]:
        truth = hull.truth
        vel, rate = truth.vel_frd_m_s, truth.rate_frd_rad_s
        lift = BODY.weight_n + BODY.buoyancy_excess_n
        lever = (r_ned_from_frd(truth.rpy_rad) @ np.array(BODY.center_of_buoyancy_frd_m))[2]
        potential = -BODY.weight_n * truth.pos_ned_m[2] + lift * (truth.pos_ned_m[2] + lever)
        heat = np.dot(BODY.linear_drag_n_s_m, vel**2) + np.dot(BODY.quadratic_drag_n_s2_m2, np.abs(vel) ** 3)
        heat += np.dot(BODY.angular_linear_drag_n_m_s, rate**2)
        heat += np.dot(BODY.angular_quadratic_drag_n_m_s2, np.abs(rate) ** 3)
        pairs = zip(truth.thrust_n, directions, arms, strict=False)
        work = sum(thrust * (d @ vel + a @ rate) for thrust, d, a in pairs)
        return kinetic_energy_j(truth) + potential, float(work), float(heat)

    start, work, heat = energy_and_power()
    done = lost = 0.0
    for k in range(1, 2001):
        pulse = (1820, 1650, 1400, 1800) if k < 1000 else (1300, 1700, 1750, 1250)
        hull.advance(k * 5_000, pulse)
        now, new_work, new_heat = energy_and_power()
        done, lost = done + 0.0025 * (work + new_work), lost + 0.0025 * (heat + new_heat)
        work, heat = new_work, new_heat
    assert done > 10.0
    assert now - start == pytest.approx(done - lost, abs=1e-4 * done)


@settings(max_examples=25, deadline=None)
@given(vel=triples, rate=triples)
def test_coriolis_terms_do_no_work(vel: tuple[float, ...], rate: tuple[float, ...]) -> None:
    vehicle = body_with(buoyancy_excess_n=0.0, center_of_buoyancy_frd_m=(0.0, 0.0, 0.0), **NO_DRAG)
    hull = plant(vehicle, start_vel_frd_m_s=vel, start_rate_frd_rad_s=rate, start_rpy_rad=(0.2, 0.1, -1.0))
    before = kinetic_energy_j(hull.truth)
    hull.advance(500_000, NEUTRAL)
    assert kinetic_energy_j(hull.truth) == pytest.approx(before, rel=1e-7, abs=1e-12)
    assert np.linalg.norm(hull.truth.quat) == pytest.approx(1.0, abs=1e-14)


def test_munk_moment_turns_the_hull_broadside() -> None:
    hull = plant(TRIMMED, start_vel_frd_m_s=(0.5, 0.1, 0.0))
    hull.advance(5_000, NEUTRAL)
    moment = (BODY.added_mass_kg[0] - BODY.added_mass_kg[1]) * 0.5 * 0.1
    assert moment < 0.0
    assert hull.truth.rate_frd_rad_s[2] == pytest.approx(moment / INERTIA[2] * 0.005, rel=0.02)


@settings(max_examples=15, deadline=None)
@given(current=triples, rpy=triples)
def test_a_uniform_current_only_carries_the_hull_along(current: tuple[float, ...], rpy: tuple[float, ...]) -> None:
    flow = np.array(current)
    carried = plant(
        world=SimulatedWaters(current=Uniform(velocity_m_s=current)),
        start_rpy_rad=rpy,
        start_vel_frd_m_s=tuple(r_ned_from_frd(np.array(rpy)).T @ flow),
    )
    still = plant(start_rpy_rad=rpy)
    for hull in (carried, still):
        hull.advance(1_000_000, (1800, 1400, 1750, 1300))
    a, b = carried.truth, still.truth
    np.testing.assert_allclose(a.vel_water_frd_m_s, b.vel_frd_m_s, atol=1e-7)
    np.testing.assert_allclose(a.rate_frd_rad_s, b.rate_frd_rad_s, atol=1e-7)
    np.testing.assert_allclose(a.pos_ned_m, b.pos_ned_m + flow, atol=1e-7)
    np.testing.assert_allclose(a.accel_frd_m_s2, b.accel_frd_m_s2, atol=1e-8)


def test_a_free_hull_ends_up_drifting_with_the_current() -> None:
    flow = (0.2, -0.1, 0.0)
    hull = plant(TRIMMED, SimulatedWaters(current=Uniform(velocity_m_s=flow)), start_rpy_rad=(0.0, 0.0, 0.7))
    hull.advance(90_000_000, NEUTRAL)
    truth = hull.truth
    np.testing.assert_allclose(r_ned_from_frd(truth.rpy_rad) @ truth.vel_frd_m_s, flow, atol=1e-6)
    np.testing.assert_allclose(truth.vel_water_frd_m_s, 0.0, atol=1e-6)
    np.testing.assert_allclose(truth.current_ned_m_s, flow)


def test_a_neutral_hull_follows_a_streamline_only_with_the_pressure_of_the_water() -> None:
    radius = 3.0
    world = SimulatedWaters(current=Vortex(circulation_m2_s=6.0, core_m=2.0))
    speed = world.current.velocity((radius, 0.0, 50.0), 0.0)
    radii = {}
    for pressure in (True, False):
        hull = plant(
            TRIMMED,
            world,
            start_pos_ned_m=(radius, 0.0, 50.0),
            start_vel_frd_m_s=speed,
            froude_krylov=pressure,
        )
        hull.advance(30_000_000, NEUTRAL)
        radii[pressure] = math.hypot(*hull.truth.pos_ned_m[:2])
    assert radii[True] == pytest.approx(radius, abs=2e-3)
    assert radii[False] > radius + 0.3


def test_crossing_a_shear_flow_accelerates_the_added_mass() -> None:
    """At y = 0 the water is at rest and not accelerated; only M_A (v . grad) c acts on a hull without drag."""
    vehicle = body_with(buoyancy_excess_n=0.0, **NO_DRAG)
    hull = plant(vehicle, SimulatedWaters(current=Shear(shear_1_s=0.5)), start_vel_frd_m_s=(0.0, 0.4, 0.0))
    expected = BODY.added_mass_kg[0] * 0.5 * 0.4 / MASS[0]
    np.testing.assert_allclose(hull.truth.accel_frd_m_s2, [expected, 0.0, -PLANT.gravity_m_s2], atol=1e-12)


def test_a_changing_tide_drags_the_hull_along() -> None:
    """A neutral hull without drag takes part in the acceleration of uniform water: v_r stays 0."""
    vehicle = body_with(buoyancy_excess_n=0.0, **NO_DRAG)
    tide = Uniform(velocity_m_s=(0.0, 0.0, 0.0), tide_m_s=(0.3, 0.1, 0.0), tide_period_s=40.0)
    hull = plant(vehicle, SimulatedWaters(current=tide), start_rpy_rad=(0.0, 0.0, 1.0))
    hull.advance(10_000_000, NEUTRAL)
    np.testing.assert_allclose(hull.truth.current_ned_m_s, [0.3, 0.1, 0.0], atol=1e-12)
    np.testing.assert_allclose(hull.truth.vel_water_frd_m_s, 0.0, atol=3e-4)  # the rate is held within a step


def test_a_held_hull_stays_until_a_thruster_is_commanded() -> None:
    world = SimulatedWaters(current=Uniform(velocity_m_s=(0.2, 0.0, 0.0)))
    hull = plant(world=world, held=True)
    hull.advance(5_000_000, (0,) * 8)
    hull.advance(6_000_000, (1510, 1490, 1500, 1500))
    np.testing.assert_array_equal(hull.truth.pos_ned_m, DEEP)
    np.testing.assert_allclose(hull.truth.accel_frd_m_s2, [0.0, 0.0, -PLANT.gravity_m_s2], atol=1e-12)
    np.testing.assert_allclose(hull.truth.vel_water_frd_m_s, [-0.2, 0.0, 0.0], atol=1e-12)
    hull.advance(6_010_000, (1600, 1600, 1500, 1500))
    hull.advance(8_000_000, NEUTRAL)
    assert hull.truth.pos_ned_m[0] > 0.05


def test_same_inputs_same_outputs_whatever_the_length_of_the_calls() -> None:
    def fly(call_us: int) -> np.ndarray:
        hull = plant(
            world=SimulatedWaters(current=Vortex(circulation_m2_s=2.0, core_m=1.0)), start_rpy_rad=(0.1, 0.0, 0.5)
        )
        for t_us in range(call_us, 2_000_001, call_us):
            hull.advance(t_us, (1750, 1620, 1600, 1400))
        truth = hull.truth
        return np.concatenate([truth.pos_ned_m, truth.quat, truth.rate_frd_rad_s, [truth.energy_used_j]])

    np.testing.assert_array_equal(fly(10_000), fly(10_000))
    np.testing.assert_array_equal(fly(10_000), fly(500_000))
    np.testing.assert_allclose(fly(4_000), fly(10_000), rtol=3e-4, atol=1e-5)


def test_time_does_not_go_back() -> None:
    hull = plant()
    hull.advance(10_000, NEUTRAL)
    with pytest.raises(ValueError, match="before the present"):
        hull.advance(9_000, NEUTRAL)
