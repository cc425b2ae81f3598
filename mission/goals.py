"""Goals other than mission items (hold, go-to, return, surface), and their workspace checks."""

import math

import numpy as np

from autopilot.core.frames import FloatArray, r_ned_from_frd
from autopilot.core.geometry import Fence
from autopilot.core.messages import Goal, NavState
from autopilot.core.params import ParamSet
from autopilot.core.vehicle import Vehicle
from autopilot.mission.circling import LoiterCircle
from autopilot.mission.clearance import Clearance
from autopilot.mission.mission_tuning import GOALS
from autopilot.mission.store import Plans


def digits(length_m: float) -> int:
    """Decimals of a length for the operator: centimetres near by, decimetres farther off."""
    return 2 if abs(length_m) < 10.0 else 1


class Goals:
    """Makes goals from where the vehicle is, from home and from requests. All positions NED [m]."""

    def __init__(self, vehicle: Vehicle, params: ParamSet, plans: Plans) -> None:
        self._vehicle = vehicle
        self._params = params
        self._plans = plans
        self._fence = plans.fence()
        self._boundaries = Clearance.of(self._fence)
        self._fence_key = self._key()

    @property
    def fence(self) -> Fence:
        """The workspace in force; the same object until plan, origin or depth band change."""
        key = self._key()
        if key != self._fence_key:
            self._fence_key, self._fence = key, self._plans.fence()
            self._boundaries = Clearance.of(self._fence)
        return self._fence

    @property
    def boundaries(self) -> Clearance:
        """The workspace in force, prepared for clearance queries."""
        _ = self.fence
        return self._boundaries

    @property
    def top_m(self) -> float:
        """Depth of the centre at the surface: the hull floats up no farther than its half height."""
        return max(self._params["DEPTH_MIN"], self._vehicle.hull_half_height_m)

    def clearance_m(self, pos_ned_m: FloatArray) -> float:
        """Signed distance of a point (3,) to the forbidden area: negative = inside it, inf = open water."""
        return float(self.boundaries.clearance_m(pos_ned_m[None, :2])[0])

    def at(self, pos_ned_m: FloatArray, yaw_rad: float | None) -> Goal:
        """Goal at a position (3,) at cruise speed, with a heading or without."""
        return Goal(
            pos_ned_m=pos_ned_m,
            yaw_rad=yaw_rad,
            speed_m_s=self._params["SPD_CRUISE"],
            accept_radius_m=self._params["WP_ACCEPT_RADIUS"],
            accept_yaw_rad=GOALS.accept_yaw_rad,
            seq=-1,
        )

    def hold(self, nav: NavState) -> Goal:
        """Where the vehicle comes to rest, with the present heading."""
        place = self._stopping_place(nav)
        place[2] = self.in_band(place[2])
        return self.at(place, float(nav.rpy_rad[2]))

    def surface(self, nav: NavState) -> Goal:
        """The surface above where the vehicle comes to rest."""
        place = self._stopping_place(nav)
        place[2] = self.top_m
        return self.at(place, float(nav.rpy_rad[2]))

    def home(self, nav: NavState) -> Goal:
        """Home at the present depth, heading free."""
        place = self._plans.home_ned_m.copy()
        place[2] = self.in_band(float(nav.pos_ned_m[2]))
        return self.at(place, None)

    def refuse_home(self) -> str:
        """Reason why home cannot be a goal, "" if it can. Near a boundary it is approached as far as that allows."""
        clearance_m = self.clearance_m(self._plans.home_ned_m)
        if clearance_m < 0.0:
            return f"home is {-clearance_m:.2f} m beyond the fence: set another"
        return ""

    def in_band(self, depth_m: float) -> float:
        """The next depth between DEPTH_MIN and DEPTH_MAX."""
        return min(max(float(depth_m), self._params["DEPTH_MIN"]), self._params["DEPTH_MAX"])

    def refuse_depth(self, depth_m: float) -> str:
        """Reason why a depth cannot be a goal, "" if it can."""
        low, high = self._params["DEPTH_MIN"], self._params["DEPTH_MAX"]
        return "" if low <= depth_m <= high else f"depth {depth_m:.2f} m is outside {low:g} to {high:g} m"

    def refuse(self, pos_ned_m: FloatArray) -> str:
        """Reason why a position (3,) cannot be a goal, "" if it can."""
        reason = self.refuse_depth(float(pos_ned_m[2]))
        if reason:
            return reason
        clearance_m = self.clearance_m(pos_ned_m)
        if clearance_m < self._keep_m():
            where = "from" if clearance_m >= 0.0 else "outside of"
            length = f"{abs(clearance_m):.{digits(clearance_m)}f} m"
            return f"target {length} {where} the fence, keep {self._keep_m():.2f} m"
        return ""

    def refuse_circle(self, circle: LoiterCircle, tolerance_m: float = 0.0) -> str:
        """Reason why a circle cannot be flown, "" if it can."""
        return circle.refusal(self.boundaries, self._keep_m() - tolerance_m)

    def may_drift(self, nav: NavState, more_m: float) -> bool:
        """Whether the vehicle is ``more_m`` further than the controller's margin from every boundary, also where
        it comes to rest without control.
        """
        stopping_m = self._stopping_m(nav)
        places = nav.pos_ned_m + np.linspace(0.0, 1.0, GOALS.stop_samples + 1)[:, None] * stopping_m
        return bool((self.boundaries.clearance_m(places[:, :2]) >= self._keep_m() + more_m).all())

    def _stopping_m(self, nav: NavState) -> FloatArray:
        """(3,) braking distance v^2 / 2a over ground."""
        vel_ned_m_s = r_ned_from_frd(nav.rpy_rad) @ nav.vel_frd_m_s
        return vel_ned_m_s * (math.hypot(*vel_ned_m_s) / (2.0 * GOALS.stop_deceleration_m_s2))

    def _key(self) -> tuple[float, ...]:
        return (self._plans.revision, self._params["DEPTH_MIN"], self._params["DEPTH_MAX"])

    def _keep_m(self) -> float:
        """The controller's margin to every boundary."""
        return self._vehicle.radius_m + self._params["MPC_MARGIN"]

    def _stopping_place(self, nav: NavState) -> FloatArray:
        """(3,) end of the braking distance v^2 / 2a over ground, or the last permitted point before it."""
        stopping_m = self._stopping_m(nav)
        places = nav.pos_ned_m + np.linspace(0.0, 1.0, GOALS.stop_samples + 1)[:, None] * stopping_m
        forbidden = np.flatnonzero(self.boundaries.clearance_m(places[1:, :2]) < self._keep_m())
        last = int(forbidden[0]) if len(forbidden) else GOALS.stop_samples
        place: FloatArray = places[last].copy()
        return place
