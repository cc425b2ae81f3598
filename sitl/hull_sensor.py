"""Simulated sensors inside the hull: leak probe, barometer, thermometer."""

from collections.abc import Iterable

import numpy as np

from autopilot.core.samples import HullSample, LeakSample
from autopilot.drivers.base import AlwaysOpen
from autopilot.sitl.fault_tables import HullClimate, Leak
from autopilot.sitl.outages import OutageClock
from autopilot.sitl.plant import Truth
from autopilot.sitl.scenario_tables import Fault
from autopilot.sitl.sensor_tables import HullSensor, Outages

PERIOD_US = 500_000


class SimHullSensor(AlwaysOpen):
    """Constant conditions inside the hull, independent of the truth outside."""

    def __init__(self, sensor: HullSensor, faults: Iterable[Fault]) -> None:
        self._sensor = sensor
        faults = list(faults)
        self._leaks = [fault for fault in faults if isinstance(fault, Leak)]
        self._climate = [fault for fault in faults if isinstance(fault, HullClimate)]
        self._gaps = OutageClock(Outages(), faults, np.random.default_rng(0), sensor="hull")
        self._samples: list[LeakSample | HullSample] = []
        self.next_us = 0
        """When it samples next."""

    def add(self, fault: Fault) -> bool:
        """A fault that begins while the simulation runs; whether it is one of this sensor."""
        if isinstance(fault, Leak):
            self._leaks.append(fault)
        elif isinstance(fault, HullClimate):
            self._climate.append(fault)
        else:
            return self._gaps.add(fault)
        return True

    def observe(self, truth: Truth) -> None:
        t_us = truth.t_us
        self.next_us += PERIOD_US
        if self._gaps.silent(t_us):
            return
        pressure_pa, temperature_c = self._sensor.pressure_pa, self._sensor.temperature_c
        for fault in self._climate:
            if fault.holds(t_us):
                pressure_pa = pressure_pa if fault.pressure_pa is None else fault.pressure_pa
                temperature_c = temperature_c if fault.temperature_c is None else fault.temperature_c
        self._samples += [
            LeakSample(t_us=t_us, wet=any(leak.holds(t_us) for leak in self._leaks)),
            HullSample(t_us=t_us, pressure_pa=pressure_pa, temperature_c=temperature_c),
        ]

    def poll(self, t_us: int) -> list[LeakSample | HullSample]:
        samples, self._samples = self._samples, []
        return samples
