"""References of the compiled library against those of the code that says what they mean."""

import math

import numpy as np
import pytest
from vehicles import drawn

from autopilot.control.nmpc.grid import geometric_grid, uniform_grid
from autopilot.control.way.quick import QuickMarch
from autopilot.control.way.reference import Route, Target, build_reference
from autopilot.core import compiled
from autopilot.core.frames import FloatArray
from autopilot.core.sharing import Sharing

needs_library = pytest.mark.skipif(compiled.missing() is not None, reason="not compiled")


def _limits(rng: np.random.Generator, thrusters: int) -> FloatArray:
    """Some thrusters weak, sometimes one lost, sometimes no bound at all."""
    limit_n = rng.uniform(0.5, 15.0, thrusters)
    if rng.random() < 0.3:
        limit_n[rng.integers(thrusters)] = 0.0
    return np.full(thrusters, math.inf) if rng.random() < 0.2 else limit_n


@needs_library
@pytest.mark.parametrize("thrusters", [4, 5, 6, 8])
def test_references_are_those_of_the_code_that_says_what_they_mean(thrusters: int) -> None:
    rng = np.random.default_rng(thrusters)
    sharing = Sharing(drawn(rng, thrusters).to_model())
    for grid in (geometric_grid(), uniform_grid(7)):
        quick = QuickMarch(compiled.load(), sharing, grid.t_s)
        for _ in range(150):
            corners = np.cumsum(rng.normal(size=(rng.integers(1, 6), 2)) * rng.uniform(0.0, 2.0), axis=0)
            route = Route(corners)
            x0, current = rng.normal(size=8), rng.choice([0.0, 0.1, 0.5]) * rng.normal(size=3)
            target = Target(
                route=route,
                s0_m=float(rng.choice([0.0, route.length_m, rng.uniform(0.0, 1.1) * route.length_m])),
                depth_m=float(rng.choice([x0[2], rng.normal()])),
                yaw_rad=float(rng.choice([x0[3], 4.0 * rng.normal()])),
                cruise_m_s=rng.uniform(0.01, 1.0),
                speed_limit_m_s=rng.uniform(0.05, 0.8),
                heave_limit_m_s=rng.uniform(0.02, 0.5),
                yaw_rate_limit_rad_s=rng.uniform(0.05, 2.0),
            )
            limit_n = _limits(rng, thrusters)
            x, thrust = quick(x0, target, current, limit_n)
            meant = build_reference(grid.t_s, x0, target, current)
            assert np.allclose(x, meant, rtol=1e-12, atol=1e-12)
            assert np.allclose(thrust, sharing.hold_n(meant[:-1, 4:], limit_n), rtol=1e-9, atol=1e-9)
            again, _ = quick(x0 + 1.0, target, current, limit_n)
            assert again is not x
            assert np.allclose(x, meant, rtol=1e-12, atol=1e-12), "an answer is no view of the next one"
