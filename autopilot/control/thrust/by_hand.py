"""Manual control without a position: forces from the pilot, heading hold by the AHRS, depth hold by the pressure
sensor.

Unmeasured quantities are not controlled: no fence, no speed limit. Neutral sticks include the trim for the vehicle's
buoyancy, so that it does not rise when they are released.
"""

import math
from dataclasses import dataclass

import numpy as np

from autopilot.control.thrust.slew import slewed
from autopilot.control.thrust.thrust_tuning import BY_HAND
from autopilot.core.control_allocator import ControlAllocator
from autopilot.core.frames import FloatArray, wrap_pi


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ByHand:
    force: FloatArray
    """(4,) X, Y, Z [N] and N [N m]."""
    yaw_rate_rad_s: float | None = None
    """None = the moment of ``force``; 0 = the heading is held."""
    down_m_s: float | None = None
    """None = the vertical force; 0 = the depth is held."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PositionlessState:
    """Measurements available without a position; None = not available."""

    yaw_rad: float | None = None
    yaw_rate_rad_s: float = 0.0
    depth_m: float | None = None


class HandLaw:
    """One instance per vehicle; asked once per tick while it flies."""

    def __init__(self, allocator: ControlAllocator) -> None:
        self._allocator = allocator
        self._thrust_n = np.zeros(allocator.model.thrusters)
        self.release()

    def release(self) -> None:
        self._last_us: int | None = None
        self._yaw_rad: float | None = None
        self._depth_m: float | None = None
        self._read_m: float | None = None
        self._rate_m_s = 0.0
        self._trim_n = 0.0

    def thrust_n(
        self, t_us: int, demand: ByHand, measured: PositionlessState, limit_n: FloatArray, now_n: FloatArray
    ) -> FloatArray:
        """(n,) thrust within ``limit_n`` [N]; ``now_n`` (n,) is the command at the start of this mode."""
        if self._last_us is None:
            self._last_us, self._thrust_n = t_us, np.array(now_n, dtype=float)
        elapsed_s = min(max((t_us - self._last_us) * 1e-6, 0.0), 0.1)
        self._last_us = t_us
        force = demand.force.copy()
        force[2] += self._allocator.model.buoyancy_excess_n
        self._feel_depth(measured.depth_m, elapsed_s)
        if demand.yaw_rate_rad_s is not None and measured.yaw_rad is not None:
            force[3] = self._moment(demand.yaw_rate_rad_s, measured.yaw_rad, measured.yaw_rate_rad_s)
        if demand.down_m_s is not None and measured.depth_m is not None:
            force[2] = self._heave_n(demand.down_m_s, measured.depth_m, elapsed_s, limit_n)
        thrust = self._allocator.thrust_n(force, limit_n)
        self._thrust_n = slewed(thrust, self._thrust_n, limit_n, elapsed_s)
        return self._thrust_n.copy()

    def _moment(self, demand_rad_s: float, yaw_rad: float, rate_rad_s: float) -> float:
        """Yaw moment [N m] of heading hold or commanded yaw rate."""
        model = self._allocator.model
        if demand_rad_s or self._yaw_rad is None:
            self._yaw_rad = yaw_rad
        turn = demand_rad_s or _limited(
            BY_HAND.yaw_gain_1_s * wrap_pi(self._yaw_rad - yaw_rad), BY_HAND.yaw_rate_limit_rad_s
        )
        drag = model.linear_drag[3] * turn + model.quadratic_drag[3] * abs(turn) * turn
        return drag + model.mass_kg[3] * BY_HAND.yaw_rate_gain_1_s * (turn - rate_rad_s)

    def _heave_n(self, demand_m_s: float, depth_m: float, elapsed_s: float, limit_n: FloatArray) -> float:
        """Heave force [N] of depth hold or commanded rate."""
        model = self._allocator.model
        if demand_m_s or self._depth_m is None:
            self._depth_m = depth_m
        climb = demand_m_s or _limited(BY_HAND.depth_gain_1_s * (self._depth_m - depth_m), BY_HAND.heave_limit_m_s)
        most = BY_HAND.trim_fraction * float(np.abs(np.array(model.allocation)[2]) @ limit_n)
        trim = self._trim_n + model.mass_kg[2] * BY_HAND.trim_gain_1_s2 * (climb - self._rate_m_s) * elapsed_s
        self._trim_n = _limited(trim, most)
        drag = model.linear_drag[2] * climb + model.quadratic_drag[2] * abs(climb) * climb
        return (
            model.buoyancy_excess_n
            + drag
            + model.mass_kg[2] * BY_HAND.heave_gain_1_s * (climb - self._rate_m_s)
            + self._trim_n
        )

    def _feel_depth(self, depth_m: float | None, elapsed_s: float) -> None:
        """The rate of depth, from readings that come more seldom than ticks."""
        if depth_m is None:
            self._read_m, self._rate_m_s, self._depth_m = None, 0.0, None
            return
        if self._read_m is None:
            self._read_m = depth_m
        fraction = elapsed_s / (BY_HAND.depth_rate_s + elapsed_s)
        # The low-passed reading's rate is the low-passed rate.
        self._rate_m_s = (depth_m - self._read_m) / BY_HAND.depth_rate_s
        self._read_m += fraction * (depth_m - self._read_m)


def _limited(value: float, most: float) -> float:
    return math.copysign(min(abs(value), most), value)
