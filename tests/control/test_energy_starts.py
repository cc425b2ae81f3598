"""Trajectories that begin at the vehicle's limits or a little beyond, and what their program is made of."""

from typing import Any

import casadi as ca
import numpy as np
import pytest
from control_loop import MODEL, VEHICLE, goal

from autopilot.control.energy import shooting
from autopilot.control.energy.flow import FlowSamples
from autopilot.control.energy.patience import Kind
from autopilot.control.energy.power import PowerModel
from autopilot.control.energy.request import Plan, TrajectoryRequest
from autopilot.control.energy.search import EnergyPlanner
from autopilot.control.energy.trajectory import Program, Trajectory
from autopilot.core import compiled
from autopilot.core.frames import FloatArray
from autopilot.core.geometry import Fence
from autopilot.core.messages import Goal

POWER = PowerModel.of(VEHICLE)
PLANNER = EnergyPlanner(MODEL, POWER)
DEEPEST_M = 60.0


def quick(x0: FloatArray, to: Goal, stream: FloatArray, cap_m_s: float) -> Plan:
    """The plan to set out with in open water."""
    axis, current = np.linspace(-30.0, 30.0, 9), np.zeros((9, 9, 3))
    current[..., :2] = stream
    request = TrajectoryRequest(
        x0=x0,
        goal=to,
        fence=Fence(depth_max_m=DEEPEST_M),
        radius_m=0.33,
        flow=FlowSamples(north_m=axis, east_m=axis, current_ned_m_s=current),
        limits=np.array([cap_m_s, 0.24, 0.96, 0.05, DEEPEST_M]),
        thrust_limit_n=np.full(4, 11.5),
        buoyancy_excess_n=MODEL.buoyancy_excess_n,
        cruise_m_s=to.speed_m_s,
        kind=Kind.QUICK,
    )
    return PLANNER.plan(request)


@pytest.mark.parametrize("surge", [0.34, 0.349, 0.35, 0.351, 0.36])
def test_a_leg_that_begins_at_the_cruise_speed_is_planned(surge: float) -> None:
    x0 = np.array([-0.53, -0.35, 0.45, 0.0, surge, 0.0, 0.0, 0.0])
    plan = quick(x0, goal(3.0, -0.35, 0.45, None), np.zeros(2), 0.41)
    assert plan.trajectory is not None, plan.why
    assert plan.energy_j == pytest.approx(200.5, abs=1.0)


@pytest.mark.parametrize("seed", range(6))
def test_a_dive_or_a_turn_on_the_spot_is_planned(seed: int) -> None:
    """A guess of half a second, as there is no way to go, left no time for either: none of these was solved, in 150
    iterations each, and it was asked for again and again."""
    rng = np.random.default_rng(seed)
    place, depth = rng.uniform(-1.0, 1.0, 2), float(rng.uniform(6.0, 40.0))
    dive, turn = ((1.0, 0.0), (0.0, 1.0), (1.0, 1.0))[seed % 3]
    start = depth - dive * float(rng.choice([-1.0, 1.0]) * rng.uniform(1.0, 4.0))
    yaw = turn * float(rng.uniform(1.5, 3.1)) if turn else None
    x0 = np.array([*(place + rng.uniform(-0.05, 0.05, 2)), start, *np.zeros(5)])
    plan = quick(x0, goal(*place, depth, yaw), np.zeros(2), 0.5)
    assert plan.trajectory is not None, plan.why
    end = plan.trajectory.x[-1]
    assert np.linalg.norm(end[:3] - [*place, depth]) < 0.3 and (yaw is None or abs(end[3] - yaw) < 0.15)


def test_small_thrusts_do_not_swing_from_side_to_side(monkeypatch: pytest.MonkeyPatch) -> None:
    """Newton's step on |F|^1.5 goes from F to -F: one in six of these took more than 50 iterations."""
    counts = []
    solve = Program.solve

    def counted(program: Program, *arguments: Any, **more: Any) -> Trajectory:
        found = solve(program, *arguments, **more)
        counts.append(program.iterations)
        return found

    monkeypatch.setattr(Program, "solve", counted)
    rng = np.random.default_rng(7)
    for _ in range(10):
        cruise, surge = float(rng.choice([0.2, 0.3, 0.35])), float(rng.choice([0.9, 0.999, 1.0, 1.001, 1.05]))
        x0 = np.array([0.0, 0.0, 0.45, rng.choice([0.0, 0.3, -1.0]), surge * cruise, 0.0, 0.0, 0.0])
        to = goal(float(rng.choice([2.5, 3.5, 6.0])), 0.0, float(rng.choice([0.45, 0.65])), None, speed_m_s=cruise)
        assert quick(x0, to, rng.uniform(-0.1, 0.1, 2), 0.41).trajectory is not None
    assert np.quantile(counts, 0.9) < 40


def test_no_leg_is_too_short_or_without_heading_to_be_planned() -> None:
    """Straight down, a turn on the spot, a goal astern that asks for no heading: guesses took no time for depth or
    turn, or turned at once: two of these were not solved, others took 60 to 150 iterations."""
    rng = np.random.default_rng(5)
    for case in range(30):
        x0 = np.array([0.0, 0.0, rng.uniform(5.0, 6.0), rng.uniform(-3.0, 3.0), *rng.uniform(-0.05, 0.05, 3), 0.0])
        way_m, bearing = float(rng.choice([0.0, 0.1, 0.29, 0.6, 1.0, 1.5, 3.0, 5.0])), rng.uniform(-3.0, 3.0)
        depth = x0[2] + float(rng.choice([-0.6, -0.3, 0.0, 0.01, 0.25, 0.4]))
        yaw = None if case % 2 else float(x0[3] + rng.choice([0.0, 0.3, 1.5, 3.0]))
        to = goal(way_m * np.cos(bearing), way_m * np.sin(bearing), depth, yaw)
        plan = quick(x0, to, rng.uniform(-0.15, 0.15, 2), 0.41)
        assert plan.trajectory is not None, (case, plan.why)


def test_the_programs_derivatives_are_those_of_its_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shooting, "SMALL_THRUST_N", 1e-12)
    flown = shooting.Shooting(MODEL, POWER, 4, 2)
    # CasADi cannot derive what is compiled.
    monkeypatch.setenv(compiled.SWITCH, compiled.OFF)
    made = shooting.Shooting(MODEL, POWER, 4, 2)
    z, p, cost, rows = (made.program[name] for name in ("x", "p", "f", "g"))
    of_cost, of_rows = ca.MX.sym("of_cost"), ca.MX.sym("of_rows", rows.shape[0])
    whole, _ = ca.hessian(of_cost * cost + ca.dot(of_rows, rows), z)
    exact = ca.Function("exact", [z, p, of_cost, of_rows], [rows, ca.jacobian(rows, z), ca.triu(whole)])
    rng = np.random.default_rng(1)
    point = 0.2 * rng.normal(size=z.shape[0])
    point[-1] = 2.0
    at = (point, 0.2 * rng.normal(size=p.shape[0]))
    weights = (1.3, rng.normal(size=rows.shape[0]))
    g, jacobian, hessian = (value.full() for value in exact(*at, *weights))
    found = [value.full() for value in flown.derivatives["jac_g"](*at)]
    assert np.allclose(found[0], g, atol=1e-12)
    assert np.allclose(found[1], jacobian, atol=1e-9)
    second = flown.derivatives["hess_lag"](*at, *weights)
    assert second.sparsity().is_triu()
    assert np.allclose(second.full(), hessian, atol=1e-8 * max(1.0, float(np.abs(hessian).max())))
