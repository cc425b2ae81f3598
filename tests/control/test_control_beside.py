"""What does not fit into a control step is done beside it: where, when its answer comes, and what happens meanwhile."""

import math
import os
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from control_loop import STEP_US, TANK, VEHICLE, A, B, goal, inside, nav_state, rk4, still
from hypothesis import given, settings
from hypothesis import strategies as st

from autopilot.control.controller import MotionController
from autopilot.control.energy.energy_tuning import PATIENCE
from autopilot.control.energy.patience import ANSWER_STEPS as ANSWER_STEPS_OF_PLANS
from autopilot.control.energy.patience import Kind
from autopilot.control.energy.power import PowerModel
from autopilot.control.energy.request import Plan, TrajectoryRequest
from autopilot.control.energy.search import EnergyPlanner
from autopilot.control.energy.trajectory import Program, Trajectory
from autopilot.control.path.path_tuning import GUIDANCE
from autopilot.control.path.planner import Planner
from autopilot.control.path.workers import BackgroundWorkers
from autopilot.core.background import BackgroundWorker, Cancel, WithdrawnError
from autopilot.core.frames import FloatArray
from autopilot.core.geometry import Circle, Fence, Polygon
from autopilot.core.messages import Fallback, Goal, Severity
from autopilot.core.params import ParamSet

MODEL = VEHICLE.to_model()
OPEN = Fence(depth_max_m=1.2)
AT_A: FloatArray = np.array([-1.60, -0.35, 0.45, 0.0, 0.0, 0.0, 0.0, 0.0])

SOUND = EnergyPlanner(MODEL, PowerModel.of(VEHICLE))
"""Built once: that takes half a second."""


class Loop:
    """A controller on its own model, step by step."""

    def __init__(self, controller: MotionController, start: FloatArray = AT_A, **params: float) -> None:
        self.controller, self.params = controller, ParamSet(params)
        self.x, self.acting, self.t_us = start.copy(), np.zeros(4), 0
        self.track = [start[:2].copy()]
        self.thrust_n = np.zeros(4)
        self.plans, self.steps = 0, 0
        self.plan_steps: list[int] = []

    def step(self, to: Goal, fence: Fence) -> FloatArray:
        output = self.controller.step(self.t_us, nav_state(self.t_us, self.x), to, fence, self.params)
        self.t_us += STEP_US
        for _ in range(5):
            self.acting = self.acting + (output.thrust_n - self.acting) * (1.0 - math.exp(-0.01 / 0.15))
            self.x = rk4(MODEL, self.x, self.acting, still, 0.01)
        self.track.append(self.x[:2].copy())
        self.thrust_n = output.thrust_n
        if output.plan is not None:
            self.plans += 1
            self.plan_steps.append(self.steps)
        self.steps += 1
        assert np.isfinite(output.thrust_n).all() and output.status.fallback is Fallback.NONE
        return output.route_ned_m

    def fly(self, steps: int, to: Goal, fence: Fence) -> None:
        for _ in range(steps):
            self.step(to, fence)


def on(executor: ThreadPoolExecutor, *, blocking: bool) -> BackgroundWorkers:
    return BackgroundWorkers(
        routes=BackgroundWorker(executor, blocking=blocking), trajectories=BackgroundWorker(executor, blocking=blocking)
    )


def pillar(x: float, y: float, radius_m: float = 0.3) -> Fence:
    return Fence(exclusions=(Circle(center_ned_m=np.array([x, y]), radius_m=radius_m),), depth_max_m=1.2)


def test_a_straight_way_is_taken_at_once_and_another_one_a_counted_number_of_steps_later() -> None:
    loop = Loop(MotionController(VEHICLE, cpu_clock=lambda: 0.0))
    far = goal(2.0, -0.35, 0.45, None)
    assert np.allclose(loop.step(far, OPEN)[-1], far.pos_ned_m[:2])
    loop.controller.reset()
    lengths = [len(loop.step(far, pillar(0.0, -0.35))) for _ in range(GUIDANCE.answer_steps + 1)]
    assert lengths[:-1] == [2] * GUIDANCE.answer_steps and lengths[-1] > 4
    assert not loop.controller.unreachable


