"""Piloted modes: sticks to goals where there is a position, to body forces where there is none.

With a position the sticks of every mode become a motion that the controller follows within fence and limits. Thrust
sticks command the velocity through the water that their thrust would hold, so that the vehicle drifts with the
current as it would without control, but is slowed down at a boundary.
"""

import math
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from autopilot.command.modes.mode import GOAL_UPDATE_US, RELEASED, FlightModeBehaviour, ModeContext, ModeStep, denied
from autopilot.command.vehicle_status import VehicleStatus
from autopilot.control.thrust.by_hand import ByHand
from autopilot.core.control_allocator import ControlAllocator
from autopilot.core.frames import FloatArray
from autopilot.core.messages import Goal, NavState, VelocityGoal
from autopilot.mavlink.api import CommandReply, FlightMode, Sticks

TURN_STOP_RAD_S2 = 0.6
"""How hard a turn brakes when its stick is let go: the heading that is held is where it comes to rest."""

YAW_SHARE = 0.85
"""Share of SPD_YAW_MAX that a stick can ask for."""


def steady_speed(force: float, linear: float, quadratic: float) -> float:
    """The speed that a force holds against drag, with its sign."""
    size = abs(force)
    if quadratic > 0.0:
        speed = (math.sqrt(linear * linear + 4.0 * quadratic * size) - linear) / (2.0 * quadratic)
    else:
        speed = size / linear if linear > 0.0 else 0.0
    return math.copysign(speed, force)


@dataclass(slots=True)
class _Held:
    """Value held since the stick was released, None = stick deflected."""

    place: FloatArray | None = None
    depth_m: float | None = None
    yaw_rad: float | None = None


