"""What every controller, estimator and plant keeps, shipped or an example of docs/extend.md."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from autopilot.analysis.nmpc_flight import estimate_of
from autopilot.control.current.currents import EstimatedCurrent
from autopilot.control.path.workers import BackgroundWorkers
from autopilot.control.protocol import Controller, ControllerContext, checked_output, create_controller
from autopilot.core.frames import FloatArray, wrap_pi
from autopilot.core.geometry import Circle, Fence, Polygon
from autopilot.core.messages import ControlOutput, Goal, NavHealth, NavState
from autopilot.core.model4 import rk4, state_derivative
from autopilot.core.params import ParamSet
from autopilot.core.vehicle import load_vehicle
from autopilot.estimator.create import create_estimator
from autopilot.sitl.backend import simulated_vehicle
from autopilot.sitl.plant import Truth
from autopilot.sitl.protocol import PlantContext, PlantLike, create_plant
from autopilot.sitl.scenario import load_scenario
from tests.control.control_loop import goal

VEHICLE = load_vehicle("lbv150")
MODEL = VEHICLE.to_model()
N = len(VEHICLE.thrusters)
LIMIT_N = np.full(N, 9.0)
TANK = Fence(
    inclusions=(Polygon(vertices_ned_m=np.array([[-2.5, -1.5], [2.5, -1.5], [2.5, 1.5], [-2.5, 1.5]])),),
    exclusions=(Circle(center_ned_m=np.array([0.0, 0.0]), radius_m=0.16),),
    depth_max_m=1.2,
)
"""A pillar stands on the straight line from START to GOAL."""
START = (-1.5, 0.05, 0.6, 0.4, 0.0, 0.0, 0.0, 0.0)
GOAL = goal(1.5, 0.0, 0.4, -0.5, speed_m_s=0.3)
CURRENT = np.array([0.05, -0.08, 0.0])


def nav_at(t_us: int, x: FloatArray, health: NavHealth = NavHealth.GOOD) -> NavState:
    c, s = math.cos(x[3]), math.sin(x[3])
    over_ground = x[4:7] + np.array([c * CURRENT[0] + s * CURRENT[1], c * CURRENT[1] - s * CURRENT[0], 0.0])
    said = estimate_of(t_us, x.copy(), current_ned_m_s=CURRENT, sigma=np.full(12, 1e-3))
    return replace(said, health=health, vel_frd_m_s=over_ground)


@pytest.fixture(params=["nmpc", "los-pid", "my_controller:Follower"])
def controller(request: pytest.FixtureRequest) -> Controller:
    return make_controller(request.param)


def make_controller(name: str) -> Controller:
    return create_controller(
        name, ControllerContext(vehicle=VEHICLE, model=MODEL, currents=EstimatedCurrent(), desks=BackgroundWorkers())
    )


def ask(controller: Controller, t_us: int, nav: NavState, params: ParamSet, goal: Goal = GOAL) -> ControlOutput:
    return checked_output(controller.step(t_us, nav, goal, TANK, params, LIMIT_N, (), delay_s=0.0), LIMIT_N)


def fly(controller: Controller, steps: int) -> tuple[FloatArray, FloatArray]:
    """States (steps, 8) and thrusts (steps, N) on the model, inner loop included."""
    params, x, states, thrusts = ParamSet(), np.array(START), [], []
    for step in range(steps):
        thrust_n = ask(controller, step * 50_000, nav_at(step * 50_000, x), params).thrust_n
        for tick in range(5):
            if tick:
                t_us = step * 50_000 + tick * 10_000
                between = controller.tick(t_us, nav_at(t_us, x))
                thrust_n = thrust_n if between is None else between
            x = rk4(lambda y, n=thrust_n: np.array(state_derivative(MODEL, y, n, CURRENT, np)), x, 0.01)
        states.append(x)
        thrusts.append(thrust_n)
    return np.array(states), np.array(thrusts)


def test_a_controller_reaches_its_goal_round_a_pillar_within_the_limits(controller: Controller) -> None:
    states, thrusts = fly(controller, 400)
    assert np.linalg.norm(states[-1, :3] - GOAL.pos_ned_m) < 0.1
    assert abs(wrap_pi(float(states[-1, 3] + 0.5))) < 0.15
    assert np.hypot(states[:, 0], states[:, 1]).min() > 0.16 + VEHICLE.radius_m - 0.01
    assert thrusts.shape == (400, N) and np.abs(thrusts).max() <= LIMIT_N[0]
    assert isinstance(controller.take_news(), list)


@pytest.mark.parametrize("name", ["nmpc", "los-pid", "my_controller:Follower"])
def test_a_controller_is_deterministic_and_forgets_at_reset(name: str) -> None:
    first, again = make_controller(name), make_controller(name)
    wanted = fly(first, 40)[1]
    assert (fly(again, 40)[1] == wanted).all()
    again.reset()
    assert np.abs(fly(again, 40)[1] - wanted).max() < 1e-6


def test_a_controller_says_what_it_has_against_arming(controller: Controller) -> None:
    nav, params = nav_at(0, np.array(START)), ParamSet()
    assert controller.refusals(nav, (("item 1", 0.9),), 1.2, params) == ()
    assert 0.0 < controller.planar_speed_m_s(nav, params) <= params["SPD_PLANAR_MAX"]


@pytest.mark.parametrize("spec", ["los-pid", "my_controller:Follower"])
@pytest.mark.parametrize("name", ["lbv150", "bluerov2", "bluerov2-heavy"])
def test_a_controller_on_the_model_flies_vehicles_with_any_number_of_thrusters(name: str, spec: str) -> None:
    vehicle = load_vehicle(name)
    given = ControllerContext(
        vehicle=vehicle, model=vehicle.to_model(), currents=EstimatedCurrent(), desks=BackgroundWorkers()
    )
    controller, params = create_controller(spec, given), ParamSet()
    limit_n = np.full(len(vehicle.thrusters), 9.0)
    x, begin_m = np.array(START), math.hypot(*(GOAL.pos_ned_m[:2] - START[:2]))
    for step in range(160):
        t_us = step * 50_000
        control = controller.step(t_us, nav_at(t_us, x), GOAL, TANK, params, limit_n, (), delay_s=0.0)
        thrust_n = checked_output(control, limit_n).thrust_n
        for _ in range(5):
            x = rk4(lambda y, n=thrust_n: np.array(state_derivative(given.model, y, n, CURRENT, np)), x, 0.01)
    assert math.hypot(*(GOAL.pos_ned_m[:2] - x[:2])) < begin_m - 1.0
    assert abs(x[2] - GOAL.pos_ned_m[2]) < 0.1


def test_no_estimate_is_no_reason_to_raise(controller: Controller) -> None:
    params, x = ParamSet(), np.array(START)
    for step, health in enumerate((NavHealth.GOOD, NavHealth.DEAD_RECKONING, NavHealth.INVALID, NavHealth.GOOD)):
        jumped = replace(nav_at(step * 50_000, x, health), reset_count=step)
        assert np.isfinite(ask(controller, step * 50_000, jumped, params).thrust_n).all()


# Estimators.


def estimates(name: str, seconds: float) -> tuple[list[NavState | None], list[Truth]]:
    """What an estimator says while the vehicle is driven through the jet on a curve."""
    vehicle = simulated_vehicle(load_scenario("paper-tank"), VEHICLE, seed=3, position="pose")
    estimator = create_estimator(name, VEHICLE, None, floor_depth_m=1.5, shadow=":" in name)
    states, truths, thrust_n = [], [], np.zeros(N)
    with vehicle:
        for tick in range(1, round(seconds * 100) + 1):
            t_us = tick * 10_000
            vehicle.advance(t_us)
            states.append(estimator.step(t_us, vehicle.poll(t_us), thrust_n))
            truths.append(vehicle.truth)
            vehicle.write([1590, 1560, 1500, 1500])
            thrust_n = vehicle.truth.thrust_n[:N]
    assert estimator.ahrs_us is not None and seconds * 1e6 - estimator.ahrs_us < 50_000
    assert isinstance(estimator.take_aids(), tuple) and isinstance(dict(estimator.counters()), dict)
    return states, truths


@pytest.mark.parametrize("name", ["ekf", "complementary", "my_estimator:Observer"])
def test_an_estimator_says_where_the_vehicle_is(name: str) -> None:
    states, truths = estimates(name, 5.0)
    assert states[0] is None
    known = [(nav, truth) for nav, truth in zip(states, truths, strict=True) if nav is not None]
    assert len(known) > 400
    for nav, truth in known:
        assert nav.t_us == truth.t_us and nav.variance.shape == (12,) and (nav.variance > 0.0).all()
    for nav, truth in known[-150:]:
        assert nav.health is NavHealth.GOOD
        assert np.linalg.norm(nav.pos_ned_m - truth.pos_ned_m) < 0.05
        assert np.linalg.norm(nav.vel_frd_m_s - truth.vel_frd_m_s) < 0.10
        assert abs(wrap_pi(float(nav.rpy_rad[2] - truth.rpy_rad[2]))) < 0.03


@pytest.mark.parametrize("name", ["ekf", "complementary", "my_estimator:Observer"])
def test_an_estimator_is_deterministic(name: str) -> None:
    first, again = (estimates(name, 1.0)[0] for _ in range(2))
    for a, b in zip(first, again, strict=True):
        assert (a is None) == (b is None)
        if a is not None and b is not None:
            assert (a.pos_ned_m == b.pos_ned_m).all() and (a.vel_frd_m_s == b.vel_frd_m_s).all()


# Plants.


def make_plant(name: str, seed: int = 1) -> PlantLike:
    return create_plant(name, PlantContext(scenario=load_scenario("open-water"), vehicle=VEHICLE, seed=seed))


def course(plant: PlantLike, times_us: Sequence[int]) -> FloatArray:
    """Positions at these times, driven ahead."""
    places = []
    for t_us in times_us:
        plant.advance(t_us, (1650, 1650, 1500, 1500))
        truth = plant.truth
        assert truth.t_us == t_us and truth.thrust_n.shape == (8,)
        assert np.isfinite([*truth.pos_ned_m, *truth.quat, *truth.rate_frd_rad_s, *truth.accel_frd_m_s2]).all()
        assert math.isclose(float(np.linalg.norm(truth.quat)), 1.0, rel_tol=1e-9)
        places.append(truth.pos_ned_m.copy())
    return np.array(places)


@pytest.mark.parametrize("name", ["rigid-body", "my_plant:Swell"])
def test_a_plant_moves_and_is_deterministic(name: str) -> None:
    times_us = range(20_000, 6_000_001, 20_000)
    first, again = (course(make_plant(name), times_us) for _ in range(2))
    assert (first == again).all()
    assert first[-1, 0] - first[0, 0] > 0.5


def test_the_swell_is_the_seeds() -> None:
    times_us = range(20_000, 3_000_001, 20_000)
    one, two = (course(make_plant("my_plant:Swell", seed), times_us) for seed in (1, 2))
    assert np.abs(one - two).max() > 0.01
