"""The five figures of the paper, section IV, and further ones. Bounds are red dashed lines as there.

Plans show the tank from above: x (north) to the right, y (east) down.
"""

from collections.abc import Callable
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from autopilot.core.frames import FloatArray, unwrap_near, wrap_pi
from autopilot.log.analysis import VehicleTrack, Visit, energy_j, estimate_error, seconds, thruster_names, wrap
from autopilot.log.figure_parts import (
    BAND,
    LISTED_LAPS,
    MOST_TURNS_RAD,
    NARROW_IN,
    TRUTH,
    FigureScene,
    draw_bounds,
    extend_limits,
    lap_colors,
    legend_above,
    named_laps,
    pair_of_axes,
    stacked_axes,
    time_axis,
    width_in,
)
from autopilot.log.figure_plan import draw_plan
from autopilot.log.plan_summary import met_current, moved_obstacles, plan_box

BESIDE_PLAN_IN, AROUND_PLAN_IN, PLAN_HEIGHTS_IN = 1.3, 1.25, (2.6, 9.0)
"""What the axes of a plan need beside it, what its legend and axes need above and below it, how high it may be."""
KEY_ABOVE_IN = 0.13
"""The key of the current, above the figure's lower edge."""
LEAST_OUTSIDE = 0.01
"""Of a flight's time: less outside of its laps is not worth a word."""
HEADS, HEAD_M = 6, 0.08
"""Arrow heads on the path of a lap, and their length."""
SIGMAS = 3.0
CONTROL_PERIOD_MS = 50.0
"""Time budget of a control step (docs/architecture.md)."""
SLIGHT_CURRENT_M_S = 0.05
"""Minimum range of current axes, so that still water looks still."""


def trajectory(scene: FigureScene) -> Figure | None:
    """The path in the horizontal plane, one colour per lap."""
    low, high = plan_box(scene.track, scene.flight.run)
    north_m, east_m = high - low
    plan_in = width_in() - BESIDE_PLAN_IN
    height_in = float(np.clip(plan_in * east_m / max(north_m, 1e-9) + AROUND_PLAN_IN, *PLAN_HEIGHTS_IN))
    figure = Figure(figsize=(width_in(), height_in))
    ax = figure.subplots()
    if scene.flight.run is not None:
        draw_plan(ax, scene.flight.run, moved_obstacles(scene.track, scene.flight.run))
    plane = scene.track.pos_ned_m
    outside = ~np.any([lap.holds(scene.track.t_s) for lap in scene.laps], axis=0) if scene.laps else None
    if outside is None:
        ax.plot(plane[:, 0], plane[:, 1], label=scene.basis, **TRUTH)
        _direction(ax, plane[:, :2], TRUTH["color"])
    elif outside.mean() > LEAST_OUTSIDE:
        ax.plot(plane[:, 0], plane[:, 1], color="#aaaaaa", linewidth=0.8, label="outside of laps")
    colors, named = lap_colors(len(scene.laps)), named_laps(len(scene.laps))
    for number, lap in enumerate(scene.laps):
        keep = lap.holds(scene.track.t_s)
        color, name = colors[number], f"lap {number + 1}" if number in named else None
        ax.plot(plane[keep, 0], plane[keep, 1], color=color, linewidth=1.3, label=name)
        if len(scene.laps) <= LISTED_LAPS or number == len(scene.laps) - 1:
            _direction(ax, plane[keep, :2], color)
    ax.plot(plane[0, 0], plane[0, 1], "k^", markersize=4, label="start")
    _current(ax, scene, height_in)
    legend_above(ax, 5 if scene.laps else 4)
    ax.set_aspect("equal")
    ax.yaxis.set_inverted(True)
    ax.set_xlabel("x, north [m]")
    ax.set_ylabel("y, east [m]")
    return figure


def _direction(ax: Axes, plane_m: FloatArray, color: str) -> None:
    """Arrow heads along a path (n, 2), evenly spaced."""
    steps = np.hypot(*np.diff(plane_m, axis=0).T)
    along = np.concatenate(([0.0], np.cumsum(steps)))
    if along[-1] <= 0.0:
        return
    for fraction in (np.arange(HEADS) + 0.5) / HEADS:
        at = min(int(np.searchsorted(along, fraction * along[-1])), len(plane_m) - 2)
        ahead = min(int(np.searchsorted(along, fraction * along[-1] + HEAD_M)), len(plane_m) - 1)
        if ahead > at:
            style = {"arrowstyle": "-|>", "color": color, "linewidth": 0.0, "mutation_scale": 11.0}
            ax.annotate("", plane_m[ahead], plane_m[at], arrowprops=style)


