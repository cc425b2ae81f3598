"""Line-of-sight guidance with PID loops: the usual autopilot, to compare with (``--controller los-pid``).

The route is that of MPC_COST 0: the shortest free path at cruise speed. Course by lookahead-based line of sight
(Fossen 2021, chapter 12), chi = pi_p - atan(y_e / Delta); heading along the motion through the water unless the goal
gives one. Surge, sway, heave and yaw have cascaded loops, P on the position and PI on the velocity, which is a PID with
the measured velocity as derivative, and the model's steady force as feed-forward. Nothing is predicted, so nothing is
promised: the route clears what stands by its margin, nothing that moves is evaded.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from autopilot.control.constraints.tracks import Obstructions
from autopilot.control.nmpc.grid import geometric_grid
from autopilot.control.path import shortest
from autopilot.control.path.drive import DriveGuidance
from autopilot.control.path.guidance import GuidanceInputs, RouteGuidance
from autopilot.control.path.path_tuning import REFERENCE
from autopilot.control.path.planner import Planner
from autopilot.control.protocol import STEP_S, Controller, ControllerContext, simple_output
from autopilot.core.control_allocator import ControlAllocator
from autopilot.core.frames import FloatArray, wrap_pi
from autopilot.core.geometry import Fence
from autopilot.core.messages import ControlOutput, Goal, NavHealth, NavState, Severity
from autopilot.core.model4 import AXES, YAW, R, U, V, W, X, Y, Z, steady_force
from autopilot.core.params import ParamSet
from autopilot.core.samples import ObstacleTrack


@dataclass(frozen=True, slots=True)
class LosPidTuning:
    """Gains; they are per unit of mass or inertia and fit any vehicle file."""

    lookahead_m: float = 0.5
    """Delta. Nearer to the goal than this its position is approached directly."""
    position_1_s: tuple[float, float, float] = (0.6, 0.6, 1.0)
    """Planar [m/s per m], depth [m/s per m], heading [rad/s per rad]."""
    velocity_1_s: float = 2.0
    integral_1_s2: float = 0.4
    integral_limit_m_s2: float = 0.3
    """Largest integral part; also of yaw [rad/s^2]."""
    delayed_gain: float = 0.4
    """Velocity gain times the delay of late commands, at most."""
    delayed_way_m: float = 0.15
    """Way over ground within that delay, at most."""
    clearance_m: float = 0.08
    """Clearance of the route beyond the body radius: the loops' error in bends."""
    crab_m_s: float = 0.1
    """Motion through the water that gives a heading."""


TUNING = LosPidTuning()


