"""The extended Kalman filter: filterpy's, with our motion, our gate and pure functions around it."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter

from autopilot.core.frames import FloatArray
from estimator.core import Innovation
from estimator.inertial import Mode, Step
from estimator.measurement import CHI2_999, Measurement, Moment
from estimator.motion import add_model, fill_jacobian, moved, reset_model
from estimator.states import (
    CURRENT_DOWN,
    HEADING_OFFSET,
    INITIAL_SIGMA,
    INITIAL_SIGMA_CURRENT_DOWN_M_S,
    NX,
    POS,
    VEL,
    YAW,
    FilterState,
)
from estimator.tuning import process_noise

VERTICAL_CURRENT_VARIANCE = 0.02**2
"""The vertical current is taken as zero unless it is a state; this is how wrong that may be [m^2/s^2]."""

RELOCATED_SIGMA_VEL_M_S = 0.1
"""Of the velocity after a reset, which is the mean over the last fixes."""


class _Filter(ExtendedKalmanFilter):  # type: ignore[misc]  # filterpy has no type hints
    """filterpy's filter with our motion: ``u`` of predict() is the step."""

    x: FloatArray
    P: FloatArray
    driven = False
    """Whether F is that of a step that the vehicle model made."""

    def predict_x(self, u: Any = 0) -> None:
        """Move the state and linearise about where it was."""
        if self.driven:
            reset_model(self.F)
            self.driven = False
        fill_jacobian(self.F, self.x, u)
        if u.slope is not None:
            add_model(self.F, self.x, u, u.slope)
            self.driven = True
        self.x = np.array(moved(self.x, u))


class KalmanCore:
    """:class:`estimator.core.FilterCore` by filterpy: predict() and update() are its own."""

    def __init__(self, *, current_3d: bool = False) -> None:
        """``current_3d``: the vertical current is a state."""
        self._kf = _Filter(NX, 4)
        self._noise = {mode: process_noise(mode, current_3d=current_3d) for mode in Mode}
        self._sigma = INITIAL_SIGMA.copy()
        self._down_variance = VERTICAL_CURRENT_VARIANCE
        if current_3d:
            self._sigma[CURRENT_DOWN] = INITIAL_SIGMA_CURRENT_DOWN_M_S
            self._down_variance = 0.0
        self._kf.Q = np.zeros((NX, NX))

    def start(self, x: FloatArray) -> FilterState:
        """Diagonal covariance."""
        return FilterState(x, np.diag(self._sigma**2))

    def predict(self, state: FilterState, step: Step) -> FilterState:
        """P = F P F' + Q dt"""
        kf = self._kf
        kf.x, kf.P = state
        np.multiply(self._noise[step.mode], step.dt_s, out=kf.Q)
        kf.predict(step)
        return FilterState(kf.x, kf.P)

    def innovation(self, state: FilterState, measurement: Measurement, moment: Moment, after_s: float) -> Innovation:
        """filterpy's update (Joseph form), and a joint chi-square test at 99.9 % of whether it may be kept.

        filterpy knows no gate: the residual's distance is known only once it has updated. Nothing is lost by that:
        states are never changed in place, so a rejected one is simply not taken."""
        kf = self._kf
        kf.x, kf.P = state
        about = (moment, after_s)
        kf.update(
            measurement.z,
            measurement.jacobian,
            measurement.predicted,
            R=measurement.noise,
            args=about,
            hx_args=about,
            residual=measurement.residual,
        )
        ratio = kf.mahalanobis**2 / CHI2_999[len(kf.y)]
        p = kf.P + kf.P.T
        p *= 0.5
        return Innovation(kf.y, kf.S.diagonal(), ratio, kf.K, kf.K.dot(kf.S), FilterState(kf.x, p))

    def correct(self, state: FilterState, innovation: Innovation) -> FilterState:
        """What filterpy's update has made of it."""
        assert innovation.after is not None
        return innovation.after

    def relocate(self, state: FilterState, pose: FloatArray, noise: FloatArray, vel_ned_m_s: FloatArray) -> FilterState:
        """The pose gets the fix's covariance, correlations of pose and velocity are dropped."""
        x, p = state.x.copy(), state.p.copy()
        x[HEADING_OFFSET] -= pose[3] - x[YAW]
        x[POS], x[YAW], x[VEL] = pose[:3], pose[3], vel_ned_m_s
        for part in (range(4), range(4, 7)):
            p[part, :] = 0.0
            p[:, part] = 0.0
        p[:4, :4] = noise
        p[VEL, VEL] = np.eye(3) * RELOCATED_SIGMA_VEL_M_S**2
        return FilterState(x, p)

    def reopen(
        self, state: FilterState, part: slice, variance: float, value: Sequence[float] | None = None
    ) -> FilterState:
        """See :class:`estimator.core.FilterCore`."""
        x, p = state.x, state.p.copy()
        p[part, :] = 0.0
        p[:, part] = 0.0
        p[part, part] = np.eye(part.stop - part.start) * variance
        if value is not None:
            x = x.copy()
            x[part] = value
        return FilterState(x, p)

    def variance(self, state: FilterState, cos_yaw: float, sin_yaw: float) -> list[float]:
        """From the covariance; velocity relative to the water with its correlation between ground and current."""
        p = state.p
        pn, pe, pd, yaw, vn, ve, vd, _, _, _, _, cn, ce, _, _, _, _, _, cd, _, _ = p.diagonal().tolist()
        nn = vn + cn - 2.0 * p.item(4, 11)
        ee = ve + ce - 2.0 * p.item(5, 12)
        ne = p.item(4, 5) + p.item(11, 12) - p.item(4, 12) - p.item(5, 11)
        c2, s2, mix = cos_yaw * cos_yaw, sin_yaw * sin_yaw, 2.0 * cos_yaw * sin_yaw * ne
        forward, right = max(c2 * nn + s2 * ee + mix, 0.0), max(s2 * nn + c2 * ee - mix, 0.0)
        below = self._down_variance + cd
        down = max(vd + below - 2.0 * p.item(6, CURRENT_DOWN), 0.0)
        return [pn, pe, pd, yaw, forward, right, down, cn, ce, below]

    def planar_variance(self, state: FilterState) -> float:
        """From the diagonal."""
        return max(state.p.item(0, 0), state.p.item(1, 1))
