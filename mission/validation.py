"""Plan validation: single items, a plan as a whole, and the plans against each other.

Problems of a plan by itself (:func:`sequence_problems`, :func:`mission_problems`, :func:`fence_problems`) refuse
it. Conflicts between plans (:func:`joint_problems`) do not, because operators send plans one after the other: they
forbid flying. Every finding is a :class:`PlanRejection`: item, MAV_MISSION_RESULT, and a line whose first 75
characters give problem and remedy (ground stations cut at 100).
"""

from bisect import bisect_left
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from autopilot.core.frames import FloatArray
from autopilot.core.geodesy import Origin
from autopilot.core.plan import MAX_ITEMS, MissionResult, PlanItem, PlanKind, PlanProblem, PlanRejection
from autopilot.mission.circling import worst_on_ring
from autopilot.mission.clearance import Clearance
from autopilot.mission.decode import ItemRefusedError, depth_m, horizontal_ned_m, refuse
from autopilot.mission.fence import FenceShape, build_fence, check_fence_item
from autopilot.mission.gaps import NarrowPassage, narrow_gaps
from autopilot.mission.item_types import parse_step
from autopilot.mission.items import (
    ChangeSpeed,
    Command,
    GoTo,
    Jump,
    LoiterTurns,
    Near,
    Order,
    ReturnHome,
    SetHome,
    Step,
    Surface,
    Travel,
    Wait,
    legs,
)
from autopilot.mission.mission_tuning import VALIDATION
from autopilot.mission.reach import FreeRegions, has_free_space

RALLY_LABEL = "rally point"


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanContext:
    """Origin, parameters and size of the vehicle that plans are checked against."""

    origin: Origin
    params: Mapping[str, float]
    radius_m: float
    """Ball round the vehicle's centre that covers it."""
    goal_margin_m: float
    """Clearance beyond it that the controller keeps where it stays."""

    @property
    def keep_m(self) -> float:
        """Distance of a route from every boundary."""
        return self.radius_m + self.params["MPC_MARGIN"]


def check_item(kind: PlanKind, item: PlanItem, origin: Origin) -> PlanRejection | None:
    """The cheap check of one item as it arrives: command, frame, ranges, finite numbers, under the surface."""
    if item.seq > MAX_ITEMS[kind]:
        return _too_many(kind, item.seq)
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


def order_problem(step: Step, order_check: Callable[[Order], str]) -> PlanRejection | None:
    """A payload item that the vehicle has nothing for; ``order_check``: why, "" if it has."""
    why = order_check(step) if isinstance(step, Order) else ""
    text = f"item {step.seq}: {why}"
    return PlanRejection(seq=step.seq, result=MissionResult.UNSUPPORTED, reason=text) if why else None


def _rally_position(item: PlanItem, origin: Origin) -> tuple[float, float]:
    if item.command != Command.RALLY_POINT:
        text = f"command {item.command} is not supported among rally points; use 5100"
        raise refuse(item, MissionResult.UNSUPPORTED, text, RALLY_LABEL)
    position = horizontal_ned_m(item, origin, RALLY_LABEL)
    depth_m(item, origin, RALLY_LABEL)
    return position


def _too_many(kind: PlanKind, count: int) -> PlanRejection:
    text = f"{kind.name.lower()}: {count} items are too many, {MAX_ITEMS[kind]} fit; split or thin out the plan"
    return PlanRejection(seq=MAX_ITEMS[kind], result=MissionResult.NO_SPACE, reason=text)


def sequence_problems(kind: PlanKind, items: Sequence[PlanItem]) -> Iterator[PlanRejection]:
    """Too many items, or numbers that are not 0, 1, 2, ..."""
    count = len(items) - sum(item.is_home for item in items[:1])
    if count > MAX_ITEMS[kind]:
        yield _too_many(kind, count)
    for index, item in enumerate(items):
        if item.seq != index:
            text = f"{kind.name.lower()} item {item.seq} stands at place {index}; number the items from 0 without gaps"
            yield PlanRejection(seq=item.seq, result=MissionResult.INVALID_SEQUENCE, reason=text)
            return


