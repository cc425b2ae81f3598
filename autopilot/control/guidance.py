"""Guidance: from a goal to what the optimiser is to follow.

Two kinds share one interface: the route guidance marches along a free path at cruise speed (the paper's quadratic
cost), the energy guidance follows a trajectory of least energy (:mod:`autopilot.control.energy`).
"""

import cmath
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from autopilot.control.currents import CurrentForecast
from autopilot.control.grid import TimeGrid
from autopilot.control.ocp import TERMINAL_STAGES
from autopilot.control.planner import Planner
from autopilot.control.reference import TURN_AHEAD_M, Route, Target, build_reference, turn_target
from autopilot.core import model4
from autopilot.core.frames import FloatArray, unwrap_near
from autopilot.core.geometry import Fence
from autopilot.core.messages import EnergyPlan, Goal, NavState
from autopilot.core.model4 import NU, YAW, Model4, R, U
from autopilot.core.params import ParamSet

VELOCITY_WEIGHTS = (8.0, 8.0, 8.0, 0.5)
"""Weights on u, v, w [1/(m/s)^2] and r [1/(rad/s)^2]: enough to hold the cruise speed."""

REPLAN_DISTANCE_M = 0.3
REPLAN_INTERVAL_US = 1_000_000
"""A vehicle that has been pushed this far off its route gets a new one, at most once a second."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Situation:
    """What guidance goes by in one step."""

    t_us: int
    x0: FloatArray
    """(8,) state at which the plan begins, yaw on the turn of the last steps."""
    nav: NavState
    goal: Goal
    params: ParamSet
    fence: Fence
    planner: Planner
    """Of the fence in force."""
    radius_m: float
    """That ways keep from every boundary."""
    forecast: CurrentForecast
    speed_cap_m_s: float
    """Planar speed through the water that may be asked for."""
    thrust_limit_n: FloatArray
    """(4,)"""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Reference:
    """What the optimiser compares its prediction with, and how it weighs the difference."""

    x: FloatArray
    """(N+1, 8)"""
    thrust_n: FloatArray
    """(N, 4)"""
    weight_x: FloatArray
    """(8,) or (N-1, 8)"""
    weight_u: FloatArray
    """(4,) or (N, 4)"""
    terminal: FloatArray
    """(8, 8)"""
    fresh: bool
    """It has nothing to do with the last one: the optimiser starts anew from it."""
    plan: EnergyPlan | None = None
    """On the step on which it came into force."""


class Guidance(Protocol):
    """One instance per vehicle; deterministic."""

    unreachable: bool
    """True while there is no way to the goal; the vehicle holds its place."""

    def reset(self) -> None:
        """Forget everything (after disarming, a jump of the estimate)."""
        ...

    def reference(self, situation: Situation) -> Reference:
        """The reference for this step."""
        ...

    def ahead(self, here: FloatArray) -> FloatArray:
        """(m, 2) the way from ``here`` (2,) to the goal, first row here, for display."""
        ...


class SteadyThrust:
    """Thrust that holds velocities through the water."""

    def __init__(self, model: Model4) -> None:
        self._model = model
        self._inverse = np.linalg.inv(np.array(model.allocation)).T.copy()

    def __call__(self, nu: FloatArray) -> FloatArray:
        """(m, 4) thrust for velocities (m, 4) u, v, w, r: drag, buoyancy and Munk moment against T_A tau."""
        force = np.empty_like(nu)
        force.T[:] = model4.steady_force(self._model, (nu[:, 0], nu[:, 1], nu[:, 2], nu[:, 3]), np)
        thrust: FloatArray = force @ self._inverse
        return thrust


class RouteGuidance:
    """Marches along the shortest free path at cruise speed over ground."""

    def __init__(self, model: Model4, grid: TimeGrid) -> None:
        self._t_s = grid.t_s
        self._steady = SteadyThrust(model)
        self.unreachable = False
        self.reset()

    def reset(self) -> None:
        """See :class:`Guidance`."""
        self._goal_key: tuple[float, ...] | None = None
        self._planner: Planner | None = None
        self._route: Route | None = None
        self._s = 0.0
        self._routed_us = 0
        self._yaw_target: float | None = None
        self._hold: FloatArray | None = None
        self.unreachable = False

    def reference(self, situation: Situation) -> Reference:
        """See :class:`Guidance`."""
        fresh, route = self._update(situation)
        x = self._march(situation, route)
        params = situation.params
        q = params["MPC_Q_POS"]
        weight_x = np.array([q, q, params["MPC_Q_Z"], params["MPC_Q_YAW"], *VELOCITY_WEIGHTS])
        return Reference(
            x=x,
            thrust_n=self._steady(x[:-1, U : R + 1]),
            weight_x=weight_x,
            weight_u=np.full(NU, params["MPC_R_THRUST"]),
            terminal=np.diag(TERMINAL_STAGES * weight_x),
            fresh=fresh,
        )

    def ahead(self, here: FloatArray) -> FloatArray:
        """See :class:`Guidance`."""
        route = self._route
        return here[None] if route is None or self.unreachable else route.ahead(here, self._s)

    def _update(self, now: Situation) -> tuple[bool, Route]:
        """Whether the route is another one, and the route."""
        goal, x0 = now.goal, now.x0
        goal_key = (
            *(float(p) for p in goal.pos_ned_m),
            0.0 if goal.yaw_rad is None else goal.yaw_rad,
            float(goal.yaw_rad is None),
        )
        route = self._route
        changed = goal_key != self._goal_key or route is None or now.planner is not self._planner
        if self._goal_key is None or goal_key[3:] != self._goal_key[3:]:
            self._yaw_target = None
        self._goal_key, self._planner = goal_key, now.planner
        if not changed and route is not None:
            self._s, off = route.project(x0[:2], self._s)
            pushed = off > REPLAN_DISTANCE_M or self.unreachable
            if not pushed or now.t_us - self._routed_us < REPLAN_INTERVAL_US:
                return False, route
        path = now.planner.path(x0[:2], np.asarray(goal.pos_ned_m, dtype=float))
        self._routed_us = now.t_us
        was_unreachable, self.unreachable = self.unreachable, path is None
        if path is None:
            if was_unreachable and not changed and route is not None:
                return False, route
            self._hold = x0.copy()
            path = np.stack([x0[:2], x0[:2]])
        else:
            self._hold = None
        route = Route(path)
        self._route, self._s = route, 0.0
        return True, route

    def _march(self, now: Situation, route: Route) -> FloatArray:
        """References (N+1, 8) along the route; chooses the way round to the heading."""
        hold, goal, x0, params = self._hold, now.goal, now.x0, now.params
        if hold is not None:
            self._yaw_target = float(hold[YAW])
        elif goal.yaw_rad is not None:
            self._yaw_target = turn_target(float(x0[YAW]), goal.yaw_rad, self._yaw_target)
        elif route.length_m - self._s > TURN_AHEAD_M or self._yaw_target is None:
            look = route.point(min(self._s + TURN_AHEAD_M, route.length_m)) - complex(x0[0], x0[1])
            if abs(look) > 0.5 * TURN_AHEAD_M:
                self._yaw_target = unwrap_near(cmath.phase(look), float(x0[YAW]))
            elif self._yaw_target is None:
                self._yaw_target = float(x0[YAW])
        target = Target(
            route=route,
            s0_m=self._s,
            depth_m=float(goal.pos_ned_m[2] if hold is None else hold[2]),
            yaw_rad=self._yaw_target,
            cruise_m_s=goal.speed_m_s,
            speed_limit_m_s=now.speed_cap_m_s,
            heave_limit_m_s=params["SPD_HEAVE_MAX"],
            yaw_rate_limit_rad_s=params["SPD_YAW_MAX"],
        )
        return build_reference(self._t_s, x0, target, now.nav.current_ned_m_s)
