"""Figures beyond the paper's: estimation errors, solve time, energy, current."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from autopilot.core.frames import FloatArray
from autopilot.log.analysis import energy_j, estimate_error, seconds
from autopilot.log.figure_parts import (
    LISTED_LAPS,
    NARROW_IN,
    TRUTH,
    FigureScene,
    extend_limits,
    lap_colors,
    legend_above,
    pair_of_axes,
    stacked_axes,
    time_axis,
    width_in,
)

SIGMAS = 3.0
CONTROL_PERIOD_MS = 50.0
"""Time budget of a control step (docs/architecture.md)."""
SLIGHT_CURRENT_M_S = 0.05
"""Minimum range of current axes, so that still water looks still."""


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