def mission_problems(
    steps: Sequence[Step], broken: Sequence[PlanRejection], params: Mapping[str, float]
) -> Iterator[PlanRejection]:
    """Problems of a mission by itself, as parsed."""
    yield from broken
    for step in steps:
        yield from _limit_problems(step, params)
    if not broken:
        yield from _jump_problems(steps)
        yield from _order_problems(steps)


def read_mission(items: Sequence[PlanItem], origin: Origin) -> tuple[tuple[Step, ...], tuple[PlanRejection, ...]]:
    """All steps that can be read, and all that is wrong with the others."""
    steps: list[Step] = []
    broken: list[PlanRejection] = []
    for item in items:
        try:
            steps.append(parse_step(item, origin))
        except ItemRefusedError as error:
            broken.append(error.rejection)
    return tuple(steps), tuple(broken)


def _limit_problems(step: Step, params: Mapping[str, float]) -> Iterator[PlanRejection]:
    """Depth band and speed limit of the parameters."""
    depth = _depth_of(step, params)
    if depth is not None:
        low, high = params["DEPTH_MIN"], params["DEPTH_MAX"]
        if not low - VALIDATION.depth_tolerance_m <= depth <= high + VALIDATION.depth_tolerance_m:
            bound = f"DEPTH_MIN {low:g}" if depth < low else f"DEPTH_MAX {high:g}"
            text = (
                f"item {step.seq}: depth {depth:.2f} m, {bound} m: use {low:g} to {high:g} m or change the parameter "
                f"(altitude {-depth:.2f} is outside the depth band)"
            )
            yield PlanRejection(seq=step.seq, result=MissionResult.INVALID_PARAM7, reason=text)
    if isinstance(step, ChangeSpeed) and step.speed_m_s is not None:
        limit = params["SPD_PLANAR_MAX"]
        if step.speed_m_s > limit + 1e-6:
            text = f"item {step.seq}: speed {step.speed_m_s:g} m/s is above SPD_PLANAR_MAX {limit:g}; ask for less"
            yield PlanRejection(seq=step.seq, result=MissionResult.INVALID_PARAM2, reason=text)


def _depth_of(step: Step, params: Mapping[str, float]) -> float | None:
    """Depth [m] of a step, None when it is unknown, or does not count."""
    if isinstance(step, GoTo) and step.dives:
        return params["TKOFF_DEPTH"] if step.dive_m is None else step.dive_m
    place = step.pos_ned_m if isinstance(step, GoTo) else step.centre_ned_m if isinstance(step, LoiterTurns) else None
    return None if place is None else float(place[2])


def _order_problems(steps: Sequence[Step]) -> Iterator[PlanRejection]:
    """Conditions on the path to a waypoint that no waypoint follows."""
    goes_on = False
    for step in reversed(steps):
        if isinstance(step, Near) and not goes_on:
            text = f"item {step.seq}: no place comes after this condition; put it before a waypoint"
            yield PlanRejection(seq=step.seq, result=MissionResult.INVALID, reason=text)
        goes_on |= isinstance(step, Travel | LoiterTurns | Jump)


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
                f"item {step.seq}: jumps to item {step.target_seq} for ever; "
                "put a waypoint in between, or limit the count (param2)"
            )
            yield PlanRejection(seq=step.seq, result=MissionResult.INVALID, reason=text)


def _takes_time(step: Step) -> bool:
    if isinstance(step, Wait):
        return step.duration_s > 0.0
    return isinstance(step, Travel | LoiterTurns)


