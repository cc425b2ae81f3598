"""Control in a stream that comes near to what the vehicle can do.

Given up, in this order: the heading (bow into the stream), the margin of the planar speed, the goal. Beyond the speed
limit itself the vehicle goes only where the stream would carry it against a boundary.
"""

import math

import numpy as np

from autopilot.control.path.path_tuning import REFERENCE, STRONG_STREAM
from autopilot.control.path.planner import Planner
from autopilot.control.path.reference import unknown_speed_m_s
from autopilot.core.control_allocator import ControlAllocator
from autopilot.core.frames import FloatArray
from autopilot.core.messages import Goal, NavState
from autopilot.core.model4 import AXES
from autopilot.core.params import ParamSet


class StrongStream:
    """One per vehicle; updated once per control step. Without such a stream nothing is given up."""

    def __init__(self, allocator: ControlAllocator, radius_m: float) -> None:
        self._allocator, self._radius_m = allocator, radius_m
        self.reset()

    def reset(self) -> None:
        self._t_us: int | None = None
        self._current = np.zeros(2)
        self._arrived = False
        self.active = False
        self.bow_rad: float | None = None
        """Heading into the stream that replaces the goal's, None = the goal's can be held."""
        self.cap_m_s = 0.0
        """Least planar speed through the water that the optimiser may use."""
        self.can_m_s = 0.0
        """Speed through the water that can be made, bow on."""
        self.shortfall = ""
        """What is missing to reach the goal, "" = nothing."""

    def update(
        self, nav: NavState, x0: FloatArray, goal: Goal, planner: Planner, params: ParamSet, limit_n: FloatArray
    ) -> None:
        tuning, limit_m_s = STRONG_STREAM, params["SPD_PLANAR_MAX"]
        estimated = nav.current_ned_m_s[:2]
        elapsed_s = math.inf if self._t_us is None else max(0.0, (nav.t_us - self._t_us) * 1e-6)
        self._current = self._current + (estimated - self._current) * min(1.0, elapsed_s / tuning.follow_s)
        self._t_us, current_m_s = nav.t_us, math.hypot(*self._current.tolist())
        made_m_s = max(limit_m_s - unknown_speed_m_s(params), tuning.least_made_m_s)
        self.active = current_m_s > (tuning.leave_ratio if self.active else tuning.enter_ratio) * made_m_s
        if not self.active:
            self.bow_rad, self.cap_m_s, self.can_m_s, self.shortfall = None, 0.0, 0.0, ""
            return
        here, place = x0[:2], np.asarray(goal.pos_ned_m[:2], dtype=float)
        away = place - here
        away_m, within_m = math.hypot(*away.tolist()), goal.accept_radius_m
        self._arrived = goal.drive is None and away_m < (tuning.left_radii if self._arrived else 1.0) * within_m
        bow = math.atan2(-self._current[1], -self._current[0])
        needed = 0.0 if goal.yaw_rad is None else self._thrust_fraction(goal.yaw_rad - bow, current_m_s, limit_n)
        travel = 0.0
        if goal.yaw_rad is not None and not self._arrived:
            travel = self._thrust_fraction(goal.yaw_rad - bow, max(current_m_s, made_m_s), limit_n)
        free = goal.yaw_rad is None or goal.facing_ned_m is not None
        most = tuning.regained_fraction if self.bow_rad is not None else tuning.thrust_fraction
        self.bow_rad = bow if free or max(needed, travel) > most else None
        own_m_s = min(current_m_s + tuning.headway_m_s, tuning.limit_fraction * limit_m_s)
        self.cap_m_s = own_m_s + self._near(here, planner) * max(0.0, current_m_s + tuning.escape_m_s - own_m_s)
        most_m_s = REFERENCE.upstream_speed_fraction * tuning.limit_fraction * limit_m_s
        self.can_m_s = self._fastest_m_s(most_m_s, limit_n)
        self.shortfall = ""
        if goal.drive is None:
            self.shortfall = self._missing(away / max(away_m, 1e-6), current_m_s, params["SPD_GROUND_MIN"])
            if not self.shortfall and not free and needed > most:
                self.shortfall = f"heading needs {100.0 * needed:.0f} % of the thrust"

    def _missing(self, direction: FloatArray, current_m_s: float, least_m_s: float) -> str:
        """What is missing to get nearer along a unit vector (2,), or to stay."""
        along = float(self._current @ direction)
        across = math.sqrt(max(current_m_s**2 - along**2, 0.0))
        needed_m_s = current_m_s if self._arrived else math.hypot(across, max(least_m_s - along, 0.0))
        missing_m_s = needed_m_s - self.can_m_s
        if missing_m_s <= 0.0:
            return ""
        return f"needs {0.01 * math.ceil(100.0 * missing_m_s):.2f} m/s more"

    def _near(self, here: FloatArray, planner: Planner) -> float:
        """0 to 1: how near boundaries are, here and a little downstream."""
        along = self._current / max(math.hypot(*self._current.tolist()), 1e-6)
        ahead = here + np.array([[0.0], [0.5], [1.0]]) * STRONG_STREAM.lee_m * along
        free_m = float(planner.features.clearance_m(ahead).min()) - self._radius_m
        far_m, near_m = STRONG_STREAM.far_m, STRONG_STREAM.near_m
        return min(max((far_m - free_m) / (far_m - near_m), 0.0), 1.0)

    def _thrust_fraction(self, off_rad: float, speed_m_s: float, limit_n: FloatArray) -> float:
        """Share of the thrust limits that holds a vehicle with its bow ``off_rad`` off a stream, buoyancy aside."""
        nu = np.zeros((2, AXES))
        nu[0, :2] = speed_m_s * math.cos(off_rad), -speed_m_s * math.sin(off_rad)
        # A square allocation has no other thruster for one that is lost.
        bound_n = np.full(len(limit_n), STRONG_STREAM.unlimited_n)
        if not self._allocator.square:
            bound_n[limit_n <= 0.0] = 0.0
        thrust_n = self._allocator.hold_n(nu, bound_n)
        return float((np.abs(thrust_n[0] - thrust_n[1]) / np.maximum(limit_n, 1e-3)).max())

    def _fastest_m_s(self, most_m_s: float, limit_n: FloatArray) -> float:
        """Speed up to ``most_m_s`` that the thrust makes, bow on."""
        low_m_s, high_m_s = most_m_s, most_m_s
        if self._thrust_fraction(0.0, most_m_s, limit_n) > 1.0:
            low_m_s = 0.0
            for _ in range(STRONG_STREAM.halvings):
                middle = 0.5 * (low_m_s + high_m_s)
                good = self._thrust_fraction(0.0, middle, limit_n) <= 1.0
                low_m_s, high_m_s = (middle, high_m_s) if good else (low_m_s, middle)
        return low_m_s
