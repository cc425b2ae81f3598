"""A forecast without a map: a planar incompressible flow through what the vehicle has estimated where.

Water that goes one way comes back another: the flow is taken as the curl of a random streamfunction (a Gaussian process
with a squared exponential kernel), so that whatever is predicted between and beyond the places visited is free of
divergence. A vehicle that has felt a jet expects the return flow beside it before it has been there. Far from all
places visited the prediction falls back to a uniform flow. How much of the flow varies at all is judged by the evidence
(marginal likelihood) of what was estimated so far.
"""

import math
from dataclasses import dataclass

import numpy as np

from autopilot.control.currents import Revision, correction_share
from autopilot.core.frames import FloatArray
from autopilot.core.geometry import Circle, Fence
from autopilot.core.messages import NavHealth, NavState

FLOW_M_S = (0.2, 0.1, 0.03)
"""Standard deviations of the varying part of the flow that are tried, the one before anything is known first."""

CLOSED_MEAN_M_S = 0.03
OPEN_MEAN_M_S = 0.3
"""Standard deviation of the uniform part: in a basin that a fence closes, and in open water."""

NOISE_M_S = 0.03
"""Standard deviation of a cell's mean estimate: the estimate lags, and it carries what the model lacks."""

LENGTH_SHARE = 0.25
"""Correlation length over the narrowest width of the workspace: a jet and its return flow side by side need it."""

OPEN_LENGTH_M = 6.0
"""Without a workspace: eddies and jets that a small vehicle meets within minutes."""

EVIDENCE_LEAD = 2.0
"""Another standard deviation is taken when what was estimated is e to this many times as likely with it."""

SHORTEST_M, LONGEST_M = 0.3, 50.0

CELLS_PER_LENGTH = 2.5
MAX_CELLS = 100
FORGET_S = 900.0
"""Time in which what was learned loses its weight by e."""

REFRESH_S = 1.0
"""The fit is made anew at most so often."""

FULL_WEIGHT_S = 0.5
"""An estimate counts in full after so much time in its cell."""


@dataclass(slots=True)
class _Cell:
    """Weighted sums of what was estimated in one square."""

    weight_s: float
    moment: FloatArray
    """(4,) of north, east [m] and current north, east [m/s]"""
    seen_us: int


