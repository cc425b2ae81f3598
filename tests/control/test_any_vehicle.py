"""The controller on vehicles with other thrusters: more of them, anywhere, in any order, one of them lost."""

import math
from dataclasses import replace

import casadi as ca
import msgspec
import numpy as np
import pytest
from control_loop import STEP_US, Flight, fly, goal, nav_state, rk4, still
from vehicles import BLUEROV2_HULL, LBV150, bluerov2, drawn, vectored, vehicle_with

from autopilot.control.controller import MotionController
from autopilot.control.energy.power import PowerModel
from autopilot.control.nmpc import ocp
from autopilot.control.nmpc.grid import uniform_grid
from autopilot.control.nmpc.solver import NativeStep, QpStep, passes_self_test
from autopilot.control.robust.fallback import station_keeping_thrust
from autopilot.control.thrust.thruster_health import ThrusterHealth
from autopilot.core.control_allocator import ControlAllocator
from autopilot.core.errors import ConfigError
from autopilot.core.frames import FloatArray
from autopilot.core.geometry import Fence
from autopilot.core.messages import Fallback
from autopilot.core.params import ParamSet
from autopilot.core.response import Response
from autopilot.core.vehicle import Vehicle
from autopilot.identify.prediction import CoefficientScale, model_of, predict

OPEN = Fence(depth_max_m=5.0)
GOALS = (goal(1.6, 0.8, 1.0, 1.0), goal(0.0, 0.0, 0.6, -0.6))
START = (0.0, 0.0, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0)


def slow_flow(_: FloatArray) -> FloatArray:
    return np.array([0.1, -0.1, 0.0])


def flown(vehicle: Vehicle, cost: int = 0) -> Flight:
    params = ParamSet({"DEPTH_MAX": 5.0, "MPC_COST": cost})
    controller = MotionController(vehicle, cpu_clock=lambda: 0.0)
    model = vehicle.to_model()
    return fly(controller, GOALS, START, fence=OPEN, params=params, current=slow_flow, model=model, limit_s=40.0)


def judge(flight: Flight, bound_n: float = 12.0) -> None:
    assert len(flight.reached_s) == len(GOALS)
    assert {output.status.fallback for output in flight.outputs} == {Fallback.NONE}
    assert float(np.abs(flight.thrust_n).max()) <= bound_n
    assert flight.planar_speed_m_s() <= 0.5


@pytest.mark.parametrize(("vehicle", "cost"), [(bluerov2(), 0), (bluerov2(), 1), (bluerov2(4), 0)])
def test_a_bluerov2_flies_to_goals_within_its_bounds(vehicle: Vehicle, cost: int) -> None:
    judge(flown(vehicle, cost))


@pytest.mark.parametrize("thrusters", [4, 5, 7])
def test_thrusters_anywhere_reach_goals_within_bounds(thrusters: int) -> None:
    judge(flown(drawn(np.random.default_rng(thrusters), thrusters)))


@pytest.mark.parametrize("vehicle", [LBV150, bluerov2()])
def test_the_order_of_thrusters_does_not_matter(vehicle: Vehicle) -> None:
    allocation = np.array(vehicle.to_model().allocation)
    order = np.random.default_rng(3).permutation(allocation.shape[1])
    hull = {name: getattr(vehicle.model4, name) for name in ("mass_kg", "linear_drag", "quadratic_drag")}
    other = vehicle_with(allocation[:, order], buoyancy_excess_n=vehicle.model4.buoyancy_excess_n, **hull)
    controllers, params = [MotionController(each, cpu_clock=lambda: 0.0) for each in (vehicle, other)], ParamSet()
    x, model = np.array(START), vehicle.to_model()
    for step in range(40):
        t_us = step * STEP_US
        plain, mixed = (c.step(t_us, nav_state(t_us, x), GOALS[0], OPEN, params).thrust_n for c in controllers)
        assert np.allclose(plain[order], mixed, atol=1e-3)
        x = rk4(model, x, plain, still, 0.05)
    assert float(np.abs(plain).max()) > 1.0


