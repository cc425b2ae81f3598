"""One SITL run: settings -> scenario, simulated vehicle, service, links, log, loop."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Unpack

from autopilot.run.config import EffectiveSettings
from autopilot.run.outside import InProcessClient
from autopilot.run.session import Session, SessionOptions, open_session
from autopilot.run.sitl_world import SimulatedDevice, SimulatedWorld


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SitlSession(Session):
    """A simulated run that is ready to go."""

    world: SimulatedWorld
    device: SimulatedDevice


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
