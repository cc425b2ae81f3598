"""False alarms of sound thrusters and the time to find lossy ones: whole flights of R1 to R4, and random vehicles.

Flights are the whole service on the drawn vehicle of a campaign run, in both cost modes in turn; random vehicles fly in
:mod:`tests.bench.thruster_loops`. What has been flown is kept in a folder, one line a flight, and not flown again.
"""

import math
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from autopilot.campaign.definition import define
from autopilot.campaign.flight import settings_of
from autopilot.campaign.run_store import ResultStore, read_lines
from autopilot.campaign.summary import failure_bound
from autopilot.core.messages import Outputs
from autopilot.run.provenance import revision
from autopilot.run.sitl_session import open_sitl
from tests.bench.thruster_loops import Loss, fly

NAMES = ("port", "starboard", "vertical", "lateral")
SETS = ("r1", "r2", "r3", "r4")
SHARES = (0.5, 0.0)
"""Left of a lossy thruster."""

RANDOM = "random"
"""Set of the random vehicles."""

ASKED_S = {0.5: 15.0, 0.0: 5.0}
"""Time to find that is asked for [s], by share."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HealthFlight:
    kind: str
    """r1 to r4, or random."""
    run: int
    """Of the campaign; seed of a random vehicle."""
    cost: int
    """MPC_COST."""
    seconds: float
    thruster: int | None = None
    """That is lossy from ``at_s`` on; None = all are sound."""
    share: float = 1.0
    at_s: float = 0.0

    @property
    def name(self) -> str:
        lost = "" if self.thruster is None else f"-{NAMES[self.thruster]}-{100.0 * self.share:.0f}-at-{self.at_s:g}"
        return f"{self.kind}-{self.run}-{self.cost}-{self.seconds:g}{lost}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    name: str
    revision: str
    armed_s: float
    """So long it looked."""
    false: tuple[str, ...]
    """What was said of sound thrusters."""
    found_s: float | None = None
    """After the loss."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    what: str
    flights: int
    minutes: float
    false: int
    """Flights with a word about a sound thruster."""
    false_below: float
    """Share of flights that this is below with 95 % confidence (with none: the rule of three)."""
    found: int | None = None
    median_s: float | None = None
    p95_s: float | None = None
    max_s: float | None = None
    asked_s: float | None = None


