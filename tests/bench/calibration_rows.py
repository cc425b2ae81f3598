"""Rows of the estimator's benchmark with a camera that was calibrated wrongly (focal length off, stamps late), or not
at all.

One recorded flight of the paper's tour again, with pictures made by geometry (:mod:`tests.bench.laid_maps`) of a
floor that is as the map has it. The vehicle file that the estimator gets is wrong, or the pictures' stamps are.
"""

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from autopilot.core.frames import FloatArray
from autopilot.core.samples import PoseSample, Sample
from autopilot.core.vehicle import Vehicle
from tests.bench.calibrations import drawn, uncertain_map, with_camera
from tests.bench.estimator_figures import EstimatorBenchRow, Limit, mean, nees_band, row, whole
from tests.bench.laid_maps import Camera, OverFloor, Recording, over, record

XY_BAR_MM, Z_BAR_MM, YAW_BAR_DEG = 4.0, 3.0, 0.3
INSIDE = Limit(low=95.0)
FIGURE_OFF = 0.25
"""A figure that is told may be wrong by this share of it, or by this [%, ms]:"""
FIGURE_OFF_LEAST = 3.0
COLUMNS = (("horizontal", slice(0, 2)), ("vertical", slice(2, 3)), ("yaw", slice(3, 4)))


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    name: str
    focal: float = 0.0
    distortion: float = 0.0
    """Shares by which the vehicle file's focal length is too long, and its distortion too large."""
    late_s: float = 0.0
    """By which stamps are late; the pictures come so much later as well."""
    drawn: bool = False
    """Nobody has calibrated anything: file, map and stamps are off by what they state, each seed otherwise."""

    @property
    def expected(self) -> tuple[str, float] | None:
        """Beginning of what has to be told, and its figure."""
        if self.focal:
            return "Focal length ", 100.0 * abs(self.focal)
        if self.distortion:
            return "Focal length or distortion ", 50.0 * abs(self.distortion)
        return ("Picture stamps ", 1e3 * abs(self.late_s)) if self.late_s else None

    def names(self, text: str) -> bool:
        """Whether a remark tells it."""
        if self.expected is None or not text.startswith(self.expected[0]):
            return False
        told, true = float(text.removeprefix(self.expected[0]).split()[0]), self.expected[1]
        return abs(told - true) <= max(FIGURE_OFF * true, FIGURE_OFF_LEAST if self.late_s else 0.0)


CASES = (
    Case(name="as it is"),
    Case(name="not calibrated", drawn=True),
    *(Case(name=f"focal length {error:+.0%}", focal=error) for error in (0.03, -0.02, 0.05)),
    *(Case(name=f"distortion {error:+.0%}", distortion=error) for error in (0.2, -0.2)),
    *(Case(name=f"stamps {ms} ms late", late_s=1e-3 * ms) for ms in (10, 30, 60, 100)),
)


def bench_calibration(seeds: Sequence[int], pool: Executor, figures: str | None = None) -> list[EstimatorBenchRow]:
    """One recorded flight, and for each seed pictures of their own noise; ``figures``: folder for a figure."""
    recording = pool.submit(record, seeds[0]).result()
    runs = list(pool.map(partial(fly_cases, recording), seeds))
    if figures is not None:
        from tests.bench.estimator_plots import draw_honesty

        drawn_case = next(k for k, case in enumerate(CASES) if case.drawn)
        draw_honesty([run[drawn_case] for run in runs], figures)
    return calibration_rows(runs)


def fly_cases(recording: Recording, seed: int, cases: Sequence[Case] = CASES) -> tuple[OverFloor, ...]:
    return tuple(fly_case(recording, case, seed) for case in cases)


