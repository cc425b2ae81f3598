"""Minimum-energy guidance: requests trajectories, follows them, and replans.

A leg is planned when its goal appears: first a quick plan, then a full search from the predicted state on it. The next
leg is planned while this one is flown, which avoids a stop at the waypoint. Replanning is triggered by a current that
differs from that of the plan, by a deviation from the plan, and by a plan that ends before the goal. A plan starts at
the state predicted for the time of its answer.

Without a plan (not yet available, no path, planning failed, deviation too large) the leg is flown by the route
guidance, and planning is requested again.
"""

from dataclasses import replace
from functools import partial

import numpy as np

from autopilot.control.energy.energy_tuning import GUIDANCE, LEG_TASK, PATIENCE
from autopilot.control.energy.flow import FlowField, area_of, sample_flow
from autopilot.control.energy.leg_task import shifted
from autopilot.control.energy.patience import ANSWER_STEPS, Kind, NoPlanError, Patience
from autopilot.control.energy.request import EXTRA_M, EXTRA_S, Plan, TrajectoryPlanner, TrajectoryRequest
from autopilot.control.energy.track import TrackedTrajectory, joined
from autopilot.control.energy.trajectory import Trajectory
from autopilot.control.nmpc.grid import REFERENCE_DT_S, TimeGrid
from autopilot.control.nmpc.ocp import TERMINAL_STAGES
from autopilot.control.path.guidance import GuidanceInputs, Reference, RouteGuidance, Weights
from autopilot.control.path.reference import unknown_speed_m_s
from autopilot.control.path.workers import TaskFailures
from autopilot.core import operator_messages as notices
from autopilot.core.acceptance import LARGEST_SHARE, sure_limit
from autopilot.core.background import BackgroundTask, BackgroundWorker, Cancel
from autopilot.core.control_allocator import ControlAllocator
from autopilot.core.frames import FloatArray
from autopilot.core.messages import EnergyPlan, Goal, NavState, Severity
from autopilot.core.model4 import YAW, R, U, Z


