"""An hour of flight: what a service holds on to that it should not.

The whole service flies laps in the paper's tank in lockstep, with its log, in this process. Memory and descriptors are
looked at after every lap or so; what caches, maps of the current and the allocator take in the first minutes is
warm-up.
"""

import gc
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import psutil

from autopilot.core.clock import TICK_US
from autopilot.core.messages import Outputs
from autopilot.mission.paper import paper_plan
from autopilot.mission.qgc_plan import write_qgc_plan
from autopilot.run.config import flight_settings
from autopilot.run.sitl_session import open_sitl

LAPS = 1000
"""More than any soak flies."""
LOOK_S = 20.0
WARM_UP_SHARE = 0.25
"""Of the flight, at its beginning."""
GROWTH = 0.01
"""Of the memory after the warm-up, that may come on top in an hour."""
HOUR_S = 3600.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Look:
    """What the process holds at a time."""

    t_s: float
    rss_mb: float
    descriptors: int
    threads: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Soak:
    """A flight's looks and what they say."""

    looks: tuple[Look, ...]

    @property
    def settled(self) -> tuple[Look, ...]:
        """Looks after the warm-up."""
        end_s = self.looks[-1].t_s
        return tuple(look for look in self.looks if look.t_s >= WARM_UP_SHARE * end_s)

    @property
    def growth_mb(self) -> float:
        """Between the first and the last quarter of the settled looks, the least of each: what is never given back."""
        settled = self.settled
        part = max(1, len(settled) // 4)
        return min(x.rss_mb for x in settled[-part:]) - min(x.rss_mb for x in settled[:part])

    @property
    def hourly_growth(self) -> float:
        """Share of the settled memory that an hour would add."""
        settled = self.settled
        part = max(1, len(settled) // 4)
        span_s = settled[-part].t_s - settled[0].t_s
        return 0.0 if span_s <= 0.0 else self.growth_mb / settled[0].rss_mb * HOUR_S / span_s

    @property
    def more_descriptors(self) -> int:
        """Between the settled looks' first and last."""
        return self.settled[-1].descriptors - self.settled[0].descriptors

    @property
    def kept(self) -> bool:
        """Whether nothing grows."""
        return self.hourly_growth <= GROWTH and self.more_descriptors <= 0


def soak(duration_s: float, seed: int, show: Callable[[Look], None] = lambda _: None) -> Soak:
    """Fly for so long (simulated)."""
    looks: list[Look] = []
    process = psutil.Process()
    every = round(LOOK_S * 1e6)

    def look(outputs: Outputs) -> None:
        if outputs.t_us % every < TICK_US:
            gc.collect()
            found = Look(
                t_s=outputs.t_us * 1e-6,
                rss_mb=process.memory_info().rss / 2**20,
                descriptors=process.num_fds(),
                threads=process.num_threads(),
            )
            looks.append(found)
            show(found)

    with tempfile.TemporaryDirectory(prefix="autopilot-") as name:
        folder = Path(name)
        plan = folder / "laps.plan"
        plan.write_text(write_qgc_plan(paper_plan(laps=LAPS)))
        given = {
            "speed": 0.0,
            "sensors": "pose",
            "start": True,
            "plan": str(plan),
            "duration": duration_s,
            "seed": seed,
            "log": str(folder / "run.mcap"),
        }
        settings = flight_settings(folder / "state", given)
        open_sitl(settings, {}, on_tick=look).run()
    return Soak(looks=tuple(looks))
