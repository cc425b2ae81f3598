"""Engines that fly the runs of a campaign: this process, a process pool, or a Dask cluster."""

import asyncio
import concurrent.futures as cf
import gc
import importlib
import logging
import multiprocessing
import os
import select
import signal
import sys
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from multiprocessing import resource_tracker
from typing import Any, Protocol, TypeVar

from autopilot import THREAD_VARIABLES, __version__
from autopilot.core.errors import AutopilotError, ConfigError
from autopilot.core.own_python import safe_path

POLL_S = 0.2
"""Interval at which a waiting engine polls ``stop``."""
SUSPECT = 2
"""Deaths of processes during a run after which it is flown alone."""
AHEAD = 2
"""Runs per process, or thread of a cluster, that are handed out at a time: one that dies takes few with it."""
WORKER = "autopilot.campaign.worker"
"""Imports all that a run needs."""
CONNECT_S = 10.0
FIRST_WORKER_S = 30.0
NO_WORKER_S = 300.0
"""How long a cluster may be without any worker before the campaign ends."""
CHATTY = ("distributed", "tornado", "asyncio")
"""Loggers of a cluster's client; those below them have levels of their own."""
DIED = "the process that flew it died each time (out of memory?)"

Stop = Callable[[], bool]


Result = TypeVar("Result")
Result_co = TypeVar("Result_co", covariant=True)


class Flyable(Protocol[Result_co]):
    """One picklable run."""

    def fly(self, stop: Stop) -> Result_co | None:
        """Fly the run.

        Parameters
        ----------
        stop
            Polled during the run; True ends it.

        Returns
        -------
        Result or None
            None if ``stop`` ended the run.

        Raises
        ------
        AutopilotError
            The run cannot be flown.
        """
        ...

    def failed(self, error: str) -> Result_co:
        """Result of a run that could not be flown; ``error`` is the reason in one line."""
        ...


class CampaignEngine(Protocol):
    """Flies tasks in any order."""

    def run(self, tasks: Sequence[Flyable[Result]], stop: Stop) -> Iterator[Result]:
        """Fly all tasks.

        Parameters
        ----------
        tasks
            Independent of each other; flown in any order.
        stop
            Polled; True ends the iteration early, without results of unfinished runs.

        Yields
        ------
        Result
            In the order of completion.
        """
        ...


def make_engine(name: str, jobs: int | None) -> CampaignEngine:
    """Engine by name.

    Parameters
    ----------
    name
        ``local``, ``dask`` or ``dask+tcp://HOST:PORT``.
    jobs
        Number of processes, None = one per core.

    Returns
    -------
    CampaignEngine

    Raises
    ------
    ConfigError
        The name is unknown, or dask.distributed is not installed.
    """
    count = jobs or os.cpu_count() or 1
    if name == "local":
        return InProcess() if count == 1 else LocalPool(count)
    if name == "dask" or name.startswith("dask+tcp://"):
        return DaskCluster(name.removeprefix("dask+") if name != "dask" else None, count)
    raise ConfigError(f"--engine {name!r}: use local, dask or dask+tcp://HOST:PORT")


def flown_or_failed(task: Flyable[Result], stop: Stop) -> Result | None:
    """The result of a run, also of one that raises; None if ``stop`` ended it."""
    try:
        return task.fly(stop)
    except Exception as error:  # noqa: BLE001 - one run that cannot be flown ends no campaign
        return task.failed(_what(error))


class InProcess:
    """Runs tasks one after the other in this process."""

    def run(self, tasks: Sequence[Flyable[Result]], stop: Stop) -> Iterator[Result]:
        for task in tasks:
            if stop():
                return
            result = flown_or_failed(task, stop)
            if result is not None:
                yield result


