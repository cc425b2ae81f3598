"""Flights beside each other: the figures of ``log check`` and per lap, mean and spread over seeds, and what differs."""

import math
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import msgspec

from autopilot.core.errors import LogError
from autopilot.core.params import PARAMETERS
from autopilot.log.analysis import FlightRecord, VehicleTrack, energy_j, flown_laps, load_flight
from autopilot.log.check import acceptance_table, overall
from autopilot.log.check_more import LEAST_LENGTH_M, path_length_m
from autopilot.log.description import RunDescription
from autopilot.log.reader import Log, open_log
from autopilot.log.rows import BoundRow, BoundVerdict

LAP_ENERGY, LAP_TIME = "energy of a lap, median", "time of a lap, median"
COMPARED: Mapping[str, str] = {
    "laps": "",
    LAP_ENERGY: "J",
    LAP_TIME: "s",
    "energy of the mission": "J",
    "time of the mission": "s",
    "path length of the mission": "m",
    "energy per path length": "J/m",
    "path length / straight-line length": "",
    "distance to obstacles": "m",
    "distance to walls": "m",
    "distance to fence": "m",
    "contacts": "",
    "waypoint position": "m",
    "waypoint heading": "rad",
    "overshoot at a goal": "m",
    "1 s prediction error, x rms": "m",
    "1 s prediction error, y rms": "m",
    "estimate position rms": "m",
    "estimate yaw rms": "rad",
    "estimate of the current, rms": "m/s",
    "planar speed": "m/s",
    "yaw rate": "rad/s",
    "mean total thrust": "N",
    "time at the thrust limit": "%",
    "alternating commands": "%",
    "thrust variation / that below 2 Hz": "",
    "largest step of thrust": "N",
    "reversals of a thruster": "1/s",
    "NMPC fallbacks": "",
    "failsafes raised": "",
    "solve time p99": "ms",
}
"""Quantity -> unit, in order; names as in ``log check``. Distances are least, waypoints are the worst visit."""
_OF_THE_RUN = ("seed", "started", "epoch_ns", "speed", "recovered", "currents_map")
"""Metadata in which flights of one group differ."""
_OF_THE_SCENARIO = ("current", "waves", "fault")
_MEAN = "mean"
_NAMED = 6
"""Settings or parameters of a difference that are named."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ComparedFlight:
    """What is kept of a log."""

    path: Path
    run: RunDescription | None
    facts: Mapping[str, str]
    """Metadata of the run."""
    group: Mapping[str, Any]
    """What flights of one group have in common, by kind: everything that was set, except the seed."""
    figures: Mapping[str, float]
    rows: Sequence[BoundRow]
    track: VehicleTrack | None
    """Judged, while armed."""
    basis: str
    """"truth", "estimate", or "" without a track."""
    metered: str
    """Where the energy is from."""
    problems: Sequence[str]

    @property
    def seed(self) -> str:
        return self.facts.get("seed", "")

    @property
    def verdict(self) -> BoundVerdict | None:
        return overall(self.rows) if self.rows else None

    def count(self, verdict: BoundVerdict) -> int:
        return sum(row.verdict is verdict for row in self.rows)


@dataclass(frozen=True, slots=True, kw_only=True)
class Value:
    """A figure of a column: of one flight, or over the seeds of a group."""

    mean: float
    spread: float | None
    """Standard deviation; None of a single flight."""
    count: int
    """Flights that have it."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Column:
    name: str
    flights: Sequence[ComparedFlight]

    def value(self, quantity: str) -> Value | None:
        known = [flight.figures[quantity] for flight in self.flights if quantity in flight.figures]
        if not known:
            return None
        spread = statistics.stdev(known) if len(known) > 1 else None
        return Value(mean=statistics.fmean(known), spread=spread, count=len(known))


def read_flight(path: Path) -> ComparedFlight:
    """A log's figures. LogError if it cannot be read; one without a track has none."""
    log = open_log(path)
    flight, track, rows = load_flight(log), None, list[BoundRow]()
    run = flight.run
    if flight.truth is not None or flight.nav is not None:
        track = flight.judged.between(flight.armed)
    if track is not None and len(track.t_s):
        rows = acceptance_table(log)
    figures = {row.name: row.worst for row in rows if row.worst is not None}
    figures |= _worst_of_several(rows)
    if rows:
        figures |= _of_the_mission(flight)
    if run is not None and run.waypoints and rows:
        laps = flown_laps(flight)
        figures["laps"] = float(len(laps))
        if laps:
            figures[LAP_TIME] = statistics.median(lap.end_s - lap.start_s for lap in laps)
        used = [joules for lap in laps if (joules := energy_j(flight, lap)) is not None]
        if used:
            figures[LAP_ENERGY] = statistics.median(used)
    return ComparedFlight(
        path=path,
        run=run,
        facts={**({} if run is None else {"scenario": run.scenario, "vehicle": run.vehicle}), **log.run},
        group=_group(log, run),
        figures={name: figures[name] for name in COMPARED if name in figures},
        rows=rows,
        track=track if rows else None,
        basis="" if not rows else "truth" if flight.truth is not None else "estimate",
        metered="simulated power" if "/sim/thrusters" in log else "battery monitor" if "/in/power_raw" in log else "",
        problems=log.problems,
    )


