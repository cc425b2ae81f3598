"""A nonlinear complementary observer behind the interface of the Kalman filter.

The form of Marantos et al. (2016): accelerometer and gyro propagate the state, the aiding sensors correct it with

    p' = v + k1 e      v' = R a - b + k2 e      b' = -k3 R' e      e = p_measured - p

and likewise heading and gyro bias. k2 and k3 are constant. k1 is adaptive: every state has a variance (no
correlations), so that a fix has more weight after a gap and with a smaller measurement noise. The current follows the
difference between measured and modelled acceleration.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from autopilot.core.frames import FloatArray
from autopilot.core.markers import MarkerMap
from autopilot.core.vehicle import Vehicle
from autopilot.estimator.engine import AidedEstimator
from autopilot.estimator.estimator_tuning import COMPLEMENTARY
from autopilot.estimator.filter_core import Innovation
from autopilot.estimator.ground import ground_of
from autopilot.estimator.inertial import InertialStep, ProcessNoiseMode
from autopilot.estimator.kalman import RELOCATED_SIGMA_VEL_M_S, VERTICAL_CURRENT_VARIANCE
from autopilot.estimator.measure_depth import Depth
from autopilot.estimator.measure_model import ModelAcceleration
from autopilot.estimator.measure_pose import PoseFix
from autopilot.estimator.measure_range import LaserRange
from autopilot.estimator.measurement import CHI2_999, Measurement, Moment
from autopilot.estimator.motion import moved
from autopilot.estimator.options import DEFAULT_OPTIONS, EstimatorOptions
from autopilot.estimator.protocol import Estimator, EstimatorContext
from autopilot.estimator.states import (
    ACCEL_BIAS,
    BIAS_AHEAD,
    BIAS_DOWN,
    BIAS_RIGHT,
    CURRENT,
    DEPTH_OFFSET,
    EAST,
    GYRO_BIAS,
    HEADING_OFFSET,
    INITIAL_SIGMA,
    LASER_BIAS,
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
)

K_VEL = 12.0 * COMPLEMENTARY.fix_period_s
"""1/s^2"""
K_BIAS = 6.0 * COMPLEMENTARY.fix_period_s
"""1/s^3"""
K_GYRO_BIAS = 1.0 * COMPLEMENTARY.fix_period_s
"""1/s^2"""

_FIX_VARIANCE, _GATE_VARIANCE = (
    np.array([pos, pos, pos, yaw]) ** 2 for pos, yaw in (COMPLEMENTARY.fix_floor, COMPLEMENTARY.gate_floor)
)
_MODEL_GATE_VARIANCE: FloatArray = np.full(2, COMPLEMENTARY.model_gate_sigma_m_s2**2)
_MODEL_GATE_VARIANCE.flags.writeable = False
_MODEL_SPREAD: FloatArray = np.zeros((NX, 2))
_MODEL_SPREAD.flags.writeable = False
"""Looks at the model correct the current by a fixed gain and tell no variance."""


class ObserverCore:
    """:class:`autopilot.estimator.filter_core.FilterCore` with one variance per state."""

    def __init__(self) -> None:
        self._growth = np.zeros(NX)
        self._growth[POS] = COMPLEMENTARY.pos_noise**2
        self._growth[YAW] = COMPLEMENTARY.yaw_noise**2
        self._growth[VEL] = COMPLEMENTARY.vel_noise**2
        self._growth[HEADING_OFFSET] = COMPLEMENTARY.offset_noise**2
        self._growth[LASER_BIAS] = COMPLEMENTARY.laser_bias_noise**2
        self._growth[DEPTH_OFFSET] = COMPLEMENTARY.depth_offset_noise**2

    def start(self, x: FloatArray) -> FilterState:
        return FilterState(x, INITIAL_SIGMA**2)

    def predict(self, state: FilterState, step: InertialStep) -> FilterState:
        """Variances grow; without vision that of the position as if the velocity were wrong in one direction."""
        made_up = step.mode not in (ProcessNoiseMode.NOMINAL, ProcessNoiseMode.TRIMMED, ProcessNoiseMode.COASTING)
        p = state.p + ((10.0 if made_up else 1.0) * step.dt_s) * self._growth
        if made_up or step.mode is ProcessNoiseMode.COASTING:
            p[POS] += 2.0 * step.dt_s * np.sqrt(p[POS] * p[VEL])
        p[POS] += step.position_variance_m2
        return FilterState(np.array(moved(state.x, step)), p)

    def transition(self) -> FloatArray | None:
        """Its gains are not the covariance's: nothing can be carried."""
        return None

    def innovation(self, state: FilterState, measurement: Measurement, moment: Moment, after_s: float) -> Innovation:
        """Gate on the sum of squares of the normalised residuals."""
        x, p = state.x, state.p
        y = measurement.residual(measurement.z, measurement.predicted(x, moment, after_s))
        if isinstance(measurement, ModelAcceleration):
            return self._result(y, _MODEL_GATE_VARIANCE, _model_gain(x), _MODEL_SPREAD)
        noise = measurement.noise.diagonal()
        ground = ground_of(measurement)
        if ground is not None:  # of sheets it knows only how well they were laid
            noise = noise + (ground.jacobian**2).dot(ground.sigma.reshape(-1) ** 2)
        h = measurement.jacobian(x, moment, after_s)
        spread = p[:, None] * h.T
        seen = np.add.reduce(h.T * spread)
        if isinstance(measurement, PoseFix):
            noise = np.maximum(noise, _FIX_VARIANCE)
            variance = np.maximum(seen + noise, _GATE_VARIANCE)
            return self._result(y, variance, _fix_gain(spread / (seen + noise), x), spread)
        variance = seen + noise
        gain = spread / variance
        if isinstance(measurement, (LaserRange, Depth)):
            variance = np.maximum(variance, COMPLEMENTARY.gate_floor[0] ** 2)
        return self._result(y, variance, gain, spread)

    def _result(self, y: FloatArray, variance: FloatArray, gain: FloatArray, spread: FloatArray) -> Innovation:
        ratio = float(y.dot(y / variance)) / CHI2_999[len(y)]
        return Innovation(y, variance, ratio, gain, spread)

    def correct(self, state: FilterState, innovation: Innovation) -> FilterState:
        """x + K y; variances are reduced by the update."""
        assert innovation.spread is not None
        p = np.maximum(state.p - np.add.reduce(innovation.gain * innovation.spread, axis=1), 1e-10)
        if len(innovation.y) == 4:
            p[VEL] *= COMPLEMENTARY.vel_shrink
        return FilterState(state.x + innovation.gain @ innovation.y, p)

    def relocate(self, state: FilterState, pose: FloatArray, noise: FloatArray, vel_ned_m_s: FloatArray) -> FilterState:
        x, p = state.x.copy(), state.p.copy()
        x[HEADING_OFFSET] -= pose[3] - x[YAW]
        x[POS], x[YAW], x[VEL] = pose[:3], pose[3], vel_ned_m_s
        p[POSE] = noise.diagonal()
        p[VEL] = RELOCATED_SIGMA_VEL_M_S**2
        return FilterState(x, p)

    def reopen(
        self, state: FilterState, part: slice, variance: float, value: Sequence[float] | None = None
    ) -> FilterState:
        x, p = state.x, state.p.copy()
        p[part] = variance
        if value is not None:
            x = x.copy()
            x[part] = value
        return FilterState(x, p)

    def loosen(self, state: FilterState, sheet: int, sigma: Sequence[float], variance: Sequence[float]) -> FilterState:
        """No-op: the observer has no sheet states."""
        return state

    def variance(self, state: FilterState, cos_yaw: float, sin_yaw: float) -> list[float]:
        """A constant for the current: the observer does not estimate it."""
        p = state.p.tolist()
        through_water = max(p[VEL_NORTH], p[VEL_EAST]) + COMPLEMENTARY.current_variance
        down = p[VEL_DOWN] + VERTICAL_CURRENT_VARIANCE
        return [
            *p[POSE],
            through_water,
            through_water,
            down,
            COMPLEMENTARY.current_variance,
            COMPLEMENTARY.current_variance,
            VERTICAL_CURRENT_VARIANCE,
        ]

    def planar_variance(self, state: FilterState) -> float:
        return max(state.p.item(NORTH), state.p.item(EAST))


