"""The optimiser: the QP's answer against IPOPT on the same problem, the choice of a solver, the checks of a result."""

import dataclasses
import math

import numpy as np
import pytest
from control_loop import MODEL, TANK

from autopilot.analysis.ipopt import IpoptNmpc
from autopilot.control.constraints.obstacles import Features
from autopilot.control.nmpc import ocp
from autopilot.control.nmpc import solver as native
from autopilot.control.nmpc.grid import geometric_grid, uniform_grid
from autopilot.control.nmpc.solver import PLANES, Nmpc, NmpcProblem, QpStep, choose_step, passes_self_test
from autopilot.control.path.planner import Planner
from autopilot.control.path.reference import ReferenceRollout, ReferenceTarget, Route
from autopilot.core.control_allocator import ControlAllocator
from autopilot.core.errors import ConfigError
from autopilot.core.messages import SolveStatus

RADIUS_M = 0.33
WEIGHTS = np.array([20.0, 20.0, 40.0, 3.0, 8.0, 8.0, 8.0, 0.5, 0.02, 0.02, 0.02, 0.02])


def problem(grid, x0: np.ndarray, goal=(1.75, 0.0), yaw: float = -math.pi, planes: int = PLANES) -> NmpcProblem:
    path = Planner(TANK, RADIUS_M).path(x0[:2], np.array(goal))
    assert path is not None
    current = np.array([0.1, -0.08, 0.0])
    target = ReferenceTarget(
        route=Route(path),
        s0_m=0.0,
        depth_m=0.3,
        yaw_rad=yaw,
        cruise_m_s=0.35,
        speed_limit_m_s=0.46,
        heave_limit_m_s=0.25,
        yaw_rate_limit_rad_s=1.0,
    )
    reference, thrust_n = ReferenceRollout(ControlAllocator(MODEL), grid.t_s)(x0, target, current, np.full(4, np.inf))
    normals, offsets = np.zeros((grid.n - 1, planes, 2)), np.zeros((grid.n - 1, planes))
    Features(TANK).half_planes(reference[: grid.n, :2], grid.t_s[: grid.n], RADIUS_M, planes, normals, offsets)
    return NmpcProblem(
        x0=x0,
        x_ref=reference,
        thrust_ref_n=thrust_n,
        current_ned_m_s=np.broadcast_to(current, (grid.n, 3)),
        weight_x=WEIGHTS[:8],
        weight_u=WEIGHTS[8:],
        terminal=np.diag(20.0 * WEIGHTS[:8]),
        limits=np.array([0.46, 0.23, 0.92, 0.05, 1.2]),
        thrust_limit_n=np.full(4, 12.0),
        plane_n=normals,
        plane_d_m=offsets,
        buoyancy_excess_n=np.array([MODEL.buoyancy_excess_n]),
    )


GRID_20 = geometric_grid(20, 8.0)
TIGHT = {"mode": "robust", "iter_max": 200, **{f"res_{name}_max": 1e-9 for name in "gbdm"}}
EXACT = ocp.QpBackend(plugin="hpipm", options={"hpipm": TIGHT}, staged=True)
"""What solvers are compared with; built once."""
START = np.array([-1.3, -0.2, 0.45, 0.3, 0.3, 0.05, 0.0, -0.2])


@pytest.mark.parametrize("grid", [uniform_grid(12), geometric_grid(12, 4.0)], ids=["uniform", "geometric"])
def test_repeated_qps_reach_what_ipopt_finds(grid) -> None:
    task = problem(grid, START)
    slow = IpoptNmpc(MODEL, grid, PLANES, 1e-9)
    slow.set_plan(task.x_ref, np.zeros((grid.n, 4)))
    x, u, solved = slow.solve(task)
    assert solved
    for backend in (ocp.HPIPM, ocp.PIQP, ocp.NATIVE):
        fast = Nmpc(MODEL, grid, backends=(backend,))
        assert fast.solver == backend.plugin
        fast.set_plan(task.x_ref, np.zeros((grid.n, 4)))
        for _ in range(10):
            result = fast.solve(task)
            assert result.status is SolveStatus.OK
        assert result.gap_max < 1e-6
        assert np.allclose(result.thrust_n, u, atol=0.05)
        assert np.allclose(result.x, x, atol=0.003)


