"""How good the estimator is, in flights of the whole vehicle: each figure beside its bar and its goal.

The bars are what the project asks for; the goals are what a prototype of the filter reached on simpler data. All errors
are against the plant's truth. Rows with neither are there for comparison.
"""

import multiprocessing
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import Any

import numpy as np

from autopilot.core.own_python import safe_path
from tests.bench.calibration_rows import bench_calibration
from tests.bench.estimator_figures import (
    EstimatorBenchRow,
    Flights,
    Limit,
    Watched,
    by_name,
    current_rms,
    drift_m,
    error_rms,
    far_fixes,
    far_fixes_used,
    growth,
    inside_fraction,
    mean,
    mean_nees,
    mean_nis,
    nees_band,
    nis_fraction,
    recovery_s,
    row,
    whiteness,
    whole,
)
from tests.bench.estimator_flights import (
    NAIVE,
    NO_MODEL,
    SAME,
    SHIFT_M,
    SHIFTED,
    SHIFTED_S,
    FlightSpec,
    fly,
)
from tests.bench.laid_rows import bench_laid

SEEDS, SHORT_SEEDS = range(1, 21), range(1, 4)
CAMERA_SEEDS, SHORT_CAMERA_SEEDS = range(1, 4), range(1, 2)
"""Flights with rendered pictures are several times slower."""
WORKERS = 2

STEADY_S = (6.0, 15.0)
"""The vehicle has started and turned; every flight lasts at least so long."""
SETTLED_S = (20.0, 28.0)
"""After 20 s the current has to be known."""
BEFORE_GAPS_S = (20.0, 26.0)
JET_GAPS_S = ((14.0, 15.0), (18.0, 20.0), (23.0, 28.0))
UNIFORM_GAPS_S = ((26.0, 27.0), (30.0, 32.0), (35.0, 40.0))
DRAG_GAPS_S = ((26.0, 31.0),)
AFTER_GAPS_S = 0.1

UNIFORM = {"kind": "uniform", "velocity_m_s": [0.12, -0.06, 0.0]}
LESS_DRAG = {"mismatch": {"linear_drag": 0.8, "drag": 0.8}}
"""20 % less than the vehicle file says."""
HAZE = {"camera": {"turbidity_1_m": 1.0}}
"""As in a tank that has not been filtered for days."""
MM, DEG = 1e3, 180.0 / np.pi
XY, Z, YAW, VELOCITY = slice(0, 2), slice(2, 3), slice(3, 4), slice(4, 7)

LAID, CALIBRATION, COST = "laid", "calibration", "cost"

Runs = Mapping[str, Sequence[Mapping[str, Watched]]]
"""Flight -> one entry per seed: estimator -> what it said."""


def _gapped(gaps_s: Sequence[tuple[float, float]], **changes: Any) -> tuple[dict[str, Any], float]:
    """Changes with pictures missing at these times, and a duration to just after the last gap."""
    faults = [{"kind": "camera_blackout", "at_s": start, "duration_s": end - start} for start, end in gaps_s]
    return {"fault": faults, **changes}, gaps_s[-1][1] + AFTER_GAPS_S


def _pose(**settings: float) -> dict[str, Any]:
    return {"sensors": {"pose": settings}}


PLAN: dict[str, tuple[dict[str, Any], float, str, tuple[str, ...]]] = {
    "steady": ({}, SETTLED_S[1], "pose", (SAME, SHIFTED)),
    "camera": ({}, STEADY_S[1], "camera", (SAME,)),
    "camera haze": (HAZE, STEADY_S[1], "camera", (SAME,)),
    "camera gaps": (*_gapped(JET_GAPS_S), "camera", (SAME,)),
    "prompt": (_pose(latency_s=0.0, latency_jitter_s=0.0), STEADY_S[1], "pose", (SAME,)),
    "late": (_pose(latency_s=0.06, latency_jitter_s=0.02), STEADY_S[1], "pose", (SAME, NAIVE)),
    "outliers 20": (_pose(outlier_probability=0.2), STEADY_S[1], "pose", (SAME,)),
    "outliers 30": (_pose(outlier_probability=0.3), STEADY_S[1], "pose", (SAME,)),
    "compass": ({"sensors": {"ahrs": {"yaw_field_rad": 10.0 / DEG}}}, STEADY_S[1], "pose", (SAME,)),
    "gaps": (*_gapped(JET_GAPS_S), "pose", (SAME,)),
    "gaps uniform": (*_gapped(UNIFORM_GAPS_S, current=UNIFORM), "pose", (SAME, NO_MODEL)),
    "gaps dvl": (*_gapped(JET_GAPS_S, sensors={"depth": {}, "dvl": {}}), "pose", (SAME,)),
    "gaps drag": (*_gapped(DRAG_GAPS_S, current=UNIFORM, vehicle=LESS_DRAG), "pose", (SAME,)),
}
"""Name -> what differs from the paper's tank, duration [s], sensors, estimators that watch."""


