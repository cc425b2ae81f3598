"""Deviation of the vehicle from its plan and its linearised dynamics.

The error is expressed in the body frame of the planned state z: e = (R(yaw_z)^T (p - p_z), depth, yaw, velocity). Its
dynamics then depend on the planned velocity only, not on heading, position or current. The velocity error is that over
ground, which the feedback measures. An error of the estimated current does not move a vehicle whose velocity over
ground is known; it acts through the drag.
"""

import math

import numpy as np

from autopilot.core.frames import FloatArray
from autopilot.core.model4 import ABS_SMOOTHING_M2_S2, NX, YAW, Model4, R, U, V, W, X, Y, Z

CHANNELS = 7
"""Disturbances: force ahead, starboard, down [N], yaw moment [N m], error of the current ahead, starboard, down."""


def velocity_jacobian(model: Model4, nu: FloatArray) -> FloatArray:
    """(4, 4) Jacobian of :func:`autopilot.core.model4.body_acceleration` with respect to u, v, w, r at ``nu`` (4,)."""
    u, v, _, r = (float(x) for x in nu)
    m11, m22, _, m44 = model.mass_kg
    jacobian = np.zeros((4, 4))
    for i, speed in enumerate(float(x) for x in nu):
        smooth = math.sqrt(speed * speed + ABS_SMOOTHING_M2_S2)
        slope = model.linear_drag[i] + model.quadratic_drag[i] * (smooth + speed * speed / smooth)
        jacobian[i, i] = -slope / model.mass_kg[i]
    jacobian[0, 1], jacobian[0, 3] = m22 * r / m11, m22 * v / m11
    jacobian[1, 0], jacobian[1, 3] = -m11 * r / m22, -m11 * u / m22
    jacobian[3, 0], jacobian[3, 1] = (m11 - m22) * v / m44, (m11 - m22) * u / m44
    return jacobian


def error_jacobian(model: Model4, nu: FloatArray) -> FloatArray:
    """(8, 8) A of the continuous error dynamics along a plan with velocity ``nu`` (4,) u, v, w, r."""
    u, v, _, r = (float(x) for x in nu)
    a = np.zeros((NX, NX))
    a[X, Y], a[Y, X] = r, -r
    a[X, YAW], a[Y, YAW] = -v, u
    a[X, U] = a[Y, V] = a[Z, W] = a[YAW, R] = 1.0
    a[U:, U:] = velocity_jacobian(model, nu)
    return a


def input_matrix(model: Model4) -> FloatArray:
    """Input matrix (8, n) of thrust [N]."""
    b = np.zeros((NX, model.thrusters))
    b[U:] = np.array(model.allocation) / np.array(model.mass_kg)[:, None]
    return b


def disturbance_matrix(model: Model4, nu: FloatArray) -> FloatArray:
    """(8, 7) input matrix of :data:`CHANNELS`: forces directly, a current error through the slope of the drag."""
    g = np.zeros((NX, CHANNELS))
    g[U:, :4] = np.diag(1.0 / np.array(model.mass_kg))
    g[U:, 4:] = -velocity_jacobian(model, nu)[:, :3]
    return g


def error_of(x: FloatArray, z: FloatArray) -> FloatArray:
    """Error (8,) of state ``x`` (8,) relative to the planned state ``z`` (8,), in the body frame of ``z``."""
    e = x - z
    c, s = math.cos(z[YAW]), math.sin(z[YAW])
    north, east = float(e[X]), float(e[Y])
    e[X], e[Y] = c * north + s * east, c * east - s * north
    e[YAW] -= 2.0 * math.pi * round(float(e[YAW]) / (2.0 * math.pi))
    return e
