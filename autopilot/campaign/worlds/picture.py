"""Figure of a flight in a random world: obstacles, current, goals, path, and speed over time."""

from pathlib import Path
from typing import Any, cast

import numpy as np

from autopilot.campaign.worlds.random_currents import flow_of
from autopilot.campaign.worlds.random_world import RandomWorld, current_table
from autopilot.campaign.worlds.world_flight import Flown
from autopilot.campaign.worlds.world_shapes import Disc
from autopilot.core.frames import FloatArray

ARROWS = 16


def draw(world: RandomWorld, flown: Flown, path: Path) -> None:
    from matplotlib.figure import Figure
    from matplotlib.patches import Circle, Polygon

    figure = Figure(figsize=(11.0, 7.0), layout="constrained")
    left, right = cast(Any, figure.subfigures(1, 2, width_ratios=(2.2, 1.0)))
    plan = left.add_subplot()
    if world.layout.outline_m is not None:
        corners = [(east, north) for north, east in world.layout.outline_m]
        plan.add_patch(Polygon(corners, fill=False, edgecolor="black", linewidth=1.2))
    for solid in world.layout.solids:
        if isinstance(solid, Disc):
            plan.add_patch(Circle(solid.center_m[::-1], solid.radius_m, color="0.6"))
        else:
            plan.add_patch(Polygon([(east, north) for north, east in solid.corners_m], color="0.6"))
    places = [world.start_m, *((w["x_m"], w["y_m"]) for w in world.waypoints)]
    _draw_current(plan, world, np.array(places))
    plan.plot(world.start_m[1], world.start_m[0], "ks")
    for leg, waypoint in zip(flown.prospect.legs, world.waypoints, strict=False):
        accept = waypoint.get("accept_m", world.scenario["params"]["WP_ACCEPT_RADIUS"])
        color = "tab:green" if leg.sure else "tab:orange" if leg.possible else "tab:red"
        plan.add_patch(Circle((waypoint["y_m"], waypoint["x_m"]), accept, fill=False, edgecolor=color))
        heading = f" {waypoint['yaw_rad']:.1f}" if "yaw_rad" in waypoint else ""
        plan.annotate(f"{leg.seq}{heading}", (waypoint["y_m"], waypoint["x_m"]), color=color)
    if flown.watch is not None:
        rows = flown.watch.rows
        shown = plan.scatter(rows[::20, 2], rows[::20, 1], c=rows[::20, 0], s=4.0, cmap="viridis")
        left.colorbar(shown, ax=plan, label="s")
        _times(right, world, flown)
    plan.set_aspect("equal")
    plan.autoscale_view()
    if flown.watch is not None and len(flown.watch.rows):
        _frame(plan, np.vstack((np.array(places), flown.watch.rows[:, 1:3])))
    plan.set_xlabel("east / m")
    plan.set_ylabel("north / m")
    plan.set_title(f"{world.title}\n{flown.result.outcome}: {flown.result.what}"[:180], fontsize=8)
    figure.savefig(path, dpi=80)


def _frame(plan: Any, points: FloatArray) -> None:
    """Area near the flight; a harbour is larger than the figure should show."""
    low, high = points.min(axis=0) - 3.0, points.max(axis=0) + 3.0
    plan.set_xlim(low[1], high[1])
    plan.set_ylim(low[0], high[0])


def _draw_current(plan: Any, world: RandomWorld, places: FloatArray) -> None:
    low, high = places.min(axis=0) - 3.0, places.max(axis=0) + 3.0
    north, east = np.meshgrid(np.linspace(low[0], high[0], ARROWS), np.linspace(low[1], high[1], ARROWS), indexing="ij")
    where = np.stack((north.ravel(), east.ravel()), axis=1)
    flow = flow_of(current_table(world.scenario["current"]))(where)[0]
    plan.quiver(where[:, 1], where[:, 0], flow[:, 1], flow[:, 0], color="tab:blue", alpha=0.35)


def _times(figure: Any, world: RandomWorld, flown: Flown) -> None:
    assert flown.watch is not None
    rows, params = flown.watch.rows, world.scenario["params"]
    speed = figure.add_subplot(3, 1, 1)
    speed.plot(rows[::5, 0], np.hypot(rows[::5, 10], rows[::5, 11]), label="through water")
    speed.plot(rows[::5, 0], np.hypot(rows[::5, 16], rows[::5, 17]), label="water")
    speed.axhline(params["SPD_PLANAR_MAX"], color="black", linestyle=":")
    speed.legend(fontsize=7)
    depth = figure.add_subplot(3, 1, 2)
    depth.plot(rows[::5, 0], -rows[::5, 3])
    depth.set_ylabel("height / m")
    thrust = figure.add_subplot(3, 1, 3)
    commands = flown.watch.commands(params["THR_LIMIT"])
    thrust.plot(commands.t_s, commands.thrust_n, linewidth=0.6)
    thrust.set_ylabel("thrust / N")
