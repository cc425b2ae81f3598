"""The reference flights: what the shipped vehicle does in known water, kept per release as a table of figures.

Each is flown in lockstep from its own seed, so that every figure is the same on every run of the same version (and
machine): one that has moved is a change of behaviour, and the table says which and from what to what.
"""

import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import msgspec

from autopilot import __version__
from autopilot.analysis.flight_figures import Figures, Moved, figures_of, moved
from autopilot.core.errors import ConfigError
from autopilot.log.reader import open_log
from autopilot.run.config import gather, sitl_defaults
from autopilot.run.provenance import revision
from autopilot.run.sitl_console import RunWatch
from autopilot.run.sitl_session import open_sitl
from tests.bench.replays import shipped_plan

TABLE = Path(__file__).with_name("reference_flights.json")
"""Figures of the last release."""
SAME = 1e-9
"""Relative change that is none: another machine rounds otherwise."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ReferenceFlight:
    scenario: str
    sensors: str
    duration_s: float | None
    """None = until the mission is complete."""
    params: Mapping[str, float] = field(default_factory=dict)


FLIGHTS: dict[str, ReferenceFlight] = {
    "tank, tracking": ReferenceFlight(scenario="paper-tank", sensors="pose", duration_s=None, params={"MPC_COST": 0}),
    "tank, energy": ReferenceFlight(scenario="paper-tank", sensors="pose", duration_s=None, params={"MPC_COST": 1}),
    "tank, start with pictures": ReferenceFlight(scenario="paper-tank", sensors="camera", duration_s=8.0),
    "tank, first leg, tracking": ReferenceFlight(
        scenario="paper-tank", sensors="pose", duration_s=15.0, params={"MPC_COST": 0}
    ),
    "tank, first leg, energy": ReferenceFlight(
        scenario="paper-tank", sensors="pose", duration_s=15.0, params={"MPC_COST": 1}
    ),
    "vortex, estimated flow": ReferenceFlight(scenario="b4-est", sensors="pose", duration_s=15.0),
    "harbour": ReferenceFlight(scenario="harbour", sensors="pose", duration_s=15.0),
}
"""By name. The short ones take a minute together, those of whole missions some minutes."""
SHORT = tuple(name for name, flight in FLIGHTS.items() if flight.duration_s is not None)


class Release(msgspec.Struct, frozen=True, kw_only=True):
    version: str
    revision: str
    flights: dict[str, dict[str, float]]


def fly(flight: ReferenceFlight, folder: Path) -> Figures:
    """The figures of a flight; its files go into ``folder``."""
    path = folder / "flight.mcap"
    given = {"scenario": flight.scenario, "sensors": flight.sensors, "speed": 0.0, "start": True}
    settings = gather(sitl_defaults(0), given, {})
    plan = shipped_plan(flight.scenario)
    settings.put("plan", None if plan is None else str(plan), "reference flight")
    places = {"connect": (), "state_dir": str(folder / "state"), "log": str(path), "log_dir": str(folder)}
    for key, value in {**places, "duration": flight.duration_s}.items():
        settings.put(key, value, "reference flight")
    session = open_sitl(settings, dict(flight.params), on_tick=lambda outputs: watch.step(outputs))
    watch = RunWatch(session, lambda _: None)
    session.run(stop=lambda: flight.duration_s is None and watch.ended)
    return figures_of(open_log(path))


def flown(names: Iterable[str]) -> Release:
    """The figures of these flights with this version. ConfigError for one that there is not."""
    found: dict[str, dict[str, float]] = {}
    for name in names:
        if name not in FLIGHTS:
            raise ConfigError(f"there is no reference flight {name!r}; there are {', '.join(FLIGHTS)}")
        with tempfile.TemporaryDirectory(prefix="reference-") as folder:
            found[name] = fly(FLIGHTS[name], Path(folder))
    return Release(version=__version__, revision=revision(), flights=found)


def read_release(path: Path = TABLE) -> Release:
    """The kept figures. ConfigError when there are none."""
    try:
        return msgspec.json.decode(path.read_bytes(), type=Release)
    except FileNotFoundError:
        return Release(version="", revision="", flights={})
    except (OSError, msgspec.MsgspecError) as error:
        raise ConfigError(f"{path}: cannot be read ({error}); fly them anew with --update") from error


def keep(release: Release, path: Path = TABLE) -> None:
    """Put figures in the place of those of the same flights. ConfigError if the file cannot be written."""
    before = read_release(path)
    together = {**before.flights, **release.flights}
    ordered = {name: together[name] for name in FLIGHTS if name in together}
    text = msgspec.json.format(msgspec.json.encode(msgspec.structs.replace(release, flights=ordered)), indent=1)
    try:
        path.write_bytes(text + b"\n")
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written ({error.strerror}); use a checkout") from error


def changes(before: Release, after: Release) -> dict[str, Sequence[Moved]]:
    """By flight the figures that have moved."""
    return {
        name: [one for one in moved(before.flights.get(name, {}), figures) if not _as_good_as_same(one)]
        for name, figures in after.flights.items()
    }


def _as_good_as_same(one: Moved) -> bool:
    return one.same or (one.relative_change is not None and abs(one.relative_change) < SAME)
