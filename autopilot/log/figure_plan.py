"""The tank seen from above: walls, obstacles with their safe zones, fence, acceptance circles."""

from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.patches import Circle, Polygon

from autopilot.log.description import Point2, RunDescription
from autopilot.log.scene import outline

_ALREADY_DRAWN_M = 0.02
"""A fence shape that lies on a wall or obstacle to this (it came as latitude and longitude) is not drawn twice."""


def draw_plan(ax: Axes, run: RunDescription) -> None:
    """Draw everything of the run's description that has a place in the horizontal plane."""
    if run.tank_polygon_m:
        ax.add_patch(Polygon(run.tank_polygon_m, closed=True, fill=False, edgecolor="black", linewidth=2.0))
    for number, obstacle in enumerate(run.obstacles):
        center = (obstacle.center_m[0], obstacle.center_m[1])
        zone = obstacle.radius_m + run.body_radius_m
        ax.add_patch(Circle(center, obstacle.radius_m, facecolor="#777777", edgecolor="black", linewidth=0.8))
        label = "safe zone" if number == 0 else None
        ax.add_patch(Circle(center, zone, fill=False, edgecolor="red", linestyle="--", linewidth=1.0, label=label))
    drawn = [(o.center_m[0], o.center_m[1], o.radius_m) for o in run.obstacles]
    for shape in run.fence:
        circle = None if shape.center_m is None else (*shape.center_m, shape.radius_m or 0.0)
        if circle is not None and any(_same(circle, other) for other in drawn):
            continue
        if shape.vertices_m and _same_corners(shape.vertices_m, run.tank_polygon_m):
            continue
        color = "#2ca02c" if shape.inclusion else "#d62728"
        ax.add_patch(Polygon(outline(shape), closed=True, fill=False, edgecolor=color, linewidth=1.0))
    for number, waypoint in enumerate(run.waypoints):
        center = (waypoint.pos_ned_m[0], waypoint.pos_ned_m[1])
        label = "acceptance" if number == 0 else None
        ax.add_patch(
            Circle(center, waypoint.accept_radius_m, facecolor="#2ca02c", alpha=0.18, linewidth=0.0, label=label)
        )
        ax.plot(*center, "k+", markersize=7)
        ax.annotate(waypoint.name, center, xytext=(5, 5), textcoords="offset points", fontweight="bold")
    ax.autoscale_view()


def _same_corners(a: Sequence[Point2], b: Sequence[Point2]) -> bool:
    return len(a) == len(b) and all(any(_same(corner, other) for other in b) for corner in a)


def _same(a: tuple[float, ...], b: tuple[float, ...]) -> bool:
    return all(abs(x - y) < _ALREADY_DRAWN_M for x, y in zip(a, b, strict=True))
