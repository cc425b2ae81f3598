"""DO_MOTOR_TEST: runs one thruster of an armed vehicle at low thrust while the command is repeated.

A test needs mode MANUAL with the sticks centred. It ends on timeout, disarming, another mode, stick input, and near
the fence. Its limits are those of :mod:`autopilot.run.motor_test`.
"""

from autopilot.command.announcements import Announcements
from autopilot.command.command_tuning import MOTOR_TESTS
from autopilot.command.mode_machine import ModeMachine
from autopilot.command.vehicle_status import VehicleStatus
from autopilot.core import operator_messages as notices
from autopilot.core.vehicle import Vehicle
from autopilot.mavlink.api import FlightMode, MotorTest, Sticks
from autopilot.mission.goals import Goals


class MotorTests:
    """The test that runs, if one does."""

    def __init__(self, vehicle: Vehicle, goals: Goals, modes: ModeMachine, operator: Announcements) -> None:
        self._thrusters = vehicle.thrusters
        self._goals, self._modes, self._operator = goals, modes, operator
        self._now: tuple[int, int] | None = None
        """Place and pulse."""
        self._began_us = self._until_us = 0
        self._rest_us = 0

    def begin(self, test: MotorTest) -> str:
        """Start a test. Returns the reason of a refusal, else ""."""
        status, count = self._modes.status, len(self._thrusters)
        if not self._modes.armed or status is None:
            return "arm first"
        if not 1 <= test.number <= count:
            return f"there is no motor {test.number}, use 1 to {count}"
        reason = self._end(status)
        if reason:
            return reason
        t_us = status.t_us
        if t_us < self._rest_us:
            return f"{MOTOR_TESTS.most_s:g} s are enough, wait {MOTOR_TESTS.rest_s:g} s"
        place = test.number - 1
        thruster = self._thrusters[place]
        drive = thruster.drive
        sign = -1 if thruster.reversed else 1
        if test.pulse_us is None:
            wanted_us = sign * (test.throttle or 0.0) * drive.span_us
        else:
            wanted_us = test.pulse_us - drive.neutral_us
        most_us = round(MOTOR_TESTS.most_fraction * drive.span_us)
        pulse_us = drive.neutral_us + round(min(max(wanted_us, -most_us), most_us))
        if self._now is None:
            self._began_us = t_us
        if self._now is None or self._now[0] != place:
            held = f", at most {100.0 * MOTOR_TESTS.most_fraction:g} %" if abs(wanted_us) > most_us else ""
            self._operator.say(notices.MOTOR_TEST(number=test.number, name=thruster.name, limit=held))
        self._now = (place, pulse_us)
        self._until_us = t_us + round(1e6 * min(test.seconds or MOTOR_TESTS.silence_s, MOTOR_TESTS.most_s))
        return ""

    def step(self, status: VehicleStatus) -> tuple[int, int] | None:
        if self._now is None:
            return None
        t_us = status.t_us
        reason = self._end(status)
        if t_us - self._began_us >= MOTOR_TESTS.most_s * 1e6:
            reason, self._rest_us = f"{MOTOR_TESTS.most_s:g} s", t_us + round(1e6 * MOTOR_TESTS.rest_s)
        if reason or t_us >= self._until_us:
            self._now = None
            self._operator.say(notices.MOTOR_TEST_ENDED(reason=reason) if reason else notices.MOTOR_TEST_OVER())
        return self._now

    def _end(self, status: VehicleStatus) -> str:
        """Reason to end the test now."""
        modes, sticks, nav = self._modes, status.sticks, self._modes.nav
        if not modes.armed:
            return "disarmed"
        if modes.yielded:
            return "the pilot has the vehicle below us"
        if modes.mode is not FlightMode.MANUAL:
            return f"{modes.mode.name}, choose MANUAL"
        if sticks is not None and sticks != Sticks():
            return "let go of the sticks"
        if nav is not None and not self._goals.may_drift(nav, MOTOR_TESTS.away_m):
            return "too near to the fence"
        return ""
