"""How good the attitude from raw sensors is: recorded trials and made-up motions, each beside a filter of fixed gain.

The parameters of either filter are chosen on all groups but one (a trial, or a family of motions with some seeds) and
tried on that one: what a table shows of a recorded trial was never seen by the choice. The made-up motions of the
table have seeds that no choice sees.
"""

import math
import multiprocessing
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import lru_cache, partial
from itertools import product
from pathlib import Path
from typing import Protocol

import numpy as np

from autopilot.core.frames import FloatArray
from autopilot.core.own_python import safe_path
from autopilot.core.samples import ImuSample
from autopilot.estimator.attitude import DEFAULT_TUNING, AttitudeFilter, AttitudeTuning
from tests.bench.attitude_fixed import FixedGainFilter, FixedGains
from tests.bench.attitude_motions import DURATION_S, FAMILIES, Recording, record, rotations
from tests.bench.attitude_recordings import FOLDER, load_trials
from tests.bench.estimator_figures import pooled_rms, rms

SEEDS, SHORT_SEEDS = range(101, 111), range(101, 103)
"""Of the table's motions."""
CHOICE_SEEDS, CHOICE_S = range(1, 7), 60.0
"""Of those that parameters are chosen by, and how long they are."""
WORKERS = 2
WORSE_SHARE, INCLINATION_BAR_DEG = 1.1, 1.0
HEADING_WEIGHT = 1.0 / 3.0
"""Of a heading error beside one of inclination, when parameters are chosen."""

TUNINGS = tuple(
    AttitudeTuning(tilt_s=tilt_s, heading_s=heading_s, heading_noise_rad_s=math.radians(noise))
    for tilt_s, heading_s, noise in product((2.0, 3.0, 4.5), (6.0, 9.0, 13.0), (5.0, 10.0))
)
GAINS = tuple(
    FixedGains(tilt=tilt, heading=heading, bias=bias)
    for tilt, heading, bias in product((0.2, 0.4, 0.8), (0.05, 0.1, 0.2), (0.0, 0.002))
)
"""What there is to choose from."""

PUBLISHED = {
    "02 slow rotation": (0.40, 1.30, 1.36),
    "10 slow translation": (0.29, 1.76, 1.79),
    "15 fast translation": (0.42, 2.12, 2.16),
    "30 stationary magnet": (1.51, 0.97, 1.80),
    "33 attached magnet": (0.75, 3.68, 3.76),
}
"""Inclination, heading, total [deg, rms] of the published VQF (PyPI vqf 2.1.2, its defaults) on the same 95 Hz."""


class Attitude(Protocol):
    def step(self, sample: ImuSample) -> FloatArray:
        """Take in a sample; (3,) roll, pitch, yaw."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class AttitudeErrors:
    """Root mean squares [deg], as the authors of BROAD define them: of the angle between the verticals, of the turn
    about the vertical, of the whole rotation."""

    inclination: float
    heading: float
    total: float


@dataclass(frozen=True, slots=True, kw_only=True)
class AttitudeRow:
    """One trial, or one family of motions over its seeds; deg, rms."""

    trial: str
    inclination: float
    heading: float
    total: float
    fixed_inclination: float
    """Of the filter with fixed gains."""
    fixed_heading: float
    fixed_total: float
    vqf_inclination: float | None
    """Published filter, None = not measured."""
    vqf_heading: float | None
    vqf_total: float | None
    chosen: str
    """The parameters of the filter, and of the one with fixed gains."""
    missed: str
    """The bars that are not kept, empty if all are."""


def errors_of(recording: Recording, attitude: Attitude) -> AttitudeErrors:
    """Run a filter over a recording."""
    estimates = []
    for n in range(len(recording.rate_frd_rad_s)):
        place, rest = divmod(n, recording.mag_every)
        sample = ImuSample(
            t_us=round((n + 1) * 1e6 / recording.rate_hz),
            rate_frd_rad_s=recording.rate_frd_rad_s[n],
            accel_frd_m_s2=recording.accel_frd_m_s2[n],
            mag_frd=recording.mag_frd[place] if rest == 0 and place < len(recording.mag_frd) else None,
        )
        rpy_rad = attitude.step(sample)
        if n % recording.true_every == 0:
            estimates.append(rpy_rad)
    keep = recording.counts
    off = recording.true[keep] @ rotations(np.array(estimates[: len(keep)]))[keep].transpose(0, 2, 1)
    return AttitudeErrors(
        inclination=_rms_deg(np.arccos(np.clip(off[:, 2, 2], -1.0, 1.0))),
        heading=_rms_deg(np.arctan2(off[:, 1, 0] - off[:, 0, 1], off[:, 0, 0] + off[:, 1, 1])),
        total=_rms_deg(np.arccos(np.clip(0.5 * (np.trace(off, axis1=1, axis2=2) - 1.0), -1.0, 1.0))),
    )


def bench_attitude(
    short: bool, folder: Path = FOLDER, seeds: Sequence[int] | None = None, workers: int = WORKERS
) -> list[AttitudeRow]:
    """The table: trials found in ``folder`` first. ``short``: with the autopilot's own parameters, none are chosen."""
    groups = [*(recording.name for recording in load_trials(folder)), *FAMILIES]
    seeds = tuple(seeds or (SHORT_SEEDS if short else SEEDS))
    spawn = multiprocessing.get_context("spawn")
    with safe_path(), ProcessPoolExecutor(max_workers=workers, mp_context=spawn) as pool:
        tunings, gains = [DEFAULT_TUNING] * len(groups), [FixedGains()] * len(groups)
        if not short:
            costs = list(pool.map(partial(_costs, folder), [*TUNINGS, *GAINS]))
            tunings = [TUNINGS[best_without(group, costs[: len(TUNINGS)])] for group in groups]
            gains = [GAINS[best_without(group, costs[len(TUNINGS) :])] for group in groups]
        return list(pool.map(partial(_row, folder, seeds), groups, tunings, gains))


