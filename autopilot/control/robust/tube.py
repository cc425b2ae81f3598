"""The tube: covariance of the deviation from the plan under disturbances and ancillary feedback.

Per planned surge speed the error follows e' = (A + B K) e + G w, with w a first-order Gauss-Markov process per
channel: disturbances longer than its correlation time are absorbed by the estimator (as current), shorter ones are
filtered by the mass. The covariance of e grows from zero along the prediction (zoRO, Zanelli et al. 2021: P_{j+1} = (A
+ B K) P_j (A + B K)^T + G W G^T, here with the dynamics of w) and settles within two seconds, faster than speed
changes: growth is tabulated once per speed and node for unit variances, and a control step only mixes and interpolates
the table. The covariance of the estimate is added at all nodes: the feedback acts on the estimate and does not reduce
its error.

Back-offs are constant for one QP, as the real-time iteration is one QP.
"""

import math
from typing import cast

import numpy as np

from autopilot.control.nmpc.grid import TimeGrid
from autopilot.control.path.reference import unknown_speed_m_s
from autopilot.control.robust.ancillary import SURGES_M_S, Ancillary
from autopilot.control.robust.disturbance import DisturbanceBound, EstimateSpread, channel_variances
from autopilot.control.robust.error_model import CHANNELS, disturbance_matrix, error_jacobian, input_matrix
from autopilot.control.robust.riccati import exponential
from autopilot.control.robust.robust_tuning import TUBE
from autopilot.control.robust.tightening import BackOffs, FixedMargins
from autopilot.core import compiled
from autopilot.core.frames import FloatArray
from autopilot.core.messages import NavState
from autopilot.core.model4 import NX, YAW, Model4, R, U, V, W, X, Y, Z
from autopilot.core.params import ParamSet

SPEED_SHARE = TUBE.estimate_speed_sigmas / TUBE.band_sigmas


class TubeTable:
    """``variance`` (speeds, nodes, STATES_OUT + thrusters, GROUPS): variances of error and feedback thrust for unit
    disturbances of each group.
    """

    def __init__(self, model: Model4, grid: TimeGrid, ancillary: Ancillary) -> None:
        self.variance = _growth(model, grid, ancillary)
        self.first_m_s, self.step_m_s = float(SURGES_M_S[0]), float(SURGES_M_S[1] - SURGES_M_S[0])

    def at_rest(self) -> FloatArray:
        """Rows of zero surge (nodes, STATES_OUT + thrusters, GROUPS), interpolated."""
        place = (0.0 - self.first_m_s) / self.step_m_s
        low = int(place)
        below, above = self.variance[low], self.variance[low + 1]
        return cast(FloatArray, below + (place - low) * (above - below))


def _growth(model: Model4, grid: TimeGrid, ancillary: Ancillary) -> FloatArray:
    """Covariances at multiples of GROWTH_STEP_S, read off at the nodes."""
    speeds, size = len(SURGES_M_S), NX + CHANNELS
    rate = np.array([TUBE.force_correlation_s] * 4 + [TUBE.current_correlation_s] * 3)
    system, b = np.zeros((speeds, size, size)), input_matrix(model)
    for i, surge in enumerate(SURGES_M_S):
        nu = np.array([surge, 0.0, 0.0, 0.0])
        system[i, :NX, :NX] = error_jacobian(model, nu) + b @ ancillary.gains[i]
        system[i, :NX, NX:] = disturbance_matrix(model, nu)
        system[i, NX:, NX:] = -np.diag(1.0 / rate)
    step = exponential(system * TUBE.growth_step_s)[:, None]
    fade = 1.0 - np.exp(-2.0 * TUBE.growth_step_s / rate)
    member = np.zeros((TUBE.groups, CHANNELS))
    member[0, :3] = member[1, 3] = member[2, 4:] = 1.0
    p, news = np.zeros((speeds, TUBE.groups, size, size)), np.zeros((TUBE.groups, size, size))
    for g in range(TUBE.groups):
        p[:, g, NX:, NX:] = np.diag(member[g])
        news[g, NX:, NX:] = np.diag(member[g] * fade)
    count = int(np.ceil(grid.t_s[-1] / TUBE.growth_step_s)) + 1
    rows = np.empty((count + 1, speeds, TUBE.groups, TUBE.states_out + model.thrusters))
    for k in range(count + 1):
        rows[k] = _outputs(p[..., :NX, :NX], ancillary.gains[:, None])
        p = step @ p @ np.swapaxes(step, -1, -2) + news
    place = grid.t_s / TUBE.growth_step_s
    low = np.minimum(place.astype(np.intp), count - 1)
    fraction = (place - low)[:, None, None, None]
    at_nodes = rows[low] * (1.0 - fraction) + rows[low + 1] * fraction
    return np.ascontiguousarray(at_nodes.transpose(1, 0, 3, 2))


def _outputs(p: FloatArray, gains: FloatArray) -> FloatArray:
    """(..., STATES_OUT + thrusters) of covariances (..., 8, 8)."""
    picks = ((X, X), (X, Y), (Y, Y), (Z, Z), (YAW, YAW), (U, U), (U, V), (V, V), (W, W), (R, R))
    thrust = np.einsum("...ij,...jk,...ik->...i", gains, p, gains)
    return np.concatenate([np.stack([p[..., i, j] for i, j in picks], axis=-1), thrust], axis=-1)


