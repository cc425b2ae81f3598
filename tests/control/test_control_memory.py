"""A controller that nobody has any more is gone at once, with the programs of its planner: the collector of cycles
knows nothing of the memory that they take, and comes when hundreds of megabytes have been left behind."""

import gc
import weakref

import numpy as np
from control_loop import TANK, VEHICLE, A, nav_state

from autopilot.control.controller import MotionController
from autopilot.core.params import ParamSet


def test_a_controller_with_a_plan_under_way_leaves_nothing_behind() -> None:
    x, params = np.array([1.0, 0.5, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0]), ParamSet({"MPC_COST": 1})
    left: list[weakref.ref[object]] = []
    gc.collect()
    gc.disable()
    try:
        for _ in range(10):
            controller = MotionController(VEHICLE, cpu_clock=lambda: 0.0)
            for step in range(4):
                controller.step(50_000 * step, nav_state(50_000 * step, x), A, TANK, params)
            # The quick plan is under way: it is answered in the tenth step.
            left += [weakref.ref(controller), weakref.ref(controller.trajectories), weakref.ref(controller.nmpc)]
            del controller
        assert [ref() for ref in left] == [None] * len(left)
    finally:
        gc.enable()
