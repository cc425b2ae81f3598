"""Starts that nobody chose: vehicles, waters, fences, headings, velocities and parameters of all kinds, both guidances.

Whatever comes, the program of a step has a solution (its limits are soft), so no step may need a fallback.
"""

import math

import msgspec
import numpy as np
import pytest
from control_loop import VEHICLE, fly, goal
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from autopilot.control import ocp
from autopilot.control.controller import MotionController
from autopilot.control.grid import geometric_grid
from autopilot.core.frames import FloatArray
from autopilot.core.geometry import Fence
from autopilot.core.messages import Fallback, SolveStatus
from autopilot.core.params import ParamSet
from autopilot.core.vehicle import Vehicle

DEPTH_M = 20.0

NO_SHRINKING = (Phase.explicit, Phase.reuse, Phase.generate)
"""Building a prediction takes longer than finding the simplest one that fails is worth."""


def scaled(factors: FloatArray) -> Vehicle:
    """The LBV150 with its masses (4), linear (4) and quadratic drags (4) multiplied."""
    old = VEHICLE.model4
    names = ("mass_kg", "linear_drag", "quadratic_drag")
    new = {
        name: tuple(float(f * v) for f, v in zip(row, getattr(old, name), strict=True))
        for name, row in zip(names, factors, strict=True)
    }
    return msgspec.structs.replace(VEHICLE, model4=msgspec.structs.replace(old, **new))


@given(
    st.lists(st.floats(0.5, 2.0), min_size=12, max_size=12),
    st.lists(st.floats(-1.0, 1.0), min_size=8, max_size=8),
)
@settings(max_examples=40, deadline=None, phases=NO_SHRINKING)
def test_predictions_of_light_vehicles_with_much_drag_do_not_explode(factors: list[float], state: list[float]) -> None:
    model = scaled(np.array(factors).reshape(3, 4)).model4.to_model()
    grid = geometric_grid()
    planar, heave, turn = (share * most for share, most in zip(state, ocp.fastest_guess(model), strict=False))
    way = math.pi * state[3]
    x = np.array([0.0, 0.0, 0.0, 0.0, planar * math.cos(way), planar * math.sin(way), heave, turn])
    steps = grid.substeps(ocp.longest_step_s(model))[-1]
    found = ocp.discrete_dynamics(model, float(grid.dt_s[-1]), steps)(x, 12.0 * np.array(state[4:]), np.zeros(3))
    assert np.abs(np.array(found[0])[4:]).max() < 3.0
    assert np.abs(np.array(found[1])).max() < 1e4


@pytest.mark.parametrize("turning", [0.5, 2.0, 3.0])
def test_a_light_vehicle_that_turns_against_much_drag_is_controlled(turning: float) -> None:
    """Twice the LBV150's damping of a turn to its full yaw rate and more."""
    factors = np.ones((3, 4))
    factors[0, 3], factors[2, 3] = 1.0 / turning, turning
    vehicle = scaled(factors)
    flight = fly(
        MotionController(vehicle, cpu_clock=lambda: 0.0),
        [goal(-2.0, 1.0, 0.5, 0.3)],
        [0.0, 0.0, 0.5, -0.2, 0.0, 0.0, 0.0, 0.4],
        fence=Fence(depth_max_m=DEPTH_M),
        params=ParamSet({"DEPTH_MAX": DEPTH_M}),
        limit_s=5.0,
        model=vehicle.model4.to_model(),
    )
    assert {output.status.status for output in flight.outputs} == {SolveStatus.OK}
    assert {output.status.fallback for output in flight.outputs} == {Fallback.NONE}
