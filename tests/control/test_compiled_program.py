"""Limits and bounds of a program by the compiled library against those of the code that says what they mean."""

import sys
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from autopilot.analysis.nmpc_flight import fly
from autopilot.bench.nmpc import START
from autopilot.control.bounds import Gaps, PlanRoom, ProgramBounds
from autopilot.control.controller import MotionController
from autopilot.control.nmpc.grid import uniform_grid
from autopilot.control.robust.tightening import BackOffs
from autopilot.core import compiled
from autopilot.core.frames import FloatArray
from autopilot.core.geometry import Fence
from autopilot.core.messages import ControlOutput
from autopilot.core.params import ParamSet
from autopilot.core.vehicle import load_vehicle
from tests.hostile_numbers import HOSTILE, agree, with_one

needs_library = pytest.mark.skipif(compiled.missing() is not None, reason="not compiled")
MADE = ("limits", "thrust_n", "keep_m", "tube_m", "held_ref_n", "held_weight")


@needs_library
@pytest.mark.parametrize("thrusters", [4, 7])
def test_bounds_are_those_of_the_code_that_says_what_they_mean(thrusters: int) -> None:
    rng, grid, params = np.random.default_rng(thrusters), uniform_grid(9), ParamSet()
    ours, plain = (ProgramBounds(grid, thrusters, 0.2) for _ in range(2))
    plain._call = None
    for _ in range(100):
        states = rng.uniform(0.0, 0.6, (5, grid.n - 1))
        names = ("clearance_m", "depth_m", "planar_speed_m_s", "heave_m_s", "yaw_rate_rad_s")
        back_off = BackOffs(
            **dict(zip(names, states, strict=True)), thrust_n=rng.uniform(0.0, 6.0, (grid.n, thrusters))
        )
        fence = Fence(
            inclusions=(), exclusions=(), depth_min_m=rng.uniform(0.0, 0.5), depth_max_m=rng.uniform(0.8, 2.0)
        )
        now = SimpleNamespace(
            x0=rng.normal(size=8), params=params, fence=fence, thrust_limit_n=rng.choice([0.0, 5.0, 12.0], thrusters)
        )
        wished = SimpleNamespace(
            thrust_n=8.0 * rng.normal(size=(grid.n, thrusters)), weight_u=rng.uniform(1e-6, 1.0, thrusters)
        )
        plan, change = rng.normal(size=(grid.n, thrusters)), float(rng.choice([0.0, 0.2]))
        for each in (ours, plain):
            each.fill(back_off, cast(Any, now), cast(Any, wished), plan, change)
        for name in MADE:
            assert np.allclose(getattr(ours, name), getattr(plain, name), rtol=1e-12, atol=1e-12), name


@needs_library
def test_room_of_a_plan_is_that_of_its_worst_half_plane() -> None:
    rng = np.random.default_rng(1)
    x, normals, offsets = np.zeros((12, 8)), np.zeros((11, 3, 2)), np.zeros((11, 3))
    room, plain = PlanRoom(x[1:, :2], normals, offsets), PlanRoom(x[1:, :2], normals, offsets)
    plain._call = None
    for _ in range(50):
        x[:], normals[:], offsets[:] = (rng.normal(size=each.shape) for each in (x, normals, offsets))
        assert room.least_m() == pytest.approx(plain.least_m(), rel=1e-12, abs=1e-12)


@needs_library
def test_gaps_between_tables() -> None:
    rng, gaps, plain = np.random.default_rng(2), Gaps(), Gaps()
    plain._call = None
    for _ in range(20):
        a, b = rng.normal(size=(9, 8)), rng.normal(size=(9, 8))
        for other, first, width in ((b, 0, 2), (None, 4, 4)):
            assert gaps.largest(a, other, first, width) == plain.largest(a, other, first, width)
    a[3, 5] = np.nan
    assert not gaps.largest(a, None, 4, 4) < 4.0


def _flown(steps: int, watch: Callable[[], None] = lambda: None) -> FloatArray:
    """(steps, 4) thrust of a controller on the model, from rest towards the first goal."""
    vehicle, thrust = load_vehicle("lbv150"), []

    def each(step: int, output: ControlOutput) -> None:
        thrust.append(output.thrust_n)
        watch()

    fly(MotionController(vehicle), vehicle, START, steps, watch=each)
    return np.array(thrust)


