"""What the margins of the controller forbid before arming: a tightened set that is empty, water that is too fast."""

import math

import numpy as np

from autopilot.control.robust.margins import Margins
from autopilot.core.geometry import Fence, Polygon
from autopilot.core.messages import NavState
from autopilot.core.params import ParamSet
from autopilot.core.vehicle import Vehicle
from mission.fence import fence_clearance_m
from mission.items import GoTo
from mission.store import Plans

GRID = 24
"""Places per axis at which the widest part of a workspace is looked for."""


class MarginCheck:
    """Reasons against arming; geometry is looked at anew only when plans or parameters have changed."""

    def __init__(self, margins: Margins, vehicle: Vehicle, params: ParamSet, plans: Plans) -> None:
        self._margins, self._vehicle, self._params, self._plans = margins, vehicle, params, plans
        self._key: tuple[int, int] = (-1, -1)
        self._goals: list[tuple[str, float]] = []
        self._widest_m = math.inf

    def __call__(self, nav: NavState) -> tuple[str, ...]:
        """Why the vehicle must not be armed with this estimate; empty when it may."""
        key = (self._plans.revision, self._params.revision)
        if key != self._key:
            self._key = key
            self._look()
        reasons = self._margins.refusals(nav, self._goals, self._widest_m, self._params)
        current = float(np.hypot(*nav.current_ned_m_s[:2]))
        limit = self._params["SPD_PLANAR_MAX"]
        if current >= limit:
            fast = (
                f"the water flows at {current:.2f} m/s, the vehicle may swim at {limit:g}: wait or raise SPD_PLANAR_MAX"
            )
            reasons = (*reasons, fast)
        return reasons

    def _look(self) -> None:
        fence = self._plans.fence()
        steps = [step for step in self._plans.steps() if isinstance(step, GoTo) and step.pos_ned_m is not None]
        self._goals = []
        if steps:
            places = np.array([step.pos_ned_m[:2] for step in steps if step.pos_ned_m is not None])
            clearance = fence_clearance_m(fence, places) - self._vehicle.radius_m
            self._goals = [(f"item {step.seq}", float(c)) for step, c in zip(steps, clearance, strict=True)]
        self._widest_m = widest_m(fence) - self._vehicle.radius_m


def widest_m(fence: Fence) -> float:
    """Largest clearance on a grid over the workspace; inf in open water."""
    corners = [
        shape.vertices_ned_m
        if isinstance(shape, Polygon)
        else shape.center_ned_m + shape.radius_m * np.array([[-1.0, -1.0], [1.0, 1.0]])
        for shape in fence.inclusions
    ]
    if not corners:
        return math.inf
    points = np.vstack(corners)
    axes = [np.linspace(points[:, i].min(), points[:, i].max(), GRID) for i in range(2)]
    grid = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    return float(fence_clearance_m(fence, grid).max())
