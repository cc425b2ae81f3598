"""Why a mode is not entered."""

from autopilot.command.arming import CHECKING
from autopilot.command.failsafes import FailsafeRules
from autopilot.command.mission_run import MissionRun
from autopilot.command.modes import Modes
from autopilot.core.plan import PlanKind
from autopilot.mavlink.api import Answer, CommandResult, FlightMode
from mission.goals import Goals
from mission.store import Plans


def denied(reason: str) -> Answer:
    """No, and why."""
    return Answer(result=CommandResult.DENIED, reason=reason)


class Refusals:
    """Looks at failsafes, plans and place before an order is followed."""

    def __init__(self, plans: Plans, goals: Goals, mission: MissionRun, modes: Modes, failsafes: FailsafeRules) -> None:
        self._plans = plans
        self._goals = goals
        self._mission = mission
        self._modes = modes
        self._failsafes = failsafes

    def of_mode(self, mode: FlightMode) -> Answer | None:
        """The refusal of a mode that cannot be entered, None if it can."""
        if self._modes.yielded:
            return denied("Denied: the pilot has the vehicle below us")
        if self._modes.overridden and mode is not FlightMode.SURFACE and self._failsafes.acting:
            return denied(f"Mode change denied: failsafe active ({self._failsafes.describe()})")
        if mode is FlightMode.MISSION:
            return self._of_mission()
        refusal = self._goals.refuse_home() if mode is FlightMode.RETURN else ""
        return denied(f"Return denied: {refusal}") if refusal else None

    def _of_mission(self) -> Answer | None:
        """The refusal of the mission, however it is to be begun."""
        if not self._plans.items(PlanKind.MISSION):
            return denied("No mission: upload one first")
        if self._plans.checking:
            return Answer(result=CommandResult.TEMPORARILY_REJECTED, reason=f"Mission denied: {CHECKING}")
        reason, nav = self._plans.problem, self._modes.nav
        if self._modes.armed:
            if not reason and nav is not None and self._goals.clearance_m(nav.pos_ned_m) < 0.0:
                reason = "outside the fence or in an obstacle: go to a free place first"
            reason = reason or self._mission.refusal(nav)
        return denied(f"Mission denied: {reason}") if reason else None
