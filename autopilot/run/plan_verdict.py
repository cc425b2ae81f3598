"""The plan check of a file, with the margins that the shipped controller keeps."""

from autopilot.command.equipment import Equipment
from autopilot.command.payload_orders import PayloadOrders
from autopilot.control.robust.margins import goal_margin_m
from autopilot.core.geodesy import Origin
from autopilot.core.params import ParamSet
from autopilot.core.vehicle import Vehicle
from autopilot.mission.plan_check import PlanVerdict, judge_file
from autopilot.mission.plan_model import PlanFile


def verdict_of(plan: PlanFile, origin: Origin, params: ParamSet, vehicle: Vehicle) -> PlanVerdict:
    """What an upload of the plan to this vehicle would be answered with."""
    return judge_file(
        plan,
        origin,
        params,
        radius_m=vehicle.radius_m,
        goal_margin_m=goal_margin_m(vehicle, params),
        order_check=PayloadOrders(Equipment(vehicle), None).refusal,
    )
