"""What has to be known before a mode in which the vehicle is steered begins: circles and dives."""

import math

from autopilot.command.modes import Modes
from autopilot.core.geodesy import refuse_place
from autopilot.core.params import ParamSet
from autopilot.core.vehicle import Vehicle
from autopilot.mavlink.api import Circling, FlightMode
from autopilot.mission.circling import Circle
from autopilot.mission.goals import Goals
from autopilot.mission.store import Plans


class Steering:
    """Makes circles and dives of requests and parameters; the reason where that is not possible, else ""."""

    def __init__(self, vehicle: Vehicle, params: ParamSet, plans: Plans, goals: Goals, modes: Modes) -> None:
        self._vehicle = vehicle
        self._params = params
        self._plans = plans
        self._goals = goals
        self._modes = modes
        self._asked_m: float | None = None

    def prepare(self, mode: FlightMode) -> str:
        """Before a mode is chosen without more words."""
        if mode is FlightMode.TAKEOFF:
            return self.choose_dive(None if self._modes.armed else self._asked_m)
        if mode is not FlightMode.CIRCLE or not self._modes.armed:
            return ""
        reason = self._ahead()
        return f"Circle denied: {reason}" if reason else ""

    def depth_refusal(self, depth_m: float) -> str:
        """Why a depth cannot be gone to."""
        low, high = self._params["DEPTH_MIN"], self._params["DEPTH_MAX"]
        return "" if low <= depth_m <= high else f"depth {depth_m:.2f} m is outside {low:g} to {high:g} m"

    def choose_dive(self, depth_m: float | None) -> str:
        """Depth of the next dive, None = TKOFF_DEPTH."""
        self._asked_m = depth_m
        wanted_m = self._params["TKOFF_DEPTH"] if depth_m is None else depth_m
        reason = self.depth_refusal(wanted_m)
        if reason:
            return f"Takeoff denied: {reason}" + (", set TKOFF_DEPTH" if depth_m is None else "")
        self._modes.dive_m = wanted_m
        return ""

    def choose_circle(self, asked: Circling) -> str:
        """The circle of a command."""
        nav, params = self._modes.nav, self._params
        if nav is None:
            return "no position"
        centre_m, depth_m = nav.pos_ned_m[:2].tolist(), float(nav.pos_ned_m[2])
        if asked.centre is not None:
            place = asked.centre
            refusal = refuse_place(self._plans.origin, place.lat_deg, place.lon_deg)
            if refusal:
                return refusal
            local = self._plans.local_ned_m(place.lat_deg, place.lon_deg, place.alt_m)
            centre_m, depth_m = local[:2].tolist(), depth_m if asked.depth_held else float(local[2])
        radius_m = params["CIRCLE_RADIUS"] if asked.radius_m is None else asked.radius_m
        speed = abs(params["CIRCLE_SPEED"]) if asked.speed_m_s is None else abs(asked.speed_m_s)
        clockwise = params["CIRCLE_SPEED"] >= 0.0 if asked.clockwise is None else asked.clockwise
        circle = Circle(
            params,
            (centre_m[0], centre_m[1]),
            radius_m,
            speed if clockwise else -speed,
            depth_m=self._in_band(depth_m) if asked.depth_held else depth_m,
            yaw=asked.yaw,
            turns=asked.turns,
        )
        return self._take(circle)

    def circle_at(self, depth_m: float) -> str:
        """The circle in force at another depth."""
        circle = self._modes.circle
        if circle is None:
            return "there is no circle"
        reason = self.depth_refusal(depth_m)
        if not reason:
            circle.depth_m = depth_m
        return reason

    def _ahead(self) -> str:
        """The circle of mode CIRCLE by itself: its centre lies ahead of the vehicle."""
        nav, params = self._modes.nav, self._params
        if nav is None:
            return "no position"
        x, y, z = nav.pos_ned_m.tolist()
        radius_m, yaw = params["CIRCLE_RADIUS"], float(nav.rpy_rad[2])
        centre_m = (x + radius_m * math.cos(yaw), y + radius_m * math.sin(yaw))
        speed = params["CIRCLE_SPEED"]
        depth_m = self._in_band(z)
        return self._take(Circle(params, centre_m, radius_m, speed or 0.1, depth_m=depth_m))

    def _take(self, circle: Circle) -> str:
        keep_m = self._vehicle.radius_m + self._params["MPC_MARGIN"]
        reason = circle.refusal(self._goals.room, keep_m)
        if not reason:
            self._modes.circle = circle
        return reason

    def _in_band(self, depth_m: float) -> float:
        return min(max(depth_m, self._params["DEPTH_MIN"]), self._params["DEPTH_MAX"])
