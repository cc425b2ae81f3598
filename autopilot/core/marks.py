"""The parts of a tick and their durations. Measurements are for reports only; the recorder is injected."""

import time
from collections.abc import Callable
from enum import IntEnum
from typing import Protocol

STATS_EVERY_TICKS = 100
"""Loop statistics once per second."""


class LoopPart(IntEnum):
    """The parts of a tick, in order of execution."""

    WAIT = 0
    """It began late although the one before had ended in time: the machine, or links that were served in between."""
    DEVICE = 1
    """Sensors read; in simulation the plant as well."""
    VISION = 2
    """Pictures handed to detection, sightings taken from it."""
    RECEIVE = 3
    ESTIMATE = 4
    MAVLINK = 5
    """Requests and telemetry."""
    DECIDE = 6
    """Commander, failsafes, health of the thrusters."""
    CONTROL = 7
    ALLOCATE = 8
    """Thrust to pulses, and what the tick's outputs are put together of."""
    WRITE = 9
    """Thrusters commanded."""
    SEND = 10
    RECORD = 11
    """Log, plans on their way to the disk, whoever looks on."""


class ServiceThread(IntEnum):
    """The threads of the service."""

    LOOP = 0
    VISION = 1
    """Detection of markers."""
    CAMERA = 2
    """Pictures fetched and decoded."""
    ROUTES = 3
    TRAJECTORIES = 4
    """Energy plans."""
    CERTIFICATES = 5
    PLANS = 6
    """Checks of plans."""
    LOG = 7
    DISK = 8
    """Parameters, plans and stills; logs that clients read."""
    VIEW = 9
    OTHER = 10
    """Those of libraries (a decoder's own), and all others."""


class Marks(Protocol):
    """Takes the time between the parts of a tick."""

    def mark(self, part: LoopPart) -> None:
        """All since the last mark was ``part``."""
        ...


class NoMarks:
    """Measures nothing."""

    def mark(self, part: LoopPart) -> None:
        """No-op."""


SHORT_S = 0.5e-3
"""A part that takes less is taken to have had the processor all the time."""


class TickTimer:
    """Wall and CPU time of the parts of one tick [s], and of the slowest tick since it was last asked.

    The thread's CPU clock costs a system call (some microseconds, a hundred times as much as the wall clock), so it is
    read at the beginning of a tick and after parts that have taken long; of short parts the CPU time is the wall time.
    """

    def __init__(
        self,
        wall_s: Callable[[], float] = time.perf_counter,
        cpu_s: Callable[[], float] = time.thread_time,
    ) -> None:
        self._wall_s, self._cpu_s = wall_s, cpu_s
        self._at_s, self._at_cpu_s = wall_s(), cpu_s()
        self._short_s = 0.0
        self.part_s = [0.0] * len(LoopPart)
        self.part_cpu_s = [0.0] * len(LoopPart)
        self._slowest = (self.part_s, self.part_cpu_s)
        self._slowest_s = -1.0

    def begin(self, late_s: float) -> None:
        """A tick begins, so much late through no fault of the one before."""
        self.part_s, self.part_cpu_s = [0.0] * len(LoopPart), [0.0] * len(LoopPart)
        self.part_s[LoopPart.WAIT] = late_s
        self._at_s, self._at_cpu_s, self._short_s = self._wall_s(), self._cpu_s(), 0.0

    def mark(self, part: LoopPart) -> None:
        """All since the last mark was ``part``."""
        now_s = self._wall_s()
        elapsed_s = now_s - self._at_s
        self.part_s[part] += elapsed_s
        self._at_s = now_s
        if elapsed_s < SHORT_S:
            self._short_s += elapsed_s
            self.part_cpu_s[part] += elapsed_s
            return
        now_cpu_s = self._cpu_s()
        cpu_s = now_cpu_s - self._at_cpu_s - self._short_s
        self.part_cpu_s[part] += min(max(cpu_s, 0.0), elapsed_s)
        self._at_cpu_s, self._short_s = now_cpu_s, 0.0

    def end(self) -> float:
        """The tick is over: how long it took without its late beginning [s]."""
        total_s = sum(self.part_s)
        if total_s > self._slowest_s:
            self._slowest, self._slowest_s = (self.part_s, self.part_cpu_s), total_s
        return total_s - self.part_s[LoopPart.WAIT]

    @property
    def tick_cpu_s(self) -> float:
        """CPU time of the tick so far."""
        return sum(self.part_cpu_s)

    def take_slowest(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Wall and CPU time by part of the slowest tick since the last call."""
        self._slowest_s = -1.0
        part_s, part_cpu_s = self._slowest
        return tuple(part_s), tuple(part_cpu_s)
