"""Disk access of the service through a nondeterminism recorder: recorded in flight, replayed from the log."""

from collections.abc import Callable
from dataclasses import dataclass

from autopilot.core.background import BackgroundTask
from autopilot.core.log_directory import LogDirectory, LogDirectoryEntry
from autopilot.core.nondeterminism import NondeterminismSource
from autopilot.core.params import ParamSaving, Saved
from autopilot.mavlink.api import SigningState, SigningStore

SHELF_ASKED = "logs asked for"
"""Kind of the note that a client has accessed logs, whose content is in no log."""


@dataclass(frozen=True, slots=True)
class WitnessedSaving:
    """A :class:`autopilot.core.params.ParamSaving` whose answers are recorded."""

    saving: ParamSaving
    nondeterminism: NondeterminismSource

    def save(self, tick: int, name: str) -> int | None:
        return self.nondeterminism.observe("parameter saving", None, lambda: self.saving.save(tick, name))

    def saved(self, tick: int) -> Saved | None:
        return _saved(self.nondeterminism, "parameters saved", lambda: self.saving.saved(tick))


def _saved(nondeterminism: NondeterminismSource, kind: str, poll: Callable[[], Saved | None]) -> Saved | None:
    def found() -> tuple[int, str] | None:
        saved = poll()
        return None if saved is None else (saved.number, saved.failure)

    fact = nondeterminism.observe(kind, None, found)
    return None if fact is None else Saved(number=fact[0], failure=fact[1])


@dataclass(frozen=True, slots=True)
class WitnessedStore:
    """Where key and signing time are kept (:class:`autopilot.mavlink.api.SigningStore`)."""

    store: SigningStore
    nondeterminism: NondeterminismSource

    @property
    def state(self) -> SigningState:
        return self.store.state

    def keep(self, tick: int, state: SigningState) -> None:
        self.store.keep(tick, state)

    def poll(self, tick: int) -> Saved | None:
        return _saved(self.nondeterminism, "key saved", lambda: self.store.poll(tick))


@dataclass(frozen=True, slots=True)
class RecordedLogDirectory:
    """Log directory for clients; an access is recorded, its content is not."""

    log_directory: LogDirectory
    nondeterminism: NondeterminismSource

    def list(self, tick: int) -> BackgroundTask[tuple[LogDirectoryEntry, ...]]:
        self._note()
        return self.log_directory.list(tick)

    def read(self, tick: int, path: str, offset: int, size: int) -> BackgroundTask[bytes]:
        self._note()
        return self.log_directory.read(tick, path, offset, size)

    def crc32(self, tick: int, path: str) -> BackgroundTask[int]:
        self._note()
        return self.log_directory.crc32(tick, path)

    def erase(self, tick: int) -> BackgroundTask[int]:
        self._note()
        return self.log_directory.erase(tick)

    def _note(self) -> None:
        self.nondeterminism.observe(SHELF_ASKED, False, lambda: True)
