"""The facade: fallbacks forced one by one, goals and fences that change, free headings, reports."""

import dataclasses
import math

import numpy as np
import pytest
from control_loop import MODEL, STEP_US, TANK, VEHICLE, A, B, fly, goal, jet, nav_state, rk4, still

from autopilot.control.constraints.obstacles import clearance_m
from autopilot.control.controller import MotionController
from autopilot.control.nmpc.solver import NativeStep, QpStep
from autopilot.core.geometry import Circle, Fence
from autopilot.core.messages import Fallback, NavHealth, SolveStatus
from autopilot.core.model4 import YAW
from autopilot.core.params import ParamSet

START = np.array([-1.6, -0.35, 0.45, 0.0, 0.0, 0.0, 0.0, 0.0])
OPEN = Fence(depth_max_m=5.0)
DEEP = ParamSet({"DEPTH_MAX": 5.0})


@pytest.fixture
def controller() -> MotionController:
    return MotionController(VEHICLE, cpu_clock=lambda: 0.0)


def breaking(monkeypatch: pytest.MonkeyPatch, status: SolveStatus) -> None:
    """From now on every QP fails the way ``status`` says."""

    def evaluate(step: QpStep | NativeStep) -> None:
        if status is SolveStatus.EXCEPTION:
            raise RuntimeError("injected")
        step.figures[:] = 0.0
        step.figures[4 if status is SolveStatus.NOT_FINITE else 1] = (
            math.nan if status is SolveStatus.NOT_FINITE else 1.0
        )
        step.u[:] = 99.0
        step.x[:] = math.nan

    for kind in (QpStep, NativeStep):
        monkeypatch.setattr(kind, "evaluate", evaluate)


@pytest.mark.parametrize("status", [SolveStatus.NOT_FINITE, SolveStatus.RESIDUAL, SolveStatus.EXCEPTION])
def test_failed_solve_continues_the_plan_then_keeps_station(
    controller: MotionController, monkeypatch: pytest.MonkeyPatch, status: SolveStatus
) -> None:
    x, params, acting = START.copy(), ParamSet(), np.zeros(4)
    seen = []
    for step in range(320):
        t_us = step * STEP_US
        if step == 60:
            planned = controller.nmpc.u.copy()
            breaking(monkeypatch, status)
        output = controller.step(t_us, nav_state(t_us, x), B, TANK, params)
        seen.append(output.status.fallback)
        assert (np.abs(output.thrust_n) <= 12.0).all()
        assert np.isfinite(output.horizon_ned_m).all()
        if step >= 60:
            assert output.status.status is status
        if step == 60:
            assert np.allclose(output.thrust_n, 0.5 * (planned[0] + planned[1]), atol=0.3)
        for _ in range(5):
            acting = acting + (output.thrust_n - acting) * (1.0 - math.exp(-0.01 / 0.15))
            x = rk4(MODEL, x, acting, still, 0.01)
        if step == 230:
            held = x.copy()
    assert set(seen[:60]) == {Fallback.NONE}
    assert set(seen[60:215]) == {Fallback.SHIFTED_PLAN}
    assert set(seen[225:]) == {Fallback.STATION_KEEPING}
    assert seen.index(Fallback.STATION_KEEPING) == pytest.approx(60 + 160, abs=2)
    assert np.linalg.norm(x[:3] - held[:3]) < 0.15
    assert np.abs(x[4:]).max() < 0.05
    monkeypatch.undo()
    again = controller.step(320 * STEP_US, nav_state(320 * STEP_US, x), B, TANK, params)
    assert again.status.fallback is Fallback.NONE


def test_failure_at_the_very_first_step_keeps_station(
    controller: MotionController, monkeypatch: pytest.MonkeyPatch
) -> None:
    breaking(monkeypatch, SolveStatus.RESIDUAL)
    output = controller.step(0, nav_state(0, START), B, TANK, ParamSet())
    assert output.status.fallback is Fallback.STATION_KEEPING
    assert np.allclose(output.thrust_n, [0.0, 0.0, 0.6, 0.0], atol=1e-9)


