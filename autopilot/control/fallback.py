"""What commands the thrusters when the optimiser does not: station keeping by a cascade of P loops on the model."""

import math

import numpy as np

from autopilot.core import model4
from autopilot.core.frames import FloatArray, wrap_pi
from autopilot.core.model4 import NU, YAW, Model4, R, U, X, Y, Z

POSITION_GAIN_1_S = 0.4
YAW_GAIN_1_S = 0.8
VELOCITY_GAIN_1_S = 1.5
SPEED_LIMIT_M_S = 0.15
HEAVE_LIMIT_M_S = 0.1
YAW_RATE_LIMIT_RAD_S = 0.4
WATER_SPEED_LIMIT_M_S = 0.4


def station_keeping_thrust(
    model: Model4, x: FloatArray, target: FloatArray, current_ned_m_s: FloatArray, limit_n: FloatArray
) -> FloatArray:
    """Thrust (4,) [N] that holds position, depth and heading of ``target`` (8,) from state ``x`` (8,) in a current.

    Position error -> velocity over ground -> velocity through the water -> drag feed-forward plus velocity feedback.
    """
    dx, dy = float(target[X] - x[X]), float(target[Y] - x[Y])
    distance = math.hypot(dx, dy)
    speed = min(POSITION_GAIN_1_S * distance, SPEED_LIMIT_M_S)
    scale = speed / distance if distance > 1e-9 else 0.0
    north, east = scale * dx - current_ned_m_s[0], scale * dy - current_ned_m_s[1]
    shrink = min(1.0, WATER_SPEED_LIMIT_M_S / max(math.hypot(north, east), 1e-9))
    c, s = math.cos(x[YAW]), math.sin(x[YAW])
    climb = max(-HEAVE_LIMIT_M_S, min(HEAVE_LIMIT_M_S, POSITION_GAIN_1_S * float(target[Z] - x[Z])))
    turn = YAW_GAIN_1_S * wrap_pi(float(target[YAW] - x[YAW]))
    wanted = np.array(
        [
            shrink * (c * north + s * east),
            shrink * (c * east - s * north),
            climb - current_ned_m_s[2],
            max(-YAW_RATE_LIMIT_RAD_S, min(YAW_RATE_LIMIT_RAD_S, turn)),
        ]
    )
    nu = [float(v) for v in x[U : R + 1]]
    drift = model4.body_acceleration(model, [float(v) for v in wanted], [0.0] * NU, math)
    force = np.array(
        [m * (VELOCITY_GAIN_1_S * (w - v) - a) for m, w, v, a in zip(model.mass_kg, wanted, nu, drift, strict=True)]
    )
    thrust = np.linalg.solve(np.array(model.allocation), force)
    limited: FloatArray = np.clip(thrust, -limit_n, limit_n)
    return limited