def _spins(steps: Sequence[Step], start: Jump) -> bool:
    """Whether the mission loops endlessly without an item that takes time."""
    cursor = start.target_seq
    for _ in range(len(steps)):
        if cursor == start.seq:
            return True
        if cursor >= len(steps) or _takes_time(steps[cursor]):
            return False
        step = steps[cursor]
        cursor = step.target_seq if isinstance(step, Jump) and step.count is None else cursor + 1
    return False


def fence_problems(
    shapes: Sequence[FenceShape],
    broken: Sequence[PlanRejection],
    ctx: PlanContext,
    check_cancel: Callable[[], None] = lambda: None,
) -> Iterator[PlanRejection]:
    """Problems of a fence by itself, as parsed."""
    yield from broken
    fence = build_fence(shapes, ctx.params)
    if fence.inclusions and not has_free_space(fence, ctx.keep_m - VALIDATION.place_tolerance_m, check_cancel):
        first = next(s for s in shapes if s.inclusion)
        text = (
            f"fence item {first.seq}: no room for the vehicle, which keeps {ctx.keep_m:g} m: enlarge it or remove "
            "exclusions"
        )
        yield PlanRejection(seq=first.seq, result=MissionResult.INVALID, reason=text)


def gap_text(gap: NarrowPassage, radius_m: float) -> str:
    """One line about a narrow gap that no leg needs."""
    north, east = gap.middle_ned_m
    return (
        f"fence item {gap.second.seq}: gap of {gap.width_m:.2f} m to fence item {gap.first.seq}, vehicle is "
        f"{2.0 * radius_m:.2f} m: it does not pass there (at north {north:z.2f}, east {east:z.2f} m)"
    )


def read_rally(
    items: Sequence[PlanItem], origin: Origin
) -> tuple[tuple[tuple[int, float, float], ...], tuple[PlanRejection, ...]]:
    """Number, north and east [m] of all rally points that can be read, and all that is wrong with the others."""
    points: list[tuple[int, float, float]] = []
    broken: list[PlanRejection] = []
    for item in items:
        try:
            points.append((item.seq, *_rally_position(item, origin)))
        except ItemRefusedError as error:
            broken.append(error.rejection)
    return tuple(points), tuple(broken)


@dataclass(frozen=True, slots=True, kw_only=True)
class _PointToClear:
    """A point of a plan that has to be free."""

    kind: PlanKind
    seq: int
    name: str
    """For the operator: "item 3"."""
    north_m: float
    east_m: float
    need_m: float
    """Distance from every boundary that it has to have."""


def joint_problems(
    steps: Sequence[Step],
    shapes: Sequence[FenceShape],
    rally: Sequence[tuple[int, float, float]],
    ctx: PlanContext,
    check_cancel: Callable[[], None] = lambda: None,
) -> tuple[list[PlanProblem], FreeRegions | None, dict[int, int]]:
    """Conflicts of mission and rally points with the fence: positions; if there are none, legs without a free path.
    With them the free space of a mission whose positions are free, and the region of every item with a place.
    """
    if not shapes:
        return [], None, {}
    places: list[_PointToClear] = []
    route: list[_PointToClear] = []
    for ring in _ring_places(tuple(_circles(steps)), shapes, ctx, check_cancel):
        places.append(ring)
        route.append(ring)
    home: _PointToClear | None = None
    for step in steps:
        if isinstance(step, ReturnHome) and home is not None:
            route.append(replace(home, seq=step.seq, name=f"item {step.seq}"))
        elif isinstance(step, SetHome) and step.pos_ned_m is None:
            home = None
        elif isinstance(step, GoTo | Surface | SetHome) and step.pos_ned_m is not None:
            place = _PointToClear(
                kind=PlanKind.MISSION,
                seq=step.seq,
                name=f"home of item {step.seq}" if isinstance(step, SetHome) else f"item {step.seq}",
                north_m=float(step.pos_ned_m[0]),
                east_m=float(step.pos_ned_m[1]),
                need_m=_clearance_needed_m(step, ctx),
            )
            places.append(place)
            if isinstance(step, SetHome):
                home = place
            else:
                route.append(place)
    route.sort(key=lambda place: place.seq)
    places.sort(key=lambda place: place.seq)
    found = _place_conflicts(places, shapes)
    check_cancel()
    regions, region_of = None, dict[int, int]()
    if not found and route:
        keep_m = ctx.keep_m + VALIDATION.passage_m
        points = np.array([(p.north_m, p.east_m) for p in route])
        regions = FreeRegions(build_fence(shapes, ctx.params), points, keep_m, check_cancel)
        region_of = dict(zip((p.seq for p in route), regions.of_points, strict=True))
        found += _path_conflicts(steps, route, regions, shapes, ctx, check_cancel)
    check_cancel()
    refuges = [
        _PointToClear(
            kind=PlanKind.RALLY,
            seq=seq,
            name=f"{RALLY_LABEL} {seq}",
            north_m=north,
            east_m=east,
            need_m=ctx.radius_m,
        )
        for seq, north, east in rally
    ]
    return found + _place_conflicts(refuges, shapes), regions, region_of


