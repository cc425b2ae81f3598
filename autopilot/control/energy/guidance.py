"""Guidance of least energy: asks for trajectories, follows them, and has them brought up to date when things change.

A leg is planned when its goal appears; the leg after it is planned while this one is flown, so that there is no wait at
a waypoint. A plan is brought up to date when the water differs from what it was made for, when the vehicle has been
pushed off it, and when it ends before the goal. Until there is a plan the vehicle stays where it is; when planning ends
with an exception, a leg without a plan is flown by the route guidance.
"""

import numpy as np

from autopilot.control.desks import Mishaps
from autopilot.control.energy.flow import Flow, area_of, sample_flow
from autopilot.control.energy.search import Plan, Request, TrajectoryPlanner, shifted
from autopilot.control.energy.track import Track, joined, still
from autopilot.control.grid import TimeGrid
from autopilot.control.guidance import VELOCITY_WEIGHTS, Reference, RouteGuidance, Situation, SteadyThrust
from autopilot.control.ocp import TERMINAL_STAGES
from autopilot.core.desk import Cancel, Desk, Ticket
from autopilot.core.frames import FloatArray
from autopilot.core.messages import EnergyPlan, Goal, Severity
from autopilot.core.model4 import NU, Model4, R, U

ANSWER_STEPS = 3
"""A plan is taken so many control steps after it was asked for: 0.15 s at 20 Hz."""

OFF_TRACK_M = 0.15
"""A vehicle this far from its trajectory gets a new one."""

CHANGED_M_S = 0.03
"""Currents along the next seconds that differ by so much (rms) from those of the plan make a new one."""

LOOK_AHEAD_S = 10.0
CHECK_STEPS = 10
"""The water is compared every so many control steps (0.5 s)."""

REPLAN_STEPS = 40
"""Plans are brought up to date at most this often (2 s)."""

RETRY_STEPS = 20
"""Without a way, one is looked for again after so many steps (1 s)."""

NEXT_LEG_S = 5.0
"""The next leg is planned when this one has so much left."""

END_HOLD_S = 0.5
"""At the end of a trajectory the vehicle, which lags a little, is held where the next one begins until the goal counts
as reached: for so long by the trajectory's clock (1.7 s), then it turns to the goal's centre."""

RUNNING_OUT_S = 20.0
"""A trajectory that does not reach its goal is continued when it has less than this left."""

FOLLOWING_THRUST_WEIGHT = 0.2
"""Least weight on the difference to the planned thrust while a trajectory is followed: to be a little off it costs less
than to correct it at once. (In the paper's tank 2 % of a lap against 0.02; the limits are kept by other means.)"""

BOUND_SHARE = 0.96
"""Share of the limits on heave, yaw rate and thrust that plans use: what tracking needs is left to the optimiser."""

SPEED_SHARE = 0.98
"""The same for the planar speed, which has a margin of its own (MPC_SPEED_MARGIN)."""


