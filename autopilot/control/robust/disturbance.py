"""Disturbance bounds from parameters, and the covariance of the estimate."""

import math
from dataclasses import dataclass

import numpy as np

from autopilot.control.robust.error_model import CHANNELS
from autopilot.control.robust.robust_tuning import DISTURBANCE
from autopilot.core.frames import FloatArray
from autopilot.core.messages import NavState
from autopilot.core.params import ParamSet


@dataclass(frozen=True, slots=True, kw_only=True)
class DisturbanceBound:
    """Bounds of the unmodelled forces that remain after the estimator has absorbed their constant part."""

    force_n: float
    """Per axis."""
    moment_n_m: float
    current_m_s: float
    """Error of the estimated current beyond its standard deviation, per axis."""

    @classmethod
    def of(cls, params: ParamSet) -> "DisturbanceBound":
        """From the parameters MPC_W_FORCE, MPC_W_MOMENT, MPC_W_CURRENT."""
        return cls(
            force_n=params["MPC_W_FORCE"], moment_n_m=params["MPC_W_MOMENT"], current_m_s=params["MPC_W_CURRENT"]
        )

    def per_channel(self) -> FloatArray:
        """(7,) bounds in the order of :data:`autopilot.control.robust.error_model.CHANNELS`."""
        bound = np.empty(CHANNELS)
        bound[:3], bound[3], bound[4:] = self.force_n, self.moment_n_m, self.current_m_s
        return bound


@dataclass(frozen=True, slots=True, kw_only=True)
class EstimateSpread:
    """Variances of the estimate, of horizontal axes the larger one."""

    position_m2: float
    depth_m2: float
    planar_m2_s2: float
    heave_m2_s2: float
    current_m2_s2: float

    @classmethod
    def of(cls, nav: NavState) -> "EstimateSpread":
        """From ``NavState.variance``. A variance that is not finite counts as the limit."""
        v = [x if math.isfinite(x) and x > 0.0 else 0.0 if x == 0.0 else math.inf for x in nav.variance.tolist()]
        return cls(
            position_m2=min(max(v[0], v[1]), DISTURBANCE.position_variance_limit_m2),
            depth_m2=min(v[2], DISTURBANCE.position_variance_limit_m2),
            planar_m2_s2=min(max(v[6], v[7]), DISTURBANCE.velocity_variance_limit_m2_s2),
            heave_m2_s2=min(v[8], DISTURBANCE.velocity_variance_limit_m2_s2),
            current_m2_s2=min(max(v[9], v[10]), DISTURBANCE.velocity_variance_limit_m2_s2),
        )


def channel_variances(bound: DisturbanceBound, spread: EstimateSpread) -> tuple[float, ...]:
    """(3,) variances of force [N^2], moment [N^2 m^2] and current error [m^2/s^2]."""
    return (
        (bound.force_n / DISTURBANCE.bound_sigmas) ** 2,
        (bound.moment_n_m / DISTURBANCE.bound_sigmas) ** 2,
        (bound.current_m_s / DISTURBANCE.bound_sigmas) ** 2 + spread.current_m2_s2,
    )
