"""Mode CIRCLE: around the centre of DO_ORBIT, or around a centre ahead of the vehicle."""

import math

from autopilot.command.modes.mode import GO_ON, FlightModeBehaviour, ModeContext, ModeStep
from autopilot.command.vehicle_status import VehicleStatus
from autopilot.core import operator_messages as notices
from autopilot.core.geodesy import refuse_place
from autopilot.core.messages import NavState
from autopilot.mavlink.api import Circling, FlightMode
from autopilot.mission.circling import LoiterCircle


class CircleMode(FlightModeBehaviour):
    """The circle that was chosen last."""

    name = FlightMode.CIRCLE
    steered = True

    def __init__(self, tools: ModeContext) -> None:
        super().__init__(tools)
        self._circle: LoiterCircle | None = None

    def prepare(self, nav: NavState | None, *, armed: bool) -> str:
        """By itself its centre lies ahead of the vehicle."""
        if not armed:
            return ""
        reason = self._choose_ahead(nav)
        return f"Circle denied: {reason}" if reason else ""

    def step(self, status: VehicleStatus, nav: NavState) -> ModeStep:
        if self._circle is None:
            return GO_ON
        goal = self._circle.goal(nav)
        if not self._circle.over:
            return ModeStep(goal=goal)
        self._operator.say(notices.CIRCLE_DONE())
        return ModeStep(goal=goal, enter=FlightMode.HOLD)

    def go_to_depth(self, depth_m: float) -> str | None:
        if self._circle is None:
            return "there is no circle"
        reason = self._goals.refuse_depth(depth_m)
        if not reason:
            self._circle.depth_m = depth_m
        return reason

    def choose(self, request: Circling, nav: NavState | None) -> str:
        """Set the circle of a command. Returns the reason of a refusal, else ""."""
        params = self._params
        if nav is None:
            return "no position"
        centre_m, depth_m = nav.pos_ned_m[:2].tolist(), float(nav.pos_ned_m[2])
        if request.centre is not None:
            place = request.centre
            refusal = refuse_place(self._plans.origin, place.lat_deg, place.lon_deg)
            if refusal:
                return refusal
            local = self._plans.local_ned_m(place.lat_deg, place.lon_deg, place.alt_m)
            centre_m, depth_m = local[:2].tolist(), depth_m if request.depth_held else float(local[2])
        radius_m = params["CIRCLE_RADIUS"] if request.radius_m is None else request.radius_m
        speed = abs(params["CIRCLE_SPEED"]) if request.speed_m_s is None else abs(request.speed_m_s)
        clockwise = params["CIRCLE_SPEED"] >= 0.0 if request.clockwise is None else request.clockwise
        circle = LoiterCircle(
            params,
            (centre_m[0], centre_m[1]),
            radius_m,
            speed if clockwise else -speed,
            depth_m=self._goals.in_band(depth_m) if request.depth_held else depth_m,
            yaw=request.yaw,
            turns=request.turns,
        )
        return self._take(circle)

    def _choose_ahead(self, nav: NavState | None) -> str:
        params = self._params
        if nav is None:
            return "no position"
        x, y, z = nav.pos_ned_m.tolist()
        radius_m, yaw = params["CIRCLE_RADIUS"], float(nav.rpy_rad[2])
        centre_m = (x + radius_m * math.cos(yaw), y + radius_m * math.sin(yaw))
        speed = params["CIRCLE_SPEED"] or 0.1
        return self._take(LoiterCircle(params, centre_m, radius_m, speed, depth_m=self._goals.in_band(z)))

    def _take(self, circle: LoiterCircle) -> str:
        reason = self._goals.refuse_circle(circle)
        if not reason:
            self._circle = circle
        return reason
