"""Disarming of the flight controller, repeated until its heartbeat reports it.

A vehicle without a flight controller is disarmed when its thrusters are neutral.
"""

from autopilot.command.announcements import Announcements
from autopilot.core import operator_messages as notices
from autopilot.core.messages import FlightControllerState
from autopilot.mavlink.api import ACCEPTED, CommandReply, CommandResult

CONFIRM_TICKS = 300
"""3 s, twelve requests: then the failure is reported. Requests continue until it is disarmed."""

ARMED_ANEW = "Disarming cancelled: armed again"

WAITING = CommandReply(result=CommandResult.IN_PROGRESS)


class Disarming:
    """From a disarming of ours to the heartbeat below that shows it. Times are counted in ticks."""

    def __init__(self, operator: Announcements) -> None:
        self._operator = operator
        self._ticks: int | None = None
        """Since it was asked for, None = nothing is waited for."""
        self._alone: bool | None = None
        """Whether there is no flight controller; None before the first tick."""
        self.answer = ACCEPTED
        """To who asked for it last."""

    @property
    def waits(self) -> bool:
        """Whether to send the disarm request on this tick."""
        return self._ticks is not None

    def begin(self) -> None:
        """Start the requests and the timeout."""
        if self._alone:
            self.answer = ACCEPTED
        else:
            self._ticks, self.answer = 0, WAITING

    def give_up(self) -> None:
        if self.answer is WAITING:
            self.answer = CommandReply(result=CommandResult.FAILED, reason=ARMED_ANEW)
        self._ticks = None

    def step(self, below: FlightControllerState | None) -> None:
        """Once per tick. The state known on the tick of the request is older than the request."""
        if below is not None or self._alone is None:
            self._alone = below is None
        ticks, self._ticks = self._ticks, None
        if ticks is None:
            return
        if self._alone or (below is not None and ticks > 0 and below.armed is False):
            if ticks > CONFIRM_TICKS:
                self._operator.say(notices.DISARM_CONFIRMED())
            self.answer = ACCEPTED
            return
        self._ticks = ticks + 1
        if ticks == CONFIRM_TICKS:
            found = notices.DISARM_NOT_CONFIRMED()
            self.answer = CommandReply(result=CommandResult.FAILED, reason=found.text)
            self._operator.say(found)
