"""Reasons against arming."""

import math
from collections.abc import Callable

from autopilot.command.failsafes import FailsafeRules
from autopilot.command.vehicle_status import VehicleStatus
from autopilot.core.geodesy import MAX_RANGE_M, far_text
from autopilot.core.messages import NavHealth, NavState
from autopilot.core.params import ParamSet
from autopilot.core.phrases import NO_FENCE, PLAN_REASON
from autopilot.core.plan import PlanKind, has_shapes
from autopilot.mission.goals import Goals
from autopilot.mission.store import Plans

CHECKING = "plan check is running, try again"
"""Reason while the plans are being checked again after a change of parameters or origin."""

STARTING = ("service is starting",)
"""The reason before the first tick."""

ControllerCheck = Callable[[NavState], tuple[str, ...]]
"""The controller's reasons against arming with an estimate."""


class ArmingChecks:
    def __init__(
        self,
        params: ParamSet,
        plans: Plans,
        goals: Goals,
        failsafes: FailsafeRules,
        controller_check: ControllerCheck,
        path_check: Callable[[NavState], str],
    ) -> None:
        """``path_check``: why the mission's next place cannot be reached from an estimate, "" if it can."""
        self._params = params
        self._plans = plans
        self._goals = goals
        self._failsafes = failsafes
        self._controller_check = controller_check
        self._path_check = path_check

    def reasons(self, status: VehicleStatus | None, *, blind: bool = False) -> tuple[str, ...]:
        """Reasons against arming, one line each, empty when ready. ``blind``: for a mode that needs no position;
        checks of an unknown position are skipped then.
        """
        if status is None:
            return STARTING
        nav = status.nav
        if blind and (nav is None or nav.health is not NavHealth.GOOD):
            return self._failsafes.prearm_reasons(status, blind=True)
        reasons = list(self._failsafes.prearm_reasons(status))
        reasons += [] if nav is None else self._of_place(nav)
        if self._params["DEPTH_MIN"] >= self._params["DEPTH_MAX"]:
            reasons.append("the depth band is empty: set DEPTH_MIN below DEPTH_MAX")
        if not self.fenced and self._params["FENCE_REQUIRED"] > 0.0:
            reasons.append(f"{NO_FENCE}: upload one (FENCE_REQUIRED 0: only warn)")
        if self._plans.checking:
            reasons.append(CHECKING)
        else:
            path = "" if self.of_plans or nav is None else self._path_check(nav)
            reasons += (PLAN_REASON + path,) if path else self.of_plans
        if nav is not None and nav.health is not NavHealth.INVALID:
            reasons += self._controller_check(nav)
        return tuple(reasons)

    @property
    def of_plans(self) -> tuple[str, ...]:
        """Reasons in mission, fence and rally points."""
        return (PLAN_REASON + self._plans.problem,) if self._plans.problem else ()

    @property
    def fenced(self) -> bool:
        return has_shapes(self._plans.items(PlanKind.FENCE))

    def _of_place(self, nav: NavState) -> list[str]:
        reasons = []
        if self._goals.clearance_m(nav.pos_ned_m) < 0.0:
            reasons.append("outside the fence or in an obstacle: check fence and origin")
        distance_m = math.hypot(*nav.pos_ned_m[:2].tolist())
        if not distance_m <= MAX_RANGE_M:
            reasons.append(f"position is {far_text(distance_m)}")
        return reasons
