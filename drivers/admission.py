"""Admission of clients to a shared port with a limited number of places.

Policy only: no socket, no clock (``t_us`` is an argument); the reader of the link supplies what a client has sent. The
rule is in docs/threats.md ("Who is served").
"""

from collections.abc import Callable, Hashable, Iterable
from dataclasses import dataclass
from enum import Enum
from typing import Generic, TypeVar

from autopilot.core.clients import ClientRecord

KEEP_US = 5_000_000
"""A client with a valid frame within this time is not displaced."""
TURN_US = 2_000_000
"""Shortest stay in the reserve place, and retry interval of waiting clients (heartbeats come every second)."""
MAX_WAITING = 64
"""Number of waiting clients that are remembered, the latest."""

K = TypeVar("K", bound=Hashable)


class Why(Enum):
    """Reason for the loss of a place."""

    UNPROVEN = "sent nothing valid"
    SILENT = "silent"
    KEPT = "kept for the operator in control"


@dataclass(frozen=True, slots=True)
class DisplacedClient(Generic[K]):
    key: K
    why: Why
    silent_us: int


@dataclass(frozen=True, slots=True)
class AdmissionReply(Generic[K]):
    """Result of a request for a place."""

    admitted: bool
    displaced: DisplacedClient[K] | None = None


@dataclass(slots=True)
class _Seat:
    entered_us: int
    turn: int
    last_received_us: int
    expected: bool


class Admission(Generic[K]):
    """``places`` of a port and one reserve: it is used when all others belong to active clients, and rotates among the
    waiting ones, so that the operator in control is always admitted. ``standing``: received data of a client. Clients
    get ``grace_us`` before they are judged.
    """

    def __init__(self, places: int, standing: Callable[[K], ClientRecord], grace_us: int = 0) -> None:
        self._most = places + 1
        self._standing = standing
        self._grace_us = grace_us
        self._places: dict[K, _Seat] = {}
        """In the order in which they came."""
        self._turn = 0
        self._waiting: dict[K, tuple[int, int]] = {}
        """Who was turned away: when first and when last, the longest silent first."""

    def __contains__(self, key: object) -> bool:
        return key in self._places

    def __len__(self) -> int:
        return len(self._places)

    def begin(self) -> None:
        """Another reading of the port: who has come in the one before had the time to be understood."""
        self._turn += 1

    def note_received(self, key: K, t_us: int) -> None:
        self._places[key].last_received_us = t_us

    def leave(self, key: K) -> None:
        self._places.pop(key, None)

    def has_place(self, t_us: int) -> bool:
        """Whether the next one who asks is admitted."""
        return len(self._places) < self._most - 1 or self._decide(t_us).admitted

    def enter(self, key: K, t_us: int, *, always: bool = False) -> AdmissionReply[K]:
        """Request of a new client; ``always``: expected, admitted in any case."""
        entry: AdmissionReply[K] = (
            AdmissionReply(True) if always or len(self._places) < self._most - 1 else self._decide(t_us)
        )
        if entry.displaced is not None and entry.displaced.why is Why.KEPT and not self._is_next(key, t_us):
            entry = AdmissionReply(False)
        if entry.displaced is not None:
            self.leave(entry.displaced.key)
        first_us, _ = self._waiting.pop(key, (t_us, t_us))
        if not entry.admitted:
            self._waiting[key] = first_us, t_us
            if len(self._waiting) > MAX_WAITING:
                del self._waiting[next(iter(self._waiting))]
        if entry.admitted:
            self._places[key] = _Seat(t_us, self._turn, t_us, always)
        return entry

    def idle(self, t_us: int, unproven_us: int, proven_us: int) -> list[K]:
        """Clients silent for longer than these times, which depend on whether they have ever sent a valid frame."""
        removed = []
        for key, place in self._places.items():
            silent_us = t_us - place.last_received_us
            if silent_us > unproven_us and (silent_us > proven_us or self._standing(key).valid_us is None):
                removed.append(key)
        return removed

    def _is_next(self, key: K, t_us: int) -> bool:
        """Whether no other waiting client has waited longer."""
        mine_us = self._waiting.get(key, (t_us, t_us))[0]
        return all(first_us >= mine_us for first_us, last_us in self._waiting.values() if t_us - last_us <= TURN_US)

    def _decide(self, t_us: int) -> AdmissionReply[K]:
        """When all places but the kept one are taken."""
        known = [(key, place, self._standing(key)) for key, place in self._places.items()]
        free = [each for each in known if not (each[1].expected or each[2].in_control)]
        victim = _first(self._unproven(free, t_us)) or _first(self._silent(free, t_us))
        if victim is None and len(self._places) < self._most:
            return AdmissionReply(True)
        if victim is None:
            victim = _first(self._latest(free, t_us))
        return AdmissionReply(victim is not None, victim)

    def _unproven(
        self, known: Iterable[tuple[K, _Seat, ClientRecord]], t_us: int
    ) -> Iterable[tuple[int, DisplacedClient[K]]]:
        """Clients without a valid frame, in order of arrival."""
        for key, place, standing in known:
            age_us = t_us - place.entered_us
            if standing.valid_us is None and place.turn < self._turn and age_us >= self._grace_us:
                yield place.entered_us, DisplacedClient(key, Why.UNPROVEN, t_us - place.last_received_us)

    def _silent(
        self, known: Iterable[tuple[K, _Seat, ClientRecord]], t_us: int
    ) -> Iterable[tuple[int, DisplacedClient[K]]]:
        """Clients without a recent valid frame, the longest silent first."""
        for key, _, standing in known:
            if standing.valid_us is not None and t_us - standing.valid_us >= KEEP_US:
                yield standing.valid_us, DisplacedClient(key, Why.SILENT, t_us - standing.valid_us)

    def _latest(
        self, known: Iterable[tuple[K, _Seat, ClientRecord]], t_us: int
    ) -> Iterable[tuple[int, DisplacedClient[K]]]:
        """The last arrival whose grace time is over."""
        for key, place, standing in list(known)[-1:]:
            if standing.valid_us is not None and t_us - place.entered_us >= TURN_US:
                yield 0, DisplacedClient(key, Why.KEPT, t_us - standing.valid_us)


def _first(candidates: Iterable[tuple[int, DisplacedClient[K]]]) -> DisplacedClient[K] | None:
    """The one with the least number, the earliest of equals."""
    least = min(candidates, key=lambda each: each[0], default=None)
    return None if least is None else least[1]


class AdmissionNotices:
    """Notices to operators about displaced and refused clients of a port: one line per call, at the caller's rate."""

    def __init__(self) -> None:
        self._line = ""
        self._warning = False
        self._more = 0

    def note(self, text: str, *, warning: bool = True) -> None:
        """Something happened; only the first is named."""
        if self._line:
            self._more += 1
        else:
            self._line = text
        self._warning |= warning

    def take(self) -> tuple[bool, str] | None:
        """Whether it is a warning, and the line; None when nothing happened."""
        if not self._line:
            return None
        taken = self._warning, f"{self._line} ({self._more} more)" if self._more else self._line
        self._line, self._warning, self._more = "", False, 0
        return taken


def displaced_text(sender: str, removed: DisplacedClient[K]) -> str:
    """The line about who lost his place."""
    seconds = removed.silent_us // 1_000_000
    why = f"silent for {seconds} s" if removed.why is Why.SILENT else removed.why.value
    return f"{sender} lost its place: {why}"