@needs_library
def test_a_steady_step_is_a_few_hundred_calls() -> None:
    # Of functions of Python and of C, the model under it included: 700 with reference, limits and margins by numpy.
    counts, calls = [], [0]

    def count(frame: object, event: str, argument: object) -> None:
        calls[0] += event in ("call", "c_call")

    def each() -> None:
        counts.append(calls[0])
        calls[0] = 0

    before = sys.getprofile()
    sys.setprofile(count)
    try:
        _flown(60, each)
    finally:
        sys.setprofile(before)
    assert np.median(counts[20:]) < 500


@needs_library
def test_the_whole_step_with_and_without_what_surrounds_the_solver(monkeypatch: pytest.MonkeyPatch) -> None:
    ours = _flown(60)
    # Only the solver loads the library: all else asks whether there is one, and goes without.
    monkeypatch.setattr(compiled, "library", lambda *_: None)
    assert np.allclose(ours, _flown(60), atol=1e-6)


@needs_library
@pytest.mark.parametrize("value", HOSTILE)
def test_no_bound_is_made_of_what_is_no_number(value: float) -> None:
    rng, grid, thrusters = np.random.default_rng(2), uniform_grid(9), 4
    ours, plain = (ProgramBounds(grid, thrusters, 0.2) for _ in range(2))
    plain._call = None
    names = ("clearance_m", "depth_m", "planar_speed_m_s", "heave_m_s", "yaw_rate_rad_s")
    fence = Fence(inclusions=(), exclusions=(), depth_max_m=2.0)
    for turn in range(44):
        given = dict(zip(names, rng.uniform(0.0, 0.6, (5, grid.n - 1)), strict=True))
        given["thrust_n"] = rng.uniform(0.0, 6.0, (grid.n, thrusters))
        given |= {"x0": rng.normal(size=8), "limit_n": rng.uniform(1.0, 9.0, thrusters)}
        given |= {"wished_n": rng.normal(size=(grid.n, thrusters)), "weight_u": rng.uniform(0.1, 1.0, thrusters)}
        given["plan_n"] = rng.normal(size=(grid.n, thrusters))
        hostile = list(given)[turn % len(given)]
        given[hostile] = with_one(rng, given[hostile], value)
        back_off = BackOffs(**{name: given[name] for name in (*names, "thrust_n")})
        now = SimpleNamespace(x0=given["x0"], params=ParamSet(), fence=fence, thrust_limit_n=given["limit_n"])
        wished = SimpleNamespace(thrust_n=given["wished_n"], weight_u=given["weight_u"])
        with np.errstate(all="ignore"):
            for each in (ours, plain):
                each.fill(back_off, cast(Any, now), cast(Any, wished), given["plan_n"], 0.2)
        for name in MADE:
            assert agree(getattr(ours, name), getattr(plain, name), 1e-12), (hostile, name)


@needs_library
@pytest.mark.parametrize("value", HOSTILE)
def test_no_room_and_no_gap_is_made_of_what_is_no_number(value: float) -> None:
    rng, gaps, plain_gaps = np.random.default_rng(1), Gaps(), Gaps()
    x, normals, offsets = np.zeros((12, 8)), np.zeros((11, 3, 2)), np.zeros((11, 3))
    room, plain = PlanRoom(x[1:, :2], normals, offsets), PlanRoom(x[1:, :2], normals, offsets)
    plain._call = plain_gaps._call = None
    for turn in range(30):
        x[:], normals[:], offsets[:] = (rng.normal(size=each.shape) for each in (x, normals, offsets))
        hostile = (x[1:, :2], normals, offsets)[turn % 3]
        hostile[:] = with_one(rng, hostile, value)
        with np.errstate(all="ignore"):
            assert agree(room.least_m(), plain.least_m(), 1e-12), turn
            assert agree(gaps.largest(x, None, 0, 2), plain_gaps.largest(x, None, 0, 2)), turn
