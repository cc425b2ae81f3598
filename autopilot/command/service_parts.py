"""Components from which the service is built."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from autopilot.command.commander import Commander
from autopilot.command.equipment import Equipment
from autopilot.command.photographer import Photographer
from autopilot.control.protocol import Controller
from autopilot.control.thrust.actuation import Actuation
from autopilot.core.background import BackgroundWorker
from autopilot.core.guard import Guard
from autopilot.core.nondeterminism import NondeterminismSource
from autopilot.core.params import ParamSet
from autopilot.core.vehicle import Vehicle
from autopilot.estimator.protocol import Estimator
from autopilot.mission.store import Plans

if TYPE_CHECKING:
    from autopilot.mavlink.server import MavlinkServer  # has the dialect, 2 MB


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ServiceParts:
    """Everything that the composition root puts together."""

    vehicle: Vehicle
    params: ParamSet
    plans: Plans
    estimator: Estimator
    controller: Controller
    actuation: Actuation
    commander: Commander
    server: "MavlinkServer"
    guard: Guard
    equipment: Equipment
    photographer: Photographer | None = None
    """None without a camera."""
    nondeterminism: NondeterminismSource
    """Recorder of nondeterministic results, for the log."""
    workers: tuple[BackgroundWorker, ...] = ()
    """Where slow work is asked for: while the loop waits there it attends to its links."""
