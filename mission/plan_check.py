"""Plan check as a pure function, run in the background because it takes a while."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain, islice
from types import MappingProxyType
from typing import Protocol

import numpy as np

from autopilot.core.background import Cancel
from autopilot.core.frames import FloatArray
from autopilot.core.geodesy import Origin
from autopilot.core.geometry import Fence
from autopilot.core.plan import MissionResult, PlanItem, PlanKind, PlanProblem, PlanRejection
from autopilot.mission.clearance import Clearance
from autopilot.mission.fence import FenceShape, build_fence, read_fence
from autopilot.mission.gaps import narrow_gaps
from autopilot.mission.items import GoTo, Order, Step, next_of
from autopilot.mission.mission_tuning import VALIDATION
from autopilot.mission.plan_model import PlanFile
from autopilot.mission.reach import FreeRegions, widest_m
from autopilot.mission.validation import (
    PlanContext,
    fence_problems,
    gap_text,
    joint_problems,
    mission_problems,
    order_problem,
    read_mission,
    read_rally,
    sequence_problems,
)

PLAN_PARAMETERS = (
    *("CIRCLE_RADIUS", "DEPTH_MAX", "DEPTH_MIN", "FENCE_GAP_CHK", "MPC_MARGIN", "SPD_PLANAR_MAX", "TKOFF_DEPTH"),
    "WP_ACCEPT_RADIUS",
)
"""Parameters that the plan check depends on."""

Plans3 = Mapping[PlanKind, tuple[PlanItem, ...]]
"""All three plans."""
EMPTY: Plans3 = MappingProxyType(dict.fromkeys(PlanKind, ()))


class CurrentCheck(Protocol):
    """Immutable check of workspaces against the known current (a current map has to cover them)."""

    def problem(self, fence: Fence, steps: Sequence[Step], origin: Origin) -> str:
        """Why nothing may be flown there, "" if it may."""
        ...

    def warning(self, fence: Fence, steps: Sequence[Step], limit_m_s: float) -> str:
        """Warning for a vehicle with this maximum speed, "" if none."""
        ...


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PlanCheckInputs:
    """Everything that an answer depends on."""

    plans: Plans3
    origin: Origin
    limits: tuple[float, ...]
    """Values of :data:`PLAN_PARAMETERS`."""
    radius_m: float
    goal_margin_m: float
    """Clearance beyond the radius that the controller keeps where it stays."""
    current_check: CurrentCheck | None = None

    def same(self, other: "PlanCheckInputs") -> bool:
        """Whether the answer to both is the same (plans are compared as objects)."""
        return self is other or (
            self.limits == other.limits
            and self.goal_margin_m == other.goal_margin_m
            and self.origin == other.origin
            and all(self.plans[kind] is other.plans[kind] for kind in PlanKind)
        )

    @property
    def context(self) -> PlanContext:
        params = dict(zip(PLAN_PARAMETERS, self.limits, strict=True))
        return PlanContext(origin=self.origin, params=params, radius_m=self.radius_m, goal_margin_m=self.goal_margin_m)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PlanVerdict:
    """Result: problems, and the plans in local metres."""

    question: PlanCheckInputs
    own: tuple[PlanProblem, ...] = ()
    """Problems of a plan by itself: it is refused, or (a parameter has changed since) not flown."""
    joint: tuple[PlanProblem, ...] = ()
    """Conflicts between the plans: they are stored, and not flown."""
    warnings: tuple[str, ...] = ()
    """Warnings: tolerated and reported."""
    steps: tuple[Step, ...] = ()
    shapes: tuple[FenceShape, ...] = ()
    regions: FreeRegions | None = None
    """Free space of the fence; None without a fence, or a mission in it."""
    region_of: Mapping[int, int] = field(default_factory=dict)
    """Item -> the region that its place is in."""
    goal_clearance_m: tuple[tuple[str, float], ...] = ()
    """Name and clearance [m] of every position of the mission, less the vehicle's radius."""
    widest_m: float = field(default=math.inf)
    """Clearance of the widest place of the workspace, less the vehicle's radius."""

    @property
    def problem(self) -> str:
        """The first reason not to fly, "" without any."""
        first = next(iter((*self.own, *self.joint)), None)
        return "" if first is None else first.reason

    def path_problem(self, pos_ned_m: FloatArray, first_seq: int) -> str:
        """Why a vehicle at ``pos_ned_m`` (3,) does not get to the first place from item ``first_seq`` on, "" if it
        does."""
        seq = next_of(self.steps, first_seq, self.region_of)
        if self.regions is None or seq is None or self.regions.of(pos_ned_m[:2]) == self.region_of[seq]:
            return ""
        keep_m = self.question.context.keep_m
        return (
            f"no free path from the vehicle to item {seq}: move the vehicle or open the fence (it keeps "
            f"{keep_m:.2f} m from every boundary)"
        )

    def refusal(self, kinds: Sequence[PlanKind]) -> PlanRejection | None:
        """The first thing that is wrong with these plans by themselves."""
        return next((problem for problem in self.own if problem.kind in kinds), None)


