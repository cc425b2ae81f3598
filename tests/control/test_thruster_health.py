"""Effectiveness of thrusters from the motion: identification on model data, no false alarms, what is left to do."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from control_loop import rk4
from hypothesis import given
from hypothesis import strategies as st

from autopilot.analysis.nmpc_flight import estimate_of
from autopilot.control.thrust.allocation import Allocation
from autopilot.control.thrust.filtered_motion import Waves
from autopilot.control.thrust.thruster_health import ThrusterHealth, configured_effectiveness, hover_problem, usable
from autopilot.core.control_allocator import ControlAllocator
from autopilot.core.frames import FloatArray
from autopilot.core.messages import NavHealth, NavState
from autopilot.core.model4 import Model4
from autopilot.core.params import ParamSet
from autopilot.core.response import Response
from autopilot.core.vehicle import load_vehicle

VEHICLE = load_vehicle("lbv150")
MODEL = VEHICLE.to_model()
LAG_S = VEHICLE.drive.time_constant_s
CURRENT = np.array([0.15, -0.1, 0.0])
FAULT_S = 15.0


def _thrust(t_s: float) -> FloatArray:
    """Cruise with turns, side steps and depth changes, as missions have them."""
    surge, turn = 3.0 * math.sin(1.0 * t_s), 1.2 * math.sin(1.8 * t_s)
    heave = 0.6 + (3.0 if math.sin(1.6 * t_s) > 0.0 else -3.0)
    return np.array([surge + turn, surge - turn, heave, 5.0 * math.sin(1.4 * t_s)])


def _fly(
    plant: Model4,
    gain: FloatArray,
    *,
    seconds: float = 45.0,
    pull_ned_n: FloatArray | None = None,
    heave: bool = True,
) -> tuple[ThrusterHealth, float | None]:
    """The estimator beside a plant that thrusts with ``gain`` from FAULT_S on; when it first declared something."""
    rng = np.random.default_rng(1)
    health = ThrusterHealth(MODEL, Response([LAG_S] * 4))
    x, acting, dt = np.zeros(8), np.zeros(4), 0.05
    first: float | None = None
    for tick in range(round(seconds / dt)):
        t_s = tick * dt
        thrust = _thrust(t_s)
        if not heave:
            thrust[2] = plant.buoyancy_excess_n
        acting += (1.0 - math.exp(-dt / LAG_S)) * (thrust - acting)
        x = rk4(plant, x, acting * (gain if t_s >= FAULT_S else 1.0), lambda _: CURRENT, dt)
        if pull_ned_n is not None:
            c, s = math.cos(x[3]), math.sin(x[3])
            north, east, down = pull_ned_n
            pull = np.array([c * north + s * east, c * east - s * north, down])
            x[4:7] += dt * pull / np.array(plant.mass_kg[:3])
        changed = health.step(round((tick + 1) * dt * 1e6), _nav(x, rng, tick * dt), thrust)
        if changed and first is None:
            first = t_s
    return health, first


def _nav(x: FloatArray, rng: np.random.Generator, t_s: float, **changes: object) -> NavState:
    """The estimate: noisy, and its current wanders."""
    c, s = math.cos(x[3]), math.sin(x[3])
    ground = np.array([x[4] + c * CURRENT[0] + s * CURRENT[1], x[5] + c * CURRENT[1] - s * CURRENT[0], x[6]])
    wandering = CURRENT + np.array([0.03 * math.sin(0.2 * t_s), 0.03 * math.cos(0.3 * t_s), 0.0])
    seen: dict[str, object] = {
        "vel_frd_m_s": ground + rng.normal(0.0, 0.004, 3),
        "rate_frd_rad_s": np.array([0.0, 0.0, x[7] + rng.normal(0.0, 0.006)]),
    }
    nav = estimate_of(round(t_s * 1e6), x.copy(), current_ned_m_s=wandering)
    return replace(nav, **{**seen, **changes})  # type: ignore[arg-type]


@pytest.mark.parametrize("thruster", range(4))
def test_half_a_thruster_is_found_and_measured(thruster: int) -> None:
    gain = np.ones(4)
    gain[thruster] = 0.5
    health, first = _fly(MODEL, gain)
    assert first is not None
    assert FAULT_S < first < FAULT_S + 25.0
    assert health.faulty == tuple(i == thruster for i in range(4))
    assert health.found[thruster] == pytest.approx(0.5, abs=0.15)
    assert abs(health.effectiveness[thruster] - 0.5) < 2.0 * health.sigma[thruster]


def test_a_dead_thruster_is_found_and_not_used() -> None:
    health, first = _fly(MODEL, np.array([1.0, 0.0, 1.0, 1.0]))
    assert first is not None
    assert first < FAULT_S + 10.0
    assert health.faulty == (False, True, False, False)
    assert health.found[1] < 0.35
    assert usable(np.array([1.0, 0.05, 0.5, 0.0])).tolist() == [1.0, 0.0, 0.5, 0.0]


@pytest.mark.parametrize(("mass", "drag", "thrust"), [(1.2, 1.3, 0.9), (0.8, 0.7, 1.1)])
def test_errors_of_mass_drag_and_thrust_are_no_loss(mass: float, drag: float, thrust: float) -> None:
    plant = Model4(
        mass_kg=tuple(mass * m for m in MODEL.mass_kg),  # type: ignore[arg-type]
        linear_drag=tuple(drag * d for d in MODEL.linear_drag),  # type: ignore[arg-type]
        quadratic_drag=tuple(drag * d for d in MODEL.quadratic_drag),  # type: ignore[arg-type]
        buoyancy_excess_n=MODEL.buoyancy_excess_n,
        allocation=tuple((thrust * a, thrust * b, thrust * c, thrust * d) for a, b, c, d in MODEL.allocation),
    )
    health, first = _fly(plant, np.ones(4))
    assert first is None
    assert health.found.tolist() == [1.0] * 4


@pytest.mark.parametrize(("surge", "sway", "pull_ned_n"), [(1.2, 0.8, (1.5, 0.0, 1.2)), (0.8, 1.2, (-1.0, 1.1, -1.2))])
def test_a_tether_that_pulls_and_a_wrong_munk_moment_are_no_loss(
    surge: float, sway: float, pull_ned_n: tuple[float, float, float]
) -> None:
    m11, m22, m33, m44 = MODEL.mass_kg
    plant = replace(MODEL, mass_kg=(surge * m11, sway * m22, m33, m44))
    pull = np.array(pull_ned_n)
    health, first = _fly(plant, np.ones(4), pull_ned_n=pull)
    assert first is None
    assert health.found.tolist() == [1.0] * 4


def test_a_thruster_that_comes_back_is_sound_again() -> None:
    health, _ = _fly(MODEL, np.array([0.5, 1.0, 1.0, 1.0]), seconds=32.0)
    assert health.faulty[0]
    rng, x, acting = np.random.default_rng(2), np.zeros(8), np.zeros(4)
    health.pause()
    for tick in range(1400):
        thrust = _thrust(tick * 0.05)
        acting += (1.0 - math.exp(-0.05 / LAG_S)) * (thrust - acting)
        x = rk4(MODEL, x, acting, lambda _: CURRENT, 0.05)
        health.step(32_000_000 + (tick + 1) * 50_000, _nav(x, rng, tick * 0.05), thrust)
    assert health.found.tolist() == [1.0] * 4


def test_without_a_good_estimate_and_at_rest_nothing_is_concluded() -> None:
    health, rng = ThrusterHealth(MODEL, Response([LAG_S] * 4)), np.random.default_rng(1)
    for tick in range(1000):
        nav = _nav(np.zeros(8), rng, 0.0, health=NavHealth.DEAD_RECKONING)
        assert not health.step(tick * 20_000, nav, np.full(4, 5.0))
    assert health.effectiveness.tolist() == [1.0] * 4
    # A thruster that is never asked says nothing about itself.
    for tick in range(1000, 3000):
        health.step(tick * 20_000, _nav(np.zeros(8), rng, 0.0), np.zeros(4))
    assert health.faulty == (False,) * 4
    assert (health.sigma >= 0.15).all()
    assert health.seen == (False,) * 4


def test_a_vertical_thruster_that_only_holds_the_buoyancy_is_said_not_to_be_seen() -> None:
    health, first = _fly(MODEL, np.array([1.0, 1.0, 0.5, 1.0]), seconds=40.0, heave=False)
    assert first is None
    assert health.seen == (True, True, False, True)
    assert health.sigma[2] > 0.2
    health, first = _fly(MODEL, np.array([1.0, 1.0, 0.5, 1.0]), seconds=40.0)
    assert first is not None
    assert health.seen[2]


def test_told_values_and_compensated_pulses() -> None:
    assert configured_effectiveness(ParamSet({"THR2_HEALTH": 0.4}), 4) == [1.0, 0.4, 1.0, 1.0]
    allocation = Allocation(VEHICLE.thrusters)
    share = np.array([0.5, 1.0, 0.5, 0.0])
    pulses = allocation.pulses_us([3.0, 3.0, -11.0, 4.0], 19.0, share)
    given = share * allocation.thrusts_n(pulses, 19.0)
    assert given[:2] == pytest.approx([3.0, 3.0], abs=0.1)
    assert given[2] == pytest.approx(-6.0, abs=0.15)
    assert pulses[3] == VEHICLE.drive.neutral_us


def test_what_is_left_of_the_vehicle() -> None:
    full, still, flow = np.full(4, 12.0), np.zeros(3), np.array([0.25, 0.0, 0.0])
    assert hover_problem(ControlAllocator(MODEL), full, flow) == ""
    assert hover_problem(ControlAllocator(MODEL), full * [1, 1, 0, 1], still) == "depth cannot be held"
    assert hover_problem(ControlAllocator(MODEL), full * [0, 0, 1, 1], still) == "heading cannot be held"
    # With one horizontal thruster the vehicle stays beam on to the current, not bow on.
    assert hover_problem(ControlAllocator(MODEL), full * [0, 1, 1, 1], flow) == ""
    assert hover_problem(ControlAllocator(MODEL), full * [0, 1, 1, 1], flow, math.pi / 2) == ""
    assert "at this heading" in hover_problem(ControlAllocator(MODEL), full * [0, 1, 1, 1], flow, 0.0)
    # Without the lateral one it is the other way round, and with neither nothing is left.
    assert hover_problem(ControlAllocator(MODEL), full * [1, 1, 1, 0], flow, math.pi) == ""
    assert "0.25 m/s" in hover_problem(ControlAllocator(MODEL), full * [0, 1, 1, 0], flow)


def _waves_m_s2(current_m_s: Callable[[float], float], course_rad: float) -> float:
    """Of a current (m/s at a time [s]) along this course, after 40 s."""
    waves, towards = Waves(), np.array([math.cos(course_rad), math.sin(course_rad), 0.0])
    for update in range(400):
        waves.update(0.1, current_m_s(0.1 * update) * towards)
    return waves.rms_m_s2


@given(st.floats(-math.pi, math.pi), st.floats(0.02, 0.3), st.floats(2.0, 6.0), st.floats(-0.4, 0.4))
def test_water_that_goes_to_and_fro_is_measured(
    course_rad: float, speed_m_s: float, period_s: float, mean_m_s: float
) -> None:
    """By the stronger of both axes, whatever the mean."""
    omega = 2.0 * math.pi / period_s
    measured = _waves_m_s2(lambda t_s: mean_m_s + speed_m_s * math.sin(omega * t_s), course_rad)
    along = max(abs(math.cos(course_rad)), abs(math.sin(course_rad)))
    assert 0.65 < measured / (along * speed_m_s * omega / math.sqrt(2.0)) < 1.15


@given(st.floats(-math.pi, math.pi), st.floats(-0.4, 0.4), st.floats(0.0, 20.0))
def test_water_that_starts_to_flow_is_no_wave(course_rad: float, speed_m_s: float, ramp_s: float) -> None:
    ramp = _waves_m_s2(lambda t_s: speed_m_s * min(1.0, max(0.0, t_s - 5.0) / max(ramp_s, 0.1)), course_rad)
    assert ramp < 1e-6
