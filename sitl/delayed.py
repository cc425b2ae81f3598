"""What the simulated sensors with a rate, a latency and gaps have in common."""

from collections import deque
from collections.abc import Iterable, Sequence
from typing import Generic, TypeVar

import numpy as np

from autopilot.sitl.outages import OutageClock
from autopilot.sitl.scenario import Fault, Outages

T = TypeVar("T")


def arrived(queue: deque[tuple[int, T]], t_us: int) -> list[T]:
    """What is due up to ``t_us`` of a queue of due times and samples; it is taken out."""
    due = []
    while queue and queue[0][0] <= t_us:
        due.append(queue.popleft()[1])
    return due


class DelayedSamples(Generic[T]):
    """When samples are taken, which are lost, and the queue of those that are under way."""

    def __init__(
        self,
        *,
        rate_hz: float,
        latency_s: float,
        jitter_s: float,
        drop_probability: float,
        outages: Outages,
        faults: Iterable[Fault],
        sensor: str,
        rng: np.random.Generator,
    ) -> None:
        """``jitter_s``: standard deviation of the latency. ``sensor``: what faults call it."""
        self._rate_hz = rate_hz
        self._latency_s = latency_s
        self._jitter_s = jitter_s
        self._drop_probability = drop_probability
        self._outages = OutageClock(outages, faults, rng, sensor=sensor)
        self._count = 0
        self._last_due_us = 0
        self._queue: deque[tuple[int, T]] = deque()
        self.next_us = 0
        """When the next sample is taken."""

    def advance(self) -> None:
        """A sample has been taken: set the time of the next."""
        self._count += 1
        self.next_us = round(self._count * 1e6 / self._rate_hz)

    def add(self, fault: Fault) -> bool:
        """A fault that begins while the simulation runs; whether it is one of this sensor."""
        return self._outages.add(fault)

    def lost(self, t_us: int, chance: float) -> bool:
        """Whether the sample of that time never arrives; ``chance`` is even in [0, 1)."""
        return self._outages.silent(t_us) or chance < self._drop_probability

    def send(self, t_us: int, normal: float, sample: T) -> None:
        """The sample arrives after the latency, never before an earlier one."""
        delay_s = self._latency_s + self._jitter_s * normal
        self._last_due_us = max(self._last_due_us, t_us + max(0, round(delay_s * 1e6)))
        self._queue.append((self._last_due_us, sample))

    def poll(self, t_us: int) -> Sequence[T]:
        """What has arrived up to ``t_us``."""
        return arrived(self._queue, t_us)