class LocalPool:
    """A process per core, each of which flies many runs.

    On Linux they are forked from a server process without threads that has only imported the modules of a run; it
    starts when the engine is created. On other systems each process imports for itself.
    """

    def __init__(self, jobs: int) -> None:
        self._jobs = jobs
        self._context: Any = multiprocessing.get_context("forkserver" if sys.platform == "linux" else "spawn")
        self._prepare()

    def _prepare(self) -> None:
        """Start the fork server if it is used and not running. Does not wait for it."""
        if self._context.get_start_method() != "forkserver":
            return
        from multiprocessing import forkserver

        self._context.set_forkserver_preload([WORKER])
        with safe_path(), _single_threaded(), interrupt_later():
            forkserver.ensure_running()

    def run(self, tasks: Sequence[Flyable[Result]], stop: Stop) -> Iterator[Result]:
        """See :class:`CampaignEngine`. If a process dies its runs are repeated; a run that kills its process again
        when it is flown alone has failed. AutopilotError if no process can start.
        """
        if tasks:
            self._check_start(stop)
        left = dict(enumerate(tasks))
        deaths: Counter[int] = Counter()
        while left and not stop():
            suspects = [key for key in left if deaths[key] >= SUSPECT]
            trusted = [key for key in left if deaths[key] < SUSPECT]
            # Runs under way during more than one death of a process are flown alone, after all others.
            batch = trusted or suspects[:1]
            broken: list[int] = []
            for key, result in self._batch({key: left[key] for key in batch}, stop, broken):
                del left[key]
                if result is not None:
                    yield result
            deaths.update(broken)
            if broken and not trusted:
                yield left.pop(broken[0]).failed(DIED)

    def _batch(
        self, tasks: dict[int, Flyable[Result]], stop: Stop, broken: list[int]
    ) -> Iterator[tuple[int, Result | None]]:
        """Results until all are there or a process dies; ``broken``: the runs that were under way then."""
        self._prepare()
        # One byte without a lock, unlike an Event: a process killed while it holds the lock would never release it.
        halt = self._context.RawValue("b", 0)
        with self._pool(min(self._jobs, len(tasks)), halt) as pool:
            running: set[int] = set()
            waiting = deque(tasks.items())
            pending: dict[cf.Future[Result | None], int] = {}
            try:
                while (waiting or pending) and not stop():
                    with interrupt_later():
                        while waiting and len(pending) < AHEAD * self._jobs:
                            key, task = waiting.popleft()
                            pending[pool.submit(_fly_in_worker, task)] = key
                    running = {key for future, key in pending.items() if future.running()} or running
                    done, _ = cf.wait(pending, POLL_S, cf.FIRST_COMPLETED)
                    for future in done:
                        key = pending[future]
                        error = future.exception()
                        if isinstance(error, cf.process.BrokenProcessPool):
                            continue
                        del pending[future]
                        running.discard(key)
                        yield key, future.result() if error is None else tasks[key].failed(_what(error))
                    if any(future in pending for future in done):
                        # All pending runs have the same error; the dead one was among those under way.
                        broken += [key for key in pending.values() if key in running] or list(pending.values())[:1]
                        return
            except cf.process.BrokenProcessPool:
                broken += sorted(running) or list(tasks)[:1]
            finally:
                halt.value = 1
                pool.shutdown(wait=True, cancel_futures=True)

    @contextmanager
    def _pool(self, processes: int, halt: Any) -> Iterator[cf.ProcessPoolExecutor]:
        given = (processes, self._context, _begin_worker, (halt, os.getpid()))
        with safe_path(), _single_threaded(), cf.ProcessPoolExecutor(*given) as pool:
            yield pool

    def _check_start(self, stop: Stop) -> None:
        """Start a process that flies nothing. AutopilotError if it cannot start: no run could be flown."""
        self._prepare()
        try:
            with self._pool(1, None) as pool:
                with interrupt_later():
                    started = pool.submit(_settle)
                while not stop() and not cf.wait([started], POLL_S).done:
                    pass
                if started.done():
                    started.result()
        except (Exception, SystemExit) as error:
            raise AutopilotError(f"--engine local: a worker process cannot start: {_what(error)}") from error


def _what(error: BaseException) -> str:
    """An error in one line; those raised on purpose need no name."""
    named = str(error) if isinstance(error, AutopilotError) else f"{type(error).__name__}: {error}"
    return " ".join(named.split())


_halt: Any = None
"""In a worker process: its value is 1 when it is to stop."""


def _end_with(owner: int) -> None:
    """End this process with the campaign's, however that ended: a worker waits for tasks forever."""
    try:
        process = os.pidfd_open(owner)
    except ProcessLookupError:
        os._exit(1)
    except (AttributeError, OSError):  # not Linux, or an old kernel
        return
    select.select([process], [], [])
    os._exit(1)


def _begin_worker(halt: Any, owner: int) -> None:
    """Initialiser of a worker process of the process ``owner``. It ignores SIGINT: the parent handles it."""
    global _halt
    threading.Thread(target=_end_with, args=(owner,), name="owner", daemon=True).start()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    _halt = halt


@cache
def _settle() -> None:
    """Import the modules of a run and exclude them from garbage collection, once in a process."""
    importlib.import_module(WORKER)
    gc.collect()
    gc.freeze()


def _fly_in_worker(task: Flyable[Result]) -> Result | None:
    _settle()
    return flown_or_failed(task, lambda: _halt is not None and bool(_halt.value))


@contextmanager
def _single_threaded() -> Iterator[None]:
    """Child processes started meanwhile use one BLAS thread: parallel runs would compete for cores."""
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
def interrupt_later() -> Iterator[None]:
    """Block SIGINT while processes start, until they can ignore it themselves; delivered to this one afterwards.

    Blocked, not ignored: a signal that arrives while it is ignored would be lost, and the campaign would continue.
    """
    resource_tracker.ensure_running()  # Its start would end the blocking.
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