@pytest.mark.parametrize("x0", [START, np.array([-1.2, -0.2, 0.45, 0.8, 0.5, 0.15, 0.1, 0.7])])
def test_constraints_hold_in_the_plan(x0: np.ndarray) -> None:
    grid = geometric_grid(20, 8.0)
    task = problem(grid, x0)
    fast = Nmpc(MODEL, grid)
    fast.set_plan(task.x_ref, np.zeros((grid.n, 4)))
    for _ in range(10):
        result = fast.solve(task)
    x = result.x[4:]
    assert (np.hypot(x[:, 4], x[:, 5]) <= 0.461).all()
    assert (np.abs(x[:, 6]) <= 0.231).all()
    assert (np.abs(x[:, 7]) <= 0.921).all()
    assert (np.abs(result.thrust_n) <= 12.0).all()
    assert Features(TANK).clearance_m(result.x[1:20, :2]).min() > RADIUS_M - 2e-3


def test_thrust_limits_are_per_thruster() -> None:
    grid = geometric_grid(20, 8.0)
    limit = np.array([12.0, 3.0, 1.0, 0.5])
    task = dataclasses.replace(problem(grid, START), thrust_limit_n=limit)
    fast = Nmpc(MODEL, grid)
    fast.set_plan(task.x_ref, np.zeros((grid.n, 4)))
    for _ in range(5):
        result = fast.solve(task)
        assert result.status is SolveStatus.OK
        assert (np.abs(result.thrust_n) <= limit).all()


def test_first_solver_that_works_is_taken() -> None:
    grid = uniform_grid(5)
    missing = ocp.QpBackend(plugin="no_such_plugin", options={}, staged=False)
    step, passed_over = choose_step(MODEL, grid, 2, (missing, ocp.PIQP))
    assert step.backend.plugin == "piqp"
    assert len(passed_over) == 1 and "no_such_plugin" in passed_over[0]
    assert Nmpc(MODEL, grid, backends=(ocp.HPIPM, ocp.PIQP)).solver == "hpipm"
    with pytest.raises(ConfigError, match="no_such_plugin"):
        choose_step(MODEL, grid, 2, (missing,))


@pytest.mark.parametrize("amount", [1.0, math.nan])
def test_self_test_rejects_wrong_answers(monkeypatch: pytest.MonkeyPatch, amount: float) -> None:
    grid = uniform_grid(10)
    step = QpStep(MODEL, grid, 2, ocp.HPIPM)
    assert passes_self_test(step, MODEL, grid)
    evaluate = QpStep.evaluate

    def spoiled(self: QpStep) -> None:
        evaluate(self)
        self.u[0, 0] += amount
        self.figures[4] += amount

    monkeypatch.setattr(QpStep, "evaluate", spoiled)
    assert not passes_self_test(step, MODEL, grid)
    with pytest.raises(ConfigError, match="self-test"):
        choose_step(MODEL, grid, 2, (ocp.HPIPM,))


def test_not_finite_input_is_reported_and_the_plan_stays() -> None:
    grid = geometric_grid(20, 8.0)
    task = problem(grid, START)
    fast = Nmpc(MODEL, grid)
    fast.set_plan(task.x_ref, np.zeros((grid.n, 4)))
    assert fast.solve(task).status is SolveStatus.OK
    before = fast.u.copy()
    bad = START.copy()
    bad[4] = math.nan
    result = fast.solve(dataclasses.replace(task, x0=bad))
    assert result.status in (SolveStatus.NOT_FINITE, SolveStatus.RESIDUAL, SolveStatus.EXCEPTION)
    assert np.array_equal(fast.u, before)
    assert fast.solve(task).status is SolveStatus.OK


