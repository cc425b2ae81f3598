"""Estimate for the controller in benchmarks on the 4-DoF model: the state of the model."""

import numpy as np

from autopilot.core.frames import FloatArray, wrap_pi
from autopilot.core.messages import NavHealth, NavState
from autopilot.core.model4 import YAW


def estimate_of(
    t_us: int, x: FloatArray, *, current_ned_m_s: FloatArray | None = None, sigma: FloatArray | None = None
) -> NavState:
    """Estimate equal to the state ``x`` (8,); ``sigma`` (12,): its standard deviations (default: none)."""
    return NavState(
        t_us=t_us,
        health=NavHealth.GOOD,
        pos_ned_m=x[:3],
        rpy_rad=np.array([0.0, 0.0, wrap_pi(float(x[YAW]))]),
        vel_frd_m_s=x[4:7],
        vel_water_frd_m_s=x[4:7],
        rate_frd_rad_s=np.array([0.0, 0.0, x[7]]),
        current_ned_m_s=np.zeros(3) if current_ned_m_s is None else current_ned_m_s,
        variance=np.zeros(12) if sigma is None else sigma**2,
    )
