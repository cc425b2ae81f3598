"""Current forecast without a map: a planar incompressible flow fitted to the currents estimated along the path.

The flow is a uniform stream plus the curl of a random streamfunction (a Gaussian process with a squared exponential
kernel): predictions between and beyond the visited positions are free of divergence. Amplitude and the presence of a
stream (there is none in a closed basin, whose walls the fence need not show) are weighed by the evidence: each
hypothesis has the weight of its marginal likelihood times its prior.

Predictions of the flow are compared with later estimates all the time. While they are worse than those of a uniform
current the flow is not used (:mod:`autopilot.control.current.current_learning`).
"""

import ctypes
import math
from collections import deque
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Protocol

import numpy as np

from autopilot.control.current.current_tuning import CURRENT_LEARNING, CURRENT_TRUST, CURRENTS
from autopilot.control.current.currents import Revision, correction_fraction
from autopilot.core import compiled
from autopilot.core.frames import FloatArray
from autopilot.core.geometry import Circle, Fence
from autopilot.core.messages import NavHealth, NavState


class Flowing(Protocol):
    """A flow that does not change.

    Every fifth of the flow's correlation length both predictions are stored with their position. Farther along the path
    each is compared with the current that is then estimated, and the log-likelihood ratio is accumulated.

    Errors have heavy tails without a fence: the log-likelihood is Gaussian, -e^2 / 2 s^2, for small errors, and -log(2
    s^2 + e^2) in general. The ratio of the two errors then decides: in a vortex both predictions are far off, and the
    slightly worse one is not rejected for it."""

    def flow(self, places: FloatArray) -> FloatArray:
        """(m, 2) [m/s] at places (m, 2)."""
        ...


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Prediction:
    """Predictions stored at a position of the path."""

    nav: NavState
    flow: Flowing


class Trust:
    """Accumulated log-likelihood ratio of the learned flow and of a uniform current as predictors along the path."""

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


class Basin(StrEnum):
    """Prior probability of a closed basin (setting ``basin``)."""

    CLOSED = "closed"
    """A tank or pool: the flow is closed."""
    OPEN = "open"
    """Part of a larger water."""
    UNKNOWN = "unknown"


CLOSED_SHARE = {Basin.CLOSED: 0.95, Basin.OPEN: 0.02, Basin.UNKNOWN: 0.25}
"""Prior probability of a closed basin. A fence is no evidence: it is no wall."""


_MEANS_M_S = (CURRENT_LEARNING.closed_mean_m_s, CURRENT_LEARNING.open_mean_m_s)


@dataclass(slots=True)
class _Cell:
    """Weighted sums of the current estimates in one cell."""

    weight_s: float
    moment: tuple[float, float, float, float]
    """Weighted sums of north, east [m] and current north, east [m/s]."""
    seen_us: int


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FlowFit:
    """A flow through estimates; never changes."""

    length_m: float
    places_ned_m: FloatArray
    """(n, 2) where cells have their means."""
    pull: FloatArray
    """(2, n) how every cell pulls at the varying part of the flow, north and east [m/s]."""
    mean_m_s: FloatArray
    """(2,) uniform part."""
    addresses: tuple[int, int, int] = field(init=False)
    """Of the three."""

    def __post_init__(self) -> None:
        cells = len(self.places_ned_m)
        addresses = (
            compiled.fitting("places_ned_m", self.places_ned_m, cells, 2),
            compiled.fitting("pull", self.pull, 2, cells),
            compiled.fitting("mean_m_s", self.mean_m_s, 2),
        )
        # Frozen dataclass: derived fields are set by object.__setattr__.
        object.__setattr__(self, "addresses", addresses)

    def flow(self, places: FloatArray) -> FloatArray:
        """(m, 2) at places (m, 2)."""
        here, out = np.array(places, dtype=float, order="C"), np.empty((len(places), 2))
        at, cells, mine = compiled.fitting("places", here, len(here), 2), len(self.places_ned_m), self.addresses
        compiled.load().flow_at(len(here), at, 2, cells, *mine[:2], self.length_m, mine[2], compiled.address(out))
        return out


class _Forecast(compiled.Mirror):
    """ctypes layout of the struct in water.c."""

    _fields_ = (
        *((name, ctypes.c_long) for name in ("m", "stride", "cells")),
        *((name, ctypes.c_double) for name in ("length_m", "trust", "scale_m")),
        *((name, ctypes.c_double) for name in ("full_within_m", "lasting_s", "fade_s")),
        *((name, ctypes.c_void_p) for name in ("places", "t_s", "here", "estimate", "cell", "pull", "mean", "out")),
    )


