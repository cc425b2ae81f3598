"""Disarming of the flight controller, repeated until its heartbeat reports it.

A vehicle without a flight controller is disarmed when its thrusters are neutral.
"""

from autopilot.command.announcements import Announcements
from autopilot.core import operator_messages as notices
from autopilot.core.messages import FlightControllerState
from autopilot.mavlink.api import ACCEPTED, CommandReply, CommandResult

CONFIRM_US = 3_000_000
"""Twelve requests: then the failure is reported. Requests continue until it is disarmed."""

WAITING = CommandReply(result=CommandResult.IN_PROGRESS)
BUSY = CommandReply(
    result=CommandResult.TEMPORARILY_REJECTED,
    reason="Arming denied: flight controller is being disarmed, try again",
)


class Disarming:
    """From a disarming of ours to the heartbeat below that shows it."""

    def __init__(self, operator: Announcements) -> None:
        self._operator = operator
        self.waits = False
        """Whether to send the disarm request."""
        self._since_us: int | None = None
        """Time of the first request, None before it."""
        self._reported = False
        self._alone: bool | None = None
        """Whether there is no flight controller; None before the first tick."""
        self.answer = ACCEPTED
        """To who asked for it last."""

    def begin(self) -> None:
        """Start the requests and the timeout."""
        if self._alone:
            self.answer = ACCEPTED
        else:
            self.waits, self._since_us, self._reported, self.answer = True, None, False, WAITING

    @property
    def refusal(self) -> CommandReply | None:
        """Of an arming meanwhile: the flight controller would obey the disarming after it, as if its pilot had
        disarmed it. None when there is nothing to wait for."""
        return BUSY if self.answer is WAITING else None

    def give_up(self) -> None:
        self.waits = False

    def step(self, t_us: int, below: FlightControllerState | None) -> None:
        """With every decision. The state known on the tick of the request is older than the request."""
        if below is not None or self._alone is None:
            self._alone = below is None
        if not self.waits:
            return
        first = self._since_us is None
        self._since_us = t_us if self._since_us is None else self._since_us
        if self._alone or (below is not None and not first and below.armed is False):
            self.waits = False
            if self._reported:
                self._operator.say(notices.DISARM_CONFIRMED())
            self.answer = ACCEPTED
        elif t_us - self._since_us >= CONFIRM_US and not self._reported:
            self._reported = True
            found = notices.DISARM_NOT_CONFIRMED()
            self.answer = CommandReply(result=CommandResult.FAILED, reason=found.text)
            self._operator.say(found)
