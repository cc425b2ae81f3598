"""Constraint tightening by Lipschitz growth of the open-loop prediction error (Limon Marruedo, Alamo and Camacho
2002).

gamma_{j+1} = L_j gamma_j + w_j; for equal steps gamma_j = w (L^j - 1)/(L - 1). The tightened set X_j is X eroded by
gamma_j. L is the largest norm of the transition matrix on the set of allowed velocities, in the Euclidean or a scaled
norm. Feedback is not credited: the sway-yaw pair is open-loop unstable ahead, and the bound becomes vacuous at useful
horizons. :func:`lipschitz_report` gives the first node with an empty set.
"""

from dataclasses import dataclass

import numpy as np

from autopilot.control.nmpc.grid import TimeGrid
from autopilot.control.robust.disturbance import DisturbanceBound, EstimateSpread
from autopilot.control.robust.error_model import error_jacobian
from autopilot.control.robust.riccati import exponential
from autopilot.control.robust.robust_tuning import TUBE
from autopilot.control.robust.tightening import BackOffs, FixedMargins
from autopilot.core.frames import FloatArray
from autopilot.core.messages import NavState
from autopilot.core.model4 import NX, Model4, R, U, W, X, Y, Z
from autopilot.core.params import ParamSet

UNIT_SCALES = (1.0,) * NX
TUNED_SCALES = (1.0, 1.0, 1.0, 4.5, 0.25, 0.25, 1.0, 1.25)
"""State = scale * scaled state: the norm in which the error grows least (coordinate search, LBV150 at 0.5 m/s)."""