def planned(healthy: int, lossy: int) -> list[HealthFlight]:
    """Flights in the order in which they are worth most: sets, modes and thrusters in turn, a random one after each."""
    flights: list[HealthFlight] = []
    for k in range(max(healthy, lossy)):
        kind, run = SETS[k % 4], k // 4
        cost = (run + k) % 2
        if k < healthy:
            flights.append(HealthFlight(kind=kind, run=run, cost=cost, seconds=90.0))
            flights.append(HealthFlight(kind=RANDOM, run=k, cost=0, seconds=60.0))
        if k < lossy:
            thruster, share, at_s = (k + k // 4) % 4, SHARES[(k // 4) % 3 == 2], 12.0 + 7.0 * (k % 5)
            whole = HealthFlight(
                kind=kind, run=100 + run, cost=cost, seconds=at_s + 35.0, thruster=thruster, share=share, at_s=at_s
            )
            flights += [whole, replace(whole, kind=RANDOM, run=10_000 + k, cost=0, seconds=50.0, at_s=15.0)]
    return flights


def fly_flight(flight: HealthFlight) -> Outcome:
    return _fly_random(flight) if flight.kind == RANDOM else _fly_campaign(flight)


def bench_thruster_health(
    healthy: int, lossy: int, folder: Path | None, show: Callable[[str], None] = lambda line: None
) -> Iterator[Row]:
    """Fly what is missing in ``folder`` (None: everything), then sum up."""
    flights = planned(healthy, lossy)
    paths = [] if folder is None else [folder / "flights.jsonl"]
    kept = read_lines(paths, Outcome, lambda outcome: (outcome.name, outcome.revision))
    done = {name: outcome for (name, code), outcome in kept.items() if code == revision()}
    stores = [ResultStore[Outcome](path, lambda outcome: outcome.name, option="--out") for path in paths]
    for number, flight in enumerate(flights):
        if flight.name in done:
            continue
        outcome = done[flight.name] = fly_flight(flight)
        for store in stores:
            store.append(outcome)
        text = "; ".join(outcome.false) or ("" if flight.thruster is None else f"found after {outcome.found_s} s")
        show(f"{number + 1} of {len(flights)}: {flight.name} {text}")
    for store in stores:
        store.close()
    yield from _rows([(flight, done[flight.name]) for flight in flights])


def _rows(flown: list[tuple[HealthFlight, Outcome]]) -> Iterator[Row]:
    for random in (False, True):
        where = "random vehicles" if random else "R1 to R4"
        mine = [(flight, outcome) for flight, outcome in flown if (flight.kind == RANDOM) is random]
        yield _row(f"{where}, sound", [pair for pair in mine if pair[0].thruster is None], None)
        for share, what in zip(SHARES, ("half", "dead"), strict=True):
            for thruster, name in enumerate(NAMES):
                these = [pair for pair in mine if pair[0].thruster == thruster and pair[0].share == share]
                if these:
                    yield _row(f"{where}, {what} {name}", these, ASKED_S[share])


def _row(what: str, flown: list[tuple[HealthFlight, Outcome]], asked_s: float | None) -> Row:
    outcomes = [outcome for _, outcome in flown]
    false = sum(bool(outcome.false) for outcome in outcomes)
    row = Row(
        what=what,
        flights=len(outcomes),
        minutes=sum(outcome.armed_s for outcome in outcomes) / 60.0,
        false=false,
        false_below=failure_bound(false, len(outcomes)),
    )
    if asked_s is None:
        return row
    times = [math.inf if outcome.found_s is None else outcome.found_s for outcome in outcomes]
    return replace(
        row,
        found=sum(map(math.isfinite, times)),
        median_s=float(np.quantile(times, 0.5, method="higher")),
        p95_s=float(np.quantile(times, 0.95, method="higher")),
        max_s=max(times),
        asked_s=asked_s,
    )


def _fly_random(flight: HealthFlight) -> Outcome:
    loss = None
    if flight.thruster is not None:
        loss = Loss(thruster=flight.thruster, share=flight.share, at_s=flight.at_s)
    flown = fly(flight.run, flight.seconds, loss)
    return Outcome(
        name=flight.name,
        revision=revision(),
        armed_s=flight.seconds,
        false=tuple(f"{t_s:.1f} s {name} {100.0 * share:.0f} %" for t_s, name, share in flown.false),
        found_s=None if flown.first_s is None else flown.first_s - flight.at_s,
    )


def _fly_campaign(flight: HealthFlight) -> Outcome:
    task = define(flight.kind, duration_s=flight.seconds).task(flight.run)
    if flight.thruster is not None:
        loss = f"at_s = {flight.at_s}\nthruster = {NAMES[flight.thruster]!r}\nloss = {1.0 - flight.share}\n"
        task = replace(task, scenario_toml=f'{task.scenario_toml}\n[[fault]]\nkind = "thruster_loss"\n{loss}')
    with tempfile.TemporaryDirectory(prefix="bench-") as name:
        watch = _Watch(flight)
        params = {"MPC_COST": float(flight.cost)}
        session = open_sitl(settings_of(task, Path(name)), params, log=False, on_tick=watch.tick)
        session.run(lambda: False)
    return watch.outcome()


class _Watch:
    def __init__(self, flight: HealthFlight) -> None:
        self._flight = flight
        self._armed_us = 0
        self._last_us = 0
        self._reported: dict[int, float] = {}
        self._false: list[str] = []
        self._found_s: float | None = None

    def tick(self, outputs: Outputs) -> None:
        """Take note of what is declared."""
        if outputs.mode.armed:
            self._armed_us += outputs.t_us - self._last_us
        self._last_us = outputs.t_us
        if outputs.thrusters is None:
            return
        t_s = 1e-6 * outputs.t_us
        for i, share in enumerate(outputs.thrusters.effectiveness[: len(NAMES)].tolist()):
            before = self._reported.get(i, 1.0)
            self._reported[i] = share
            if share == 1.0 or before < 1.0:
                continue
            if i != self._flight.thruster or t_s < self._flight.at_s:
                self._false.append(f"{t_s:.1f} s {NAMES[i]} {100.0 * share:.0f} %")
            elif self._found_s is None:
                self._found_s = t_s - self._flight.at_s

    def outcome(self) -> Outcome:
        return Outcome(
            name=self._flight.name,
            revision=revision(),
            armed_s=1e-6 * self._armed_us,
            false=tuple(self._false),
            found_s=self._found_s,
        )