def _of_the_mission(flight: FlightRecord) -> dict[str, float]:
    """Until it is complete: what comes after may be of any length."""
    length_m, used_j = path_length_m(flight.judged.between(flight.mission)), energy_j(flight, flight.mission)
    found = {"time of the mission": flight.mission.end_s - flight.mission.start_s}
    found["path length of the mission"] = length_m
    if used_j is not None:
        found["energy of the mission"] = used_j
        found |= {"energy per path length": used_j / length_m} if length_m > LEAST_LENGTH_M else {}
    return found


def _worst_of_several(rows: Sequence[BoundRow]) -> dict[str, float]:
    """Figures of which ``log check`` has a row for each obstacle or waypoint."""
    areas = ("distance to walls", "distance to fence")
    known = [(row.name, row.worst) for row in rows if row.worst is not None]
    found = {
        "distance to obstacles": [-v for name, v in known if name.startswith("distance to ") and name not in areas],
        "waypoint position": [v for name, v in known if name.startswith("waypoint ") and name.endswith(" position")],
        "waypoint heading": [v for name, v in known if name.startswith("waypoint ") and name.endswith(" heading")],
    }
    return {name: abs(max(values)) for name, values in found.items() if values}


def _group(log: Log, run: RunDescription | None) -> dict[str, Any]:
    """Everything that was set, by kind, without the seed."""
    settings = {name: value for name, value in log.run.items() if name not in _OF_THE_RUN}
    scenario = _attached(log, "scenario.json")
    config = _attached(log, "config.json")
    if "sensors" in config:
        settings["sensors"] = config["sensors"] or scenario.get("sensors", {}).get("position", "")
        settings["markers"] = config.get("markers") or ""
    if "scenario" in scenario:
        scenario = {**scenario, "scenario": {**scenario["scenario"], "seed": None}}
    return {
        "settings": settings,
        "parameters": {} if run is None else run.parameters,
        "scenario": scenario,
        "vehicle": _attached(log, "vehicle.json"),
        "task": {
            **({} if run is None else {"tank": run.tank_polygon_m, "obstacles": run.obstacles, "plan": run.waypoints}),
            **{name: scenario[name] for name in _OF_THE_SCENARIO if name in scenario},
        },
    }


def _attached(log: Log, name: str) -> dict[str, Any]:
    try:
        found = msgspec.json.decode(log.attachments.get(name, b"{}"))
    except msgspec.MsgspecError as error:
        raise LogError(f"{log.path}: attachment {name} is damaged ({error})") from error
    return found if isinstance(found, dict) else {}


def columns(flights: Sequence[ComparedFlight]) -> list[Column]:
    """One column for each group of flights that differ only in their seed, in the order of the flights.

    Flights that are all of one group have a column each, and a last one for all of them.
    """
    groups: list[list[ComparedFlight]] = []
    for flight in flights:
        mine = next((group for group in groups if _belongs(flight, group)), None)
        if mine is None:
            groups.append([flight])
        else:
            mine.append(flight)
    if len(groups) == 1 < len(flights):
        return [*_named([[flight] for flight in flights]), Column(name=_MEAN, flights=flights)]
    return _named(groups)


def own(shown: Sequence[Column]) -> list[Column]:
    """All but the mean of all flights."""
    return [column for column in shown if column.name != _MEAN]


def _named(groups: Sequence[Sequence[ComparedFlight]]) -> list[Column]:
    return [Column(name=_letters(number), flights=group) for number, group in enumerate(groups)]


