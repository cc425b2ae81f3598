"""A ground station that reads events: the receiving side of https://mavlink.io/en/services/events.html."""

from typing import Any

from mavlink_harness import Client

from autopilot.mavlink.dialect import extra

ASK_AGAIN_TICKS = 10


def newer(number: int, than: int) -> bool:
    return 0 < (number - than) & 0xFFFF <= 0x7FFF


class EventReader:
    """Takes events in order, and asks for the first one that is missing."""

    def __init__(self, client: Client) -> None:
        self.client = client
        self.latest: int | None = None
        self.current = 0
        self.events: list[Any] = []
        self.lost = 0
        self.asked = 0
        self._boot_ms = 0
        self._wait: int | None = None
        client.on_message = self._on

    def _ask(self) -> None:
        assert self.latest is not None
        number = (self.latest + 1) & 0xFFFF
        self.client.send(extra.MAVLink_request_event_message(1, 1, number, number))
        self.asked, self._wait = self.asked + 1, ASK_AGAIN_TICKS

    def tick(self) -> None:
        """Once per tick: the timer that repeats a request."""
        if self._wait is not None:
            self._wait -= 1
            if self._wait == 0:
                self._ask()

    def _on(self, message: Any) -> None:
        match message.get_type():
            case "EVENT":
                self._on_event(message)
            case "CURRENT_EVENT_SEQUENCE":
                if self.latest is None or message.flags & 1:
                    self.latest = message.sequence
                self.current = message.sequence
                if newer(message.sequence, self.latest):
                    self._ask()
            case "RESPONSE_EVENT_ERROR" if (message.target_system, message.target_component) == (
                self.client.sysid,
                self.client.compid,
            ):
                assert self.latest is not None
                if message.sequence == (self.latest + 1) & 0xFFFF:
                    self.lost += (message.sequence_oldest_available - self.latest - 1) & 0xFFFF
                    self.latest = (message.sequence_oldest_available - 1) & 0xFFFF
                    self._ask()

    def _on_event(self, event: Any) -> None:
        if self.latest is None or event.event_time_boot_ms + 10_000 < self._boot_ms:
            self.latest = (event.sequence - 1) & 0xFFFF
        expected = (self.latest + 1) & 0xFFFF
        if newer(event.sequence, expected):
            self._ask()
        elif event.sequence == expected:
            self.latest, self._boot_ms, self._wait = event.sequence, event.event_time_boot_ms, None
            self.events.append(event)
            if newer(self.current, self.latest):
                self._ask()
