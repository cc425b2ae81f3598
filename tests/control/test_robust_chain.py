"""The chain of what commands the thrusters when things go wrong, each link forced; and the loop between steps."""

import math

import numpy as np
import pytest
from control_loop import MODEL, PILLARS, TANK, VEHICLE, A, B, goal, nav_state, rk4, still

from autopilot.campaign.tube_study import TubeCheck
from autopilot.control.controller import MotionController
from autopilot.control.robust.penalty import PATIENCE_STEPS, PenaltyWatch
from autopilot.control.robust.station import StationKeeper
from autopilot.core.control_allocator import ControlAllocator
from autopilot.core.frames import FloatArray, wrap_pi
from autopilot.core.geometry import Circle, Fence
from autopilot.core.messages import ControlOutput, Fallback, Goal, SolveStatus
from autopilot.core.operator_messages import LIMITS_GIVEN_UP
from autopilot.core.params import ParamSet

OPEN = Fence(depth_max_m=5.0)
START = np.array([-1.6, -0.35, 0.45, 0.0, 0.0, 0.0, 0.0, 0.0])


class Rig:
    """Controller and model vehicle, with and without the inner loop, with a solver that can be made to fail."""

    def __init__(self, start: FloatArray, *, step_ticks: int = 5, inner: bool = True) -> None:
        self.controller = MotionController(VEHICLE, cpu_clock=lambda: 0.0)
        self.params = ParamSet()
        self.x, self.acting, self.command = start.copy(), np.zeros(4), np.zeros(4)
        self.step_ticks, self.inner = step_ticks, inner
        self.fence, self.told, self.water = OPEN, np.zeros(3), np.zeros(3)
        self.push_n = np.zeros(4)
        self.tick = 0
        self.outputs: list[ControlOutput] = []
        self.states: list[FloatArray] = []
        self.audit = TubeCheck()

    def fail_solver(self, failing: bool = True) -> None:
        """Make every QP come out as nothing, or let the solver work again."""
        step = self.controller.nmpc._step

        def nothing() -> None:
            step.figures[:] = math.nan

        step.evaluate = nothing if failing else type(step).evaluate.__get__(step)  # type: ignore[method-assign]

    def fly(self, target: Goal, seconds: float) -> "Rig":
        for _ in range(int(seconds * 100)):
            t_us = self.tick * 10_000
            seen = self.x.copy()
            c, s = math.cos(seen[3]), math.sin(seen[3])
            error = self.water - self.told
            seen[4] += c * error[0] + s * error[1]
            seen[5] += c * error[1] - s * error[0]
            nav = nav_state(t_us, seen, self.told.copy())
            if self.tick % self.step_ticks == 0:
                output = self.controller.step(t_us, nav, target, self.fence, self.params)
                self.command = output.thrust_n
                self.outputs.append(output)
                self.audit.announce(output)
            elif self.inner:
                between = self.controller.tick(t_us, nav)
                self.command = self.command if between is None else between
            self.audit.update(t_us * 1e-6, *self.x[:2].tolist())
            self.acting = self.acting + (self.command - self.acting) * (1.0 - math.exp(-0.01 / 0.15))
            self.x = rk4(MODEL, self.x, self.acting + self.push_n, lambda _: self.water, 0.01)
            self.states.append(self.x)
            self.tick += 1
        return self

    def fallbacks(self) -> list[Fallback]:
        return [output.status.fallback for output in self.outputs]


def test_a_failed_solve_follows_the_old_plan_with_feedback() -> None:
    """Pushed sideways while the solver fails, the vehicle is held at the plan; without feedback the sway turns it away
    (Munk). Metres aside plus radians turned."""
    aside = {}
    for inner in (True, False):
        rig = Rig(START, inner=inner)
        far = goal(6.0, -0.35, 0.45, 0.0)
        rig.fly(far, 4.0)
        rig.fail_solver()
        rig.push_n[3] = 1.0
        if not inner:
            rig.params.set("MPC_TIGHTEN", 0)
            rig.controller.margins.ancillary.gains[:] = 0.0
        begin = len(rig.outputs)
        rig.fly(far, 3.0)
        assert set(rig.fallbacks()[begin:]) == {Fallback.SHIFTED_PLAN}
        aside[inner] = abs(rig.x[1] + 0.35) + abs(rig.x[3])
        assert rig.x[0] > START[0] + 1.5, "it goes on along the plan"
    assert aside[True] < 0.1 < 0.3 < aside[False], aside


def test_station_keeping_ends_inside_the_invariant_set() -> None:
    rig = Rig(START)
    rig.told[:] = rig.water[:] = [0.12, -0.08, 0.0]
    far = goal(6.0, -0.35, 0.45, 0.0)
    rig.fly(far, 3.0)
    rig.fail_solver()
    rig.controller._plan_age_s = None
    rig.fly(far, 25.0)
    assert rig.fallbacks()[-1] is Fallback.STATION_KEEPING
    watchdog = rig.controller._station
    assert watchdog.inside and watchdog.target is not None
    assert np.hypot(*(rig.x[:2] - watchdog.target[:2])) < 0.02 and abs(wrap_pi(rig.x[3] - watchdog.target[3])) < 0.05
    rig.fail_solver(False)
    rig.fly(far, 1.0)
    assert rig.fallbacks()[-1] is Fallback.NONE and watchdog.target is None


