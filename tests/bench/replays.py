"""Whether flights give the same when they are replayed: every shipped scenario, with pictures and without.

A flight is cut short unless whole ones are asked for: most of what a replay must reproduce shows within seconds, but
not what comes late (faults, failsafes, the end of a mission). Beside the scenarios there is a paced run (real time,
where answers come when they are ready).
"""

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from autopilot.core.errors import AutopilotError
from autopilot.log.reader import open_log
from autopilot.replay.service_replay import replay_service
from autopilot.run.config import gather, sitl_defaults
from autopilot.run.sitl_console import RunWatch
from autopilot.run.sitl_session import open_sitl
from autopilot.sitl.scenario import load_scenario, scenario_names, scenario_path

FLIGHT_S, SHORT_S, PACED_S = 30.0, 5.0, 15.0
WHOLE_S = 1800.0
"""A mission that is not complete by then never will be."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ReplayRow:
    flight: str
    sensors: str
    speed: float
    ticks: int
    messages: int
    differences: int
    first: str
    """Where and what the first difference is, or why there was no flight; "" = the same."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Flown:
    """One flight that is to be replayed."""

    scenario: str
    sensors: str
    duration_s: float
    whole: bool = False
    """It ends with its mission, before ``duration_s``."""
    speed: float = 0.0

    def __str__(self) -> str:
        return f"{self.scenario}, {self.sensors}" + (", in real time" if self.speed else "")


def planned_flights(*, short: bool = False, whole: bool = False, only: Sequence[str] = ()) -> list[Flown]:
    """What :func:`flown_and_replayed` is to be asked, in order. ``only``: these scenarios."""
    flights: list[Flown] = []
    for name in only or scenario_names():
        position = load_scenario(name).sensors.position
        ends = whole and _has_plan(name)
        duration_s = WHOLE_S if ends else SHORT_S if short else FLIGHT_S
        flights += [
            Flown(scenario=name, sensors=sensors, duration_s=duration_s, whole=ends)
            for sensors in (("camera", "pose") if position == "camera" else (position,))
        ]
    paced_s = WHOLE_S if whole else SHORT_S if short else PACED_S
    return [*flights, Flown(scenario="paper-tank", sensors="pose", duration_s=paced_s, whole=whole, speed=1.0)]


def flown_and_replayed(flight: Flown) -> ReplayRow:
    """Fly it from its start, and replay it."""
    with tempfile.TemporaryDirectory(prefix="replays-") as folder:
        path = Path(folder) / "flight.mcap"
        try:
            _fly(flight, path)
            result = replay_service(open_log(path))
        except AutopilotError as error:
            return _row(flight, differences=1, first=str(error))
    first = str(result.differences[0]) if result.differences else result.stopped
    count = len(result.differences)
    return _row(flight, ticks=result.ticks, messages=result.messages, differences=count, first=first)


def _row(flight: Flown, *, differences: int, first: str, ticks: int = 0, messages: int = 0) -> ReplayRow:
    return ReplayRow(
        flight=flight.scenario,
        sensors=flight.sensors,
        speed=flight.speed,
        ticks=ticks,
        messages=messages,
        differences=differences,
        first=first,
    )


def _fly(flight: Flown, path: Path) -> None:
    name = flight.scenario
    given = {"scenario": name, "sensors": flight.sensors, "speed": flight.speed, "start": True}
    settings = gather(sitl_defaults(0), given, {})
    places = {"connect": (), "state_dir": str(path.parent / "state"), "log": str(path)}
    plan = shipped_plan(name)
    rest = {"duration": flight.duration_s, "start": _has_plan(name), "plan": None if plan is None else str(plan)}
    for key, value in {**places, **rest}.items():
        settings.put(key, value, "bench replay")
    session = open_sitl(settings, {}, on_tick=lambda outputs: watch.step(outputs))
    watch = RunWatch(session, lambda _: None)
    session.run(stop=lambda: flight.whole and watch.ended)


def _has_plan(name: str) -> bool:
    return shipped_plan(name) is not None or load_scenario(name).scenario.plan is not None


def shipped_plan(name: str) -> Path | None:
    """The plan that lies beside a scenario, None where it names its own or has none."""
    path = scenario_path(name).with_suffix(".mission.toml")
    return path if load_scenario(name).scenario.plan is None and path.is_file() else None
