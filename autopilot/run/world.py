"""World of a service: a real vehicle, emulated devices or a simulation, with its environment.

A session (:mod:`autopilot.run.session`) is opened, run, recorded and closed alike in all of them; the differences
are here.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from autopilot.command.service_parts import ServiceParts
from autopilot.core.background import BackgroundWorker
from autopilot.core.geometry import Fence
from autopilot.core.messages import FlightControllerState, Inputs, Severity
from autopilot.core.param_file import PersistentParams
from autopilot.core.params import ParamSet
from autopilot.log.description import RunDescription
from autopilot.log.log_session import LoggedTruth
from autopilot.log.record_table import TruthLike
from autopilot.mission.plan_files import PlanFile
from autopilot.run.clocks import LockstepClock, PacedClock
from autopilot.run.compose import KnownEnvironment
from autopilot.run.config import EffectiveSettings
from autopilot.run.outside import InProcessClient, VehicleIo
from autopilot.run.recorder import TruthSource
from autopilot.view.controls import Controls
from autopilot.view.page_state import Solid


@dataclass(frozen=True, slots=True, kw_only=True)
class CurrentSource:
    """Source of :attr:`.KnownEnvironment.currents`, for the log."""

    kind: str
    basin: str
    map_file: Path | None = None
    map_start: str | None = None


class WatchedService:
    """A service; ``describe`` makes the description of now."""

    def __init__(self, parts: ServiceParts, describe: Callable[[], RunDescription]) -> None:
        self._parts = parts
        self._describe = describe

    def revision(self) -> Hashable:
        """Changes with plans and parameters. The fence comes into force slightly after its plan."""
        parts = self._parts
        return parts.plans.revision, id(parts.commander.fence), tuple(parts.params.values())

    def describe(self) -> RunDescription:
        return self._describe()

    def fence(self) -> Fence:
        return self._parts.commander.fence

    def truth(self) -> LoggedTruth | None:
        return None

    def solids(self) -> tuple[Solid, ...]:
        return ()


class World(ABC):
    """One world; used by one session."""

    settings: EffectiveSettings
    known: KnownEnvironment
    current_source: CurrentSource
    speed: float
    """1 on hardware, 0 = as fast as possible."""
    folder: Path
    """Folder of the files that an instance keeps between runs."""
    disk: BackgroundWorker
    """The lane on which that is written."""
    params: ParamSet
    persistent: PersistentParams
    warnings: tuple[str, ...]
    """Problems of saved parameters."""
    device: VehicleIo
    """From :meth:`open_device` on."""
    plan: Path | None = None
    """To have on board from the start."""
    flown_at_once: bool = False
    keeps_plans: bool = True
    peers: Sequence[InProcessClient] = ()
    simulated: bool = False
    truth_source: TruthSource | None = None
    """The plant's, for the log."""
    skips: bool = False
    """It does not wait for a loop that is late."""
    duration_s: float | None
    markers_from_file: bool = True
    """:attr:`KnownEnvironment.markers` stand in a file of their own."""

    @abstractmethod
    def epoch_ns(self, t_us: int) -> int:
        """Log time of the vehicle's time zero, for a log that begins at ``t_us``."""

    @abstractmethod
    def open_device(self, parts: ServiceParts) -> None:
        """The vehicle's devices, for that service."""

    @abstractmethod
    def describe(self, parts: ServiceParts) -> RunDescription:
        """The run as things stand now."""

    @abstractmethod
    def metadata(self) -> Mapping[str, str]: ...

    @abstractmethod
    def attachments(self) -> Mapping[str, bytes]:
        """The files that its logs hold of it."""

    @abstractmethod
    def below(self, t_us: int) -> FlightControllerState | None:
        """State of the flight controller at a time, None without one."""

    def finish_plan(self, plan: PlanFile) -> tuple[PlanFile, tuple[str, ...]]:
        """Complete a plan from a file before it is loaded; with a message about that."""
        return plan, ()

    def watched(self, parts: ServiceParts) -> WatchedService:
        return WatchedService(parts, lambda: self.describe(parts))

    @abstractmethod
    def controls(self, clock: PacedClock | LockstepClock) -> Controls:
        """Interventions that the live view may make."""

    def truth(self) -> TruthLike | None:
        """Where the vehicle really is, where that is known."""
        return None

    def notices(self) -> Sequence[tuple[Severity, str]]:
        return ()

    def refusals(self, t_us: int) -> tuple[str, ...]:
        """Reasons of the world not to arm, empty = none."""
        return ()

    def hold(self, t_us: int) -> bool:
        """Whether the simulation is paused."""
        return False

    def mishaps(self, inputs: Inputs) -> Inputs:
        """The inputs with the injected sensor faults."""
        return inputs