class DaskCluster:
    """A Dask cluster: a local one, or the scheduler at ``address``."""

    def __init__(self, address: str | None, jobs: int) -> None:
        """ConfigError if dask.distributed is not installed."""
        try:
            distributed, settings = (importlib.import_module(name) for name in ("distributed", "dask.config"))
        except ImportError as error:
            raise ConfigError(
                "--engine dask needs dask.distributed; install underwater-autopilot[cluster] or use --engine local"
            ) from error
        self._distributed: Any = distributed
        self._settings: Any = settings
        self._address = address
        self._option = f"--engine dask{'' if address is None else f'+{address}'}"
        self._jobs = jobs

    def run(self, tasks: Sequence[Flyable[Result]], stop: Stop) -> Iterator[Result]:
        """See :class:`CampaignEngine`. Runs of a dead worker are resubmitted by Dask up to
        ``distributed.scheduler.allowed-failures`` (3) times, then the run has failed. ConfigError if the
        scheduler does not answer, has no workers or one with another version; AutopilotError if the scheduler
        is lost.
        """
        if not tasks:
            return
        with safe_path(), self._quiet(), self._unsampled(), self._client() as client:
            self._see_workers(client)
            waiting = deque(tasks)
            pending: dict[Any, Flyable[Result]] = {}
            missed_s: float | None = None
            while (waiting or pending) and not stop():
                try:
                    threads = sum(client.nthreads().values())
                    while waiting and len(pending) < AHEAD * max(1, threads):
                        task = waiting.popleft()
                        pending[client.submit(_fly_in_worker, task, pure=False)] = task
                    finished = self._finished(pending)
                    for future in finished:
                        result = self._outcome(future, pending[future])
                        del pending[future]
                        if result is not None:
                            yield result
                except (OSError, TimeoutError, cf.CancelledError, asyncio.CancelledError) as error:
                    raise AutopilotError(self._unreachable("does not answer any more")) from error
                if client.status != "running":
                    raise AutopilotError(self._unreachable("does not answer any more"))
                now_s = time.monotonic()
                missed_s = None if threads else now_s if missed_s is None else missed_s
                if missed_s is not None and now_s - missed_s > NO_WORKER_S:
                    raise AutopilotError(self._unreachable(f"has had no worker for {NO_WORKER_S:g} s"))
            client.cancel(list(pending))

    def _finished(self, pending: "dict[Any, Flyable[Result]]") -> list[Any]:
        try:
            done: set[Any] = self._distributed.wait(list(pending), timeout=POLL_S, return_when="FIRST_COMPLETED").done
        except TimeoutError:
            return []
        return list(done)

    def _outcome(self, future: Any, task: Flyable[Result]) -> Result | None:
        if future.status in ("cancelled", "lost"):
            raise cf.CancelledError
        error = future.exception()
        if isinstance(error, self._distributed.KilledWorker):
            return task.failed(DIED)
        if error is not None:
            return task.failed(_what(error))
        result: Result | None = future.result()
        return result

    def _unreachable(self, what: str) -> str:
        return f"{self._option}: the scheduler {what}; finished runs are kept, the same command resumes"

    def _see_workers(self, client: Any) -> None:
        """ConfigError if there is no worker, or one with another version of this package."""
        try:
            client.wait_for_workers(1, timeout=FIRST_WORKER_S)
        except TimeoutError as error:
            raise ConfigError(
                f"{self._option}: no worker is there after {FIRST_WORKER_S:g} s;"
                f" start some: dask worker {self._address} --nthreads 1"
            ) from error
        try:
            versions: dict[str, str] = client.run(_version)
        except ImportError as error:
            raise ConfigError(
                f"{self._option}: a worker cannot import this package ({error}); install it there"
            ) from error
        for worker, version in versions.items():
            if version != __version__:
                raise ConfigError(
                    f"{self._option}: worker {worker} has version {version}, this is {__version__};"
                    " install the same there"
                )

    @contextmanager
    def _quiet(self) -> Iterator[None]:
        """Silence Dask's log messages about lost workers; the engine reports them."""
        names = [name for name in logging.root.manager.loggerDict if name.split(".")[0] in CHATTY]
        before = {name: logging.getLogger(name).level for name in names}
        for name in before:
            logging.getLogger(name).setLevel(logging.CRITICAL + 1)
        try:
            yield
        finally:
            for name, level in before.items():
                logging.getLogger(name).setLevel(level)

    @contextmanager
    def _unsampled(self) -> Iterator[None]:
        """Disable Dask's profiler in a local cluster: sampling all stacks 100 times a second blocks the interpreter."""
        with self._settings.set({"distributed.worker.profile.enabled": False}):
            yield

    def _client(self) -> Any:
        if self._address is None:
            return self._distributed.Client(
                n_workers=self._jobs,
                threads_per_worker=1,
                processes=True,
                dashboard_address=None,
                silence_logs=logging.CRITICAL,
            )
        try:
            return self._distributed.Client(self._address, timeout=f"{CONNECT_S:g}s")
        except (OSError, ValueError) as error:
            raise ConfigError(
                f"{self._option}: no scheduler answers ({' '.join(str(error).split())});"
                " start it with dask scheduler, or check the address"
            ) from error


def _version() -> str:
    """Version of this package in the process that calls it, which can fly runs. ImportError if it cannot."""
    _settle()
    return __version__
