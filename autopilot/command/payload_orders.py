"""Payload items of a mission: whether they can be carried out, and their execution.

A missing or silent camera is reported and its items are skipped: a survey is worth flying for its track. A missing
output refuses the plan.
"""

from collections.abc import Sequence

from autopilot.command.equipment import Equipment
from autopilot.command.photographer import Photographer
from autopilot.core import operator_messages as notices
from autopilot.core.messages import Event
from autopilot.mavlink.api import ACCEPTED, CommandReply, CommandResult
from autopilot.mission.items import Order
from autopilot.mission.payload_items import (
    Grip,
    MoveActuators,
    MoveServo,
    NothingToDo,
    Shoot,
    ShootEvery,
    StopShooting,
    SwitchRelay,
    TiltCamera,
)

NO_CAMERA = "no camera here, no photos"


class PayloadOrders:
    """Between the mission and the equipment."""

    def __init__(self, equipment: Equipment, photographer: Photographer | None) -> None:
        self._equipment, self._photographer = equipment, photographer
        self._reported_camera = False

    def refusal(self, order: Order) -> str:
        """Why the vehicle has nothing that could ever do it, "" when it has."""
        equipment = self._equipment
        match order:
            case MoveServo():
                return equipment.refuse_servo(order.channel) or equipment.refuse_pulse(order.channel, order.pulse_us)
            case SwitchRelay():
                return equipment.refuse_relay(order.number)
            case Grip():
                return equipment.refuse_gripper(order.number)
            case MoveActuators():
                refusals = [equipment.refuse_actuator(number) for number, value in order.values if value != 0.0]
                return next((refusal for refusal in refusals if refusal), "")
            case TiltCamera():
                return equipment.refuse_tilt(order.angle_rad)
        return ""

    def carry_out(self, t_us: int, orders: Sequence[Order]) -> list[Event]:
        """Execute an order; messages to the operator."""
        events = []
        for order in orders:
            answer = self._done(order)
            if answer.result is not CommandResult.ACCEPTED:
                events.append(notices.ITEM_ORDER_FAILED.event(t_us, seq=order.seq, reason=answer.reason))
        return events

    def _done(self, order: Order) -> CommandReply:
        equipment = self._equipment
        match order:
            case Shoot() | ShootEvery() | StopShooting() | NothingToDo():
                return self._camera(order)
            case MoveServo(count=0):
                return equipment.set_servo(order.channel, order.pulse_us)
            case MoveServo():
                return equipment.repeat_servo(order.channel, order.pulse_us, order.count, order.cycle_s)
            case SwitchRelay(count=0, on=None):
                return equipment.toggle_relay(order.number)
            case SwitchRelay(count=0):
                return equipment.set_relay(order.number, on=bool(order.on))
            case SwitchRelay():
                return equipment.repeat_relay(order.number, order.count, order.cycle_s)
            case Grip():
                return equipment.grip(order.number, close=order.close)
            case MoveActuators():
                meant = {n: value for n, value in order.values if value != 0.0 or not equipment.refuse_actuator(n)}
                return equipment.set_actuators(meant)
            case TiltCamera():
                return equipment.tilt_by(None) if order.angle_rad is None else equipment.tilt(order.angle_rad)
        return ACCEPTED

    def _camera(self, order: Shoot | ShootEvery | StopShooting | NothingToDo) -> CommandReply:
        camera = self._photographer
        starts = isinstance(order, Shoot) or (isinstance(order, ShootEvery) and order.distance_m > 0.0)
        if camera is None:
            reported, self._reported_camera = self._reported_camera, self._reported_camera or starts
            return CommandReply(result=CommandResult.DENIED, reason=NO_CAMERA) if starts and not reported else ACCEPTED
        match order:
            case Shoot():
                return camera.shoot(order.count, order.interval_s, order.seq)
            case ShootEvery():
                return camera.shoot_every(order.distance_m, now=order.now, seq=order.seq)
            case StopShooting():
                return camera.stop()
        return ACCEPTED
