"""What the whole-system tests share."""

import contextlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from autopilot.core.messages import Outputs, ProgressState
from autopilot.run.children import Child
from autopilot.run.config import flight_settings
from autopilot.run.sitl_session import SitlSession, open_sitl

ROOT = Path(__file__).resolve().parents[2]
PAPER_PLAN = ROOT / "sitl" / "scenarios" / "paper.plan"

OpenSession = Callable[..., SitlSession]


def fly_to_the_end(session: OpenSession, *arguments: Any, **given: Any) -> SitlSession:
    """A run that is started in this process and ends a second after its mission (what would follow is station keeping),
    at the latest at its ``duration``."""
    complete: list[int] = []

    def on_tick(outputs: Outputs) -> None:
        if outputs.progress is not None and outputs.progress.state is ProgressState.COMPLETE:
            complete.append(outputs.t_us)

    run = session(*arguments, start=True, on_tick=on_tick, **given)
    run.run(stop=lambda: len(complete) >= 100)
    return run


@dataclass(frozen=True, kw_only=True)
class RunningService:
    """A service in its own process."""

    child: Child
    port: int
    log: Path

    def keep_waiting(self, cpu_s: float = 60.0) -> None:
        """Fails when the service has ended, is stuck, or has computed so much more than it should that it never ends.

        A limit for what tests wait for: on a busy machine everything takes longer, but no more work.
        """
        assert self.child.at_work(), "the service hangs"
        spent_s = self.child.cpu_s()
        assert spent_s is None or spent_s < cpu_s, f"the service has used {spent_s:.0f} s of CPU time"


@contextlib.contextmanager
def sessions(folder: Path) -> Iterator[OpenSession]:
    """Makes sessions with nothing shared: a state folder of their own, lockstep, no sockets but ``connections``."""
    opened: list[SitlSession] = []

    def make(
        scenario: str = "paper-tank",
        *,
        peers: Sequence[Any] = (),
        params: dict[str, float] | None = None,
        log: Path | None = None,
        connections: Sequence[str] = (),
        on_tick: Callable[[Outputs], None] = lambda _: None,
        **given: Any,
    ) -> SitlSession:
        settings = flight_settings(folder / "state", {"scenario": scenario, **given})
        settings.put("connect", tuple(connections), "test")
        settings.put("log", None if log is None else str(log), "test")
        made = open_sitl(settings, params or {}, log=log is not None, peers=peers, on_tick=on_tick)
        opened.append(made)
        return made

    yield make
    for made in opened:
        made.runtime.close()
        made.recorder.close()
