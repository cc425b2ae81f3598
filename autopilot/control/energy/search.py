"""From a request to a plan: ways over the energy field, both ways of turning, the best of them as a trajectory."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from autopilot.control.energy.field import LONGEST_MOVE, EnergyField, EnergyToGo, Way, other_ways
from autopilot.control.energy.flow import LEAST_SAMPLES, Flow, FlowSamples, area_of
from autopilot.control.energy.patience import Kind
from autopilot.control.energy.power import PowerModel, SpeedTable, energy_per_metre, planar_limit_m_s, speed_table
from autopilot.control.energy.shooting import PLANES
from autopilot.control.energy.trajectory import SUBSTEP_S, Ask, Program, Trajectory
from autopilot.control.guidance import SteadyThrust
from autopilot.control.obstacles import Features, fence_key
from autopilot.core.desk import Cancel
from autopilot.core.frames import FloatArray, unwrap_near
from autopilot.core.free_space import Area, FreeSpace
from autopilot.core.geometry import Fence
from autopilot.core.messages import Goal
from autopilot.core.model4 import NX, YAW, Model4, R, U, V, W, X, Y, Z

INTERVALS = 48
"""Of a trajectory: 0.2 s each in the paper's tank."""

LONGEST_S = 43.0
"""A trajectory is planned so far; beyond it the energy field says what is best. (Twice as far takes a program with
twice as many RK4 steps, 200 MB more, and intervals that are too long for doors.)"""

SHORTER_S = (18.0,)
"""So far if none of that length is solved: shorter intervals find their way through doors."""

SUBSTEPS = (1, 2)

LONGER, LONGER_S = 1.3, 3.0
"""A solution takes at most so many times as long as its guess, and so much more: RK4 steps must not grow unstable."""

RADIUS_SHARE = 0.93
YAW_SHARE = 0.8
"""Shares of the acceptance region that a trajectory aims at, so that it is surely reached in spite of small errors."""

GATE_RADIUS_M = 0.5
"""Region in which a trajectory ends that does not reach its goal within LONGEST_S."""

SCREEN_ROUNDS = 1
POLISH_ROUNDS = 3
"""Rounds of linearisation for every candidate, and more for the best."""

SETTLED_SHARE = 1e-4
"""A round that changes the cost by less than this share was the last."""

UPDATE_ROUNDS = 1
"""Rounds for a plan that is only brought up to date."""

STAY_WITHIN = 1.1
"""A plan stays on its way while the energy field knows none that is cheaper by so much: near-ties would flip."""

CHEAPER_SHARE = 0.95
"""A full search replaces a quick plan that is under way if it costs less than so much of what is left of that."""

KEEP_WITHIN = 1.15
"""Ways whose energy is beyond so many times the best one's are not looked at."""

MAX_OTHER_WAYS = 2

TIE_WITHIN, MAX_TIES = 1.15, 3
"""Among so many trajectories within so many times the best one's cost the leg after this one decides."""

BOTH_TURNS_RAD = 0.4 * math.pi
"""A turn longer than this is tried both ways round."""

SLIGHT_TURN_RAD = 0.8
TURNED_WITHIN_M = 0.05

GUESS_TURN_RAD_S = 0.4
"""Rate at which first guesses turn from where the vehicle points to their way."""

LINEAR_TURN_S = 20.0
"""On a way that takes less, the first guess turns evenly from start to end; on a longer one it follows the way."""

SLOPE_REACH_M = 0.25

SLOWING_M_S2 = 0.1
"""What a vehicle that is faster than it may be is asked to slow down with at least: what drag does at 0.2 m/s."""

SLOWING_RAD_S2 = 0.3
"""The same of one that turns too fast."""

BETWEEN_M = 0.004
"""Kept beyond the optimiser's own margin, for what lies between the nodes."""

EXTRA_M, EXTRA_S = 0.02, 0.5
"""Kept beyond it at most where there is room, and how long a current of one standard deviation takes for it: an
estimate wavers, and every millimetre that a vehicle is within the margin is answered sharply."""

