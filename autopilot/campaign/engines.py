"""Who flies the runs: this process, a pool of processes on this machine, or a Dask cluster."""

import concurrent.futures as cf
import gc
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from multiprocessing.synchronize import Event
from typing import Any, Protocol, TypeVar

from autopilot import THREAD_VARIABLES
from autopilot.core.errors import AutopilotError, ConfigError

LOOK_S = 0.2
"""How often a waiting engine looks whether it is to stop."""

Stop = Callable[[], bool]


Result = TypeVar("Result")
Result_co = TypeVar("Result_co", covariant=True)


class Flyable(Protocol[Result_co]):
    """One run, complete in itself and fit to be sent to another process."""

    def fly(self, stop: Stop) -> Result_co | None:
        """The result, None if ``stop`` said so before the end. AutopilotError if it cannot be flown."""
        ...

    def failed(self, error: str) -> Result_co:
        """The result of a run that could not be flown."""
        ...


class Engine(Protocol):
    """Flies tasks in any order."""

    def run(self, tasks: Sequence[Flyable[Result]], stop: Stop) -> Iterator[Result]:
        """Results as they come; ends early, without results of unfinished runs, when ``stop`` says so."""
        ...


def make_engine(name: str, jobs: int | None) -> Engine:
    """``local``, ``dask`` or ``dask+tcp://HOST:PORT``; ``jobs`` None = one per core. ConfigError if unknown."""
    count = jobs or os.cpu_count() or 1
    if name == "local":
        return InProcess() if count == 1 else LocalPool(count)
    if name == "dask" or name.startswith("dask+tcp://"):
        return DaskCluster(name.removeprefix("dask+") if name != "dask" else None, count)
    raise ConfigError(f"--engine {name!r}: use local, dask or dask+tcp://HOST:PORT")


class InProcess:
    """One after the other, here."""

    def run(self, tasks: Sequence[Flyable[Result]], stop: Stop) -> Iterator[Result]:
        """See :class:`Engine`."""
        for task in tasks:
            if stop():
                return
            try:
                result = task.fly(stop)
            except AutopilotError as error:
                result = task.failed(str(error))
            if result is not None:
                yield result


class LocalPool:
    """A process per core. Each imports once and flies many runs."""

    def __init__(self, jobs: int) -> None:
        self._jobs = jobs

    def run(self, tasks: Sequence[Flyable[Result]], stop: Stop) -> Iterator[Result]:
        """See :class:`Engine`. AutopilotError if a process dies."""
        if not tasks:
            return
        context = multiprocessing.get_context("spawn")
        halt = context.Event()
        with (
            _single_threaded(),
            cf.ProcessPoolExecutor(
                min(self._jobs, len(tasks)), mp_context=context, initializer=_begin_worker, initargs=(halt,)
            ) as pool,
        ):
            with _deaf_to_interrupt():
                pending = {pool.submit(_fly_in_worker, task): task for task in tasks}
            try:
                while pending and not stop():
                    done, _ = cf.wait(pending, LOOK_S, cf.FIRST_COMPLETED)
                    for future in done:
                        result = _outcome(future, pending.pop(future))
                        if result is not None:
                            yield result
            finally:
                halt.set()
                pool.shutdown(wait=True, cancel_futures=True)


def _outcome(future: "cf.Future[Result | None]", task: Flyable[Result]) -> Result | None:
    """The result; a run that raised is a failed one; a process that died is nobody's result."""
    error = future.exception()
    if isinstance(error, cf.process.BrokenProcessPool):
        raise AutopilotError(
            "a worker process died (out of memory?); finished runs are kept, start again with fewer --jobs"
        ) from error
    if error is not None:
        return task.failed(f"{type(error).__name__}: {error}")
    return future.result()


_halt: Event | None = None
"""In a worker process: set when it is to stop."""


def _begin_worker(halt: Event) -> None:
    """Once per process: interrupts are the parent's business; what is imported needs no garbage collection."""
    global _halt
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _halt = halt
    import autopilot.campaign.flight  # noqa: F401

    gc.collect()
    gc.freeze()


def _fly_in_worker(task: Flyable[Result]) -> Result | None:
    return task.fly((lambda: False) if _halt is None else _halt.is_set)


@contextmanager
def _single_threaded() -> Iterator[None]:
    """Processes that begin meanwhile use one thread for linear algebra: several runs would only wait for each other."""
    before = {name: os.environ.get(name) for name in THREAD_VARIABLES}
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


@contextmanager
def _deaf_to_interrupt() -> Iterator[None]:
    """Processes that begin meanwhile do not hear Ctrl-C before they can ignore it themselves."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


class DaskCluster:
    """A Dask cluster: one of its own on this machine, or the scheduler at ``address``."""

    def __init__(self, address: str | None, jobs: int) -> None:
        """ConfigError if dask.distributed is not installed."""
        try:
            import distributed
        except ImportError as error:
            raise ConfigError(
                "--engine dask needs dask.distributed; install underwater-autopilot[cluster] or use --engine local"
            ) from error
        self._distributed: Any = distributed
        self._address = address
        self._jobs = jobs

    def run(self, tasks: Sequence[Flyable[Result]], stop: Stop) -> Iterator[Result]:
        """See :class:`Engine`. ConfigError if the scheduler does not answer."""
        with self._client() as client:
            pending = {client.submit(_fly_in_worker, task, pure=False): task for task in tasks}
            while pending and not stop():
                try:
                    finished = self._distributed.wait(list(pending), timeout=LOOK_S, return_when="FIRST_COMPLETED").done
                except TimeoutError:
                    continue
                for future in finished:
                    task = pending.pop(future)
                    error = future.exception()
                    if error is not None:
                        yield task.failed(f"{type(error).__name__}: {error}")
                    else:
                        result: Result | None = future.result()
                        if result is not None:
                            yield result
            client.cancel(list(pending))

    def _client(self) -> Any:
        if self._address is None:
            return self._distributed.Client(n_workers=self._jobs, threads_per_worker=1, dashboard_address=None)
        try:
            return self._distributed.Client(self._address, timeout="10s")
        except OSError as error:
            raise ConfigError(f"--engine dask+{self._address}: no scheduler answers; check the address") from error
