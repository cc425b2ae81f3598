"""Mode SURFTRAK: depth hold relative to the floor (ArduSub's mode 21)."""

import math
from dataclasses import replace

from autopilot.command.modes.mode import RELEASED, ModeContext, ModeStep, denied
from autopilot.command.modes.piloted import DepthHoldMode
from autopilot.command.vehicle_status import VehicleStatus
from autopilot.control.thrust.by_hand import ByHand
from autopilot.core import operator_messages as notices
from autopilot.core.frames import FloatArray
from autopilot.core.messages import Goal, NavState, VelocityGoal
from autopilot.mavlink.api import CommandReply, FlightMode, Sticks

PLAY_M = 0.01
"""Deadband of the altitude: ranges are noisy."""

SLOWED, STOPPED = 0.8, 0.5
"""Below the first share of the height that is to be held sticks ahead and sideways count less, below the second not at
all: a floor that rises faster than the vehicle can is not run into."""

HEIGHT_GAIN_1_S = 1.5
"""Climb per error of the height."""

CHASE_M, CAUGHT_M = 0.02, 0.005
"""An error of the height beyond the first is made good by climbing or sinking until it is below the second; within that
the depth is held,"""
LEVEL_M_S = 0.02
"""as long as the floor below rises or falls no faster than that."""

FLOOR_RATE_S = 0.3
"""Time constant of how fast the floor rises or falls."""


class SurftrakMode(DepthHoldMode):
    """Holds the altitude over the floor. Without a range to the floor the depth is held until there is one."""

    name = FlightMode.SURFTRAK

    def __init__(self, tools: ModeContext) -> None:
        self._height_m: float | None = None
        """Altitude held, None = stick deflected, or floor not seen yet."""
        self._floor_m: float | None = None
        """Depth of the floor below, None = not known."""
        self._floor_us = 0
        """When that was last updated."""
        self._now_m: float | None = None
        """Height of now, None = not known."""
        self._reported: bool | None = None
        """Whether the floor was known at the last report."""
        self._floor_m_s = 0.0
        """How fast it falls below us, as we move over it."""
        self._chases = False
        """The height is being made good."""
        super().__init__(tools)

    def refusal(self, status: VehicleStatus | None, *, armed: bool) -> CommandReply | None:
        """Refused without a downward range sensor, or out of its range."""
        refusal = super().refusal(status, armed=armed)
        if refusal is None and armed and status is not None and self._height_of(status) is None:
            refusal = denied("SURFTRAK denied: no range to the floor, use ALT_HOLD")
        return refusal

    def enter(self, nav: NavState | None) -> None:
        """The height of here is held."""
        super().enter(nav)
        self._height_m = self._floor_m = self._now_m = self._reported = None
        self._floor_m_s, self._chases = 0.0, False

    def step(self, status: VehicleStatus, nav: NavState) -> ModeStep:
        """Motion commanded by the sticks, relative to the floor."""
        self._update_height(status, float(nav.pos_ned_m[2]))
        return super().step(status, nav)

    def by_hand(self, status: VehicleStatus) -> ByHand | None:
        """Without a position: the height by the rate of climb."""
        demand = super().by_hand(status)
        self._update_height(status, 0.0)
        up = (status.sticks or RELEASED).up
        if demand is None or up or self._now_m is None:
            self._height_m = None if up else self._height_m
            return demand
        self._height_m = self._now_m if self._height_m is None else self._height_m
        most = self._params["PILOT_SPD_Z"]
        error_m = self._now_m - self._height_m
        sinks = max(-most, min(most, HEIGHT_GAIN_1_S * error_m)) if abs(error_m) > PLAY_M else 0.0
        return replace(demand, down_m_s=sinks)

    def _update_height(self, status: VehicleStatus, depth_m: float) -> None:
        """Where the floor is, as fast as the vehicle may follow it."""
        self._now_m = self._height_of(status)
        known = self._now_m is not None
        if self._reported is not None and known is not self._reported:
            self._operator.say(notices.FLOOR_BACK() if known else notices.FLOOR_LOST())
        self._reported = known
        if self._now_m is None:
            return
        seen_m = depth_m + self._now_m
        if self._floor_m is None:
            self._floor_m, self._floor_us = seen_m, status.t_us
            return
        passed_s, self._floor_us = (status.t_us - self._floor_us) * 1e-6, status.t_us
        if passed_s <= 0.0:
            return
        off_m, most_m = seen_m - self._floor_m, self._params["PILOT_SPD_Z"] * passed_s
        beyond_m = off_m - math.copysign(min(abs(off_m), PLAY_M), off_m)
        moved_m = max(-most_m, min(most_m, beyond_m))
        self._floor_m += moved_m
        self._floor_m_s += min(passed_s / FLOOR_RATE_S, 1.0) * (moved_m / passed_s - self._floor_m_s)

    def _held_depth_m(self, rest: Goal) -> float:
        """Over the floor; the pilot's stick has moved the height."""
        if self._floor_m is None:
            return super()._held_depth_m(rest)
        if self._height_m is None:
            self._height_m = self._floor_m - float(rest.pos_ned_m[2])
        return self._goals.in_band(self._floor_m - self._height_m)

    def _others(self, sticks: Sticks, nav: NavState, rest: Goal) -> tuple[float | None, float | None]:
        """An altitude error beyond the deadband is corrected at no more than full-stick rate."""
        down_m_s, turn_rad_s = super()._others(sticks, nav, rest)
        depth_m, most_m_s = self._held.depth_m, self._params["PILOT_SPD_Z"]
        if down_m_s is not None or depth_m is None:
            return down_m_s, turn_rad_s
        off_m = depth_m - float(nav.pos_ned_m[2])
        near_m = CAUGHT_M if self._chases else CHASE_M
        self._chases = abs(off_m) > near_m or abs(self._floor_m_s) > LEVEL_M_S
        if self._chases:
            down_m_s = max(-most_m_s, min(most_m_s, HEIGHT_GAIN_1_S * off_m + self._floor_m_s))
        return down_m_s, turn_rad_s

    def _let_go_of_depth(self) -> None:
        super()._let_go_of_depth()
        self._height_m = None

    def _planar(self, sticks: Sticks, nav: NavState, rest: Goal) -> VelocityGoal:
        """Slows down when the floor comes near."""
        if self._height_m is not None and self._now_m is not None:
            fraction = (self._now_m / self._height_m - STOPPED) / (SLOWED - STOPPED)
            fraction = max(0.0, min(1.0, fraction))
            sticks = replace(sticks, ahead=fraction * sticks.ahead, starboard=fraction * sticks.starboard)
        return super()._planar(sticks, nav, rest)

    @staticmethod
    def _height_of(status: VehicleStatus) -> float | None:
        attitude: FloatArray | None = None if status.nav is None else status.nav.rpy_rad
        return status.floor.height_m(status.t_us, attitude)
