"""Summary of a campaign: proportions with confidence intervals, percentiles of margins, acceptance bars."""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from autopilot.campaign.results import RunResult
from autopilot.campaign.tube_study import AHEAD_S
from autopilot.log.smoothness import BARS

CONFIDENCE = 0.95
TO_THE_END = "runs flown to their end"
"""Name of the bar that counts them."""
PERCENTILES = (0.0, 1.0, 5.0, 50.0, 95.0, 100.0)
TUBE_FRACTION = 0.999
"""Share of nodes that has to lie inside the announced tube."""
INSIDE_SHARE = 0.95
"""Share of the time that the truth lies within three standard deviations of the estimate."""
TUBE_BAR = 0
"""Which of :data:`AHEAD_S` the bar is for."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Bar:
    """Something that all runs together have to hold."""

    name: str
    bar: str
    value: str
    held: bool | None
    """None = cannot be judged."""
    note: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Distribution:
    """How a figure is distributed over the runs."""

    name: str
    unit: str
    count: int
    percentiles: tuple[float, ...]
    """At :data:`PERCENTILES`."""
    broken: int = 0
    """Runs that broke this bound at all."""
    beyond: int = 0
    """Runs that broke it by more than its tolerance."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Summary:
    planned: int
    """Runs that were asked for."""
    finished: int
    bars: tuple[Bar, ...]
    margins: tuple[Distribution, ...]
    figures: tuple[Distribution, ...]
    not_flown: str
    """``2 of 10 runs could not be flown: CAUSE``; empty if all were."""
    failed: tuple[RunResult, ...]
    """Runs that break what the scenario holds against a run."""
    within_tolerance: tuple[RunResult, ...]
    """Runs that broke a bound within its tolerance, or missed something that is not held against them."""

    @property
    def passed(self) -> bool:
        return not self.not_flown and self._kept

    @property
    def _kept(self) -> bool:
        return all(bar.held is not False for bar in self.bars if bar.name != TO_THE_END)

    @property
    def verdict(self) -> str:
        """What the campaign has shown, in one line: a run that could not be flown breaks no bound."""
        kept = "" if self._kept else "A BOUND IS BROKEN"
        return "; ".join(filter(None, (kept, self.not_flown))) or "all bounds hold"


def failure_bound(failures: int, runs: int) -> float:
    """Largest failure rate that such a result still allows with 95 % confidence (Clopper and Pearson 1934, one-sided).

    Without failures about 3 / runs (rule of three)."""
    if failures >= runs:
        return 1.0
    if failures == 0:
        return float(1.0 - (1.0 - CONFIDENCE) ** (1.0 / runs))
    from scipy.stats import beta

    return float(beta.ppf(CONFIDENCE, failures + 1, runs - failures))


def failure_interval(failures: int, runs: int) -> tuple[float, float]:
    """Failure rates between which the true one lies with 95 % confidence (Clopper and Pearson 1934, two-sided)."""
    from scipy.stats import beta

    tail = 0.5 * (1.0 - CONFIDENCE)
    low = 0.0 if failures == 0 else float(beta.ppf(tail, failures, runs - failures + 1))
    high = 1.0 if failures >= runs else float(beta.ppf(1.0 - tail, failures + 1, runs - failures))
    return low, high


def not_flown(errors: Sequence[str], count: int, flights: str = "runs") -> str:
    """``2 of 10 runs could not be flown: CAUSE (and 1 other cause)``, the most frequent one; empty without errors."""
    if not errors:
        return ""
    (cause, _), *others = Counter(errors).most_common()
    more = f" (and {len(others)} other cause{'s' * (len(others) > 1)})" if others else ""
    return f"{len(errors)} of {count} {flights} could not be flown: {cause}{more}"