class LosPid(Controller):
    """See :class:`autopilot.control.protocol.Controller`."""

    def __init__(self, given: ControllerContext) -> None:
        grid = geometric_grid()
        self._given, self._allocator = given, ControlAllocator.of(given.vehicle)
        self._keep_m = given.vehicle.radius_m + TUNING.clearance_m
        self._mass = np.array(given.model.mass_kg)
        self._route = RouteGuidance(self._allocator, grid, given.desks.routes)
        self._drive = DriveGuidance(self._allocator, grid)
        self._obstructions = Obstructions()
        self._planner: tuple[Fence, Planner] | None = None
        self.reset()

    def reset(self) -> None:
        self._integral = np.zeros(AXES)
        self._last_us, self._estimate = -1, -1
        self._route.reset()
        self._drive.reset()
        self._obstructions.reset()

    def warm(self, params: ParamSet) -> None:
        routes = self._given.desks.routes
        if not routes.blocking:
            routes.submit(0, lambda _, __: shortest.warm(), None)

    def take_news(self) -> list[tuple[Severity, str]]:
        return self._route.take_notices()

    @property
    def unreachable(self) -> bool:
        return self._route.unreachable

    def planar_speed_m_s(self, nav: NavState, params: ParamSet) -> float:
        return REFERENCE.water_speed_fraction * params["SPD_PLANAR_MAX"]

    def step(
        self,
        t_us: int,
        nav: NavState,
        goal: Goal,
        fence: Fence,
        params: ParamSet,
        thruster_limit_n: FloatArray,
        tracks: Sequence[ObstacleTrack],
        *,
        delay_s: float | None,
    ) -> ControlOutput:
        nav = self._given.currents.view(nav).in_level_frame()
        x = nav.model4_state()
        known = nav.health is not NavHealth.INVALID and bool(np.isfinite([*x, *nav.current_ned_m_s]).all())
        if not known or delay_s is None or nav.reset_count != self._estimate:
            self.reset()
            self._estimate = nav.reset_count
        if not known or delay_s is None:
            return simple_output(t_us, nav, np.zeros(len(thruster_limit_n)), solved=False)
        if delay_s:
            goal = replace(goal, speed_m_s=min(goal.speed_m_s, TUNING.delayed_way_m / delay_s))
        guidance = self._route if goal.drive is None else self._drive
        now = self._inputs(t_us, x, nav, goal, fence, params, thruster_limit_n, tracks)
        wanted = self._velocity(now, guidance.reference(now).x)
        error = wanted - x[U:]
        gain = min(TUNING.velocity_1_s, TUNING.delayed_gain / delay_s) if delay_s else TUNING.velocity_1_s
        force = np.array(steady_force(self._allocator.model, wanted.tolist(), math))
        thrust_n = self._allocator.thrust_n(force + self._mass * (gain * error + self._integral), thruster_limit_n)
        # Anti-windup by conditional integration: not while a thruster is at its limit.
        if (np.abs(thrust_n) < thruster_limit_n)[thruster_limit_n > 0.0].all():
            elapsed_s = min(max(t_us - self._last_us, 0) * 1e-6, STEP_S) if self._last_us >= 0 else 0.0
            step = TUNING.integral_1_s2 * gain / TUNING.velocity_1_s * elapsed_s * error
            self._integral = np.clip(self._integral + step, -TUNING.integral_limit_m_s2, TUNING.integral_limit_m_s2)
        self._last_us = t_us
        return simple_output(t_us, nav, thrust_n, route_ned_m=guidance.ahead(x[:2]))

    def _inputs(
        self,
        t_us: int,
        x: FloatArray,
        nav: NavState,
        goal: Goal,
        fence: Fence,
        params: ParamSet,
        limit_n: FloatArray,
        tracks: Sequence[ObstacleTrack],
    ) -> GuidanceInputs:
        """Inputs of guidance; detected obstacles that stand become part of the fence."""
        fence, _ = self._obstructions.go_round(t_us, fence, tracks, nav, goal, self._keep_m, self._route.ahead)
        if self._planner is None or self._planner[0] is not fence:
            self._planner = fence, Planner(fence, self._keep_m)
        return GuidanceInputs(
            t_us=t_us,
            x0=x,
            nav=nav,
            goal=goal,
            params=params,
            fence=fence,
            planner=self._planner[1],
            radius_m=self._keep_m,
            forecast=self._given.currents,
            speed_cap_m_s=params["SPD_PLANAR_MAX"],
            thrust_limit_n=limit_n,
        )

    def _velocity(self, now: GuidanceInputs, reference: FloatArray) -> FloatArray:
        """Wanted u, v, w through the water [m/s] and r [rad/s] (4,), from the reference (n, 8) of guidance."""
        x, current, begin, end = now.x0, now.nav.current_ned_m_s, reference[1], reference[-1]
        planar, depth, heading = TUNING.position_1_s
        c, s = math.cos(begin[YAW]), math.sin(begin[YAW])
        north = c * begin[U] - s * begin[V] + current[0]
        east = s * begin[U] + c * begin[V] + current[1]
        to_north, to_east = float(end[X] - x[X]), float(end[Y] - x[Y])
        away, course = math.hypot(to_north, to_east), math.atan2(to_east, to_north)
        speed = min(math.hypot(north, east), planar * away)
        if away > TUNING.lookahead_m:
            path = math.atan2(east, north)
            cross_track = math.cos(path) * (x[Y] - reference[0, Y]) - math.sin(path) * (x[X] - reference[0, X])
            course = path - math.atan2(cross_track, TUNING.lookahead_m)
        else:
            speed = min(planar * away, now.goal.speed_m_s)
        north, east = speed * math.cos(course) - current[0], speed * math.sin(course) - current[1]
        shrink = min(1.0, self.planar_speed_m_s(now.nav, now.params) / max(math.hypot(north, east), 1e-9))
        north, east = shrink * north, shrink * east
        turn = heading * wrap_pi(float(end[YAW] - x[YAW]))
        fastest = abs(float(begin[R]))
        free = now.goal.yaw_rad is None and now.goal.facing_ned_m is None and now.goal.drive is None
        if free and away > TUNING.lookahead_m and math.hypot(north, east) > TUNING.crab_m_s:
            turn = heading * wrap_pi(math.atan2(east, north) - float(x[YAW]))
            fastest = REFERENCE.yaw_rate_fraction * now.params["SPD_YAW_MAX"]
        climb, steepest = depth * float(end[Z] - x[Z]), abs(float(begin[W] + current[2]))
        c, s = math.cos(x[YAW]), math.sin(x[YAW])
        return np.array(
            [
                c * north + s * east,
                c * east - s * north,
                max(-steepest, min(steepest, climb)) - current[2],
                max(-fastest, min(fastest, turn)),
            ]
        )