SPEED_SAMPLES = 5
"""Samples of surge, sway and yaw rate for the norm of the transition matrix."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LipschitzReport:
    """Growth of the error bound along the horizon and the node at which a tightened set is empty."""

    lipschitz: FloatArray
    """(N,) of every interval."""
    t_s: FloatArray
    """(N+1,)"""
    gamma: FloatArray
    """(N+1,) in the scaled norm."""
    back_off: FloatArray
    """(N+1, 8) of every state."""
    empty_node: int | None
    """First node whose tightened set is empty, None = none is."""
    limited_by: str
    """Which limit empties it, "" if none does."""

    @property
    def text(self) -> str:
        if self.empty_node is None:
            return f"Lipschitz sets hold to the horizon's end at {self.t_s[-1]:.1f} s"
        when = f"node {self.empty_node} ({self.t_s[self.empty_node]:.2f} s)"
        return f"Lipschitz sets are empty from {when}: {self.limited_by}"


def lipschitz_constants(model: Model4, dt_s: FloatArray, params: ParamSet, scales: tuple[float, ...]) -> FloatArray:
    """(N,) largest norm of the transition over each interval, on the set of allowed velocities."""
    speed, turn = params["SPD_PLANAR_MAX"], params["SPD_YAW_MAX"]
    axis = np.linspace(-1.0, 1.0, SPEED_SAMPLES)
    places = [(u, v, r) for u in axis for v in axis for r in axis if u * u + v * v <= 1.0 + 1e-9]
    a = np.array([error_jacobian(model, np.array([speed * u, speed * v, 0.0, turn * r])) for u, v, r in places])
    d = np.array(scales)
    scaled = a * d[None, None, :] / d[None, :, None]
    unique, where = np.unique(dt_s, return_inverse=True)
    norms = np.array([np.linalg.norm(exponential(scaled * dt), 2, axis=(-2, -1)).max() for dt in unique])
    return norms[where]


def lipschitz_report(
    model: Model4,
    grid: TimeGrid,
    params: ParamSet,
    bound: DisturbanceBound,
    *,
    start_m: float = 0.0,
    scales: tuple[float, ...] = TUNED_SCALES,
    free_m: float | None = None,
    constants: FloatArray | None = None,
) -> LipschitzReport:
    """Error bound along the horizon for bounded disturbances.

    Parameters
    ----------
    model
        The 4-DoF model.
    grid
        Prediction grid of N intervals.
    params
        Limits on speeds and depth.
    bound
        Disturbance bounds.
    start_m
        Error of the estimated position [m].
    scales
        (8,) state = scale * scaled state, for the norm.
    free_m
        Half the width of the workspace minus the body radius [m]; None in open water.
    constants
        (N,) Lipschitz constants, as of :func:`lipschitz_constants`; None computes them.
    """
    d = np.array(scales)
    growth = lipschitz_constants(model, grid.dt_s, params, scales) if constants is None else constants
    m = np.array(model.mass_kg)
    rate = np.zeros(NX)
    rate[[X, Y, Z]] = bound.current_m_s
    rate[U:] = np.array([bound.force_n] * 3 + [bound.moment_n_m]) / m
    per_second = float(np.linalg.norm(rate / d))
    gamma = np.empty(grid.n + 1)
    gamma[0] = start_m / d[X]
    for j in range(grid.n):
        gamma[j + 1] = growth[j] * gamma[j] + per_second * grid.dt_s[j]
    back_off = gamma[:, None] * d
    limits = {
        "heave speed": (W, params["SPD_HEAVE_MAX"]),
        "planar speed": (U, params["SPD_PLANAR_MAX"]),
        "yaw rate": (R, params["SPD_YAW_MAX"]),
        "depth band": (Z, 0.5 * (params["DEPTH_MAX"] - params["DEPTH_MIN"])),
    }
    if free_m is not None:
        limits["clearance"] = (X, free_m)
    first, name = grid.n + 1, ""
    for label, (index, available) in limits.items():
        beyond = np.flatnonzero(back_off[:, index] >= available)
        if len(beyond) and int(beyond[0]) < first:
            first, name = int(beyond[0]), label
    return LipschitzReport(
        lipschitz=growth,
        t_s=grid.t_s,
        gamma=gamma,
        back_off=back_off,
        empty_node=first if name else None,
        limited_by=name,
    )


class LipschitzMargins:
    """Back-offs from Lipschitz growth; from the node on that is empty they stay at the last that is not."""

    def __init__(self, model: Model4, grid: TimeGrid, fixed: FixedMargins) -> None:
        self._model, self._grid, self._fixed = model, grid, fixed
        self._limits: tuple[float, ...] = ()
        self._constants = np.ones(grid.n)
        self._key: tuple[float, ...] = ()
        self._back_offs: BackOffs | None = None

    def report(self, nav: NavState | None, params: ParamSet) -> LipschitzReport:
        """Growth for the present parameters and estimate."""
        spread = None if nav is None else EstimateSpread.of(nav)
        limits = (params["SPD_PLANAR_MAX"], params["SPD_YAW_MAX"])
        if limits != self._limits:
            self._limits = limits
            self._constants = lipschitz_constants(self._model, self._grid.dt_s, params, TUNED_SCALES)
        bound = DisturbanceBound.of(params)
        start_m = 0.0
        if spread is not None:
            start_m = TUBE.disc_sigmas * float(np.sqrt(spread.position_m2))
            more = TUBE.disc_sigmas * float(np.sqrt(spread.current_m2_s2))
            bound = DisturbanceBound(
                force_n=bound.force_n, moment_n_m=bound.moment_n_m, current_m_s=bound.current_m_s + more
            )
        return lipschitz_report(self._model, self._grid, params, bound, start_m=start_m, constants=self._constants)

    def back_offs(self, nav: NavState, x: FloatArray, thrust_n: FloatArray, params: ParamSet) -> BackOffs:
        report = self.report(nav, params)
        last = self._grid.n - 1 if report.empty_node is None else max(report.empty_node - 1, 0)
        rows = report.back_off[np.minimum(np.arange(1, self._grid.n), last)]
        fixed = self._fixed.back_offs(nav, x, thrust_n, params)
        return BackOffs(
            clearance_m=np.maximum(rows[:, X], fixed.clearance_m),
            depth_m=np.maximum(rows[:, Z], fixed.depth_m),
            planar_speed_m_s=np.maximum(rows[:, U], fixed.planar_speed_m_s),
            heave_m_s=np.maximum(rows[:, W], fixed.heave_m_s),
            yaw_rate_rad_s=np.maximum(rows[:, R], fixed.yaw_rate_rad_s),
            thrust_n=np.zeros((self._grid.n, self._model.thrusters)),
        )
