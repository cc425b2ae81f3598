"""The extended Kalman filter: filterpy's, with our motion model, gating, and pure functions around it.

Where there is the library the same is computed in C (:mod:`.compiled_update`), two hundred times a second each.
"""

import ctypes
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from autopilot.core.compiled import Mirror, library
from autopilot.core.frames import FloatArray
from autopilot.core.map_errors import STATES
from autopilot.estimator.carry import PastUpdate, symmetric
from autopilot.estimator.estimator_tuning import NOISE
from autopilot.estimator.filter_core import Innovation
from autopilot.estimator.ground import columns_of, entered, ground_of
from autopilot.estimator.inertial import InertialStep, ProcessNoiseMode
from autopilot.estimator.measure_pose import SheetDependence
from autopilot.estimator.measurement import CHI2_999, Measurement, Moment, chi2_999
from autopilot.estimator.motion import MotionModel
from autopilot.estimator.states import (
    BIAS_AHEAD,
    BIAS_RIGHT,
    CURRENT,
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
from autopilot.estimator.tuning import process_noise

VERTICAL_CURRENT_VARIANCE = 0.02**2
"""The vertical current is taken as zero unless it is a state; this is how wrong that may be [m^2/s^2]."""

MAX_SHEETS = 96
"""Sheets held at a time: more than a lap sees of sheets of half a metre. Beyond, the first ones seen are forgotten."""

LEANING_M_S2 = 0.5
"""An offset of the accelerometer beyond this, forward and right together, is gravity that leaks in: the AHRS's tilt is
wrong by 3 degrees and more, and with it the axis of turning."""

RELOCATED_SIGMA_VEL_M_S = 0.1
"""Of the velocity after a reset, which is the mean over the last fixes."""
MOST = 24
"""Residuals of one update: those of six sheets in a picture."""


class _Update(Mirror):
    """ctypes layout of the struct in estimator.c."""

    _fields_ = (
        ("m", ctypes.c_long),
        ("x", ctypes.c_double * NX),
        ("p", ctypes.c_double * (NX * NX)),
        ("residual", ctypes.c_double * MOST),
        ("jacobian", ctypes.c_double * (MOST * NX)),
        ("shared", ctypes.c_double * (NX * MOST)),
        ("noise", ctypes.c_double * (MOST * MOST)),
        ("inverse", ctypes.c_double * (MOST * MOST)),
        ("distance2", ctypes.c_double),
    )


class Updated(NamedTuple):
    """State and covariance after a measurement of m numbers, and what comes up on the way."""

    x: FloatArray
    """(21,)"""
    p: FloatArray
    """(21, 21)"""
    gain: FloatArray
    """(21, m)"""
    spread: FloatArray
    """(m, m) covariance of the residual, and its inverse."""
    inverse: FloatArray
    distance2: float
    """Squared Mahalanobis distance of the residual."""


class CompiledUpdate:
    """As filterpy, in a tenth of the time, around one work space. :meth:`of_library`: None without a library."""

    def __init__(self, compiled: ctypes.PyDLL) -> None:
        self._update, self._spread = compiled.kalman_update, compiled.spread_step
        self._work = _Update()
        self._address = ctypes.addressof(self._work)
        self._x, self._p = self._view("x"), self._view("p").reshape(NX, NX)
        self._views = [self._views_of(m) for m in range(MOST + 1)]
        self._before, self._after = np.zeros((NX, NX)), np.zeros((NX, NX))
        self._spread_addresses = self._before.ctypes.data, self._after.ctypes.data

    @staticmethod
    def of_library() -> "CompiledUpdate | None":
        compiled = library(_Update)
        return None if compiled is None else CompiledUpdate(compiled)

    def _view(self, name: str, count: int | None = None) -> FloatArray:
        return np.frombuffer(getattr(self._work, name), count=-1 if count is None else count)

    def _views_of(self, m: int) -> tuple[FloatArray, ...]:
        """Residual, Jacobian, noise, shared and inverse of m residuals."""
        shapes = {"jacobian": (m, NX), "noise": (m, m), "shared": (NX, m), "inverse": (m, m)}
        return (
            self._view("residual", m),
            *(self._view(name, rows * columns).reshape(rows, columns) for name, (rows, columns) in shapes.items()),
        )

    def spread(self, jacobian_address: int, p: FloatArray, noise_address: int) -> FloatArray:
        """F P F' + Q, a new array (21, 21), by the addresses of F (21, 21) and of the diagonal of Q (21,)."""
        before, after = self._spread_addresses
        self._before[:] = p
        self._spread(jacobian_address, before, noise_address, after)
        return self._after.copy()

    def update(
        self,
        x: FloatArray,
        p: FloatArray,
        residual: FloatArray,
        jacobian: FloatArray,
        noise: FloatArray,
        shared: FloatArray | float = 0.0,
    ) -> Updated:
        """The update by m residuals (m,) with their Jacobian (m, 21) and noise (m, m), at most :data:`MOST`.

        ``shared`` (21, m): covariance of the state with the noise. LinAlgError where filterpy raises it."""
        m = len(residual)
        y, h, r, t, inverse = self._views[m]
        self._work.m = m
        self._x[:], self._p[:], y[:], h[:], r[:], t[:] = x, p, residual, jacobian, noise, shared
        if not self._update(self._address):
            raise np.linalg.LinAlgError("the covariance of the residual is singular")
        return Updated(self._x.copy(), self._p.copy(), t.copy(), r.copy(), inverse.copy(), self._work.distance2)


class KalmanCore:
    """:class:`autopilot.estimator.filter_core.FilterCore` by filterpy's predict() and update(), or as they are in C."""

    def __init__(self, *, current_3d: bool = False, sheets: int = 0) -> None:
        """``current_3d``: the vertical current is a state. ``sheets``: of the map, so many may be seen at once."""
        self._motion = MotionModel()
        self._rates = [process_noise(mode, current_3d=current_3d).diagonal() for mode in sorted(ProcessNoiseMode)]
        self._sigma = INITIAL_SIGMA.copy()
        self._down_variance = VERTICAL_CURRENT_VARIANCE
        if current_3d:
            self._sigma[CURRENT_DOWN] = INITIAL_SIGMA_CURRENT_DOWN_M_S
            self._down_variance = 0.0
        self._noise = np.zeros(NX)
        self._addresses = self._motion.jacobian.ctypes.data, self._noise.ctypes.data
        self._compiled = CompiledUpdate.of_library()
        self._filters: dict[int, Any] = {}
        """filterpy's, by the number of states that the sheets of a measurement add."""
        if self._compiled is None or STATES * sheets > MOST:
            self._filter(0)  # filterpy is imported now, and not in flight

    def start(self, x: FloatArray) -> FilterState:
        return FilterState(x, np.diag(self._sigma**2))

    def predict(self, state: FilterState, step: InertialStep) -> FilterState:
        """P = F P F' + Q dt"""
        sheets, noise = state.sheets, self._noise
        np.multiply(self._rates[step.mode], step.dt_s, out=noise)
        if step.current_variance_per_s:
            noise[CURRENT] += step.current_variance_per_s * step.dt_s
        if any(step.position_variance_m2):
            noise[POS] += step.position_variance_m2
        more = step.yaw_variance_rad2
        if math.hypot(state.x.item(BIAS_AHEAD), state.x.item(BIAS_RIGHT)) > LEANING_M_S2:
            more += NOISE.tilted_gyro_noise**2 * step.dt_s
        if more:
            noise[YAW] += more
        x = self._motion.step(state.x, step)
        if self._compiled is not None:
            p = self._compiled.spread(self._addresses[0], state.p, self._addresses[1])
        else:
            kf = self._filter(0)
            kf.x, kf.P, kf.F, kf.Q = x, state.p, self._motion.jacobian, np.diag(noise)
            kf.predict_x = lambda u: None  # it has been moved
            kf.predict()
            p = kf.P
        if sheets is not None:  # they lie where they lie
            sheets = SheetStates(sheets.which, sheets.offset, self._motion.jacobian.dot(sheets.cross), sheets.cov)
        return FilterState(x, p, sheets)

    def transition(self) -> FloatArray | None:
        return self._motion.jacobian.copy()

    def innovation(self, state: FilterState, measurement: Measurement, moment: Moment, after_s: float) -> Innovation:
        """filterpy's update (Joseph form), and a joint chi-square gate at 99.9 %.

        The Mahalanobis distance is known only after the update. States are never changed in place, so a rejected one is
        simply discarded.
        """
        x, sheets = state.x, state.sheets
        ground = ground_of(measurement)
        y = measurement.residual(measurement.z, measurement.predicted(x, moment, after_s))
        h = measurement.jacobian(x, moment, after_s)
        if ground is not None:
            return self._on_sheets(state, measurement.noise, ground, y, h)
        done = self._updated(state, y, h, measurement.noise)
        ratio = done.distance2 / CHI2_999[len(y)]
        if sheets is not None:  # consider states, not updated: almost no information about them
            cross = sheets.cross - done.gain.dot(h.dot(sheets.cross))
            sheets = SheetStates(sheets.which, sheets.offset, cross, sheets.cov)
        after = FilterState(done.x, done.p, sheets)
        update = None if sheets is not None else PastUpdate(done.gain, h, done.spread, y)
        return Innovation(y, done.spread.diagonal(), ratio, done.gain, None, after, update)

    def _on_sheets(
        self, state: FilterState, noise: FloatArray, ground: SheetDependence, y: FloatArray, h: FloatArray
    ) -> Innovation:
        """Update with the sheets' effect on the measurement as additional states, one per row.

        This is exact: the measurement depends on the offsets through these sums only. The offsets follow by their
        covariance with the residual; an update of all of them (two hundred) would take 50 times as long.
        """
        sheets = entered(state.sheets, ground.sheets, ground.sigma, MAX_SHEETS)
        columns = columns_of(sheets.which, ground.sheets)
        g = ground.jacobian
        y = y - g.dot(sheets.offset[columns] - ground.at)
        to_offsets = sheets.cov[:, columns].dot(g.T)
        to_states = sheets.cross[:, columns].dot(g.T)
        done = self._updated(state, y, h, noise, (to_states, g.dot(to_offsets[columns])))
        spread = h.dot(sheets.cross) + to_offsets.T
        offset, cov = sheets.offset, sheets.cov
        if ground.learns:
            pull = spread.T.dot(done.inverse)
            offset = offset + pull.dot(y)
            cov = symmetric(cov - pull.dot(spread))
        sheets = SheetStates(sheets.which, offset, sheets.cross - done.gain.dot(spread), cov)
        after = FilterState(done.x, done.p, sheets)
        return Innovation(y, done.spread.diagonal(), done.distance2 / chi2_999(len(y)), done.gain, None, after)

    def _updated(
        self,
        state: FilterState,
        y: FloatArray,
        h: FloatArray,
        noise: FloatArray,
        bent: tuple[FloatArray, FloatArray] | None = None,
    ) -> Updated:
        """The update by residuals (m,). ``bent``: of the sheets' effects on them the covariance with the states
        (21, m), and their own (m, m)."""
        if self._compiled is not None and len(y) <= MOST:
            if bent is None:
                return self._compiled.update(state.x, state.p, y, h, noise)
            seen = h.dot(bent[0])
            return self._compiled.update(state.x, state.p, y, h, noise + bent[1] + seen.T, bent[0])
        m = 0 if bent is None else len(y)
        kf = self._filter(m)
        kf.x, kf.P = state.x, state.p
        if bent is not None:
            kf.x = np.concatenate((state.x, np.zeros(m)))
            kf.P = np.block([[state.p, bent[0]], [bent[0].T, bent[1]]])
            h = np.hstack((h, np.eye(m)))
        kf.update(y, lambda _: h, lambda _: 0.0, R=noise)
        distance2 = kf.mahalanobis**2
        return Updated(kf.x[:NX], symmetric(kf.P[:NX, :NX]), kf.K[:NX], kf.S, kf.SI, distance2)

    def _filter(self, more: int) -> Any:
        if more not in self._filters:
            from filterpy.kalman import ExtendedKalmanFilter  # a third of the start of a service that needs it

            self._filters[more] = ExtendedKalmanFilter(NX + more, 1)
        return self._filters[more]

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
