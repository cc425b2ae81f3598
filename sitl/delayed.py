"""Common part of simulated sensors: rate, latency, lost samples and gaps."""

from collections import deque
from collections.abc import Iterable
from typing import Generic, TypeVar

import numpy as np

from autopilot.drivers.base import AlwaysOpen
from autopilot.sitl.scenario_tables import CameraBlackout, Fault, SensorSilence
from autopilot.sitl.sensor_tables import Outages, SampledSensor

T = TypeVar("T")


class OutageClock:
    """Tells whether a sensor is silent. Asked with times that never go back."""

    def __init__(
        self, outages: Outages, faults: Iterable[Fault], rng: np.random.Generator, *, sensor: str = "camera"
    ) -> None:
        """``sensor``: whose gaps they are; faults of others do not count."""
        self._outages = outages
        self._sensor = sensor
        self._faults: list[tuple[float, float]] = []
        for fault in faults:
            self.add(fault)
        self._rng = rng
        self._start_s = self._end_s = 0.0
        self._draw()

    def add(self, fault: Fault) -> bool:
        """A fault that begins while the simulation runs; whether it is one of this sensor."""
        if (isinstance(fault, CameraBlackout) and self._sensor == "camera") or (
            isinstance(fault, SensorSilence) and fault.sensor == self._sensor
        ):
            self._faults.append((fault.at_s, fault.at_s + fault.duration_s))
            return True
        return False

    def silent(self, t_us: int) -> bool:
        t_s = t_us / 1e6
        while t_s >= self._end_s > 0.0:
            self._draw()
        return self._start_s <= t_s < self._end_s or any(start <= t_s < end for start, end in self._faults)

    def _draw(self) -> None:
        """The next random gap, after the one before."""
        if self._outages.per_minute > 0.0:
            self._start_s = self._end_s + float(self._rng.exponential(60.0 / self._outages.per_minute))
            self._end_s = self._start_s + float(self._rng.uniform(self._outages.min_s, self._outages.max_s))


class DelayedSensor(AlwaysOpen, Generic[T]):
    """Sampling schedule, and the queue of samples in transmission."""

    def __init__(self, rate_hz: float, latency_s: float, jitter_s: float = 0.0) -> None:
        """``jitter_s``: standard deviation of the latency."""
        self._rate_hz = rate_hz
        self._latency_s = latency_s
        self._jitter_s = jitter_s
        self._count = 0
        self._last_due_us = 0
        self._queue: deque[tuple[int, T]] = deque()
        self.next_us = 0
        """When the next sample is taken."""

    def poll(self, t_us: int) -> list[T]:
        return [sample for _, sample in self._arrived(t_us)]

    def _arrived(self, t_us: int) -> list[tuple[int, T]]:
        """Remove the arrived samples from the queue; with times of arrival."""
        due = []
        while self._queue and self._queue[0][0] <= t_us:
            due.append(self._queue.popleft())
        return due

    def _taken(self) -> None:
        """A sample has been taken: set the time of the next."""
        self._count += 1
        self.next_us = round(self._count * 1e6 / self._rate_hz)

    def _send(self, t_us: int, normal: float, *samples: T) -> None:
        """Put samples of that time into the queue."""
        due_us = self._due_us(t_us, normal)
        self._queue.extend((due_us, sample) for sample in samples)

    def _due_us(self, t_us: int, normal: float) -> int:
        """When a sample of that time arrives: after the latency, never before an earlier one; ``normal`` is a standard
        normal number."""
        delay_s = self._latency_s + self._jitter_s * normal
        self._last_due_us = max(self._last_due_us, t_us + max(0, round(delay_s * 1e6)))
        return self._last_due_us


class LossySensor(DelayedSensor[T]):
    """One whose samples are also lost, one by one or in gaps."""

    def __init__(
        self,
        table: SampledSensor,
        usual: tuple[float, float],
        faults: Iterable[Fault],
        seed: tuple[int, int],
        *,
        sensor: str,
    ) -> None:
        """``usual``: default rate [Hz] and latency [s]. ``seed``: of run and sensor; the next one is that of its gaps.
        ``sensor``: its name in faults.
        """
        rate_hz, latency_s = usual
        latency_s = latency_s if table.latency_s is None else table.latency_s
        super().__init__(table.rate_hz or rate_hz, latency_s, table.latency_jitter_s)
        self._rng = np.random.default_rng(seed)
        self._drop_probability = table.drop_probability
        self._outages = OutageClock(table.outages, faults, np.random.default_rng((seed[0], seed[1] + 1)), sensor=sensor)

    def add(self, fault: Fault) -> bool:
        """A fault that begins while the simulation runs; whether it is one of this sensor."""
        return self._outages.add(fault)

    def _lost(self, t_us: int, chance: float) -> bool:
        """Whether the sample of that time never arrives; ``chance`` is even in [0, 1)."""
        return self._outages.silent(t_us) or chance < self._drop_probability
