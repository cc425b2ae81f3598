"""A study of pictures that look right and are not of here and now: every kind, for 1 to 10 s, over seeds.

A flight is one of the whole service (:mod:`tests.bench.sensor_faults`). When the fault begins, how long it lasts
and how large it is follows from its kind and the seed alone. Promised: nothing is touched, and an estimate outside of
3 sigma is not called good for longer than half a second.
"""

import random
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from tests.bench.sensor_faults import FaultFlight, FaultResult, fly_fault

KINDS = ("near_frozen", "repeated", "delayed", "mirrored", "half_frozen", "elsewhere", "reflection")
BEGIN_S, LASTS_S, AFTER_S = (8.0, 16.0), (1.0, 10.0), 6.0
"""When faults begin and how long they last, and how long the flight goes on."""
DEADLINE_S = 0.5
"""So long an estimate outside of 3 sigma may be called good."""
SEEDS, SHORT_SEEDS = range(1, 21), range(1, 3)
RATE_HZ = 15.0
"""Pictures per second of flights with rendered pictures: half of what the camera gives, and of the time it takes."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PictureFlight:
    kind: str
    seed: int
    sensors: str
    at_s: float
    lasts_s: float
    contacts: int
    outside_s: float
    """Longest time in a row outside 3 sigma and called good."""
    worst_m: float
    claim_m: float
    """3 sigma at that moment."""
    back_s: float | None
    """From the end of the fault to the first fix that is used."""
    resets: int
    good_pct: float
    blamed: bool
    """A sound thruster, or a sound inertial sensor."""
    kept: bool
    texts: tuple[str, ...]


def drawn(kind: str, seed: int) -> tuple[Mapping[str, Any], float, float]:
    """The ``[[fault]]`` table without its times, when it begins and how long it lasts [s]."""
    rng = random.Random(f"{kind} {seed}")
    at_s, lasts_s = round(rng.uniform(*BEGIN_S), 2), round(rng.uniform(*LASTS_S), 2)
    sizes: dict[str, dict[str, Any]] = {
        "near_frozen": {"noise_levels": round(rng.uniform(0.5, 3.0), 1)},
        "repeated": {"pictures": rng.randrange(2, 40)},
        "delayed": {"delay_s": round(rng.uniform(0.1, 3.0), 2)},
        "mirrored": {"across": rng.choice(("columns", "rows", "both"))},
        "half_frozen": {"part": rng.choice(("top", "bottom", "left", "right")), "share": rng.choice((0.3, 0.5, 0.7))},
        "elsewhere": {
            "offset_m": [round(rng.uniform(-1.0, 1.0), 2), round(rng.uniform(-0.6, 0.6), 2), 0.0],
            "yaw_rad": round(rng.uniform(-3.0, 3.0), 2),
            "follows": rng.random() < 0.5,
        },
        "reflection": {"strength": round(rng.uniform(0.2, 0.8), 2)},
    }
    return {"kind": f"camera_{kind}", **sizes[kind]}, at_s, lasts_s


def fly_pictures(kind: str, seed: int, sensors: str) -> PictureFlight:
    fault, at_s, lasts_s = drawn(kind, seed)
    changes = {"sensors": {"camera": {"rate_hz": RATE_HZ}}} if sensors == "camera" else None
    flight = FaultFlight(
        faults=(fault,),
        at_s=at_s,
        lasts_s=lasts_s,
        seed=seed,
        sensors=sensors,
        changes=changes,
        duration_s=at_s + lasts_s + AFTER_S,
    )
    return _of(kind, flight, fly_fault(flight))


def _of(kind: str, flight: FaultFlight, result: FaultResult) -> PictureFlight:
    blamed = result.thrusters_blamed or any(text.startswith(("Accelerometer", "Gyro")) for text in result.texts)
    return PictureFlight(
        kind=kind,
        seed=flight.seed,
        sensors=flight.sensors,
        at_s=flight.at_s,
        lasts_s=flight.lasts_s or 0.0,
        contacts=result.contacts,
        outside_s=round(result.outside_s, 2),
        worst_m=round(result.worst_m, 3),
        claim_m=round(result.worst_claim_m, 3),
        back_s=None if result.back_s is None else round(result.back_s, 2),
        resets=result.resets,
        good_pct=round(100.0 * result.good, 1),
        blamed=blamed,
        kept=result.contacts == 0 and result.outside_s <= DEADLINE_S,
        texts=result.texts,
    )


def bench_picture_faults(
    kinds: Sequence[str], seeds: Sequence[int], sensors: str, show: Callable[[str], None] = lambda _: None
) -> Iterator[PictureFlight]:
    """Seed by seed, so that a study that is stopped has something of every kind."""
    for seed in seeds:
        for kind in kinds:
            show(f"{kind}, seed {seed}, {sensors}")
            yield fly_pictures(kind, seed, sensors)
