"""Timing statistics of the loop, once per second and for the whole run."""

import gc
import threading
import time
from dataclasses import dataclass
from functools import cache

import psutil

from autopilot.core.clock import TICK_US
from autopilot.core.marks import STATS_EVERY_TICKS, ServiceThread, TickTimer
from autopilot.core.messages import LoopStats, ProcessStats


@dataclass(slots=True)
class LoopCounters:
    ticks: int = 0
    skipped: int = 0
    """Ticks that were due and not taken, because the loop was late."""
    overruns: int = 0
    """Those, and ticks that began more than one late."""
    worst_tick_s: float = 0.0
    """Wall time of the longest tick."""
    cpu_load: float = 0.0

    @property
    def due(self) -> int:
        """All ticks until now, taken or skipped."""
        return self.ticks + self.skipped


class LoopAccount:
    def __init__(self, *, paced: bool) -> None:
        """Load is not defined without a pace."""
        self._paced = paced
        pauses().take()
        self._cpu_mark_s = time.process_time()
        self._busy_s = 0.0
        self._ticks_s: list[float] = []
        self._ticks_cpu_s: list[float] = []
        self._threads = ThreadTimes()
        self.counters = LoopCounters()

    def busy(self, time_s: float) -> None:
        """Work between two ticks."""
        self._busy_s += time_s

    def tick(
        self, t_us: int, watch: TickTimer, *, dropped_log: int, dropped_frames: int, queued: tuple[int, int] = (0, 0)
    ) -> LoopStats | None:
        """Account for a tick timed by ``watch``; returns statistics once per second. ``queued``: messages and
        bytes waiting for the log writer.
        """
        tick_s = watch.end()
        counters = self.counters
        counters.ticks += 1
        self._busy_s += tick_s
        self._ticks_s.append(tick_s)
        self._ticks_cpu_s.append(watch.tick_cpu_s)
        if counters.ticks % STATS_EVERY_TICKS:
            return None
        cpu_s, worst_tick_s = time.process_time(), max(self._ticks_s)
        spent_s = cpu_s - self._cpu_mark_s
        part_s, part_cpu_s = watch.take_slowest()
        stats = LoopStats(
            t_us=t_us,
            tick_s=worst_tick_s,
            cpu_s=spent_s,
            overruns=counters.overruns,
            dropped_log=dropped_log,
            dropped_frames=dropped_frames,
            part_s=part_s,
            part_cpu_s=part_cpu_s,
            ticks_s=tuple(self._ticks_s),
            ticks_cpu_s=tuple(self._ticks_cpu_s),
            process=process_stats(queued, self._threads.take(spent_s)),
        )
        if self._paced:
            counters.cpu_load = min(1.0, self._busy_s / (STATS_EVERY_TICKS * TICK_US * 1e-6))
        counters.worst_tick_s = max(counters.worst_tick_s, worst_tick_s)
        self._cpu_mark_s, self._busy_s = cpu_s, 0.0
        self._ticks_s, self._ticks_cpu_s = [], []
        return stats


_NAMES = {
    "log-writer": ServiceThread.LOG,
    "files": ServiceThread.DISK,
    "view http": ServiceThread.VIEW,
    "foxglove": ServiceThread.VIEW,
    **{thread.name.lower(): thread for thread in ServiceThread},
}
"""Threads by name, without the number in an executor."""
_VIEWER = "process_request_thread"
"""In the names of the threads of the view's clients."""


def kind_of(thread: threading.Thread) -> ServiceThread:
    """Which of the service's threads that is; the loop is the one that asks."""
    if thread is threading.current_thread():
        return ServiceThread.LOOP
    if _VIEWER in thread.name:
        return ServiceThread.VIEW
    return _NAMES.get(thread.name.split("_")[0], ServiceThread.OTHER)


def thread_cpu_s(native_id: int) -> float:
    """CPU time of a thread of this process so far; OSError if it has ended, or the system is not Linux."""
    return time.clock_gettime((~native_id << 3) | 6)  # the kernel's number of that clock: clock_getcpuclockid(3)


class ThreadTimes:
    """CPU time of the service's threads since they were last asked for."""

    def __init__(self) -> None:
        self._so_far_s: dict[int, float] = {}
        self._able = hasattr(time, "clock_gettime")
        self.take(0.0)

    def take(self, whole_s: float) -> tuple[float, ...]:
        """By :class:`ServiceThread`; what is left of ``whole_s``, the process's, is OTHER. All 0 if not known."""
        taken_s, so_far_s = [0.0] * len(ServiceThread), {}
        for thread in threading.enumerate() if self._able else ():
            number = thread.native_id
            if number is None:
                continue
            try:
                so_far_s[number] = thread_cpu_s(number)
            except OSError:
                continue
            taken_s[kind_of(thread)] += max(so_far_s[number] - self._so_far_s.get(number, 0.0), 0.0)
        self._so_far_s = so_far_s
        if not so_far_s:
            return tuple(taken_s)
        taken_s[ServiceThread.OTHER] = 0.0
        taken_s[ServiceThread.OTHER] = max(whole_s - sum(taken_s), 0.0)
        return tuple(taken_s)


class Pauses:
    """Longest garbage collection pause since the last call."""

    def __init__(self) -> None:
        """Register with the garbage collector; its callbacks are global, so there is one instance per process."""
        self._begun_s: float | None = None
        self._longest_s = 0.0
        gc.callbacks.append(self._on_collection)

    def take(self) -> float:
        """Seconds, 0 without any."""
        longest_s, self._longest_s = self._longest_s, 0.0
        return longest_s

    def _on_collection(self, phase: str, _: dict[str, int]) -> None:
        if phase == "start":
            self._begun_s = time.perf_counter()
        elif self._begun_s is not None:
            self._longest_s = max(self._longest_s, time.perf_counter() - self._begun_s)
            self._begun_s = None


@cache
def pauses() -> Pauses:
    return Pauses()


@cache
def _process() -> psutil.Process:
    return psutil.Process()


def process_stats(queued: tuple[int, int], thread_cpu_s: tuple[float, ...]) -> ProcessStats:
    """Present statistics; ``queued``: messages and bytes waiting for the log writer."""
    try:
        rss = int(_process().memory_info().rss)
    except (psutil.Error, OSError):
        rss = 0
    messages, size = queued
    return ProcessStats(
        rss_bytes=rss,
        log_queue=messages,
        log_queue_bytes=size,
        threads=threading.active_count(),
        collect_s=pauses().take(),
        thread_cpu_s=thread_cpu_s,
    )
