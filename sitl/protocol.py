"""What a plant is to the simulation, and how one is made (docs/extend.md)."""

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from autopilot.core.plugins import Plugin, find_plugin
from autopilot.core.toml_table import Vec2, Vec3
from autopilot.core.vehicle import Vehicle
from autopilot.sitl.contact import Cylinder, Prism, Sphere
from autopilot.sitl.fault_tables import Mishap
from autopilot.sitl.plant import Plant, Truth, build_plant
from autopilot.sitl.scenario_tables import Scenario, ThrusterLoss

PLANTS = {"rigid-body": "autopilot.sitl.protocol:rigid_body"}
"""Shipped plants: name -> what makes one."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PlantContext:
    """What a plant is made of. What a scenario asks for and a plant cannot do it refuses with ConfigError."""

    scenario: Scenario
    """Start, tank, obstacles, current, tether, mismatch and thruster faults are the plant's business."""
    vehicle: Vehicle
    """The vehicle file; ``body`` and ``thrusters`` are meant for plants."""
    seed: int
    """Of the run; all randomness comes from it."""


class PlantLike(Protocol):
    """Pulses in, truth out: the vehicle in its world. Sensors, faults of sensors, and late commands are not its part.

    World NED with the surface at depth 0, body FRD, SI, radians. Deterministic: the same calls give the same truth bit
    for bit. What raises is told as sensors that failed, and the plant is asked again on the next tick.
    """

    @property
    @abstractmethod
    def truth(self) -> Truth:
        """The present truth; asked for at the times at which sensors look, and by the log."""
        ...

    @abstractmethod
    def advance(self, t_us: int, pwm_us: Sequence[int]) -> None:
        """Move on to ``t_us``, no earlier than the last one, with these pulses held: one per channel (from 1 on),
        missing or 0 = off."""
        ...


@runtime_checkable
class SteerablePlant(Protocol):
    """What a plant may offer beside, for whoever steers a simulation by hand (the live view)."""

    @property
    def solids(self) -> tuple[Cylinder | Sphere | Prism, ...]:
        """The obstacles where they are now, in the scenario's order."""
        ...

    def suffer(self, fault: ThrusterLoss | Mishap) -> None:
        """A fault of hull, thrusters or battery that nobody knew of at the start."""
        ...

    def add_flow(self, flow_m_s: Vec2) -> None:
        """From now on this flow (north, east) is added to the scenario's current everywhere."""
        ...

    def current_at(self, pos_ned_m: Sequence[float], t_s: float) -> Vec3:
        """The current (3,) NED at a place and time."""
        ...

    def put_obstacle(self, number: int, north_m: float, east_m: float) -> None:
        """The obstacle of that number (from 1) stands there from now on."""
        ...


def create_plant(name: str, context: PlantContext, asked_by: str | None = None) -> PlantLike:
    """The plant of that name (shipped, of an installed package, or package:Class).

    ConfigError names ``asked_by`` (default ``--plant``), the value and what to do.
    """
    made: PlantLike = find_plant(name, asked_by).make(context, PlantLike)
    return made


def find_plant(name: str, asked_by: str | None = None) -> Plugin:
    """Where the plant of that name comes from. ConfigError if there is none."""
    return find_plugin("plant", name, PLANTS, asked_by)


def rigid_body(context: PlantContext) -> Plant:
    """The shipped plant ("rigid-body"): six degrees of freedom."""
    return build_plant(context.scenario, context.vehicle)
