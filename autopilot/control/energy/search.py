"""From a request to a plan: paths over the energy field, both directions of turning, the best as a trajectory."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from autopilot.control.constraints.obstacles import Features, fence_key
from autopilot.control.energy.energy_tuning import FLOW, LEG_TASK, SEARCH, TRAJECTORY
from autopilot.control.energy.field import LONGEST_MOVE, EnergyField, EnergyToGo, FieldPath, alternative_paths
from autopilot.control.energy.flow import FlowField, FlowSamples, area_of
from autopilot.control.energy.leg_task import LegTask
from autopilot.control.energy.patience import Kind
from autopilot.control.energy.power import PowerModel, SpeedTable, speed_table
from autopilot.control.energy.request import Plan, TrajectoryRequest, no_plan
from autopilot.control.energy.trajectory import Program, Trajectory
from autopilot.core.background import Cancel
from autopilot.core.control_allocator import ControlAllocator
from autopilot.core.frames import FloatArray
from autopilot.core.free_space import Area, FreeSpace
from autopilot.core.geometry import Fence
from autopilot.core.messages import Goal
from autopilot.core.model4 import YAW, Model4, X, Y


class EnergyPlanner:
    """Keeps the built programs and the last features; otherwise a function of the request."""

    def __init__(self, model: Model4, power: PowerModel) -> None:
        self._power, self._allocator = power, ControlAllocator(model, power.thrust_w_n15)
        self._programs: dict[int, Program] = {}
        self._features: tuple[tuple[object, ...], Features] | None = None
        self._spaces: dict[int, tuple[Features, tuple[float, ...], FreeSpace]] = {}

    def warm(self) -> None:
        self._program(0.0)
        still = np.zeros((FLOW.least_samples, FLOW.least_samples, 3))
        still[0] = 1.0
        axis = np.arange(float(FLOW.least_samples))
        FlowField(FlowSamples(north_m=axis, east_m=axis, current_ned_m_s=still))

    def plan(self, request: TrajectoryRequest, cancel: Cancel | None = None) -> Plan:
        """See :class:`TrajectoryPlanner`. Ends with WithdrawnError soon after ``cancel`` is requested."""
        cancel = cancel or Cancel()
        cancel.check()
        features = self._features_of(request.fence)
        flow = FlowField(request.flow)
        self._allocator.buoyancy_excess_n = request.buoyancy_excess_n
        table = speed_table(self._allocator.model, self._power, float(request.limits[0]), request.cruise_m_s)
        found = self._field(request, features, flow, table)
        if found is None:
            return no_plan(request.goal, "no way")
        field, to_go, best = found
        cancel.check()
        following = request.goal.following
        beyond = None if following is None else field.to(np.asarray(following.pos_ned_m[:2], dtype=float))
        end_slope = _slope_beyond(beyond, request.goal)
        task = LegTask(request, features, flow, table, to_go, end_slope, self._program, self._allocator, cancel)
        task.guesses(best)
        # Trajectories that end at a gate get a new one.
        warm = None if request.warm is None or not task.complete else task.refine(request.warm, SEARCH.update_rounds)
        stays = warm is not None and warm.solved and task.energy_along(warm) < SEARCH.stay_within * best.energy_j
        if warm is not None and stays and request.kind is Kind.WARM:
            return task.plan(warm)
        if request.kind is Kind.QUICK:
            return task.first(best)
        candidates = [] if warm is None else [warm]
        for task.reach_s in (LEG_TASK.longest_s, *SEARCH.shorter_s):
            if task.reach_s < LEG_TASK.longest_s and task.ends_in_goal(best):
                continue
            candidates += self._candidates(task, field, to_go, best, features)
            solved = sorted((one for one in candidates if one.solved), key=lambda one: one.cost_j)
            if solved:
                break
        else:
            return no_plan(request.goal, f"none of {len(candidates)} trajectories solved")
        winner = solved[0]
        close: list[Trajectory] = []
        for one in solved:
            if one.cost_j < SEARCH.tie_within * winner.cost_j and not any(_alike(one, known) for known in close):
                close.append(one)
        del close[SEARCH.max_ties :]
        if len(close) > 1 and beyond is not None and task.complete:
            onward = self._onward(task, close, beyond)
            winner = close[int(np.argmin(onward))]
        if warm is not None and warm.solved and winner.cost_j > SEARCH.cheaper_fraction * warm.cost_j:
            return replace(task.plan(warm), stay=True)
        for one in [winner, *(one for one in solved if one is not winner)]:
            # Candidates are approximate; the selected one is solved to convergence before it is flown.
            polished = task.refine(replace(one, solved=False), LEG_TASK.polish_rounds)
            if polished.solved:
                return task.plan(polished)
        return no_plan(request.goal, f"none of {len(solved)} candidates solved to the end")

    def _field(
        self, request: TrajectoryRequest, features: Features, flow: FlowField, table: SpeedTable
    ) -> tuple[EnergyField, EnergyToGo, FieldPath] | None:
        """Field and minimum-energy path of a request; narrow passages only if there is no other path."""
        goal_at, start = np.asarray(request.goal.pos_ned_m[:2], dtype=float), request.x0[:2]
        places = [start, goal_at]
        if request.goal.following is not None:
            places.append(np.asarray(request.goal.following.pos_ned_m[:2], dtype=float))
        area = area_of(request.fence, np.stack(places))
        for index, extra_m in enumerate((SEARCH.comfort_m, 0.0) if features.count else (0.0,)):
            field = EnergyField(self._space_of(index, request.radius_m + extra_m, features, area), flow, table)
            to_go = field.to(goal_at)
            path = None if to_go is None else to_go.path(start)
            if to_go is not None and path is not None:
                return field, to_go, path
        return None

    def _candidates(
        self, task: LegTask, field: EnergyField, to_go: EnergyToGo, best: FieldPath, features: Features
    ) -> list[Trajectory]:
        """One trajectory per candidate path and direction of turning."""
        guesses = task.guesses(best)
        # Ways to other gates cannot be compared.
        others = alternative_paths(field, to_go, best, features, SEARCH.max_alternative_paths) if task.complete else []
        for path in others:
            if path.energy_j <= SEARCH.keep_within * best.energy_j:
                guesses += task.guesses(path)
        return [task.screened(guess) for guess in guesses]

    @staticmethod
    def _onward(task: LegTask, ends: Sequence[Trajectory], beyond: EnergyToGo) -> FloatArray:
        """(len(ends),) energy of each trajectory plus the next leg along its cheapest path, inf where none was found.

        Trajectories with different paths or turns differ more in the next leg than in themselves.
        """
        totals = np.full(len(ends), np.inf)
        for i, end in enumerate(ends):
            path = beyond.path(end.x[-1, :2])
            if path is None:
                continue
            after = task.following(end, beyond)
            legs = [leg for leg in map(after.screened, after.guesses(path)) if leg.solved]
            if legs:
                totals[i] = end.energy_j + min(leg.cost_j for leg in legs)
        return totals if np.isfinite(totals).any() else np.array([end.cost_j for end in ends])

    def _features_of(self, fence: Fence) -> Features:
        key = fence_key(fence)
        if self._features is None or self._features[0] != key:
            self._features = (key, Features(fence))
        return self._features[1]

    def _space_of(self, index: int, radius_m: float, features: Features, area: Area) -> FreeSpace:
        """The free space of a request; cached while only the current changes."""
        key = (radius_m, *area.low_m.tolist(), *area.high_m.tolist())
        kept = self._spaces.get(index)
        if kept is None or kept[0] is not features or kept[1] != key:
            kept = (features, key, FreeSpace(features, area, radius_m, long_moves=LONGEST_MOVE))
            self._spaces[index] = kept
        return kept[2]

    def _program(self, duration_s: float) -> Program:
        """The program whose RK4 steps are short enough for a trajectory of that duration."""
        need = duration_s / (LEG_TASK.intervals * TRAJECTORY.substep_s)
        substeps = next((s for s in SEARCH.substeps if s >= need), SEARCH.substeps[-1])
        if substeps not in self._programs:
            self._programs[substeps] = Program(self._allocator.model, self._power, LEG_TASK.intervals, substeps)
        return self._programs[substeps]


def _alike(one: Trajectory, other: Trajectory) -> bool:
    """Whether two trajectories to the same goal take the same path and the same turns."""
    return bool(np.abs(one.x[:, [X, Y, YAW]] - other.x[:, [X, Y, YAW]]).max() < SEARCH.alike)


def _slope_beyond(beyond: EnergyToGo | None, goal: Goal) -> FloatArray:
    """(2,) slope [J/m] at the goal of the energy that it takes to go on from there."""
    if beyond is None:
        return np.zeros(2)
    return beyond.slope(np.asarray(goal.pos_ned_m[:2], dtype=float), SEARCH.slope_reach_m)
