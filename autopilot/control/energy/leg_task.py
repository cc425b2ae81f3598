"""Planning of one leg: initial guesses along its candidate paths, their nonlinear programs, and the resulting plan."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from autopilot.control.constraints.obstacles import Features
from autopilot.control.energy.energy_tuning import LEG_TASK, SHOOTING
from autopilot.control.energy.field import EnergyToGo, FieldPath
from autopilot.control.energy.flow import FlowField
from autopilot.control.energy.power import SpeedTable, energy_per_metre, planar_limit_m_s
from autopilot.control.energy.request import Plan, TrajectoryRequest, no_plan
from autopilot.control.energy.trajectory import Program, ProgramInputs, Trajectory
from autopilot.core.background import Cancel
from autopilot.core.control_allocator import ControlAllocator
from autopilot.core.frames import FloatArray, unwrap_near
from autopilot.core.model4 import NX, YAW, R, U, V, W, X, Y, Z

BOTH_TURNS_RAD = 0.4 * math.pi
"""A turn longer than this is tried both ways round."""


class LegTask:
    """One request and its intermediate results."""

    def __init__(
        self,
        request: TrajectoryRequest,
        features: Features,
        flow: FlowField,
        table: SpeedTable,
        to_go: EnergyToGo,
        end_slope: FloatArray,
        program: Callable[[float], Program],
        allocator: ControlAllocator,
        cancel: Cancel,
    ) -> None:
        self._allocator, self._cancel = allocator, cancel
        self._request, self._features, self._flow, self._table = request, features, flow, table
        self._to_go, self._end_slope, self._program = to_go, end_slope, program
        self.reach_s = LEG_TASK.longest_s
        """Planning distance."""
        self._gate: FloatArray | None = None
        """(3,) where the trajectory ends when the goal is too far away."""

    @property
    def complete(self) -> bool:
        """Whether the trajectories of the last guesses end in the goal's region."""
        return self._gate is None

    def following(self, end: Trajectory, beyond: EnergyToGo) -> "LegTask":
        """The task of the leg after this one, from where ``end`` ends."""
        goal = self._request.goal.following
        assert goal is not None
        request = replace(self._request, x0=end.x[-1], goal=goal, warm=None, leg_depth_m=None)
        rest = (np.zeros(2), self._program, self._allocator, self._cancel)
        return LegTask(request, self._features, self._flow, self._table, beyond, *rest)

    def first(self, path: FieldPath) -> Plan:
        """The quick plan: the better of both directions of turning along the path. (The guesses do not show which that
        is.)
        """
        found = [
            one for one in (self.refine(guess, LEG_TASK.screen_rounds) for guess in self.guesses(path)) if one.solved
        ]
        if not found:
            return no_plan(self._request.goal, "no quick trajectory solved")
        return self.plan(min(found, key=lambda one: one.cost_j))

    def ends_in_goal(self, path: FieldPath) -> bool:
        """Whether a trajectory along a path reaches the goal region."""
        return float(self._timed(path)[1][-1]) <= self.reach_s

    def guesses(self, path: FieldPath) -> list[Trajectory]:
        """Initial trajectories along a path, one per direction of turning, at the minimum-energy steady speed and its
        thrust.
        """
        request = self._request
        points, times = self._timed(path)
        whole_s = float(times[-1])
        if whole_s > self.reach_s:
            cut = int(np.searchsorted(times, self.reach_s))
            points, times = points[: cut + 1], times[: cut + 1]
            fraction = float(times[-1]) / whole_s
            depth = request.x0[Z] + fraction * (request.goal.pos_ned_m[2] - request.x0[Z])
            self._gate = np.array([*points[-1], depth])
        else:
            self._gate = None
            away = np.hypot(*(points - points[-1]).T)
            outside = away > self._region_m
            last = min(int(np.flatnonzero(outside)[-1]) + 1 if outside.any() else 1, len(points) - 1)
            points, times = points[: last + 1], times[: last + 1]
        if times[-1] > LEG_TASK.linear_turn_s:
            points, times = self._turned_first(points, times)
        return [self._guess(points, times, yaw) for yaw in self._turns()]

    @property
    def _region_m(self) -> float:
        """Radius about the goal in which the trajectory ends."""
        request = self._request
        return (LEG_TASK.radius_fraction - request.uncertainty) * request.goal.accept_radius_m

    def _least_s(self, yaw_rad: float | None) -> float:
        """Lower bound of the duration [s] from the change of depth to the goal region and the turn to its heading."""
        if self._gate is not None:
            return LEG_TASK.shortest_guess_s
        start, goal = self._request.x0, self._request.goal
        heave, turn_rate = (float(limit) for limit in self._request.limits[1:3])
        rise = abs(float(goal.pos_ned_m[2] - start[Z])) - self._region_m
        turn = 0.0 if yaw_rad is None else abs(yaw_rad - float(start[YAW]))
        return max(LEG_TASK.shortest_guess_s, rise / heave, turn / turn_rate)

    def _turned_first(self, points: FloatArray, times: FloatArray) -> tuple[FloatArray, FloatArray]:
        """A timed path that starts after the turn towards it: otherwise the guess would move astern at full speed,
        where sway and yaw are so unstable that the integration diverges.
        """
        ahead = min(int(np.searchsorted(times, times[0] + 2.0)), len(points) - 1)
        ground = (points[ahead] - points[0]) / max(float(times[ahead] - times[0]), 1e-9)
        relative = ground - self._flow.current(points[:1])[0, :2]
        yaw = float(self._request.x0[YAW])
        turn = abs(unwrap_near(math.atan2(relative[1], relative[0]), yaw) - yaw)
        if turn < LEG_TASK.slight_turn_rad:
            return points, times
        wait_s = turn / LEG_TASK.guess_turn_rad_s
        return np.vstack([points[:1], points]), np.concatenate([[0.0], times + wait_s])

    def _guess(self, points: FloatArray, times: FloatArray, yaw_rad: float | None) -> Trajectory:
        """The initial trajectory along a timed path that ends with a heading (None: along the path)."""
        request = self._request
        whole_s = float(times[-1])
        end_s = max(whole_s, self._least_s(yaw_rad))
        times = times * (end_s / whole_s)
        t = np.linspace(0.0, end_s, LEG_TASK.intervals + 1)
        x = np.zeros((LEG_TASK.intervals + 1, NX))
        x[:, X], x[:, Y] = np.interp(t, times, points[:, 0]), np.interp(t, times, points[:, 1])
        depth = float(request.goal.pos_ned_m[2] if self._gate is None else self._gate[2])
        x[:, Z] = np.linspace(request.x0[Z], depth, LEG_TASK.intervals + 1)
        relative = np.gradient(x[:, :2], t, axis=0) - self._flow.current(x[:, :2])[:, :2]
        x[:, YAW] = self._headings(t, x, relative, yaw_rad)
        c, s = np.cos(x[:, YAW]), np.sin(x[:, YAW])
        x[:, U], x[:, V] = c * relative[:, 0] + s * relative[:, 1], c * relative[:, 1] - s * relative[:, 0]
        x[:, R] = np.gradient(x[:, YAW], t)
        thrust = self._allocator.hold_n(0.5 * (x[1:, U:] + x[:-1, U:]), request.thrust_limit_n)
        x[0] = request.x0
        energy = end_s * float(self._table.power_w.min())
        return Trajectory(t_s=t, x=x, thrust_n=thrust, energy_j=energy, cost_j=energy, solved=False)

    def _headings(self, t: FloatArray, x: FloatArray, relative: FloatArray, yaw_rad: float | None) -> FloatArray:
        """(n + 1,) of a guess with places ``x`` and velocities ``relative`` (n + 1, 2) through the water.

        No guess may turn within an interval: from such a one no solution is found.
        """
        start, end_s = float(self._request.x0[YAW]), float(t[-1])
        if yaw_rad is not None and end_s < LEG_TASK.linear_turn_s:
            return np.linspace(start, yaw_rad, len(t))
        if end_s < LEG_TASK.turnless_s:
            return np.full(len(t), start)
        course = np.arctan2(relative[1:, 1], relative[1:, 0])
        here = np.hypot(*(x[1:, :2] - x[0, :2]).T) < LEG_TASK.turned_within_m
        if here.any() and not here.all():
            course[here] = course[int(here.argmin())]
        along: FloatArray = np.unwrap(np.concatenate([[start], course]))
        turn = float(along[1] - along[0])
        if turn:
            rate = max(LEG_TASK.guess_turn_rad_s, 2.0 * abs(turn) / end_s)
            along[1:] -= turn * np.clip(1.0 - t[1:] * rate / abs(turn), 0.0, 1.0)
        if yaw_rad is None:
            return along
        last = unwrap_near(yaw_rad, float(along[-1]))
        return along + np.clip((t - end_s) / (0.5 * LEG_TASK.linear_turn_s) + 1.0, 0.0, 1.0) * (last - along)

    def energy_along(self, trajectory: Trajectory) -> float:
        """Energy of a trajectory's path by the model of the energy field [J]: steady speeds, heading along the path."""
        places = trajectory.x[:, :2]
        step = np.diff(places, axis=0)
        ds = np.maximum(np.hypot(*step.T), 1e-9)
        current = self._flow.current(0.5 * (places[1:] + places[:-1]))[:, :2]
        along = (current * step).sum(axis=1) / ds
        across = (current[:, 0] * step[:, 1] - current[:, 1] * step[:, 0]) / ds
        rest = self._to_go.path(places[-1])
        energy = float((ds * energy_per_metre(self._table, along, across)).sum())
        return math.inf if rest is None else energy + rest.energy_j

    def _timed(self, path: FieldPath) -> tuple[FloatArray, FloatArray]:
        """Dense points (m, 2) along a path and their times at the minimum-energy speeds."""
        length = np.hypot(*np.diff(path.points_ned_m, axis=0).T)
        s = np.concatenate(([0.0], np.cumsum(length)))
        at = np.linspace(0.0, s[-1], max(200, int(s[-1] / 0.5)))
        points = np.stack([np.interp(at, s, path.points_ned_m[:, i]) for i in range(2)], axis=1)
        step = np.diff(points, axis=0)
        ds = np.maximum(np.hypot(*step.T), 1e-9)
        current = self._flow.current(0.5 * (points[1:] + points[:-1]))[:, :2]
        along = (current * step).sum(axis=1) / ds
        across = (current[:, 0] * step[:, 1] - current[:, 1] * step[:, 0]) / ds
        u = self._table.speed_m_s[:, None]
        ground = np.sqrt(np.maximum(u * u - across * across, 0.0)) + along
        usable = (ground > 0.02) & self._table.allowed(along, across)
        cost = np.where(usable, self._table.power_w[:, None] / np.maximum(ground, 0.02), np.inf)
        best = cost.argmin(axis=0)
        speed = np.maximum(ground[best, np.arange(len(ds))], 0.02)
        return points, np.concatenate(([0.0], np.cumsum(ds / speed)))

    def _turns(self) -> Sequence[float | None]:
        """Headings to end with, on the turns by which they may be reached; None = free."""
        goal = self._request.goal
        if goal.yaw_rad is None or self._gate is not None:
            return (None,)
        start = float(self._request.x0[YAW])
        nearest = unwrap_near(goal.yaw_rad, start)
        if abs(nearest - start) < BOTH_TURNS_RAD:
            return (nearest,)
        return (nearest, nearest + math.copysign(2.0 * math.pi, start - nearest))

    def screened(self, guess: Trajectory) -> Trajectory:
        """A candidate, solved as accurately as needed for the comparison."""
        return self.refine(guess, LEG_TASK.screen_rounds, rough=True)

    def refine(self, guess: Trajectory, rounds: int, *, rough: bool = False) -> Trajectory:
        """Solve, linearise anew around the solution, and so on; the last solution, solved if any was."""
        trajectory = guess
        program = self._program(1.1 * float(guess.t_s[-1]))
        for _ in range(rounds):
            cost_j = trajectory.cost_j if trajectory.solved else math.inf
            found = self._solved(program, trajectory, rough)
            if not found.solved:
                warm = trajectory.multipliers is not None
                second = replace(trajectory, multipliers=None) if warm else _slower(trajectory)
                found = self._solved(program, second, rough)
            if not found.solved:
                return trajectory if trajectory.solved else found
            trajectory = found
            if abs(trajectory.cost_j - cost_j) < LEG_TASK.settled_fraction * cost_j:
                break
        return trajectory

    def _solved(self, program: Program, guess: Trajectory, rough: bool) -> Trajectory:
        self._cancel.check()
        inputs, end_s = self._inputs(guess, self._request), float(guess.t_s[-1])
        return program.solve(inputs, guess.x, guess.thrust_n, end_s, rough=rough, multipliers=guess.multipliers)

    def _inputs(self, guess: Trajectory, request: TrajectoryRequest) -> ProgramInputs:
        goal, x = request.goal, guess.x
        n = len(x) - 1
        normals, offsets = np.zeros((n + 1, SHOOTING.planes, 2)), np.zeros((n + 1, SHOOTING.planes))
        self._features.half_planes(
            np.vstack([x[:1, :2], x[:, :2]]),
            np.concatenate([[0.0], guess.t_s]),
            self._keep_m(guess.t_s, x[:, :2]),
            SHOOTING.planes,
            normals,
            offsets,
        )
        gate = self._gate
        aimed = goal.yaw_rad is not None and gate is None
        yaw_band = (LEG_TASK.yaw_fraction - request.uncertainty) * goal.accept_yaw_rad if aimed else 1e3
        middle = float(x[-1, YAW]) if goal.yaw_rad is None else unwrap_near(goal.yaw_rad, float(x[-1, YAW]))
        place = np.asarray(goal.pos_ned_m, dtype=float)
        slope = self._end_slope
        if gate is not None:
            place = gate
            slope = self._to_go.slope(gate[:2], LEG_TASK.gate_radius_m)
        return ProgramInputs(
            x0=request.x0,
            goal_ned_m=place,
            radius_m=self._region_m if gate is None else LEG_TASK.gate_radius_m,
            yaw_rad=middle,
            yaw_band_rad=yaw_band,
            current=self._flow.current(x[:, :2]),
            gradient=self._flow.gradient(x[:, :2]),
            places=x[:, :2].copy(),
            plane_n=normals,
            plane_d=offsets,
            planar_m_s=self._planar_m_s(guess, request),
            limits=self._limits(guess, request),
            thrust_limit_n=request.thrust_limit_n,
            end_slope_j_m=slope,
            longest_s=LEG_TASK.longer * float(guess.t_s[-1]) + LEG_TASK.longer_s,
            buoyancy_excess_n=request.buoyancy_excess_n,
        )

    def _planar_m_s(self, guess: Trajectory, request: TrajectoryRequest) -> FloatArray:
        """(n + 1,) limit of the planar speed along a guess; one that begins faster is given the time to slow down."""
        x = guess.x
        tangent = np.gradient(x[:, :2], axis=0)
        tangent /= np.maximum(np.hypot(*tangent.T), 1e-9)[:, None]
        current = self._flow.current(x[:, :2])[:, :2]
        across = current[:, 0] * tangent[:, 1] - current[:, 1] * tangent[:, 0]
        limit = planar_limit_m_s(self._table, (current * tangent).sum(axis=1), across)
        slowing = float(np.hypot(request.x0[U], request.x0[V])) - LEG_TASK.slowing_m_s2 * guess.t_s
        result: FloatArray = np.maximum(np.minimum(limit, request.limits[0]), slowing)
        return result

    def _limits(self, guess: Trajectory, request: TrajectoryRequest) -> FloatArray:
        """(n + 1, 4) limits of heave, yaw rate and depth; a vehicle that begins beyond one, or cannot stop before a
        depth, is given the time to."""
        depth, heave, turn = (float(request.x0[i]) for i in (Z, W, R))
        stop = 0.5 * heave * abs(heave) / LEG_TASK.slowing_m_s2
        limits = np.tile(request.limits[1:], (len(guess.t_s), 1))
        limits[:, 0] = np.maximum(limits[:, 0], abs(heave) - LEG_TASK.slowing_m_s2 * guess.t_s)
        limits[:, 1] = np.maximum(limits[:, 1], abs(turn) - LEG_TASK.slowing_rad_s2 * guess.t_s)
        began = depth if request.leg_depth_m is None else request.leg_depth_m
        ends = began, float(request.goal.pos_ned_m[2])
        limits[:, 2] = np.maximum(limits[:, 2], min(ends) - LEG_TASK.leg_depth_m)
        limits[:, 3] = np.minimum(limits[:, 3], max(ends) + LEG_TASK.leg_depth_m)
        limits[:, 2] = np.minimum(limits[:, 2], depth + min(stop, 0.0))
        limits[:, 3] = np.maximum(limits[:, 3], depth + max(stop, 0.0))
        return limits

    def _keep_m(self, t_s: FloatArray, places: FloatArray) -> FloatArray:
        """(n + 1,) clearance of a trajectory along positions (n + 1, 2): EXTRA_M beyond the radius, less in narrow
        passages, at the goal and at the start.
        """
        radius_m, features = self._request.radius_m, self._features
        if features.count == 0:
            return np.full(len(places), radius_m)
        at = np.arange(0.0, len(places) - 1.0 + 1e-9, 1.0 / LEG_TASK.points_between)
        points = np.stack([np.interp(at, np.arange(len(places)), places[:, i]) for i in range(2)], axis=1)
        most = radius_m + self._request.extra_m
        for _ in range(LEG_TASK.door_steps):
            points += features.push_out(points, most)
        doors_m = float(features.clearance_up_to_m(points, most).min())
        ends = np.stack([np.asarray(self._request.goal.pos_ned_m[:2], dtype=float), self._request.x0[:2]])
        goal_m, here_m = features.clearance_up_to_m(ends, most).tolist()
        least = max(radius_m, min(doors_m, radius_m + LEG_TASK.between_m))
        result: FloatArray = np.clip(here_m + LEG_TASK.widening_m_s * t_s, least, max(least, min(doors_m, goal_m)))
        return result

    def plan(self, trajectory: Trajectory) -> Plan:
        """The answer that a trajectory makes."""
        energy, eta = trajectory.energy_j, float(trajectory.t_s[-1])
        if self._gate is not None:
            path = self._to_go.path(self._gate[:2])
            if path is not None:
                energy += path.energy_j
                eta += float(self._timed(path)[1][-1])
        return Plan(
            goal=self._request.goal,
            trajectory=trajectory,
            energy_j=energy,
            eta_s=eta,
            complete=self._gate is None,
            flow=self._flow,
        )


