"""The controller on vehicles with other thrusters: more of them, anywhere, in any order, one of them lost."""

import math

import numpy as np
import pytest
from control_loop import STEP_US, Flight, fly, goal, nav_state, rk4, still
from vehicles import LBV150, bluerov2, drawn, vehicle_with

from autopilot.control.controller import MotionController
from autopilot.control.nmpc import ocp
from autopilot.control.nmpc.grid import uniform_grid
from autopilot.control.nmpc.native import NativeStep
from autopilot.control.nmpc.solver import QpStep, passes_self_test
from autopilot.control.robust.fallback import station_keeping_thrust
from autopilot.core.frames import FloatArray
from autopilot.core.geometry import Fence
from autopilot.core.messages import Fallback
from autopilot.core.params import ParamSet
from autopilot.core.sharing import Sharing
from autopilot.core.vehicle import Vehicle

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


@pytest.mark.parametrize("thrusters", [4, 5, 7, 8])
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
    model, sharing, limit = vehicle.to_model(), Sharing.of(vehicle), np.full(8, 12.0)
    limit[2] = 0.0
    x, held, flow = np.array([0.5, -0.3, 1.0, 0.6, 0.0, 0.0, 0.0, 0.0]), np.zeros(8), np.array([0.1, -0.1, 0.0])
    held[2] = 1.2
    for _ in range(800):
        thrust = station_keeping_thrust(sharing, x, held, flow, limit)
        assert (np.abs(thrust) <= limit).all()
        x = rk4(model, x, thrust, slow_flow, 0.05)
    assert np.linalg.norm(x[:3] - held[:3]) < 0.02 and abs(x[3]) < 0.02