class PilotedMode(FlightModeBehaviour):
    """Maps the sticks to goals and forces."""

    steered = True
    holds_heading: ClassVar[bool] = True
    """With its stick released."""
    holds_depth: ClassVar[bool] = True
    holds_place: ClassVar[bool] = False
    """The planar sticks are velocities over ground."""

    def __init__(self, tools: ModeContext) -> None:
        super().__init__(tools)
        self._model = tools.vehicle.to_model()
        self._allocator = ControlAllocator.of(tools.vehicle)
        self._limits_n = np.array([thruster.limit_n for thruster in tools.vehicle.thrusters])
        self._reach: tuple[float, FloatArray] | None = None
        self.enter(None)

    def enter(self, nav: NavState | None) -> None:
        """Hold the present values."""
        self._held = _Held()
        self._goal: Goal | None = None
        self._last_sticks: Sticks | None = None
        self._made_us = 0

    def position_came_or_went(self) -> None:
        """Reset the held values: they differ with and without a position."""
        self.enter(None)

    def step(self, status: VehicleStatus, nav: NavState) -> ModeStep:
        """Motion commanded by the sticks."""
        return ModeStep(goal=self._goal_of(status.sticks or RELEASED, nav))

    def _goal_of(self, sticks: Sticks, nav: NavState) -> Goal:
        """The same object while nothing changes."""
        if self._goal is not None and self._last_sticks == sticks and nav.t_us - self._made_us < GOAL_UPDATE_US:
            return self._goal
        self._last_sticks, self._made_us = sticks, nav.t_us
        made = self._made(sticks, nav)
        old = self._goal
        if old is None or made.drive != old.drive or made.yaw_rad != old.yaw_rad or _moved(made, old):
            self._goal = made
        assert self._goal is not None
        return self._goal

    def by_hand(self, status: VehicleStatus) -> ByHand | None:
        """Forces, and the depth and heading that can be held."""
        sticks = status.sticks or RELEASED
        reach = self._reach_n()
        demand = np.array([sticks.ahead, sticks.starboard, -sticks.up, sticks.turn])
        return ByHand(
            force=demand * reach,
            yaw_rate_rad_s=sticks.turn * self._yaw_rate() if self.holds_heading else None,
            down_m_s=-sticks.up * self._params["PILOT_SPD_Z"] if self.holds_depth else None,
        )

    def _made(self, sticks: Sticks, nav: NavState) -> Goal:
        rest = self._goals.hold(nav)
        down_m_s, turn_rad_s = self._others(sticks, nav, rest)
        planar = self._planar(sticks, nav, rest)
        drive = replace(planar, down_m_s=down_m_s, yaw_rate_rad_s=turn_rad_s)
        here = nav.pos_ned_m if self._held.place is None else self._held.place
        depth_m = float(nav.pos_ned_m[2]) if self._held.depth_m is None else self._held.depth_m
        return replace(
            rest,
            pos_ned_m=np.array([here[0], here[1], depth_m]),
            yaw_rad=self._held.yaw_rad,
            speed_m_s=max(math.hypot(drive.north_m_s, drive.east_m_s), 0.01),
            drive=drive,
        )

    def _planar(self, sticks: Sticks, nav: NavState, rest: Goal) -> VelocityGoal:
        yaw, held = float(nav.rpy_rad[2]), self._held
        ahead, starboard = sticks.ahead, sticks.starboard
        north, east = 0.0, 0.0
        if self.holds_place:
            if not (ahead or starboard):
                held.place = rest.pos_ned_m[:2].copy() if held.place is None else held.place
                return VelocityGoal()
            u, v = (self._params["PILOT_SPD"] * deflection for deflection in (ahead, starboard))
        else:
            model, reach = self._model, self._reach_n()
            u, v = (
                steady_speed(deflection * float(reach[axis]), model.linear_drag[axis], model.quadratic_drag[axis])
                for axis, deflection in enumerate((ahead, starboard))
            )
            north, east = float(nav.current_ned_m_s[0]), float(nav.current_ned_m_s[1])
        held.place = None
        c, s = math.cos(yaw), math.sin(yaw)
        return VelocityGoal(north_m_s=north + c * u - s * v, east_m_s=east + s * u + c * v)

    def _others(self, sticks: Sticks, nav: NavState, rest: Goal) -> tuple[float | None, float | None]:
        """Rates of depth and heading, or their held values."""
        held, model = self._held, self._model
        down: float | None
        turn: float | None = sticks.turn * self._yaw_rate()
        if not self.holds_depth:
            reach = float(self._reach_n()[2])
            down = -steady_speed(sticks.up * reach, model.linear_drag[2], model.quadratic_drag[2])
            held.depth_m = None
        elif sticks.up:
            down = -sticks.up * self._params["PILOT_SPD_Z"]
            self._let_go_of_depth()
        else:
            down, held.depth_m = None, self._held_depth_m(rest)
        if not self.holds_heading or sticks.turn:
            held.yaw_rad = None
        else:
            rate = float(nav.rate_frd_rad_s[2])
            stop = float(nav.rpy_rad[2]) + rate * abs(rate) / (2.0 * TURN_STOP_RAD_S2)
            turn, held.yaw_rad = None, stop if held.yaw_rad is None else held.yaw_rad
        return down, turn

    def _held_depth_m(self, rest: Goal) -> float:
        """``rest``: with the stick released, the depth at which the vehicle comes to rest."""
        return float(rest.pos_ned_m[2]) if self._held.depth_m is None else self._held.depth_m

    def _let_go_of_depth(self) -> None:
        self._held.depth_m = None

    def _yaw_rate(self) -> float:
        return min(self._params["PILOT_RATE_YAW"], YAW_SHARE * self._params["SPD_YAW_MAX"])

    def _reach_n(self) -> FloatArray:
        """(4,) force of full deflection of each stick alone."""
        limit = self._params["THR_LIMIT"]
        if self._reach is None or self._reach[0] != limit:
            self._reach = (limit, self._allocator.reach(np.minimum(self._limits_n, limit)))
        return self._reach[1]


class ManualMode(PilotedMode):
    """Sticks are forces and moments, without feedback."""

    name = FlightMode.MANUAL
    holds_heading = holds_depth = False


class StabilizeMode(PilotedMode):
    """Manual with heading hold."""

    name = FlightMode.STABILIZE
    holds_depth = False


class DepthHoldMode(PilotedMode):
    """As stabilize, depth held: without a position by the pressure sensor."""

    name = FlightMode.ALT_HOLD

    def refusal(self, status: VehicleStatus | None, *, armed: bool) -> CommandReply | None:
        """Refused while there is neither an estimate nor a depth."""
        if not armed or status is None or status.estimate is not None:
            return None
        measured = status.measured(status.t_us)
        return denied(f"{self.name.name} denied: no depth, use STABILIZE") if measured.depth_m is None else None


class PositionMode(PilotedMode):
    """Sticks command velocities; released, the vehicle holds position."""

    name = FlightMode.POSHOLD
    holds_place = True


def _moved(made: Goal, old: Goal) -> bool:
    """Whether position or depth of the goal changed. For a velocity goal the position is for display only."""
    gap = np.abs(made.pos_ned_m - old.pos_ned_m)
    drive = made.drive
    held = drive is None or not (drive.north_m_s or drive.east_m_s)
    return bool((gap[:2] > 0.0).any() if held else (gap[:2] > 0.1).any()) or bool(gap[2] > 0.0)