def summarise(results: Sequence[RunResult], planned: int) -> Summary:
    """All figures of the finished runs."""
    flown = [result for result in results if result.flown]
    failed = tuple(result for result in results if result.failed)
    errors = [result.error for result in results if result.error is not None]
    return Summary(
        planned=planned,
        finished=len(results),
        bars=tuple(_bars(results, flown)),
        not_flown=not_flown(errors, len(results)),
        margins=tuple(_margins(flown)),
        figures=tuple(_figures(flown)),
        failed=failed,
        within_tolerance=tuple(r for r in flown if not r.failed and (r.broken or r.laps_missing)),
    )


def _bars(results: Sequence[RunResult], flown: Sequence[RunResult]) -> list[Bar]:
    count = len(results)
    strict = any(result.judged == "bounds" for result in flown)
    lost = [result for result in results if not result.flown]
    done = f"{len(flown)} of {count}"
    bars = [Bar(name=TO_THE_END, bar="all", value=done, held=not lost, note=_which(lost))]
    with_laps = [result for result in flown if result.arrived]
    done = f"{len(with_laps)} of {len(flown)}"
    laps_held = len(with_laps) == len(flown) if strict else None
    bars.append(Bar(name="laps done", bar="all" if strict else "not asked", value=done, held=laps_held))
    touched = [result for result in flown if result.contacts]
    bars.append(_none("contacts", touched, True))
    bars.append(_none("a bound broken beyond its tolerance", [r for r in flown if r.beyond], strict))
    at_all = [result for result in flown if result.broken]
    note = _which(at_all) or ("goal" if strict else "")
    bars.append(Bar(name="a bound broken at all", bar="goal: no run", value=str(len(at_all)), held=None, note=note))
    bars.append(_tube(flown, strict))
    bars += _honest(flown) + _smooth(flown)
    failures = sum(result.failed for result in results)
    if count:
        bound, (low, high) = failure_bound(failures, count), failure_interval(failures, count)
        note = (
            f"{failures} failed of {count} = {failures / count:.2%}; 95 % confidence; between {low:.2%} and {high:.2%}"
            f"{f'; {len(lost)} of them were not flown' if lost else ''}"
        )
        bars.append(Bar(name="failure rate", bar="", value=f"<= {bound:.2%}", held=None, note=note))
    return bars


def _none(name: str, runs: Sequence[RunResult], strict: bool) -> Bar:
    bar = "no run" if strict else "not held against it"
    return Bar(name=name, bar=bar, value=str(len(runs)), held=not runs if strict else None, note=_which(runs))


def _which(runs: Sequence[RunResult]) -> str:
    shown = ", ".join(str(result.run) for result in runs[:12])
    return f"runs {shown}{', ...' if len(runs) > 12 else ''}" if runs else ""


def _tube(flown: Sequence[RunResult], strict: bool) -> Bar:
    name, bar = f"nodes up to {AHEAD_S[TUBE_BAR]:g} s ahead inside the announced tube", f">= {TUBE_FRACTION:.1%}"
    fractions = np.array([result.tube_shares for result in flown if len(result.tube_shares) == len(AHEAD_S)])
    if not len(fractions):
        return Bar(name=name, bar=bar, value="", held=None, note="the controller announced none")
    mean = fractions.mean(axis=0)
    reach = [f"up to {ahead_s:g} s" if math.isfinite(ahead_s) else "of all" for ahead_s in AHEAD_S]
    other = [f"{fraction:.2%} {label}" for label, fraction in zip(reach, mean.tolist(), strict=True)]
    value = float(mean[TUBE_BAR])
    held = value >= TUBE_FRACTION if strict else None
    return Bar(name=name, bar=bar if strict else "", value=f"{value:.3%}", held=held, note=", ".join(other))


SMOOTH = (
    ("alternating", "alternating commands", 100.0, "%"),
    ("ratio", "thrust variation / that below 2 Hz", 1.0, ""),
    ("step_n", "largest step of thrust", 1.0, "N"),
    ("reversals_1_s", "reversals of a thruster", 1.0, "1/s"),
    ("silent", "unreported fallback steps", 1.0, ""),
)
"""Figure of :class:`autopilot.log.smoothness.Smoothness`, how it is called, factor to its unit, unit."""


