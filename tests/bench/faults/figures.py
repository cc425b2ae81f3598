"""Figures of findings that no test may depend on: real time, CPU time of a machine, drawn faults, memory."""

import random
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from autopilot.core.plan import PlanKind
from tests.bench.fault_campaign import drawn_fault
from tests.bench.faults.finding import Finding, Measured
from tests.bench.faults.pilot import KEPT_FREE, crowded_plan, go_to, piloted
from tests.bench.fuzz.run import run_fuzz
from tests.bench.sensor_faults import FaultFlight, fly_fault

P99_MS, MAX_MS = 10.0, 50.0
"""What a tick may cost of CPU time."""
OCTAGONS = 50
DRAWN = 8
FUZZED = 15_000
"""Messages of the table's fuzzer; `autopilot bench fuzz` takes a million."""


def _crowded_flight(cost: int, *, round_ones: bool = False) -> Measured:
    """On its way in open water; then comes a fence that bars the way, then a go-to behind another obstacle."""
    with piloted("open-water", {"MPC_COST": cost}) as flight:
        flight.upload(PlanKind.MISSION, crowded_plan(flight.origin(), 0, 2, 1).mission)
        flight.start()
        flight.fly(3.0)
        since = len(flight.control_s)
        fence = crowded_plan(flight.origin(), OCTAGONS, 2, 1, round_ones=round_ones).fence
        flight.upload(PlanKind.FENCE, fence)
        flight.fly(2.0)
        go_to(flight, (*KEPT_FREE[2], 0.6))
        flight.fly(3.0)
        ms = 1e3 * np.array(flight.control_s[since:])
        kept = float(np.percentile(ms, 99)) <= P99_MS and float(ms.max()) <= MAX_MS
        return Measured(text=f"control {flight.figures(flight.control_s, since)} of CPU per tick", kept=kept)


def _long_check(waypoints: int) -> Measured:
    with piloted("open-water") as flight:
        plan = crowded_plan(flight.origin(), OCTAGONS, waypoints, seed=1)
        flight.fly(3.0)
        since, begin_us = len(flight.step_s), flight.t_us
        for kind in (PlanKind.FENCE, PlanKind.MISSION):
            flight.upload(kind, plan.items(kind))
        spent_s = (flight.t_us - begin_us) * 1e-6
        flight.fly(0.5)
        text = f"CPU of a tick: {flight.figures(flight.step_s, since)}; taken after {spent_s:.1f} s of vehicle time"
        return Measured(text=text, kept=1e3 * max(flight.step_s[since:]) <= MAX_MS)


def _drawn() -> Measured:
    rng = random.Random(2024)
    faults: list[Mapping[str, Any]] = [drawn_fault(rng) for _ in range(DRAWN)]
    gaps_s = [rng.choice((0.0, 1.0, 3.0, 5.0)) for _ in faults]
    flown = [
        fly_fault(FaultFlight(faults=(fault,), gap_s=gap_s, seed=100 + k))
        for k, (fault, gap_s) in enumerate(zip(faults, gaps_s, strict=True))
    ]
    kept, inside = sum(result.kept for result in flown), min(result.inside for result in flown)
    contacts = sum(result.contacts for result in flown)
    text = f"{kept} of {DRAWN} kept; worst: inside 3 sigma {100.0 * inside:.0f} %, {contacts} contacts"
    return Measured(text=text, kept=kept == DRAWN)


def _fuzzed() -> Measured:
    result = run_fuzz(FUZZED, seed=3)
    grown_mb = result.rss_end_mb - result.rss_start_mb
    text = f"{result.messages} messages, {len(result.failures)} exceptions or broken rules, {grown_mb:+.0f} MB"
    return Measured(text=text, kept=not result.failures and grown_mb < 50.0)


def _measured(part: str, name: str, before: str, promise: str, measure: Callable[[], Measured]) -> Finding:
    return Finding(part=part, name=name, before=before, promise=promise, measure=measure)


_CONTROL = f"control p99 <= {P99_MS:g} ms, none above {MAX_MS:g} ms of CPU per tick"
_UPLOADED = "uploaded in flight, then a go-to behind one"

FIGURES: tuple[Finding, ...] = (
    _measured(
        "plans",
        f"a fence of {OCTAGONS} octagons and a mission of 4 items are uploaded",
        "loop stopped for 2.3 s of CPU, longest tick 4 s",
        f"no tick above {MAX_MS:g} ms of CPU",
        lambda: _long_check(4),
    ),
    _measured(
        "plans",
        f"a fence of {OCTAGONS} octagons and a mission of 500 items are uploaded",
        "0.6 s of CPU more in another tick",
        f"no tick above {MAX_MS:g} ms of CPU",
        lambda: _long_check(500),
    ),
    _measured(
        "beside",
        f"{OCTAGONS} octagons {_UPLOADED}; plain route",
        "the route is searched in the tick: 103 ms (378 ms the first time) of CPU",
        _CONTROL,
        lambda: _crowded_flight(0),
    ),
    _measured(
        "beside",
        f"{OCTAGONS} cylinders {_UPLOADED}; plain route",
        "the route is searched in the tick: 99 ms of CPU",
        _CONTROL,
        lambda: _crowded_flight(0, round_ones=True),
    ),
    _measured(
        "beside",
        f"{OCTAGONS} octagons {_UPLOADED}; least energy",
        "the tick waits for the plan, 2 to 5 s without a heartbeat at speed 0",
        _CONTROL,
        lambda: _crowded_flight(1),
    ),
    _measured(
        "estimator",
        "drawn faults of accelerometer, gyro and attitude, alone and in gaps of 1 to 5 s",
        "not measured",
        "inside 3 sigma in 95 %, no contact, health says so within 1 s",
        _drawn,
    ),
    _measured(
        "guard",
        "hostile messages and wild samples (short form; the long one is bench fuzz)",
        "process ended (battery of 1e308 V: OverflowError)",
        "no exception, rules hold, bounded memory",
        _fuzzed,
    ),
)
