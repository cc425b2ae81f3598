"""Process noise of the filter, per state. Tuned on simulated runs through the tank jet."""

import numpy as np

from autopilot.core.frames import FloatArray
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

POS_NOISE = 2e-4
"""m/sqrt(s): keeps the position gain alive at rest."""
GYRO_NOISE = 1.1e-3
"""rad/s/sqrt(Hz): 0.05 deg/s/sqrt(Hz) of the IG-500 class, and a quarter more for scale error and misalignment."""
ACCEL_NOISE = 0.007
"""m/s^2/sqrt(Hz), north and east: sensor noise is a third of this, the rest is what tilt errors do within a second."""
ACCEL_NOISE_DOWN = 0.005
"""m/s^2/sqrt(Hz), down: tilt errors leak in squared only."""
GYRO_BIAS_WALK = 1e-4
"""rad/s/sqrt(s)"""
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
CURRENT_WALK = 0.02
"""m/s/sqrt(s): eddies that CURRENT_RATE does not describe."""
CURRENT_RATE_WALK = 0.04
"""m/s^2/sqrt(s): with CURRENT_RATE_TIME_S a stationary 0.04 m/s^2. The jet crossed at cruise speed does twice that
for a moment, but a larger value lets errors of the drag pass for current."""
CURRENT_RATE_TIME_S = tuple(
    2.0 if mode in (ProcessNoiseMode.NOMINAL, ProcessNoiseMode.TRIMMED) else 0.25 for mode in sorted(ProcessNoiseMode)
)
"""Correlation time of the current's rate of change by mode: the jet's width at cruise speed. Without fixes an error of
the rate would be carried on for two seconds, into most of the drift at the end of a gap: there it is soon forgotten."""
HEADING_OFFSET_WALK = 0.0087
"""rad/sqrt(s), 0.5 degrees: steel of a tank."""
LASER_BIAS_WALK = 1e-3
"""m/sqrt(s)"""

BLIND_GYRO_NOISE = 0.2
"""rad/s/sqrt(Hz) when there is no gyro."""
BLIND_ACCEL_NOISE = 0.15
"""m/s^2/sqrt(Hz) when the vehicle model stands in for the accelerometer."""

MODEL_ACCEL_NOISE = 0.04
"""m/s^2/sqrt(Hz) when the vehicle model is all there is: 0.03 m/s^2 that changes within a second, tether and jet."""
TILTED_GYRO_NOISE = 0.01
"""rad/s/sqrt(Hz) when the accelerometer is suspect: its tilt may be wrong, and with it the axis of turning."""
COMPASS_NOISE = 0.03
"""rad/s/sqrt(Hz) when the turning is the AHRS heading's: its slow error of a degree and the steel of the tank."""

COAST_FRACTION = 0.5
"""Without vision current, drag and thrust cannot be told from the accelerometer's bias: their states wander by this
share only. What the current may do unseen comes on top (:mod:`.water`)."""
DRAG_WALK = 0.004
"""1/sqrt(s): drag changes over minutes."""
THRUST_WALK = 0.002
"""1/sqrt(s): mass and propellers change over longer still."""
CURRENT_DOWN_WALK = 0.01
"""m/s/sqrt(s), when the vertical current is a state: half of the horizontal ones."""
DEPTH_OFFSET_WALK = 3e-4
"""m/sqrt(s): tides, weather and a warming sensor move the offset by a centimetre in a quarter of an hour."""


def process_noise(mode: ProcessNoiseMode, *, current_3d: bool = False) -> FloatArray:
    """Covariance per second (21, 21), diagonal."""
    coast = 1.0 if mode in (ProcessNoiseMode.NOMINAL, ProcessNoiseMode.TRIMMED) else COAST_FRACTION
    blind = mode is ProcessNoiseMode.BLIND
    by_model = mode in (ProcessNoiseMode.MODEL, ProcessNoiseMode.MODEL_COMPASS)
    sigma = np.zeros(NX)
    sigma[POS] = POS_NOISE
    sigma[YAW] = BLIND_GYRO_NOISE if blind else GYRO_NOISE
    if mode in (ProcessNoiseMode.COMPASS, ProcessNoiseMode.MODEL_COMPASS):
        sigma[YAW] = COMPASS_NOISE
    sigma[VEL] = BLIND_ACCEL_NOISE if blind else (ACCEL_NOISE, ACCEL_NOISE, ACCEL_NOISE_DOWN)
    if by_model:
        sigma[VEL] = MODEL_ACCEL_NOISE
        sigma[YAW] = max(sigma[YAW], TILTED_GYRO_NOISE)
    sigma[GYRO_BIAS] = GYRO_BIAS_WALK
    sigma[ACCEL_BIAS] = ACCEL_BIAS_WALK[mode]
    sigma[CURRENT] = coast * CURRENT_WALK
    sigma[CURRENT_RATE] = coast * CURRENT_RATE_WALK
    sigma[HEADING_OFFSET] = HEADING_OFFSET_WALK
    sigma[LASER_BIAS] = LASER_BIAS_WALK
    sigma[DRAG_EXCESS] = coast * DRAG_WALK
    sigma[THRUST_EXCESS] = coast * THRUST_WALK
    sigma[CURRENT_DOWN] = coast * CURRENT_DOWN_WALK if current_3d else 0.0
    sigma[DEPTH_OFFSET] = DEPTH_OFFSET_WALK
    return np.diag(sigma**2)
