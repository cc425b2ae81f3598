"""Reasons against arming."""

import math
from collections.abc import Callable

from autopilot.command.failsafes import FailsafeRules
from autopilot.command.vehicle_status import VehicleStatus
from autopilot.core.arming_reasons import ALL_MODES, ArmingReason, HealthComponent, ModeGroup
from autopilot.core.geodesy import MAX_RANGE_M, far_text
from autopilot.core.messages import NavHealth, NavState
from autopilot.core.params import ParamSet
from autopilot.core.phrases import NO_FENCE, PLAN_REASON
from autopilot.core.plan import PlanKind, has_shapes
from autopilot.mission.goals import Goals
from autopilot.mission.store import Plans

CHECKING = "plan check is running, try again"
"""Reason while the plans are being checked again after a change of parameters or origin."""

STARTING = (ArmingReason("service is starting", HealthComponent.SERVICE),)
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

    def reasons(self, status: VehicleStatus | None) -> tuple[ArmingReason, ...]:
        """Reasons against arming, empty when ready. Modes that need no position are not judged by an unknown one."""
        if status is None:
            return STARTING
        nav = status.nav
        reasons = list(self._failsafes.prearm_reasons(status))
        blind = nav is None or nav.health is not NavHealth.GOOD
        modes = ALL_MODES & ~ModeGroup.POSITIONLESS if blind else ALL_MODES
        reasons += [ArmingReason(text, component, modes) for text, component in self._of_fence(nav)]
        if self._plans.checking:
            reasons.append(ArmingReason(CHECKING, HealthComponent.MISSION, modes))
        else:
            path = "" if self._plans.problem or nav is None else self._path_check(nav)
            problem = PLAN_REASON + path if path else self.of_plans
            reasons += [ArmingReason(problem, HealthComponent.MISSION, modes)] if problem else []
        if nav is not None and nav.health is not NavHealth.INVALID:
            reasons += [ArmingReason(text, HealthComponent.CONTROLLER, modes) for text in self._controller_check(nav)]
        return tuple(reasons)

    @property
    def while_armed(self) -> tuple[ArmingReason, ...]:
        """What keeps an armed vehicle from its mission."""
        problem = self.of_plans
        return (ArmingReason(problem, HealthComponent.MISSION, ModeGroup.MISSION),) if problem else ()

    @property
    def of_plans(self) -> str:
        """The reason in mission, fence and rally points, "" = none."""
        return PLAN_REASON + self._plans.problem if self._plans.problem else ""

    @property
    def fenced(self) -> bool:
        return has_shapes(self._plans.items(PlanKind.FENCE))

    def _of_fence(self, nav: NavState | None) -> list[tuple[str, HealthComponent]]:
        found = []
        if nav is not None and self._goals.clearance_m(nav.pos_ned_m) < 0.0:
            found.append(("outside the fence or in an obstacle: check fence and origin", HealthComponent.FENCE))
        distance_m = 0.0 if nav is None else math.hypot(*nav.pos_ned_m[:2].tolist())
        if not distance_m <= MAX_RANGE_M:
            found.append((f"position is {far_text(distance_m)}", HealthComponent.POSITION))
        if self._params["DEPTH_MIN"] >= self._params["DEPTH_MAX"]:
            found.append(("the depth band is empty: set DEPTH_MIN below DEPTH_MAX", HealthComponent.FENCE))
        if not self.fenced and self._params["FENCE_REQUIRED"] > 0.0:
            found.append((f"{NO_FENCE}: upload one (FENCE_REQUIRED 0: only warn)", HealthComponent.FENCE))
        return found
