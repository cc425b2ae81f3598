"""Tether: quasi-static force on the centre of gravity, unknown to the controller.

Drag of the part that moves with the vehicle through the water, 0.5 rho C_d d L |v_r| v_r, and a constant pull towards
the place where the tether enters the water. The tether is neutrally buoyant (LBV manual) and makes no moment here.
"""

import math
from collections.abc import Sequence

from autopilot.core.vehicle import Tether, Vec3

WATER_DENSITY_KG_M3 = 998.0
"""Fresh water at 21 degrees C."""

SLACK_M = 0.2
"""Closer than this to its entry point the tether loses its pull in proportion (assumed: one bend radius)."""


def tether_force_ned_n(
    tether: Tether, entry_ned_m: Vec3, pos_ned_m: Sequence[float], vel_water_ned_m_s: Sequence[float]
) -> Vec3:
    """Force on the vehicle (3,) NED [N] at a position, moving at a velocity relative to the water."""
    speed = math.hypot(*vel_water_ned_m_s)
    area_m2 = tether.diameter_m * tether.length_in_flow_m
    drag = 0.5 * WATER_DENSITY_KG_M3 * tether.drag_coefficient * area_m2 * speed
    away = [p - e for p, e in zip(pos_ned_m, entry_ned_m, strict=True)]
    pull = tether.pull_n / max(math.hypot(*away), SLACK_M)
    return (
        -drag * vel_water_ned_m_s[0] - pull * away[0],
        -drag * vel_water_ned_m_s[1] - pull * away[1],
        -drag * vel_water_ned_m_s[2] - pull * away[2],
    )
