"""What the process holds: memory, threads, what waits for the log, and how long the garbage collector paused."""

import gc
import threading
import time
from functools import cache

import psutil

from autopilot.core.messages import ProcessStats


class Pauses:
    """The longest pause of the garbage collector since it was last asked."""

    def __init__(self) -> None:
        """Listen from now on: the collector's callbacks are of the whole process, so there is one of these."""
        self._begun_s: float | None = None
        self._longest_s = 0.0
        gc.callbacks.append(self._heard)

    def take(self) -> float:
        """Seconds, 0 without any."""
        longest_s, self._longest_s = self._longest_s, 0.0
        return longest_s

    def _heard(self, phase: str, _: dict[str, int]) -> None:
        if phase == "start":
            self._begun_s = time.perf_counter()
        elif self._begun_s is not None:
            self._longest_s = max(self._longest_s, time.perf_counter() - self._begun_s)
            self._begun_s = None


@cache
def pauses() -> Pauses:
    """Those of this process."""
    return Pauses()


@cache
def _process() -> psutil.Process:
    return psutil.Process()


def process_stats(queued: tuple[int, int]) -> ProcessStats:
    """As it is now; ``queued``: messages and bytes that wait for the writer of the log."""
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
    )
