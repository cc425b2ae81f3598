"""What the service asks of disks, with a witness beside it: a flight notes the answers, a replay has them from its
log."""

from collections.abc import Callable
from dataclasses import dataclass

from autopilot.core.desk import Ticket
from autopilot.core.log_directory import Shelf, ShelfFile
from autopilot.core.params import ParamSaving, Saved
from autopilot.core.witness import Witness
from autopilot.mavlink.api import SigningState, SigningStore

SHELF_ASKED = "logs asked for"
"""Kind of the note that a client has looked at logs: what it was shown is not in any log."""


@dataclass(frozen=True, slots=True)
class WitnessedSaving:
    """Where parameters are kept (:class:`autopilot.core.params.ParamSaving`)."""

    saving: ParamSaving
    witness: Witness

    def save(self, tick: int, name: str) -> int | None:
        return self.witness.ask("parameter saving", None, lambda: self.saving.save(tick, name))

    def saved(self, tick: int) -> Saved | None:
        return _saved(self.witness, "parameters saved", lambda: self.saving.saved(tick))


def _saved(witness: Witness, kind: str, ask: Callable[[], Saved | None]) -> Saved | None:
    def found() -> tuple[int, str] | None:
        saved = ask()
        return None if saved is None else (saved.number, saved.failure)

    fact = witness.ask(kind, None, found)
    return None if fact is None else Saved(number=fact[0], failure=fact[1])


@dataclass(frozen=True, slots=True)
class WitnessedStore:
    """Where key and signing time are kept (:class:`autopilot.mavlink.api.SigningStore`)."""

    store: SigningStore
    witness: Witness

    @property
    def state(self) -> SigningState:
        """As found at the start."""
        return self.store.state

    def keep(self, tick: int, state: SigningState) -> None:
        self.store.keep(tick, state)

    def poll(self, tick: int) -> Saved | None:
        return _saved(self.witness, "key saved", lambda: self.store.poll(tick))


@dataclass(frozen=True, slots=True)
class WitnessedShelf:
    """The logs for clients; that one has looked at them is noted, what it saw is not."""

    shelf: Shelf
    witness: Witness

    def list(self, tick: int) -> Ticket[tuple[ShelfFile, ...]]:
        self._note()
        return self.shelf.list(tick)

    def read(self, tick: int, path: str, offset: int, size: int) -> Ticket[bytes]:
        self._note()
        return self.shelf.read(tick, path, offset, size)

    def crc32(self, tick: int, path: str) -> Ticket[int]:
        self._note()
        return self.shelf.crc32(tick, path)

    def erase(self, tick: int) -> Ticket[int]:
        self._note()
        return self.shelf.erase(tick)

    def _note(self) -> None:
        self.witness.ask(SHELF_ASKED, False, lambda: True)
