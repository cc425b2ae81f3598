"""Maintenance commands (storage, reboot, calibration), and hints for those that are not supported."""

import math
from collections.abc import Mapping

from autopilot.core import operator_messages as notices
from autopilot.core.messages import RunEnd
from autopilot.mavlink.api import ACCEPTED, CommandReply, CommandResult, MotorTest
from autopilot.mavlink.commands import Call, CommandRow, Reply, action, denied, request
from autopilot.mavlink.context import Context
from autopilot.mavlink.dialect import mav
from autopilot.mavlink.parameters import Parameters

_READ, _WRITE, _RESET, _RESET_SENSORS, _FACTORY = range(5)
"""PREFLIGHT_STORAGE_PARAMETER_ACTION."""
_NOTHING, _RESTART, _STOP = range(3)
"""REBOOT_SHUTDOWN_ACTION."""

_AS_ITEM = "Looking at a place: only as an item of a mission"
ELSEWHERE: Mapping[int, str] = {
    mav.MAV_CMD_CONDITION_YAW: "To turn: go-to (DO_REPOSITION) with a heading",
    mav.MAV_CMD_DO_SET_ROI_LOCATION: _AS_ITEM,
    mav.MAV_CMD_DO_SET_ROI_WPNEXT_OFFSET: _AS_ITEM,
    mav.MAV_CMD_DO_SET_ROI_NONE: _AS_ITEM,
    mav.MAV_CMD_DO_SET_ROI: _AS_ITEM,
}
"""Unsupported commands that clients offer -> the supported alternative."""


class Maintenance:
    def __init__(self, ctx: Context, parameters: Parameters) -> None:
        self._ctx, self._parameters = ctx, parameters

    def table(self) -> Mapping[int, CommandRow]:

        def elsewhere(reason: str) -> CommandRow:
            answer = CommandReply(result=CommandResult.UNSUPPORTED, reason=reason)
            return request(lambda call: Reply(answer))

        return {
            **{command: elsewhere(reason) for command, reason in ELSEWHERE.items()},
            mav.MAV_CMD_DO_MOTOR_TEST: action(self.test_motor),
            mav.MAV_CMD_PREFLIGHT_STORAGE: action(self.storage),
            mav.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN: action(self.reboot),
            mav.MAV_CMD_PREFLIGHT_CALIBRATION: action(self.calibrate),
        }

    def test_motor(self, call: Call) -> Reply:
        """DO_MOTOR_TEST: param1 motor from 1, param2 0 = param3 is percent (50 = stop, as in ArduSub), 1 = a pulse
        [us], param4 seconds. One motor at a time, in any order (param5, param6).
        """
        number, kind, value, seconds = call.whole(1), call.whole(2), call.params[2], call.param(4)
        if number is None or number < 1 or not math.isfinite(value) or not 0.0 <= seconds < math.inf:
            reason = "use a motor from 1, a finite value and 0 s or more"
            return denied(f"Motor test denied: motor {call.param(1):g}, value {value:g}, {seconds:g} s; {reason}")
        if call.param5 > 1.0:
            return denied("Motor test denied: one motor at a time (param5)")
        if kind == mav.MOTOR_TEST_THROTTLE_PERCENT:
            if not 0.0 <= value <= 100.0:
                return denied(f"Motor test denied: {value:g} %, use 0 to 100, 50 stands")
            test = MotorTest(number=number, throttle=value / 50.0 - 1.0, seconds=seconds)
        elif kind == mav.MOTOR_TEST_THROTTLE_PWM:
            test = MotorTest(number=number, pulse_us=value, seconds=seconds)
        else:
            return denied(f"Motor test denied: throttle type {call.param(2):g}, use 0 (percent) or 1 (us)")
        return Reply(self._ctx.vehicle.test_motor(test))

    def storage(self, call: Call) -> Reply:
        """PREFLIGHT_STORAGE: parameters are saved when they are set, so that read and write have no effect; 2 and 4
        reset all to their defaults. Plans and logs are not supported.
        """
        what = call.whole(1)
        if what == _RESET_SENSORS:
            return denied("storage: calibration is in the vehicle file, see `autopilot calibrate`")
        if what not in (_READ, _WRITE, _RESET, _FACTORY, -1):
            return denied(f"storage: param1 = {call.param(1):g}, use 0, 1 or 2")
        if (call.whole(2) or 0) in (_RESET, _FACTORY):
            return denied("storage: plans are cleared by MISSION_CLEAR_ALL")
        if what in (_RESET, _FACTORY):
            if self._ctx.view.armed:
                return denied("Parameters not reset: disarm first")
            count = self._parameters.reset()
            self._ctx.say(notices.PARAMETERS_RESET(client=call.peer.name, count=count))
        return Reply(ACCEPTED)

    def reboot(self, call: Call) -> Reply:
        """PREFLIGHT_REBOOT_SHUTDOWN: 1 restarts the service, 2 shuts it down."""
        what = call.whole(1)
        if what == _NOTHING:
            return Reply(ACCEPTED)
        if what not in (_RESTART, _STOP):
            return denied(f"reboot: param1 = {call.param(1):g}, use 1 (restart) or 2 (stop)")
        answer = self._ctx.vehicle.end_run(RunEnd.AGAIN if what == _RESTART else RunEnd.STOP)
        if answer.result is CommandResult.ACCEPTED:
            name = call.peer.name
            text = notices.SERVICE_ENDS(client=name) if what == _STOP else notices.SERVICE_RESTARTS(client=name)
            self._ctx.say(text)
        return Reply(answer)

    def calibrate(self, call: Call) -> Reply:
        """PREFLIGHT_CALIBRATION: not supported, sensors are calibrated from logs; all zeros (cancel) has nothing to
        cancel.
        """
        wanted = [*call.params, call.x, call.y, call.z]
        if not any(value and value == value for value in wanted):
            return Reply(ACCEPTED)
        return denied("Calibrate on board: `autopilot calibrate`")
