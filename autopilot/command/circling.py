"""Mode CIRCLE: round a place, at a depth, at a speed."""

import math

import numpy as np

from autopilot.core.frames import FloatArray, wrap_pi
from autopilot.core.messages import Drive, Goal, NavState
from autopilot.core.params import ParamSet
from autopilot.core.vehicle import Vehicle
from autopilot.mavlink.api import OrbitYaw
from mission.goals import Goals

PULL_1_S = 0.6
"""How fast a distance from the circle is made good."""

PULL_SHARE = 0.7
"""Share of the speed that may go into it."""

JOIN_M = 0.25
"""Farther off, the circle's nearest point is a place to go to."""

SAMPLES = 72
FRESH_TICKS = 5
YAW_SHARE = 0.5
"""Share of SPD_YAW_MAX that a circle on which the heading turns may use."""


class Circle:
    """One circle, from its beginning to its end."""

    def __init__(
        self,
        vehicle: Vehicle,
        params: ParamSet,
        goals: Goals,
        centre_m: tuple[float, float],
        radius_m: float,
        speed_m_s: float,
        *,
        depth_m: float,
        yaw: OrbitYaw = OrbitYaw.TO_CENTRE,
        turns: float = 0.0,
    ) -> None:
        """``speed_m_s``: negative = to port; ``turns``: 0 = for ever."""
        self._keep_m = vehicle.radius_m + params["MPC_MARGIN"]
        self._params = params
        self._goals = goals
        self._centre = complex(*centre_m)
        self.radius_m = radius_m
        most = min(params["SPD_PLANAR_MAX"], YAW_SHARE * params["SPD_YAW_MAX"] * radius_m)
        self._speed_m_s = math.copysign(min(abs(speed_m_s), most), speed_m_s)
        self.depth_m = depth_m
        self._yaw, self._turns = yaw, turns
        self._initial_rad: float | None = None
        self._bearing: float | None = None
        self._turned = 0.0
        self._goal: Goal | None = None
        self._age = 0

    def refusal(self) -> str:
        """Why it cannot be flown, "" if it can."""
        low, high = self._params["DEPTH_MIN"], self._params["DEPTH_MAX"]
        if not low <= self.depth_m <= high:
            return f"depth {self.depth_m:.2f} m is outside {low:g} to {high:g} m"
        angles = np.linspace(0.0, 2.0 * math.pi, SAMPLES, endpoint=False)
        places = self._centre + self.radius_m * np.exp(1j * angles)
        room = float(self._goals.room.clearance_m(places.view(float).reshape(-1, 2)).min())
        if room < self._keep_m:
            return f"circle comes within {room:.2f} m of the fence, keep {self._keep_m:.2f} m"
        return ""

    @property
    def over(self) -> bool:
        """All turns have been made."""
        return self._turns > 0.0 and abs(self._turned) >= 2.0 * math.pi * self._turns

    def goal(self, nav: NavState) -> Goal:
        """Of this tick; the same object until it is due again."""
        away = complex(nav.pos_ned_m[0], nav.pos_ned_m[1]) - self._centre
        bearing = math.atan2(away.imag, away.real)
        off_m = self.radius_m - abs(away)
        if self._initial_rad is None:
            self._initial_rad = float(nav.rpy_rad[2])
        if abs(off_m) < JOIN_M and self._bearing is not None:
            self._turned += wrap_pi(bearing - self._bearing)
        self._bearing = bearing
        self._age += 1
        if self._goal is None or self._age >= FRESH_TICKS:
            self._goal, self._age = self._made(bearing, off_m), 0
        return self._goal

    def _made(self, bearing: float, off_m: float) -> Goal:
        out, sense = complex(math.cos(bearing), math.sin(bearing)), math.copysign(1.0, self._speed_m_s)
        yaw = self._heading(bearing, sense)
        if abs(off_m) > JOIN_M:
            place = self._centre + self.radius_m * out
            joining = self._goals.at(np.array([place.real, place.imag, self.depth_m]), yaw)
            old = self._goal
            near = old is not None and old.drive is None and _near(old.pos_ned_m, joining.pos_ned_m)
            return old if near and old is not None else joining
        speed = abs(self._speed_m_s)
        pull = min(max(PULL_1_S * off_m, -PULL_SHARE * speed), PULL_SHARE * speed)
        along = math.sqrt(speed * speed - pull * pull)
        velocity = out * complex(pull, sense * along)
        turn = sense * along / self.radius_m
        turns = self._yaw in (OrbitYaw.TO_CENTRE, OrbitYaw.ALONG)
        place = self._centre + self.radius_m * out
        return Goal(
            pos_ned_m=np.array([place.real, place.imag, self.depth_m]),
            yaw_rad=yaw,
            speed_m_s=speed,
            accept_radius_m=self._params["WP_ACCEPT_RADIUS"],
            accept_yaw_rad=0.15,
            seq=-1,
            drive=Drive(
                north_m_s=velocity.real,
                east_m_s=velocity.imag,
                turn_rad_s=turn,
                yaw_trend_rad_s=turn if turns else 0.0,
            ),
        )

    def _heading(self, bearing: float, sense: float) -> float:
        """Wanted at that bearing from the centre."""
        if self._yaw is OrbitYaw.TO_CENTRE:
            return wrap_pi(bearing + math.pi)
        if self._yaw is OrbitYaw.ALONG:
            return wrap_pi(bearing + sense * 0.5 * math.pi)
        return self._initial_rad or 0.0


def _near(a: FloatArray, b: FloatArray) -> bool:
    """Whether a place to join the circle at may stay where it is."""
    return math.dist(a.tolist(), b.tolist()) < 0.15