def _fix_gain(gain: FloatArray, x: FloatArray) -> FloatArray:
    """The adaptive gain (21, 4) with the fixed rows for velocity and biases; the position's share sets their size."""
    c, s = np.cos(x[YAW]), np.sin(x[YAW])
    gain[VEL] = 0.0
    gain[VEL_NORTH, 0] = gain[VEL_EAST, 1] = gain[VEL_DOWN, 2] = K_VEL
    gain[GYRO_BIAS] = 0.0
    gain[GYRO_BIAS, 3] = -K_GYRO_BIAS
    gain[ACCEL_BIAS] = 0.0
    gain[BIAS_AHEAD, 0], gain[BIAS_AHEAD, 1] = -K_BIAS * c, -K_BIAS * s
    gain[BIAS_RIGHT, 0], gain[BIAS_RIGHT, 1] = K_BIAS * s, -K_BIAS * c
    gain[BIAS_DOWN, 2] = -K_BIAS
    return gain


def _model_gain(x: FloatArray) -> FloatArray:
    """Gain (21, 2): an acceleration that the model does not explain is water that pushes."""
    c, s = float(np.cos(x[YAW])), float(np.sin(x[YAW]))
    gain = np.zeros((NX, 2))
    gain[CURRENT] = (
        (COMPLEMENTARY.k_current_s * c, COMPLEMENTARY.k_current_s * -s),
        (COMPLEMENTARY.k_current_s * s, COMPLEMENTARY.k_current_s * c),
    )
    return gain


def create_complementary(
    vehicle: Vehicle,
    markers: MarkerMap | None,
    floor_depth_m: float | None,
    options: EstimatorOptions = DEFAULT_OPTIONS,
) -> AidedEstimator:
    can = replace(options, current_3d=False, gps=False)
    return AidedEstimator(ObserverCore(), vehicle, markers, floor_depth_m, can)


def of_context(context: EstimatorContext) -> Estimator:
    """The observer by name ("complementary")."""
    return create_complementary(context.vehicle, context.markers, context.floor_depth_m, context.options)
