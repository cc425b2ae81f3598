"""Queue of messages to the operator, in order."""

from autopilot.core.messages import Event
from autopilot.core.operator_messages import OperatorText


class Announcements:
    """Collects messages to the operator; the service sends them once per tick."""

    def __init__(self) -> None:
        self.t_us = 0
        """Time of the tick."""
        self._events: list[Event] = []

    def say(self, text: OperatorText) -> None:
        self._events.append(text.event(self.t_us))

    def pass_on(self, event: Event) -> None:
        """Queue a message with an explicit time."""
        self._events.append(event)

    def drain(self) -> tuple[Event, ...]:
        events, self._events = tuple(self._events), []
        return events
