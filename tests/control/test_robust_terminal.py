"""Terminal regions: steady input, cost, certificate, and the cases that do not fit."""

import dataclasses
import math
from dataclasses import replace

import numpy as np
import pytest
from control_loop import MODEL, VEHICLE, A, B, goal, nav_state
from hypothesis import given, settings
from hypothesis import strategies as st

from autopilot.control.controller import MotionController
from autopilot.control.robust.regions import TerminalRegions
from autopilot.control.robust.riccati import discretise
from autopilot.control.robust.robust_tuning import REGIONS, TERMINAL
from autopilot.control.robust.terminal import (
    Terminal,
    TerminalLimits,
    analytic_alpha,
    certify,
    closed_loop,
    region_error,
    terminal_law,
    unit_samples,
    violations,
)
from autopilot.core import model4
from autopilot.core.background import BackgroundWorker
from autopilot.core.control_allocator import ControlAllocator
from autopilot.core.frames import FloatArray
from autopilot.core.geometry import Circle, Fence
from autopilot.core.messages import Goal, Severity
from autopilot.core.params import ParamSet

Q = np.array([20.0, 20.0, 40.0, 3.0, 8.0, 8.0, 8.0, 0.5])
R = np.full(4, 0.02)
SHARING, LIMIT_N = ControlAllocator(MODEL), np.full(4, 12.0)
FEW = unit_samples(4_000)
flows = st.tuples(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3))


def limits(**changes: object) -> TerminalLimits:
    """Of the paper's tank at waypoint B, margins taken off."""
    usual = TerminalLimits(
        thrust_n=np.full(4, 11.0),
        planar_speed_m_s=0.46,
        heave_m_s=0.23,
        yaw_rate_rad_s=0.92,
        depth_min_m=0.06,
        depth_max_m=1.19,
        clearance_m=0.3225,
    )
    return dataclasses.replace(usual, **changes)


def law_of(goal: Goal, current: tuple[float, float]) -> Terminal:
    assert goal.yaw_rad is not None
    return terminal_law(SHARING, goal.yaw_rad, np.array([*current, 0.0]), Q, R, LIMIT_N)


@given(flows, st.floats(-3.1, 3.1))
@settings(max_examples=40, deadline=None)
def test_steady_input_holds_the_goal_in_the_current(current: tuple[float, float], yaw: float) -> None:
    law = terminal_law(SHARING, yaw, np.array([*current, 0.0]), Q, R, LIMIT_N)
    state = [1.0, 2.0, 0.3, yaw, *law.nu.tolist()]
    rate = model4.state_derivative(MODEL, state, law.thrust_n.tolist(), (*current, 0.0), math)
    assert np.abs(rate).max() < 1e-9
    after, cost = closed_loop(MODEL, law, np.zeros((1, 8)))
    assert np.abs(after).max() < 1e-9 and cost[0] == 0.0


@given(flows, st.floats(-3.1, 3.1))
@settings(max_examples=25, deadline=None)
def test_cost_solves_the_inflated_lyapunov_equation(current: tuple[float, float], yaw: float) -> None:
    law = terminal_law(SHARING, yaw, np.array([*current, 0.0]), Q, R, LIMIT_N)
    h = 1e-6
    columns = []
    for i in range(8):
        step = np.zeros((1, 8))
        step[0, i] = h
        columns.append((closed_loop(MODEL, law, step)[0] - closed_loop(MODEL, law, -step)[0])[0] / (2.0 * h))
    closed = np.array(columns).T
    wanted = -TERMINAL.kappa * (np.diag(Q) + law.k.T @ np.diag(R) @ law.k)
    residual = closed.T @ law.p @ closed - law.p - wanted
    assert np.abs(residual).max() < 2e-2 * np.abs(law.p).max()
    assert np.linalg.eigvalsh(law.p).min() > 0.0
    turned = law.cost_ned()
    assert np.allclose(np.linalg.eigvalsh(turned), np.linalg.eigvalsh(law.p))


@pytest.mark.parametrize("current", [(0.0, 0.0), (0.15, 0.0), (0.0, -0.25)])
@pytest.mark.parametrize("goal", [A, B], ids="AB")
def test_certificate_holds_on_fresh_samples(goal: Goal, current: tuple[float, float]) -> None:
    law = law_of(goal, current)
    certificate = certify(MODEL, law, goal, limits(), FEW)
    assert certificate.alpha > 0.0 and certificate.violations == 0 and certificate.samples == len(FEW)
    fresh = unit_samples(4_000, seed=7)
    error = math.sqrt(certificate.alpha) * fresh @ np.linalg.inv(np.linalg.cholesky(law.p))
    assert violations(MODEL, law, error) == 0
    after, _ = closed_loop(MODEL, law, error)
    assert np.einsum("mi,ij,mj->m", after, law.p, after).max() <= certificate.alpha, "the region is invariant"
    thrust = law.thrust_n + error @ law.k.T
    assert np.abs(thrust).max() <= 11.0 + 1e-9
    assert np.abs(error[:, 3]).max() <= goal.accept_yaw_rad + 1e-9
    assert np.hypot(error[:, 0], error[:, 1]).max() <= min(0.3225, certificate.radius_m) + 1e-9


