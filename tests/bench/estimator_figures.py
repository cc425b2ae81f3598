"""Figures of the estimator's benchmark out of recorded flights, and how they are judged. Pure functions."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from filterpy.stats import NEES
from numpy.typing import NDArray

from autopilot.core.frames import FloatArray

FIX_POINT_95 = 9.488
"""95 % point of the chi-square distribution with four degrees of freedom: north, east, down, yaw
(Abramowitz & Stegun, table 26.8)."""
FAR_FIX_M = 0.05
"""A fix further from the truth than this must not be used."""
FOUND_M = 0.05
"""A vehicle that was moved has been found again when the planar error stays below this."""
SETTLED_S = 0.5
"""For so long."""
GAUSS_3_SIGMA = 3.0


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Watched:
    """One estimator during one flight: estimate minus truth."""

    t_s: FloatArray
    """(n,)"""
    error: FloatArray
    """(n, 7) position NED [m], yaw [rad], velocity over ground NED [m/s]."""
    covariance: FloatArray
    """(n, 7, 7) that the estimator claims for the same."""
    current_error: FloatArray
    """(n, 2) north, east [m/s]."""
    fix_t_s: FloatArray
    """(m,) times of the fixes that met the gate."""
    fix_used: NDArray[np.bool_]
    """(m,)"""
    fix_distance: FloatArray
    """(m,) squared Mahalanobis distance of the residual."""
    fix_residual: FloatArray
    """(m, 3) residuals of the position over their expected standard deviation."""
    fix_off_m: FloatArray
    """(m,) how far the fix was from the truth, NaN = not known."""


Flights = Sequence[Watched]
"""One estimator in the same flight with several seeds."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Limit:
    """What a figure has to keep, both ends included."""

    low: float = -np.inf
    high: float = np.inf

    def holds(self, value: float) -> bool:
        """False for NaN."""
        return self.low <= value <= self.high

    def __str__(self) -> str:
        if self.low == -np.inf:
            return f"<= {self.high:g}"
        return f">= {self.low:g}" if self.high == np.inf else f"{self.low:.3g} to {self.high:.3g}"


@dataclass(frozen=True, slots=True, kw_only=True)
class EstimatorBenchRow:
    figure: str
    measured: float
    """Over all seeds."""
    low: float | None
    """The least of one seed; None, as the next two, for figures that only exist over all seeds."""
    median: float | None
    high: float | None
    unit: str
    bar: str
    goal: str
    verdict: str
    """``goal`` or ``bar`` = reached, ``missed``, empty = for comparison."""
    seeds: int


def verdict(measured: float, bar: Limit | None, goal: Limit | None) -> str:
    """``goal``, ``bar`` or ``missed``; empty for a figure that is only shown for comparison."""
    if goal is not None and goal.holds(measured):
        return "goal"
    if bar is None:
        return ""
    return "bar" if bar.holds(measured) else "missed"


def nees_band(states: int, runs: int) -> Limit:
    """Two-sided 95 % band of the mean over ``runs`` independent values that are chi-square with ``states``."""
    from scipy.stats import chi2

    freedom = states * runs
    return Limit(low=float(chi2.ppf(0.025, freedom)) / runs, high=float(chi2.ppf(0.975, freedom)) / runs)


def rms(values: FloatArray) -> float:
    """Root mean square length of vectors (n, k) or numbers (n,)."""
    squares = np.square(values)
    return float(np.sqrt((squares.sum(axis=1) if values.ndim == 2 else squares).mean()))


def pooled_rms(values: Sequence[float]) -> float:
    """Root mean square over runs of equal length that each have one."""
    return float(np.sqrt(np.mean(np.square(values))))


def row(
    figure: str,
    values: Sequence[float],
    unit: str,
    *,
    bar: Limit | None = None,
    goal: Limit | None = None,
    pool: Callable[[Sequence[float]], float] = pooled_rms,
) -> EstimatorBenchRow:
    """A figure that every seed has."""
    measured = float(pool(values))
    return EstimatorBenchRow(
        figure=figure,
        measured=measured,
        low=min(values),
        median=float(np.median(values)),
        high=max(values),
        unit=unit,
        bar="" if bar is None else str(bar),
        goal="" if goal is None else str(goal),
        verdict=verdict(measured, bar, goal),
        seeds=len(values),
    )


def whole(figure: str, value: float, unit: str, seeds: int, bar: Limit | None) -> EstimatorBenchRow:
    """A figure that only all seeds together have."""
    return EstimatorBenchRow(
        figure=figure,
        measured=value,
        low=None,
        median=None,
        high=None,
        unit=unit,
        bar="" if bar is None else str(bar),
        goal="",
        verdict=verdict(value, bar, None),
        seeds=seeds,
    )