def _letters(number: int) -> str:
    """A to Z, then AA, AB and so on."""
    before = _letters(number // 26 - 1) if number >= 26 else ""
    return before + chr(ord("A") + number % 26)


def _belongs(flight: ComparedFlight, group: Sequence[ComparedFlight]) -> bool:
    return bool(flight.seed) and flight.group == group[0].group and all(other.seed != flight.seed for other in group)


def ratio(first: Value | None, other: Value | None) -> float | None:
    """To the first, of values above 0."""
    if first is None or other is None or not (first.mean > 0.0 and other.mean > 0.0):
        return None
    return other.mean / first.mean


def differences(shown: Sequence[Column]) -> list[str]:
    """What was set otherwise than in the first column, of what both logs name."""
    found = []
    first = shown[0].flights[0].group
    for column in own(shown)[1:]:
        one = column.flights[0].group
        changed = []
        for kind in ("settings", "parameters"):
            ours, theirs = first[kind], one[kind]
            other = [name for name in ours if name in theirs and ours[name] != theirs[name]]
            changed += [f"{n} {_meant(n, theirs[n])}, not {_meant(n, ours[n])}" for n in other[:_NAMED]]
            changed += [f"{len(other) - _NAMED} more {kind} (log diff)"] if len(other) > _NAMED else []
        if changed:
            found.append(f"{column.name} has {'; '.join(changed)}")
    return found


def _meant(name: str, value: float | str) -> str:
    """A setting or a parameter's value, with its meaning if it is one of a list."""
    if isinstance(value, str):
        return value or "none"
    values = next((spec.values for spec in PARAMETERS if spec.name == name), {})
    meaning = values.get(int(value)) if math.isfinite(value) else None
    return f"{value:g}" if meaning is None else f"{value:g} ({meaning})"


def not_comparable(shown: Sequence[Column]) -> list[str]:
    """What makes figures of different columns incomparable, or missing."""
    first, a = shown[0].flights[0], shown[0].name
    found = []
    for column in own(shown)[1:]:
        one, b = column.flights[0], column.name
        ours, theirs = first.group["task"], one.group["task"]
        other = [name for name in ours if name in theirs and ours[name] != theirs[name]]
        names = [flight.facts.get("scenario", "") for flight in (first, one)]
        if other or (all(names) and names[0] != names[1]):
            where = f"scenarios {names[0]} and {names[1]}" if names[0] != names[1] else f"both {names[0]}"
            what = f"different {', '.join(other)}" if other else "other names"
            found.append(f"{a} and {b} have {what} ({where}): laps, times, energy and distances are of two tasks")
        names = [flight.facts.get("vehicle", "") for flight in (first, one)]
        files = [flight.group["vehicle"] for flight in (first, one)]
        if any(all(pair) and pair[0] != pair[1] for pair in (files, names)):
            what = f"{names[0]} and {names[1]}" if names[0] != names[1] else f"{names[0]} with different vehicle files"
            found.append(f"{a} and {b} are {what}: energy and thrust are of two vehicles")
        if first.basis and one.basis and first.basis != one.basis:
            found.append(f"{a} is judged on the {first.basis}, {b} on the {one.basis}: distances differ by its error")
        if first.metered and one.metered and first.metered != one.metered:
            found.append(f"energy of {a} is by the {first.metered}, of {b} by the {one.metered}")
    for column in own(shown):
        for flight in column.flights:
            found += [f"{flight.path.name}: {text}" for text in _lacks(flight)]
    return list(dict.fromkeys(found))


def _lacks(flight: ComparedFlight) -> list[str]:
    found = [f"damaged, {problem}" for problem in flight.problems]
    if flight.track is None:
        return [*found, "has neither /sim/truth nor /nav/state: nothing can be judged"]
    if flight.run is None:
        return [*found, "has no run.json: no laps, no limits"]
    asked, done = flight.run.accept.laps, flight.figures.get("laps")
    if done is None:
        found.append("has no waypoints: no laps")
    elif asked is not None and done < asked:
        found.append(f"{done:.0f} of {asked} laps are complete")
    return found


def headline(shown: Sequence[Column]) -> str:
    """Energy and time of a lap, or energy as a whole where no two columns have laps; "" without energy."""
    known = own(shown)
    parts = _against(known, LAP_ENERGY, "J a lap") + _against(known, LAP_TIME, "s a lap")
    parts = parts or _against(known, "energy per path length", "J/m")
    return ", ".join(parts or _against(known, "energy of the mission", "J"))


def _against(shown: Sequence[Column], quantity: str, unit: str) -> list[str]:
    values = [column.value(quantity) for column in shown]
    if sum(value is not None for value in values) < 2:
        return []
    texts = ["-" if value is None else f"{value.mean:.{0 if value.mean >= 100.0 else 1}f}" for value in values]
    if len(shown) == 2:
        times = ratio(values[0], values[1])
        return [f"{texts[0]} against {texts[1]} {unit}" + ("" if times is None else f" ({times:.2f} times)")]
    return ["; ".join(f"{column.name} {text}" for column, text in zip(shown, texts, strict=True)) + f" {unit}"]


def as_json(shown: Sequence[Column]) -> dict[str, Any]:
    first = shown[0]
    figures = [
        {
            "name": name,
            "unit": unit,
            "values": {c.name: None if (v := c.value(name)) is None else asdict(v) for c in shown},
            "ratios": {c.name: ratio(first.value(name), c.value(name)) for c in shown[1:]},
        }
        for name, unit in COMPARED.items()
        if any(column.value(name) for column in shown)
    ]
    logs = {
        column.name: [
            {
                "log": str(one.path),
                "run": dict(one.facts),
                "verdict": None if one.verdict is None else one.verdict.value,
                "figures": dict(one.figures),
            }
            for one in column.flights
        ]
        for column in own(shown)
    }
    return {
        "headline": headline(shown),
        "columns": logs,
        "figures": figures,
        "differences": differences(shown),
        "not_comparable": not_comparable(shown),
    }