class EstimatedFlow:
    def __init__(self, basin: Basin = Basin.UNKNOWN) -> None:
        self._basin = basin
        self._length_m = CURRENT_LEARNING.open_length_m
        self._fenced = False
        self._last_us: int | None = None
        self._revision = Revision()
        self._here, self._estimate = np.zeros(3), np.zeros(3)
        self._struct = _Forecast(
            full_within_m=CURRENTS.full_within_m,
            lasting_s=CURRENTS.lasting_s,
            fade_s=CURRENTS.fade_s,
            here=self._here.ctypes.data,
            estimate=self._estimate.ctypes.data,
        )
        self._reference, self._call = ctypes.byref(self._struct), compiled.load(_Forecast).fill_currents
        self._forget()

    @property
    def closed(self) -> float:
        """Posterior probability of a closed basin."""
        return float(self._belief[:, 0].sum())

    @property
    def trust(self) -> float:
        """Share of the learned flow in the forecast; the rest is the estimate, the same everywhere."""
        return self._trust.weight

    def _forget(self) -> None:
        self._cells: dict[tuple[int, int], _Cell] = {}
        self._fitted_us: int | None = None
        closed = CLOSED_SHARE[self._basin]
        prior = np.column_stack([CURRENT_LEARNING.closed_flow_prior, CURRENT_LEARNING.open_flow_prior]) * [
            closed,
            1.0 - closed,
        ]
        self._belief: FloatArray = prior
        self._log_prior: FloatArray = np.log(prior)
        self._fit = FlowFit(
            length_m=self._length_m, places_ned_m=np.zeros((0, 2)), pull=np.zeros((2, 0)), mean_m_s=np.zeros(2)
        )
        sure = self._basin is Basin.CLOSED or not self._fenced
        self._trust = Trust(self._length_m, sure=sure, tails=not self._fenced)

    def within(self, fence: Fence) -> None:
        """Take the correlation length from the size of the workspace. Another one begins with nothing learned."""
        width = narrowest_width_m(fence)
        length = CURRENT_LEARNING.open_length_m if width is None else CURRENT_LEARNING.length_fraction * width
        length = min(max(length, CURRENT_LEARNING.shortest_m), CURRENT_LEARNING.longest_m)
        if (length, width is not None) != (self._length_m, self._fenced):
            self._length_m, self._fenced = length, width is not None
            self._forget()

    def view(self, nav: NavState) -> NavState:
        elapsed_s = 0.0 if self._last_us is None else (nav.t_us - self._last_us) * 1e-6
        self._last_us = nav.t_us
        if nav.health is not NavHealth.GOOD or not math.isfinite(sum(nav.current_ned_m_s.tolist())):
            return nav
        if elapsed_s > 0.0 or not self._cells:
            self._learn(nav, min(max(elapsed_s, 0.01), 0.2))
        if self._fitted_us is None or nav.t_us - self._fitted_us >= CURRENT_LEARNING.refresh_s * 1e6:
            self._fitted_us = nav.t_us
            self._refit(nav.t_us)
        self._trust.update(nav, self._fit)
        return nav

    def fill(self, nav: NavState, pos_ned_m: FloatArray, t_s: FloatArray, out: FloatArray) -> None:
        """Learned flow, weighted by its trust, corrected by its present residual against the estimate."""
        struct, fit, m = self._struct, self._fit, len(pos_ned_m)
        places, times, made = np.array(pos_ned_m, dtype=float, order="C"), np.array(t_s, dtype=float), np.empty((m, 3))
        self._here[:], self._estimate[:] = nav.pos_ned_m, nav.current_ned_m_s
        struct.m, struct.stride, struct.cells = m, 3, len(fit.places_ned_m)
        struct.length_m, struct.trust, struct.scale_m = fit.length_m, self.trust, self._length_m
        struct.places, struct.out = compiled.fitting("pos_ned_m", places, m, 3), compiled.address(made)
        struct.t_s = compiled.fitting("t_s", times, m)
        struct.cell, struct.pull, struct.mean = fit.addresses
        self._call(self._reference)
        out[:] = made

    def revision(self, nav: NavState) -> int:
        """Changes when the estimate differs from the learned flow here."""
        here = self._fit.flow(np.asarray(nav.pos_ned_m, dtype=float)[None, :2])[0]
        lack = np.array([nav.current_ned_m_s[0] - here[0], nav.current_ned_m_s[1] - here[1], 0.0])
        return self._revision.update(lack, nav.t_us * 1e-6)

    def _learn(self, nav: NavState, duration_s: float) -> None:
        size = self._length_m / CURRENT_LEARNING.cells_per_length
        x, y, _ = nav.pos_ned_m.tolist()
        key = (math.floor(x / size), math.floor(y / size))
        cell = self._cells.pop(key, None)
        if cell is None:
            cell = _Cell(0.0, (0.0, 0.0, 0.0, 0.0), nav.t_us)
            if len(self._cells) >= CURRENT_LEARNING.max_cells:
                del self._cells[next(iter(self._cells))]
        fade = math.exp((cell.seen_us - nav.t_us) * 1e-6 / CURRENT_LEARNING.forget_s)
        north, east, _ = nav.current_ned_m_s.tolist()
        cell.weight_s = fade * cell.weight_s + duration_s
        a, b, c, d = cell.moment
        cell.moment = (
            fade * a + duration_s * x,
            fade * b + duration_s * y,
            fade * c + duration_s * north,
            fade * d + duration_s * east,
        )
        cell.seen_us = nav.t_us
        self._cells[key] = cell

    def _refit(self, now_us: int) -> None:
        """All models through the cells, mixed by how likely they are (Rasmussen and Williams 2006, eq. 5.8)."""
        cells = list(self._cells.values())
        rows = np.array([cell.moment for cell in cells]) / np.array([[cell.weight_s] for cell in cells])
        weight = np.array(
            [
                cell.weight_s
                * math.exp((cell.seen_us - now_us) * 1e-6 / CURRENT_LEARNING.forget_s)
                / CURRENT_LEARNING.full_weight_s
                for cell in cells
            ]
        )
        noise = np.tile(CURRENT_LEARNING.noise_m_s**2 / np.minimum(weight, 1.0), 2)
        seen = np.concatenate([rows[:, 2], rows[:, 3]])
        places = np.ascontiguousarray(rows[:, :2])
        varying = _varying(places, self._length_m)
        likely = np.empty((len(CURRENT_LEARNING.flow_m_s), len(_MEANS_M_S)))
        alpha = np.empty((*likely.shape, len(seen)))
        for i, flow in enumerate(CURRENT_LEARNING.flow_m_s):
            likely[i], alpha[i] = _weights(flow, varying, noise, seen)
        belief = CURRENT_LEARNING.evidence_fraction * likely + self._log_prior
        belief = np.exp(belief - belief.max())
        self._belief = belief = belief / belief.sum()
        pull = np.einsum("ij,i,ijk->k", belief, np.square(CURRENT_LEARNING.flow_m_s), alpha).reshape(2, -1)
        mean = np.einsum("ij,j,ijk->k", belief, np.square(_MEANS_M_S), alpha).reshape(2, -1).sum(axis=1)
        pull = np.ascontiguousarray(pull)
        self._fit = FlowFit(length_m=self._length_m, places_ned_m=places, pull=pull, mean_m_s=mean)


