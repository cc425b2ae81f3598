"""A thread for disk access that does not delay the end of the process."""

import queue
import threading
import weakref
from collections.abc import Callable
from concurrent.futures import Executor, Future
from typing import Any, ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")

Job = tuple[Future[Any], Callable[[], Any]]


class DaemonExecutor(Executor):
    """One daemon thread with a queue.

    The interpreter joins the threads of a ThreadPoolExecutor at its exit, but not this one. The thread ends after
    :meth:`shutdown`, or when the executor is no longer referenced.
    """

    def __init__(self, name: str) -> None:
        """``name``: of the thread, which begins with the first job."""
        self._jobs: queue.SimpleQueue[Job | None] = queue.SimpleQueue()
        self._lock = threading.Lock()
        self._closed = False
        self._thread = threading.Thread(target=_work, args=(self._jobs,), name=name, daemon=True)
        weakref.finalize(self, self._jobs.put, None)

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """Have ``fn`` called after all that was submitted before. RuntimeError after :meth:`shutdown`."""
        future: Future[T] = Future()
        with self._lock:
            if self._closed:
                raise RuntimeError(f"{self._thread.name}: nothing is taken any more")
            self._jobs.put((future, lambda: fn(*args, **kwargs)))
            if self._thread.ident is None:
                self._thread.start()
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        with self._lock:
            if not self._closed:
                self._closed = True
                if cancel_futures:
                    self._cancel_waiting()
                self._jobs.put(None)
        if wait and self._thread.ident is not None:
            self._thread.join()

    def _cancel_waiting(self) -> None:
        try:
            while True:
                job = self._jobs.get_nowait()
                if job is not None:
                    job[0].cancel()
        except queue.Empty:
            return


def _work(jobs: "queue.SimpleQueue[Job | None]") -> None:
    """The thread: it references the queue, not the executor, which can be collected while it waits."""
    while (job := jobs.get()) is not None:
        _do(*job)
        del job  # releases its references: the next job may come much later


def _do(future: Future[Any], call: Callable[[], Any]) -> None:
    if not future.set_running_or_notify_cancel():
        return
    try:
        result = call()
    except BaseException as error:  # noqa: BLE001 - handled by the caller
        future.set_exception(error)
    else:
        future.set_result(result)