def test_every_limit_can_bind_and_is_named() -> None:
    law = law_of(B, (0.1, 0.0))
    for changes, name in (
        ({"clearance_m": 0.01}, "clearance"),
        ({"planar_speed_m_s": 0.11}, "planar speed"),
        ({"heave_m_s": 0.002}, "heave speed"),
        ({"yaw_rate_rad_s": 0.01}, "yaw rate"),
        ({"depth_max_m": 0.305}, "depth"),
        ({"thrust_n": np.array([11.0, 11.0, 0.7, 11.0])}, "thruster 3 thrust"),
    ):
        alpha, binding = analytic_alpha(law, B, limits(**changes))
        assert binding == name and 0.0 < alpha < analytic_alpha(law, B, limits())[0]


def test_a_goal_whose_ball_does_not_fit_gets_a_smaller_region_and_says_so() -> None:
    law = law_of(B, (0.0, 0.0))
    certificate = certify(MODEL, law, B, limits(clearance_m=0.0225), FEW)
    assert not certificate.fits and 0.0 < certificate.radius_m <= 0.0225 + 1e-9
    assert certificate.binding == "clearance" and "0.022 m of clearance, region made smaller" in certificate.text
    nothing = certify(MODEL, law, B, limits(clearance_m=-0.01), FEW)
    assert nothing.alpha == 0.0 and "no terminal region: the goal is beyond its clearance limit" in nothing.text
    fast = terminal_law(SHARING, 0.0, np.array([0.6, 0.0, 0.0]), Q, R, LIMIT_N)
    assert certify(MODEL, fast, A, limits(), FEW).binding == "planar speed"


def test_sampling_shrinks_a_region_in_which_the_decrease_fails() -> None:
    """A gain that is made useless far out: the sampled level is lower than the limits allow."""
    wide = dataclasses.replace(A, accept_radius_m=5.0, accept_yaw_rad=3.0)
    law = law_of(wide, (0.2, 0.2))
    roomy = limits(
        thrust_n=np.full(4, 400.0),
        planar_speed_m_s=9.0,
        heave_m_s=9.0,
        yaw_rate_rad_s=9.0,
        depth_min_m=-9.0,
        depth_max_m=9.0,
        clearance_m=9.0,
    )
    certificate = certify(MODEL, law, wide, roomy, FEW)
    assert certificate.shrunk > 0 and certificate.binding == "decrease" and certificate.violations == 0
    assert 0.0 < certificate.alpha < analytic_alpha(law, wide, roomy)[0]


def test_region_error_turns_into_the_frame_of_the_goal() -> None:
    law = law_of(B, (0.1, 0.05))
    x = np.array([B.pos_ned_m[0] - 0.1, B.pos_ned_m[1] + 0.05, 0.35, math.pi - 2.0 * math.pi + 0.02, *law.nu])
    error = region_error(law, x, B.pos_ned_m)
    assert np.allclose(error, [0.1, -0.05, 0.05, 0.02, 0.0, 0.0, 0.0, 0.0], atol=1e-12)


def test_regions_are_certified_beside_the_loop_and_told_to_the_log_once() -> None:
    regions = TerminalRegions(SHARING, BackgroundWorker())
    still = np.zeros(3)
    steps = 0
    while regions.certificate is None:
        regions.follow(B, math.pi, still, 0.3225, limits, Q, R)
        assert regions.law is not None, "the law is there at once"
        steps += 1
        assert steps < 200
    assert steps == REGIONS.answer_steps + 1
    assert regions.certificate.samples == TERMINAL.samples
    news = regions.take_notices()
    assert len(news) == 1 and news[0][0] is Severity.DEBUG and "Item 0: alpha" in news[0][1]
    for _ in range(2 * steps):
        regions.follow(B, math.pi, np.array([0.07, 0.0, 0.0]), 0.3225, limits, Q, R)
    assert regions.take_notices() == [], "another current, the same story"
    assert regions.law is not None and regions.law.nu[0] == pytest.approx(0.07)
    end = np.array([*B.pos_ned_m, math.pi, *regions.law.nu])
    assert regions.cost_at(end, B) is not None
    assert regions.cost_at(end + np.array([0.1, 0, 0, 0, 0, 0, 0, 0]), B) is None