class EnergyGuidance:
    """See :class:`autopilot.control.guidance.Guidance`."""

    def __init__(
        self, model: Model4, grid: TimeGrid, desk: Desk, planner: TrajectoryPlanner, route: RouteGuidance
    ) -> None:
        """``route`` flies what ``planner`` cannot."""
        self._t_s = grid.t_s
        self._steady = SteadyThrust(model)
        self._desk, self._trajectories, self._route = desk, planner, route
        self._ticket: Ticket[Plan] | None = None
        self._request: Request | None = None
        self._mishaps = Mishaps("energy planner", "No energy plan: this leg goes by the plain route")
        self._no_way = False
        self.reset()

    @property
    def unreachable(self) -> bool:
        """See :class:`autopilot.control.guidance.Guidance`."""
        return self._route.unreachable if self._by_route else self._no_way

    def reset(self) -> None:
        """See :class:`Guidance`."""
        self._step = 0
        self._last_us: int | None = None
        self._goal_key: tuple[float, ...] | None = None
        self._planner: object = None
        self._track: Track | None = None
        self._next: Track | None = None
        self._asked_next = False
        self._flow: Flow | None = None
        self._asked_step = -REPLAN_STEPS
        self._hold: FloatArray | None = None
        self._withdraw()
        self._no_way = self._by_route = False
        self._news: EnergyPlan | None = None

    def take_news(self) -> list[tuple[Severity, str]]:
        """See :class:`autopilot.control.guidance.Guidance`."""
        return self._mishaps.take_news() + self._route.take_news()

    def reference(self, situation: Situation) -> Reference:
        """See :class:`Guidance`."""
        now = situation
        elapsed_s = 0.0 if self._last_us is None else max(0.0, (now.t_us - self._last_us) * 1e-6)
        self._last_us = now.t_us
        self._step += 1
        fresh = self._update(now, elapsed_s)
        if self._by_route:
            return self._route.reference(now)
        current = now.nav.current_ned_m_s
        weight_u = now.params["MPC_R_THRUST"]
        if self._track is None:
            if self._hold is None:
                self._hold, fresh = now.x0.copy(), True
            x = still(self._hold, self._t_s, current)
            thrust = self._steady(x[:-1, U : R + 1])
        else:
            self._hold = None
            if self._track.rest_s > 0.0:
                weight_u = max(weight_u, FOLLOWING_THRUST_WEIGHT)
            then = self._next if self._track.rest_s > -END_HOLD_S else None
            x, thrust = self._track.sample(self._t_s, current, then)
            if then is None or self._track.rest_s <= 0.0:
                after = self._t_s[:-1] >= self._track.rest_s
                thrust[after] = self._steady(x[:-1][after][:, U : R + 1])
        params = now.params
        q = params["MPC_Q_POS"]
        weight_x = np.array([q, q, params["MPC_Q_Z"], params["MPC_Q_YAW"], *VELOCITY_WEIGHTS])
        return Reference(
            x=x,
            thrust_n=thrust,
            weight_x=weight_x,
            weight_u=np.full(NU, weight_u),
            terminal=np.diag(TERMINAL_STAGES * weight_x),
            fresh=fresh,
            plan=self._take_news(),
        )

    def ahead(self, here: FloatArray) -> FloatArray:
        """See :class:`Guidance`."""
        if self._by_route:
            return self._route.ahead(here)
        return here[None] if self._track is None else np.vstack([here, self._track.ahead()])

    def _update(self, now: Situation, elapsed_s: float) -> bool:
        """Goals, answers and requests; whether the reference has nothing to do with the last one."""
        fresh = False
        key = _key(now.goal)
        if key != self._goal_key or now.planner is not self._planner:
            fresh = self._new_goal(now, key)
        answer, request = None if self._ticket is None else self._ticket.poll(self._step), self._request
        if answer is not None and request is not None:
            self._ticket = self._request = None
            if answer.error is None:
                self._mishaps.succeeded()
                fresh |= self._take(request, answer.get(), now)
            else:
                self._fail(request, answer.error)
        off_m = 0.0 if self._track is None else self._track.advance(elapsed_s, now.x0)
        if self._ticket is None and not self._by_route:
            self._ask_if_needed(now, off_m)
        return fresh

    def _fail(self, request: Request, error: Exception) -> None:
        """Planning has failed: a leg that has no trajectory is flown by the route guidance, to its end."""
        by_route = self._track is None and _key(request.goal) == self._goal_key
        self._mishaps.failed(error, felt=by_route)
        if by_route:
            self._by_route, self._hold = True, None
            self._route.reset()

    def _new_goal(self, now: Situation, key: tuple[float, ...]) -> bool:
        """Take the plan that was made ahead for this goal, or begin without one."""
        left, ahead, same_fence = self._track, self._next, now.planner is self._planner
        self._goal_key, self._planner = key, now.planner
        self._track, self._next, self._asked_next = None, None, False
        self._withdraw()
        self._asked_step = -REPLAN_STEPS
        self._no_way = self._by_route = False
        if ahead is not None and same_fence and _key(ahead.goal) == key:
            # The region is entered a little before the trajectory ends: that much of it is still flown.
            onward = ahead.trajectory if left is None else joined(left.trajectory, left.clock_s, ahead.trajectory)
            self._track = Track(onward, now.goal, ahead.complete)
            return False
        return True

    def _take(self, request: Request, plan: Plan, now: Situation) -> bool:
        """Put an answer into force."""
        track = None if plan.trajectory is None else Track(plan.trajectory, plan.goal, plan.complete)
        if _key(request.goal) != self._goal_key:
            self._next = track
            return False
        fresh = self._track is None
        self._no_way = track is None
        if track is None and self._track is not None:
            return False
        self._track = track
        # The next leg was planned from where the last trajectory ended.
        self._next, self._asked_next = None, False
        if track is not None:
            track.locate(now.x0, 0.0)
        self._flow = plan.flow
        if plan.trajectory is not None:
            self._news = EnergyPlan(
                seq=plan.goal.seq,
                eta_s=plan.eta_s,
                energy_j=plan.energy_j,
                trajectory_s=float(plan.trajectory.t_s[-1]),
                late=self._desk.late,
            )
        return fresh

    def _take_news(self) -> EnergyPlan | None:
        news, self._news = self._news, None
        return news

    def _ask_if_needed(self, now: Situation, off_m: float) -> None:
        """Ask for a plan: the first, a better one for this leg, or the next leg's."""
        track, since = self._track, self._step - self._asked_step
        if track is None:
            if since >= RETRY_STEPS:
                self._ask(now, now.goal, now.x0, None)
            return
        if since >= REPLAN_STEPS and track.rest_s > 2.0:
            pushed = off_m > OFF_TRACK_M
            running_out = not track.complete and track.rest_s < RUNNING_OUT_S
            if pushed or running_out or (self._step % CHECK_STEPS == 0 and self._water_changed(now, track)):
                warm = None if running_out or off_m > 2.0 * OFF_TRACK_M else track
                self._ask(now, now.goal, now.x0, warm)
                return
        following = now.goal.following
        if following is not None and not self._asked_next and track.complete and track.rest_s < NEXT_LEG_S:
            self._asked_next = True
            end = track.trajectory.x[-1].copy()
            self._ask(now, following, end, None)

    def _water_changed(self, now: Situation, track: Track) -> bool:
        """Whether the forecast along the next seconds is another one than the plan was made with."""
        if self._flow is None:
            return False
        ahead = np.linspace(0.0, max(0.5, min(LOOK_AHEAD_S, track.rest_s)), 16)
        x, _ = track.sample(ahead, now.nav.current_ned_m_s)
        forecast = np.empty((len(x), 3))
        now.forecast.fill(now.nav, x[:, :3], ahead, forecast)
        assumed = self._flow.current(x[:, :2])
        return float(np.sqrt(((forecast - assumed)[:, :2] ** 2).sum(axis=1).mean())) > CHANGED_M_S

    def _ask(self, now: Situation, goal: Goal, x0: FloatArray, warm: Track | None) -> None:
        """Hand a request in."""
        params, fence = now.params, now.fence
        places = [x0[:2], np.asarray(goal.pos_ned_m[:2], dtype=float)]
        if goal.following is not None:
            places.append(np.asarray(goal.following.pos_ned_m[:2], dtype=float))
        area = area_of(fence, np.stack(places))
        limits = np.array(
            [
                SPEED_SHARE * now.speed_cap_m_s,
                BOUND_SHARE * params["SPD_HEAVE_MAX"],
                BOUND_SHARE * params["SPD_YAW_MAX"],
                max(fence.depth_min_m, params["DEPTH_MIN"]),
                min(fence.depth_max_m, params["DEPTH_MAX"]),
            ]
        )
        request = Request(
            x0=x0.copy(),
            goal=goal,
            fence=fence,
            radius_m=now.radius_m,
            flow=sample_flow(now.forecast, now.nav, area, float(x0[2])),
            limits=limits,
            thrust_limit_n=BOUND_SHARE * now.thrust_limit_n,
            warm=None if warm is None else shifted(warm.trajectory, warm.clock_s, x0),
        )
        if _key(goal) == self._goal_key:
            self._asked_step = self._step
        self._request = request
        self._ticket = self._desk.submit(self._step + ANSWER_STEPS, self._planned, request)

    def _planned(self, request: Request, cancel: Cancel) -> Plan:
        """What the planner says, if that makes sense."""
        plan = self._trajectories.plan(request, cancel)
        found = plan.trajectory
        if found is not None and not bool(np.isfinite(found.x).all() and np.isfinite(found.thrust_n).all()):
            raise ValueError("a trajectory that is not finite")
        return plan

    def _withdraw(self) -> None:
        if self._ticket is not None:
            self._ticket.cancel()
        self._ticket = self._request = None


def _key(goal: Goal) -> tuple[float, ...]:
    """Place and heading, to tell goals apart."""
    yaw = goal.yaw_rad
    return (*(float(p) for p in goal.pos_ned_m), 0.0 if yaw is None else yaw, float(yaw is None))
