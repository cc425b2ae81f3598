"""Limits and bounds of a program by the compiled library against those of the code that says what they mean."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from autopilot.control.bounds import PlanRoom, ProgramBounds
from autopilot.control.nmpc.grid import uniform_grid
from autopilot.control.robust.tightening import BackOffs
from autopilot.core import compiled
from autopilot.core.geometry import Fence
from autopilot.core.params import ParamSet

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
