"""Is a plan fit to be flown? Items alone, the plan as a whole, and plan and fence against each other.

Every finding is a :class:`PlanRejection`: where, the MAV_MISSION_RESULT, and a line with what to do.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from autopilot.core.plan import MAX_ITEMS, MissionResult, PlanItem, PlanKind, PlanRejection
from mission.decode import ItemRefusedError, depth_m, horizontal_ned_m, parse_step, refuse
from mission.fence import FenceShape, build_fence, check_fence_item, read_fence
from mission.gaps import Gap, narrow_gaps
from mission.geodesy import Origin
from mission.items import ChangeSpeed, Command, GoTo, Jump, ReturnHome, SetHome, Step, Surface, Wait
from mission.plan_model import PlanFile
from mission.reach import free_regions
from mission.shapes import clearance_m

DEPTH_TOLERANCE_M = 1e-3
"""Altitudes arrive as 32-bit floats."""
PLACE_TOLERANCE_M = 0.012
"""Rounding of a waypoint and of a fence point to 1e-7 degrees (11 mm) together."""
APPROACH_SHARE = 0.6
"""The controller keeps MPC_MARGIN beyond the body radius, so that a place nearer to a boundary is only approached: what
is missing may be this share of the acceptance radius (two walls at once make it 1.41 times as much) ..."""
APPROACH_M = 0.15
"""... and no more than this, beyond which the route planner does not look for free ground round a goal."""
PASSAGE_M = 2.5e-3
"""A passage has to have this much more than the controller keeps on both sides, for the route planner to find it. What
is narrower is refused here: the controller would not enter it."""
RALLY_LABEL = "rally point"


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanContext:
    """What plans are judged by."""

    origin: Origin
    params: Mapping[str, float]
    radius_m: float
    """Ball round the vehicle's centre that covers it."""

    @property
    def keep_m(self) -> float:
        """What the controller keeps from every boundary."""
        return self.radius_m + self.params["MPC_MARGIN"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Conflict:
    """A step of the mission that the fence forbids."""

    step_seq: int
    fence_seq: int
    text: str
    """From the step's point of view."""


def check_item(kind: PlanKind, item: PlanItem, origin: Origin) -> PlanRejection | None:
    """The cheap check of one item as it arrives: command, frame, ranges, finite numbers, under the surface."""
    if item.seq >= MAX_ITEMS:
        return _too_many(kind, item.seq + 1)
    if kind is PlanKind.FENCE:
        return check_fence_item(item, origin)
    try:
        if kind is PlanKind.MISSION:
            parse_step(item, origin)
        else:
            _rally_position(item, origin)
    except ItemRefusedError as error:
        return error.rejection
    return None


def _rally_position(item: PlanItem, origin: Origin) -> tuple[float, float]:
    if item.command != Command.RALLY_POINT:
        text = f"command {item.command} is not supported among rally points; use 5100"
        raise refuse(item, MissionResult.UNSUPPORTED, text, RALLY_LABEL)
    position = horizontal_ned_m(item, origin, RALLY_LABEL)
    depth_m(item, origin, RALLY_LABEL)
    return position


def _too_many(kind: PlanKind, count: int) -> PlanRejection:
    text = f"{kind.name.lower()}: {count} items are too many, {MAX_ITEMS} fit; split or thin out the plan"
    return PlanRejection(seq=MAX_ITEMS, result=MissionResult.NO_SPACE, reason=text)


def sequence_problems(kind: PlanKind, items: Sequence[PlanItem]) -> Iterator[PlanRejection]:
    """Too many items, or numbers that are not 0, 1, 2, ..."""
    if len(items) > MAX_ITEMS:
        yield _too_many(kind, len(items))
    for index, item in enumerate(items):
        if item.seq != index:
            text = f"{kind.name.lower()}: item {item.seq} stands at place {index}; number the items from 0 without gaps"
            yield PlanRejection(seq=item.seq, result=MissionResult.INVALID_SEQUENCE, reason=text)
            return


def mission_problems(items: Sequence[PlanItem], ctx: PlanContext) -> Iterator[PlanRejection]:
    """What is wrong with a mission by itself."""
    yield from sequence_problems(PlanKind.MISSION, items)
    steps: list[Step] = []
    broken = False
    for item in items:
        try:
            steps.append(parse_step(item, ctx.origin))
        except ItemRefusedError as error:
            broken = True
            yield error.rejection
    for step in steps:
        yield from _limit_problems(step, ctx.params)
    if not broken:
        yield from _jump_problems(steps)


def _limit_problems(step: Step, params: Mapping[str, float]) -> Iterator[PlanRejection]:
    """Depth band and speed limit of the parameters."""
    if isinstance(step, GoTo) and step.pos_ned_m is not None:
        depth, low, high = float(step.pos_ned_m[2]), params["DEPTH_MIN"], params["DEPTH_MAX"]
        if not low - DEPTH_TOLERANCE_M <= depth <= high + DEPTH_TOLERANCE_M:
            bound = f"DEPTH_MIN {low:g}" if depth < low else f"DEPTH_MAX {high:g}"
            text = (
                f"item {step.seq}: depth {depth:.2f} m (altitude {-depth:.2f}) is outside the depth band, {bound} m; "
                f"use {low:g} to {high:g} m of depth or change the parameter"
            )
            yield PlanRejection(seq=step.seq, result=MissionResult.INVALID_PARAM7, reason=text)
    if isinstance(step, ChangeSpeed) and step.speed_m_s is not None:
        limit = params["SPD_PLANAR_MAX"]
        if step.speed_m_s > limit + 1e-6:
            text = f"item {step.seq}: speed {step.speed_m_s:g} m/s is above SPD_PLANAR_MAX {limit:g}; ask for less"
            yield PlanRejection(seq=step.seq, result=MissionResult.INVALID_PARAM2, reason=text)


def _jump_problems(steps: Sequence[Step]) -> Iterator[PlanRejection]:
    """Jumps out of the plan, and endless loops in which nothing takes time."""
    for step in steps:
        if isinstance(step, Jump) and step.target_seq >= len(steps):
            text = f"item {step.seq}: jump target {step.target_seq} does not exist; use 0 to {len(steps) - 1}"
            yield PlanRejection(seq=step.seq, result=MissionResult.INVALID_PARAM1, reason=text)
            return
    for step in steps:
        if isinstance(step, Jump) and step.count is None and _spins(steps, step):
            text = (
                f"item {step.seq}: jumps to item {step.target_seq} for ever without a waypoint in between; "
                "put a waypoint into the loop or limit the count (param2)"
            )
            yield PlanRejection(seq=step.seq, result=MissionResult.INVALID, reason=text)


def _takes_time(step: Step) -> bool:
    if isinstance(step, Wait):
        return step.duration_s > 0.0
    return isinstance(step, GoTo | Surface | ReturnHome)


def _spins(steps: Sequence[Step], start: Jump) -> bool:
    """Whether the walk from an endless jump comes back to it with nothing on the way that takes time."""
    cursor = start.target_seq
    for _ in range(len(steps)):
        if cursor == start.seq:
            return True
        if cursor >= len(steps) or _takes_time(steps[cursor]):
            return False
        step = steps[cursor]
        cursor = step.target_seq if isinstance(step, Jump) and step.count is None else cursor + 1
    return False


def fence_problems(items: Sequence[PlanItem], ctx: PlanContext) -> Iterator[PlanRejection]:
    """What is wrong with a fence by itself."""
    yield from sequence_problems(PlanKind.FENCE, items)
    shapes, problems = read_fence(items, ctx.origin)
    yield from problems
    if ctx.params["FENCE_GAP_CHK"]:
        yield from (_gap_rejection(gap, ctx.radius_m) for gap in narrow_gaps(shapes, 2.0 * ctx.radius_m))
    fence = build_fence(shapes, ctx.params)
    if fence.inclusions and free_regions(fence, np.zeros((0, 2)), ctx.keep_m - PLACE_TOLERANCE_M) is None:
        first = next(s for s in shapes if s.inclusion)
        text = (
            f"fence item {first.seq}: the workspace has no room for the vehicle, which keeps {ctx.keep_m:g} m from "
            "every boundary; make it larger or remove exclusions"
        )
        yield PlanRejection(seq=first.seq, result=MissionResult.INVALID, reason=text)


def gap_text(gap: Gap, radius_m: float) -> str:
    """One line about a narrow gap."""
    north, east = gap.middle_ned_m
    return (
        f"fence item {gap.second.seq}: the gap of {gap.width_m:.2f} m at north {north:.2f}, east {east:.2f} m to "
        f"{gap.first.name} is narrower than the vehicle ({2.0 * radius_m:.2f} m); widen or close it"
    )


def _gap_rejection(gap: Gap, radius_m: float) -> PlanRejection:
    text = gap_text(gap, radius_m) + ", or set FENCE_GAP_CHK to 0"
    return PlanRejection(seq=gap.second.seq, result=MissionResult.INVALID, reason=text)


def rally_problems(
    items: Sequence[PlanItem], shapes: Sequence[FenceShape], ctx: PlanContext
) -> Iterator[PlanRejection]:
    """What is wrong with rally points, by themselves and against the fence."""
    yield from sequence_problems(PlanKind.RALLY, items)
    for item in items:
        try:
            point = _rally_position(item, ctx.origin)
        except ItemRefusedError as error:
            yield error.rejection
            continue
        name = f"{RALLY_LABEL} {item.seq}"
        place = _Place(seq=item.seq, name=name, north_m=point[0], east_m=point[1], need_m=ctx.radius_m)
        for conflict in _place_conflicts([place], shapes):
            yield PlanRejection(seq=item.seq, result=MissionResult.INVALID_PARAM5_X, reason=conflict.text)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Place:
    """A point of a plan that has to be free."""

    seq: int
    name: str
    """For the operator: "item 3: waypoint"."""
    north_m: float
    east_m: float
    need_m: float
    """Distance from every boundary that it has to have."""


def conflicts(steps: Sequence[Step], shapes: Sequence[FenceShape], ctx: PlanContext) -> Iterator[Conflict]:
    """Steps whose place the fence forbids; if there is none, legs without a free path."""
    places: list[_Place] = []
    route: list[_Place] = []
    for step in steps:
        if isinstance(step, GoTo | Surface | SetHome) and step.pos_ned_m is not None:
            name = "home" if isinstance(step, SetHome) else "waypoint"
            north, east = float(step.pos_ned_m[0]), float(step.pos_ned_m[1])
            name = f"item {step.seq}: {name}"
            need_m = _room_needed_m(step, ctx)
            place = _Place(seq=step.seq, name=name, north_m=north, east_m=east, need_m=need_m)
            places.append(place)
            if not isinstance(step, SetHome):
                route.append(place)
    if not places or not shapes:
        return
    found = _place_conflicts(places, shapes)
    yield from found
    if not found and route:
        yield from _path_conflicts(route, shapes, ctx)


def _room_needed_m(step: GoTo | Surface | SetHome, ctx: PlanContext) -> float:
    """How far from every boundary a place has to be: no contact, and near enough to where the controller gets."""
    accept_m = step.accept_radius_m if isinstance(step, GoTo) else None
    if accept_m is None:
        accept_m = ctx.params["WP_ACCEPT_RADIUS"]
    return max(ctx.radius_m, ctx.keep_m - min(APPROACH_SHARE * accept_m, APPROACH_M))


def _place_conflicts(places: Sequence[_Place], shapes: Sequence[FenceShape]) -> list[Conflict]:
    """Places in an inflated obstacle or outside the shrunk workspace, in the order of the plan."""
    if not shapes:
        return []
    points = np.array([(p.north_m, p.east_m) for p in places]).reshape(-1, 2)
    signs = np.array([-1.0 if s.inclusion else 1.0 for s in shapes])
    room = np.array([clearance_m(s.shape, points) for s in shapes]).reshape(len(shapes), -1) * signs[:, None]
    need_m = np.array([p.need_m for p in places])
    bad = np.argwhere((room < need_m - PLACE_TOLERANCE_M).T)
    return [_place_conflict(places[i], shapes[k], float(room[k, i])) for i, k in bad]


def _place_conflict(place: _Place, shape: FenceShape, room_m: float) -> Conflict:
    """One line about a place that has ``room_m`` between itself and a boundary, less than it needs."""
    if shape.inclusion:
        state = f"{-room_m:.2f} m outside" if room_m < 0.0 else f"only {room_m:.2f} m inside"
    else:
        state = f"{-room_m:.2f} m inside" if room_m < 0.0 else f"only {room_m:.2f} m from"
    text = (
        f"{place.name} at north {place.north_m:.2f}, east {place.east_m:.2f} m is {state} {shape.name}; "
        f"the vehicle keeps {place.need_m:.2f} m, move it by {place.need_m - room_m:.2f} m"
    )
    return Conflict(step_seq=place.seq, fence_seq=shape.seq, text=text)


def _path_conflicts(route: Sequence[_Place], shapes: Sequence[FenceShape], ctx: PlanContext) -> Iterator[Conflict]:
    """Neighbours in the order of the plan that stand in different parts of the free space."""
    fence = build_fence(shapes, ctx.params)
    points = np.array([(p.north_m, p.east_m) for p in route])
    regions = free_regions(fence, points, ctx.keep_m + PASSAGE_M)
    if regions is None:
        regions = (0,) * len(route)
    for before, after, a, b in zip(regions, regions[1:], route, route[1:], strict=False):
        if before != after:
            text = (
                f"item {b.seq}: no free path from item {a.seq} to item {b.seq} for a vehicle that keeps "
                f"{ctx.keep_m:.2f} m from every boundary; move the waypoint or open the fence"
            )
            yield Conflict(step_seq=b.seq, fence_seq=shapes[0].seq, text=text)


def mission_conflict(conflict: Conflict) -> PlanRejection:
    """The answer when the mission comes second."""
    return PlanRejection(seq=conflict.step_seq, result=MissionResult.INVALID_PARAM5_X, reason=conflict.text)


def fence_conflict(conflict: Conflict) -> PlanRejection:
    """The answer when the fence comes second."""
    text = f"fence item {conflict.fence_seq} forbids the mission in force, {conflict.text}; or clear the mission first"
    return PlanRejection(seq=conflict.fence_seq, result=MissionResult.INVALID, reason=text)


def plan_problems(
    kind: PlanKind, plans: Mapping[PlanKind, tuple[PlanItem, ...]], ctx: PlanContext
) -> Iterator[PlanRejection]:
    """All that is wrong with the plan of one kind, by itself and against the others."""
    items = plans[kind]
    if not items:
        return
    if kind is PlanKind.MISSION:
        found = list(mission_problems(items, ctx))
        yield from found
        if not found:
            steps = [parse_step(item, ctx.origin) for item in items]
            shapes = read_fence(plans[PlanKind.FENCE], ctx.origin)[0]
            yield from map(mission_conflict, conflicts(steps, shapes, ctx))
    elif kind is PlanKind.RALLY:
        yield from rally_problems(items, read_fence(plans[PlanKind.FENCE], ctx.origin)[0], ctx)
    else:
        found = list(fence_problems(items, ctx))
        yield from found
        if not found:
            yield from _fence_against_others(plans, ctx)


def _fence_against_others(plans: Mapping[PlanKind, tuple[PlanItem, ...]], ctx: PlanContext) -> Iterator[PlanRejection]:
    shapes = read_fence(plans[PlanKind.FENCE], ctx.origin)[0]
    steps = [parse_step(item, ctx.origin) for item in plans[PlanKind.MISSION]]
    yield from map(fence_conflict, conflicts(steps, shapes, ctx))
    for rejection in rally_problems(plans[PlanKind.RALLY], shapes, ctx):
        text = f"fence forbids a rally point in force: {rejection.reason}; or clear the rally points first"
        yield PlanRejection(seq=0, result=rejection.result, reason=text)


def file_problems(plan: PlanFile, ctx: PlanContext) -> Iterator[tuple[PlanKind, PlanRejection]]:
    """All that is wrong with a plan file, each finding once."""
    plans = {kind: plan.items(kind) for kind in PlanKind}
    alone = {PlanKind.FENCE: plans[PlanKind.FENCE]}
    for kind in PlanKind:
        against = {**dict.fromkeys(PlanKind, ()), **alone} if kind is PlanKind.FENCE else plans
        yield from ((kind, problem) for problem in plan_problems(kind, against, ctx))