def test_solvers_find_what_other_means_find() -> None:
    rng, grid = np.random.default_rng(1), uniform_grid(10)
    for thrusters in (5, 6, 8):
        model = drawn(rng, thrusters).to_model()
        steps = (QpStep(model, grid, 8, ocp.HPIPM), QpStep(model, grid, 8, ocp.PIQP))
        assert all(passes_self_test(step, model, grid) for step in steps)
        try:
            native = NativeStep(model, grid, 8, ocp.NATIVE)
        except RuntimeError:
            continue  # no compiler here
        assert passes_self_test(native, model, grid)


@pytest.mark.parametrize("lost", [0, 5])
def test_a_lost_thruster_of_a_bluerov2_is_made_up_for(lost: int) -> None:
    vehicle, params = bluerov2(), ParamSet({"DEPTH_MAX": 5.0})
    model, controller = vehicle.to_model(), MotionController(vehicle, cpu_clock=lambda: 0.0)
    x, acting, limit = np.array(START), np.zeros(6), np.full(6, 12.0)
    reached_s = math.inf
    for step in range(400):
        t_us = step * STEP_US
        if step == 40:
            limit[lost] = 0.0
        output = controller.step(t_us, nav_state(t_us, x), GOALS[0], OPEN, params, limit)
        assert output.status.fallback is Fallback.NONE
        assert (np.abs(output.thrust_n) <= limit).all()
        for _ in range(5):
            acting = acting + (output.thrust_n - acting) * (1.0 - math.exp(-0.01 / 0.15))
            x = rk4(model, x, acting * (limit > 0.0), still, 0.01)
        if np.linalg.norm(x[:3] - GOALS[0].pos_ned_m) < 0.1:
            reached_s = min(reached_s, t_us * 1e-6)
    assert reached_s < 15.0
    # And it stays.
    assert np.linalg.norm(x[:3] - GOALS[0].pos_ned_m) < 0.05 and abs(x[3] - 1.0) < 0.05


def test_the_fallback_holds_a_heavy_with_a_lost_thruster() -> None:
    vehicle = bluerov2(4)
    model, allocator, limit = vehicle.to_model(), ControlAllocator.of(vehicle), np.full(8, 12.0)
    limit[2] = 0.0
    x, held, flow = np.array([0.5, -0.3, 1.0, 0.6, 0.0, 0.0, 0.0, 0.0]), np.zeros(8), np.array([0.1, -0.1, 0.0])
    held[2] = 1.2
    for _ in range(800):
        thrust = station_keeping_thrust(allocator, x, held, flow, limit)
        assert (np.abs(thrust) <= limit).all()
        x = rk4(model, x, thrust, slow_flow, 0.05)
    assert np.linalg.norm(x[:3] - held[:3]) < 0.02 and abs(x[3]) < 0.02


def test_a_vehicle_that_lacks_an_axis_is_refused_by_name() -> None:
    allocation = np.array(LBV150.to_model().allocation)
    with pytest.raises(ConfigError, match="vehicle made: no thrust in sway: no thruster pushes that way"):
        MotionController(vehicle_with(allocation[:, :3]))
    redundant_one = np.delete(vectored(2), [2, 3], axis=1)
    with pytest.raises(ConfigError, match="alone: it comes only with"):
        MotionController(vehicle_with(redundant_one))


def test_thrusters_with_limits_and_lags_of_their_own() -> None:
    vehicle = bluerov2()
    slow = msgspec.structs.replace(vehicle.drive, time_constant_s=0.3)
    tables = list(vehicle.thruster_tables)
    tables[1] = msgspec.structs.replace(tables[1], limit_n=4.0, drive=slow)
    tables[4] = msgspec.structs.replace(tables[4], limit_n=1.5)
    vehicle = msgspec.structs.replace(vehicle, thruster_tables=tuple(tables))
    limit = np.array([each.limit_n for each in vehicle.thrusters])
    lag = np.array([each.drive.time_constant_s for each in vehicle.thrusters])
    controller, model = MotionController(vehicle, cpu_clock=lambda: 0.0), vehicle.to_model()
    x, acting, params, last = np.array(START), np.zeros(6), ParamSet({"DEPTH_MAX": 5.0}), np.zeros(6)
    for step in range(300):
        t_us = step * STEP_US
        thrust = controller.step(t_us, nav_state(t_us, x), GOALS[0], OPEN, params).thrust_n
        assert (np.abs(thrust) <= limit).all()
        assert step == 0 or (np.abs(thrust - last) <= 4.5 * 0.05 * limit + 1e-9).all()
        last = thrust
        for _ in range(5):
            acting = acting + (thrust - acting) * (1.0 - np.exp(-0.01 / lag))
            x = rk4(model, x, acting, still, 0.01)
    assert np.linalg.norm(x[:3] - GOALS[0].pos_ned_m) < 0.05