def test_a_new_fence_binds_at_once_and_the_loop_never_waits_for_the_way_round() -> None:
    """The search is held up for 20 s: the vehicle stops before what has appeared on its route, and goes on after."""
    gate, far = threading.Event(), goal(2.5, -0.35, 0.45, None)
    with ThreadPoolExecutor(1) as executor:
        controller = MotionController(VEHICLE, desks=on(executor, blocking=False), cpu_clock=lambda: 0.0)
        loop = Loop(controller)
        loop.fly(60, far, OPEN)
        assert loop.x[4] > 0.25
        executor.submit(gate.wait, 60.0)
        wall = pillar(float(loop.x[0]) + 1.2, -0.35)
        loop.fly(400, far, wall)
        center = wall.exclusions[0].center_ned_m  # type: ignore[union-attr]
        away = np.hypot(*(np.array(loop.track[60:]) - center).T)
        assert away.min() > 0.3 + VEHICLE.radius_m
        assert abs(loop.x[4]) < 0.05, "it holds its place"
        assert controller.desks.routes.late == 1 and not controller.unreachable
        gate.set()
        for _ in range(1500):
            loop.step(far, wall)
            if inside(loop.x, far):
                break
        assert inside(loop.x, far)
        assert np.hypot(*(np.array(loop.track) - center).T).min() > 0.3 + VEHICLE.radius_m


def test_a_loop_that_never_rests_gets_its_route_all_the_same() -> None:
    """On a core of its own, as fast as it can, the loop would keep the interpreter from the thread that searches."""
    cores = sorted(os.sched_getaffinity(0))
    if len(cores) < 2:
        pytest.skip("on one core the kernel changes over by itself")
    with ThreadPoolExecutor(1) as executor:
        executor.submit(os.sched_setaffinity, 0, cores[1:]).result()
        os.sched_setaffinity(0, cores[:1])
        try:
            loop = Loop(MotionController(VEHICLE, desks=on(executor, blocking=False), cpu_clock=lambda: 0.0))
            way, around = goal(2.0, -0.35, 0.45, None), pillar(0.0, -0.35)
            found = any(len(loop.step(way, around)) > 4 for _ in range(1500))
        finally:
            os.sched_setaffinity(0, cores)
    assert found


def test_what_does_not_bar_the_route_does_not_stop_the_vehicle() -> None:
    """A new fence beside the route: it goes on while the way is looked for."""
    gate, far = threading.Event(), goal(1.75, 0.0, 0.3, math.pi)
    with ThreadPoolExecutor(1) as executor:
        loop = Loop(MotionController(VEHICLE, desks=on(executor, blocking=False), cpu_clock=lambda: 0.0))
        executor.submit(lambda: None).result()
        for _ in range(100):
            route = loop.step(far, TANK)
            if len(route) > 4:
                break
            threading.Event().wait(0.02)
        assert len(route) > 4
        executor.submit(gate.wait, 60.0)
        loop.fly(30, far, TANK)
        beside = replace_exclusions(TANK, Circle(center_ned_m=np.array([-2.0, 1.2]), radius_m=0.1))
        begin = loop.x[0]
        loop.fly(40, far, beside)
        assert loop.x[0] - begin > 0.4
        gate.set()


def replace_exclusions(fence: Fence, *more: Circle) -> Fence:
    return Fence(
        inclusions=fence.inclusions,
        exclusions=(*fence.exclusions, *more),
        depth_min_m=fence.depth_min_m,
        depth_max_m=fence.depth_max_m,
    )


def test_goals_and_fences_that_change_faster_than_routes_are_found_do_not_stop_it_for_ever() -> None:
    """Another goal and another fence at every step, answers two steps later: the vehicle still gets there, roughly."""
    loop = Loop(MotionController(VEHICLE, cpu_clock=lambda: 0.0))
    for step in range(600):
        wall = pillar(0.0, -0.35 + 0.001 * (step % 7))
        loop.step(goal(2.0 + 0.01 * (step % 5), -0.35, 0.45, None), wall)
    assert loop.x[0] > 1.0
    assert GUIDANCE.patience_steps * STEP_US == 1_000_000


