"""The world as markers for 3D viewers: tank, obstacles with their safe zones, fence, waypoints."""

import math
from dataclasses import replace

import numpy as np

from autopilot.log.analysis import obstacle_position
from autopilot.log.description import FenceShape, Obstacle, Point2, RunDescription
from autopilot.log.visuals import Marker

_CIRCLE_POINTS = 48
_LINE_M = 0.02
_WALL = (0.2, 0.2, 0.2, 1.0)
_SOLID = (0.5, 0.5, 0.5, 1.0)
_SAFE = (0.9, 0.3, 0.2, 0.25)
_FENCE = (0.8, 0.1, 0.1, 1.0)
_GOAL = (0.1, 0.6, 0.2, 0.4)
_DEFAULT_DEPTH_M = 1.5


def scene_markers(run: RunDescription) -> list[Marker]:
    """Everything of the description that keeps its place; the list is the same for the whole run."""
    depth = run.tank_depth_m if run.tank_depth_m is not None else _DEFAULT_DEPTH_M
    markers: list[Marker] = []
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
            Marker(
                namespace="waypoint",
                number=number,
                kind=Marker.SPHERE,
                position_ned_m=waypoint.pos_ned_m,
                scale_m=(size, size, size),
                color_rgba=_GOAL,
            )
        )
    return markers


def moving_markers(run: RunDescription, t_s: float) -> list[Marker]:
    """What moves, where it is at a time."""
    depth = run.tank_depth_m if run.tank_depth_m is not None else _DEFAULT_DEPTH_M
    markers: list[Marker] = []
    for number, obstacle in enumerate(run.obstacles):
        if obstacle.path_m:
            north, east = obstacle_position(obstacle, np.array([t_s]))[0].tolist()
            here = replace(obstacle, center_m=(north, east))
            markers.append(_solid("obstacle", number, here, obstacle.radius_m, depth, _SOLID))
            markers.append(_solid("safe_zone", number, here, obstacle.radius_m + run.body_radius_m, depth, _SAFE))
    return markers


def outline(shape: FenceShape) -> tuple[Point2, ...]:
    """Corners of a fence shape (not closed); a circle as a polygon."""
    if shape.center_m is None or shape.radius_m is None:
        return shape.vertices_m
    (north, east), radius = shape.center_m, shape.radius_m
    angles = (2.0 * math.pi * i / _CIRCLE_POINTS for i in range(_CIRCLE_POINTS))
    return tuple((north + radius * math.cos(a), east + radius * math.sin(a)) for a in angles)


def _outline(
    namespace: str, number: int, corners: tuple[Point2, ...], z_m: float, color: tuple[float, float, float, float]
) -> Marker:
    closed = (*corners, *corners[:1])
    return Marker(
        namespace=namespace,
        number=number,
        kind=Marker.LINE_STRIP,
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
) -> Marker:
    is_sphere = len(obstacle.center_m) == 3
    center_z = obstacle.center_m[2] if is_sphere else 0.5 * depth_m
    return Marker(
        namespace=namespace,
        number=number,
        kind=Marker.SPHERE if is_sphere else Marker.CYLINDER,
        position_ned_m=(obstacle.center_m[0], obstacle.center_m[1], center_z),
        scale_m=(2.0 * radius_m, 2.0 * radius_m, 2.0 * radius_m if is_sphere else depth_m),
        color_rgba=color,
    )