WIDENING_M_S = 0.02
"""A vehicle that is nearer than that goes away from the boundary so fast."""

COMFORT_M = 0.03
"""Kept beyond the radius by ways, if there are such: a passage that is open by centimetres only is not chosen."""

LOOKS_BETWEEN = 4
DOOR_STEPS = 4
"""A way is looked at between its nodes for doors that are too narrow for that: where both sides push places about."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Request:
    """Everything a plan depends on. Pure data: the answer is the same whenever it is computed."""

    x0: FloatArray
    """(8,) state at which the plan begins."""
    goal: Goal
    fence: Fence
    radius_m: float
    """Kept from every boundary."""
    extra_m: float = EXTRA_M
    """Kept beyond that where there is room."""
    flow: FlowSamples
    limits: FloatArray
    """(5,) planar speed, heave, yaw rate, depth minimum, depth maximum."""
    thrust_limit_n: FloatArray
    """(4,)"""
    cruise_m_s: float = math.inf
    """See :func:`autopilot.control.energy.power.planar_limit_m_s`."""
    warm: Trajectory | None = None
    """What is left of the plan in force, if the vehicle may stay on it."""
    kind: Kind = Kind.COLD
    """What is looked at."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Plan:
    """An answer."""

    goal: Goal
    trajectory: Trajectory | None
    """None if there is no way."""
    energy_j: float
    """To the goal region, what lies beyond LONGEST_S included."""
    eta_s: float
    complete: bool
    """The trajectory ends in the goal's region."""
    flow: Flow | None = None
    """The water that it was made for."""
    why: str = ""
    """Without a trajectory: the reason."""
    stay: bool = False
    """A full search has found nothing that is clearly cheaper than the plan in force."""


class TrajectoryPlanner(Protocol):
    """Makes plans beside the loop; an exception means that there is none."""

    def plan(self, request: Request, cancel: Cancel) -> Plan:
        """Answer one request; once ``cancel`` is requested anything will do."""
        ...

    def warm(self) -> None:
        """Import and build what the first plan needs."""
        ...