@pytest.mark.parametrize("how", ["health", "nan"])
def test_invalid_estimate_means_neutral_and_a_fresh_start(controller: MotionController, how: str) -> None:
    params = ParamSet()
    for step in range(5):
        controller.step(step * STEP_US, nav_state(step * STEP_US, START), B, TANK, params)
    x = START.copy()
    if how == "nan":
        x[0] = math.nan
    health = NavHealth.INVALID if how == "health" else NavHealth.GOOD
    output = controller.step(5 * STEP_US, nav_state(5 * STEP_US, x, health=health), B, TANK, params)
    assert output.status.fallback is Fallback.NEUTRAL
    assert output.status.status is SolveStatus.IDLE
    assert not output.thrust_n.any()
    output = controller.step(6 * STEP_US, nav_state(6 * STEP_US, START), B, TANK, params)
    assert output.status.fallback is Fallback.NONE
    assert output.restarted


def test_a_jump_of_the_estimate_gets_a_new_route_at_once(controller: MotionController) -> None:
    params = ParamSet()
    for step in range(4):
        controller.step(step * STEP_US, nav_state(step * STEP_US, START), B, TANK, params)
    jumped = START.copy()
    jumped[:2] = [-1.0, 0.9]
    nav = dataclasses.replace(nav_state(4 * STEP_US, jumped), reset_count=1)
    output = controller.step(4 * STEP_US, nav, B, TANK, params)
    assert output.restarted
    assert output.status.fallback is Fallback.NONE
    straight = np.linspace(jumped[:2], output.route_ned_m[1], 40)
    assert clearance_m(TANK, straight).min() > 0.33


def test_no_turn_is_made_up_for_after_the_estimate_was_lost(controller: MotionController) -> None:
    """More than a turn before the gap, heading free: the heading that is found again is the one to keep."""
    params, here = ParamSet(), goal(-1.6, 0.9, 0.45, None)
    x = np.array([-1.6, 0.9, 0.45, 0.0, 0.0, 0.0, 0.0, 0.0])
    for step in range(40):
        x[3] = 0.2 * step
        controller.step(step * STEP_US, nav_state(step * STEP_US, x), here, TANK, params)
    lost = nav_state(40 * STEP_US, x, health=NavHealth.INVALID)
    controller.step(40 * STEP_US, lost, here, TANK, params)
    controller.step(41 * STEP_US, nav_state(41 * STEP_US, x), here, TANK, params)
    assert abs(controller.nmpc.x[-1, YAW] - (x[3] - 2.0 * math.pi)) < 0.2


def test_report_of_a_step(controller: MotionController) -> None:
    ticks = iter([1.0, 1.25] * 3)
    timed = MotionController(VEHICLE, cpu_clock=lambda: next(ticks))
    for t_us in (7, 50_007, 100_007):
        output = timed.step(t_us, nav_state(t_us, START), B, TANK, ParamSet())
    assert output.status.solve_s == 0.25
    assert output.status.t_us == 100_007
    assert output.status.margin_m > 0.0
    assert output.horizon_ned_m.shape == (21, 3)
    assert np.allclose(output.route_ned_m[0], START[:2])
    assert np.allclose(output.route_ned_m[-1], B.pos_ned_m[:2])
    assert not controller.unreachable


def test_equal_content_is_no_new_goal_or_fence(controller: MotionController) -> None:
    params = ParamSet()
    same = Fence(inclusions=TANK.inclusions, exclusions=TANK.exclusions, depth_max_m=1.2)
    begun = []
    for step in range(8):
        target = goal(1.75, 0.0, 0.30, math.pi, seq=step)
        fence = TANK if step % 2 else same
        output = controller.step(step * STEP_US, nav_state(step * STEP_US, START), target, fence, params)
        begun.append(output.restarted)
    assert begun == [True, False, True, *[False] * 5], "it holds its place, and then goes along the route"
    assert controller.step(8 * STEP_US, nav_state(8 * STEP_US, START), A, TANK, params).restarted


def test_unreachable_goal_is_reported_and_the_place_is_held(controller: MotionController) -> None:
    far = goal(-3.5, 0.0, 0.5, None)
    flight = fly(controller, [far], START, limit_s=8.0, current=lambda p: np.array([0.1, 0.0, 0.0]), hold=True)
    assert controller.unreachable
    assert flight.outputs[-1].route_ned_m.shape == (1, 2)
    assert np.hypot(*(flight.x[-1, :2] - START[:2])) < 0.1
    controller.step(10_000_000, nav_state(10_000_000, flight.x[-1]), B, TANK, ParamSet())
    assert not controller.unreachable