def _weights(
    flow_m_s: float, varying: FloatArray, noise: FloatArray, seen: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Logarithms (means,) of how likely estimates are without and with a stream, and alpha (means, 2 n).

    Without the uniform part the covariance is A; with it A + m^2 E E', E the two directions: one factorisation serves
    both (matrix inversion lemma).
    """
    n = len(seen) // 2
    a = varying * flow_m_s**2
    a[np.diag_indices_from(a)] += noise
    log_root = np.log(np.linalg.cholesky(a).diagonal()).sum()
    right = np.zeros((2 * n, 3))
    right[:, 0], right[:n, 1], right[n:, 2] = seen, 1.0, 1.0
    solved = np.linalg.solve(a, right)
    both = solved[:, 1:]
    inner = np.stack([both[:n].sum(axis=0), both[n:].sum(axis=0)])
    pulled = np.array([solved[:n, 0].sum(), solved[n:, 0].sum()])
    likely, alpha = np.empty(len(_MEANS_M_S)), np.empty((len(_MEANS_M_S), 2 * n))
    for j, mean in enumerate(_MEANS_M_S):
        gain = np.eye(2) / mean**2 + inner
        alpha[j] = solved[:, 0] - both @ np.linalg.solve(gain, pulled)
        stream = 0.5 * math.log(float(np.linalg.det(gain))) + 2.0 * math.log(mean)
        likely[j] = -0.5 * float(seen @ alpha[j]) - log_root - stream
    return likely, alpha


def _varying(places: FloatArray, length_m: float) -> FloatArray:
    """(2 n, 2 n) covariance of north and east components at places (n, 2) of a varying part of 1 m/s, the curl of a
    streamfunction of variance length^2."""
    n, scale = len(places), 1.0 / length_m
    dx, dy = ((places[:, axis, None] - places[None, :, axis]) * scale for axis in (0, 1))
    bell = np.exp(-0.5 * (dx * dx + dy * dy))
    out = np.empty((2 * n, 2 * n))
    out[:n, :n] = bell * (1.0 - dy * dy)
    out[n:, n:] = bell * (1.0 - dx * dx)
    out[:n, n:] = out[n:, :n] = bell * dx * dy
    return out


def narrowest_width_m(fence: Fence) -> float | None:
    """Smaller side of the box round the smallest inclusion, None in open water."""
    widths = []
    for shape in fence.inclusions:
        if isinstance(shape, Circle):
            widths.append(2.0 * float(shape.radius_m))
        else:
            corners = np.asarray(shape.vertices_ned_m, dtype=float)
            widths.append(float((corners.max(axis=0) - corners.min(axis=0)).min()))
    return min(widths) if widths else None
