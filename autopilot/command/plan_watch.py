"""Reports the result of plan checks, and keeps the fence from being changed under an armed vehicle."""

from collections.abc import Sequence

from autopilot.command.announcements import Announcements
from autopilot.core import operator_messages as notices
from autopilot.core.frames import FloatArray
from autopilot.core.messages import Goal, NavState
from autopilot.core.params import ParamSet
from autopilot.core.plan import MissionResult, PlanKind, PlanRejection, has_shapes
from autopilot.core.vehicle import Vehicle
from autopilot.mission.clearance import Clearance
from autopilot.mission.goals import Goals
from autopilot.mission.mission_tuning import VALIDATION
from autopilot.mission.plan_check import PlanVerdict
from autopilot.mission.store import Plans, plan_checksum

REPEAT_US = 5_000_000
"""Minimum interval at which the same problem of another upload is reported again."""


class PlanCheckNews:
    """Reports new results of the plan check."""

    def __init__(self, plans: Plans, operator: Announcements) -> None:
        self._plans = plans
        self._operator = operator
        self._checked: tuple[PlanVerdict, bool] | None = None
        self._reported = ""
        self._reported_us = 0
        self._reported_revision = 0

    def changed(self) -> bool:
        """Whether the result differs from the last call, or is pending."""
        checked = (self._plans.verdict, self._plans.checking)
        if checked == self._checked:
            return False
        self._checked = checked
        return True

    def tell(self, t_us: int, *, in_mission: bool) -> bool:
        """Report the result once it is there; True when it forbids the running mission."""
        if self._plans.checking:
            return False
        problem, revision = self._plans.problem, self._plans.revision
        ends = bool(problem) and in_mission
        again = revision != self._reported_revision and t_us - self._reported_us >= REPEAT_US
        if ends:
            self._operator.say(notices.PLAN_HOLD(problem=problem))
        elif problem and (problem != self._reported or again):
            self._operator.say(notices.PLAN_NO_START(problem=problem))
        elif self._reported and not problem:
            self._operator.say(notices.PLAN_OK())
        else:
            return False
        self._reported, self._reported_us, self._reported_revision = problem, t_us, revision
        return ends


class FenceGuard:
    """While armed: no fence that the vehicle or its mission would break, and none removed."""

    def __init__(self, vehicle: Vehicle, params: ParamSet, plans: Plans, goals: Goals) -> None:
        self._radius_m = vehicle.radius_m
        self._params = params
        self._plans = plans
        self._goals = goals

    def refusal(
        self, kinds: Sequence[PlanKind], verdict: PlanVerdict, nav: NavState | None, goal: Goal | None
    ) -> PlanRejection | None:
        """Refusal of plans for an armed vehicle at ``nav`` on its way to ``goal``; None when they are accepted."""
        fence = verdict.question.plans[PlanKind.FENCE]
        same = plan_checksum(fence) == self._plans.checksum(PlanKind.FENCE)
        if self._params["FENCE_ARMED_CHG"] or PlanKind.FENCE not in kinds or same:
            return None
        if has_shapes(self._plans.items(PlanKind.FENCE)) and not has_shapes(fence):
            reason = "disarm before the fence is removed"
        elif verdict.joint:
            reason = f"the vehicle is armed and {verdict.joint[0].reason}"
        else:
            reason = self._lack(Clearance([(s.shape, s.inclusion) for s in verdict.shapes]), nav, goal)
            if not reason and PlanKind.MISSION not in kinds and nav is not None and goal is not None and goal.seq >= 0:
                reason = verdict.path_problem(nav.pos_ned_m, goal.seq)
        if not reason:
            return None
        return PlanRejection(seq=None, result=MissionResult.DENIED, reason=f"{reason}; FENCE_ARMED_CHG 1 allows it")

    def _lack(self, free_space: Clearance, nav: NavState | None, goal: Goal | None) -> str:
        """Conflict of another workspace with the vehicle's position or goal, "" if none."""
        places: list[tuple[str, FloatArray]] = [] if nav is None else [("vehicle", nav.pos_ned_m)]
        places += [] if goal is None else [("vehicle's goal", goal.pos_ned_m)]
        for name, pos_ned_m in places:
            have_m = float(free_space.clearance_m(pos_ned_m[None, :2])[0])
            # Not worse than it is: a vehicle that was pushed to a boundary may get its fence again.
            need_m = min(self._radius_m, self._goals.clearance_m(pos_ned_m)) - VALIDATION.place_tolerance_m
            if have_m < need_m:
                return f"the {name} would be {need_m - have_m:.2f} m too near or inside: move it, or the fence"
        return ""