class EnergyPlanner:
    """Keeps the built programs and the last features; otherwise a function of the request."""

    def __init__(self, model: Model4, power: PowerModel) -> None:
        self._model, self._power = model, power
        self._steady = SteadyThrust(model)
        self._programs: dict[int, Program] = {}
        self._features: tuple[tuple[object, ...], Features] | None = None
        self._spaces: dict[int, tuple[Features, tuple[float, ...], FreeSpace]] = {}

    def warm(self) -> None:
        """See :class:`TrajectoryPlanner`."""
        self._program(0.0)
        still = np.zeros((LEAST_SAMPLES, LEAST_SAMPLES, 3))
        still[0] = 1.0
        axis = np.arange(float(LEAST_SAMPLES))
        Flow(FlowSamples(north_m=axis, east_m=axis, current_ned_m_s=still))

    def plan(self, request: Request, cancel: Cancel | None = None) -> Plan:
        """See :class:`TrajectoryPlanner`. Ends with WithdrawnError soon after ``cancel`` is requested."""
        cancel = cancel or Cancel()
        cancel.check()
        features = self._features_of(request.fence)
        flow = Flow(request.flow)
        table = speed_table(self._model, self._power, float(request.limits[0]), request.cruise_m_s)
        found = self._field(request, features, flow, table)
        if found is None:
            return _none(request.goal, "no way")
        field, to_go, best = found
        cancel.check()
        beyond = _field_beyond(field, request.goal)
        end_slope = _slope_beyond(beyond, request.goal)
        task = _Task(request, features, flow, table, to_go, end_slope, self._program, self._steady, cancel)
        task.guesses(best)
        # What ends at a gate has a new one.
        warm = None if request.warm is None or not task.complete else task.refine(request.warm, UPDATE_ROUNDS)
        stays = warm is not None and warm.solved and task.energy_along(warm) < STAY_WITHIN * best.energy_j
        if warm is not None and stays and request.kind is Kind.WARM:
            return task.plan(warm)
        if request.kind is Kind.QUICK:
            return task.first(best)
        candidates = [] if warm is None else [warm]
        for task.reach_s in (LONGEST_S, *SHORTER_S):
            if task.reach_s < LONGEST_S and task.ends_in_goal(best):
                continue
            candidates += self._candidates(task, field, to_go, best, features)
            solved = sorted((one for one in candidates if one.solved), key=lambda one: one.cost_j)
            if solved:
                break
        else:
            return _none(request.goal, f"none of {len(candidates)} trajectories solved")
        winner = solved[0]
        close = [one for one in solved if one.cost_j < TIE_WITHIN * winner.cost_j][:MAX_TIES]
        if len(close) > 1 and beyond is not None and task.complete:
            onward = self._onward(task, close, field, beyond, features)
            winner = close[int(np.argmin(onward))]
        if warm is not None and warm.solved and winner.cost_j > CHEAPER_SHARE * warm.cost_j:
            return replace(task.plan(warm), stay=True)
        polished = task.refine(winner, POLISH_ROUNDS)
        return task.plan(polished if polished.solved else winner)

    def _field(
        self, request: Request, features: Features, flow: Flow, table: SpeedTable
    ) -> tuple[EnergyField, EnergyToGo, Way] | None:
        """The field of a request with the cheapest way, through tight doors only if there is no other."""
        goal_at, start = np.asarray(request.goal.pos_ned_m[:2], dtype=float), request.x0[:2]
        places = [start, goal_at]
        if request.goal.following is not None:
            places.append(np.asarray(request.goal.following.pos_ned_m[:2], dtype=float))
        area = area_of(request.fence, np.stack(places))
        for look, extra_m in enumerate((COMFORT_M, 0.0) if features.count else (0.0,)):
            field = EnergyField(self._space_of(look, request.radius_m + extra_m, features, area), flow, table)
            to_go = field.to(goal_at)
            way = None if to_go is None else to_go.way(start)
            if to_go is not None and way is not None:
                return field, to_go, way
        return None

    def _candidates(
        self, task: "_Task", field: EnergyField, to_go: EnergyToGo, best: Way, features: Features
    ) -> list[Trajectory]:
        """A trajectory along every way that is worth a look, for every way of turning."""
        guesses = task.guesses(best)
        # Ways to other gates cannot be compared.
        others = other_ways(field, to_go, best, features, MAX_OTHER_WAYS) if task.complete else []
        for way in others:
            if way.energy_j <= KEEP_WITHIN * best.energy_j:
                guesses += task.guesses(way)
        return [task.refine(guess, SCREEN_ROUNDS) for guess in guesses]

    def _onward(
        self, task: "_Task", ends: Sequence[Trajectory], field: EnergyField, beyond: EnergyToGo, features: Features
    ) -> FloatArray:
        """(len(ends),) energy of each trajectory and of the best leg after it, inf where none was found.

        Trajectories that arrive by different ways or turns differ more in what the next leg takes than in themselves.
        """
        totals = np.full(len(ends), np.inf)
        for i, end in enumerate(ends):
            way = beyond.way(end.x[-1, :2])
            if way is None:
                continue
            after = task.following(end, beyond)
            legs = [leg for leg in self._candidates(after, field, beyond, way, features) if leg.solved]
            if legs:
                totals[i] = end.energy_j + min(leg.cost_j for leg in legs)
        return totals if np.isfinite(totals).any() else np.array([end.cost_j for end in ends])

    def _features_of(self, fence: Fence) -> Features:
        key = fence_key(fence)
        if self._features is None or self._features[0] != key:
            self._features = (key, Features(fence))
        return self._features[1]

    def _space_of(self, look: int, radius_m: float, features: Features, area: Area) -> FreeSpace:
        """The free space of a look; that of the last request if nothing but the water is another one."""
        key = (radius_m, *area.low_m.tolist(), *area.high_m.tolist())
        kept = self._spaces.get(look)
        if kept is None or kept[0] is not features or kept[1] != key:
            kept = (features, key, FreeSpace(features, area, radius_m, long_moves=LONGEST_MOVE))
            self._spaces[look] = kept
        return kept[2]

    def _program(self, duration_s: float) -> Program:
        """The program whose RK4 steps are short enough for a trajectory of that duration."""
        need = duration_s / (INTERVALS * SUBSTEP_S)
        substeps = next((s for s in SUBSTEPS if s >= need), SUBSTEPS[-1])
        if substeps not in self._programs:
            self._programs[substeps] = Program(self._model, self._power, INTERVALS, substeps)
        return self._programs[substeps]


