"""Gaps in a sensor's output: at random, or by a fault of the scenario."""

from collections.abc import Iterable

import numpy as np

from autopilot.sitl.scenario_tables import CameraBlackout, Fault, SensorSilence
from autopilot.sitl.sensor_tables import Outages


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
