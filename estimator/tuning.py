"""Process noise of the filter, per state. Tuned on simulated runs through the tank jet."""

import numpy as np

from autopilot.core.frames import FloatArray
from autopilot.estimator.estimator_tuning import NOISE
from autopilot.estimator.inertial import ProcessNoiseMode
from autopilot.estimator.states import (
    ACCEL_BIAS,
    CURRENT,
    CURRENT_DOWN,
    CURRENT_RATE,
    DEPTH_OFFSET,
    DRAG_EXCESS,
    GYRO_BIAS,
    HEADING_OFFSET,
    LASER_BIAS,
    NX,
    POS,
    THRUST_EXCESS,
    VEL,
    YAW,
)

ACCEL_BIAS_WALK = {
    ProcessNoiseMode.NOMINAL: 0.03,
    ProcessNoiseMode.TRIMMED: 0.015,
    ProcessNoiseMode.COASTING: 0.05,
    ProcessNoiseMode.BLIND: 0.03,
    ProcessNoiseMode.MODEL: 0.03,
    ProcessNoiseMode.COMPASS: 0.03,
    ProcessNoiseMode.MODEL_COMPASS: 0.03,
}
"""m/s^2/sqrt(s): gravity leaking in through slow tilt errors, 0.09 m/s^2 for 0.5 degrees in 20 s. Little when vision
trims the tilt. More without fixes: the vehicle model then knows the acceleration better than an accelerometer that is
not level."""
CURRENT_RATE_TIME_S = tuple(
    2.0 if mode in (ProcessNoiseMode.NOMINAL, ProcessNoiseMode.TRIMMED) else 0.25 for mode in sorted(ProcessNoiseMode)
)
"""Correlation time of the current's rate of change by mode: the jet's width at cruise speed. Without fixes an error of
the rate would be carried on for two seconds, into most of the drift at the end of a gap: there it is soon forgotten."""


def process_noise(mode: ProcessNoiseMode, *, current_3d: bool = False) -> FloatArray:
    """Covariance per second (21, 21), diagonal."""
    coast = 1.0 if mode in (ProcessNoiseMode.NOMINAL, ProcessNoiseMode.TRIMMED) else NOISE.coast_fraction
    blind = mode is ProcessNoiseMode.BLIND
    by_model = mode in (ProcessNoiseMode.MODEL, ProcessNoiseMode.MODEL_COMPASS)
    sigma = np.zeros(NX)
    sigma[POS] = NOISE.pos_noise
    sigma[YAW] = NOISE.blind_gyro_noise if blind else NOISE.gyro_noise
    if mode in (ProcessNoiseMode.COMPASS, ProcessNoiseMode.MODEL_COMPASS):
        sigma[YAW] = NOISE.compass_noise
    sigma[VEL] = NOISE.blind_accel_noise if blind else (NOISE.accel_noise, NOISE.accel_noise, NOISE.accel_noise_down)
    if by_model:
        sigma[VEL] = NOISE.model_accel_noise
        sigma[YAW] = max(sigma[YAW], NOISE.tilted_gyro_noise)
    sigma[GYRO_BIAS] = NOISE.gyro_bias_walk
    sigma[ACCEL_BIAS] = ACCEL_BIAS_WALK[mode]
    sigma[CURRENT] = coast * NOISE.current_walk
    sigma[CURRENT_RATE] = coast * NOISE.current_rate_walk
    sigma[HEADING_OFFSET] = NOISE.heading_offset_walk
    sigma[LASER_BIAS] = NOISE.laser_bias_walk
    sigma[DRAG_EXCESS] = coast * NOISE.drag_walk
    sigma[THRUST_EXCESS] = coast * NOISE.thrust_walk
    sigma[CURRENT_DOWN] = coast * NOISE.current_down_walk if current_3d else 0.0
    sigma[DEPTH_OFFSET] = NOISE.depth_offset_walk
    return np.diag(sigma**2)