def _circles(steps: Sequence[Step]) -> Iterator[tuple[LoiterTurns, FloatArray]]:
    """All circles with a known centre (3,): their own, or the preceding position in the plan."""
    last: FloatArray | None = None
    for step in steps:
        if isinstance(step, LoiterTurns):
            if step.centre_ned_m is not None:
                last = step.centre_ned_m
            if last is not None:
                yield step, last
            last = None  # where it ends is not known
        elif isinstance(step, GoTo | Surface):
            last = step.pos_ned_m


def _ring_places(
    circles: Sequence[tuple[LoiterTurns, FloatArray]],
    shapes: Sequence[FenceShape],
    ctx: PlanContext,
    check_cancel: Callable[[], None],
) -> Iterator[_PointToClear]:
    """The point of least clearance of each circle, or any when the whole circle is free."""
    if not circles:
        return
    need_m = ctx.keep_m - VALIDATION.place_tolerance_m
    both = [(s.shape, s.inclusion) for s in shapes]
    from_centre = Clearance(both).of_shapes_m(np.array([centre[:2] for _, centre in circles]))
    for (step, centre), away in zip(circles, from_centre, strict=True):
        radius_m = ctx.params["CIRCLE_RADIUS"] if step.radius_m is None else step.radius_m
        within = np.flatnonzero(away < radius_m + need_m)
        boundaries, middle = Clearance([both[i] for i in within.tolist()]), (float(centre[0]), float(centre[1]))
        worst = worst_on_ring(boundaries, middle, radius_m, need_m) if len(within) else None
        north, east = (middle[0] + radius_m, middle[1]) if worst is None else worst.tolist()
        check_cancel()
        yield _PointToClear(
            kind=PlanKind.MISSION,
            seq=step.seq,
            name=f"circle of item {step.seq}",
            north_m=north,
            east_m=east,
            need_m=ctx.keep_m,
        )


def _clearance_needed_m(step: GoTo | Surface | SetHome, ctx: PlanContext) -> float:
    """Clearance required of a position: no contact, and within reach of the controller."""
    accept_m = step.accept_radius_m if isinstance(step, GoTo) else None
    if accept_m is None:
        accept_m = ctx.params["WP_ACCEPT_RADIUS"]
    short_m = min(VALIDATION.approach_fraction * accept_m, VALIDATION.approach_m)
    return ctx.radius_m + max(0.0, ctx.goal_margin_m - short_m)


def _place_conflicts(places: Sequence[_PointToClear], shapes: Sequence[FenceShape]) -> list[PlanProblem]:
    """Positions in an inflated obstacle or outside the shrunk workspace, in the order of the plan, each with its
    worst.
    """
    if not places:
        return []
    points = np.array([(p.north_m, p.east_m) for p in places])
    clearances = Clearance([(s.shape, s.inclusion) for s in shapes]).of_shapes_m(points)
    need_m = np.array([p.need_m for p in places])
    worst = np.argmin(clearances, axis=1)
    least = clearances[np.arange(len(places)), worst]
    bad = np.flatnonzero(least < need_m - VALIDATION.place_tolerance_m)
    return [_place_conflict(places[i], shapes[int(worst[i])], float(least[i])) for i in bad.tolist()]


