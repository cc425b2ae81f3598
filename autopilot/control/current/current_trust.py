"""Comparison of the learned flow with a uniform current as predictors.

Every fifth of the flow's correlation length both predictions are stored with their position. Farther along the path
each is compared with the current that is then estimated, and the log-likelihood ratio is accumulated.

Errors have heavy tails without a fence: the log-likelihood is Gaussian, -e^2 / 2 s^2, for small errors, and
-log(2 s^2 + e^2) in general. The ratio of the two errors then decides: in a vortex both predictions are far off, and
the slightly worse one is not rejected for it.
"""

import math
from collections import deque
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from autopilot.control.current.current_tuning import CURRENT_TRUST
from autopilot.control.current.currents import correction_fraction
from autopilot.core.frames import FloatArray
from autopilot.core.messages import NavState


class Flowing(Protocol):
    """A flow that does not change."""

    def flow(self, places: FloatArray) -> FloatArray:
        """(m, 2) [m/s] at places (m, 2)."""
        ...


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Prediction:
    """Predictions stored at a position of the path."""

    nav: NavState
    flow: Flowing


class Trust:
    """Accumulated log-likelihood ratio of the two predictors along the path."""

    def __init__(self, length_m: float, *, sure: bool, tails: bool) -> None:
        self._length_m = length_m
        self._step_m = max(CURRENT_TRUST.least_step_m, CURRENT_TRUST.step_fraction * length_m)
        self._tails = tails
        self._balance = CURRENT_TRUST.sure if sure else CURRENT_TRUST.unsure
        self._predictions: deque[_Prediction] = deque(maxlen=CURRENT_TRUST.kept)
        self._last_us: int | None = None
        self.weight = _weight_of(self._balance)
        """0 = the estimate everywhere, 1 = the learned flow."""

    def update(self, nav: NavState, flow: Flowing) -> None:
        """At every control step: judge when the vehicle has come far enough."""
        elapsed_s = 0.0 if self._last_us is None else max(0.0, (nav.t_us - self._last_us) * 1e-6)
        self._last_us = nav.t_us
        self.weight += (_weight_of(self._balance) - self.weight) * min(1.0, elapsed_s / CURRENT_TRUST.ramp_s)
        if self._predictions and _away_m(self._predictions[-1].nav, nav) < self._step_m:
            return
        self._judge(nav)
        self._predictions.append(_Prediction(nav=nav, flow=flow))

    def _judge(self, nav: NavState) -> None:
        here, seen = nav.pos_ned_m[None], nav.current_ned_m_s[:2]
        gains = []
        for prediction in self._predictions:
            if (
                not CURRENT_TRUST.near_fraction
                <= _away_m(prediction.nav, nav) / self._length_m
                <= CURRENT_TRUST.far_fraction
            ):
                continue
            before = prediction.nav.current_ned_m_s[:2]
            flow = prediction.flow.flow(np.stack([nav.pos_ned_m[:2], prediction.nav.pos_ned_m[:2]]))
            fraction = float(correction_fraction(prediction.nav, here, np.zeros(1), self._length_m)[0])
            learned = flow[0] + fraction * (before - flow[1])
            gains.append(self._cost(before - seen) - self._cost(learned - seen))
        if gains:
            gain = float(np.mean(gains))
            self._balance = min(
                max(self._balance + min(max(gain, -CURRENT_TRUST.worst), CURRENT_TRUST.worst), -CURRENT_TRUST.limit),
                CURRENT_TRUST.limit,
            )

    def _cost(self, error_m_s: FloatArray) -> float:
        """Negative logarithm of how likely an error is."""
        square = float(np.square(error_m_s).sum()) / (2.0 * CURRENT_TRUST.error_m_s**2)
        return math.log1p(square) if self._tails else square


def _away_m(a: NavState, b: NavState) -> float:
    return math.dist(a.pos_ned_m[:2].tolist(), b.pos_ned_m[:2].tolist())


def _weight_of(balance: float) -> float:
    return 1.0 / (1.0 + math.exp(-2.0 * balance))
