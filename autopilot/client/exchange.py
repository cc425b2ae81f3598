"""What all exchanges with a vehicle share, as state machines without clock and socket.

Each gives the messages to send from ``begin``, ``handle`` (one received message) and ``tick`` (time has passed), until
``outcome`` is set. Lost, repeated and swapped datagrams are part of the job: everything is repeated until it is
answered or the vehicle has been silent for :attr:`Timers.give_up_s`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias

from autopilot.client.texts import WARNING, TextCollector, VehicleText

Message: TypeAlias = Any
"""A message object of the dialect (pymavlink carries no types)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Timers:
    """Waiting times [s]."""

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


class Exchange(Protocol):
    """What :class:`autopilot.client.client_session.VehicleConnection` runs."""

    outcome: ExchangeResult | None

    @property
    def progress(self) -> tuple[int, int]:
        """Items done and items in all."""
        ...

    def begin(self, t_s: float) -> list[Message]: ...

    def handle(self, message: Message, t_s: float) -> list[Message]:
        """Answers to a message of the vehicle."""
        ...

    def tick(self, t_s: float) -> list[Message]:
        """Messages to repeat now."""
        ...

    def grant(self, held_up_s: float) -> None:
        """The vehicle could not get on for so long: that is no silence of its own."""
        ...


class BaseExchange:
    """Silence, refusals and their reasons: common to all exchanges."""

    def __init__(self, target: VehicleAddress, timers: Timers, what: str) -> None:
        self.outcome: ExchangeResult | None = None
        self._target = target
        self._timers = timers
        self._what = what
        self._heard_s = 0.0
        self._sent_s = 0.0
        self._texts = TextCollector()
        self._complaints: list[VehicleText] = []
        self._refused: tuple[int, float] | None = None

    @property
    def complaints(self) -> tuple[str, ...]:
        """Warnings and worse that the vehicle has said meanwhile."""
        return tuple(text.text for text in self._complaints)

    @property
    def hears_half_a_text(self) -> bool:
        """Whether chunks of a text are still to come."""
        return self._texts.waiting

    def _start(self, t_s: float) -> None:
        self._heard_s = self._sent_s = t_s

    def grant(self, held_up_s: float) -> None:
        """The vehicle could not get on for so long: that is no silence of its own."""
        self._heard_s += held_up_s

    def _listens(self, message: Message, t_s: float) -> bool:
        """Keep what the vehicle says in words; True while its answers still matter."""
        if message.get_type() == "STATUSTEXT":
            self._take_texts(self._texts.feed(message, t_s), t_s)
        return self.outcome is None and self._refused is None

    def _take_texts(self, texts: Sequence[VehicleText], t_s: float) -> None:
        self._complaints += [text for text in texts if text.severity <= WARNING]
        if self._refused is not None and self._best_reason():
            self._finish_refusal(self._refused[0])

    def _refuse(self, result: int, t_s: float) -> None:
        """The vehicle said no: its reason may already be there or still come."""
        if self._refused is None:
            self._refused = (result, t_s)
            if self._best_reason():
                self._finish_refusal(result)

    def _best_reason(self) -> str:
        """The complaint that speaks of a refusal, "" if there is none yet."""
        spoken = [c.text for c in self._complaints if "refus" in c.text.lower() or "denied" in c.text.lower()]
        return spoken[-1] if spoken else ""

    def _finish_refusal(self, result: int) -> None:
        """A vehicle does not say the same again at once, so there may be no reason."""
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
        if t_s - self._heard_s >= self._timers.give_up_s:
            text = f"{self._what}: the vehicle did not answer for {self._timers.give_up_s:g} s; check the connection"
            self.outcome = ExchangeResult(result=None, reason=text)
            return True
        return False
