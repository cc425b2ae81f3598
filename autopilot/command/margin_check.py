"""Reasons of the controller against arming: an empty tightened set, or a current that is too strong."""

import numpy as np

from autopilot.control.protocol import Controller
from autopilot.core.messages import NavState
from autopilot.core.params import ParamSet
from autopilot.mission.store import Plans


class MarginCheck:
    """Reasons against arming; the geometry comes from the plan check."""

    def __init__(self, controller: Controller, params: ParamSet, plans: Plans) -> None:
        self._controller, self._params, self._plans = controller, params, plans

    def planar_speed_m_s(self, nav: NavState) -> float:
        """Planar speed that the controller's margins leave with this estimate."""
        return self._controller.planar_speed_m_s(nav, self._params)

    def __call__(self, nav: NavState) -> tuple[str, ...]:
        """Why the vehicle must not be armed with this estimate; empty when it may."""
        verdict = self._plans.verdict
        reasons = self._controller.refusals(nav, verdict.goal_clearance_m, verdict.widest_m, self._params)
        current = float(np.hypot(*nav.current_ned_m_s[:2]))
        limit = self._params["SPD_PLANAR_MAX"]
        if current >= limit:
            fast = f"current {current:.2f} m/s, speed limit {limit:g}: wait or raise SPD_PLANAR_MAX"
            reasons = (*reasons, fast)
        return reasons
