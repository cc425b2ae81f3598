"""The interface between a plant and the simulation, and how a plant is made (docs/extend.md)."""

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from autopilot.core.plugins import find_plugin
from autopilot.core.toml_table import Vec2, Vec3
from autopilot.core.vehicle import Vehicle
from autopilot.sitl.contact import Cylinder, Prism, Sphere
from autopilot.sitl.fault_tables import Mishap
from autopilot.sitl.plant import Plant, Truth, build_plant
from autopilot.sitl.scenario_tables import Scenario, ThrusterLoss


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PlantContext:
    """Everything that a plant is constructed from. ConfigError if the plant does not support the scenario."""

    scenario: Scenario
    """The plant models start, tank, obstacles, current, tether, mismatch and thruster faults."""
    vehicle: Vehicle
    """The vehicle file; a plant uses ``body`` and ``thrusters``."""
    seed: int
    """Seed of the run; all randomness derives from it."""


class PlantLike(Protocol):
    """Pulses in, truth out: the vehicle in its world, without sensors, sensor faults and command latency.

    World frame NED with the surface at depth 0, body frame FRD, SI units, radians. Deterministic: the same calls give
    the same truth bit for bit. An exception counts as failed sensors; the plant is called again on the next tick.
    """

    @property
    @abstractmethod
    def truth(self) -> Truth:
        """The present truth; asked for at the times at which sensors sample, and by the log."""
        ...

    @abstractmethod
    def advance(self, t_us: int, pwm_us: Sequence[int]) -> None:
        """Advance the simulation with constant pulses.

        Parameters
        ----------
        t_us
            Time to advance to [us], not before the last one.
        pwm_us
            One pulse per channel, channel 1 first [us]; missing or 0 = off.
        """
        ...


@runtime_checkable
class SteerablePlant(Protocol):
    """Optional: changes of a running simulation by the live view."""

    @property
    def solids(self) -> tuple[Cylinder | Sphere | Prism, ...]:
        """The obstacles where they are now, in the scenario's order."""
        ...

    def begin_fault(self, fault: ThrusterLoss | Mishap) -> None:
        """Begin a fault of hull, thrusters or battery that the scenario does not have. ConfigError if unsupported."""
        ...

    def add_flow(self, flow_m_s: Vec2) -> None:
        """Add a uniform flow (north, east) [m/s] to the scenario's current; replaces the one added before."""
        ...

    def current_at(self, pos_ned_m: Sequence[float], t_s: float) -> Vec3:
        """The current (3,) NED [m/s] at a position (3,) NED [m] and time [s]."""
        ...

    def put_obstacle(self, number: int, north_m: float, east_m: float) -> None:
        """Move the obstacle of that number (from 1) to a position [m]. ConfigError if the hull is there."""
        ...


def create_plant(name: str, context: PlantContext, asked_by: str | None = None) -> PlantLike:
    """Construct the plant of that name: a shipped one, one of an installed package, or ``package:Class``.

    ConfigError names ``asked_by`` (default ``--plant``), value and remedy if there is none, or it is none by
    :class:`PlantLike`.
    """
    made: PlantLike = find_plugin("plant", name, asked_by).make(context, PlantLike)
    return made


def rigid_body(context: PlantContext) -> Plant:
    """The shipped plant ("rigid-body"): six degrees of freedom."""
    return build_plant(context.scenario, context.vehicle)
