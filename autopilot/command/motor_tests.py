"""DO_MOTOR_TEST: one thruster of an armed vehicle turns a little, as long as somebody says so.

A test needs mode MANUAL with the sticks let go, and ends by silence, disarming, another mode, a stick, and near the
fence. What it may do at most is what :mod:`autopilot.run.motor_test` may on board.
"""

from autopilot.command.announcements import Announcements
from autopilot.command.conditions import Conditions
from autopilot.command.mode_machine import ModeMachine
from autopilot.core.messages import Severity
from autopilot.core.vehicle import Vehicle
from autopilot.mavlink.api import FlightMode, MotorTest, Sticks
from autopilot.mission.goals import Goals

MOST_SHARE = 0.3
"""Of the pulse's span."""
MOST_S = 5.0
"""In one go, and of one word."""
REST_S = 1.0
"""After so long."""
SILENCE_S = 0.5
"""A word that says no time holds for so long: ArduSub wants two a second."""
AWAY_M = 0.2
"""From every boundary, beyond what the controller keeps: nothing brakes a vehicle while a thruster is tested."""


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
        """Why there is no test, "" when it runs."""
        conditions, count = self._modes.conditions, len(self._thrusters)
        if not self._modes.armed or conditions is None:
            return "arm first"
        if not 1 <= test.number <= count:
            return f"there is no motor {test.number}, use 1 to {count}"
        reason = self._end(conditions)
        if reason:
            return reason
        t_us = conditions.t_us
        if t_us < self._rest_us:
            return f"{MOST_S:g} s are enough, wait {REST_S:g} s"
        place = test.number - 1
        thruster = self._thrusters[place]
        drive = thruster.drive
        way = -1 if thruster.reversed else 1
        if test.pulse_us is None:
            wanted_us = way * (test.share or 0.0) * drive.span_us
        else:
            wanted_us = test.pulse_us - drive.neutral_us
        most_us = round(MOST_SHARE * drive.span_us)
        pulse_us = drive.neutral_us + round(min(max(wanted_us, -most_us), most_us))
        if self._now is None:
            self._began_us = t_us
        if self._now is None or self._now[0] != place:
            held = f", at most {100.0 * MOST_SHARE:g} %" if abs(wanted_us) > most_us else ""
            self._operator.say(Severity.INFO, f"Motor test: {test.number} {thruster.name}{held}")
        self._now = (place, pulse_us)
        self._until_us = t_us + round(1e6 * min(test.seconds or SILENCE_S, MOST_S))
        return ""

    def step(self, conditions: Conditions) -> tuple[int, int] | None:
        """What turns on this tick."""
        if self._now is None:
            return None
        t_us = conditions.t_us
        reason = self._end(conditions)
        if t_us - self._began_us >= MOST_S * 1e6:
            reason, self._rest_us = f"{MOST_S:g} s", t_us + round(1e6 * REST_S)
        if reason or t_us >= self._until_us:
            self._now = None
            self._operator.say(Severity.INFO, f"Motor test over: {reason}" if reason else "Motor test over")
        return self._now

    def _end(self, conditions: Conditions) -> str:
        """What speaks against a test now."""
        modes, sticks, nav = self._modes, conditions.sticks, self._modes.nav
        if not modes.armed:
            return "disarmed"
        if modes.yielded:
            return "the pilot has the vehicle below us"
        if modes.mode is not FlightMode.MANUAL:
            return f"{modes.mode.name}, choose MANUAL"
        if sticks is not None and sticks != Sticks():
            return "let go of the sticks"
        if nav is not None and not self._goals.may_drift(nav, AWAY_M):
            return "too near to the fence"
        return ""
