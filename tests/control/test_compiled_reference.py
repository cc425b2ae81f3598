"""References of the compiled library against those of the code that says what they mean."""

import math
from dataclasses import replace

import numpy as np
import pytest
from vehicles import drawn

from autopilot.control.nmpc.grid import geometric_grid, uniform_grid
from autopilot.control.way.compiled_reference import QuickMarch
from autopilot.control.way.reference import ReferenceTarget, Route, build_reference
from autopilot.core import compiled
from autopilot.core.frames import FloatArray
from autopilot.core.sharing import Sharing
from tests.hostile_numbers import HOSTILE, agree, outcome, with_one

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
            target = ReferenceTarget(
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


NUMBERS = (
    *("s0_m", "depth_m", "yaw_rad", "cruise_m_s", "speed_limit_m_s", "heave_limit_m_s", "yaw_rate_limit_rad_s"),
    *("x0", "current"),
)


@needs_library
@pytest.mark.parametrize("value", HOSTILE)
@pytest.mark.parametrize("hostile", NUMBERS)
def test_no_reference_is_made_of_what_is_no_number(hostile: str, value: float) -> None:
    rng, grid = np.random.default_rng(3), uniform_grid(7)
    sharing = Sharing(drawn(rng, 4).to_model())
    quick = QuickMarch(compiled.load(), sharing, grid.t_s)
    sound = ReferenceTarget(
        route=Route(np.array([[0.0, 0.0], [1.0, 0.5], [2.0, 0.0]])),
        s0_m=0.3,
        depth_m=0.8,
        yaw_rad=1.0,
        cruise_m_s=0.35,
        speed_limit_m_s=0.4,
        heave_limit_m_s=0.2,
        yaw_rate_limit_rad_s=0.9,
    )
    for _ in range(8):
        x0, current, target = rng.normal(size=8), 0.1 * rng.normal(size=3), sound
        if hostile == "x0":
            x0[2:4] = with_one(rng, x0[2:4], value)
        elif hostile == "current":
            current = with_one(rng, current, value)
        else:
            target = replace(sound, **{hostile: value})
        limit_n = np.full(4, 9.0)
        ours = outcome(lambda *given: quick(*given)[0], x0, target, current, limit_n)
        theirs = outcome(build_reference, grid.t_s, x0, target, current)
        if abs(value) == 1e308 and np.ndim(theirs) == 0:
            continue  # the absolute value of a complex number raises, a square in C need not count in the end
        # A state is used as a whole: in which of its numbers it shows is another matter.
        rows = np.isfinite(ours).all(axis=-1) & np.isfinite(theirs).all(axis=-1)
        assert (rows == np.isfinite(ours).all(axis=-1)).all()
        assert agree(np.asarray(ours)[rows], np.broadcast_to(theirs, (len(grid.t_s), 8))[rows]), (ours, theirs)
        assert not (np.isnan(value) and rows.all())