def bench_estimator(
    seeds: Sequence[int] = SEEDS,
    camera_seeds: Sequence[int] = CAMERA_SEEDS,
    workers: int = WORKERS,
    groups: Sequence[str] | None = None,
    figures: str | None = None,
) -> list[EstimatorBenchRow]:
    """Fly everything with these seeds (what has rendered pictures with the second ones), in so many processes, and
    judge it. ``groups``: only these of :data:`GROUPS`, and :data:`LAID`, :data:`CALIBRATION`; ``figures``: folder for
    the figure of :data:`CALIBRATION`."""
    wanted = [name for name in GROUPS if groups is None or name in groups]
    needed = {flight for name in wanted for flight in GROUPS[name][0]}
    specs = [spec for spec in flight_specs(seeds, camera_seeds) if spec.name in needed]
    spawn = multiprocessing.get_context("spawn")
    with safe_path(), ProcessPoolExecutor(max_workers=workers, mp_context=spawn) as pool:
        flown = list(pool.map(fly, specs))
        laid = bench_laid(seeds, pool) if groups is None or LAID in groups else []
        off = bench_calibration(seeds, pool, figures) if groups is None or CALIBRATION in groups else []
    runs: dict[str, list[Mapping[str, Watched]]] = {name: [] for name in needed}
    for spec, watched in zip(specs, flown, strict=True):
        runs[spec.name].append(watched)
    return [*judged(runs, wanted), *laid, *off]


def group_names() -> tuple[str, ...]:
    """Of all rows, as they are shown."""
    return (*GROUPS, LAID, CALIBRATION, COST)


def flight_specs(seeds: Sequence[int], camera_seeds: Sequence[int]) -> list[FlightSpec]:
    """All flights, the slowest first."""
    specs = [
        FlightSpec(name=name, changes=changes, duration_s=duration_s, seed=seed, sensors=sensors, watchers=watchers)
        for name, (changes, duration_s, sensors, watchers) in PLAN.items()
        for seed in (camera_seeds if sensors == "camera" else seeds)
    ]
    return sorted(specs, key=lambda spec: (spec.sensors != "camera", -spec.duration_s))


def judged(runs: Runs, groups: Sequence[str] | None = None) -> list[EstimatorBenchRow]:
    """The table, or some of its groups."""
    return [row for name, (_, rows) in GROUPS.items() if groups is None or name in groups for row in rows(runs)]


def _steady(prefix: str, runs: Flights) -> list[EstimatorBenchRow]:
    """Markers in view all the time."""

    def error(name: str, columns: slice, scale: float, unit: str, bar: float, goal: float) -> EstimatorBenchRow:
        values = [scale * error_rms(run, columns, STEADY_S) for run in runs]
        return row(f"{prefix}{name}", values, unit, bar=Limit(high=bar), goal=Limit(high=goal))

    def average(
        name: str, figure: Callable[[Watched, tuple[float, float]], float], unit: str, bar: Limit
    ) -> EstimatorBenchRow:
        return row(f"{prefix}{name}", [figure(run, STEADY_S) for run in runs], unit, bar=bar, pool=mean)

    nees = [mean_nees(run, STEADY_S) for run in runs]
    return [
        error("position, horizontal", XY, MM, "mm", 6.0, 3.0),
        error("position, vertical", Z, MM, "mm", 3.0, 1.0),
        error("yaw", YAW, DEG, "deg", 0.3, 0.1),
        error("velocity over ground", VELOCITY, MM, "mm/s", 20.0, 12.0),
        row(
            f"{prefix}NEES of these 7 states",
            nees,
            "",
            bar=Limit(low=3.0, high=9.0),
            goal=nees_band(7, len(runs)),
            pool=mean,
        ),
        average("NIS of fixes, 4 components", mean_nis, "", Limit(low=2.0, high=5.0)),
        average("NIS beyond the 95 % point", nis_fraction, "%", Limit(high=10.0)),
        average("correlation of residuals", whiteness, "", Limit(high=0.2)),
    ]


def _currents(runs: Runs) -> list[EstimatorBenchRow]:
    """Horizontal current, with the tether in tow that the model does not know."""
    cases = (
        ("current, uniform", "gaps uniform", BEFORE_GAPS_S, 20.0),
        ("current, jet", "steady", SETTLED_S, 20.0),
        ("current, uniform, 20 % less drag", "gaps drag", BEFORE_GAPS_S, 60.0),
    )
    return [
        row(
            figure,
            [MM * current_rms(run, span_s) for run in by_name(runs[flight], SAME)],
            "mm/s",
            bar=Limit(high=bar),
        )
        for figure, flight, span_s, bar in cases
    ]


