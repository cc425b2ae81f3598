"""Tightening of the limits of the prediction, node by node."""

from dataclasses import dataclass

import numpy as np

from autopilot.control.nmpc.grid import TimeGrid
from autopilot.control.path.reference import unknown_speed_m_s
from autopilot.core.frames import FloatArray
from autopilot.core.messages import NavState
from autopilot.core.params import ParamSet

YAW_RATE_SHARE = 0.92
HEAVE_SHARE = 0.92
"""Shares of the heave and yaw rate limits that the optimiser may use; the rest is for estimation error."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class BackOffs:
    """Back-off of every limit at nodes 1 .. N-1 (thrust: at nodes 0 .. N-1). Never negative."""

    clearance_m: FloatArray
    """(N-1,) beyond the body radius."""
    depth_m: FloatArray
    """(N-1,)"""
    planar_speed_m_s: FloatArray
    """(N-1,)"""
    heave_m_s: FloatArray
    """(N-1,)"""
    yaw_rate_rad_s: FloatArray
    """(N-1,)"""
    thrust_n: FloatArray
    """(N, n)"""


@dataclass(frozen=True, slots=True, kw_only=True)
class FixedValues:
    """Back-offs that are equal at every node."""

    clearance_m: float
    planar_speed_m_s: float
    heave_m_s: float
    yaw_rate_rad_s: float


class FixedMargins:
    """Equal margins at every node: MPC_MARGIN, MPC_SPEED_MARGIN and fractions of the other speed limits."""

    def __init__(self, grid: TimeGrid, thrusters: int) -> None:
        self._n, self._thrusters = grid.n, thrusters
        self._values: FixedValues | None = None
        self._back_offs: BackOffs | None = None

    def values(self, params: ParamSet) -> FixedValues:
        return FixedValues(
            clearance_m=params["MPC_MARGIN"],
            planar_speed_m_s=unknown_speed_m_s(params),
            heave_m_s=(1.0 - HEAVE_SHARE) * params["SPD_HEAVE_MAX"],
            yaw_rate_rad_s=(1.0 - YAW_RATE_SHARE) * params["SPD_YAW_MAX"],
        )

    def back_offs(self, nav: NavState, x: FloatArray, thrust_n: FloatArray, params: ParamSet) -> BackOffs:
        values = self.values(params)
        if self._back_offs is None or values != self._values:
            self._values = values
            nodes = self._n - 1
            self._back_offs = BackOffs(
                clearance_m=np.full(nodes, values.clearance_m),
                depth_m=np.zeros(nodes),
                planar_speed_m_s=np.full(nodes, values.planar_speed_m_s),
                heave_m_s=np.full(nodes, values.heave_m_s),
                yaw_rate_rad_s=np.full(nodes, values.yaw_rate_rad_s),
                thrust_n=np.zeros((self._n, self._thrusters)),
            )
        return self._back_offs

    def clearance_m(self, params: ParamSet) -> float:
        return params["MPC_MARGIN"]
