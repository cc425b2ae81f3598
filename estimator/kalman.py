"""The extended Kalman filter: filterpy's, with our motion model, gating, and pure functions around it."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter

from autopilot.core.frames import FloatArray
from autopilot.estimator.carry import PastUpdate, symmetric
from autopilot.estimator.filter_core import Innovation
from autopilot.estimator.ground import columns_of, entered, ground_of
from autopilot.estimator.inertial import InertialStep, ProcessNoiseMode
from autopilot.estimator.measure_pose import SheetDependence
from autopilot.estimator.measurement import CHI2_999, Measurement, Moment, chi2_999
from autopilot.estimator.motion import MotionModel
from autopilot.estimator.states import (
    CURRENT_DOWN,
    CURRENT_EAST,
    CURRENT_NORTH,
    EAST,
    HEADING_OFFSET,
    INITIAL_SIGMA,
    INITIAL_SIGMA_CURRENT_DOWN_M_S,
    NORTH,
    NX,
    POS,
    POSE,
    VEL,
    VEL_DOWN,
    VEL_EAST,
    VEL_NORTH,
    YAW,
    FilterState,
    SheetStates,
)
from autopilot.estimator.tuning import TILTED_GYRO_NOISE, process_noise

VERTICAL_CURRENT_VARIANCE = 0.02**2
"""The vertical current is taken as zero unless it is a state; this is how wrong that may be [m^2/s^2]."""

MAX_SHEETS = 96
"""Sheets held at a time: more than a lap sees of sheets of half a metre. Beyond, the first ones seen are forgotten."""

LEANING_M_S2 = 0.5
"""An offset of the accelerometer beyond this, forward and right together, is gravity that leaks in: the AHRS's tilt is
wrong by 3 degrees and more, and with it the axis of turning."""

RELOCATED_SIGMA_VEL_M_S = 0.1
"""Of the velocity after a reset, which is the mean over the last fixes."""


_POSITION = (range(3), range(3))
"""Variances of north, east and down among those of the state."""


class _Filter(ExtendedKalmanFilter):  # type: ignore[misc]  # filterpy has no type hints
    """filterpy's filter with our motion: ``u`` of predict() is the step."""

    x: FloatArray
    P: FloatArray

    def __init__(self, dim_x: int, dim_z: int) -> None:
        super().__init__(dim_x, dim_z)
        self._motion = MotionModel()
        self.F = self._motion.jacobian

    def predict_x(self, u: Any = 0) -> None:
        """Move the state and linearise about where it was."""
        self.x = self._motion.step(self.x, u)