def test_thrust_astern_costs_what_its_drive_says() -> None:
    vehicle = bluerov2()
    tables = list(vehicle.thruster_tables)
    tables[3] = msgspec.structs.replace(
        tables[3], drive=msgspec.structs.replace(vehicle.drive, power_w_n15=1.0, reverse_power_w_n15=1.45)
    )
    power = PowerModel.of(msgspec.structs.replace(vehicle, thruster_tables=tuple(tables)))
    ahead, astern = power.thrust_w(np.full(6, 4.0)), power.thrust_w(np.full(6, -4.0))
    assert ahead.tolist() == pytest.approx([9.6, 9.6, 9.6, 8.0, 9.6, 9.6], rel=1e-3)
    assert astern.tolist() == pytest.approx([9.6, 9.6, 9.6, 11.6, 9.6, 9.6], rel=1e-3)
    thrust = ca.SX.sym("thrust", 6)
    both = ca.Function("both", [thrust], [power.thrust_w(thrust), power.secant_over_tangent(thrust)])
    assert np.allclose(both(-4.0)[0].full().ravel(), astern) and (both(-4.0)[1].full() > 0.0).all()


@pytest.mark.parametrize("lost", [0, 2])
def test_a_lost_horizontal_thruster_of_a_bluerov2_is_found_in_any_order(lost: int) -> None:
    order = [4, 2, 0, 5, 3, 1]
    model = vehicle_with(vectored(2)[:, order], **BLUEROV2_HULL).to_model()
    at, rng = order.index(lost), np.random.default_rng(1)
    health = ThrusterHealth(model, Response([0.15] * 6))
    x, acting, dt = np.zeros(8), np.zeros(6), 0.05
    for tick in range(600):
        t_s = tick * dt
        ahead, aside, turn = 4.0 * math.sin(t_s), 4.0 * math.sin(1.4 * t_s), 0.4 * math.sin(1.8 * t_s)
        down = 2.0 + 4.0 * math.copysign(1.0, math.sin(1.6 * t_s))
        thrust = ControlAllocator(model).thrust_n(np.array([ahead, aside, down, turn]), np.full(6, 12.0))
        acting += (1.0 - math.exp(-dt / 0.15)) * (thrust - acting)
        gives = np.where(np.arange(6) == at, 0.1 if t_s >= 10.0 else 1.0, 1.0)
        x = rk4(model, x, acting * gives, still, dt)
        nav = nav_state(round((tick + 1) * dt * 1e6), x)
        rates = replace(nav, rate_frd_rad_s=nav.rate_frd_rad_s + np.array([0.0, 0.0, rng.normal(0.0, 0.006)]))
        health.step(nav.t_us, replace(rates, vel_frd_m_s=x[4:7] + rng.normal(0.0, 0.004, 3)), thrust)
        if t_s < 10.0:
            assert not any(health.faulty)
    assert health.faulty == tuple(i == at for i in range(6))
    assert health.found[at] < 0.35


def test_identification_predicts_with_any_thrusters() -> None:
    model, rng = bluerov2().to_model(), np.random.default_rng(2)
    values = CoefficientScale.of(model).base
    assert model_of(values, model).allocation == model.allocation
    values[13] = 0.02
    armed = model_of(values, model)
    assert np.allclose(
        np.array(armed.allocation)[3], np.array(model.allocation)[3] + 0.02 * np.array(model.allocation)[1]
    )
    x, thrusts = np.array(START), rng.normal(0.0, 3.0, (20, 6))
    told = np.hstack([thrusts, np.zeros((20, 4))])
    seen = predict(values, model, x, told, np.zeros(2), 0.05)
    for thrust in thrusts:
        x = rk4(armed, x, thrust, still, 0.05)
    assert np.allclose(seen[-1], x[[0, 1, 2, 3, 7]], atol=1e-9)