def _current(ax: Axes, scene: FigureScene, height_in: float) -> None:
    """The current where the vehicle met it, to scale with the plan and with a key; nothing where there was none."""
    met = met_current(scene.track, scene.flight.run)
    if met is None:
        return
    ax.update_datalim(met.place_m + met.scale_m * met.flow_m_s)
    arrows = ax.quiver(
        *met.place_m.T,
        *met.flow_m_s.T,
        color="#17a2b8",
        alpha=0.8,
        width=0.0025,
        angles="xy",
        scale_units="xy",
        scale=1.0 / met.scale_m,
        zorder=1.5,
    )
    low = KEY_ABOVE_IN / height_in  # beside the label of the axis
    label = f"current {met.key_m_s:g} m/s"
    ax.quiverkey(arrows, 0.08, low, met.key_m_s, label, labelpos="E", coordinates="figure", color="#17a2b8")


def depth_and_yaw(scene: FigureScene) -> Figure | None:
    """Depth and heading with the acceptance bands of the waypoint that is approached."""
    figure, (top, bottom) = stacked_axes(2, 4.6)
    run, track = scene.flight.run, scene.track
    top.plot(track.t_s, track.pos_ned_m[:, 2], label=f"depth ({scene.basis})", **TRUTH)
    _bands(scene, top, lambda v: (v.waypoint.pos_ned_m[2], v.waypoint.accept_radius_m))
    limits = (run.accept.depth_min_m, run.accept.depth_max_m) if run is not None else (None, None)
    draw_bounds(top, *limits)
    extend_limits(top, *limits)
    legend_above(top)
    top.yaxis.set_inverted(True)
    top.set_ylabel("z, depth [m]")
    yaw = np.unwrap(track.rpy_rad[:, 2])
    if np.ptp(yaw) <= MOST_TURNS_RAD:
        bottom.plot(track.t_s, yaw, **TRUTH)
        _bands(scene, bottom, lambda visit: _yaw_band(visit, track, yaw))
        bottom.set_ylabel("yaw, unwrapped [rad]")
    else:
        around = wrap(yaw)
        jumps = np.flatnonzero(np.abs(np.diff(around)) > np.pi) + 1  # no line from one end of the axis to the other
        bottom.plot(np.insert(track.t_s, jumps, track.t_s[jumps]), np.insert(around, jumps, np.nan), **TRUTH)
        for turn in (-2.0 * np.pi, 0.0, 2.0 * np.pi):
            _bands(scene, bottom, partial(_heading_band, turn_rad=turn))
        bottom.set_ylim(-np.pi, np.pi)
        bottom.set_ylabel("yaw [rad]")
    time_axis(scene, [top, bottom])
    return figure


def _heading_band(visit: Visit, turn_rad: float) -> tuple[float, float] | None:
    """Centre and half width of a heading band, a turn further."""
    waypoint = visit.waypoint
    return None if waypoint.yaw_rad is None else (wrap_pi(waypoint.yaw_rad) + turn_rad, waypoint.accept_yaw_rad)


def _yaw_band(visit: Visit, track: VehicleTrack, unwrapped_rad: FloatArray) -> tuple[float, float] | None:
    """Centre and half width of a heading band, on the turn on which the vehicle reached it."""
    if visit.waypoint.yaw_rad is None:
        return None
    at = len(unwrapped_rad) - 1 if visit.t_s is None else int(np.searchsorted(track.t_s, visit.t_s))
    return unwrap_near(visit.waypoint.yaw_rad, float(unwrapped_rad[at])), visit.waypoint.accept_yaw_rad


def _bands(scene: FigureScene, ax: Axes, band: Callable[[Visit], tuple[float, float] | None]) -> None:
    """Shade the acceptance band of each waypoint while it is approached."""
    start, label = float(scene.track.t_s[0]), "acceptance band"
    for visit in scene.tour:
        end = visit.t_s if visit.t_s is not None else float(scene.track.t_s[-1])
        around = band(visit)
        if around is not None:
            center, half = around
            ax.fill_between([start, end], center - half, center + half, label=label, **BAND)
            label = ""
        start = end