def best_without(group: str, costs: Sequence[Mapping[str, float]]) -> int:
    """Which parameters cost least on all the other groups."""
    means = [np.mean([cost for name, cost in each.items() if name != group]) for each in costs]
    return int(np.argmin(means))


def median_inclination(rows: Sequence[AttitudeRow]) -> float:
    """deg"""
    return float(np.median([row.inclination for row in rows]))


def _made(parameters: AttitudeTuning | FixedGains) -> Attitude:
    return AttitudeFilter(parameters) if isinstance(parameters, AttitudeTuning) else FixedGainFilter(parameters)


def _costs(folder: Path, parameters: AttitudeTuning | FixedGains) -> dict[str, float]:
    """What these parameters cost in every group."""
    return {
        group: found.inclination + HEADING_WEIGHT * found.heading
        for group in (*(recording.name for recording in load_trials(folder)), *FAMILIES)
        for found in (_group_errors(folder, group, tuple(CHOICE_SEEDS), CHOICE_S, parameters),)
    }


def _group_errors(
    folder: Path, group: str, seeds: tuple[int, ...], duration_s: float, parameters: AttitudeTuning | FixedGains
) -> AttitudeErrors:
    recordings = [trial for trial in load_trials(folder) if trial.name == group]
    found = [
        errors_of(each, _made(parameters))
        for each in recordings or (_recorded(group, seed, duration_s) for seed in seeds)
    ]
    return AttitudeErrors(
        inclination=pooled_rms([each.inclination for each in found]),
        heading=pooled_rms([each.heading for each in found]),
        total=pooled_rms([each.total for each in found]),
    )


@lru_cache(maxsize=len(FAMILIES) * len(CHOICE_SEEDS))
def _recorded(family: str, seed: int, duration_s: float) -> Recording:
    return record(family, seed, duration_s)


def _row(folder: Path, seeds: tuple[int, ...], group: str, tuning: AttitudeTuning, gains: FixedGains) -> AttitudeRow:
    ours = _group_errors(folder, group, seeds, DURATION_S, tuning)
    fixed = _group_errors(folder, group, seeds, DURATION_S, gains)
    vqf = PUBLISHED.get(group, (None, None, None))
    too_much = [
        name
        for name, mine, theirs in (
            ("inclination", ours.inclination, fixed.inclination),
            ("heading", ours.heading, fixed.heading),
            ("total", ours.total, fixed.total),
        )
        if mine > WORSE_SHARE * theirs
    ]
    return AttitudeRow(
        trial=group if group not in FAMILIES else f"{group}, {len(seeds)} seeds",
        inclination=ours.inclination,
        heading=ours.heading,
        total=ours.total,
        fixed_inclination=fixed.inclination,
        fixed_heading=fixed.heading,
        fixed_total=fixed.total,
        vqf_inclination=vqf[0],
        vqf_heading=vqf[1],
        vqf_total=vqf[2],
        chosen=f"{_listed(tuning)} | {_listed(gains)}",
        missed=", ".join(too_much),
    )


def _listed(parameters: AttitudeTuning | FixedGains) -> str:
    if isinstance(parameters, FixedGains):
        return f"{parameters.tilt:g} {parameters.heading:g} {parameters.bias:g}"
    return f"{parameters.tilt_s:g} {parameters.heading_s:g} {math.degrees(parameters.heading_noise_rad_s):.3g}"


def _rms_deg(angles_rad: FloatArray) -> float:
    return math.degrees(rms(angles_rad))
