"""The fault campaign: every row of the failsafe table at drawn times, in the paper's tank and the harbour.

A folder holds one line of JSON per finished flight (``faults.jsonl``); the same call resumes an interrupted
campaign. The draws of flight k of a row depend on row, scenario and k alone.
"""

import random
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from autopilot.campaign.engines import Flyable, InProcess
from autopilot.campaign.fault_cases import CASES, FaultCase
from autopilot.campaign.fault_flights import SCENARIOS, FaultResult, fly_fault_case
from autopilot.campaign.run_store import ResultStore, read_lines
from autopilot.core.names import unknown

FILE = "faults.jsonl"
BETWEEN_S = {"paper-tank": (9.0, 40.0), "harbour": (9.0, 90.0)}
"""Range of the start of faults: armed and under way, with part of the plan left."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultTask:
    case: FaultCase
    scenario: str
    run: int
    seed: int
    at_s: float

    def fly(self, stop: Callable[[], bool]) -> FaultResult:
        return fly_fault_case(self.case, self.scenario, self.seed, self.at_s)

    def failed(self, error: str) -> str:
        return f"{self.case.rule.name} {self.scenario} at {self.at_s:g} s: {error}"

    @property
    def key(self) -> tuple[str, str, int]:
        """Its key in the file."""
        return self.case.rule.name, self.scenario, self.seed


def tasks(runs: int, rows: Sequence[str] = (), scenarios: Sequence[str] = SCENARIOS) -> list[FaultTask]:
    """All flights of a campaign, run by run so that one that is stopped has something of every row.

    UnknownNameError for a row or scenario that does not exist.
    """
    names = [case.rule.name for case in CASES]
    for what, given, known in (("row", rows, names), ("scenario", scenarios, SCENARIOS)):
        for name in given:
            if name not in known:
                raise unknown(what, name, known)
    wanted = [case for case in CASES if not rows or case.rule.name in rows]
    return [_task(case, scenario, run) for run in range(runs) for scenario in scenarios for case in wanted]


def _task(case: FaultCase, scenario: str, run: int) -> FaultTask:
    rng = random.Random(f"{case.rule.name} {scenario} {run}")
    seed, at_s = rng.randrange(1, 10**6), round(rng.uniform(*BETWEEN_S[scenario]), 2)
    return FaultTask(case=case, scenario=scenario, run=run, seed=seed, at_s=at_s)


def fly_campaign(folder: Path, wanted: Sequence[FaultTask]) -> Iterator[FaultResult | str]:
    """Fly the flights missing in the folder; results are stored before they are yielded. Of a flight that could not
    be flown the error is yielded; it stays missing. ConfigError: the folder is in use.
    """
    store: ResultStore[FaultResult] = ResultStore(
        folder / FILE, lambda flight: f"{flight.rule} of {flight.scenario}", option="--out"
    )
    try:
        done = results(folder)
        missing: list[Flyable[FaultResult | str]] = [task for task in wanted if task.key not in done]
        for result in InProcess().run(missing, lambda: False):
            if isinstance(result, FaultResult):
                store.append(result)
            yield result
    finally:
        store.close()


def results(folder: Path) -> dict[tuple[str, str, int], FaultResult]:
    """All finished flights of a folder by the keys of their tasks. LogError names a line that is damaged."""
    return read_lines([folder / FILE], FaultResult, lambda result: (result.rule, result.scenario, result.seed))


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultRow:
    """All flights of one failsafe in one scenario: the worst of each figure."""

    rule: str
    scenario: str
    flights: int
    effect: str
    reaction_s: float | None
    """Slowest from fault to failsafe; None = one was never raised."""
    ends: str
    """End states and how often."""
    closest_m: float
    contacts: int
    kept: int


def table(found: Sequence[FaultResult]) -> list[FaultRow]:
    """One row per failsafe and scenario."""
    rows = []
    for case in CASES:
        for scenario in SCENARIOS:
            mine = [result for result in found if (result.rule, result.scenario) == (case.rule.name, scenario)]
            if mine:
                rows.append(_row(case, scenario, mine))
    return rows


def _row(case: FaultCase, scenario: str, mine: Sequence[FaultResult]) -> FaultRow:
    ends: dict[str, int] = {}
    for result in mine:
        name = result.end.split(" at ")[0]
        ends[name] = ends.get(name, 0) + 1
    reactions = [result.raised_s for result in mine]
    known = [reaction for reaction in reactions if reaction is not None]
    return FaultRow(
        rule=case.rule.name,
        scenario=scenario,
        flights=len(mine),
        effect=case.effect,
        reaction_s=max(known) if len(known) == len(mine) else None,
        ends=", ".join(f"{name} {count}" for name, count in sorted(ends.items())),
        closest_m=min(result.closest_m for result in mine),
        contacts=sum(result.contacts for result in mine),
        kept=sum(result.kept for result in mine),
    )
