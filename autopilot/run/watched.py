"""What the live view looks at in a service: the same on a real vehicle and in simulation."""

from collections.abc import Callable, Hashable

from autopilot.command.service_parts import Parts
from autopilot.core.geometry import Fence
from autopilot.log.description import RunDescription
from autopilot.view.feed import TruthSeen
from autopilot.view.shown import Solid


class WatchedService:
    """A service; ``describe`` makes the description of now."""

    def __init__(self, parts: Parts, describe: Callable[[], RunDescription]) -> None:
        self._parts = parts
        self._describe = describe

    def revision(self) -> Hashable:
        """Changes with plans and parameters. The fence comes into force a little after its plan."""
        parts = self._parts
        return parts.plans.revision, id(parts.commander.fence), tuple(parts.params.values())

    def describe(self) -> RunDescription:
        """The run as things stand now."""
        return self._describe()

    def fence(self) -> Fence:
        """The fence in force."""
        return self._parts.commander.fence

    def truth(self) -> TruthSeen | None:
        """Nobody knows."""
        return None

    def solids(self) -> tuple[Solid, ...]:
        """Nobody knows."""
        return ()