def planar_speed(scene: FigureScene) -> Figure | None:
    """Speed relative to the water in the horizontal plane."""
    figure, (ax,) = stacked_axes(1, 2.6)
    limit = scene.bound("planar_speed_m_s")
    ax.plot(scene.track.t_s, scene.track.planar_speed_m_s, label="norm of (u, v)", **TRUTH)
    ax.plot(scene.track.t_s, scene.track.literal_speed_m_s, color="#bbbbbb", linewidth=0.7, label="|u + v|", zorder=1)
    draw_bounds(ax, limit)
    legend_above(ax)
    extend_limits(ax, limit, 0.0)
    ax.set_ylabel("planar speed [m/s]")
    time_axis(scene, [ax])
    return figure


def heave_and_yaw_rate(scene: FigureScene) -> Figure | None:
    """Heave relative to the water and yaw rate, with their bounds."""
    figure, (top, bottom) = stacked_axes(2, 4.2)
    curves = (
        (top, scene.track.vel_level_m_s[:, 2], scene.bound("heave_m_s"), "heave w [m/s]"),
        (bottom, scene.track.rate_frd_rad_s[:, 2], scene.bound("yaw_rate_rad_s"), "yaw rate r [rad/s]"),
    )
    for ax, values, limit, label in curves:
        both = () if limit is None else (-limit, limit)
        ax.plot(scene.track.t_s, values, label=scene.basis, **TRUTH)
        draw_bounds(ax, *both)
        extend_limits(ax, *both)
        ax.set_ylabel(label)
    legend_above(top)
    time_axis(scene, [top, bottom])
    return figure


def thrusters(scene: FigureScene) -> Figure | None:
    table = scene.flight.table("/out/thrusters")
    if table is None:
        return None
    names = thruster_names(scene.flight, table)
    figure, axes = stacked_axes(len(names), 1.6 * len(names) + 0.4)
    limit = scene.bound("thrust_n")
    both = () if limit is None else (-limit, limit)
    for index, (ax, name) in enumerate(zip(axes, names, strict=True)):
        ax.step(seconds(table), table["thrust_n"][:, index], where="post", label="command", **TRUTH)
        draw_bounds(ax, *both)
        extend_limits(ax, *both)
        ax.set_ylabel(f"{name} [N]")
    legend_above(axes[0])
    time_axis(scene, axes)
    return figure


def estimate_errors(scene: FigureScene) -> Figure | None:
    """Estimate minus truth with the filter's own 3 sigma."""
    flight = scene.flight
    if flight.truth is None or flight.nav is None:
        return None
    error = estimate_error(flight.truth, flight.nav.between(flight.armed))
    if error is None:
        return None
    figure, axes = stacked_axes(4, 6.4)
    covariance = flight.table("/nav/covariance")
    curves = [(1000.0 * error.pos_ned_m[:, i], 1000.0, i, f"{'xyz'[i]} [mm]") for i in range(3)]
    curves.append((np.degrees(error.yaw_rad), float(np.degrees(1.0)), 5, "yaw [deg]"))
    for ax, (values, scale, index, label) in zip(axes, curves, strict=True):
        ax.plot(error.t_s, values, label="estimate minus truth", **TRUTH)
        if covariance is not None:
            sigma = SIGMAS * scale * np.sqrt(np.maximum(covariance["variance"][:, index], 0.0))
            t_s = seconds(covariance)
            for sign in (-1.0, 1.0):
                ax.plot(t_s, sign * sigma, color="#2ca02c", linewidth=0.8, label="3 sigma" if sign > 0 else None)
            _limit_to(ax, scene, t_s, sigma)
        ax.set_ylabel(label)
    legend_above(axes[0])
    rms = f"rms {1000.0 * error.pos_rms_m:.1f} mm, {np.degrees(error.yaw_rms_rad):.2f} deg"
    if width_in() < NARROW_IN:  # no room beside the legend
        figure.suptitle(rms, fontsize="medium")
    else:
        axes[0].set_title(rms, loc="left")
    time_axis(scene, axes)
    return figure


def _limit_to(ax: Axes, scene: FigureScene, t_s: FloatArray, sigma: FloatArray) -> None:
    """Show the band of the flight in full: before arming it may be far wider than anything of interest."""
    keep = scene.flight.armed.holds(t_s)
    if keep.any():
        height = 1.3 * float(np.max(sigma[keep]))
        low, high = ax.get_ylim()
        ax.set_ylim(max(low, -3.0 * height), min(high, 3.0 * height))


