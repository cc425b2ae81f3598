"""Whether flights give the same when they are replayed: every shipped scenario, with pictures and without.

A flight is cut short; what a replay must reproduce does not depend on how long it is. Beside the scenarios a paced run
(real time, where answers come when they are ready) and a real vehicle's service on emulated devices.
"""

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from autopilot.core.errors import AutopilotError
from autopilot.log.reader import open_log
from autopilot.run.config import gather, sitl_defaults
from autopilot.run.sitl_replay import replay_service
from autopilot.run.sitl_session import open_sitl
from sitl.scenario import load_scenario, scenario_names, scenario_path

FLIGHT_S, SHORT_S = 30.0, 5.0


@dataclass(frozen=True, slots=True, kw_only=True)
class ReplayRow:
    """One flight and its replay."""

    flight: str
    sensors: str
    speed: float
    ticks: int
    messages: int
    differences: int
    first: str
    """Where and what the first difference is, or why there was no flight; "" = the same."""


def replay_rows(*, short: bool, only: Sequence[str] = ()) -> Iterator[ReplayRow]:
    """Fly and replay, one after the other. ``only``: these scenarios."""
    duration_s = SHORT_S if short else FLIGHT_S
    for name in only or scenario_names():
        position = load_scenario(name).sensors.position
        yield flown_and_replayed(name, position, duration_s)
        if position == "camera":
            yield flown_and_replayed(name, "pose", duration_s)
    yield flown_and_replayed("paper-tank", "pose", min(duration_s, 15.0), speed=1.0)


def flown_and_replayed(
    name: str, sensors: str, duration_s: float, *, speed: float = 0.0, params: dict[str, float] | None = None
) -> ReplayRow:
    """A flight of a scenario from its start, and its replay."""
    with tempfile.TemporaryDirectory(prefix="replays-") as folder:
        path = Path(folder) / "flight.mcap"
        try:
            _fly(name, sensors, duration_s, speed, path, params or {})
            result = replay_service(open_log(path))
        except AutopilotError as error:
            return ReplayRow(
                flight=name, sensors=sensors, speed=speed, ticks=0, messages=0, differences=1, first=str(error)
            )
    first = str(result.differences[0]) if result.differences else result.stopped
    return ReplayRow(
        flight=name,
        sensors=sensors,
        speed=speed,
        ticks=result.ticks,
        messages=result.messages,
        differences=len(result.differences),
        first=first,
    )


def _fly(name: str, sensors: str, duration_s: float, speed: float, path: Path, params: dict[str, float]) -> None:
    given = {"scenario": name, "sensors": sensors, "speed": speed, "duration": duration_s, "start": True}
    settings = gather(sitl_defaults(0), given, {})
    for key, value in (("connect", ()), ("state_dir", str(path.parent / "state")), ("log", str(path))):
        settings.put(key, value, "bench replay")
    plan = shipped_plan(name)
    if plan is None and load_scenario(name).scenario.plan is None:
        settings.put("start", False, "bench replay")
    settings.put("plan", None if plan is None else str(plan), "bench replay")
    open_sitl(settings, params).run()


def shipped_plan(name: str) -> Path | None:
    """The plan that lies beside a scenario, None where it names its own or has none."""
    path = scenario_path(name).with_suffix(".mission.toml")
    return path if load_scenario(name).scenario.plan is None and path.is_file() else None
