"""Content of plan views that varies in time: current along the path, and positions of moving obstacles."""

from dataclasses import dataclass

import numpy as np

from autopilot.core.frames import FloatArray
from autopilot.core.geometry import lengths_m
from autopilot.log.analysis import VehicleTrack, distance_to_obstacle, obstacle_position
from autopilot.log.description import Obstacle, RunDescription
from autopilot.log.scene import outline

ARROWS = 90
"""Maximum number of current arrows along a path, evenly spaced,"""
APART = 0.05
"""no nearer to each other than this share of the plan's size,"""
LONGEST_ARROW = 0.1
"""and this long where the current is fastest."""
BELOW = 0.07
"""Of the plan's size: between what it shows and the key."""
LEAST_CURRENT_M_S = 0.005
"""Slower is still water."""
ROUND_FIGURES = (1.0, 2.0, 5.0)
PATH_POINTS = 200


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class MetCurrent:
    """The current where the vehicle was, as arrows that are to scale with the plan."""

    place_m: FloatArray
    """(n, 2) north, east"""
    flow_m_s: FloatArray
    """(n, 2)"""
    scale_m: float
    """Length of the arrow of 1 m/s."""
    key_m_s: float
    """A round figure, of the size of the fastest: for the key,"""
    key_m: tuple[float, float]
    """and a free area of the plan for it, north and east."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class MovedObstacle:
    """Where a moving obstacle was during a flight."""

    obstacle: Obstacle
    path_m: FloatArray
    """(n, 2) north, east, from its place at the start to that at the end."""
    nearest_m: tuple[float, float]
    """Its position at the vehicle's closest approach,"""
    nearest_s: float
    """and when that was."""


def plan_box(track: VehicleTrack, run: RunDescription | None) -> tuple[FloatArray, FloatArray]:
    """Least and greatest north and east (2,) of a plan view: path, tank, fence and waypoints."""
    points = [track.pos_ned_m[:, :2]]
    if run is not None:
        outlines = [run.tank_polygon_m, *(outline(shape) for shape in run.fence)]
        points += [np.array(corners) for corners in outlines if corners]
        points += [np.array([waypoint.pos_ned_m[:2]]) for waypoint in run.waypoints]
    every = np.concatenate(points)
    return every.min(axis=0), every.max(axis=0)


def met_current(track: VehicleTrack, run: RunDescription | None) -> MetCurrent | None:
    """Arrows for the plan of a flight; None where nothing is known, nothing flowed or nothing moved."""
    along = lengths_m(track.pos_ned_m[:, :2])
    if len(track.t_s) < 2 or not along[-1] > 0.0:
        return None
    low, high = plan_box(track, run)
    size_m = float((high - low).max())
    rows = np.unique(np.searchsorted(along, np.arange(0.0, along[-1], max(along[-1] / ARROWS, APART * size_m))))
    flow = track.current_ned_m_s[rows, :2]
    fastest = float(np.hypot(*flow.T).max(initial=0.0)) if np.isfinite(flow).all() else 0.0
    if fastest < LEAST_CURRENT_M_S:
        return None
    return MetCurrent(
        place_m=track.pos_ned_m[rows, :2],
        flow_m_s=flow,
        scale_m=LONGEST_ARROW * size_m / fastest,
        key_m_s=round_figure(fastest),
        key_m=(float(low[0]), float(high[1] + BELOW * size_m)),
    )


def round_figure(value: float) -> float:
    """The largest of 1, 2 and 5 times a power of ten that is not above a value."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(power * max(figure for figure in ROUND_FIGURES if figure * power <= value * (1.0 + 1e-9)))


def moved_obstacles(track: VehicleTrack, run: RunDescription) -> list[MovedObstacle]:
    """Those that moved, over the time of a track."""
    found = []
    for obstacle in run.obstacles if len(track.t_s) else ():
        if not obstacle.path_m:
            continue
        nearest = int(np.argmin(distance_to_obstacle(track, obstacle)))
        where = obstacle_position(obstacle, track.t_s)
        rows = np.unique(np.linspace(0, len(track.t_s) - 1, PATH_POINTS).astype(int))
        north, east = where[nearest].tolist()
        found.append(
            MovedObstacle(
                obstacle=obstacle,
                path_m=where[rows],
                nearest_m=(north, east),
                nearest_s=float(track.t_s[nearest]),
            )
        )
    return found