def test_station_keeper_falls_back_to_the_cascade_in_water_that_is_too_fast() -> None:
    watchdog = StationKeeper(ControlAllocator(MODEL))
    thrust = watchdog.thrust(START, np.array([0.9, 0.0, 0.0]), np.full(4, 12.0))
    assert not watchdog.inside and np.isfinite(thrust).all() and np.abs(thrust).max() <= 12.0


def test_a_jump_of_the_current_is_ridden_out() -> None:
    """The water suddenly flows 0.3 m/s aside and the estimate follows within seconds: no link of the chain breaks."""
    rig = Rig(np.array([-1.6, 0.9, 0.45, 0.0, 0.0, 0.0, 0.0, 0.0]))
    rig.fence = TANK
    rig.fly(B, 3.0)
    rig.water[:] = [0.0, -0.3, 0.0]
    for _ in range(12):
        rig.fly(B, 0.5)
        rig.told += 0.4 * (rig.water - rig.told)
    states = np.array(rig.states)
    assert set(rig.fallbacks()) == {Fallback.NONE}
    assert min(np.hypot(states[:, 0] - n, states[:, 1] - e).min() for n, e in PILLARS) > 0.46 - 0.01
    assert (1.5 - np.abs(states[:, 1])).min() > 0.3 - 0.01
    assert np.hypot(states[:, 4], states[:, 5]).max() < 0.5 + 0.31, "the jump itself is speed through the water"
    assert np.hypot(states[400:, 4], states[400:, 5]).max() < 0.52


def test_an_obstacle_uploaded_onto_the_nose_pushes_out_and_says_so() -> None:
    rig = Rig(START)
    far = goal(2.0, -0.35, 0.45, 0.0)
    rig.fly(far, 4.0)
    nose = rig.x[:2] + np.array([0.35, 0.0])
    rig.fence = Fence(exclusions=(Circle(center_ned_m=nose, radius_m=0.2),), depth_max_m=5.0)
    hit = len(rig.outputs)
    rig.fly(far, 1.5)
    statuses = [output.status for output in rig.outputs[hit:]]
    assert all(status.status is SolveStatus.OK for status in statuses)
    assert max(status.slack_max for status in statuses) > 0.01, "inside the keep-out: the limit cannot be kept"
    assert max(status.penalty_use for status in statuses) > 0.9
    rig.fly(far, 20.0)
    away = np.hypot(*(np.array(rig.states)[:, :2] - nose).T)
    assert away[-500:].min() > 0.5 - 0.01, "out of it again"
    assert np.hypot(*(rig.x[:2] - far.pos_ned_m[:2])) < 0.1, "and round it to the goal"


def test_the_operator_hears_of_limits_that_are_given_up_once() -> None:
    watch = PenaltyWatch()
    for _ in range(PATIENCE_STEPS - 1):
        watch.watch(1.0)
    watch.watch(0.2)
    assert watch.take_notices() == []
    for _ in range(3 * PATIENCE_STEPS):
        watch.watch(1.0)
    assert watch.take_notices() == [LIMITS_GIVEN_UP()]
    assert len(LIMITS_GIVEN_UP.template) <= 50, "one STATUSTEXT"


def test_nothing_to_follow_means_no_inner_loop() -> None:
    controller, params = MotionController(VEHICLE, cpu_clock=lambda: 0.0), ParamSet()
    assert controller.tick(0, nav_state(0, START)) is None
    controller.step(10_000, nav_state(10_000, START), B, TANK, params)
    assert controller.tick(20_000, nav_state(20_000, START)) is not None
    none = controller.tick(30_000, nav_state(30_000, np.full(8, math.nan)))
    assert none is not None
    assert not none.any(), "what is no state gives no thrust, not that of before"
    params.set("MPC_TIGHTEN", 0)
    controller.step(50_000, nav_state(50_000, START), B, TANK, params)
    assert controller.tick(60_000, nav_state(60_000, START)) is None, "fixed margins credit no feedback"
    controller.reset()
    assert controller.tick(70_000, nav_state(70_000, START)) is None


@pytest.mark.parametrize("inner", [True, False])
def test_the_inner_loop_holds_yaw_under_a_slow_optimiser(inner: bool) -> None:
    """Munk: at 0.5 m/s with a step every 0.2 s and a push on the yaw; see autopilot.analysis.munk for the table."""
    from autopilot.analysis.munk import munk_case

    row = munk_case(inner=inner, seconds=8.0)
    assert row.speed_m_s > 0.42
    if inner:
        assert row.yaw_rms_deg < 2.0
    else:
        assert row.yaw_rms_deg > 1.2 * munk_case(inner=True, seconds=8.0).yaw_rms_deg


def test_the_vehicle_is_where_its_plans_said_within_the_tube() -> None:
    """Random pushes within the bounds, the whole controller in the loop: promises 0.5 s ahead are kept."""
    rig = Rig(START)
    rig.fence = TANK
    rng = np.random.default_rng(3)
    mixing = np.linalg.inv(np.array(MODEL.allocation))
    w = np.zeros(4)
    for _ in range(40):
        w = np.clip(0.8 * w + 0.6 * rng.normal(size=4) / 3.0, -1.0, 1.0)
        rig.push_n = mixing @ (w * np.array([1.0, 1.0, 1.0, 0.1]))
        rig.fly(B if rig.tick < 1000 else A, 0.25)
    assert (rig.audit.fraction(0.5) or 0.0) >= 0.999
    assert set(rig.fallbacks()) == {Fallback.NONE}
    assert still(rig.x).any() == 0.0