def fly_case(recording: Recording, case: Case, seed: int) -> OverFloor:
    camera = Camera(recording)
    if case.drawn:
        given = drawn(uncertain_map(recording.plan), np.random.default_rng((seed, 8)))
        vehicle, known, late_us = given.vehicle, given.markers, given.late_us
    else:
        vehicle, known, late_us = _miscalibrated(recording.vehicle, case), recording.plan, round(1e6 * case.late_s)
    camera.poses = {t_us + late_us: pose for t_us, pose in camera.poses.items()}
    wrong = replace(recording, vehicle=vehicle, ticks=_later(recording.ticks, late_us))
    return over(wrong, camera, recording.plan, known, seed)


def _miscalibrated(vehicle: Vehicle, case: Case) -> Vehicle:
    """What is wrong is stated to be as uncertain as it is off."""
    eye = vehicle.eye
    return with_camera(
        vehicle,
        focal_px=tuple((1.0 + case.focal) * f for f in eye.focal_px),
        distortion=tuple((1.0 + case.distortion) * k for k in eye.distortion),
        focal_sigma=abs(case.focal),
        distortion_sigma=abs(case.distortion),
        time_offset_sigma_s=abs(case.late_s),
    )


def calibration_rows(runs: Sequence[Sequence[OverFloor]], cases: Sequence[Case] = CASES) -> list[EstimatorBenchRow]:
    """The table of ``runs``: per seed one for each case."""
    rows, count = [], len(runs)
    for case, flown in zip(cases, zip(*runs, strict=True), strict=True):
        yaw_deg = [np.degrees(float(np.sqrt((run.error[:, 3] ** 2).mean()))) for run in flown]
        z_mm = [1e3 * float(np.sqrt((run.error[:, 2] ** 2).mean())) for run in flown]
        told = [text for run in flown for text in run.remarks]
        true = sum(map(case.names, told))
        name = f"{case.name}: "
        bars = [None if case.drawn else Limit(high=limit) for limit in (XY_BAR_MM, Z_BAR_MM, YAW_BAR_DEG)]
        rows += [
            row(f"{name}position, horizontal", [run.xy_mm() for run in flown], "mm", bar=bars[0]),
            row(f"{name}position, vertical", z_mm, "mm", bar=bars[1]),
            row(f"{name}yaw", yaw_deg, "deg", bar=bars[2]),
        ]
        for what, columns in COLUMNS:  # surer than it may be is wrong, less sure than it could be is not
            values = [run.nees(columns) for run in flown]
            states = columns.stop - columns.start
            bar = (
                Limit(low=0.5 * states, high=2.0 * states) if case.drawn else Limit(high=nees_band(states, count).high)
            )
            rows.append(row(f"{name}NEES, {what}", values, "", bar=bar, pool=mean))
        if case.drawn:
            rows.append(row(f"{name}within 3 sigma", [run.inside_pct() for run in flown], "%", bar=INSIDE, pool=mean))
            continue
        rows.append(whole(f"{name}resets", sum(run.resets for run in flown), "", count, Limit(high=0.0)))
        if case.expected is not None:
            rows.append(whole(f"{name}named with its figure, of {count}", true, "", count, Limit(low=count)))
        rows.append(whole(f"{name}named wrongly", len(told) - true, "", count, Limit(high=0.0)))
    return rows


def _later(
    ticks: Sequence[tuple[int, tuple[Sample, ...], FloatArray]], late_us: int
) -> list[tuple[int, tuple[Sample, ...], FloatArray]]:
    """Ticks whose poses come, and are stamped, so much later."""
    result, held = [], list[tuple[int, Sample]]()
    for t_us, samples, thrust_n in ticks:
        held += [(t_us + late_us, replace(s, t_us=s.t_us + late_us)) for s in samples if isinstance(s, PoseSample)]
        others = [s for s in samples if not isinstance(s, PoseSample)]
        now = [sample for due_us, sample in held if due_us <= t_us]
        held = [(due_us, sample) for due_us, sample in held if due_us > t_us]
        result.append((t_us, (*others, *now), thrust_n))
    return result
