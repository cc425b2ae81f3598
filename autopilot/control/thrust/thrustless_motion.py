"""Acceleration of the 4-DoF model without thrust, as reference of the filters that estimate thruster behaviour.

Used by :mod:`autopilot.control.thrust.thruster_health` and :mod:`autopilot.control.thrust.actuation_delay`: the
difference to the measured acceleration is thrust or an unmodelled disturbance.
"""

import math
from collections.abc import Sequence

import numpy as np

from autopilot.core.frames import FloatArray
from autopilot.core.messages import NavState
from autopilot.core.model4 import NO_FORCES, Model4, forced_acceleration


def thrustless_motion(model: Model4, nav: NavState, current_ned_m_s: Sequence[float]) -> tuple[float, ...]:
    """(8,) velocity over ground and yaw rate, and their rate of change without thrust in that current (3,)."""
    ground_u, ground_v, ground_w = nav.vel_frd_m_s.tolist()
    north, east, down = current_ned_m_s
    yaw, r = nav.rpy_rad.item(2), nav.rate_frd_rad_s.item(2)
    c, s = math.cos(yaw), math.sin(yaw)
    flow_u, flow_v = c * north + s * east, c * east - s * north
    nu = (ground_u - flow_u, ground_v - flow_v, ground_w - down, r)
    du, dv, dw, dr = forced_acceleration(model, nu, NO_FORCES, math)
    # A steady current turns in the body frame.
    return ground_u, ground_v, ground_w, r, du + r * flow_v, dv - r * flow_u, dw, dr


def push_sigma(model: Model4, nav: NavState, at_rest: tuple[float, ...], flow_m_s: float) -> FloatArray:
    """(4,) standard deviation of unknown accelerations at the speed of now.

    ``at_rest`` (4,) is that of a vehicle at rest; ``flow_m_s`` that of the water's velocity, of which drag and Munk
    moment make more the faster the vehicle is."""
    m11, m22, _, m44 = model.mass_kg
    speed = np.abs(nav.vel_frd_m_s)
    slope = [(model.linear_drag[i] + 2.0 * model.quadratic_drag[i] * speed[i]) / model.mass_kg[i] for i in range(2)]
    munk = abs(m11 - m22) / m44 * math.hypot(speed[0], speed[1])
    return np.hypot(at_rest, np.array([slope[0], slope[1], 0.0, munk]) * flow_m_s)