def _none(goal: Goal, why: str) -> Plan:
    return Plan(goal=goal, trajectory=None, energy_j=math.inf, eta_s=math.inf, complete=False, why=why)


def _field_beyond(field: EnergyField, goal: Goal) -> EnergyToGo | None:
    """The energy to go of the leg after ``goal``."""
    return None if goal.following is None else field.to(np.asarray(goal.following.pos_ned_m[:2], dtype=float))


def _slope_beyond(beyond: EnergyToGo | None, goal: Goal) -> FloatArray:
    """(2,) slope [J/m] at the goal of the energy that it takes to go on from there."""
    if beyond is None:
        return np.zeros(2)
    return beyond.slope(np.asarray(goal.pos_ned_m[:2], dtype=float), SLOPE_REACH_M)


class _Task:
    """One request with what has been made of it."""

    def __init__(
        self,
        request: Request,
        features: Features,
        flow: Flow,
        table: SpeedTable,
        to_go: EnergyToGo,
        end_slope: FloatArray,
        program: Callable[[float], Program],
        steady: SteadyThrust,
        cancel: Cancel,
    ) -> None:
        self._steady, self._cancel = steady, cancel
        self._request, self._features, self._flow, self._table = request, features, flow, table
        self._to_go, self._end_slope, self._program = to_go, end_slope, program
        self.reach_s = LONGEST_S
        """So far trajectories are planned."""
        self._gate: FloatArray | None = None
        """(3,) where the trajectory ends when the goal is too far away."""

    @property
    def complete(self) -> bool:
        """Whether the trajectories of the last guesses end in the goal's region."""
        return self._gate is None

    def following(self, end: Trajectory, beyond: EnergyToGo) -> "_Task":
        """The task of the leg after this one, from where ``end`` ends."""
        goal = self._request.goal.following
        assert goal is not None
        request = replace(self._request, x0=end.x[-1], goal=goal, warm=None)
        rest = (np.zeros(2), self._program, self._steady, self._cancel)
        return _Task(request, self._features, self._flow, self._table, beyond, *rest)

    def first(self, way: Way) -> Plan:
        """The quick answer: the better turn along the way. (Which one that is cannot be seen from the guesses.)"""
        found = [one for one in (self.refine(guess, SCREEN_ROUNDS) for guess in self.guesses(way)) if one.solved]
        if not found:
            return _none(self._request.goal, "no quick trajectory solved")
        return self.plan(min(found, key=lambda one: one.cost_j))

    def ends_in_goal(self, way: Way) -> bool:
        """Whether a trajectory along a way reaches the goal's region."""
        return float(self._timed(way)[1][-1]) <= self.reach_s

    def guesses(self, way: Way) -> list[Trajectory]:
        """First trajectories along a way, one per way of turning: at the cheapest steady speed and its thrust."""
        request = self._request
        points, times = self._timed(way)
        whole_s = float(times[-1])
        if whole_s > self.reach_s:
            cut = int(np.searchsorted(times, self.reach_s))
            points, times = points[: cut + 1], times[: cut + 1]
            share = float(times[-1]) / whole_s
            depth = request.x0[Z] + share * (request.goal.pos_ned_m[2] - request.x0[Z])
            self._gate = np.array([*points[-1], depth])
        else:
            self._gate = None
            away = np.hypot(*(points - points[-1]).T)
            outside = away > RADIUS_SHARE * request.goal.accept_radius_m
            last = min(int(np.flatnonzero(outside)[-1]) + 1 if outside.any() else 1, len(points) - 1)
            points, times = points[: last + 1], times[: last + 1]
        if times[-1] > LINEAR_TURN_S:
            points, times = self._turned_first(points, times)
        t = np.linspace(0.0, max(float(times[-1]), 0.5), INTERVALS + 1)
        x = np.zeros((INTERVALS + 1, NX))
        x[:, X], x[:, Y] = np.interp(t, times, points[:, 0]), np.interp(t, times, points[:, 1])
        depth = float(request.goal.pos_ned_m[2] if self._gate is None else self._gate[2])
        x[:, Z] = np.linspace(request.x0[Z], depth, INTERVALS + 1)
        ground = np.gradient(x[:, :2], t, axis=0)
        water = ground - self._flow.current(x[:, :2])[:, :2]
        course = np.arctan2(water[1:, 1], water[1:, 0])
        here = np.hypot(*(x[1:, :2] - x[0, :2]).T) < TURNED_WITHIN_M
        if here.any() and not here.all():
            course[here] = course[int(here.argmin())]
        along = np.unwrap(np.concatenate([[request.x0[YAW]], course]))
        turn = float(along[1] - along[0])
        if turn and t[-1] > LINEAR_TURN_S:
            along[1:] -= turn * np.clip(1.0 - t[1:] * GUESS_TURN_RAD_S / abs(turn), 0.0, 1.0)
        return [self._guess(t, x, water, along, yaw) for yaw in self._turns(float(along[-1]))]

    def _turned_first(self, points: FloatArray, times: FloatArray) -> tuple[FloatArray, FloatArray]:
        """A timed way that begins when the vehicle has turned to it: it would else be guessed to go backwards at full
        speed, where sway and yaw are so unstable that the integration runs away."""
        ahead = min(int(np.searchsorted(times, times[0] + 2.0)), len(points) - 1)
        ground = (points[ahead] - points[0]) / max(float(times[ahead] - times[0]), 1e-9)
        water = ground - self._flow.current(points[:1])[0, :2]
        yaw = float(self._request.x0[YAW])
        turn = abs(unwrap_near(math.atan2(water[1], water[0]), yaw) - yaw)
        if turn < SLIGHT_TURN_RAD:
            return points, times
        wait_s = turn / GUESS_TURN_RAD_S
        return np.vstack([points[:1], points]), np.concatenate([[0.0], times + wait_s])

    def _guess(
        self, t: FloatArray, x: FloatArray, water: FloatArray, along: FloatArray, yaw_rad: float | None
    ) -> Trajectory:
        x = x.copy()
        start = float(self._request.x0[YAW])
        if yaw_rad is None:
            x[:, YAW] = along
        elif t[-1] < LINEAR_TURN_S:
            x[:, YAW] = np.linspace(start, yaw_rad, len(t))
        else:
            last = unwrap_near(yaw_rad, float(along[-1]))
            fade = np.clip((t - t[-1] + 0.5 * LINEAR_TURN_S) / (0.5 * LINEAR_TURN_S), 0.0, 1.0)
            x[:, YAW] = along + fade * (last - along)
        c, s = np.cos(x[:, YAW]), np.sin(x[:, YAW])
        x[:, U], x[:, V] = c * water[:, 0] + s * water[:, 1], c * water[:, 1] - s * water[:, 0]
        x[:, R] = np.gradient(x[:, YAW], t)
        limit = self._request.thrust_limit_n
        thrust = np.clip(self._steady(0.5 * (x[1:, U:] + x[:-1, U:])), -limit, limit)
        x[0] = self._request.x0
        energy = float(t[-1]) * float(self._table.power_w.min())
        return Trajectory(t_s=t, x=x, thrust_n=thrust, energy_j=energy, cost_j=energy, solved=False)

    def energy_along(self, trajectory: Trajectory) -> float:
        """What the way of a trajectory costs by the measure of the energy field: steady speeds, heading along it."""
        places = trajectory.x[:, :2]
        step = np.diff(places, axis=0)
        ds = np.maximum(np.hypot(*step.T), 1e-9)
        current = self._flow.current(0.5 * (places[1:] + places[:-1]))[:, :2]
        along = (current * step).sum(axis=1) / ds
        across = (current[:, 0] * step[:, 1] - current[:, 1] * step[:, 0]) / ds
        rest = self._to_go.way(places[-1])
        energy = float((ds * energy_per_metre(self._table, along, across)).sum())
        return math.inf if rest is None else energy + rest.energy_j

    def _timed(self, way: Way) -> tuple[FloatArray, FloatArray]:
        """Points (m, 2) close together along a way and when they are passed at the cheapest speeds."""
        length = np.hypot(*np.diff(way.points_ned_m, axis=0).T)
        s = np.concatenate(([0.0], np.cumsum(length)))
        at = np.linspace(0.0, s[-1], max(200, int(s[-1] / 0.5)))
        points = np.stack([np.interp(at, s, way.points_ned_m[:, i]) for i in range(2)], axis=1)
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

    def _turns(self, along_rad: float) -> Sequence[float | None]:
        """Headings to end with, on the turns by which they may be reached; None = free."""
        goal = self._request.goal
        if goal.yaw_rad is None or self._gate is not None:
            return (None,)
        start = float(self._request.x0[YAW])
        nearest = unwrap_near(goal.yaw_rad, start)
        if abs(nearest - start) < BOTH_TURNS_RAD:
            return (nearest,)
        return (nearest, nearest + math.copysign(2.0 * math.pi, start - nearest))

    def refine(self, guess: Trajectory, rounds: int) -> Trajectory:
        """Solve, linearise anew around the solution, and so on; the last solution, solved or not."""
        request, trajectory = self._request, guess
        program = self._program(1.1 * float(guess.t_s[-1]))
        for _ in range(rounds):
            self._cancel.check()
            end_s, cost_j = float(trajectory.t_s[-1]), trajectory.cost_j if trajectory.solved else math.inf
            trajectory = program.solve(
                self._ask(trajectory, request), trajectory.x, trajectory.thrust_n, end_s, self._cancel
            )
            if not trajectory.solved:
                self._cancel.check()
                break
            if abs(trajectory.cost_j - cost_j) < SETTLED_SHARE * cost_j:
                break
        return trajectory

    def _ask(self, guess: Trajectory, request: Request) -> Ask:
        goal, x = request.goal, guess.x
        n = len(x) - 1
        normals, offsets = np.zeros((n + 1, PLANES, 2)), np.zeros((n + 1, PLANES))
        self._features.half_planes(
            np.vstack([x[:1, :2], x[:, :2]]),
            np.concatenate([[0.0], guess.t_s]),
            self._keep_m(guess.t_s, x[:, :2]),
            PLANES,
            normals,
            offsets,
        )
        gate = self._gate
        yaw_band = goal.accept_yaw_rad * YAW_SHARE if goal.yaw_rad is not None and gate is None else 1e3
        middle = float(x[-1, YAW]) if goal.yaw_rad is None else unwrap_near(goal.yaw_rad, float(x[-1, YAW]))
        place = np.asarray(goal.pos_ned_m, dtype=float)
        slope = self._end_slope
        if gate is not None:
            place = gate
            slope = self._to_go.slope(gate[:2], GATE_RADIUS_M)
        return Ask(
            x0=request.x0,
            goal_ned_m=place,
            radius_m=RADIUS_SHARE * goal.accept_radius_m if gate is None else GATE_RADIUS_M,
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
            longest_s=LONGER * float(guess.t_s[-1]) + LONGER_S,
        )

    def _planar_m_s(self, guess: Trajectory, request: Request) -> FloatArray:
        """(n + 1,) limit of the planar speed along a guess; one that begins faster is given the time to slow down."""
        x = guess.x
        way = np.gradient(x[:, :2], axis=0)
        way /= np.maximum(np.hypot(*way.T), 1e-9)[:, None]
        current = self._flow.current(x[:, :2])[:, :2]
        across = current[:, 0] * way[:, 1] - current[:, 1] * way[:, 0]
        limit = planar_limit_m_s(self._table, (current * way).sum(axis=1), across)
        slowing = float(np.hypot(request.x0[U], request.x0[V])) - SLOWING_M_S2 * guess.t_s
        result: FloatArray = np.maximum(np.minimum(limit, request.limits[0]), slowing)
        return result

    def _limits(self, guess: Trajectory, request: Request) -> FloatArray:
        """(n + 1, 4) limits of heave, yaw rate and depth; a vehicle that begins beyond one, or cannot stop before a
        depth, is given the time to."""
        depth, heave, turn = (float(request.x0[i]) for i in (Z, W, R))
        stop = 0.5 * heave * abs(heave) / SLOWING_M_S2
        limits = np.tile(request.limits[1:], (len(guess.t_s), 1))
        limits[:, 0] = np.maximum(limits[:, 0], abs(heave) - SLOWING_M_S2 * guess.t_s)
        limits[:, 1] = np.maximum(limits[:, 1], abs(turn) - SLOWING_RAD_S2 * guess.t_s)
        limits[:, 2] = np.minimum(limits[:, 2], depth + min(stop, 0.0))
        limits[:, 3] = np.maximum(limits[:, 3], depth + max(stop, 0.0))
        return limits

    def _keep_m(self, t_s: FloatArray, places: FloatArray) -> FloatArray:
        """(n + 1,) what a trajectory along places (n + 1, 2) keeps from boundaries: EXTRA_M beyond the radius, where
        the doors that it goes through, the goal and the place where it begins let it."""
        radius_m, features = self._request.radius_m, self._features
        if features.count == 0:
            return np.full(len(places), radius_m)
        at = np.arange(0.0, len(places) - 1.0 + 1e-9, 1.0 / LOOKS_BETWEEN)
        points = np.stack([np.interp(at, np.arange(len(places)), places[:, i]) for i in range(2)], axis=1)
        most = radius_m + self._request.extra_m
        for _ in range(DOOR_STEPS):
            points += features.push_out(points, most)
        doors_m = float(features.clearance_up_to_m(points, most).min())
        ends = np.stack([np.asarray(self._request.goal.pos_ned_m[:2], dtype=float), self._request.x0[:2]])
        goal_m, here_m = features.clearance_up_to_m(ends, most).tolist()
        least = max(radius_m, min(doors_m, radius_m + BETWEEN_M))
        result: FloatArray = np.clip(here_m + WIDENING_M_S * t_s, least, max(least, min(doors_m, goal_m)))
        return result

    def plan(self, trajectory: Trajectory) -> Plan:
        """The answer that a trajectory makes."""
        energy, eta = trajectory.energy_j, float(trajectory.t_s[-1])
        if self._gate is not None:
            way = self._to_go.way(self._gate[:2])
            if way is not None:
                energy += way.energy_j
                eta += float(self._timed(way)[1][-1])
        return Plan(
            goal=self._request.goal,
            trajectory=trajectory,
            energy_j=energy,
            eta_s=eta,
            complete=self._gate is None,
            flow=self._flow,
        )


def shifted(trajectory: Trajectory, by_s: float, x0: FloatArray) -> Trajectory:
    """What is left of a trajectory after ``by_s``, on INTERVALS intervals, from the state ``x0``."""
    n = INTERVALS
    t = np.linspace(min(by_s, 0.98 * float(trajectory.t_s[-1])), float(trajectory.t_s[-1]), n + 1)
    x = np.stack([np.interp(t, trajectory.t_s, column) for column in trajectory.x.T], axis=1)
    x[:, YAW] += unwrap_near(float(x[0, YAW]), float(x0[YAW])) - x[0, YAW]
    index = np.clip(np.searchsorted(trajectory.t_s, 0.5 * (t[1:] + t[:-1])) - 1, 0, len(trajectory.thrust_n) - 1)
    x[0] = x0
    return replace(trajectory, t_s=t - t[0], x=x, thrust_n=trajectory.thrust_n[index], solved=False)