class KalmanCore:
    """:class:`autopilot.estimator.filter_core.FilterCore` by filterpy: predict() and update() are its own."""

    def __init__(self, *, current_3d: bool = False) -> None:
        """``current_3d``: the vertical current is a state."""
        self._kf = _Filter(NX, 4)
        self._noise = [process_noise(mode, current_3d=current_3d) for mode in sorted(ProcessNoiseMode)]
        self._sigma = INITIAL_SIGMA.copy()
        self._down_variance = VERTICAL_CURRENT_VARIANCE
        if current_3d:
            self._sigma[CURRENT_DOWN] = INITIAL_SIGMA_CURRENT_DOWN_M_S
            self._down_variance = 0.0
        self._kf.Q = np.zeros((NX, NX))
        self._wider: dict[int, ExtendedKalmanFilter] = {}

    def start(self, x: FloatArray) -> FilterState:
        return FilterState(x, np.diag(self._sigma**2))

    def predict(self, state: FilterState, step: InertialStep) -> FilterState:
        """P = F P F' + Q dt"""
        kf, sheets = self._kf, state.sheets
        kf.x, kf.P = state.x, state.p
        np.multiply(self._noise[step.mode], step.dt_s, out=kf.Q)
        if step.current_variance_per_s:
            more = step.current_variance_per_s * step.dt_s
            kf.Q[CURRENT_NORTH, CURRENT_NORTH] += more
            kf.Q[CURRENT_EAST, CURRENT_EAST] += more
        if any(step.position_variance_m2):
            kf.Q[_POSITION] += step.position_variance_m2
        kf.Q[YAW, YAW] += step.yaw_variance_rad2
        if math.hypot(state.x.item(8), state.x.item(9)) > LEANING_M_S2:
            kf.Q[YAW, YAW] += TILTED_GYRO_NOISE**2 * step.dt_s
        kf.predict(step)
        if sheets is not None:  # they lie where they lie
            sheets = sheets._replace(cross=kf.F.dot(sheets.cross))
        return FilterState(kf.x, kf.P, sheets)

    def transition(self) -> FloatArray | None:
        return self._kf.F.copy()

    def innovation(self, state: FilterState, measurement: Measurement, moment: Moment, after_s: float) -> Innovation:
        """filterpy's update (Joseph form), and a joint chi-square gate at 99.9 %.

        filterpy has no gate: the Mahalanobis distance is known only after the update. States are never changed in
        place, so a rejected one is simply discarded.
        """
        kf, sheets = self._kf, state.sheets
        ground = ground_of(measurement)
        if ground is not None:
            return self._on_sheets(state, measurement, ground, moment, after_s)
        kf.x, kf.P = state.x, state.p
        kf.R = measurement.noise
        h = measurement.jacobian(state.x, moment, after_s)
        kf.update(
            measurement.z,
            lambda _: h,
            measurement.predicted,
            hx_args=(moment, after_s),
            residual=measurement.residual,
        )
        ratio = kf.mahalanobis**2 / CHI2_999[len(kf.y)]
        if sheets is not None:  # consider states, not updated: almost no information about them
            sheets = sheets._replace(cross=sheets.cross - kf.K.dot(h.dot(sheets.cross)))
        after = FilterState(kf.x, symmetric(kf.P), sheets)
        update = None if sheets is not None else PastUpdate(kf.K, h, kf.S, kf.y)
        return Innovation(kf.y, kf.S.diagonal(), ratio, kf.K, None, after, update)

    def _on_sheets(
        self, state: FilterState, measurement: Measurement, ground: SheetDependence, moment: Moment, after_s: float
    ) -> Innovation:
        """Update with the sheets' effect on the measurement as additional states, one per row.

        This is exact: the measurement depends on the offsets through these sums only. The offsets follow by their
        covariance with the residual; filterpy's update on all of them (two hundred) would take 50 times as long.
        """
        sheets = entered(state.sheets, ground.sheets, ground.sigma, MAX_SHEETS)
        columns = columns_of(sheets.which, ground.sheets)
        g = ground.jacobian
        m = len(g)
        bent = g.dot(sheets.offset[columns] - ground.at)
        to_offsets = sheets.cov[:, columns].dot(g.T)
        to_states = sheets.cross[:, columns].dot(g.T)
        kf = self._wider.setdefault(m, ExtendedKalmanFilter(NX + m, m))
        kf.x = np.concatenate((state.x, bent))
        kf.P = np.empty((NX + m, NX + m))
        kf.P[:NX, :NX], kf.P[:NX, NX:] = state.p, to_states
        kf.P[NX:, :NX], kf.P[NX:, NX:] = to_states.T, g.dot(to_offsets[columns])
        h = np.empty((m, NX + m))
        h[:, :NX], h[:, NX:] = measurement.jacobian(state.x, moment, after_s), np.eye(m)
        kf.update(
            measurement.z,
            lambda _: h,
            lambda x: measurement.predicted(x[:NX], moment, after_s) + x[NX:],
            R=measurement.noise,
            residual=measurement.residual,
        )
        ratio = kf.mahalanobis**2 / chi2_999(m)
        spread = h[:, :NX].dot(sheets.cross) + to_offsets.T
        gain = kf.K[:NX]
        offset, cov = sheets.offset, sheets.cov
        if ground.learns:
            pull = spread.T.dot(kf.SI)
            offset = offset + pull.dot(kf.y)
            cov = symmetric(cov - pull.dot(spread))
        sheets = SheetStates(sheets.which, offset, sheets.cross - gain.dot(spread), cov)
        after = FilterState(kf.x[:NX], symmetric(kf.P[:NX, :NX]), sheets)
        return Innovation(kf.y, kf.S.diagonal(), ratio, gain, None, after)

    def correct(self, state: FilterState, innovation: Innovation) -> FilterState:
        assert innovation.after is not None
        return innovation.after

    def relocate(self, state: FilterState, pose: FloatArray, noise: FloatArray, vel_ned_m_s: FloatArray) -> FilterState:
        """The pose gets the fix's covariance, correlations of pose and velocity are dropped."""
        x, p, sheets = state.x.copy(), state.p.copy(), state.sheets
        x[HEADING_OFFSET] -= pose[3] - x[YAW]
        x[POS], x[YAW], x[VEL] = pose[:3], pose[3], vel_ned_m_s
        for part in (range(4), range(4, 7)):
            p[part, :] = 0.0
            p[:, part] = 0.0
        p[POSE, POSE] = noise
        p[VEL, VEL] = np.eye(3) * RELOCATED_SIGMA_VEL_M_S**2
        return FilterState(x, p, _forgotten(sheets, slice(0, 7)))

    def reopen(
        self, state: FilterState, part: slice, variance: float, value: Sequence[float] | None = None
    ) -> FilterState:
        x, p = state.x, state.p.copy()
        p[part, :] = 0.0
        p[:, part] = 0.0
        p[part, part] = np.eye(part.stop - part.start) * variance
        if value is not None:
            x = x.copy()
            x[part] = value
        return FilterState(x, p, _forgotten(state.sheets, part))

    def loosen(self, state: FilterState, sheet: int, sigma: Sequence[float], variance: Sequence[float]) -> FilterState:
        sheets = entered(state.sheets, (sheet,), np.array([sigma]), MAX_SHEETS)
        cov = sheets.cov.copy()
        columns = columns_of(sheets.which, (sheet,))
        cov[columns, columns] += variance
        return state._replace(sheets=sheets._replace(cov=cov))

    def variance(self, state: FilterState, cos_yaw: float, sin_yaw: float) -> list[float]:
        """From the covariance; velocity relative to the water with its correlation between ground and current."""
        p = state.p
        pn, pe, pd, yaw, vn, ve, vd, _, _, _, _, cn, ce, _, _, _, _, _, cd, _, _ = p.diagonal().tolist()
        nn = vn + cn - 2.0 * p.item(VEL_NORTH, CURRENT_NORTH)
        ee = ve + ce - 2.0 * p.item(VEL_EAST, CURRENT_EAST)
        ne = (
            p.item(VEL_NORTH, VEL_EAST)
            + p.item(CURRENT_NORTH, CURRENT_EAST)
            - p.item(VEL_NORTH, CURRENT_EAST)
            - p.item(VEL_EAST, CURRENT_NORTH)
        )
        c2, s2, mix = cos_yaw * cos_yaw, sin_yaw * sin_yaw, 2.0 * cos_yaw * sin_yaw * ne
        forward, right = max(c2 * nn + s2 * ee + mix, 0.0), max(s2 * nn + c2 * ee - mix, 0.0)
        below = self._down_variance + cd
        down = max(vd + below - 2.0 * p.item(VEL_DOWN, CURRENT_DOWN), 0.0)
        return [pn, pe, pd, yaw, forward, right, down, cn, ce, below]

    def planar_variance(self, state: FilterState) -> float:
        return max(state.p.item(NORTH, NORTH), state.p.item(EAST, EAST))


def _forgotten(sheets: SheetStates | None, part: slice) -> SheetStates | None:
    """The sheets uncorrelated with these states."""
    if sheets is None:
        return None
    cross = sheets.cross.copy()
    cross[part] = 0.0
    return sheets._replace(cross=cross)
