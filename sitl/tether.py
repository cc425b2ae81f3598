"""Tether: quasi-static force on the centre of gravity, unknown to the controller.

Drag of the part that moves with the vehicle through the water, 0.5 rho C_d d L |v_r| v_r, and a constant pull towards
the place where the tether enters the water. The tether is neutrally buoyant (LBV manual) and makes no moment here.
"""

import math
from collections.abc import Callable

from autopilot.core.toml_table import Vec3
from autopilot.core.vehicle import Tether

WATER_DENSITY_KG_M3 = 998.0
"""Fresh water at 21 degrees C."""

SLACK_M = 0.2
"""Closer than this to its entry point the tether loses its pull in proportion (assumed: one bend radius)."""


def make_tether(tether: Tether, entry_ned_m: Vec3) -> Callable[[Vec3, Vec3], Vec3]:
    """Force on the vehicle (3,) NED [N] as a function of its position and its velocity relative to the water, NED."""
    area_m2 = tether.diameter_m * tether.length_in_flow_m
    drag_n_s2_m2 = 0.5 * WATER_DENSITY_KG_M3 * tether.drag_coefficient * area_m2
    pull_n = tether.pull_n
    entry_n, entry_e, entry_d = entry_ned_m

    def force_ned_n(pos_ned_m: Vec3, vel_water_ned_m_s: Vec3) -> Vec3:
        x, y, z = pos_ned_m
        vn, ve, vd = vel_water_ned_m_s
        an, ae, ad = x - entry_n, y - entry_e, z - entry_d
        drag = drag_n_s2_m2 * math.sqrt(vn * vn + ve * ve + vd * vd)
        pull = pull_n / max(math.sqrt(an * an + ae * ae + ad * ad), SLACK_M)
        return -drag * vn - pull * an, -drag * ve - pull * ae, -drag * vd - pull * ad

    return force_ned_n