@pytest.mark.parametrize("backend", [ocp.NATIVE, ocp.HPIPM, ocp.PIQP], ids=lambda backend: backend.plugin)
def test_a_wish_that_is_no_number_is_refused_by_every_solver(backend: ocp.QpBackend) -> None:
    task, nmpc = problem(GRID_20, START), Nmpc(MODEL, GRID_20, backends=(backend,))
    nmpc.set_plan(task.x_ref, np.zeros((20, 4)))
    for name in (f.name for f in dataclasses.fields(NmpcProblem)):
        spoiled = np.array(getattr(task, name))
        spoiled[np.unravel_index(spoiled.size // 2, spoiled.shape)] = math.nan
        result = nmpc.solve(dataclasses.replace(task, **{name: spoiled}))
        assert result.status is SolveStatus.NOT_FINITE, name
        assert not nmpc.u.any()
    assert nmpc.solve(task).status is SolveStatus.OK


def test_solvers_find_the_same_thrust_far_from_the_plan() -> None:
    rng, task = np.random.default_rng(1), problem(GRID_20, START)
    best, *others = (Nmpc(MODEL, GRID_20, backends=(b,)) for b in (EXACT, ocp.NATIVE, ocp.HPIPM, ocp.PIQP))
    for turn in range(20):
        x0 = START + (1.0, 3.0)[turn % 2] * rng.normal(size=8) * [0.1, 0.1, 0.05, 0.2, 0.1, 0.1, 0.05, 0.2]
        aside = dataclasses.replace(task, x0=x0)
        for nmpc in (best, *others):
            nmpc.set_plan(task.x_ref, np.zeros((20, 4)))
            assert nmpc.solve(aside).status is SolveStatus.OK
        for nmpc in others:
            assert np.allclose(nmpc.u[0], best.u[0], atol=5e-3), nmpc.solver


def test_unsolved_qp_is_reported() -> None:
    grid = geometric_grid(20, 8.0)
    task = problem(grid, START)
    fast = Nmpc(MODEL, grid)
    fast.set_plan(task.x_ref, np.zeros((grid.n, 4)))
    impossible = dataclasses.replace(task, thrust_limit_n=np.full(4, -1.0))
    assert fast.solve(impossible).status is not SolveStatus.OK


def test_native_solver_gives_what_hpipm_gives_at_a_tight_tolerance() -> None:
    grid = GRID_20
    exact = QpStep(MODEL, grid, PLANES, EXACT)
    step = native.NativeStep(MODEL, grid, PLANES, ocp.NATIVE)
    rng = np.random.default_rng(5)
    names = (*native.ARRAYS[5:15], "plane_n", "plane_d")
    for _ in range(20):
        start = START + rng.normal(size=8) * [0.3, 0.1, 0.2, 0.5, 0.2, 0.2, 0.1, 0.5]
        task = problem(grid, start)
        values = (
            *(task.x_ref, np.zeros((grid.n, 4)), task.x_ref, task.thrust_ref_n, task.current_ned_m_s, task.weight_x),
            *(task.weight_u, task.terminal, task.limits, task.thrust_limit_n, task.plane_n, task.plane_d_m),
        )
        for one in (exact, step):
            for name, value in zip(names, values, strict=True):
                getattr(one, name)[:] = value
            one.x_guess[0] = start
            one.evaluate()
        assert step.figures[7] == 0.0
        assert step.figures[6] <= 30
        assert np.allclose(step.u, exact.u, atol=2e-3)
        assert np.allclose(step.x, exact.x, atol=1e-3)
        assert step.figures[0] == pytest.approx(exact.figures[0], rel=1e-4, abs=1e-3)
        assert step.figures[5] == pytest.approx(exact.figures[5], abs=1e-3)


@pytest.mark.parametrize("wild", [1e3, math.inf, math.nan])
def test_a_guess_that_has_run_away_is_not_solved_around(wild: float, capfd: pytest.CaptureFixture[str]) -> None:
    nmpc = Nmpc(MODEL, uniform_grid(12))
    task = problem(nmpc.grid, START)
    nmpc.set_plan(task.x_ref, np.zeros((12, 4)))
    nmpc.x[5, 4] = wild
    assert nmpc.solve(task).status is SolveStatus.NOT_FINITE
    assert capfd.readouterr().out == ""
