"""Time grids of the prediction: uniform for comparisons, geometric for control.

A geometric grid is fine where the input is about to be applied: 20 nodes reach 8 s with a first interval of 0.1 s, and
need a quarter of the time of 80 uniform nodes for the same closed-loop behaviour.
"""

from dataclasses import dataclass

import numpy as np

from autopilot.core.frames import FloatArray

REFERENCE_DT_S = 0.1
"""Cost weights are per stage of this length; longer stages weigh proportionally more."""

MAX_RK4_STEP_S = 0.5
"""Longest RK4 step; longer intervals are split. Where the vehicle's damping asks for shorter ones, see
:func:`autopilot.control.nmpc.ocp.longest_step_s`."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class TimeGrid:
    dt_s: FloatArray
    """(N,) lengths of the intervals."""
    t_s: FloatArray
    """(N+1,) times of the nodes, the first is 0."""

    @property
    def n(self) -> int:
        """Number of intervals."""
        return len(self.dt_s)

    def substeps(self, longest_s: float = MAX_RK4_STEP_S) -> list[int]:
        """RK4 steps per interval, none longer than ``longest_s``."""
        return [max(1, int(np.ceil(dt / longest_s - 1e-9))) for dt in self.dt_s]


def grid_of(dt_s: FloatArray) -> TimeGrid:
    """The grid of these intervals (N,)."""
    return TimeGrid(dt_s=dt_s, t_s=np.concatenate(([0.0], np.cumsum(dt_s))))


def uniform_grid(n: int, dt_s: float = REFERENCE_DT_S) -> TimeGrid:
    return grid_of(np.full(n, dt_s))


def geometric_grid(n: int = 20, horizon_s: float = 8.0) -> TimeGrid:
    """A grid of ``n`` intervals that start with REFERENCE_DT_S, grow by a constant factor and sum to ``horizon_s``.

    A uniform one if ``n * REFERENCE_DT_S`` is not less than ``horizon_s``.
    """
    if n * REFERENCE_DT_S >= horizon_s:
        return uniform_grid(n, horizon_s / n)
    low, high = 1.0, horizon_s / REFERENCE_DT_S
    for _ in range(200):
        ratio = 0.5 * (low + high)
        if REFERENCE_DT_S * sum(ratio**k for k in range(n)) < horizon_s:
            low = ratio
        else:
            high = ratio
    dt_s = REFERENCE_DT_S * ratio ** np.arange(n)
    return grid_of(dt_s * (horizon_s / dt_s.sum()))


def shift_matrices(grid: TimeGrid, delta_s: float) -> tuple[FloatArray, FloatArray]:
    """Matrices that move a plan ``delta_s`` into the future on a non-uniform grid.

    The first (N+1, N+1) interpolates states linearly at ``t + delta_s`` (the last interval is extrapolated), the second
    (N, N) averages the piecewise constant inputs over the moved intervals (the last input is held).
    """
    n, t = grid.n, grid.t_s
    states = np.zeros((n + 1, n + 1))
    for row, time in enumerate(t + delta_s):
        k = min(max(int(np.searchsorted(t, time, side="right")) - 1, 0), n - 1)
        fraction = (time - t[k]) / grid.dt_s[k]
        states[row, k] += 1.0 - fraction
        states[row, k + 1] += fraction
    ends = t.copy()
    ends[-1] = np.inf
    start, stop = t[:-1, None] + delta_s, t[1:, None] + delta_s
    overlap = np.minimum(stop, ends[None, 1:]) - np.maximum(start, ends[None, :-1])
    inputs = np.maximum(overlap, 0.0) / grid.dt_s[:, None]
    return states, inputs
