"""The estimator: inertial sensors, lenses and markers that are wrong and do not say so."""

import random
from collections.abc import Mapping
from typing import Any

from tests.bench.fault_campaign import FAULTS, drawn_fault
from tests.bench.faults.finding import Finding, Measured
from tests.bench.sensor_faults import FaultFlight, FaultResult, fly_fault

SEED = 4
DRAWN = 8


def _flown(name: str, gap_s: float, *, seed: int = SEED) -> FaultResult:
    return fly_fault(FaultFlight(faults=(FAULTS[name],), gap_s=gap_s, seed=seed))


def _text(result: FaultResult) -> str:
    blamed = ", sound thrusters or commands blamed" if result.thrusters_blamed else ""
    return (
        f"off by {result.worst_m:.2f} m, inside 3 sigma {100.0 * result.inside:.0f} %,"
        f" silent {result.unflagged_s:.1f} s, {result.contacts} contacts{blamed}"
    )


def _gap_with_offset() -> Measured:
    result = _flown("accelerometer +1 m/s2 forward", 3.0)
    return Measured(text=_text(result), kept=result.kept)


def _gap_with_large_offset() -> Measured:
    result = _flown("accelerometer +10 m/s2 forward", 3.0)
    return Measured(text=_text(result), kept=result.kept)


def _detectors() -> Measured:
    results = [_flown("accelerometer -2 m/s2 sideways", gap_s) for gap_s in (0.0, 3.0)]
    blamed = sum(result.thrusters_blamed for result in results)
    return Measured(text=f"{blamed} of {len(results)} flights blame a thruster or the commands", kept=blamed == 0)


def _markers_moved() -> Measured:
    result = _flown("markers moved by 0.3 m", 0.0)
    told = any(text.startswith("Markers disagree") for text in result.texts)
    kept = told and result.unflagged_s <= 1.0 and result.contacts == 0
    return Measured(text=f"told: {'yes' if told else 'no'}, silent {result.unflagged_s:.1f} s", kept=kept)


def _lens() -> Measured:
    result = _flown("lens 0.9", 0.0)
    return Measured(text=_text(result), kept=result.kept)


def _drawn() -> Measured:
    rng = random.Random(2024)
    faults: list[Mapping[str, Any]] = [drawn_fault(rng) for _ in range(DRAWN)]
    gaps_s = [rng.choice((0.0, 1.0, 3.0, 5.0)) for _ in faults]
    flown = [
        fly_fault(FaultFlight(faults=(fault,), gap_s=gap_s, seed=100 + k))
        for k, (fault, gap_s) in enumerate(zip(faults, gaps_s, strict=True))
    ]
    kept = sum(result.kept for result in flown)
    worst = min(result.inside for result in flown)
    return Measured(
        text=f"{kept} of {DRAWN} kept; worst: inside 3 sigma {100.0 * worst:.0f} %,"
        f" {sum(result.contacts for result in flown)} contacts",
        kept=kept == DRAWN,
    )


_HONEST = "inside 3 sigma in 95 %, no contact, health says so within 1 s"

FINDINGS: tuple[Finding, ...] = (
    Finding(
        part="estimator",
        name="accelerometer off by 1 m/s2 in a marker gap of 3 s",
        before="4.9 m off with 0.18 m claimed, GOOD, 3 contacts",
        promise=_HONEST,
        measure=_gap_with_offset,
    ),
    Finding(
        part="estimator",
        name="accelerometer off by 10 m/s2 in a marker gap of 3 s",
        before="the process ended",
        promise=_HONEST,
        measure=_gap_with_large_offset,
    ),
    Finding(
        part="estimator",
        name="detectors of lost thrusters and late commands with a wrong accelerometer",
        before="thrusters declared dead, commands late",
        promise="they wait while the estimate is in doubt",
        measure=_detectors,
    ),
    Finding(
        part="estimator",
        name="all markers moved by 0.3 m in flight",
        before="not measured",
        promise="told, not called good within 1 s",
        measure=_markers_moved,
    ),
    Finding(
        part="estimator",
        name="focal length 10 % off in flight",
        before="3 %: height 28.5 mm off, NEES 37,600, nothing told",
        promise=_HONEST,
        measure=_lens,
    ),
    Finding(
        part="estimator",
        name="drawn faults of accelerometer, gyro and attitude, alone and in gaps of 1 to 5 s",
        before="not measured",
        promise=_HONEST,
        measure=_drawn,
    ),
)
