"""How smooth the commands are: alternation, variation, steps and reversals of thrust, and fallbacks without a word.

Looked at are the commands of the control steps (20 Hz, and at once when a goal appears), not those of the inner loop
between them. Over N steps with the commands u_k of one thruster and their differences d_k = u_k - u_(k-1):

* *alternating*: d_k and d_(k+1) have opposite signs and both exceed ALTERNATION_N. Counted are the steps k at which any
  thruster does, against all steps
* *variation*: sum of |d_k| over the time, the mean of the thrusters; and the same of the commands behind a low-pass of
  LOW_PASS_HZ without phase (Butterworth, second order, forwards and backwards), which is what the motion can follow.
  Their ratio is judged. On a straight way nothing has to change, and any noise is a multiple of nothing: the slow part
  counts as at least LEAST_SLOW_1_S of the thrust limit
* *largest step*: the largest |d_k| that neither begins nor ends at the thrust limit and is no start. Starts are the
  differences to commands within START_S after arming and after a goal that is another place
* *reversals*: changes of sign per second, of the worst thruster; what is smaller than REVERSAL_N is no thrust
* *silent*: steps flown by a fallback of which the operator has not heard within REPORTED_S before or ANSWER_S after
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from autopilot.core.frames import FloatArray
from autopilot.core.messages import FALLBACK_TEXT, Fallback

ALTERNATION_N = 2.0
LOW_PASS_HZ = 2.0
START_S = 0.25
REVERSAL_N = 0.1
REPORTED_S = 30.0
ANSWER_S = 1.0
LEAST_SLOW_1_S = 1.0 / 12.0
"""Share of the limit per second: 1 N/s of 12 N. Twice that is the variation of white noise of 0.7 % of the limit."""

AT_LIMIT = 0.999
"""Share of the thrust limit from which on a command counts as saturated."""

LONGEST_STEP_S = 0.2
"""Longer intervals between commands are gaps in control."""

FEWEST_STEPS = 20
"""A second: less is too short for rates."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ThrustCommands:
    """The commands of the control steps, in order."""

    t_s: FloatArray
    """(n,)"""
    thrust_n: FloatArray
    """(n, thrusters)"""
    fallback: NDArray[np.uint8]
    """(n,) :class:`Fallback`"""
    starts_s: FloatArray
    """Times of arming, and of goals that are another place."""
    reported_s: FloatArray
    """Times of the reports of a fallback."""
    limit_n: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Smoothness:
    alternating: float
    """Share of the steps."""
    variation_n_s: float
    """N/s, mean of the thrusters."""
    low_passed_n_s: float
    """The same of what is left below LOW_PASS_HZ."""
    step_n: float
    step_at_s: float
    """When the largest step was."""
    reversals_1_s: float
    """Per second, worst thruster."""
    silent: int
    """Steps."""
    least_n_s: float = 0.0
    """Lower bound of the slow part."""

    @property
    def ratio(self) -> float:
        """Variation over the variation below LOW_PASS_HZ, the latter no less than LEAST_SLOW_1_S."""
        slow_n_s = max(self.low_passed_n_s, self.least_n_s)
        return self.variation_n_s / slow_n_s if slow_n_s > 0.0 else 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Bars:
    """Limits for smooth commands; names as the figures."""

    alternating: float = 0.005
    ratio: float = 2.0
    step_n: float = 3.0
    """Of a thrust limit of 12 N; in proportion to others."""
    reversals_1_s: float = 0.3
    silent: float = 0.0

    def of(self, found: Smoothness) -> "Bars":
        """For the thrust limit of these commands, the same if it is not known."""
        limits = found.least_n_s / (12.0 * LEAST_SLOW_1_S) or 1.0
        return replace(self, step_n=self.step_n * limits)

    def broken(self, found: Smoothness) -> list[str]:
        """Names of the bars that are not kept."""
        bars = self.of(found)
        return [f.name for f in fields(self) if not getattr(found, f.name) <= getattr(bars, f.name)]


BARS = Bars()


