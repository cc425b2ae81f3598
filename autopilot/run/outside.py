"""Interfaces of the loop: vehicle (hardware or simulation), log, and observers in the same process."""

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

from autopilot.core.messages import Inputs, LoopStats, Outputs, ThrusterCommand
from autopilot.core.payload import PayloadState
from autopilot.core.samples import CameraFrame, Sample


class VehicleIo(Protocol):
    """All of a vehicle's devices as one, real or simulated."""

    def advance(self, t_us: int) -> None:
        """Advance a simulation to ``t_us``."""
        ...

    def poll(self, t_us: int) -> Sequence[Sample]:
        """Samples that have arrived by ``t_us``."""
        ...

    def frames(self, t_us: int) -> Sequence[CameraFrame]:
        """Images that have arrived by ``t_us``."""
        ...

    def write(self, t_us: int, command: ThrusterCommand) -> None: ...

    # Failures raise DriverError or OSError, are reported to the service, and tried again on the next tick.

    def close(self) -> None:
        """Thrusters to neutral, devices closed."""
        ...


@runtime_checkable
class WeightRelease(Protocol):
    """A vehicle that can let a drop weight go."""

    def release_weight(self, t_us: int) -> None:
        """Release the weight; called on every tick on which that is requested. Raises as :class:`VehicleIo` does."""
        ...


@runtime_checkable
class HandsBack(Protocol):
    """A vehicle with a flight controller below us that can have the thrusters back."""

    def hand_back(self, t_us: int) -> None:
        """Release the thrusters; called on every tick on which a failsafe requests it, after a neutral ``write``."""
        ...


@runtime_checkable
class DisarmsFlightController(Protocol):
    """A vehicle with a flight controller that can be disarmed, whoever armed it."""

    def disarm_flight_controller(self, t_us: int) -> None:
        """Called on every tick until its heartbeat reports disarmed."""
        ...

    def stand_down(self, t_us: int) -> bool:
        """End of the run: disarm it where that is ours to do; True when done."""
        ...


@runtime_checkable
class Actuates(Protocol):
    """A vehicle that carries something that moves."""

    def actuate(self, t_us: int, state: PayloadState) -> None:
        """Drive all payload outputs; called on every tick. Raises as :class:`VehicleIo` does."""
        ...


@runtime_checkable
class HasWatchdog(Protocol):
    """A vehicle whose thrusters a process beside the service stops when the service cannot."""

    def watchdog(self, t_us: int) -> str:
        """Fault of the watchdog process, "" while it answers or none is needed; called once per tick."""
        ...


class Recorder(Protocol):
    def record(self, inputs: Inputs, outputs: Outputs, frames: Sequence[CameraFrame]) -> None: ...

    def loop_stats(self, stats: LoopStats) -> None:
        """Log the health of the loop."""
        ...

    @property
    def dropped(self) -> int: ...

    @property
    def queued(self) -> tuple[int, int]:
        """Messages and bytes that wait to be written."""
        ...

    @property
    def lost(self) -> bool:
        """Whether recording has failed although it should be active."""
        ...


class Onlooker(Protocol):
    """Passive observer of the loop (the live view)."""

    def tick(self, inputs: Inputs, outputs: Outputs, frames: Sequence[CameraFrame]) -> None: ...

    def loop_stats(self, stats: LoopStats) -> None: ...


class Onlookers:
    def __init__(self, *those: Onlooker) -> None:
        self._those = those

    def tick(self, inputs: Inputs, outputs: Outputs, frames: Sequence[CameraFrame]) -> None:
        for each in self._those:
            each.tick(inputs, outputs, frames)

    def loop_stats(self, stats: LoopStats) -> None:
        for each in self._those:
            each.loop_stats(stats)


class InProcessClient(Protocol):
    """An in-process MAVLink client that lives in the same time as the vehicle (scripted operators, tests)."""

    def step(self, t_us: int, received: Sequence[bytes]) -> list[bytes]:
        """Datagrams that the vehicle sent since the last call -> datagrams for the vehicle."""
        ...
