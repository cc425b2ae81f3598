"""Trajectories of least energy, when they are answered, and how they are followed."""

import math
from dataclasses import replace

import numpy as np
import pytest

from autopilot.control.controller import MotionController
from autopilot.control.current.currents import EstimatedCurrent, MappedCurrent, PointwiseField
from autopilot.control.energy.energy_tuning import LEG_TASK
from autopilot.control.energy.flow import area_of, sample_flow
from autopilot.control.energy.leg_task import shifted
from autopilot.control.energy.power import PowerModel
from autopilot.control.energy.request import TrajectoryRequest
from autopilot.control.energy.search import EnergyPlanner
from autopilot.control.energy.track import TrackedTrajectory, joined
from autopilot.core import model4
from autopilot.core.frames import FloatArray
from autopilot.core.geometry import Fence
from autopilot.core.messages import Goal
from autopilot.core.params import ParamSet
from tests.control.control_loop import MODEL, TANK, VEHICLE, A, B, fly, goal, jet, nav_state

POWER = PowerModel.of(VEHICLE)
PLANNER = EnergyPlanner(MODEL, POWER)
LIMITS = np.array([0.5, 0.25, 1.0, 0.0, 1.2])
AT_A = np.array([-1.60, -0.35, 0.45, 0.0, 0.0, 0.0, 0.0, 0.0])


def request(x0: FloatArray, to: Goal, fence: Fence = TANK, current: FloatArray | None = None) -> TrajectoryRequest:
    nav = nav_state(0, x0, current)
    area = area_of(fence, np.stack([x0[:2], to.pos_ned_m[:2]]))
    return TrajectoryRequest(
        x0=x0,
        goal=to,
        fence=fence,
        radius_m=0.32,
        flow=sample_flow(EstimatedCurrent(), nav, area, 0.4),
        limits=LIMITS,
        thrust_limit_n=np.full(4, 12.0),
        buoyancy_excess_n=MODEL.buoyancy_excess_n,
    )


def fine_end(x: FloatArray, thrust_n: FloatArray, duration_s: float, current: FloatArray) -> FloatArray:
    """RK4 in steps of 5 ms."""
    count = math.ceil(duration_s / 0.005)
    h = duration_s / count

    def f(state: FloatArray) -> FloatArray:
        return np.array(model4.state_derivative(MODEL, state.tolist(), thrust_n.tolist(), current.tolist(), math))

    for _ in range(count):
        k1 = f(x)
        k2 = f(x + h / 2 * k1)
        k3 = f(x + h / 2 * k2)
        k4 = f(x + h * k3)
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return x


def test_a_plan_obeys_physics_and_limits() -> None:
    current = np.array([0.05, 0.02, 0.0])
    plan = PLANNER.plan(request(AT_A, B, current=current))
    found = plan.trajectory
    assert found is not None
    assert found.solved
    assert plan.complete
    dt = float(found.t_s[1])
    for k in range(len(found.thrust_n)):
        assert np.allclose(fine_end(found.x[k], found.thrust_n[k], dt, current), found.x[k + 1], atol=2e-3)
    assert np.hypot(found.x[:, 4], found.x[:, 5]).max() < 0.5 + 1e-6
    assert np.abs(found.thrust_n).max() < 12.0 + 1e-6
    for cx, cy in ((-0.625, -0.625), (0.9375, 0.0)):
        assert np.hypot(found.x[:, 0] - cx, found.x[:, 1] - cy).min() > 0.16 + 0.32 - 1e-4
    assert np.linalg.norm(found.x[-1, :3] - B.pos_ned_m) < 0.3
    watt = 12.0 + 1.2 * ((found.thrust_n**2 + 1e-4) ** 0.75).sum(axis=1)
    assert found.energy_j == pytest.approx(float(watt.sum()) * dt, rel=1e-6)
    assert plan.energy_j == found.energy_j
    assert plan.eta_s == pytest.approx(found.t_s[-1])


