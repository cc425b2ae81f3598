"""Figure of one control step: route and plan from above, and the active limits over the prediction."""

from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle as RoundPatch
from matplotlib.patches import Polygon as CornerPatch

from autopilot.analysis.step_replay import ControlStepView
from autopilot.core.disk import in_place_of
from autopilot.core.errors import LogError
from autopilot.core.geometry import Circle, Shape
from autopilot.core.model4 import YAW, U, V
from autopilot.log.figure_parts import BOUND, LAP_COLORS, STYLE
from autopilot.log.figures import DPI

PLAN, BEST, PATH, OTHER = "#1f77b4", "#d62728", "#2ca02c", "#9467bd"
AROUND_M = 0.8
"""Margin drawn beyond route and prediction."""


def write_step_figure(view: ControlStepView, path: Path) -> Path:
    """Draw a step as PNG. LogError if the file cannot be written."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(11.0, 6.0))
        grid = figure.add_gridspec(3, 2, width_ratios=(1.15, 1.0))
        _draw_plan(figure.add_subplot(grid[:, 0]), view)
        speed = figure.add_subplot(grid[0, 1])
        thrust = figure.add_subplot(grid[1, 1], sharex=speed)
        limits = figure.add_subplot(grid[2, 1], sharex=speed)
        _draw_speed(speed, view)
        _draw_thrust(thrust, view)
        _draw_limits(limits, view)
        figure.suptitle(f"control step at {view.t_s:.2f} s", x=0.01, ha="left")
        try:
            with in_place_of(path) as part:
                figure.savefig(part, dpi=DPI, format="png")
        except OSError as error:
            raise LogError(f"{path}: cannot be written ({error.strerror}); choose another --figure") from error
    return path


def _draw_plan(ax: Axes, view: ControlStepView) -> None:
    for shape in view.fence.exclusions:
        _draw_shape(ax, shape, facecolor="#bbbbbb", edgecolor="#444444")
        if isinstance(shape, Circle):
            center = (float(shape.center_ned_m[1]), float(shape.center_ned_m[0]))
            ax.add_patch(RoundPatch(center, shape.radius_m + view.radius_m, fill=False, **BOUND))
    for shape in view.fence.inclusions:
        _draw_shape(ax, shape, facecolor="none", edgecolor="black")
    for number, side in enumerate(view.others):
        label = "other side of an obstacle" if number == 0 else None
        if len(side.route_ned_m):
            ax.plot(side.route_ned_m[:, 1], side.route_ned_m[:, 0], color=OTHER, ls=":", lw=1.4, label=label)
    route = view.output.route_ned_m
    ax.plot(route[:, 1], route[:, 0], color=PATH, lw=1.2, label="route")
    ax.plot(view.problem.x_ref[:, 1], view.problem.x_ref[:, 0], color=PATH, ls="", marker=".", ms=4, label="reference")
    ax.plot(view.plan_x[:, 1], view.plan_x[:, 0], color=PLAN, marker="o", ms=3, lw=1.4, label="plan flown")
    ax.plot(view.best_x[:, 1], view.best_x[:, 0], color=BEST, ls="--", lw=1.2, label="converged (IPOPT)")
    north, east, yaw = view.plan_x[0, 0], view.plan_x[0, 1], view.plan_x[0, YAW]
    nose = 0.25
    ax.annotate(
        "",
        (east + nose * np.sin(yaw), north + nose * np.cos(yaw)),
        (east, north),
        arrowprops={"arrowstyle": "-|>", "lw": 1.8, "color": "black"},
    )
    goal = view.goal.pos_ned_m
    ax.add_patch(
        RoundPatch((float(goal[1]), float(goal[0])), view.goal.accept_radius_m, facecolor=PATH, alpha=0.2, lw=0)
    )
    ax.plot(goal[1], goal[0], "k+", ms=8)
    seen = np.vstack([route[:, :2], view.plan_x[:, :2], goal[None, :2], *(side.route_ned_m for side in view.others)])
    ax.set_xlim(float(seen[:, 1].min()) - AROUND_M, float(seen[:, 1].max()) + AROUND_M)
    ax.set_ylim(float(seen[:, 0].min()) - AROUND_M, float(seen[:, 0].max()) + AROUND_M)
    ax.set_aspect("equal")
    ax.set_xlabel("east [m]")
    ax.set_ylabel("north [m]")
    ax.legend(loc="best")


def _draw_shape(ax: Axes, shape: Shape, *, facecolor: str, edgecolor: str) -> None:
    if isinstance(shape, Circle):
        center = (float(shape.center_ned_m[1]), float(shape.center_ned_m[0]))
        ax.add_patch(RoundPatch(center, shape.radius_m, facecolor=facecolor, edgecolor=edgecolor, lw=1.0))
    else:
        corners = np.asarray(shape.vertices_ned_m)[:, ::-1]
        ax.add_patch(CornerPatch(corners, closed=True, facecolor=facecolor, edgecolor=edgecolor, lw=1.0))


def _draw_speed(ax: Axes, view: ControlStepView) -> None:
    t_s = view.grid_t_s
    for x, color, style, label in (
        (view.plan_x, PLAN, "-", "plan flown"),
        (view.best_x, BEST, "--", "converged"),
        (view.problem.x_ref, PATH, ":", "reference"),
    ):
        ax.plot(t_s, np.hypot(x[:, U], x[:, V]), color=color, ls=style, label=label)
    limits = np.broadcast_to(view.problem.limits, (len(t_s) - 2, 5))
    ax.plot(t_s[1:-1], limits[:, 0], label="limit", **BOUND)
    ax.set_ylabel("planar speed\n[m/s]")
    ax.set_ylim(bottom=0.0)
    ax.tick_params(labelbottom=False)


def _draw_thrust(ax: Axes, view: ControlStepView) -> None:
    t_s = view.grid_t_s[:-1]
    for number in range(view.plan_n.shape[1]):
        color = LAP_COLORS[number % len(LAP_COLORS)]
        ax.step(t_s, view.plan_n[:, number], where="post", color=color, label=view.thrusters[number])
        ax.step(t_s, view.best_n[:, number], where="post", color=color, ls="--", lw=0.8)
    bound = np.broadcast_to(view.problem.thrust_limit_n, view.plan_n.shape).max(axis=1)
    ax.plot(t_s, bound, **BOUND)
    ax.plot(t_s, -bound, **BOUND)
    ax.set_ylabel("thrust [N]\n(dashed: converged)")
    ax.legend(ncols=2, loc="best")
    ax.tick_params(labelbottom=False)


def _draw_limits(ax: Axes, view: ControlStepView) -> None:
    """When which limit holds the converged plan, the strongest on top."""
    shown = view.limits[:6]
    for row, limit in enumerate(reversed(shown)):
        width = max(limit.to_s - limit.from_s, 0.05)
        ax.barh(row, width, left=limit.from_s, height=0.6, color=BEST, alpha=0.6)
        ax.annotate(f"{limit.multiplier:.3g}", (limit.from_s + width, row), xytext=(3, -3), textcoords="offset points")
    ax.set_yticks(range(len(shown)), [limit.name for limit in reversed(shown)])
    ax.set_xlim(0.0, float(view.grid_t_s[-1]))
    ax.set_xlabel("time after the step [s]")
    ax.set_title("limits that hold the plan, with multiplier" if shown else "no limit holds the plan", fontsize=9)
