"""Tether: quasi-static force on the centre of gravity, unknown to the controller.

Drag of the part that moves with the vehicle through the water, 0.5 rho C_d d L |v_r| v_r, and a constant tension
towards the point where the tether enters the water. The tether is neutrally buoyant (LBV manual) and causes no moment.
"""

import math
from dataclasses import dataclass

from autopilot.core.toml_table import Vec3
from autopilot.core.vehicle import Tether

WATER_DENSITY_KG_M3 = 998.0
"""Fresh water at 21 degrees C."""

SLACK_M = 0.2
"""Closer than this to its entry point the tether loses its pull in proportion (assumed: one bend radius)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TetherForce:
    """Force on the vehicle (3,) NED [N] as a function of its position and its velocity relative to the water, NED."""

    drag_n_s2_m2: float
    pull_n: float
    entry_ned_m: Vec3
    slack_m: float = SLACK_M

    def __call__(self, pos_ned_m: Vec3, vel_water_ned_m_s: Vec3) -> Vec3:
        x, y, z = pos_ned_m
        vn, ve, vd = vel_water_ned_m_s
        entry_n, entry_e, entry_d = self.entry_ned_m
        an, ae, ad = x - entry_n, y - entry_e, z - entry_d
        drag = self.drag_n_s2_m2 * math.sqrt(vn * vn + ve * ve + vd * vd)
        pull = self.pull_n / max(math.sqrt(an * an + ae * ae + ad * ad), self.slack_m)
        return -drag * vn - pull * an, -drag * ve - pull * ae, -drag * vd - pull * ad


def make_tether(tether: Tether, entry_ned_m: Vec3) -> TetherForce:
    """The force of a vehicle's tether that enters the water there."""
    area_m2 = tether.diameter_m * tether.length_in_flow_m
    drag_n_s2_m2 = 0.5 * WATER_DENSITY_KG_M3 * tether.drag_coefficient * area_m2
    return TetherForce(drag_n_s2_m2=drag_n_s2_m2, pull_n=tether.pull_n, entry_ned_m=entry_ned_m)
