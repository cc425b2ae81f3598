"""Background work of the loop: a request is pure data, its result is delivered a fixed number of ticks after it.

Everything that does not fit into a tick (validation of plans, route search, energy plans, certificates, disk) runs on
a worker. A worker is a queue: requests are processed in order, and one that is cancelled before its start is skipped.
The result of a run must not depend on the speed of the machine: in lockstep the loop waits at a *blocking* worker for
a result that is due; in real time the loop continues and takes the result when it is ready, and late ones are counted.
Without an executor the work is done when its result is due (tests, studies).
"""

from collections.abc import Callable
from concurrent.futures import CancelledError, Executor, Future, wait
from concurrent.futures import TimeoutError as NotReadyError
from dataclasses import dataclass
from typing import Any, Generic, TypeVar, cast

from autopilot.core.nondeterminism import NondeterminismSource

ROOM_S = 0.0005
"""Sleep of the loop per poll of a late result. A loop without sleep (an overloaded machine) releases its lock and takes
it back before the worker's thread has woken up: the result would never arrive."""

IDLE_S = 0.05
"""Interval in which a waiting loop serves urgent tasks (heartbeats)."""

Q = TypeVar("Q")
A = TypeVar("A")


class WithdrawnError(Exception):
    """Ends a cancelled task; it is not reported."""


class Cancel:
    """Cancellation flag of a task; long work checks it between its steps and may then return anything."""

    __slots__ = ("requested",)

    def __init__(self) -> None:
        self.requested = False

    def check(self) -> None:
        """Raise WithdrawnError if the answer is not wanted any more."""
        if self.requested:
            raise WithdrawnError


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class TaskResult(Generic[A]):
    """Result of a task: a value, or the exception that ended it."""

    value: A | None
    error: Exception | None = None

    def get(self) -> A:
        """The value, or the work's exception."""
        if self.error is not None:
            raise self.error
        return cast(A, self.value)


class BackgroundTask(Generic[A]):
    """A request that has been handed in. ``poll`` gives its answer once; after ``cancel`` there is none."""

    def __init__(self, worker: "BackgroundWorker", due: int, work: Callable[[], A], cancel: Cancel) -> None:
        self._worker, self._work, self._cancel = worker, work, cancel
        self._late = False
        self._future: Future[A] | None = None if worker.executor is None else worker.executor.submit(work)
        self.due = due
        """When the answer is to be taken, in the caller's counts."""
        self.open = True
        """Until it is answered or cancelled."""

    def poll(self, now: int) -> TaskResult[A] | None:
        """The result, once, when it is due (and ready, unless the worker is blocking)."""
        if not self.open or now < self.due:
            return None
        future = self._future
        if future is not None and not self._worker.blocking and not self._worker.ready(future):
            self._worker.late += not self._late
            self._late = True
            return None
        self.open = False
        try:
            return TaskResult(value=self._work() if future is None else self._worker.wait(future))
        except CancelledError:  # the worker was closed
            return None
        except Exception as error:  # noqa: BLE001 - the task's own; handled by the caller
            return TaskResult(value=None, error=error)

    def cancel(self) -> None:
        """The answer is not wanted any more."""
        self.open = False
        self._cancel.requested = True
        if self._future is not None:
            self._future.cancel()


class BackgroundWorker:
    def __init__(self, executor: Executor | None = None, *, blocking: bool = True) -> None:
        self.executor, self.blocking = executor, blocking
        self.late = 0
        """Answers that were not there when they were due."""
        self.idle: Callable[[], None] = lambda: None
        """Called now and then while the loop waits for an answer."""
        self.ready: Callable[[Future[Any]], bool] = _there
        """Whether a result is ready, at a worker that is not blocking. A replay uses the recorded answer, and waits."""

    def witnessed(self, name: str, nondeterminism: NondeterminismSource) -> "BackgroundWorker":
        """Record the times at which results are ready; returns this worker."""
        self.ready = lambda future: nondeterminism.observe(f"{name} ready", False, lambda: _there(future))
        return self

    def submit(self, due: int, work: Callable[[Q, Cancel], A], request: Q) -> BackgroundTask[A]:
        """Ask for ``work(request, cancel)``; the answer is taken when the caller's count has reached ``due``.

        ``request`` must not change any more, and ``work`` may touch nothing else that does.
        """
        cancel = Cancel()
        return BackgroundTask(self, due, lambda: work(request, cancel), cancel)

    def run(self, work: Callable[[], None]) -> None:
        """Queue ``work``, which must not raise and has no result."""
        if self.executor is None:
            work()
        else:
            self.executor.submit(work)

    def wait(self, future: "Future[A]") -> A:
        """The result of ``future``, without a timeout."""
        while not future.done():
            try:
                return future.result(IDLE_S)
            except NotReadyError:
                self.idle()
        return future.result()

    def close(self) -> None:
        """Start no further tasks; the running one is left to end."""
        if self.executor is not None:
            self.executor.shutdown(wait=False, cancel_futures=True)


def _there(future: Future[Any]) -> bool:
    """Whether the task has ended; if not, yield to its thread."""
    return future.done() or bool(wait((future,), ROOM_S).done)