def _slower(guess: Trajectory) -> Trajectory:
    """The same path in more time: the second start of a program that was not solved from the first."""
    x = guess.x.copy()
    x[1:, U:] /= LEG_TASK.second_start
    return replace(guess, t_s=LEG_TASK.second_start * guess.t_s, x=x, thrust_n=guess.thrust_n / LEG_TASK.second_start)


def shifted(trajectory: Trajectory, by_s: float, x0: FloatArray) -> Trajectory:
    """The part of a trajectory after ``by_s``, resampled to INTERVALS intervals, from the state ``x0``."""
    n = LEG_TASK.intervals
    t = np.linspace(min(by_s, 0.98 * float(trajectory.t_s[-1])), float(trajectory.t_s[-1]), n + 1)
    x = np.stack([np.interp(t, trajectory.t_s, column) for column in trajectory.x.T], axis=1)
    x[:, YAW] += unwrap_near(float(x[0, YAW]), float(x0[YAW])) - x[0, YAW]
    index = np.clip(np.searchsorted(trajectory.t_s, 0.5 * (t[1:] + t[:-1])) - 1, 0, len(trajectory.thrust_n) - 1)
    x[0] = x0
    return replace(trajectory, t_s=t - t[0], x=x, thrust_n=trajectory.thrust_n[index], solved=False, multipliers=None)
