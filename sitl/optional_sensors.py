"""Optional simulated sensors of a scenario: their common inputs and construction."""

from collections.abc import Iterable
from dataclasses import dataclass
from importlib import import_module
from typing import Any, ClassVar, Generic, TypeVar

import numpy as np

from autopilot.core.geodesy import Origin
from autopilot.core.samples import Sample
from autopilot.core.sensors import SENSOR_ROWS
from autopilot.core.vehicle import Vehicle
from autopilot.sitl.delayed import LossySensor
from autopilot.sitl.fault_tables import SensorFrozen
from autopilot.sitl.plant import Truth
from autopilot.sitl.scenario_tables import Fault
from autopilot.sitl.sensor_tables import Sensors
from autopilot.sitl.waves import WaveTrain

S = TypeVar("S", bound=Sample)
V = TypeVar("V")


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SensedWorld:
    floor_depth_m: float | None = None
    """None = open water."""
    waves: WaveTrain | None = None
    origin: Origin | None = None
    """Of the local frame; None = no sensor needs it."""


class OptionalSensor(LossySensor[S], Generic[S, V]):
    """Samples the truth at its mounting position and delivers after the latency; ``V`` is the type of a reading."""

    name: ClassVar[str]
    """What faults call it."""
    seed: ClassVar[int]
    """Of its random numbers; the next one is that of its gaps."""
    nothing: V
    """What it repeats when it is frozen before its first reading."""

    def __init__(self, table: Any, mount: Any, world: SensedWorld, faults: Iterable[Fault], seed: int) -> None:
        """``table``: of the scenario; ``mount``: of the vehicle file."""
        faults = list(faults)
        super().__init__(table, (mount.rate_hz, mount.latency_s), faults, (seed, self.seed), sensor=self.name)
        self._sensor, self._world = table, world
        self._mount_frd_m = np.array(mount.position_frd_m)
        self._frozen = [f for f in faults if isinstance(f, SensorFrozen) and f.sensor == self.name]
        self._last = self.nothing

    def observe(self, truth: Truth) -> None:
        """Take the sample that is due at ``truth.t_us``."""
        raise NotImplementedError

    def _read(self, t_us: int, value: V) -> V:
        """The reading, or the last one while the sensor is frozen."""
        if not any(fault.holds(t_us) for fault in self._frozen):
            self._last = value
        return self._last


def optional_sensors(
    sensors: Sensors, vehicle: Vehicle, world: SensedWorld, faults: Iterable[Fault], seed: int
) -> list[OptionalSensor[Any, Any]]:
    found = []
    for row in SENSOR_ROWS:
        table = getattr(sensors, row.device) if row.simulated else None
        if table is not None:
            module, _, name = row.simulated.partition(":")
            kind: type[OptionalSensor[Any, Any]] = getattr(import_module(module), name)
            found.append(kind(table, getattr(vehicle, row.table), world, faults, seed))
    return found
