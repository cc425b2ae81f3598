"""Layout of the state vector of both estimators, and its initial covariance."""

from typing import NamedTuple

import numpy as np

from autopilot.core.frames import FloatArray

NX = 21
"""Number of states."""

POS = slice(0, 3)
"""Position of the centre of gravity, NED [m]."""
NORTH, EAST, DOWN = range(POS.start, POS.stop)
YAW = 3
"""Heading [rad], not wrapped: it counts turns."""
POSE = slice(0, 4)
"""Position and heading."""
VEL = slice(4, 7)
"""Velocity over ground, NED [m/s]."""
VEL_NORTH, VEL_EAST, VEL_DOWN = range(VEL.start, VEL.stop)
GYRO_BIAS = 7
"""Offset of the heading rate [rad/s]."""
ACCEL_BIAS = slice(8, 11)
"""Offset of the acceleration in the level frame that turns with the heading [m/s^2].

The accelerometer's own offset and, mostly, gravity that leaks in through the AHRS's error of roll and pitch."""
BIAS_AHEAD, BIAS_RIGHT, BIAS_DOWN = range(ACCEL_BIAS.start, ACCEL_BIAS.stop)
CURRENT = slice(11, 13)
"""Velocity of the water, north and east [m/s]."""
CURRENT_NORTH, CURRENT_EAST = range(CURRENT.start, CURRENT.stop)
CURRENT_RATE = slice(13, 15)
"""Rate of change of the current at the moving vehicle, north and east [m/s^2]."""
CURRENT_RATE_NORTH, CURRENT_RATE_EAST = range(CURRENT_RATE.start, CURRENT_RATE.stop)
HEADING_OFFSET = 15
"""Heading that the AHRS shows minus true heading [rad]."""
LASER_BIAS = 16
"""Range that the laser shows minus true range [m]."""
DRAG_EXCESS = 17
"""Share by which surge and sway drag exceed the model's: growth, wear, a tether in tow."""
CURRENT_DOWN = 18
"""Velocity of the water, down [m/s]; held at zero unless ``EstimatorOptions.current_3d``."""
DEPTH_OFFSET = 19
"""Depth that the pressure sensor shows minus true depth [m]: air pressure, water level, its own zero."""
THRUST_EXCESS = 20
"""Share by which the acceleration that a newton gives in surge and sway exceeds the model's: mass, propellers."""

INITIAL_SIGMA_CURRENT_DOWN_M_S = 0.05
"""Of the vertical current at start-up, when it is a state."""


def one(index: int) -> slice:
    return slice(index, index + 1)


class SheetStates(NamedTuple):
    """Offsets of the observed sheets as Kalman filter states, beside the 21 states.

    Four per sheet: true minus mapped pose, north, east, down [m], heading [rad].
    """

    which: tuple[int, ...]
    """Numbers of the sheets."""
    offset: FloatArray
    """(4k,)"""
    cross: FloatArray
    """(21, 4k) covariance with the states."""
    cov: FloatArray
    """(4k, 4k)"""


class FilterState(NamedTuple):
    """Estimate at one moment. The arrays are never changed in place, only replaced."""

    x: FloatArray
    """(21,)"""
    p: FloatArray
    """Covariance (21, 21) in the Kalman filter, variances (21,) in the observer."""
    sheets: SheetStates | None = None
    """None = the map is exact, or nothing of it has been seen."""


INITIAL_SIGMA: FloatArray = np.array([
    0.03, 0.03, 0.03, 0.03, 0.3, 0.3, 0.1, 0.02, 0.15, 0.15, 0.1,
    0.2, 0.2, 0.05, 0.05, 0.05, 0.02, 0.15, 0.0, 0.1, 0.1,
])  # fmt: skip
"""(21,) standard deviations at start-up: position from one fix, moderate speed, current and biases not known."""
INITIAL_SIGMA.flags.writeable = False


def initial_state(pos_ned_m: FloatArray, yaw_rad: float, heading_offset_rad: float) -> FloatArray:
    """State (21,) of a vehicle at rest at that pose."""
    x = np.zeros(NX)
    x[POS] = pos_ned_m
    x[YAW] = yaw_rad
    x[HEADING_OFFSET] = heading_offset_rad
    return x