def _honest(flown: Sequence[RunResult]) -> list[Bar]:
    """Goal: the truth lies within the estimate's three standard deviations."""
    runs = [(result.inside_share, result) for result in flown if result.inside_share is not None]
    if not runs:
        return []
    out = [result for share, result in runs if share < INSIDE_SHARE]
    value = f"{min(share for share, _ in runs):.1%}"
    name, bar = "estimate within 3 sigma, worst run", f"goal: >= {INSIDE_SHARE:.0%} of the time"
    return [Bar(name=name, bar=bar, value=value, held=None, note=_which(out))]


def _smooth(flown: Sequence[RunResult]) -> list[Bar]:
    """Goals: a run does not fail by them."""
    runs = [result for result in flown if result.smoothness is not None]
    bars = []
    for figure, name, factor, unit in SMOOTH if runs else ():
        worst = max(factor * getattr(result.smoothness, figure) for result in runs)
        rough = [result for result in runs if figure in result.rough]
        bar = f"goal: <= {factor * getattr(BARS, figure):g} {unit}".strip()
        value = f"{worst:.3g} {unit}".strip()
        bars.append(Bar(name=f"{name}, worst run", bar=bar, value=value, held=None, note=_which(rough)))
    return bars


def margin_unit(name: str) -> str:
    """Unit of the margin to a bound of a run."""
    return {"planar speed": "m/s", "heave": "m/s", "yaw rate": "rad/s", "thrust": "N"}.get(name, "m")


def _margins(flown: Sequence[RunResult]) -> list[Distribution]:
    names = list(dict.fromkeys(name for result in flown for name in result.margins))
    return [
        _spread(
            name,
            margin_unit(name),
            [result.margins[name].margin for result in flown if name in result.margins],
            broken=sum(name in result.broken for result in flown),
            beyond=sum(name in result.beyond for result in flown),
        )
        for name in names
    ]


def _figures(flown: Sequence[RunResult]) -> list[Distribution]:
    laps = [energy for result in flown for energy in result.energy_j]
    rows = [
        _spread("energy per lap", "J", laps),
        _spread("energy of a run's laps", "J", [sum(result.energy_j) for result in flown if result.arrived]),
        _spread("time per lap", "s", [lap for result in flown for lap in result.lap_s]),
        _spread("estimate position rms", "mm", [1000.0 * result.pos_rms_m for result in flown]),
        _spread("estimate position worst", "mm", [1000.0 * result.pos_max_m for result in flown]),
        _spread("estimate yaw rms", "deg", [math.degrees(result.yaw_rms_rad) for result in flown]),
        _spread("estimate current rms", "m/s", [result.current_rms_m_s for result in flown]),
        _spread("estimate within 3 sigma", "%", [100.0 * r.inside_share for r in flown if r.inside_share is not None]),
        _spread("mean squared error / variance", "", [r.nees for r in flown if r.nees is not None]),
        _spread("controller fallbacks", "%", [100.0 * r.fallbacks / r.steps for r in flown if r.steps]),
        _spread("largest slack", "", [result.slack_max for result in flown]),
        _spread("CPU time of a run", "s", [result.cpu_s for result in flown]),
    ]
    smooth = [result.smoothness for result in flown if result.smoothness is not None]
    rows += [
        _spread(name, unit, [factor * getattr(s, figure) for s in smooth]) for figure, name, factor, unit in SMOOTH
    ]
    return [row for row in rows if row.count]


def _spread(name: str, unit: str, values: Sequence[float], *, broken: int = 0, beyond: int = 0) -> Distribution:
    at = tuple(float(value) for value in np.percentile(values, PERCENTILES)) if len(values) else ()
    return Distribution(name=name, unit=unit, count=len(values), percentiles=at, broken=broken, beyond=beyond)
