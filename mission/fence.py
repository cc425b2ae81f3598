"""Fence items -> shapes in local metres -> workspace of planner and controller.

Circle exclusion = vertical cylinder, polygon exclusion = prism, inclusions = workspace, depth band from parameters
(MAV_CMD_NAV_FENCE_*, common.xml: a polygon is one item per vertex, each with the vertex count in param1).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from autopilot.core.frames import FloatArray
from autopilot.core.geodesy import MAX_RANGE_M, Origin
from autopilot.core.geometry import Circle, Fence, Polygon, Shape
from autopilot.core.plan import MissionResult, PlanItem, PlanRejection
from autopilot.core.shapes import crossing_edges, signed_area_m2
from autopilot.mission.clearance import Clearance
from autopilot.mission.decode import ItemRefusedError, horizontal_ned_m, number, refuse
from autopilot.mission.items import Command

LABEL = "fence item"
MIN_VERTICES = 3
MIN_AREA_M2 = 1e-3
"""A smaller polygon is a drawing error: 1e-7 degrees already are 11 mm."""
MAX_RADIUS_M = 2.0 * MAX_RANGE_M
"""It covers all places that a plan may have, from any of them."""
POLYGONS = frozenset({Command.FENCE_POLYGON_VERTEX_INCLUSION, Command.FENCE_POLYGON_VERTEX_EXCLUSION})
CIRCLES = frozenset({Command.FENCE_CIRCLE_INCLUSION, Command.FENCE_CIRCLE_EXCLUSION})
INCLUSIONS = frozenset({Command.FENCE_POLYGON_VERTEX_INCLUSION, Command.FENCE_CIRCLE_INCLUSION})


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FenceShape:
    """One shape of the fence with its first item in the plan."""

    seq: int
    """Its first item."""
    inclusion: bool
    shape: Shape

    @property
    def name(self) -> str:
        """For the operator: type and first item."""
        kind = "circle" if isinstance(self.shape, Circle) else "polygon"
        return f"{'inclusion' if self.inclusion else 'exclusion'} {kind} (fence item {self.seq})"


def check_fence_item(item: PlanItem, origin: Origin) -> PlanRejection | None:
    """Cheap checks of one fence item by itself."""
    try:
        if item.command == Command.FENCE_RETURN_POINT:
            horizontal_ned_m(item, origin, LABEL)
        elif item.command in CIRCLES:
            _circle(item, origin)
        elif item.command in POLYGONS:
            _vertex_count(item)
            horizontal_ned_m(item, origin, LABEL)
        else:
            text = f"command {item.command} is not supported in a fence; use 5001 to 5004 (polygons, circles) or 5000"
            raise refuse(item, MissionResult.UNSUPPORTED, text, LABEL)
    except ItemRefusedError as error:
        return error.rejection
    return None


def _circle(item: PlanItem, origin: Origin) -> Circle:
    radius = number(item, 1, "radius", LABEL)
    if radius is None or not 0.0 < radius <= MAX_RADIUS_M:
        shown = "not given" if radius is None else f"{radius:g} m"
        text = f"radius (param1) is {shown}; give more than 0, up to {MAX_RADIUS_M:.0f} m"
        raise refuse(item, MissionResult.INVALID_PARAM1, text, LABEL)
    return Circle(center_ned_m=np.array(horizontal_ned_m(item, origin, LABEL)), radius_m=radius)


def _vertex_count(item: PlanItem) -> int:
    count = number(item, 1, "vertex count", LABEL)
    if count is None or count != int(count) or count < MIN_VERTICES:
        shown = "not given" if count is None else f"{count:g}"
        text = f"vertex count (param1) is {shown}; a polygon has {MIN_VERTICES} or more"
        raise refuse(item, MissionResult.INVALID_PARAM1, text, LABEL)
    return int(count)


def _polygon(group: Sequence[PlanItem], count: int, origin: Origin) -> Polygon:
    """The polygon of one group of vertices, or a refusal: incomplete, self-intersecting, without area."""
    first = group[0]
    if len(group) < count:
        text = f"polygon has {len(group)} of {count} vertices; send all of them one after the other, equal in param1"
        raise refuse(first, MissionResult.INVALID_PARAM1, text, LABEL)
    vertices = np.array([horizontal_ned_m(item, origin, LABEL) for item in group])
    crossing = crossing_edges(vertices)
    if crossing is not None:
        a, b = (group[i].seq for i in crossing)
        text = f"polygon intersects itself (edges after fence items {a} and {b}); put them in order, without repeats"
        raise refuse(first, MissionResult.INVALID, text, LABEL)
    area = abs(signed_area_m2(vertices))
    if area < MIN_AREA_M2:
        raise refuse(first, MissionResult.INVALID, f"polygon has no area ({area:.1e} m2); move its vertices", LABEL)
    return Polygon(vertices_ned_m=vertices)


def read_fence(items: Sequence[PlanItem], origin: Origin) -> tuple[tuple[FenceShape, ...], tuple[PlanRejection, ...]]:
    """All shapes that can be read, and all that is wrong with the others."""
    shapes: list[FenceShape] = []
    problems: list[PlanRejection] = []
    index = 0
    while index < len(items):
        item = items[index]
        index += 1
        try:
            rejection = check_fence_item(item, origin)
            if rejection is not None:
                problems.append(rejection)
            elif item.command in CIRCLES:
                shapes.append(
                    FenceShape(seq=item.seq, inclusion=item.command in INCLUSIONS, shape=_circle(item, origin))
                )
            elif item.command in POLYGONS:
                count = _vertex_count(item)
                group = _take_group(items, index - 1, count)
                index += len(group) - 1
                polygon = _polygon(group, count, origin)
                shapes.append(FenceShape(seq=item.seq, inclusion=item.command in INCLUSIONS, shape=polygon))
        except ItemRefusedError as error:
            problems.append(error.rejection)
    return tuple(shapes), tuple(problems)


def _take_group(items: Sequence[PlanItem], start: int, count: int) -> list[PlanItem]:
    """Up to ``count`` items from ``start`` that are vertices of the same polygon."""
    first = items[start]
    group: list[PlanItem] = []
    for item in items[start : start + count]:
        if item.command != first.command or item.param1 != first.param1:
            break
        group.append(item)
    return group


def build_fence(shapes: Sequence[FenceShape], params: Mapping[str, float]) -> Fence:
    """The workspace: shapes and the depth band of the parameters. No shapes = open water."""
    return Fence(
        inclusions=tuple(s.shape for s in shapes if s.inclusion),
        exclusions=tuple(s.shape for s in shapes if not s.inclusion),
        depth_min_m=params["DEPTH_MIN"],
        depth_max_m=params["DEPTH_MAX"],
    )


def fence_clearance_m(fence: Fence, points_ned_m: FloatArray) -> FloatArray:
    """(n,) signed distance of points (n, 2) to the forbidden area: negative = inside it, inf = open water."""
    return Clearance.of(fence).clearance_m(points_ned_m)