def judge(question: PlanCheckInputs, cancel: Cancel) -> PlanVerdict:
    """Check all plans. Raises :class:`autopilot.core.background.WithdrawnError` soon after ``cancel``."""
    check_cancel = cancel.check
    ctx, plans = question.context, question.plans
    steps, broken_steps = read_mission(plans[PlanKind.MISSION], ctx.origin)
    shapes, broken_shapes = read_fence(plans[PlanKind.FENCE], ctx.origin)
    rally, broken_points = read_rally(plans[PlanKind.RALLY], ctx.origin)
    own = tuple(
        PlanProblem(kind=kind, seq=p.seq, result=p.result, reason=p.reason)
        for kind, problems in (
            (PlanKind.MISSION, mission_problems(steps, broken_steps, ctx.params)),
            (PlanKind.FENCE, fence_problems(shapes, broken_shapes, ctx, check_cancel)),
            (PlanKind.RALLY, broken_points),
        )
        for p in chain(sequence_problems(kind, plans[kind]), problems)
    )
    check_cancel()
    if broken_steps or broken_shapes or broken_points:
        return PlanVerdict(question=question, own=own)
    joint, regions, region_of = joint_problems(steps, shapes, rally, ctx, check_cancel)
    check_cancel()
    fence = build_fence(shapes, ctx.params)
    warnings: list[str] = []
    if ctx.params["FENCE_GAP_CHK"]:
        gaps = narrow_gaps(shapes, 2.0 * ctx.radius_m, check_cancel)
        warnings += [gap_text(gap, ctx.radius_m) for gap in islice(gaps, VALIDATION.max_gaps)]
    check_cancel()
    if question.current_check is not None and (steps or shapes):
        reason = question.current_check.problem(fence, steps, ctx.origin)
        if reason:
            kind = PlanKind.FENCE if shapes else PlanKind.MISSION
            joint.append(PlanProblem(kind=kind, seq=0, result=MissionResult.INVALID, reason=reason))
        check_cancel()
        warning = question.current_check.warning(fence, steps, ctx.params["SPD_PLANAR_MAX"])
        warnings += [warning] if warning else []
    goals = [step for step in steps if isinstance(step, GoTo) and step.pos_ned_m is not None]
    places = np.array([step.pos_ned_m[:2] for step in goals if step.pos_ned_m is not None]).reshape(-1, 2)
    clearance = Clearance.of(fence).clearance_m(places) - ctx.radius_m
    return PlanVerdict(
        question=question,
        own=own,
        joint=tuple(joint),
        warnings=tuple(warnings),
        steps=steps,
        shapes=shapes,
        regions=regions,
        region_of=region_of,
        goal_clearance_m=tuple((f"item {step.seq}", float(c)) for step, c in zip(goals, clearance, strict=True)),
        widest_m=widest_m(fence) - ctx.radius_m,
    )


def judge_file(
    plan: PlanFile,
    origin: Origin,
    params: Mapping[str, float],
    *,
    radius_m: float,
    goal_margin_m: float,
    order_check: Callable[[Order], str] = lambda order: "",
) -> PlanVerdict:
    """All that is wrong with a plan file, each finding once. ``order_check``: why the vehicle has nothing that could
    carry out an order, "" when it has.
    """
    question = PlanCheckInputs(
        plans={kind: plan.items(kind) for kind in PlanKind},
        origin=origin,
        limits=tuple(params[name] for name in PLAN_PARAMETERS),
        radius_m=radius_m,
        goal_margin_m=goal_margin_m,
    )
    verdict = judge(question, Cancel())
    steps, _ = read_mission(question.plans[PlanKind.MISSION], origin)
    orders = [order_problem(step, order_check) for step in steps]
    lacks = [PlanProblem(kind=PlanKind.MISSION, seq=p.seq, result=p.result, reason=p.reason) for p in orders if p]
    return replace(verdict, own=(*verdict.own, *lacks))
