"""Commands to servos, relays, grippers and lights (https://mavlink.io/en/messages/common.html)."""

import math
from collections.abc import Mapping

from autopilot.mavlink.api import EquipmentOrders
from autopilot.mavlink.commands import Call, CommandRow, Reply, action, denied
from autopilot.mavlink.dialect import mav

ACTUATORS = 6
"""Values of one DO_SET_ACTUATOR; param7 is the index of the set."""


class EquipmentCommands:
    def __init__(self, orders: EquipmentOrders) -> None:
        self._orders = orders

    def table(self) -> Mapping[int, CommandRow]:
        return {
            mav.MAV_CMD_DO_SET_SERVO: action(self.set_servo),
            mav.MAV_CMD_DO_REPEAT_SERVO: action(self.repeat_servo),
            mav.MAV_CMD_DO_SET_RELAY: action(self.set_relay),
            mav.MAV_CMD_DO_REPEAT_RELAY: action(self.repeat_relay),
            mav.MAV_CMD_DO_GRIPPER: action(self.gripper),
            mav.MAV_CMD_DO_SET_ACTUATOR: action(self.set_actuator),
        }

    def set_servo(self, call: Call) -> Reply:
        """DO_SET_SERVO: param1 number of the output, param2 pulse [us]."""
        channel = call.whole(1)
        if channel is None:
            return _no_number("Servo", call, 1)
        return Reply(self._orders.set_servo(channel, call.param(2)))

    def repeat_servo(self, call: Call) -> Reply:
        """DO_REPEAT_SERVO: param1 number, param2 pulse [us], param3 how often, param4 time of a cycle [s]."""
        channel, count = call.whole(1), call.whole(3)
        if channel is None or count is None:
            return _no_number("Servo", call, 1 if channel is None else 3)
        return Reply(self._orders.repeat_servo(channel, call.param(2), count, call.param(4)))

    def set_relay(self, call: Call) -> Reply:
        """DO_SET_RELAY: param1 number from 0, param2 1 = on, 0 = off, -1 = the other side (ArduPilot's toggle)."""
        number, setting = call.whole(1), call.whole(2)
        if number is None:
            return _no_number("Relay", call, 1)
        if setting not in (-1, 0, 1):
            return denied(f"Relay refused: setting {call.param(2):g}, use 1, 0 or -1 (the other)")
        if setting == -1:
            return Reply(self._orders.toggle_relay(number))
        return Reply(self._orders.set_relay(number, on=setting == 1))

    def repeat_relay(self, call: Call) -> Reply:
        """DO_REPEAT_RELAY: param1 number, param2 how often, param3 time of a cycle [s]."""
        number, count = call.whole(1), call.whole(2)
        if number is None or count is None:
            return _no_number("Relay", call, 1 if number is None else 2)
        return Reply(self._orders.repeat_relay(number, count, call.param(3)))

    def gripper(self, call: Call) -> Reply:
        """DO_GRIPPER: param1 number from 1 (0 = the first), param2 0 = open, 1 = close."""
        number, what = call.whole(1), call.whole(2)
        if number is None:
            return _no_number("Gripper", call, 1)
        if what not in (mav.GRIPPER_ACTION_RELEASE, mav.GRIPPER_ACTION_GRAB):
            return denied(f"Gripper refused: action {call.param(2):g}, use 0 (open) or 1 (close)")
        return Reply(self._orders.grip(number, close=what == mav.GRIPPER_ACTION_GRAB))

    def set_actuator(self, call: Call) -> Reply:
        """DO_SET_ACTUATOR: param1 to param6 -1 to 1 (NaN = unchanged), param7 index of the set of six, from 0."""
        values: tuple[float, ...] = (*call.params, call.x, call.y)
        group = call.z if call.z == call.z else 0.0
        if not 0.0 <= group < 100.0 or group != int(group):
            return denied(f"Actuator refused: index {call.z:g} (param7), use 0 for actuators 1 to 6, 1 for the next")
        if call.exact:  # COMMAND_INT has no float there
            values = call.params
        first = int(group) * ACTUATORS + 1
        given = {first + n: value for n, value in enumerate(values) if not math.isnan(value)}
        # Clients that know no NaN send 0 for those that they do not mean.
        meant = {n: v for n, v in given.items() if v != 0.0 or not self._orders.refuse_actuator(n)}
        return Reply(self._orders.set_actuators(meant or given))


def _no_number(what: str, call: Call, param: int) -> Reply:
    return denied(f"{what} refused: {call.param(param):g} (param{param}), use a whole number")
