"""One SITL run: settings -> scenario, simulated vehicle, service, links, log, loop."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Unpack

from autopilot.run.config import EffectiveSettings
from autopilot.run.outside import InProcessClient
from autopilot.run.session import Session, SessionOptions, open_session
from autopilot.run.sitl_view import Steering
from autopilot.run.sitl_world import SimulatedDevice, SimulatedWorld
from autopilot.sitl.operator import ScriptedOperator
from autopilot.sitl.scenario_tables import Scenario


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SitlSession(Session):
    """A simulated run that is ready to go."""

    world: SimulatedWorld
    device: SimulatedDevice

    @property
    def scenario(self) -> Scenario:
        return self.world.scenario

    @property
    def operator(self) -> ScriptedOperator | None:
        """Automatic operator that starts the plan, None without ``--start``."""
        return self.world.operator

    @property
    def steering(self) -> Steering | None:
        """Executes the live view's requests on the simulation; None without a view."""
        return self.world.steering


def open_sitl(
    settings: EffectiveSettings,
    overrides: dict[str, float],
    *,
    instance: int = 0,
    peers: Sequence[InProcessClient] = (),
    **more: Unpack[SessionOptions],
) -> SitlSession:
    """A simulated run, as :func:`autopilot.run.session.open_session` does it. ``peers``: clients in the process."""
    world = SimulatedWorld(settings, overrides, instance, peers)
    return open_session(SitlSession, world, instance=instance, **more)