class TubeMargins:
    """Back-offs from the tube, at least the fixed margins (which also cover the motion between the nodes)."""

    def __init__(self, model: Model4, grid: TimeGrid, ancillary: Ancillary, fixed: FixedMargins) -> None:
        self.table = TubeTable(model, grid, ancillary)
        self._fixed = fixed
        self._speeds, nodes, width, _ = self.table.variance.shape
        self._n, self._thrusters = nodes - 1, width - TUBE.states_out
        self._call = compiled.load().tube_back_offs
        self._given, self._states = np.zeros(TUBE.given), np.zeros((5, self._n - 1))
        self._thrust = np.zeros((self._n, self._thrusters))
        self._given[18:26] = (
            *(TUBE.disc_sigmas, TUBE.band_sigmas, TUBE.band_sigmas, TUBE.band_sigmas, TUBE.band_sigmas),
            *(self.table.first_m_s, self.table.step_m_s, TUBE.band_sigmas),
        )
        arrays = self._given, self._states, self._thrust
        self._addresses = tuple(array.ctypes.data for array in (self.table.variance, *arrays))
        self._plan: FloatArray | None = None
        self._plan_address = 0
        self._nav: NavState | None = None
        self._spread = EstimateSpread(
            position_m2=0.0, depth_m2=0.0, planar_m2_s2=0.0, heave_m2_s2=0.0, current_m2_s2=0.0
        )
        self._params_seen: tuple[ParamSet, int] | None = None
        self._bound = DisturbanceBound(force_n=0.0, moment_n_m=0.0, current_m_s=0.0)
        self._mix = (0.0,) * TUBE.groups
        self._rest = self.table.at_rest()[-2, 5:8].tolist()

    def rest_speed_m_s(self, nav: NavState, params: ParamSet) -> float:
        """Back-off of the planar speed [m/s] at node N-1 for a vehicle at rest."""
        self._refresh(nav, params)
        a, b, c = self._mix
        xx, xy, yy = (row[0] * a + row[1] * b + row[2] * c for row in self._rest)
        half = 0.5 * (xx - yy)
        size = 0.5 * (xx + yy) + math.sqrt(half * half + xy * xy)
        wanted = TUBE.band_sigmas * math.sqrt(size + SPEED_SHARE**2 * self._spread.planar_m2_s2)
        return max(min(wanted, TUBE.largest_fraction * params["SPD_PLANAR_MAX"]), unknown_speed_m_s(params))

    def back_offs(
        self, nav: NavState, x: FloatArray, thrust_n: FloatArray, params: ParamSet, speed_fraction: float = 1.0
    ) -> BackOffs:
        """Back-offs along the plan, constant for one QP.

        ``nav``: its variance widens the margins; ``x``: (N+1, 8) planned states; ``thrust_n``: (N, n) planned [N];
        ``speed_fraction``: fraction of the planar speed's back-off that is applied, at least the fixed margin.
        ValueError if the plan has another grid.
        """
        self._refresh(nav, params)
        given, spread, fraction = self._given, self._spread, SPEED_SHARE**2
        added = (spread.position_m2, spread.depth_m2, fraction * spread.planar_m2_s2, fraction * spread.heave_m2_s2)
        given[:7] = (*self._mix, *added)
        given[26] = speed_fraction
        if x is not self._plan:
            self._plan_address = compiled.fitting("x", x, self._n + 1, NX)
            self._plan = x
        table, inputs, states, thrust = self._addresses
        self._call(table, self._speeds, self._n, self._thrusters, inputs, self._plan_address, states, thrust)
        clearance, depth, planar, heave, yaw_rate = self._states.copy()
        return BackOffs(
            clearance_m=clearance,
            depth_m=depth,
            planar_speed_m_s=planar,
            heave_m_s=heave,
            yaw_rate_rad_s=yaw_rate,
            thrust_n=self._thrust.copy(),
        )

    def _refresh(self, nav: NavState, params: ParamSet) -> None:
        """Update the mixture weights for the covariance of this estimate and for changed parameters."""
        params_seen = params, params.revision
        same = params_seen == self._params_seen
        if nav is self._nav and same:
            return
        self._nav, self._spread = nav, EstimateSpread.of(nav)
        self._params_seen, self._bound = params_seen, self._bound if same else DisturbanceBound.of(params)
        self._mix = channel_variances(self._bound, self._spread)
        if same:
            return
        fixed = self._fixed.values(params)
        band = max(params["DEPTH_MAX"] - params["DEPTH_MIN"], 0.0)
        self._given[8:18] = (
            *(fixed.clearance_m, 0.0, fixed.planar_speed_m_s, fixed.heave_m_s, fixed.yaw_rate_rad_s),
            *(
                TUBE.largest_clearance_m,
                0.5 * TUBE.largest_fraction * band,
                TUBE.largest_fraction * params["SPD_PLANAR_MAX"],
            ),
            *(TUBE.largest_fraction * params["SPD_HEAVE_MAX"], TUBE.largest_fraction * params["SPD_YAW_MAX"]),
        )
        self._given[27] = unknown_speed_m_s(params)
