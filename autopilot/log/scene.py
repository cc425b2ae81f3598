"""The world as markers for 3D viewers: tank, obstacles with their safe zones, fence, waypoints."""

import math
from dataclasses import replace

import numpy as np

from autopilot.core.frames import FloatArray
from autopilot.log.analysis import obstacle_position
from autopilot.log.description import FenceItemDescription, Obstacle, Point2, RunDescription
from autopilot.log.visuals import VisualMarker

_CIRCLE_POINTS = 48
_LINE_M = 0.02
_WALL = (0.2, 0.2, 0.2, 1.0)
_SOLID = (0.5, 0.5, 0.5, 1.0)
_SAFE = (0.9, 0.3, 0.2, 0.25)
_FENCE = (0.8, 0.1, 0.1, 1.0)
_GOAL = (0.1, 0.6, 0.2, 0.4)
_BODY = (0.95, 0.55, 0.1, 0.8)
_TRUE_BODY = (0.15, 0.45, 0.9, 0.5)
_THROUGH = 0.12
"""Opacity of what is seen through."""
_DEFAULT_DEPTH_M = 1.5
CURRENT_M_S = 0.2
"""Current whose arrow is a metre long."""
TRUE_CURRENT = "true current"


def scene_markers(run: RunDescription) -> list[VisualMarker]:
    """Static parts of the description; the list is the same for the whole run."""
    depth = run.tank_depth_m if run.tank_depth_m is not None else _DEFAULT_DEPTH_M
    markers: list[VisualMarker] = []
    if run.tank_polygon_m:
        for number, z in enumerate((0.0, depth)):
            markers.append(_outline("tank", number, run.tank_polygon_m, z, _WALL))
    for number, obstacle in enumerate(run.obstacles):
        if obstacle.path_m:
            continue
        markers.append(_solid("obstacle", number, obstacle, obstacle.radius_m, depth, _SOLID))
        markers.append(_solid("safe_zone", number, obstacle, obstacle.radius_m + run.body_radius_m, depth, _SAFE))
    markers += [_outline("fence", number, outline(shape), 0.0, _FENCE) for number, shape in enumerate(run.fence)]
    for number, waypoint in enumerate(run.waypoints):
        size = 2.0 * waypoint.accept_radius_m
        markers.append(
            VisualMarker(
                namespace="waypoint",
                number=number,
                kind=VisualMarker.SPHERE,
                position_ned_m=waypoint.pos_ned_m,
                scale_m=(size, size, size),
                color_rgba=_GOAL,
            )
        )
    return markers


def moving_markers(run: RunDescription, t_s: float) -> list[VisualMarker]:
    """Moving obstacles at time ``t_s`` [s]."""
    depth = run.tank_depth_m if run.tank_depth_m is not None else _DEFAULT_DEPTH_M
    markers: list[VisualMarker] = []
    for number, obstacle in enumerate(run.obstacles):
        if obstacle.path_m:
            north, east = obstacle_position(obstacle, np.array([t_s]))[0].tolist()
            here = replace(obstacle, center_m=(north, east))
            markers.append(_solid("obstacle", number, here, obstacle.radius_m, depth, _SOLID))
            markers.append(_solid("safe_zone", number, here, obstacle.radius_m + run.body_radius_m, depth, _SAFE))
    return markers


def body_markers(run: RunDescription, *, truth: bool) -> list[VisualMarker]:
    """The hull, the ball round it and the heading of the estimated vehicle; ``truth``: of the simulated one too."""
    radius_m, half_m = run.hull_m or (0.9 * run.body_radius_m, 0.4 * run.body_radius_m)
    markers: list[VisualMarker] = []
    for frame, color in (("frd", _BODY), ("tru", _TRUE_BODY))[: 1 + truth]:
        size, ball = 2.0 * radius_m, 2.0 * run.body_radius_m
        shape = VisualMarker(
            namespace=f"body {frame}", number=0, kind=VisualMarker.CYLINDER, color_rgba=color, frame=frame
        )
        nose = ((0.0, 0.0, 0.0), (1.6 * radius_m, 0.0, 0.0))
        around = (*color[:3], _THROUGH)
        markers += [
            replace(shape, scale_m=(size, size, 2.0 * half_m)),
            replace(shape, number=1, kind=VisualMarker.ARROW, scale_m=(0.05, 0.1, 0.1), points_ned_m=nose),
            replace(shape, number=2, kind=VisualMarker.SPHERE, scale_m=(ball, ball, ball), color_rgba=around),
        ]
    return markers


def current_marker(namespace: str, pos_ned_m: FloatArray, current_ned_m_s: FloatArray) -> VisualMarker:
    """The current as an arrow from the vehicle, a metre for CURRENT_M_S."""
    north, east, down = pos_ned_m.tolist()
    tip = (pos_ned_m + current_ned_m_s / CURRENT_M_S).tolist()
    return VisualMarker(
        namespace=namespace,
        number=0,
        kind=VisualMarker.ARROW,
        scale_m=(0.03, 0.07, 0.07),
        color_rgba=_TRUE_BODY if namespace == TRUE_CURRENT else _BODY,
        points_ned_m=((north, east, down), (tip[0], tip[1], tip[2])),
    )


def outline(shape: FenceItemDescription) -> tuple[Point2, ...]:
    """Corners of a fence shape (not closed); a circle as a polygon."""
    if shape.center_m is None or shape.radius_m is None:
        return shape.vertices_m
    (north, east), radius = shape.center_m, shape.radius_m
    angles = (2.0 * math.pi * i / _CIRCLE_POINTS for i in range(_CIRCLE_POINTS))
    return tuple((north + radius * math.cos(a), east + radius * math.sin(a)) for a in angles)


def _outline(
    namespace: str, number: int, corners: tuple[Point2, ...], z_m: float, color: tuple[float, float, float, float]
) -> VisualMarker:
    closed = (*corners, *corners[:1])
    return VisualMarker(
        namespace=namespace,
        number=number,
        kind=VisualMarker.LINE_STRIP,
        scale_m=(_LINE_M, 0.0, 0.0),
        color_rgba=color,
        points_ned_m=tuple((north, east, z_m) for north, east in closed),
    )


def _solid(
    namespace: str,
    number: int,
    obstacle: Obstacle,
    radius_m: float,
    depth_m: float,
    color: tuple[float, float, float, float],
) -> VisualMarker:
    is_sphere = len(obstacle.center_m) == 3
    center_z = obstacle.center_m[2] if is_sphere else 0.5 * depth_m
    return VisualMarker(
        namespace=namespace,
        number=number,
        kind=VisualMarker.SPHERE if is_sphere else VisualMarker.CYLINDER,
        position_ned_m=(obstacle.center_m[0], obstacle.center_m[1], center_z),
        scale_m=(2.0 * radius_m, 2.0 * radius_m, 2.0 * radius_m if is_sphere else depth_m),
        color_rgba=color,
    )
