"""Exchanges with a vehicle: state machines without clock and socket.

Each returns the messages to send from ``begin``, ``handle`` (a message was received) and ``tick`` (time has
passed), until ``outcome`` is set. Datagrams may be lost, duplicated or reordered: every message is retransmitted
until it is answered or the vehicle has been silent for :attr:`Timers.give_up_s`.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

from autopilot.client.texts import WARNING, TextCollector, VehicleText

Message: TypeAlias = Any
"""A message object of the dialect (pymavlink carries no types)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Timers:
    """Timeouts and retransmission intervals [s]."""

    general_s: float = 0.5
    """Before COUNT, REQUEST_LIST, a command or the last item is sent again."""
    item_s: float = 0.25
    """Before an item of a download is asked for again (MAVLink mission protocol)."""
    give_up_s: float = 10.0
    """Silence of the vehicle that ends the exchange."""
    reason_s: float = 0.8
    """Wait for a STATUSTEXT that explains a refusal."""


@dataclass(frozen=True, slots=True, kw_only=True)
class VehicleAddress:
    system: int = 1
    component: int = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class ExchangeResult:
    result: int | None
    """MAV_MISSION_RESULT or MAV_RESULT (0 = accepted in both), None = the vehicle stayed silent."""
    reason: str
    """The vehicle's own words for a refusal, else what happened; one line, empty when accepted."""

    @property
    def accepted(self) -> bool:
        return self.result == 0


class Exchange(ABC):
    """State machine of one exchange, run by :class:`autopilot.client.client_session.VehicleConnection`.

    Timeout, refusals and their reasons are common to all. Times ``t_s`` are seconds of the caller's monotonic clock.
    """

    def __init__(self, what: str, target: VehicleAddress | None, timers: Timers | None) -> None:
        self.outcome: ExchangeResult | None = None
        self._what = what
        self._target = target or VehicleAddress()
        self._timers = timers or Timers()
        self._received_s = 0.0
        self._sent_s = 0.0
        self._texts = TextCollector()
        self._complaints: list[VehicleText] = []
        self._refused: tuple[int, float] | None = None

    @property
    @abstractmethod
    def progress(self) -> tuple[int, int]:
        """Items done and items in all."""
        ...

    @abstractmethod
    def _due(self) -> Message:
        """The message that the vehicle has to answer next."""
        ...

    @property
    def _repeat_s(self) -> float:
        """After so long without an answer it is sent again."""
        return self._timers.general_s

    def begin(self, t_s: float) -> list[Message]:
        self._received_s = self._sent_s = t_s
        return [self._due()]

    @abstractmethod
    def handle(self, message: Message, t_s: float) -> list[Message]:
        """Messages to send in answer to a message of the vehicle."""
        ...

    def tick(self, t_s: float) -> list[Message]:
        """Messages to retransmit now."""
        if self._waits(t_s) or t_s - self._sent_s < self._repeat_s:
            return []
        self._sent_s = t_s
        return [self._due()]

    @property
    def complaints(self) -> tuple[str, ...]:
        """Texts of severity WARNING and worse received during the exchange."""
        return tuple(text.text for text in self._complaints)

    @property
    def hears_half_a_text(self) -> bool:
        """Whether chunks of a text are still missing."""
        return self._texts.waiting

    def grant(self, held_up_s: float) -> None:
        """Extend the timeout by the time in which the vehicle made no progress [s]."""
        self._received_s += held_up_s

    def _listens(self, message: Message, t_s: float) -> bool:
        """Collect STATUSTEXT; True while an answer of the vehicle is still expected."""
        if message.get_type() == "STATUSTEXT":
            self._take_texts(self._texts.feed(message, t_s), t_s)
        return self.outcome is None and self._refused is None

    def _take_texts(self, texts: Sequence[VehicleText], t_s: float) -> None:
        self._complaints += [text for text in texts if text.severity <= WARNING]
        if self._refused is not None and self._best_reason():
            self._finish_refusal(self._refused[0])

    def _refuse(self, result: int, t_s: float) -> None:
        """The vehicle refused: its reason may have arrived already or arrive later."""
        if self._refused is None:
            self._refused = (result, t_s)
            if self._best_reason():
                self._finish_refusal(result)

    def _best_reason(self) -> str:
        """The latest text that mentions a refusal, "" if none has arrived."""
        spoken = [c.text for c in self._complaints if "refus" in c.text.lower() or "denied" in c.text.lower()]
        return spoken[-1] if spoken else ""

    def _finish_refusal(self, result: int) -> None:
        """End with the reason; vehicles do not repeat a text at once, so there may be none."""
        unknown = f"{self._what} refused by the vehicle with result {result}; ask again in 5 s for its reason"
        others = self._complaints[-1].text if self._complaints else ""
        self.outcome = ExchangeResult(result=result, reason=self._best_reason() or others or unknown)

    def _waits(self, t_s: float) -> bool:
        """True when nothing has to be sent now: ended, waiting for a reason, or given up."""
        self._take_texts(self._texts.flush(t_s), t_s)
        if self.outcome is not None:
            return True
        if self._refused is not None:
            if t_s - self._refused[1] >= self._timers.reason_s:
                self._finish_refusal(self._refused[0])
            return True
        if t_s - self._received_s >= self._timers.give_up_s:
            text = f"{self._what}: the vehicle did not answer for {self._timers.give_up_s:g} s; check the connection"
            self.outcome = ExchangeResult(result=None, reason=text)
            return True
        return False
