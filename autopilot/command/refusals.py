"""Why a mode is not entered."""

from autopilot.command.arming import CHECKING
from autopilot.command.failsafes import FailsafeRules
from autopilot.command.mission_run import MissionRun
from autopilot.command.modes import Modes
from autopilot.command.offboard import Offboard
from autopilot.core.messages import Failsafe
from autopilot.core.plan import PlanKind
from autopilot.mavlink.api import BLIND, Answer, CommandResult, FlightMode
from autopilot.mission.goals import Goals
from autopilot.mission.store import Plans


def denied(reason: str) -> Answer:
    """No, and why."""
    return Answer(result=CommandResult.DENIED, reason=reason)


class Refusals:
    """Looks at failsafes, plans and place before an order is followed."""

    def __init__(
        self,
        plans: Plans,
        goals: Goals,
        mission: MissionRun,
        modes: Modes,
        failsafes: FailsafeRules,
        offboard: Offboard,
    ) -> None:
        self._plans = plans
        self._offboard = offboard
        self._goals = goals
        self._mission = mission
        self._modes = modes
        self._failsafes = failsafes

    def of_mode(self, mode: FlightMode) -> Answer | None:
        """The refusal of a mode that cannot be entered, None if it can."""
        if self._modes.yielded:
            return denied("Denied: the pilot has the vehicle below us")
        steers = mode in BLIND and not self._failsafes.acts_beside(Failsafe.NAV_LOST)
        if self._modes.overridden and mode is not FlightMode.SURFACE and self._failsafes.acting and not steers:
            return denied(f"Mode change denied: failsafe active ({self._failsafes.describe()})")
        if mode is FlightMode.MISSION:
            return self._of_mission()
        refusal = self._goals.refuse_home() if mode is FlightMode.RETURN else ""
        return denied(f"Return denied: {refusal}") if refusal else self._of_steering(mode)

    def _of_steering(self, mode: FlightMode) -> Answer | None:
        """The refusal of a mode in which somebody steers."""
        conditions, armed = self._modes.conditions, self._modes.armed
        if not armed or conditions is None:
            return None
        blind = self._modes.nav is None
        if blind and mode in (FlightMode.POSHOLD, FlightMode.GUIDED, FlightMode.CIRCLE, FlightMode.TAKEOFF):
            return denied(f"{mode.name} denied: no position, use STABILIZE")
        if blind and mode is FlightMode.ALT_HOLD and conditions.facts.felt(conditions.t_us).depth_m is None:
            return denied("ALT_HOLD denied: no depth, use STABILIZE")
        if mode is FlightMode.GUIDED and not self._offboard.alive(conditions.t_us):
            return denied(f"Offboard denied: {self._offboard.lacks}")
        return None

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
