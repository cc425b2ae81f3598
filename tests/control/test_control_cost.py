"""Many obstacles cost hardly more than two: the nearest fill the slots, what is far is not looked at."""

import math
import time

import numpy as np
import pytest
from control_loop import MODEL, PILLARS, STEP_US, TANK, VEHICLE, B, nav_state, rk4, still

from autopilot.control.controller import MotionController
from autopilot.core.compiled import OFF, SWITCH
from autopilot.core.geometry import Circle, Fence, Polygon
from autopilot.core.params import ParamSet


def crowded(count: int) -> Fence:
    """The tank with so many cylinders, those beyond the paper's two along its walls."""
    rng = np.random.default_rng(3)
    circles = list(TANK.exclusions)
    while len(circles) < count:
        low, high = ([-2.4, 0.9], [2.4, 1.45]) if len(circles) % 2 else ([-2.4, -1.45], [2.4, -1.2])
        circles.append(Circle(center_ned_m=rng.uniform(low, high), radius_m=0.05))
    return Fence(inclusions=TANK.inclusions, exclusions=tuple(circles), depth_max_m=1.2)


def jagged(count: int) -> Fence:
    """The tank with stars of so many edges in place of its cylinders."""
    angle = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
    radius = np.where(np.arange(count) % 2, 0.16, 0.1)
    star = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    stars = tuple(Polygon(vertices_ned_m=np.array(place) + star) for place in PILLARS)
    return Fence(inclusions=TANK.inclusions, exclusions=stars, depth_max_m=1.2)


def test_fifty_obstacles_cost_at_most_1_3_times_two(monkeypatch: pytest.MonkeyPatch) -> None:
    """CPU time of whole steps, all controllers stepped in turn: what disturbs one disturbs the others.

    All without the compiled library: what obstacles cost is Python, and is not to look dear beside a step in C.
    """
    monkeypatch.setenv(SWITCH, OFF)
    fences = [crowded(2), crowded(50), jagged(50)]
    controllers = [MotionController(VEHICLE) for _ in fences]
    states = [np.array([-1.6, -0.35, 0.45, 0.0, 0.0, 0.0, 0.0, 0.0]) for _ in fences]
    params, lag = ParamSet(), 1.0 - math.exp(-STEP_US * 1e-6 / VEHICLE.drive.time_constant_s)
    acting, spent = [np.zeros(4) for _ in fences], []
    for step in range(60):
        row = []
        for i, (controller, fence) in enumerate(zip(controllers, fences, strict=True)):
            nav = nav_state(step * STEP_US, states[i])
            began = time.thread_time()
            thrust = controller.step(step * STEP_US, nav, B, fence, params).thrust_n
            row.append(time.thread_time() - began)
            acting[i] = acting[i] + (thrust - acting[i]) * lag
            states[i] = rk4(MODEL, states[i], acting[i], still, STEP_US * 1e-6)
        spent.append(row)
    undisturbed = np.quantile(np.array(spent[5:]), 0.25, axis=0)
    ratios = undisturbed[1:] / undisturbed[0]
    assert ratios[0] < 1.3
    assert ratios[1] < 1.5  # a hundred edges, for which nothing is asked