def _place_conflict(place: _PointToClear, shape: FenceShape, clearance_m: float) -> PlanProblem:
    """One line about a position with clearance ``clearance_m``, less than it needs."""
    if shape.inclusion:
        state = f"{-clearance_m:.2f} m outside" if clearance_m < 0.0 else f"only {clearance_m:.2f} m inside"
    else:
        state = f"{-clearance_m:.2f} m inside" if clearance_m < 0.0 else f"only {clearance_m:.2f} m from"
    text = (
        f"{place.name} is {state} {shape.name}: move it {place.need_m - clearance_m:.2f} m "
        f"(at north {place.north_m:.2f}, east {place.east_m:.2f} m; the vehicle keeps {place.need_m:.2f} m)"
    )
    return PlanProblem(kind=place.kind, seq=place.seq, result=MissionResult.INVALID_PARAM5_X, reason=text)


def _path_conflicts(
    steps: Sequence[Step],
    route: Sequence[_PointToClear],
    regions: FreeRegions,
    shapes: Sequence[FenceShape],
    ctx: PlanContext,
    check_cancel: Callable[[], None],
) -> Iterator[PlanProblem]:
    """Places flown one after the other that stand in different parts of the free space; the first ones with the gap
    that would have to be wider.
    """
    part = dict(zip((place.seq for place in route), regions.of_points, strict=True))
    place_of = {place.seq: place for place in route}
    apart = [(place_of[a], place_of[b]) for a, b in legs(steps, part) if part[a] != part[b]]
    needed_m = 2.0 * (ctx.keep_m + VALIDATION.passage_m)
    every = narrow_gaps(shapes, needed_m, check_cancel, pockets=True) if apart else iter(())
    gaps = sorted(islice(every, VALIDATION.max_candidates), key=lambda gap: -gap.width_m)
    for number, (a, b) in enumerate(apart):
        gap = _bottleneck(a, b, gaps, shapes, ctx, check_cancel) if number < VALIDATION.max_bottlenecks else None
        if gap is None:
            remedy = f"move item {b.seq} or open the fence (the vehicle keeps {ctx.keep_m:.2f} m from every boundary)"
        else:
            north, east = gap.middle_ned_m
            remedy = (
                f"widen the gap of fence items {gap.first.seq} and {gap.second.seq} ({gap.width_m:.2f} m, needs "
                f"{needed_m:.2f} m; at north {north:z.2f}, east {east:z.2f} m)"
            )
        text = f"no free path from item {a.seq} to item {b.seq}: {remedy}"
        yield PlanProblem(kind=PlanKind.MISSION, seq=b.seq, result=MissionResult.INVALID_PARAM5_X, reason=text)


def _bottleneck(
    a: _PointToClear,
    b: _PointToClear,
    gaps: Sequence[NarrowPassage],
    shapes: Sequence[FenceShape],
    ctx: PlanContext,
    check_cancel: Callable[[], None],
) -> NarrowPassage | None:
    """The first of ``gaps`` (widest first) at whose width two points are connected; None if it is no gap that keeps
    them apart.
    """
    fence = build_fence(shapes, ctx.params)
    ends = np.array([(p.north_m, p.east_m) for p in (a, b)])

    def passes(gap: NarrowPassage) -> bool:
        check_cancel()
        half_m = max(0.5 * gap.width_m - VALIDATION.passage_m, 0.0)
        one, other = FreeRegions(fence, ends, half_m, check_cancel).of_points
        return one == other

    at = bisect_left(gaps, True, key=passes)
    return gaps[at] if at < len(gaps) else None