class EnergyGuidance:
    def __init__(
        self,
        allocator: ControlAllocator,
        grid: TimeGrid,
        worker: BackgroundWorker,
        planner: TrajectoryPlanner,
        route: RouteGuidance,
    ) -> None:
        """``route``: guidance while ``planner`` has no plan."""
        self._t_s = grid.t_s
        self._last_s, self._stages = float(grid.t_s[-2]), np.diff(grid.t_s)[1:] / REFERENCE_DT_S
        self._reach_s = float(2.0 * grid.t_s[-1] - grid.t_s[-2])
        """Time from which on the end of a trajectory is out of sight: see _node_weights."""
        self._weights = Weights(allocator.model.thrusters)
        self._allocator = allocator
        self._worker, self._route = worker, route
        # Not a method: work that is under way must not keep whoever asked for it, who keeps the work.
        self._plan = partial(planned, planner)
        self._task: BackgroundTask[Plan] | None = None
        self._request: TrajectoryRequest | None = None
        self._failures = TaskFailures("energy planner", notices.NO_ENERGY_PLAN)
        self.reset()

    @property
    def unreachable(self) -> bool:
        return self._track is None and self._route.unreachable

    def reset(self) -> None:
        self._step = 0
        self._last_us: int | None = None
        self._goal_key: tuple[float, ...] | None = None
        self._goal_step = 0
        self._leg_depth_m: float | None = None
        self._planner: object = None
        self._track: TrackedTrajectory | None = None
        self._next: TrackedTrajectory | None = None
        self._quick = False
        self._left_at_m: float | None = None
        """How far from its goal the vehicle was when the leg was left to the route guidance, None = it is not."""
        self._first = Kind.QUICK
        self._taken_step = 0
        self._next_requested = False
        self._flow: FlowField | None = None
        self._planned_cap_m_s = 0.0
        self._requested_step = 0
        self._patience = Patience()
        self._withdraw()
        self._by_route = False
        self._notices: EnergyPlan | None = None

    def take_notices(self) -> list[tuple[Severity, str]]:
        return self._failures.take_notices() + self._route.take_notices()

    def reference(self, situation: GuidanceInputs) -> Reference:
        now = situation
        elapsed_s = 0.0 if self._last_us is None else max(0.0, (now.t_us - self._last_us) * 1e-6)
        self._last_us = now.t_us
        self._step += 1
        fresh = self._update(now, elapsed_s)
        if self._track is None:
            if not self._by_route:
                self._by_route = True
                self._route.reset()
            return self._setting_out(self._route.reference(now))
        self._by_route = False
        return self._along(self._track, now, fresh)

    def ahead(self, here: FloatArray) -> FloatArray:
        return self._route.ahead(here) if self._track is None else np.vstack([here, self._track.ahead()])

    def _setting_out(self, route: Reference) -> Reference:
        """The route's reference, slow while the leg's first plan is computed, which may start in another direction."""
        awaited = self._request is not None and self._request.kind is Kind.QUICK
        if not awaited or self._step - self._goal_step > GUIDANCE.set_out_steps:
            return route
        return replace(route, weight_u=np.maximum(route.weight_u, GUIDANCE.following_thrust_weight))

    def _along(self, track: TrackedTrajectory, now: GuidanceInputs, fresh: bool) -> Reference:
        """The reference along a trajectory, and on into the next one."""
        current, params = now.nav.current_ned_m_s, now.params
        weight_u, rest_s = params["MPC_R_THRUST"], track.rest_s
        if rest_s > 0.0:
            weight_u = max(weight_u, GUIDANCE.following_thrust_weight)
        then = self._next
        x, thrust = track.sample(self._t_s, current, then)
        thrust += self._lift_n(self._allocator.buoyancy_excess_n, now.thrust_limit_n)
        rest = 1.0 if then is None else track.missing
        if rest > 0.0 and self._last_s >= rest_s:
            after = self._t_s[:-1] >= rest_s
            steady = self._allocator.hold_n(x[:-1][after][:, U : R + 1], now.thrust_limit_n)
            thrust[after] += rest * (steady - thrust[after])
        weights = self._weights.update(params, weight_u)
        nodes, terminal = weights.x, weights.terminal
        # The end of a trajectory weighs where the prediction reaches it.
        if track.complete and 0.0 < rest_s < self._reach_s:
            nodes, last = self._end_weights(weights.x, track)
            terminal = np.diag(last)
        return Reference(
            x=x,
            thrust_n=thrust,
            weight_x=nodes,
            weight_u=weights.u,
            terminal=terminal,
            fresh=fresh,
            plan=self._take_news(),
        )

    def _end_weights(self, weight_x: FloatArray, track: TrackedTrajectory) -> tuple[FloatArray, FloatArray]:
        """(N-1, 8) and (8,) weights of the nodes and of the last one: more for the end of a trajectory that enters its
        goal's region, shared by the nodes before and after it, so that nothing jumps as it comes nearer."""
        weights, end = self._node_weights(track.rest_s), GUIDANCE.end_stages * weight_x[:U]
        if track.goal.yaw_rad is not None:
            # Headings are normalised by their remaining tolerance, as positions are.
            tolerance = (
                (1.0 - LEG_TASK.radius_fraction) * track.goal.accept_radius_m,
                (1.0 - LEG_TASK.yaw_fraction) * track.goal.accept_yaw_rad,
            )
            end[YAW] = max(end[YAW], end[0] * min(tolerance[0] / max(tolerance[1], 1e-3), 1.0) ** 2)
        nodes, terminal = np.tile(weight_x, (len(self._t_s) - 2, 1)), TERMINAL_STAGES * weight_x
        nodes[:, :U] += (weights[1:-1] / self._stages)[:, None] * end
        terminal[:U] += float(weights[-1]) * end
        return nodes, terminal

    def _node_weights(self, at_s: float) -> FloatArray:
        """(N+1,) interpolation weights of the nodes at a time, zero far behind the last node."""
        t_s, weights = self._t_s, np.zeros(len(self._t_s))
        last, length_s = len(t_s) - 1, float(t_s[-1] - t_s[-2])
        if at_s >= t_s[-1]:
            weights[last] = max(0.0, 1.0 - (at_s - t_s[-1]) / length_s)
            return weights
        after = int(np.searchsorted(t_s, at_s, side="right"))
        weights[after] = (at_s - t_s[after - 1]) / (t_s[after] - t_s[after - 1])
        weights[after - 1] = 1.0 - weights[after]
        return weights

    def _update(self, now: GuidanceInputs, elapsed_s: float) -> bool:
        """Goals, answers and requests; whether the reference has nothing to do with the last one."""
        fresh = False
        key = _key(now.goal)
        if key != self._goal_key or now.planner is not self._planner:
            fresh = self._new_goal(now, key)
        if now.goal.speed_asked or now.goal.facing_ned_m is not None or now.bow_rad is not None:
            # A minimum-energy plan would choose another speed or heading: the route guidance keeps the commanded ones.
            self._withdraw()
            self._track = self._next = None
            return fresh
        answer, request = None if self._task is None else self._task.poll(self._step), self._request
        if answer is not None and request is not None:
            self._task = self._request = None
            if answer.error is None:
                fresh |= self._take(request, answer.get(), now)
            else:
                self._fail(request, answer.error)
        off_m = 0.0 if self._track is None else self._track.advance(elapsed_s, now.x0)
        self._leave_if_track_lost(now, off_m)
        if self._task is None:
            self._request_if_needed(now, off_m, elapsed_s)
        elif self._track is None and self._step - self._requested_step == GUIDANCE.late_steps:
            self._failures.failed(NoPlanError("late"), notify=not self._route.unreachable)
        return fresh

    def _lift_n(self, buoyancy_excess_n: float, limit_n: FloatArray) -> FloatArray:
        """(n,) thrust of those of ``limit_n`` (n,) that are alive which holds the vehicle against that buoyancy."""
        force = np.array([0.0, 0.0, buoyancy_excess_n, 0.0])
        return self._allocator.thrust_n(force, np.where(limit_n > 0.0, np.inf, 0.0))

    def _leave_if_track_lost(self, now: GuidanceInputs, off_m: float) -> None:
        """A trajectory that the vehicle is far from, or that has ended without its goal, is followed no more.

        Where one ends at a place to stay at, it is followed to the goal's centre. The little that is left of a leg when
        its region was missed is for the route guidance, until the vehicle is swept away from there; the next leg's
        plan is kept.
        """
        track = self._track
        if track is None:
            return
        ended = track.rest_s <= (-GUIDANCE.end_hold_s if track.complete else 0.0)
        if off_m > GUIDANCE.track_lost_m or (ended and not (track.complete and self._next is None)):
            self._track = None
            self._left_at_m = _away_m(now) if ended and track.complete else None

    def _fail(self, request: TrajectoryRequest, error: Exception) -> None:
        """There is no such plan: a leg that has none is flown by the route guidance meanwhile."""
        mine = _key(request.goal) == self._goal_key
        if mine:
            self._patience.failed()
        self._failures.failed(error, notify=mine and self._track is None and not self._route.unreachable)

    def _new_goal(self, now: GuidanceInputs, key: tuple[float, ...]) -> bool:
        """Take the plan that was made ahead for this goal, or begin without one."""
        left, ahead, same_fence = self._track, self._next, now.planner is self._planner
        self._goal_key, self._planner, self._goal_step = key, now.planner, self._step
        self._leg_depth_m = float(now.x0[Z])
        self._track, self._next, self._next_requested = None, None, False
        self._quick, self._left_at_m, self._first = False, None, Kind.QUICK
        self._patience.succeeded()
        if ahead is not None and left is None and ahead.locate(now.x0, 0.0) > GUIDANCE.off_track_m:
            ahead = None
        if ahead is not None and same_fence and _key(ahead.goal) == key:
            self._withdraw()
            self._requested_step = self._step - GUIDANCE.replan_steps
            # The region is entered a little before the trajectory ends: that much of it is still flown.
            onward = ahead.trajectory if left is None else joined(left.trajectory, left.clock_s, ahead.trajectory)
            self._track = TrackedTrajectory(onward, now.goal, ahead.complete)
            return False
        if self._request is None or not same_fence or _key(self._request.goal) != key:
            self._withdraw()
        return True

    def _take(self, request: TrajectoryRequest, plan: Plan, now: GuidanceInputs) -> bool:
        if plan.trajectory is None:
            if request.kind is Kind.QUICK:
                # Another way or turn, or a shorter trajectory, may be solved.
                self._first = Kind.COLD
            else:
                self._fail(request, NoPlanError(plan.why))
            return False
        # Without buoyancy compensation: its estimate changes under way.
        lift_n = self._lift_n(request.buoyancy_excess_n, request.thrust_limit_n)
        moving = replace(plan.trajectory, thrust_n=plan.trajectory.thrust_n - lift_n)
        track = TrackedTrajectory(moving, plan.goal, plan.complete)
        self._failures.succeeded()
        if plan.stay and self._track is not None:
            self._quick = False
            self._patience.succeeded()
            return False
        runs = float(np.hypot(*now.nav.current_ned_m_s[:2])) > GUIDANCE.running_m_s
        if request.kind is Kind.QUICK and plan.complete and track.length_s < GUIDANCE.short_s and runs:
            self._left_at_m = _away_m(now)
            return False
        if _key(request.goal) != self._goal_key:
            self._next = track
            return False
        self._patience.succeeded()
        if track.locate(now.x0, 0.0) > GUIDANCE.track_lost_m:
            return False
        old, self._track, self._next_requested = self._track, track, False
        self._quick, self._taken_step = request.kind is Kind.QUICK, self._step
        if old is None or np.hypot(*(track.trajectory.x[-1] - old.trajectory.x[-1])[:2]) > GUIDANCE.same_end_m:
            # The next leg was planned from where the last trajectory ended.
            self._next = None
        self._flow = plan.flow
        self._planned_cap_m_s = float(request.limits[0]) / GUIDANCE.speed_fraction
        self._notices = EnergyPlan(
            seq=plan.goal.seq,
            eta_s=plan.eta_s,
            energy_j=plan.energy_j,
            trajectory_s=float(plan.trajectory.t_s[-1]),
            late=self._worker.late,
        )
        return old is None or abs(track.trajectory.x[-1, YAW] - old.trajectory.x[-1, YAW]) > np.pi

    def _take_news(self) -> EnergyPlan | None:
        news, self._notices = self._notices, None
        return news

    def _request_if_needed(self, now: GuidanceInputs, off_m: float, elapsed_s: float) -> None:
        """Ask for a plan: the first, a better one for this leg (not of a short one), or the next leg's."""
        track, since = self._track, self._step - self._requested_step
        over = self._patience.over(now, since)
        if track is None:
            if self._left_at_m is not None and _away_m(now) < self._left_at_m + GUIDANCE.track_lost_m:
                return
            self._left_at_m = None
            begun = self._step - self._goal_step
            kind, at_once = self._first, self._first is Kind.COLD
            if (over or at_once) and begun > 0 and (not self._route.searching or begun >= GUIDANCE.route_steps):
                self._first = Kind.QUICK
                self._submit(now, kind, now.goal, self._coming(now, kind, elapsed_s), None)
            return
        followed = self._step - self._taken_step >= GUIDANCE.followed_steps
        if self._quick and followed and over and track.rest_s > GUIDANCE.next_leg_s:
            self._submit(now, Kind.COLD, now.goal, self._coming(now, Kind.COLD, elapsed_s), track)
            return
        running_out = not track.complete and track.rest_s < min(
            GUIDANCE.running_out_s, GUIDANCE.running_out_fraction * track.length_s
        )
        kind = Kind.COLD if running_out or off_m > 2.0 * GUIDANCE.off_track_m else Kind.WARM
        if (
            over
            and since >= GUIDANCE.replan_steps
            and track.rest_s > GUIDANCE.last_update_s + ANSWER_STEPS[kind] * PATIENCE.step_s
        ):
            pushed = off_m > GUIDANCE.off_track_m or track.goal.speed_m_s != now.goal.speed_m_s
            checked = self._step % GUIDANCE.check_steps == 0
            if pushed or running_out or (checked and (self._cap_changed(now) or self._current_changed(now, track))):
                self._submit(
                    now, kind, now.goal, self._coming(now, kind, elapsed_s), track if kind is Kind.WARM else None
                )
                return
        following = now.goal.following
        if following is None or following.speed_asked or following.facing_ned_m is not None:
            return
        far = float(np.hypot(*(following.pos_ned_m - now.goal.pos_ned_m)[:2])) > GUIDANCE.long_leg_m
        if (
            not self._next_requested
            and track.complete
            and track.rest_s < (GUIDANCE.long_next_leg_s if far else GUIDANCE.next_leg_s)
        ):
            self._next_requested = True
            end = track.trajectory.x[-1].copy()
            self._submit(now, Kind.NEXT, following, end, None)

    def _coming(self, now: GuidanceInputs, kind: Kind, elapsed_s: float) -> FloatArray:
        """(8,) state predicted for the time of the answer, by the last plan."""
        if now.last_plan is None:
            return now.x0
        meant, then = (
            np.array([np.interp(t_s, self._t_s, column) for column in now.last_plan.T])
            for t_s in (elapsed_s, elapsed_s + ANSWER_STEPS[kind] * PATIENCE.step_s)
        )
        off = now.x0 - meant
        off[YAW] -= 2.0 * np.pi * round(float(off[YAW]) / (2.0 * np.pi))
        off[U:] = 0.0
        result: FloatArray = then + off
        return result

    def _cap_changed(self, now: GuidanceInputs) -> bool:
        """Whether the plan was made with another limit of the planar speed, and one of them is higher than without
        knowledge of the drag."""
        usual_m_s = now.params["SPD_PLANAR_MAX"] - unknown_speed_m_s(now.params)
        caps = now.speed_cap_m_s, self._planned_cap_m_s
        return max(caps) > usual_m_s + GUIDANCE.other_cap_m_s and abs(caps[0] - caps[1]) > GUIDANCE.other_cap_m_s

    def _current_changed(self, now: GuidanceInputs, track: TrackedTrajectory) -> bool:
        """Whether the forecast along the next seconds is another one than the plan was made with."""
        if self._flow is None:
            return False
        ahead = np.linspace(0.0, max(0.5, min(GUIDANCE.lookahead_s, track.rest_s)), 16)
        x, _ = track.sample(ahead, now.nav.current_ned_m_s)
        forecast = np.empty((len(x), 3))
        now.forecast.fill(now.nav, x[:, :3], ahead, forecast)
        assumed = self._flow.current(x[:, :2])
        return float(np.sqrt(((forecast - assumed)[:, :2] ** 2).sum(axis=1).mean())) > GUIDANCE.changed_m_s

    def _submit(
        self, now: GuidanceInputs, kind: Kind, goal: Goal, x0: FloatArray, warm: TrackedTrajectory | None
    ) -> None:
        params, fence = now.params, now.fence
        places = [x0[:2], np.asarray(goal.pos_ned_m[:2], dtype=float)]
        if goal.following is not None:
            places.append(np.asarray(goal.following.pos_ned_m[:2], dtype=float))
        area = area_of(fence, np.stack(places))
        limits = np.array(
            [
                GUIDANCE.speed_fraction * now.speed_cap_m_s,
                GUIDANCE.bound_fraction * params["SPD_HEAVE_MAX"],
                GUIDANCE.bound_fraction * params["SPD_YAW_MAX"],
                max(fence.depth_min_m, params["DEPTH_MIN"]),
                min(fence.depth_max_m, params["DEPTH_MAX"]),
            ]
        )
        steps = ANSWER_STEPS[kind]
        begun: Trajectory | None = None
        if warm is not None:
            left = shifted(warm.trajectory, warm.clock_s + steps * PATIENCE.step_s, x0)
            lift_n = self._lift_n(self._allocator.buoyancy_excess_n, now.thrust_limit_n)
            begun = replace(left, thrust_n=left.thrust_n + lift_n)
        request = TrajectoryRequest(
            x0=x0.copy(),
            goal=goal,
            fence=fence,
            radius_m=now.radius_m,
            extra_m=min(EXTRA_M, LEG_TASK.between_m + EXTRA_S * float(np.sqrt(now.nav.variance[9:11].max()))),
            flow=sample_flow(now.forecast, now.nav, area, float(x0[2])),
            limits=limits,
            thrust_limit_n=GUIDANCE.bound_fraction * now.thrust_limit_n,
            buoyancy_excess_n=self._allocator.buoyancy_excess_n,
            cruise_m_s=goal.speed_m_s,
            leg_depth_m=None if kind is Kind.NEXT else self._leg_depth_m,
            warm=begun,
            kind=kind,
            uncertainty=_uncertainty(goal, now.nav),
        )
        if kind is not Kind.NEXT:
            self._requested_step = self._step
            self._patience.note_request(now)
        self._request = request
        self._task = self._worker.submit(self._step + steps, self._plan, request)

    def _withdraw(self) -> None:
        if self._task is not None:
            self._task.cancel()
        self._task = self._request = None