class LearnedCurrent:
    """See :class:`autopilot.control.currents.CurrentForecast`."""

    def __init__(self) -> None:
        self._length_m, self._mean_m_s = OPEN_LENGTH_M, OPEN_MEAN_M_S
        self._flow_m_s = FLOW_M_S[0]
        self._last_us: int | None = None
        self._revision = Revision()
        self._forget()

    def _forget(self) -> None:
        self._cells: dict[tuple[int, int], _Cell] = {}
        self._fitted_us: int | None = None
        self._flow_m_s = FLOW_M_S[0]
        self._places: FloatArray = np.zeros((0, 2))
        self._alpha: FloatArray = np.zeros(0)

    def within(self, fence: Fence) -> None:
        """Take the correlation length from the size of the workspace. Another one begins with nothing learned."""
        width = narrowest_width_m(fence)
        length = OPEN_LENGTH_M if width is None else LENGTH_SHARE * width
        length = min(max(length, SHORTEST_M), LONGEST_M)
        mean = OPEN_MEAN_M_S if width is None else CLOSED_MEAN_M_S
        if (length, mean) != (self._length_m, self._mean_m_s):
            self._length_m, self._mean_m_s = length, mean
            self._forget()

    def view(self, nav: NavState) -> NavState:
        """Unchanged; learns from it."""
        elapsed_s = 0.0 if self._last_us is None else (nav.t_us - self._last_us) * 1e-6
        self._last_us = nav.t_us
        if nav.health is not NavHealth.GOOD or not bool(np.isfinite(nav.current_ned_m_s).all()):
            return nav
        if elapsed_s > 0.0 or not self._cells:
            self._learn(nav, min(max(elapsed_s, 0.01), 0.2))
        if self._fitted_us is None or nav.t_us - self._fitted_us >= REFRESH_S * 1e6:
            self._fitted_us = nav.t_us
            self._fit(nav.t_us)
        return nav

    def fill(self, nav: NavState, pos_ned_m: FloatArray, t_s: FloatArray, out: FloatArray) -> None:
        """Fitted flow, corrected by what the estimate says it lacks here and now."""
        out[:, :2] = self._flow(pos_ned_m[:, :2])
        out[:, 2] = nav.current_ned_m_s[2]
        lack = nav.current_ned_m_s[:2] - self._flow(np.asarray(nav.pos_ned_m, dtype=float)[None, :2])[0]
        out[:, :2] += correction_share(nav, pos_ned_m, t_s, self._length_m)[:, None] * lack

    def revision(self, nav: NavState) -> int:
        """The estimate surprises by what has not been learned here."""
        here = self._flow(np.asarray(nav.pos_ned_m, dtype=float)[None, :2])[0]
        lack = np.array([nav.current_ned_m_s[0] - here[0], nav.current_ned_m_s[1] - here[1], 0.0])
        return self._revision.look(lack, nav.t_us * 1e-6)

    def _learn(self, nav: NavState, duration_s: float) -> None:
        size = self._length_m / CELLS_PER_LENGTH
        x, y = float(nav.pos_ned_m[0]), float(nav.pos_ned_m[1])
        key = (math.floor(x / size), math.floor(y / size))
        cell = self._cells.pop(key, None)
        if cell is None:
            cell = _Cell(0.0, np.zeros(4), nav.t_us)
            if len(self._cells) >= MAX_CELLS:
                del self._cells[next(iter(self._cells))]
        fade = math.exp((cell.seen_us - nav.t_us) * 1e-6 / FORGET_S)
        row = np.array([x, y, nav.current_ned_m_s[0], nav.current_ned_m_s[1]])
        cell.weight_s = fade * cell.weight_s + duration_s
        cell.moment = fade * cell.moment + duration_s * row
        cell.seen_us = nav.t_us
        self._cells[key] = cell

    def _fit(self, now_us: int) -> None:
        """Solve (K + noise) alpha = estimates."""
        cells = list(self._cells.values())
        rows = np.array([cell.moment / cell.weight_s for cell in cells])
        weight = np.array(
            [cell.weight_s * math.exp((cell.seen_us - now_us) * 1e-6 / FORGET_S) / FULL_WEIGHT_S for cell in cells]
        )
        noise = np.tile(NOISE_M_S**2 / np.minimum(weight, 1.0), 2)
        seen = np.concatenate([rows[:, 2], rows[:, 3]])
        self._places = np.ascontiguousarray(rows[:, :2])
        varying, mean = self._parts(self._places, self._places)
        found = {each: self._weights(each, varying, mean, noise, seen) for each in FLOW_M_S}
        best = max(found, key=lambda each: found[each][0])
        if found[best][0] > found[self._flow_m_s][0] + EVIDENCE_LEAD:
            self._flow_m_s = best
        self._alpha = found[self._flow_m_s][1]

    @staticmethod
    def _weights(
        flow_m_s: float, varying: FloatArray, mean: FloatArray, noise: FloatArray, seen: FloatArray
    ) -> tuple[float, FloatArray]:
        """Logarithm of how likely the estimates are (Rasmussen and Williams 2006, eq. 5.8), and alpha."""
        k = varying.copy()
        k *= flow_m_s**2
        k += mean
        k[np.diag_indices_from(k)] += noise
        root = np.linalg.cholesky(k)
        alpha: FloatArray = np.asarray(np.linalg.solve(k, seen), dtype=np.float64)
        return float(-0.5 * seen @ alpha - np.log(root.diagonal()).sum()), alpha

    def _flow(self, places: FloatArray) -> FloatArray:
        """(n, 2) mean of the process at places (n, 2): the covariance of :meth:`_parts` times alpha."""
        out = np.zeros((len(places), 2))
        if len(self._places) == 0:
            return out
        north, east = self._alpha.reshape(2, -1)
        dx, dy, bell = self._bell(places, self._places)
        across = bell * dx * dy
        flow, mean = self._flow_m_s**2, self._mean_m_s**2
        out[:, 0] = flow * ((bell * (1.0 - dy * dy)) @ north + across @ east) + mean * float(north.sum())
        out[:, 1] = flow * ((bell * (1.0 - dx * dx)) @ east + across @ north) + mean * float(east.sum())
        return out

    def _bell(self, a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(n, m) distances north and east in correlation lengths, and their Gaussian."""
        scale = 1.0 / self._length_m
        dx = (a[:, 0, None] - b[None, :, 0]) * scale
        dy = (a[:, 1, None] - b[None, :, 1]) * scale
        return dx, dy, np.exp(-0.5 * (dx * dx + dy * dy))

    def _parts(self, a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(2 n, 2 m) covariance of north and east components at places (n, 2) and (m, 2): of a varying part of 1 m/s,
        the curl of a streamfunction of variance length^2, and of the uniform part."""
        n, m = len(a), len(b)
        dx, dy, bell = self._bell(a, b)
        varying, mean = np.empty((2 * n, 2 * m)), np.zeros((2 * n, 2 * m))
        varying[:n, :m] = bell * (1.0 - dy * dy)
        varying[n:, m:] = bell * (1.0 - dx * dx)
        varying[:n, m:] = varying[n:, :m] = bell * dx * dy
        mean[:n, :m] = mean[n:, m:] = self._mean_m_s**2
        return varying, mean


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