def mean(values: Sequence[float]) -> float:
    """Over runs that each have one."""
    return float(np.mean(values))


def error_rms(run: Watched, columns: slice, span_s: tuple[float, float]) -> float:
    """Root mean square of some columns of the error within a span of time."""
    return rms(run.error[_within(run.t_s, span_s)][:, columns])


def current_rms(run: Watched, span_s: tuple[float, float]) -> float:
    """The same of the current [m/s]."""
    return rms(run.current_error[_within(run.t_s, span_s)])


def mean_nees(run: Watched, span_s: tuple[float, float]) -> float:
    """Mean normalised estimation error squared of the seven states; 7 = as sure as it should be."""
    keep = _within(run.t_s, span_s)
    error = run.error[keep]
    return float(np.mean(NEES(error, np.zeros_like(error), run.covariance[keep])))


def mean_nis(run: Watched, span_s: tuple[float, float]) -> float:
    """Mean squared distance of the fixes from the prediction; 4 = as sure as it should be."""
    return float(run.fix_distance[_within(run.fix_t_s, span_s)].mean())


def nis_fraction(run: Watched, span_s: tuple[float, float]) -> float:
    """Share of the fixes [%] beyond the 95 % point."""
    return float(100.0 * (run.fix_distance[_within(run.fix_t_s, span_s)] > FIX_POINT_95).mean())


def whiteness(run: Watched, span_s: tuple[float, float]) -> float:
    """Autocorrelation of the residuals from one fix to the next, the largest of the three components in size."""
    residual = run.fix_residual[_within(run.fix_t_s, span_s) & run.fix_used]
    return float(np.abs((residual[1:] * residual[:-1]).sum(axis=0) / np.square(residual).sum(axis=0)).max())


def drift_m(run: Watched, end_s: float) -> float:
    """Planar error at the end of a gap."""
    k = int(np.searchsorted(run.t_s, end_s - 1e-6))
    return float(np.linalg.norm(run.error[k, :2]))


def inside_fraction(runs: Flights, gaps_s: Sequence[tuple[float, float]]) -> float:
    """Share of north and east errors [%] inside three standard deviations, during gaps."""
    inside = []
    for run in runs:
        sigma = np.sqrt(np.diagonal(run.covariance, axis1=1, axis2=2)[:, :2])
        for gap_s in gaps_s:
            keep = _within(run.t_s, gap_s)
            inside.append(np.abs(run.error[keep, :2]) <= GAUSS_3_SIGMA * sigma[keep])
    return float(100.0 * np.concatenate(inside).mean())


def far_fixes_used(run: Watched) -> int:
    """Fixes that were used although they were far from the truth."""
    return int((run.fix_used & (run.fix_off_m > FAR_FIX_M)).sum())


def far_fixes(run: Watched) -> int:
    """Fixes that were far from the truth."""
    return int((run.fix_off_m > FAR_FIX_M).sum())


def growth(runs: Sequence[float], reference: Sequence[float]) -> float:
    """How much larger the pooled rms is than that of other runs [%]."""
    return 100.0 * (pooled_rms(runs) / pooled_rms(reference) - 1.0)


def recovery_s(run: Watched, moved_s: float, until_s: float, shift_m: float) -> float:
    """Time from ``moved_s``, when all fixes move north by ``shift_m``, until the estimate has followed for good.

    Infinite if it has not by ``until_s``."""
    keep = _within(run.t_s, (moved_s, until_s))
    t_s, planar = run.t_s[keep], run.error[keep, :2] - np.array([shift_m, 0.0])
    away = np.flatnonzero(np.hypot(planar[:, 0], planar[:, 1]) > FOUND_M)
    if len(away) == 0:
        return 0.0
    found = away[-1] + 1
    if found >= len(t_s) or t_s[-1] - t_s[found] < SETTLED_S:
        return float("inf")
    return float(t_s[found] - moved_s)


def by_name(runs: Sequence[Mapping[str, Watched]], name: str) -> list[Watched]:
    """One estimator out of several flights."""
    return [run[name] for run in runs]


def _within(t_s: FloatArray, span_s: tuple[float, float]) -> NDArray[np.bool_]:
    """(n,) from start to end, both included up to rounding."""
    result: NDArray[np.bool_] = (t_s >= span_s[0] - 1e-6) & (t_s <= span_s[1] + 1e-6)
    return result
