"""Flies a random world: the whole service on the simulated vehicle, with the plan through the service's checks."""

import math
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import msgspec

from autopilot.campaign.flight import run_watched
from autopilot.campaign.tick_watch import TickWatch
from autopilot.campaign.worlds.random_world import SCENARIO_FILE, RandomWorld, make_world, write_files
from autopilot.campaign.worlds.reachability import Prospect, prospect
from autopilot.campaign.worlds.world_judge import is_hopeless, judge_flight, judge_refusal
from autopilot.campaign.worlds.world_results import WorldResult
from autopilot.core.errors import PlanError
from autopilot.core.messages import Fallback, Outputs, Severity
from autopilot.run.config import flight_settings
from autopilot.sitl.plant import Truth

ARMING_S = 12.0
"""A service that has not armed by then does not want to."""
MOST_EVENTS = 40
HOPELESS_S = 30.0
"""Time from the report that a goal is given up to the end of the flight, where giving up is acceptable."""


class WorldWatch(TickWatch):
    """Data to judge a flight in a random world, beside those of any run of a campaign."""

    def __init__(self, truth: Callable[[], Truth]) -> None:
        super().__init__(truth)
        self.reported: list[tuple[float, int, str]] = []
        """Time, severity and text of every message to the operator."""
        self.reached_seq = -1
        self.hopeless_s = math.inf
        """Time of the report that it does not continue, inf without one."""
        self.first_fallback_s: float | None = None
        self.first_failsafe_s: float | None = None

    def tick(self, outputs: Outputs) -> None:
        super().tick(outputs)
        t_s = outputs.t_us * 1e-6
        for event in outputs.events:
            if event.severity <= Severity.NOTICE and len(self.reported) < MOST_EVENTS:
                self.reported.append((t_s, event.severity, event.text))
            if self._armed_s is not None and is_hopeless(event.text):
                self.hopeless_s = t_s
        if outputs.progress is not None and outputs.progress.reached_seq > self.reached_seq:
            self.reached_seq, self.hopeless_s = outputs.progress.reached_seq, math.inf
        if outputs.mode.failsafes and self.first_failsafe_s is None:
            self.first_failsafe_s = t_s
        control = outputs.control
        if control is not None and outputs.mode.armed and self.first_fallback_s is None:
            self.first_fallback_s = t_s if control.status.fallback is not Fallback.NONE else None

    @property
    def given_up(self) -> bool:
        """Whether the service has reported that it does not continue, and did not."""
        return self._now_s > self.hopeless_s + HOPELESS_S

    @property
    def never_armed(self) -> bool:
        """Whether it is still disarmed after the time allowed."""
        return self._armed_s is None and self._now_s > ARMING_S


@dataclass(frozen=True, slots=True, kw_only=True)
class WorldTask:
    room: int
    mode: int
    seed: int

    def fly(self, stop: Callable[[], bool] = lambda: False) -> WorldResult | None:
        """The result, None if ``stop`` ended the run."""
        flown = fly_world(make_world(self.seed), self.mode, stop)
        return None if flown is None else msgspec.structs.replace(flown.result, room=self.room)

    def failed(self, error: str) -> WorldResult:
        """The result of a flight that raised."""
        return WorldResult(room=self.room, mode=self.mode, seed=self.seed, what=error)


@dataclass(frozen=True, slots=True, eq=False)
class Flown:
    """A flight with the data to judge it."""

    result: WorldResult
    watch: WorldWatch | None
    """None if it was refused by its plan."""
    prospect: Prospect
    end: Truth | None = None
    """The truth at its end."""


def fly_world(
    world: RandomWorld, mode: int, stop: Callable[[], bool] = lambda: False, *, log: str | None = None
) -> Flown | None:
    """Fly a world in a mode (MPC_COST); None if ``stop`` ended the run. AutopilotError if it cannot be flown at all."""
    begun_s = time.process_time()
    chances = prospect(world)
    duration_s = chances.bound_s(mode)
    with tempfile.TemporaryDirectory(prefix="room-") as folder:
        write_files(world, Path(folder), mode=mode, duration_s=duration_s)
        given = {"scenario": str(Path(folder) / SCENARIO_FILE), "seed": world.seed, "start": True, "log": log}
        settings = flight_settings(folder, given)
        try:
            flown = run_watched(settings, {}, WorldWatch, stop, lambda watch: _over(watch, chances, mode))
        except PlanError as error:
            result = judge_refusal(world, chances, str(error))
            return Flown(_timed(result, world, mode, begun_s), None, chances)
        if flown is None:
            return None
        session, watch = flown
        if watch.never_armed or not len(watch.rows):
            result = judge_refusal(world, chances, watch.not_armed or "not armed, and nothing was said")
        else:
            result = judge_flight(world, chances, mode, watch, session.device.truth)
        return Flown(_timed(result, world, mode, begun_s), watch, chances, session.device.truth)


def _over(watch: WorldWatch, chances: Prospect, mode: int) -> bool:
    hopeless = watch.given_up and not chances.sure_after(watch.reached_seq, mode)
    return hopeless or watch.over or watch.never_armed


def _timed(result: WorldResult, world: RandomWorld, mode: int, begun_s: float) -> WorldResult:
    cpu_s = round(time.process_time() - begun_s, 2)
    return msgspec.structs.replace(result, cpu_s=cpu_s, mode=mode, seed=world.seed, title=world.title)