@pytest.mark.parametrize("cost", [0.0, 1.0])
def test_the_controller_certifies_its_goal_while_it_flies(cost: float) -> None:
    """By least energy the region is no cost of the program: its size is told, and no sample is looked at."""
    controller, params = MotionController(VEHICLE, cpu_clock=lambda: 0.0), ParamSet({"MPC_COST": cost})
    x: FloatArray = np.array([*A.pos_ned_m, 0.0, 0.0, 0.0, 0.0, 0.0])
    fence = Fence(exclusions=(Circle(center_ned_m=np.array([0.9375, 0.0]), radius_m=0.16),), depth_max_m=1.2)
    for step in range(90):
        controller.step(step * 50_000, nav_state(step * 50_000, x), A, fence, params)
    certificate = controller.regions.certificate
    assert certificate is not None and certificate.alpha > 0.0 and certificate.violations == 0
    assert certificate.samples == (0 if cost else TERMINAL.samples)
    assert [severity for severity, text in controller.take_news() if "alpha" in text] == [Severity.DEBUG]


def test_a_goal_without_a_region_is_something_to_mend() -> None:
    regions = TerminalRegions(SHARING, BackgroundWorker())
    for _ in range(2 * REGIONS.answer_steps):
        regions.follow(B, math.pi, np.zeros(3), -0.01, lambda: limits(clearance_m=-0.01), Q, R)
    told = [text for severity, text in regions.take_notices() if severity <= Severity.INFO]
    assert told == ["Item 0: no margin left to the clearance limit, move it"]
    regions.follow(replace(A, seq=1), 0.0, np.zeros(3), 0.3225, limits, Q, R)
    assert regions.take_notices() == [], "the next goal is not to be moved for it"


def told_at(pos_north_m: float, to: Goal, stream: tuple[float, float, float], seconds: float = 2.5) -> list[str]:
    """What the operator hears of a controller that is kept at a place in a stream."""
    controller, params = MotionController(VEHICLE, cpu_clock=lambda: 0.0), ParamSet({"MPC_COST": 0})
    x = np.array([pos_north_m, 0.0, 0.6, 0.0, -stream[0], -stream[1], 0.0, 0.0])
    for step in range(round(seconds / 0.05)):
        nav = nav_state(step * 50_000, x, np.array(stream))
        controller.step(step * 50_000, nav, to, Fence(depth_max_m=1.2), params)
    return [text for severity, text in controller.take_news() if severity <= Severity.INFO]


STAY = goal(0.5, 0.0, 0.6, None, seq=3)


@pytest.mark.parametrize(
    ("north_m", "to", "stream", "told"),
    [
        (0.0, STAY, (-0.47, 0.0, 0.0), ["Item 3: current 0.47 m/s, too fast to stay"]),
        (0.0, replace(STAY, following=goal(-9.0, 0.0, 0.6, None)), (0.47, 0.0, 0.0), []),
        (-9.0, STAY, (-0.47, 0.0, 0.0), []),
        (0.0, STAY, (-0.2, 0.0, 0.0), []),
    ],
    ids=["stays", "is carried through", "far away", "slow water"],
)
def test_a_current_is_said_to_be_too_fast_only_where_the_vehicle_is_to_stay_in_it(
    north_m: float, to: Goal, stream: tuple[float, float, float], told: list[str]
) -> None:
    assert told_at(north_m, to, stream) == told


@pytest.mark.parametrize("cost", [0.0, 1.0])
@pytest.mark.parametrize("depth_m", [0.1, 0.3, 1.1])
def test_a_goal_is_not_to_be_moved_because_the_depth_is_in_doubt_when_it_appears(depth_m: float, cost: float) -> None:
    """Dead reckoning lets the depth's variance grow; a goal that appeared at its end was called beyond its limit."""
    controller, params = MotionController(VEHICLE, cpu_clock=lambda: 0.0), ParamSet({"MPC_COST": cost})
    to, x = goal(0.5, 0.0, depth_m, None, seq=1), np.array([0.0, 0.0, 0.6, 0.0, 0.0, 0.0, 0.0, 0.0])
    doubt = np.zeros(12)
    doubt[:3] = 0.05**2, 0.05**2, 0.16**2
    for step in range(2 * REGIONS.answer_steps):
        nav = nav_state(step * 50_000, x)
        nav = replace(nav, variance=doubt) if step < 5 else nav
        controller.step(step * 50_000, nav, to, Fence(depth_max_m=1.2), params)
    told = controller.take_news()
    assert [text for severity, text in told if severity <= Severity.INFO] == []
    assert any("alpha" in text for _, text in told), "the goal has been certified meanwhile"


def test_zero_order_hold_of_the_goal_is_that_of_the_law() -> None:
    law = law_of(A, (0.0, 0.0))
    a, b = discretise(np.zeros((2, 2)), np.eye(2), 0.1)
    assert np.allclose(a, np.eye(2)) and np.allclose(b, 0.1 * np.eye(2))
    assert law.k.shape == (4, 8) and law.thrust_n[2] == pytest.approx(0.6, abs=1e-9), "buoyancy is held down"