def _gaps(runs: Runs) -> list[EstimatorBenchRow]:
    """Horizontal drift at the end of gaps without pictures or laser."""

    def drift(figure: str, runs: Flights, end_s: float, bar: float | None, goal: float | None) -> EstimatorBenchRow:
        values = [MM * drift_m(run, end_s) for run in runs]
        bar_mm, goal_mm = (None if limit is None else Limit(high=limit) for limit in (bar, goal))
        return row(figure, values, "mm", bar=bar_mm, goal=goal_mm)

    rows = []
    cases = (
        ("uniform", "gaps uniform", UNIFORM_GAPS_S),
        ("jet", "gaps", JET_GAPS_S),
        ("jet, pictures", "camera gaps", JET_GAPS_S),
    )
    for name, flight, gaps_s in cases:
        flown = by_name(runs[flight], SAME)
        for (start_s, end_s), bar, goal in zip(gaps_s, (40.0, 80.0, 250.0), (20.0, 41.0, 60.0), strict=True):
            rows.append(drift(f"gap of {end_s - start_s:g} s, {name}", flown, end_s, bar, goal))
        inside = inside_fraction(flown, gaps_s)
        rows.append(whole(f"gaps, {name}: inside 3 sigma", inside, "%", len(flown), Limit(low=95.0)))
    aided = by_name(runs["gaps dvl"], SAME)
    for start_s, end_s in JET_GAPS_S:
        figure = f"gap of {end_s - start_s:g} s, jet, Doppler log and depth"
        rows.append(drift(figure, aided, end_s, 40.0, 20.0))
    inside = inside_fraction(aided, JET_GAPS_S)
    rows.append(whole("gaps, jet, Doppler log and depth: inside 3 sigma", inside, "%", len(aided), Limit(low=95.0)))
    less_drag, no_model = by_name(runs["gaps drag"], SAME), by_name(runs["gaps uniform"], NO_MODEL)
    return [
        *rows,
        drift("gap of 5 s, uniform, 20 % less drag", less_drag, DRAG_GAPS_S[-1][1], 400.0, None),
        drift("gap of 5 s, uniform, no vehicle model", no_model, UNIFORM_GAPS_S[-1][1], None, None),
    ]


def _bad_fixes(runs: Runs) -> list[EstimatorBenchRow]:
    """Wrong fixes one by one, and all of them at once."""
    reference = [error_rms(run, XY, STEADY_S) for run in by_name(runs["steady"], SAME)]
    rows = []
    for share in (20, 30):
        flown = by_name(runs[f"outliers {share}"], SAME)
        used, wrong = sum(map(far_fixes_used, flown)), sum(map(far_fixes, flown))
        grown = growth([error_rms(run, XY, STEADY_S) for run in flown], reference)
        rows += [
            whole(f"outliers {share} %: used, of {wrong}", used, "", len(flown), Limit(high=0.0)),
            whole(f"outliers {share} %: growth of horizontal error", grown, "%", len(flown), Limit(high=30.0)),
        ]
    start_s, end_s = SHIFTED_S
    found = [
        max(recovery_s(run, start_s, end_s, SHIFT_M), recovery_s(run, end_s, SETTLED_S[1], 0.0))
        for run in by_name(runs["steady"], SHIFTED)
    ]
    figure = "all fixes shifted by 0.5 m and back: found again after"
    return [*rows, row(figure, found, "s", bar=Limit(high=1.0), pool=max)]


def _late(runs: Runs) -> list[EstimatorBenchRow]:
    """Fixes that come 60 +- 20 ms late."""
    late, naive = by_name(runs["late"], SAME), by_name(runs["late"], NAIVE)
    errors = [error_rms(run, XY, STEADY_S) for run in late]
    prompt = [error_rms(run, XY, STEADY_S) for run in by_name(runs["prompt"], SAME)]
    ignored = [MM * error_rms(run, XY, STEADY_S) for run in naive]
    nees = [mean_nees(run, STEADY_S) for run in naive]
    case, delay = "60 +- 20 ms late", "delay ignored (must be bad)"
    return [
        whole(f"{case}: growth of horizontal error", growth(errors, prompt), "%", len(late), Limit(high=20.0)),
        row(f"{case}: position, horizontal", [MM * error for error in errors], "mm", bar=Limit(high=6.0)),
        row(f"{case}: position, {delay}", ignored, "mm", bar=Limit(low=6.0)),
        row(f"{case}: NEES, {delay}", nees, "", bar=Limit(low=9.0), pool=mean),
    ]


def _compass(runs: Runs) -> list[EstimatorBenchRow]:
    """The heading while the magnetic field is wrong."""
    values = [DEG * error_rms(run, YAW, STEADY_S) for run in by_name(runs["compass"], SAME)]
    return [row("compass off by 10 deg: yaw", values, "deg", bar=Limit(high=0.3), goal=Limit(high=0.1))]


GROUPS: dict[str, tuple[tuple[str, ...], Callable[[Runs], list[EstimatorBenchRow]]]] = {
    "steady": (("steady",), lambda runs: _steady("", by_name(runs["steady"], SAME))),
    "pictures": (("camera",), lambda runs: _steady("pictures: ", by_name(runs["camera"], SAME))),
    "haze": (("camera haze",), lambda runs: _steady("pictures, haze: ", by_name(runs["camera haze"], SAME))),
    "currents": (("gaps uniform", "steady", "gaps drag"), _currents),
    "gaps": (("gaps uniform", "gaps", "camera gaps", "gaps dvl", "gaps drag"), _gaps),
    "outliers": (("steady", "outliers 20", "outliers 30"), _bad_fixes),
    "late": (("late", "prompt"), _late),
    "compass": (("compass",), _compass),
}
"""Rows that are shown together -> flights that they are made of, and how."""
