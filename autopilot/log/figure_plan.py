"""The tank seen from above: walls, obstacles with their safe zones, fence, acceptance circles."""

from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.patches import Circle, Polygon

from autopilot.log.description import RunDescription
from autopilot.log.plan_summary import MovedObstacle
from autopilot.log.scene import outline

MOVED = "#555555"
"""Colour of a moving obstacle at other times."""

_ALREADY_DRAWN_M = 0.02
"""Tolerance for fence shapes that coincide with a wall or obstacle (rounded by latitude and longitude); these are
not drawn twice."""


def draw_plan(ax: Axes, run: RunDescription, moved: Sequence[MovedObstacle]) -> None:
    """Draw the run's description in the horizontal plane."""
    if run.tank_polygon_m:
        ax.add_patch(Polygon(run.tank_polygon_m, closed=True, fill=False, edgecolor="black", linewidth=2.0))
    standing = [obstacle for obstacle in run.obstacles if not obstacle.path_m]
    for number, obstacle in enumerate(standing):
        center = (obstacle.center_m[0], obstacle.center_m[1])
        zone = obstacle.radius_m + run.body_radius_m
        ax.add_patch(Circle(center, obstacle.radius_m, facecolor="#777777", edgecolor="black", linewidth=0.8))
        label = "safe zone" if number == 0 else None
        ax.add_patch(Circle(center, zone, fill=False, edgecolor="red", linestyle="--", linewidth=1.0, label=label))
    for number, one in enumerate(moved):
        _draw_moved(ax, one, run, "safe zone" if number == 0 and not standing else None)
    drawn = [(o.center_m[0], o.center_m[1], o.radius_m) for o in standing]
    for shape in run.fence:
        circle = None if shape.center_m is None else (*shape.center_m, shape.radius_m or 0.0)
        if circle is not None and any(_same(circle, other) for other in drawn):
            continue
        walls = run.tank_polygon_m if len(run.tank_polygon_m) == len(shape.vertices_m) else ()
        if walls and all(any(_same(corner, wall) for wall in walls) for corner in shape.vertices_m):
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


def _draw_moved(ax: Axes, moved: MovedObstacle, run: RunDescription, label: str | None) -> None:
    """A moving obstacle: solid at the vehicle's closest approach, outlines at its first and last position."""
    radius = moved.obstacle.radius_m
    ax.plot(*moved.path_m.T, color=MOVED, linestyle=":", linewidth=1.0)
    for place, style, side, text in ((moved.path_m[0], "--", -1, "start "), (moved.path_m[-1], "-", 1, " end")):
        center = (float(place[0]), float(place[1]))
        ax.add_patch(Circle(center, radius, fill=False, edgecolor=MOVED, linestyle=style, linewidth=0.8))
        beside = (center[0] + side * radius, center[1])
        ax.annotate(text, beside, ha="right" if side < 0 else "left", va="center", fontsize=7, color=MOVED)
    ax.add_patch(Circle(moved.nearest_m, radius, facecolor="#777777", edgecolor="black", linewidth=0.8))
    zone = radius + run.body_radius_m
    ax.add_patch(Circle(moved.nearest_m, zone, fill=False, edgecolor="red", linestyle="--", linewidth=1.0, label=label))
    ax.annotate(f"{moved.nearest_s:.0f} s", moved.nearest_m, ha="center", va="center", fontsize=7, color="white")


def _same(a: tuple[float, ...], b: tuple[float, ...]) -> bool:
    return all(abs(x - y) < _ALREADY_DRAWN_M for x, y in zip(a, b, strict=True))
