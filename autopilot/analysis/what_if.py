"""A logged run repeated with other parameters.

*Closed loop*: the simulation of the log's scenario, with the log's own settings, parameters and plan; clients send
what they sent then, at the same times. *Open loop*: the recorded inputs into a service with other parameters: its
commands for the states of that flight, which is informative for a step and not for a flight.
"""

import tempfile
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from autopilot.analysis.flight_figures import Moved, figures_of, moved
from autopilot.core.errors import ConfigError, LogError
from autopilot.core.params import ParamSet
from autopilot.log.reader import Log, open_log
from autopilot.record.service_setup import ServiceRecord, read_record
from autopilot.replay.service_inputs import ServiceInputs
from autopilot.replay.service_replay import replay_service
from autopilot.run.config import gather, sitl_defaults
from autopilot.run.sitl_console import RunWatch
from autopilot.run.sitl_session import open_sitl
from autopilot.sitl.scenario import load_scenario

LONGER = 1.5
"""Factor on the duration of a mission that was complete in the log."""


@dataclass(frozen=True, slots=True, kw_only=True)
class WhatIf:
    changes: tuple[tuple[str, float, float], ...]
    """Parameter, value of the log, value tried."""
    moved: tuple[Moved, ...]
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class OpenLoop:
    """Commands on the recorded inputs with other parameters against those of the log."""

    changes: tuple[tuple[str, float, float], ...]
    steps: int
    rms_n: float
    """Of the difference of thrust, over steps and thrusters."""
    largest_n: float
    largest_at_s: float
    rms_before_n: float
    rms_after_n: float


def read_changes(log: Log, texts: Iterable[str]) -> tuple[tuple[str, float], ...]:
    """``NAME=VALUE`` texts as parameters. ConfigError names one that is not."""
    params, found = ParamSet(), []
    for text in texts:
        name, _, raw = text.partition("=")
        try:
            params.set(name.strip(), float(raw))
        except ValueError as error:
            raise ConfigError(f"--set {text!r}: write NAME=VALUE with a number") from error
        found.append((name.strip(), params[name.strip()]))
    return tuple(found)


def closed_loop(log: Log, changes: Sequence[tuple[str, float]], out: Path | None = None) -> WhatIf:
    """Simulate the log's run with ``changes``; ``out`` keeps its log. LogError for a log of no simulation."""
    record = read_record(log)
    with tempfile.TemporaryDirectory(prefix="what-if-") as folder:
        path = out or Path(folder) / "run.mcap"
        remarks = _simulate(log, record, changes, Path(folder), path)
        again = open_log(path)
        return WhatIf(
            changes=_named(record, changes),
            moved=tuple(moved(figures_of(log), figures_of(again))),
            remarks=remarks,
        )


def open_loop(log: Log, changes: Sequence[tuple[str, float]], out: Path | None = None) -> OpenLoop:
    """Give the log's inputs to a service with ``changes``; ``out`` keeps its log."""
    record = read_record(log)
    with tempfile.TemporaryDirectory(prefix="what-if-") as folder:
        path = out or Path(folder) / "run.mcap"
        replay_service(log, changes=changes, out=path)
        then, now = _commands(log), _commands(open_log(path))
    _, i, j = np.intersect1d(then[0], now[0], return_indices=True)
    if not len(i):
        raise LogError(f"{log.path}: holds no command of an armed vehicle; there is nothing to compare")
    a, b = then[1][i], now[1][j]
    apart = np.abs(b - a)
    at = int(np.argmax(apart.max(axis=1)))
    used = max(1, int((np.abs(a) + np.abs(b)).any(axis=0).sum()))
    rms = [float(np.sqrt((values**2).sum() / (used * len(i)))) for values in (apart, a, b)]
    return OpenLoop(
        changes=_named(record, changes),
        steps=len(i),
        rms_n=rms[0],
        largest_n=float(apart.max()),
        largest_at_s=1e-6 * float(then[0][i][at]),
        rms_before_n=rms[1],
        rms_after_n=rms[2],
    )


def _commands(log: Log) -> tuple[Any, Any]:
    table = log.get("/out/thrusters")
    steps = log.get("/ctl/nmpc")
    if table is None or steps is None:
        return np.zeros(0, dtype=np.int64), np.zeros((0, 8))
    flown = table[np.isin(table["t_us"], steps["t_us"])]
    return flown["t_us"], flown["thrust_n"]


def _named(record: ServiceRecord, changes: Sequence[tuple[str, float]]) -> tuple[tuple[str, float, float], ...]:
    return tuple((name, record.parameters.get(name, float("nan")), value) for name, value in changes)


class _RecordedLink:
    """A client that repeats the logged messages of a client at the same times, regardless of answers."""

    def __init__(self, sent: dict[int, list[bytes]]) -> None:
        self._sent = sent

    def step(self, t_us: int, received: Sequence[bytes]) -> list[bytes]:
        """Data sent in a tick are received on the next."""
        del received
        return self._sent.get(t_us + 10_000, [])


def _clients(log: Log, links: int) -> list[_RecordedLink]:
    sent: list[dict[int, list[bytes]]] = [{} for _ in range(links)]
    for inputs in ServiceInputs(log):
        for frame in inputs.mavlink_rx:
            if 0 <= frame.link < links:
                sent[frame.link].setdefault(inputs.t_us, []).append(frame.data)
    return [_RecordedLink(one) for one in sent]


def _simulate(
    log: Log, record: ServiceRecord, changes: Sequence[tuple[str, float]], folder: Path, path: Path
) -> tuple[str, ...]:
    config = log.attachments.get("config.json")
    scene = log.attachments.get("scenario.json")
    if scene is None or config is None:
        raise LogError(
            f"{log.path}: is of no simulation (no attachment scenario.json): its world cannot be asked again; "
            "compare commands on the recorded inputs (--open-loop)"
        )
    values: dict[str, Any] = msgspec.json.decode(config)
    settings = gather(sitl_defaults(record.instance), {}, {})
    for name in settings.table:
        if values.get(name) is not None:
            value = values[name]
            settings.put(name, tuple(value) if isinstance(value, list) else value, str(log.path))
    places = {"connect": (), "log": str(path), "log_dir": str(folder), "state_dir": str(folder / "state")}
    for name, value in {**places, "speed": 0.0, "duration": LONGER * log.duration_s, "view": None}.items():
        settings.put(name, value, "what-if")
    if log.run.get("seed", "").isdecimal():
        settings.put("seed", int(log.run["seed"]), str(log.path))
    now = load_scenario(settings["scenario"])
    remarks: tuple[str, ...] = (
        () if msgspec.json.encode(now) == scene else ("the scenario has changed since: this is today's",)
    )
    overrides = {**record.parameters, **dict(changes)}
    peers = () if settings["start"] else _clients(log, record.links)
    session = open_sitl(settings, overrides, instance=record.instance, peers=peers, on_tick=lambda o: watch.step(o))
    watch = RunWatch(session, lambda _: None)
    ends_s, ends = log.duration_s, _completed(log)
    ticks = 0

    def stop() -> bool:
        nonlocal ticks
        ticks += 1
        return watch.ended if ends else ticks * 0.01 > ends_s

    session.run(stop=stop)
    if ends and not watch.complete:
        remarks += ("the mission was complete then and is not now",)
    return remarks


def _completed(log: Log) -> bool:
    progress = log.get("/mission/progress")
    return progress is not None and bool((progress["state"] == 5).any())