def test_settles_at_a_goal_in_a_current(controller: MotionController) -> None:
    target = goal(2.0, 1.0, 0.8, 0.4)
    flight = fly(
        controller, [target], [0, 0, 0.5, 2.5, 0, 0, 0, 0], fence=OPEN, params=DEEP, hold=True, limit_s=25.0,
        current=lambda p: np.array([0.15, -0.2, 0.0]),
    )  # fmt: skip
    end = flight.x[-300:]
    assert np.linalg.norm(end[:, :3] - target.pos_ned_m, axis=1).max() < 0.03
    assert np.abs(end[:, 3] - 0.4).max() < 0.04
    assert flight.planar_speed_m_s() < 0.5


def test_switching_goals_all_the_time_breaks_nothing(controller: MotionController) -> None:
    params, x, acting = ParamSet(), START.copy(), np.zeros(4)
    rng = np.random.default_rng(5)
    target = B
    states = []
    for step in range(300):
        if step % 12 == 0:
            x_, y_ = rng.uniform([-2.1, 0.2], [2.1, 1.1])
            yaw = float(rng.uniform(-9.0, 9.0))
            target = goal(x_, y_, float(rng.uniform(0.2, 1.0)), None if step % 24 else yaw)
        output = controller.step(step * STEP_US, nav_state(step * STEP_US, x, jet(x[:2])), target, TANK, params)
        assert output.status.fallback is Fallback.NONE
        for _ in range(5):
            acting = acting + (output.thrust_n - acting) * (1.0 - math.exp(-0.01 / 0.15))
            x = rk4(MODEL, x, acting, jet, 0.01)
            states.append(x)
    s = np.array(states)
    assert np.hypot(s[:, 4], s[:, 5]).max() < 0.5
    assert np.abs(s[:, 6]).max() < 0.25
    assert np.abs(s[:, 7]).max() < 1.0


def test_free_heading_looks_along_the_route(controller: MotionController) -> None:
    plain = ParamSet({**DEEP, "MPC_COST": 0})
    flight = fly(
        controller,
        [goal(0.0, 4.0, 0.5, None)],
        [0, 0, 0.5, -0.5, 0, 0, 0, 0],
        fence=OPEN,
        params=plain,
        limit_s=20.0,
    )
    middle = flight.x[(flight.x[:, 1] > 1.5) & (flight.x[:, 1] < 3.0)]
    assert np.abs(middle[:, 3] - math.pi / 2.0).max() < 0.15
    assert flight.reached_s


CUP = ((0.0, 0.0), (0.0, 0.35), (0.0, -0.35), (-0.5, 0.65), (-0.5, -0.65))


@pytest.mark.parametrize(
    ("centers_m", "radius_m"),
    [(((0.0, 0.0),), 0.5), (((0.0, 0.05),), 0.5), (CUP, 0.3)],
    ids=["on the line", "beside the line", "pocket"],
)
def test_obstacle_on_the_line_and_pocket_are_passed(
    controller: MotionController, centers_m: tuple[tuple[float, float], ...], radius_m: float
) -> None:
    circles = tuple(Circle(center_ned_m=np.array(center), radius_m=radius_m) for center in centers_m)
    fence = Fence(exclusions=circles, depth_max_m=5.0)
    flight = fly(
        controller, [goal(2.0, 0.0, 0.5, None)], [-2, 0, 0.5, 0, 0, 0, 0, 0], fence=fence, params=DEEP, limit_s=30.0
    )
    assert flight.reached_s, "stuck"
    assert controller._planner is not None
    assert controller._planner.features.clearance_m(flight.x[:, :2]).min() > 0.3


def test_from_outside_the_workspace_it_comes_back_within_its_limits(controller: MotionController) -> None:
    flight = fly(controller, [goal(-1.0, 0.5, 0.5, None)], [-3.2, 0.5, 0.02, 0, 0, 0, 0, 0], limit_s=20.0)
    assert flight.reached_s
    assert flight.planar_speed_m_s() < 0.5
    assert np.abs(flight.x[:, 6]).max() < 0.25


def test_reset_forgets_everything(controller: MotionController) -> None:
    first = fly(controller, [B], START, limit_s=2.0)
    controller.reset()
    second = fly(controller, [B], START, limit_s=2.0)
    assert first.x.tobytes() == second.x.tobytes()
