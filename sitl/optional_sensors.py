"""Simulated sensors that a scenario may have or not: what they are made of."""

from collections.abc import Iterable
from dataclasses import dataclass
from importlib import import_module
from typing import Any, Protocol

from autopilot.core.samples import Sample
from autopilot.core.sensors import SENSOR_ROWS
from autopilot.core.vehicle import Vehicle
from autopilot.sitl.plant import Truth
from autopilot.sitl.scenario_tables import Fault
from autopilot.sitl.sensor_tables import Sensors
from autopilot.sitl.waves import WaveTrain


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SensedWorld:
    """What they can measure."""

    floor_depth_m: float | None
    """None = open water."""
    waves: WaveTrain | None


class OptionalSensor(Protocol):
    """One of them."""

    @classmethod
    def of(cls, table: Any, mount: Any, world: SensedWorld, faults: Iterable[Fault], seed: int) -> "OptionalSensor":
        """``table``: of the scenario; ``mount``: of the vehicle file."""
        ...

    @property
    def next_us(self) -> int:
        """When it looks next."""
        ...

    def observe(self, truth: Truth) -> None: ...

    def poll(self, t_us: int) -> list[Sample]:
        """What has arrived up to ``t_us``."""
        ...

    def add(self, fault: Fault) -> bool:
        """A fault begins at its time; whether it is one of this sensor."""
        ...


def optional_sensors(
    sensors: Sensors, vehicle: Vehicle, world: SensedWorld, faults: Iterable[Fault], seed: int
) -> list[OptionalSensor]:
    """Those that the scenario has."""
    found = []
    for row in SENSOR_ROWS:
        table = getattr(sensors, row.device) if row.simulated else None
        if table is not None:
            module, _, name = row.simulated.partition(":")
            kind: type[OptionalSensor] = getattr(import_module(module), name)
            found.append(kind.of(table, getattr(vehicle, row.table), world, faults, seed))
    return found
