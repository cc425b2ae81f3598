"""Circles at constant depth and speed: mode CIRCLE and NAV_LOITER_TURNS."""

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from autopilot.core.frames import FloatArray, wrap_pi
from autopilot.core.messages import Goal, NavState, VelocityGoal
from autopilot.core.orbit import OrbitYaw
from autopilot.mission.clearance import Clearance
from autopilot.mission.mission_tuning import CIRCLING


class LoiterCircle:
    """One circle, from its beginning to its end."""

    def __init__(
        self,
        params: Mapping[str, float],
        centre_m: tuple[float, float],
        radius_m: float,
        speed_m_s: float,
        *,
        depth_m: float,
        yaw: OrbitYaw = OrbitYaw.TO_CENTRE,
        turns: float = 0.0,
        seq: int = -1,
    ) -> None:
        """``speed_m_s``: negative = to port; ``turns``: 0 = for ever; ``seq``: of its goals."""
        self._params = params
        self._centre = complex(*centre_m)
        self.radius_m = radius_m
        self._sense = math.copysign(1.0, speed_m_s)
        self._speed_m_s = 0.0
        self.go(abs(speed_m_s))
        self.depth_m = depth_m
        self.approach_m_s: float | None = None
        """Speed on the way to the circle, None = SPD_CRUISE."""
        self.facing_m: tuple[float, float] | None = None
        """North and east of the point that the vehicle faces instead."""
        self._seq = seq
        self._yaw, self._turns = yaw, turns
        self._initial_rad: float | None = None
        self._bearing: float | None = None
        self._turned = 0.0
        self._off_m = 0.0
        self._goal: Goal | None = None
        self._made_us = 0

    def go(self, speed_m_s: float) -> None:
        """Another speed, as far as the limits allow."""
        turning_m_s = CIRCLING.yaw_fraction * self._params["SPD_YAW_MAX"] * self.radius_m
        self._speed_m_s = min(speed_m_s, self._params["SPD_PLANAR_MAX"], turning_m_s)

    def refusal(self, boundaries: Clearance, keep_m: float) -> str:
        """Reason why it cannot be flown, "" if it can. ``keep_m``: the controller's margin to every boundary."""
        low, high = self._params["DEPTH_MIN"], self._params["DEPTH_MAX"]
        if not low <= self.depth_m <= high:
            return f"depth {self.depth_m:.2f} m is outside {low:g} to {high:g} m"
        worst = worst_on_ring(boundaries, (self._centre.real, self._centre.imag), self.radius_m, keep_m)
        if worst is None:
            return ""
        clearance_m = float(boundaries.clearance_m(worst[None])[0])
        return f"circle comes within {clearance_m:.2f} m of the fence, keep {keep_m:.2f} m"

    @property
    def over(self) -> bool:
        return self._turns > 0.0 and abs(self._turned) >= 2.0 * math.pi * self._turns

    @property
    def left_m(self) -> float:
        """Path length left, inf for an endless circle."""
        if self._turns == 0.0:
            return math.inf
        arc = max(2.0 * math.pi * self._turns - abs(self._turned), 0.0) * self.radius_m
        return arc + (abs(self._off_m) if abs(self._off_m) > CIRCLING.join_m else 0.0)

    def rest(self, nav: NavState) -> Goal:
        """Position after the last turn: the nearest point of the circle."""
        goal = self.goal(nav)
        return replace(goal, drive=None)

    def goal(self, nav: NavState) -> Goal:
        """Goal of this tick; the same object until it changes."""
        away = complex(nav.pos_ned_m[0], nav.pos_ned_m[1]) - self._centre
        bearing = math.atan2(away.imag, away.real)
        off_m = self._off_m = self.radius_m - abs(away)
        if self._initial_rad is None:
            self._initial_rad = float(nav.rpy_rad[2])
        if abs(off_m) < CIRCLING.join_m and self._bearing is not None:
            self._turned += wrap_pi(bearing - self._bearing)
        self._bearing = bearing
        if self._goal is None or nav.t_us - self._made_us >= CIRCLING.fresh_us:
            self._goal, self._made_us = self._made(nav, bearing, off_m), nav.t_us
        return self._goal

    def _made(self, nav: NavState, bearing: float, off_m: float) -> Goal:
        out, sense = complex(math.cos(bearing), math.sin(bearing)), self._sense
        place = self._centre + self.radius_m * out
        nearest = Goal(
            pos_ned_m=np.array([place.real, place.imag, self.depth_m]),
            yaw_rad=self._heading(nav, bearing),
            speed_m_s=self._speed_m_s,
            accept_radius_m=self._params["WP_ACCEPT_RADIUS"],
            accept_yaw_rad=CIRCLING.accept_yaw_rad,
            seq=self._seq,
        )
        if abs(off_m) > CIRCLING.join_m:
            approach = self.approach_m_s
            speed = self._params["SPD_CRUISE"] if approach is None else approach
            joining = replace(nearest, speed_m_s=speed, speed_asked=approach is not None)
            old = self._goal
            if old is None or old.drive is not None or not _near(old.pos_ned_m, joining.pos_ned_m):
                return joining
            same = (old.speed_m_s, old.speed_asked) == (joining.speed_m_s, joining.speed_asked)
            return old if same else replace(old, speed_m_s=joining.speed_m_s, speed_asked=joining.speed_asked)
        speed = self._speed_m_s
        pull = min(max(CIRCLING.pull_1_s * off_m, -CIRCLING.pull_fraction * speed), CIRCLING.pull_fraction * speed)
        along = math.sqrt(speed * speed - pull * pull)
        velocity = out * complex(pull, sense * along)
        turn = sense * along / self.radius_m
        turns = self._yaw in (OrbitYaw.TO_CENTRE, OrbitYaw.ALONG) and self.facing_m is None
        return replace(
            nearest,
            drive=VelocityGoal(
                north_m_s=velocity.real,
                east_m_s=velocity.imag,
                turn_rad_s=turn,
                yaw_trend_rad_s=turn if turns else 0.0,
            ),
        )

    def _heading(self, nav: NavState, bearing: float) -> float:
        """Wanted at that bearing from the centre."""
        if self.facing_m is not None:
            north, east = self.facing_m
            return math.atan2(east - float(nav.pos_ned_m[1]), north - float(nav.pos_ned_m[0]))
        if self._yaw is OrbitYaw.TO_CENTRE:
            return wrap_pi(bearing + math.pi)
        if self._yaw is OrbitYaw.ALONG:
            return wrap_pi(bearing + self._sense * 0.5 * math.pi)
        return self._initial_rad or 0.0


def _near(a: FloatArray, b: FloatArray) -> bool:
    """Whether the point of joining the circle may stay."""
    return math.dist(a.tolist(), b.tolist()) < 0.15


def worst_on_ring(
    boundaries: Clearance, centre_m: tuple[float, float], radius_m: float, need_m: float
) -> FloatArray | None:
    """A point (2,) on a circle with less clearance than ``need_m``, None if there is none. Clearance is Lipschitz
    with constant 1: an arc whose middle exceeds the need by half its length is free, others are bisected.
    """
    step = 2.0 * math.pi / CIRCLING.ring_arcs
    angles = np.arange(CIRCLING.ring_arcs) * step
    while len(angles):
        places = np.array(centre_m) + radius_m * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        clearance = boundaries.clearance_m(places)
        least = int(np.argmin(clearance))
        if clearance[least] < need_m:
            place: FloatArray = places[least]
            return place
        half_m = 0.5 * step * radius_m
        if half_m < CIRCLING.ring_step_m:
            return None
        open_ = angles[clearance - half_m < need_m]
        step /= CIRCLING.ring_parts
        angles = (open_[:, None] + step * (np.arange(CIRCLING.ring_parts) - 0.5 * (CIRCLING.ring_parts - 1))).ravel()
    return None