def test_a_long_leg_in_still_water_is_near_the_closed_form() -> None:
    to = goal(20.0, 0.0, 0.45, None)
    plan = PLANNER.plan(request(np.array([0.0, 0.0, 0.45, 0, 0, 0, 0, 0]), to, Fence()))
    speed = np.linspace(0.05, 0.5, 500)
    drag = 0.5 * (4.0 + 30.0 * speed) * speed
    expected = 19.7 * float(((12.0 + 1.2 * (2.0 * drag**1.5 + 0.6**1.5)) / speed).min())
    assert plan.trajectory is not None
    assert plan.trajectory.solved
    assert plan.energy_j == pytest.approx(expected, rel=0.03)


def test_a_goal_that_no_way_reaches_is_an_answer() -> None:
    away = replace(B, pos_ned_m=np.array([9.0, 0.0, 0.3]))
    plan = PLANNER.plan(request(AT_A, away))
    assert plan.trajectory is None
    assert math.isinf(plan.energy_j)


def test_the_clock_of_a_track_waits_for_the_vehicle_and_settles_at_the_goal() -> None:
    trajectory = PLANNER.plan(request(AT_A, B)).trajectory
    assert trajectory is not None
    track = TrackedTrajectory(trajectory, B, complete=True)
    for _ in range(20):
        track.advance(0.05, AT_A)
    assert 0.3 <= track.clock_s < 0.8
    track.locate(trajectory.x[24], float(trajectory.t_s[24]))
    assert track.clock_s == pytest.approx(trajectory.t_s[24], abs=0.06)
    x, _ = track.sample(np.linspace(0.0, 30.0, 31), np.zeros(3))
    assert np.allclose(x[-1, :3], B.pos_ned_m, atol=1e-3)
    assert abs(x[-1, 4]) + abs(x[-1, 5]) < 1e-3
    rest = shifted(trajectory, float(trajectory.t_s[10]), trajectory.x[10])
    assert np.allclose(rest.x[0], trajectory.x[10])
    assert rest.t_s[-1] == pytest.approx(trajectory.t_s[-1] - trajectory.t_s[10])


def test_a_track_runs_on_into_the_next_one() -> None:
    """Where one trajectory ends the next begins: no jump of the state, the same turn, the next one's thrust."""
    first = PLANNER.plan(request(AT_A, B)).trajectory
    assert first is not None
    end = first.x[-1].copy()
    end[3] += 2.0 * math.pi
    second = PLANNER.plan(request(end, A)).trajectory
    assert second is not None
    track, then = TrackedTrajectory(first, B, complete=True), TrackedTrajectory(second, A, complete=True)
    track.locate(first.x[-6], float(first.t_s[-6]))
    x, thrust = track.sample(np.linspace(0.0, 3.0, 61), np.zeros(3), then)
    assert np.abs(np.diff(x[:, :4], axis=0)).max() < 0.06
    late = 3.0 + track.clock_s - float(first.t_s[-1])
    k = int(np.searchsorted(second.t_s, late - 0.025)) - 1
    assert np.allclose(thrust[-1], second.thrust_n[k], atol=1e-6)
    track.locate(first.x[-1], float(first.t_s[-1]))
    at, current = np.linspace(0.0, 3.0, 61), np.array([0.1, 0.0, 0.0])
    assert track.missing == 0.0 and np.allclose(track.sample(at, current, then)[0][1:, :2], then._at(at[1:])[:, :2])
    # Who is at the end and not in the region is brought to the goal's centre, not all at once.
    samples = []
    while track.missing < 1.0:
        track.advance(0.05, first.x[-1])
        samples.append(track.sample(at, current, then)[0])
    assert np.abs(np.diff([sample[-1, :4] for sample in samples], axis=0)).max() < 0.25
    assert np.allclose(samples[-1][-1, :2], B.pos_ned_m[:2], atol=0.05)
    assert not track.sample(at, current, then)[1].any()
    whole = joined(first, float(first.t_s[40]), second)
    assert whole.t_s[-1] == pytest.approx(float(first.t_s[-1] - first.t_s[40] + second.t_s[-1]))
    assert len(whole.t_s) == len(whole.x) == len(whole.thrust_n) + 1
    assert (np.diff(whole.t_s) > 0.0).all()
    assert np.allclose(whole.x[0], first.x[40])
    assert np.abs(np.diff(whole.x[:, 3])).max() < 0.5
    assert np.allclose(whole.thrust_n[0], first.thrust_n[40])
    assert joined(first, float(first.t_s[-1]) + 0.1, second) is second


