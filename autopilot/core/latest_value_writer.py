"""Background writing of the latest state: one write in progress, and at most one waiting.

A state that arrives during a write replaces the waiting one: only the latest is needed after a restart, and a slow
disk must not fill a queue.
"""

from collections.abc import Callable
from concurrent.futures import wait
from dataclasses import dataclass
from typing import Generic, TypeVar

from autopilot.core.background import BackgroundTask, BackgroundWorker, Cancel
from autopilot.core.disk import cause_of
from autopilot.core.params import Saved

KEEP_TICKS = 5
"""In lockstep a write is done so many ticks after it was asked for: 50 ms, what a flash disk needs for an fsync."""
RETRY_TICKS = 500
"""A write that failed is tried again so many ticks later (5 s), unless a newer state comes before."""
FINISH_S = 10.0
"""Timeout for a disk at the end of a run."""

Q = TypeVar("Q")


@dataclass(frozen=True, slots=True, kw_only=True)
class WriteResult:
    number: int
    """Every state up to this one is settled."""
    error: Exception | None
    """Why it is not on disk, None when it is."""


class LatestValueWriter(Generic[Q]):
    """``write`` gets immutable states and may raise; a failed write is repeated."""

    def __init__(self, worker: BackgroundWorker, write: Callable[[Q], None]) -> None:
        self._worker, self._write = worker, write
        self._number = self._submitted = self._done = 0
        self._newest: Q | None = None
        self._task: BackgroundTask[int] | None = None
        self._again_at: int | None = None
        """When a write that failed is tried again."""

    @property
    def busy(self) -> bool:
        """Whether something is being written or waits for it."""
        return self._task is not None

    def put(self, tick: int, state: Q) -> int:
        """Ask for ``state`` to be written; the result is its number."""
        self._number += 1
        self._newest = state
        if self._task is None:
            self._submit(tick)
        return self._number

    def poll(self, tick: int) -> WriteResult | None:
        """Result of the last completed write, once."""
        if self._again_at is not None and tick >= self._again_at:
            self._submit(tick)
        answer = None if self._task is None else self._task.poll(tick)
        if answer is None:
            return None
        number, self._task = self._submitted, None
        if self._submitted < self._number:
            self._submit(tick)
        elif answer.error is not None:
            self._again_at = tick + RETRY_TICKS
        return WriteResult(number=number, error=answer.error)

    def saved(self, tick: int, note: Callable[[Exception | None], None]) -> Saved | None:
        """Result of the last completed write, once, for who asked for it; ``note`` gets its error."""
        kept = self.poll(tick)
        if kept is None:
            return None
        note(kept.error)
        return Saved(number=kept.number, failure="" if kept.error is None else cause_of(kept.error))

    def finish(self, timeout_s: float = FINISH_S) -> Exception | None:
        """End of a run: write the pending state. Returns the reason of a failure, or None.

        Waits ``timeout_s`` at most: a hanging disk must not prevent the service's end.
        """
        state, number = self._newest, self._number
        if state is None or self._done == number:
            return None

        def work() -> None:
            if self._done != number:
                self._write(state)
                self._done = number

        try:
            if self._worker.executor is None:
                work()
                return None
            future = self._worker.executor.submit(work)
            if not wait((future,), timeout_s).done:
                return TimeoutError("disk does not answer")
            future.result()
        except Exception as error:  # noqa: BLE001 - no failure of the disk may stop the shutdown
            return error
        return None

    def _submit(self, tick: int) -> None:
        assert self._newest is not None
        number, state = self._number, self._newest

        def work(request: Q, _: Cancel) -> int:
            self._write(request)
            self._done = number
            return number

        self._submitted, self._again_at = number, None
        self._task = self._worker.submit(tick + KEEP_TICKS, work, state)