def measure(commands: ThrustCommands) -> Smoothness | None:
    """All figures, None with too few data."""
    t_s, thrust = commands.t_s, commands.thrust_n
    if len(t_s) < FEWEST_STEPS:
        return None
    d, follows = np.diff(thrust, axis=0), np.diff(t_s) < LONGEST_STEP_S
    d[~follows] = 0.0
    large = np.abs(d) > ALTERNATION_N
    alternates = (d[1:] * d[:-1] < 0.0) & large[1:] & large[:-1]
    span_s = max(float(np.diff(t_s)[follows].sum()), 1e-9)
    counted = np.where((follows & ~_begins(t_s[1:], commands.starts_s))[:, None] & ~_saturated(commands), np.abs(d), 0)
    at = int(np.argmax(counted.max(axis=1)))
    return Smoothness(
        alternating=float(alternates.any(axis=1).sum()) / len(t_s),
        variation_n_s=float(np.abs(d).sum(axis=0).mean()) / span_s,
        least_n_s=LEAST_SLOW_1_S * commands.limit_n if math.isfinite(commands.limit_n) else 0.0,
        low_passed_n_s=float(np.abs(np.diff(low_passed(t_s, thrust), axis=0)[follows]).sum(axis=0).mean()) / span_s,
        step_n=float(counted.max()),
        step_at_s=float(t_s[at + 1]),
        reversals_1_s=max(_reversals(column) for column in thrust.T) / span_s,
        silent=_silent(commands),
    )


def low_passed(t_s: FloatArray, values: FloatArray) -> FloatArray:
    """(n, m) values after a zero-phase low-pass of LOW_PASS_HZ. The filter is applied in the frequency domain;
    ends are continued by point reflection.
    """
    n = len(values)
    around = np.concatenate([2.0 * values[0] - values[:0:-1], values, 2.0 * values[-1] - values[-2::-1]])
    hz = np.fft.rfftfreq(len(around), max(float(np.median(np.diff(t_s))), 1e-3))
    response = 1.0 / (1.0 + (hz / LOW_PASS_HZ) ** 4)
    line = np.linspace(0.0, 1.0, len(around))[:, None] * (around[-1] - around[0])
    passed = np.fft.irfft(np.fft.rfft(around - line, axis=0) * response[:, None], len(around), axis=0) + line
    result: FloatArray = passed[n - 1 : 2 * n - 1]
    return result


def _begins(t_s: FloatArray, starts_s: FloatArray) -> NDArray[np.bool_]:
    """(n,) which times lie within START_S after a start."""
    if not len(starts_s):
        return np.zeros(len(t_s), dtype=bool)
    starts = np.sort(starts_s)
    last = starts[np.maximum(np.searchsorted(starts, t_s, side="right") - 1, 0)]
    return (t_s >= last) & (t_s <= last + START_S)


def _saturated(commands: ThrustCommands) -> NDArray[np.bool_]:
    """(n-1, thrusters) differences that begin or end at the limit."""
    at = np.abs(commands.thrust_n) >= AT_LIMIT * commands.limit_n
    return at[1:] | at[:-1]


def _reversals(thrust_n: FloatArray) -> int:
    signs = np.sign(thrust_n[np.abs(thrust_n) > REVERSAL_N])
    return int(np.count_nonzero(np.diff(signs)))


def _silent(commands: ThrustCommands) -> int:
    """A neutral command has its own texts: there is no estimate, or it is not known whether commands act."""
    flown = (commands.fallback == Fallback.SHIFTED_PLAN) | (commands.fallback == Fallback.STATION_KEEPING)
    when, reported = commands.t_s[flown], commands.reported_s
    explained = (reported[None] >= when[:, None] - REPORTED_S) & (reported[None] <= when[:, None] + ANSWER_S)
    return int(np.count_nonzero(~explained.any(axis=1)))


def is_reported(texts: Sequence[str]) -> NDArray[np.bool_]:
    """Whether a text reports a fallback."""
    return np.array([text.startswith(FALLBACK_TEXT) for text in texts], dtype=bool)
