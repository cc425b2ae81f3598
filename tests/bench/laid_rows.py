"""Rows of the estimator's benchmark over floors that a person has laid (:mod:`tests.bench.laid_maps`)."""

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial

import numpy as np

from tests.bench.estimator_figures import EstimatorBenchRow, Limit, mean, nees_band, row, whole
from tests.bench.laid_maps import (
    Camera,
    OverFloor,
    Recording,
    faulty_floor,
    laid_floor,
    over,
    plan_with_errors,
    record,
    sigma_of,
)

LEVELS_M = ((0.0014, 0.004), (0.0028, 0.006), (0.0069, 0.010))
"""How far sheets put markers off, rms, and the bar of the horizontal error."""
REFINED_BAR_M = 0.002
SPOILT_RMS_M = PRINTED_RMS_M = 0.0028
AGAIN = 1000
"""Added to the seed for the flight with the refined map: the same floor in new noise."""
XY, Z, YAW = slice(0, 2), slice(2, 3), slice(3, 4)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LaidRun:
    rigid: tuple[tuple[OverFloor, OverFloor], ...]
    """Per level: with the plan, of whose sheets nothing is said, and with what had been made of it by the end."""
    printed: OverFloor
    """Sheets as uncertain as the map says, waves of the floor and of the print among it."""
    missing: tuple[str, ...]
    """What was wrong and was not named,"""
    false: tuple[str, ...]
    """and what was said besides."""


def bench_laid(seeds: Sequence[int], pool: Executor) -> list[EstimatorBenchRow]:
    """One recorded flight, and for each seed floors of its own."""
    recording = pool.submit(record, seeds[0]).result()
    return laid_rows(list(pool.map(partial(fly_laid, recording), seeds)))


def fly_laid(recording: Recording, seed: int) -> LaidRun:
    camera = Camera(recording)
    plan, without_errors = recording.plan, plan_with_errors(recording.plan, None)
    rigid = []
    for rms_m, _ in LEVELS_M:
        floor = laid_floor(plan, np.random.default_rng((seed, 5)), sigma_of(rms_m))
        first = over(recording, camera, floor, without_errors, seed)
        again = over(recording, camera, floor, first.refined, seed + AGAIN)
        rigid.append((first, again))
    sigma = sigma_of(PRINTED_RMS_M)
    floor = laid_floor(plan, np.random.default_rng((seed, 6)), sigma, printed=True)
    printed = over(recording, camera, floor, plan_with_errors(plan, sigma), seed)
    floor = laid_floor(plan, np.random.default_rng((seed, 7)), sigma_of(SPOILT_RMS_M))
    faulty = faulty_floor(recording, camera, plan, floor, seed)
    remarks = over(recording, camera, faulty.floor, without_errors, seed).remarks
    return LaidRun(
        rigid=tuple(rigid),
        printed=printed,
        missing=tuple(
            what for what, texts in faulty.expected.items() if not any(text.startswith(texts) for text in remarks)
        ),
        false=tuple(text for text in remarks if not text.startswith(faulty.true)),
    )


def laid_rows(runs: Sequence[LaidRun]) -> list[EstimatorBenchRow]:
    rows = []
    count = len(runs)
    for k, (rms_m, bar_m) in enumerate(LEVELS_M):
        name = f"sheets {1e3 * rms_m:.1f} mm off: "
        first, again = ([run.rigid[k][n] for run in runs] for n in (0, 1))
        rows += [
            row(f"{name}position, horizontal", [run.xy_mm() for run in first], "mm", bar=Limit(high=1e3 * bar_m)),
            row(f"{name}the same at worst", [run.worst_mm() for run in first], "mm", pool=max),
            _nees(f"{name}NEES, horizontal", first, XY),
            whole(f"{name}resets", sum(run.resets for run in first), "", count, Limit(high=0.0)),
            row(
                f"{name}position with the refined map",
                [run.xy_mm() for run in again],
                "mm",
                bar=Limit(high=1e3 * REFINED_BAR_M),
            ),
            row(f"{name}the same but for one shift and turn", [run.form_mm() for run in again], "mm"),
        ]
    name = f"sheets {1e3 * PRINTED_RMS_M:.1f} mm, print 0.1 mm, floor 1 mm off, as told: "
    printed = [run.printed for run in runs]
    wrong = 3 * count
    named = wrong - sum(len(run.missing) for run in runs)
    figure = "marker moved 3 cm, sheet turned 5 deg, ids swapped"
    return [
        *rows,
        row(f"{name}position, horizontal", [run.xy_mm() for run in printed], "mm", bar=Limit(high=6.0)),
        _nees(f"{name}NEES, horizontal", printed, XY),
        _nees(f"{name}NEES, vertical", printed, Z),
        _nees(f"{name}NEES, yaw", printed, YAW),
        whole(f"{figure}: named, of {wrong}", named, "", count, Limit(low=wrong)),
        whole(f"{figure}: named wrongly", sum(len(run.false) for run in runs), "", count, Limit(high=0.0)),
    ]


def _nees(figure: str, runs: Sequence[OverFloor], columns: slice) -> EstimatorBenchRow:
    """Within its 95 % band, each flight being one draw of its floor."""
    values = [run.nees(columns) for run in runs]
    return row(figure, values, "", bar=nees_band(columns.stop - columns.start, len(runs)), pool=mean)
