"""Mode GUIDED: follows a client's setpoints until they time out."""

import math
from dataclasses import replace

import numpy as np

from autopilot.command.modes.mode import GOAL_UPDATE_US, FlightModeBehaviour, ModeContext, ModeStep, denied
from autopilot.command.vehicle_status import VehicleStatus
from autopilot.core import operator_messages as notices
from autopilot.core.frames import FloatArray, wrap_pi
from autopilot.core.messages import Goal, NavState, VelocityGoal
from autopilot.mavlink.api import CommandReply, FlightMode, SetPoint

NONE_YET = "send set points first"


class GuidedMode(FlightModeBehaviour):
    """The newest set point, and the goal that it makes."""

    name = FlightMode.GUIDED
    steered = True

    def __init__(self, tools: ModeContext) -> None:
        super().__init__(tools)
        self._point: SetPoint | None = None
        self._lacks = NONE_YET
        """Why there is nothing to follow."""
        self._forget()

    def _forget(self) -> None:
        self._place: FloatArray | None = None
        self._depth_m: float | None = None
        self._yaw_rad: float | None = None
        self._goal: Goal | None = None
        self._made_of: SetPoint | None = None
        self._made_us = 0

    def refusal(self, status: VehicleStatus | None, *, armed: bool) -> CommandReply | None:
        """No position, or nothing to follow."""
        refusal = super().refusal(status, armed=armed)
        if refusal is None and armed and status is not None and not self._alive(status.t_us):
            refusal = denied(f"Offboard denied: {self._lacks}")
        return refusal

    def enter(self, nav: NavState | None) -> None:
        """Hold the present state in the axes that setpoints leave open."""
        self._forget()

    def step(self, status: VehicleStatus, nav: NavState) -> ModeStep:
        if self._alive(status.t_us):
            return ModeStep(goal=self._followed(nav))
        self._operator.say(notices.SETPOINTS_STOPPED())
        return ModeStep(enter=FlightMode.HOLD)

    def refuse_point(self, point: SetPoint) -> str:
        """Why it cannot be followed, "" if it can."""
        reason = "" if point.depth_m is None else self._goals.refuse_depth(point.depth_m)
        if reason or point.place_ned_m is None:
            return reason
        depth_m = self._params["DEPTH_MIN"] if point.depth_m is None else point.depth_m
        return self._goals.refuse(np.array([*point.place_ned_m, depth_m]))

    def take(self, point: SetPoint | None, lacks: str = NONE_YET) -> None:
        """The newest setpoint; None = none can be followed, with the reason."""
        self._point, self._lacks = point, lacks

    def _alive(self, t_us: int) -> bool:
        """Whether there is a setpoint that has not timed out."""
        return self._point is not None and t_us <= self._point.until_us

    def _followed(self, nav: NavState) -> Goal:
        """Of the newest set point; the same object while nothing changes."""
        point, made_of = self._point, self._made_of
        same = point is not None and made_of is not None and replace(point, until_us=made_of.until_us) == made_of
        turns = point is not None and point.vel_m_s is not None and point.body
        if self._goal is None or not same or (turns and nav.t_us - self._made_us >= GOAL_UPDATE_US):
            self._goal, self._made_of = self._made(point or SetPoint(until_us=0), nav), point
            self._made_us = nav.t_us
        return self._goal

    def _made(self, point: SetPoint, nav: NavState) -> Goal:
        rest = self._goals.hold(nav)
        place = self._held_place(point, rest)
        depth_m = self._held_depth(point, rest)
        yaw = self._held_yaw(point, nav)
        goal = replace(rest, pos_ned_m=np.array([place[0], place[1], depth_m]), yaw_rad=yaw)
        north, east = self._velocity(point, nav)
        if point.vel_m_s is None and point.down_m_s is None and point.yaw_rate_rad_s is None:
            return goal
        drive = VelocityGoal(
            north_m_s=north,
            east_m_s=east,
            turn_rad_s=(point.yaw_rate_rad_s or 0.0) if point.body else 0.0,
            down_m_s=point.down_m_s,
            yaw_rate_rad_s=point.yaw_rate_rad_s,
        )
        moves = point.vel_m_s is not None
        return replace(goal, speed_m_s=max(math.hypot(north, east), 0.01) if moves else goal.speed_m_s, drive=drive)

    def _velocity(self, point: SetPoint, nav: NavState) -> tuple[float, float]:
        if point.vel_m_s is None:
            return 0.0, 0.0
        a, b = point.vel_m_s
        if not point.body:
            return a, b
        c, s = math.cos(float(nav.rpy_rad[2])), math.sin(float(nav.rpy_rad[2]))
        return c * a - s * b, s * a + c * b

    def _held_place(self, point: SetPoint, rest: Goal) -> FloatArray:
        if point.place_ned_m is not None:
            self._place = np.array(point.place_ned_m)
        elif point.vel_m_s is not None and (point.vel_m_s[0] or point.vel_m_s[1]):
            self._place = None
            return rest.pos_ned_m
        elif self._place is None:
            self._place = rest.pos_ned_m[:2].copy()
        return self._place

    def _held_depth(self, point: SetPoint, rest: Goal) -> float:
        if point.depth_m is not None:
            self._depth_m = point.depth_m
        elif point.down_m_s:
            self._depth_m = None
            return float(rest.pos_ned_m[2])
        elif self._depth_m is None:
            self._depth_m = float(rest.pos_ned_m[2])
        return self._depth_m

    def _held_yaw(self, point: SetPoint, nav: NavState) -> float | None:
        if point.yaw_rad is not None:
            self._yaw_rad = wrap_pi(point.yaw_rad)
        elif point.yaw_rate_rad_s is not None:
            self._yaw_rad = None
        elif self._yaw_rad is None:
            self._yaw_rad = float(nav.rpy_rad[2])
        return self._yaw_rad