class Counting(EnergyPlanner):
    """The shipped planner, counted."""

    def __init__(self) -> None:
        super().__init__(MODEL, PowerModel.of(VEHICLE))
        self.done: list[Goal] = []
        self.withdrawn = 0
        self.begun = threading.Event()

    def plan(self, request: TrajectoryRequest, cancel: Cancel | None = None) -> Plan:
        self.begun.set()
        try:
            plan = super().plan(request, cancel)
        except WithdrawnError:
            self.withdrawn += 1
            raise
        self.done.append(request.goal)
        return plan


def test_superseded_plans_are_not_made() -> None:
    """Twenty goals, one every 0.4 s: what is planned to its end is the last of them, not all twenty."""
    planner = Counting()
    planner.warm()
    with ThreadPoolExecutor(1) as executor:
        controller = MotionController(
            VEHICLE, desks=on(executor, blocking=True), trajectories=planner, cpu_clock=lambda: 0.0
        )
        params = ParamSet({"MPC_COST": 1})
        goals = [goal(1.75, 0.02 * i, 0.30, None) for i in range(20)]
        for step in range(160 + ANSWER_STEPS_OF_PLANS[Kind.COLD]):
            target = goals[min(step // 8, 19)]
            t_us = step * STEP_US
            output = controller.step(t_us, nav_state(t_us, AT_A), target, TANK, params)
            if step == 7:  # the last with the first goal
                assert planner.begun.wait(10.0)
        assert output.plan is not None or len(output.route_ned_m) > 2
        assert planner.done == [goals[-1]]
        assert planner.withdrawn >= 1, "the one in work is given up"


def test_a_plan_in_work_is_given_up_before_its_next_program(monkeypatch: pytest.MonkeyPatch) -> None:
    planner, cancel = EnergyPlanner(MODEL, PowerModel.of(VEHICLE)), Cancel()
    controller = MotionController(VEHICLE, trajectories=planner, cpu_clock=lambda: 0.0)
    loop = Loop(controller, MPC_COST=1)
    loop.fly(6, B, TANK)
    energy = controller._guidances[1]
    request = energy._request  # type: ignore[attr-defined]
    solve, solved = Program.solve, []

    def withdrawn(self: Program, *program: Any, **more: Any) -> Trajectory:
        cancel.requested = True
        solved.append(solve(self, *program, **more))
        return solved[-1]

    monkeypatch.setattr(Program, "solve", withdrawn)
    for count in (1, 1):  # in work, and before it
        with pytest.raises(WithdrawnError):
            planner.plan(replace(request, kind=Kind.COLD), cancel)
        assert len(solved) == count


class Hostile:
    """Makes what ``script`` says of every request: a plan, an exception, something that is not finite."""

    def __init__(self, script: Callable[[int, TrajectoryRequest, Cancel], Plan]) -> None:
        self._script, self.asked = script, 0

    def plan(self, request: TrajectoryRequest, cancel: Cancel) -> Plan:
        self.asked += 1
        return self._script(self.asked, request, cancel)

    def warm(self) -> None:
        raise OSError("no libraries")


def raising(error: Exception) -> Callable[[int, TrajectoryRequest, Cancel], Plan]:
    def script(_: int, __: TrajectoryRequest, ___: Cancel) -> Plan:
        raise error

    return script


def not_finite(_: int, request: TrajectoryRequest, cancel: Cancel) -> Plan:
    plan = SOUND.plan(request, cancel)
    assert plan.trajectory is not None
    return replace(plan, trajectory=replace(plan.trajectory, x=np.full_like(plan.trajectory.x, np.nan)))


@pytest.mark.parametrize(
    "script",
    [
        raising(RuntimeError("IPOPT")),
        raising(MemoryError()),
        raising(np.linalg.LinAlgError("singular")),
        raising(WithdrawnError()),
        lambda *_: None,  # no plan at all
        not_finite,
    ],
    ids=["runtime", "memory", "numpy", "withdrawn", "none", "nan"],
)
def test_a_leg_whose_plan_fails_goes_by_the_plain_route(
    script: Callable[[int, TrajectoryRequest, Cancel], Plan],
) -> None:
    planner = Hostile(script)
    controller = MotionController(VEHICLE, trajectories=planner, cpu_clock=lambda: 0.0)
    loop = Loop(controller, MPC_COST=1)
    news: list[tuple[Severity, str]] = []
    legs, index = (B, A), 0
    for _ in range(1200):
        loop.step(legs[index], TANK)
        news += controller.take_news()
        assert not controller.unreachable
        if inside(loop.x, legs[index]):
            index += 1
            if index == 2:
                break
    assert index == 2, "both legs are flown"
    # On each leg after 1, 2, 4, 8 s, and where the vehicle has gone on by 2 m.
    assert 4 <= planner.asked <= 14 and planner.asked < loop.steps / PATIENCE.retry_steps / 2
    warnings = [text for severity, text in news if severity <= Severity.WARNING]
    assert warnings == ["No energy plan: flying the plain route"] and len(warnings[0]) <= 50
    assert sum("energy planner: " in text for severity, text in news if severity is Severity.DEBUG) == 1


def test_a_planner_that_recovers_is_used_again_and_its_next_failure_is_news() -> None:
    """The first two of every three requests fail: one word, and then the same leg is flown by the plan."""

    def script(asked: int, request: TrajectoryRequest, cancel: Cancel) -> Plan:
        if asked % 3:
            raise ValueError("odd")
        return SOUND.plan(request, cancel)

    loop = Loop(MotionController(VEHICLE, trajectories=Hostile(script), cpu_clock=lambda: 0.0), MPC_COST=1)
    told: list[str] = []
    for target in (goal(4.0, 0.3, 0.45, None), goal(-4.0, -0.3, 0.45, None)):
        loop.plans = 0
        for _ in range(200):
            loop.step(target, OPEN)
            told += [text for severity, text in loop.controller.take_news() if severity is Severity.WARNING]
        assert loop.plans >= 1
    assert told == ["No energy plan: flying the plain route"] * 2


def test_no_plan_and_no_way_are_no_reason_to_stop_where_the_route_goes_on() -> None:
    """What the energy planner finds no way through, or no trajectory, the vehicle flies like the other mode."""

    def none(_: int, request: TrajectoryRequest, __: Cancel) -> Plan:
        return Plan(goal=request.goal, trajectory=None, energy_j=math.inf, eta_s=math.inf, complete=False, why="no way")

    loop = Loop(MotionController(VEHICLE, trajectories=Hostile(none), cpu_clock=lambda: 0.0), MPC_COST=1)
    told: list[str] = []
    for _ in range(500):
        loop.step(B, TANK)
        told += [text for severity, text in loop.controller.take_news() if severity is Severity.WARNING]
        assert not loop.controller.unreachable
        if inside(loop.x, B):
            break
    assert inside(loop.x, B)
    assert told == ["No energy plan: flying the plain route"]


def test_a_trajectory_that_is_not_solved_is_not_flown(monkeypatch: pytest.MonkeyPatch) -> None:
    def unsolved(self: Program, *program: Any, **more: Any) -> Trajectory:
        return replace(solve(self, *program, **more), solved=False)

    solve = Program.solve
    monkeypatch.setattr(Program, "solve", unsolved)
    loop = Loop(MotionController(VEHICLE, cpu_clock=lambda: 0.0), MPC_COST=1)
    loop.fly(100, B, TANK)
    assert loop.plans == 0 and loop.x[0] > AT_A[0] + 0.5
    reasons = [text for severity, text in loop.controller.take_news() if severity is Severity.DEBUG]
    assert sum("none of" in text and "solved" in text for text in reasons) == 1


def test_a_quick_plan_comes_first_and_the_full_search_takes_over_without_a_jump() -> None:
    """To either side: under way until the quick plan, no stop and no jerk when the other comes."""
    for far in (goal(6.0, 1.0, 0.45, None), goal(6.0, -1.5, 0.45, None)):
        kinds: list[Kind] = []

        def noted(_: int, request: TrajectoryRequest, cancel: Cancel, kinds: list[Kind] = kinds) -> Plan:
            kinds.append(request.kind)
            return SOUND.plan(request, cancel)

        loop = Loop(MotionController(VEHICLE, trajectories=Hostile(noted), cpu_clock=lambda: 0.0), MPC_COST=1)
        speed, thrust = [], []
        for _ in range(200):
            loop.step(far, OPEN)
            thrust.append(loop.thrust_n)
            speed.append(float(np.hypot(*loop.x[4:6])))
        assert kinds[:2] == [Kind.QUICK, Kind.COLD]
        quick = loop.plan_steps[0]
        assert quick < 15
        assert np.hypot(*loop.x[4:6]) > 0.1
        if loop.x[0] > 0.0:
            assert min(speed[quick + 20 :]) > 0.12, "no stop at the change"
        for change in loop.plan_steps:
            assert np.abs(np.diff(thrust[change - 3 : change + 5], axis=0)).max() < 3.0


def test_a_short_leg_in_still_water_has_a_plan_and_what_it_misses_is_left_to_the_route() -> None:
    loop = Loop(MotionController(VEHICLE, cpu_clock=lambda: 0.0), MPC_COST=1)
    near = goal(-0.8, -0.1, 0.45, None)
    for _ in range(120):
        loop.step(near, OPEN)
    assert loop.plans == 1 and inside(loop.x, near)
    assert not [text for severity, text in loop.controller.take_news() if severity <= Severity.WARNING]


def test_a_plan_that_is_late_is_waited_for_under_way_and_told_once() -> None:
    """The planner is held up: the leg is flown by the route to its end, with one word."""
    gate = threading.Event()
    with ThreadPoolExecutor(1) as executor:
        controller = MotionController(VEHICLE, desks=on(executor, blocking=False), cpu_clock=lambda: 0.0)
        controller.desks = BackgroundWorkers(
            routes=BackgroundWorker(), trajectories=BackgroundWorker(executor, blocking=False)
        )
        controller._guidances[1]._route._worker = BackgroundWorker()  # type: ignore[attr-defined]
        executor.submit(gate.wait, 60.0)
        loop = Loop(controller, MPC_COST=1)
        told: list[str] = []
        for _ in range(500):
            loop.step(B, TANK)
            told += [text for severity, text in controller.take_news() if severity is Severity.WARNING]
            if inside(loop.x, B):
                break
        gate.set()
        assert inside(loop.x, B)
        assert told == ["No energy plan: flying the plain route"]


def test_a_route_search_that_fails_holds_the_place_and_is_tried_again(monkeypatch: pytest.MonkeyPatch) -> None:
    sound, calls = Planner.path, []

    def path(self: Planner, start: FloatArray, to: FloatArray, cancel: Cancel | None = None) -> FloatArray | None:
        calls.append(1)
        if len(calls) < 3:
            raise IndexError("grid")
        return sound(self, start, to, cancel)

    monkeypatch.setattr(Planner, "path", path)
    loop = Loop(MotionController(VEHICLE, cpu_clock=lambda: 0.0), MPC_COST=0)
    loop.fly(10, B, TANK)
    assert loop.controller.unreachable
    news = loop.controller.take_news()
    assert [text for severity, text in news if severity is Severity.WARNING] == [
        "Route search failed: holding, send another goal"
    ]
    loop.fly(60, B, TANK)
    assert len(calls) == 3 and not loop.controller.unreachable


points = st.tuples(st.floats(-3.0, 3.0), st.floats(-2.0, 2.0))
polygons = st.lists(points, min_size=1, max_size=6).map(lambda p: Polygon(vertices_ned_m=np.array(p)))
circles = st.builds(
    lambda p, r: Circle(center_ned_m=np.array(p), radius_m=r), points, st.sampled_from([0.0, 1e-9, 0.1, 1.0, 50.0])
)
shapes = st.lists(st.one_of(polygons, circles), max_size=3).map(tuple)


@settings(max_examples=30, deadline=None)
@given(shapes, shapes, points, st.sampled_from([0, 1]))
def test_no_fence_and_no_goal_ends_the_loop(
    inclusions: tuple[Polygon | Circle, ...],
    exclusions: tuple[Polygon | Circle, ...],
    to: tuple[float, float],
    cost: int,
) -> None:
    """Shapes without an area, on top of the vehicle, of goals that nothing reaches."""
    fence = Fence(inclusions=inclusions, exclusions=exclusions, depth_max_m=1.2)
    controller, params = MotionController(VEHICLE, cpu_clock=lambda: 0.0), ParamSet({"MPC_COST": cost})
    target = goal(*to, 0.4, None)
    for step in range(5):
        output = controller.step(step * STEP_US, nav_state(step * STEP_US, AT_A), target, fence, params)
        assert np.isfinite(output.thrust_n).all()