def solve_time(scene: FigureScene) -> Figure | None:
    """CPU time of the NMPC steps over time and as a histogram."""
    table = scene.flight.table("/ctl/nmpc")
    if table is None or not (table["solve_s"] > 0.0).any():
        return None
    figure, left, right = pair_of_axes(2.8)
    keep = table["solve_s"] > 0.0
    t_s, solve_ms = seconds(table)[keep], 1000.0 * table["solve_s"][keep]
    left.plot(t_s, solve_ms, ".", markersize=2, color="#1f77b4")
    failed = table["fallback"][keep] != 0
    left.plot(t_s[failed], solve_ms[failed], "rx", markersize=4, label="fallback")
    left.set_xlabel("time [s]")
    left.set_ylabel("NMPC step [ms]")
    left.set_ylim(bottom=0.0)
    longest = float(solve_ms.max())
    edges = np.geomspace(0.8 * float(solve_ms.min()), 1.25 * max(longest, CONTROL_PERIOD_MS), 61)
    right.hist(solve_ms, bins=edges.tolist(), color="#1f77b4")
    right.set_xscale("log")
    right.set_yscale("log")
    p50, p99 = (float(np.percentile(solve_ms, percent)) for percent in (50, 99))
    for value, name, color, style in (
        (p50, f"p50 {p50:.2f}", "#444444", "-"),
        (p99, f"p99 {p99:.2f}", "#ff7f0e", "--"),
        (longest, f"longest {longest:.1f}", "#9467bd", "--"),
        (CONTROL_PERIOD_MS, f"deadline {CONTROL_PERIOD_MS:g}", "red", "--"),
    ):
        right.axvline(value, color=color, linestyle=style, linewidth=1.0, label=name)
    right.set_xlabel("NMPC step [ms]")
    right.set_ylabel("steps")
    legend_above(right, 2)
    return figure


def energy(scene: FigureScene) -> Figure | None:
    """Electrical energy per lap, and power over time."""
    table = scene.flight.table("/sim/thrusters")
    if table is None:
        return None
    figure, left, right = pair_of_axes(2.8)
    hotel_w = scene.flight.run.hotel_power_w if scene.flight.run is not None else 0.0
    left.plot(seconds(table), table["power_w"] + hotel_w, label="electrical power", **TRUTH)
    if hotel_w > 0.0:
        left.axhline(hotel_w, color="#999999", linewidth=0.8, label="hotel load")
    legend_above(left)
    left.set_ylim(bottom=0.0)
    left.set_ylabel("power [W]")
    time_axis(scene, [left])
    used = {number: energy_j(scene.flight, lap) for number, lap in enumerate(scene.laps, 1)}
    known = {number: joules for number, joules in used.items() if joules is not None}
    for (number, joules), color in zip(known.items(), lap_colors(len(known)), strict=True):
        right.bar(number, joules, color=color, width=0.6)
    labelled = set(known) if len(known) <= LISTED_LAPS else {min(known, key=known.__getitem__)}
    for number in labelled | ({max(known, key=known.__getitem__)} if known else set()):
        place = (number, known[number])
        right.annotate(f"{known[number]:.0f} J", place, ha="center", va="bottom", fontsize=8)
    if len(scene.laps) <= LISTED_LAPS:
        right.set_xticks(range(1, len(scene.laps) + 1))
    right.set_xlabel("lap")
    right.set_ylabel("energy [J]")
    right.margins(y=0.12)
    return figure


def current(scene: FigureScene) -> Figure | None:
    """Current at the vehicle: estimate and truth."""
    nav = scene.flight.nav
    if nav is None:
        return None
    figure, axes = stacked_axes(2, 3.8)
    nav = nav.between(scene.flight.armed)
    truth = scene.flight.truth.between(scene.flight.armed) if scene.flight.truth is not None else None
    for index, (ax, label) in enumerate(zip(axes, ("north [m/s]", "east [m/s]"), strict=True)):
        if truth is not None:
            ax.plot(truth.t_s, truth.current_ned_m_s[:, index], label="truth", **TRUTH)
        ax.plot(nav.t_s, nav.current_ned_m_s[:, index], color="#ff7f0e", linewidth=1.0, label="estimate")
        ax.set_ylabel(f"current {label}")
        extend_limits(ax, -SLIGHT_CURRENT_M_S, SLIGHT_CURRENT_M_S)
    legend_above(axes[0])
    time_axis(scene, axes)
    return figure
