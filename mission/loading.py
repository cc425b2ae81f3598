"""Plans of a file, taken before the loop runs."""

from autopilot.core.errors import PlanError
from autopilot.core.plan import PlanKind
from autopilot.mission.plan_model import PlanFile
from autopilot.mission.store import Plans


def load_plan(plans: Plans, plan: PlanFile, origin: str) -> str:
    """Take fence, mission and rally of a plan file. The result is why they cannot be flown yet,
    "" if they can. PlanError with the reason when a plan is wrong by itself."""
    for kind, items in ((PlanKind.FENCE, plan.fence), (PlanKind.MISSION, plan.mission), (PlanKind.RALLY, plan.rally)):
        if items:
            rejection = plans.replace(kind, items)
            if rejection is not None:
                raise PlanError(f"{origin}: {kind.name.lower()}: {rejection.reason}")
    return plans.problem