def test_the_leg_after_decides_between_ways_that_cost_about_the_same() -> None:
    """B is reached round either side of the second cylinder for nearly the same energy; the ways back differ."""
    x0 = np.array([-1.36, -0.5, 0.39, -0.14, -0.1, 0.11, -0.03, 0.26])

    def asked(start: FloatArray, to: Goal) -> TrajectoryRequest:
        nav = nav_state(0, start)
        area = area_of(TANK, np.stack([start[:2], to.pos_ned_m[:2]]))
        return replace(request(start, to), flow=sample_flow(JET, nav, area, 0.4), radius_m=0.32)

    def both_legs_j(first: Goal) -> float:
        there = PLANNER.plan(asked(x0, first))
        assert there.trajectory is not None
        back = PLANNER.plan(asked(there.trajectory.x[-1], A))
        return there.energy_j + back.energy_j

    assert both_legs_j(replace(B, following=A)) < both_legs_j(B) - 5.0


JET = MappedCurrent(PointwiseField(lambda p, _: tuple(jet(np.array(p)).tolist())))


def test_energy_mode_rides_the_jet() -> None:
    joules = []
    there, back = replace(B, following=A), replace(A, following=B)
    for cost in (0, 1):
        field = MappedCurrent(PointwiseField(lambda p, _: tuple(jet(np.array(p)).tolist())))
        flight = fly(
            MotionController(VEHICLE, currents=field),
            [there, back],
            AT_A.tolist(),
            params=ParamSet({"MPC_COST": cost}),
            current=jet,
            current_lag_s=0.05,
        )
        assert len(flight.reached_s) == 2
        assert flight.pillar_distance_m() > 0.46
        assert flight.wall_distance_m() > 0.3
        joules.append(float((12.0 + 1.2 * ((flight.thrust_n**2 + 1e-4) ** 0.75).sum(axis=1)).sum()) * 0.05)
    assert joules[1] < 0.7 * joules[0]


def test_a_vehicle_swept_away_from_a_leg_that_was_left_to_the_route_gets_a_plan() -> None:
    controller, params = MotionController(VEHICLE, cpu_clock=lambda: 0.0), ParamSet({"MPC_COST": 1})
    stream, open_water = np.array([0.0, -0.15, 0.0]), Fence(depth_max_m=20.0)

    def plans(first: int, from_m: float) -> int:
        x = np.array([-from_m, 0.0, 0.5, 0.0, 0.0, 0.15, 0.0, 0.0])
        steps = range(first, first + 40)
        to = goal(0.0, 0.0, 0.5, None)
        told = [controller.step(k * 50_000, nav_state(k * 50_000, x, stream), to, open_water, params) for k in steps]
        return sum(output.plan is not None for output in told)

    assert plans(0, 1.2) == 0
    assert plans(40, 1.9) == 0
    assert plans(80, 6.0) > 0


@pytest.mark.long
def test_a_long_leg_keeps_to_the_depth_that_was_drawn() -> None:
    """Sinking all the way and rising at the end would be a little cheaper, and every new plan would begin deeper."""
    open_water = Fence(depth_max_m=20.0)
    controller = MotionController(VEHICLE, cpu_clock=lambda: 0.0)
    params = ParamSet({"MPC_COST": 1, "DEPTH_MAX": 20.0})
    to = goal(60.0, 0.0, 5.0, None)
    flight = fly(controller, [to], [0, 0, 5.0, 0, 0, 0, 0, 0], fence=open_water, params=params, limit_s=240.0)
    assert flight.reached_s
    assert np.abs(flight.x[:, 2] - 5.0).max() < LEG_TASK.leg_depth_m + 0.05
