"""Record and replay of the answers that do not follow from the inputs.

A step depends on a few external results: whether background work is ready (in real time), whether a disk write has
completed, whether a signature matches our key. Every answer other than the default is recorded with its kind and the
number of queries since the last record was taken; in a replay :class:`NondeterminismReplay` returns it at the same
query.
"""

from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Protocol, TypeAlias, TypeVar, cast

Fact: TypeAlias = bool | int | str | tuple[int, str] | None
"""What is noted: it has to survive JSON."""

F = TypeVar("F", bound=Fact)


@dataclass(frozen=True, slots=True)
class Note:
    """An answer that was not the usual one."""

    kind: str
    number: int
    """The n-th question of its kind of this tick, from 1."""
    fact: Fact


class NondeterminismSource(Protocol):
    def observe(self, kind: str, usual: F, find: Callable[[], F]) -> F:
        """The answer to a question; ``find`` gets it in flight, ``usual`` is the one that need not be noted."""
        ...

    def take(self) -> tuple[Note, ...]:
        """The notes of the tick that ends now."""
        ...


class NondeterminismRecorder:
    def __init__(self) -> None:
        self._counts: dict[str, int] = {}
        self._notes: list[Note] = []

    def observe(self, kind: str, usual: F, find: Callable[[], F]) -> F:
        """Find the answer, and note it where it is not the usual one."""
        self._counts[kind] = self._counts.get(kind, 0) + 1
        fact = find()
        if fact != usual:
            self._notes.append(Note(kind, self._counts[kind], fact))
        return fact

    def take(self) -> tuple[Note, ...]:
        """The notes since the last call; counting begins anew."""
        if self._counts:
            self._counts.clear()
        if not self._notes:
            return ()
        notes, self._notes = tuple(self._notes), []
        return notes


class NondeterminismReplay:
    """Returns the recorded answers in a replay."""

    def __init__(self) -> None:
        self._counts: Counter[str] = Counter()
        self._notes: tuple[Note, ...] = ()
        self._facts: dict[tuple[str, int], Fact] = {}

    def tell(self, notes: Iterable[Note]) -> None:
        """The answers of the tick that begins now."""
        self._counts.clear()
        self._notes = tuple(notes)
        self._facts = {(note.kind, note.number): note.fact for note in self._notes}

    def observe(self, kind: str, usual: F, find: Callable[[], F]) -> F:
        del find
        self._counts[kind] += 1
        # Notes of a kind are of the kind of its usual answer.
        return cast(F, self._facts.get((kind, self._counts[kind]), usual))

    def take(self) -> tuple[Note, ...]:
        return self._notes