def planned(planner: TrajectoryPlanner, request: TrajectoryRequest, cancel: Cancel) -> Plan:
    """The planner's result, if it is valid."""
    plan = planner.plan(request, cancel)
    found = plan.trajectory
    if found is not None and not bool(np.isfinite(found.x).all() and np.isfinite(found.thrust_n).all()):
        raise ValueError("a trajectory that is not finite")
    return plan


def _away_m(now: GuidanceInputs) -> float:
    """Distance to the goal in the plane."""
    return float(np.hypot(*(now.goal.pos_ned_m[:2] - now.x0[:2])))


def _key(goal: Goal) -> tuple[float, ...]:
    """Position and heading, as a key of goals."""
    yaw = goal.yaw_rad
    return (*(float(p) for p in goal.pos_ned_m), 0.0 if yaw is None else yaw, float(yaw is None))


def _uncertainty(goal: Goal, nav: NavState) -> float:
    """Share of the goal's acceptance that the estimate's uncertainty takes: nothing or the most that it may, so that
    plans do not change with every tick's variance."""
    limits = ((goal.accept_radius_m, float(nav.variance[:3].sum())), (goal.accept_yaw_rad, float(nav.variance[5])))
    sure = all(sure_limit(limit, variance) >= LEG_TASK.sure_fraction * limit for limit, variance in limits)
    return 0.0 if sure else LARGEST_SHARE + LEG_TASK.spare
