"""Figures of a run as PNG files: the five of the paper (section IV), and what its readers ask for next.

Bounds are red dashed lines as in the paper. Plans show the tank from above: x (north) to the right, y (east) down.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from autopilot.core.errors import LogError
from autopilot.core.frames import FloatArray
from autopilot.log.analysis import (
    Flight,
    Span,
    Track,
    Visit,
    energy_j,
    estimate_error,
    lap_spans,
    load_flight,
    seconds,
    visits,
    wrap,
)
from autopilot.log.figure_plan import draw_plan
from autopilot.log.reader import Log

LAP_COLORS = ("#1f77b4", "#ff7f0e", "#2ca02c", "#9467bd", "#8c564b", "#17becf")
BOUND: dict[str, Any] = {"color": "red", "linestyle": "--", "linewidth": 1.0}
TRUTH: dict[str, Any] = {"color": "#1f77b4", "linewidth": 1.2}
ESTIMATE: dict[str, Any] = {"color": "#444444", "linewidth": 0.8, "linestyle": ":"}
BAND: dict[str, Any] = {"color": "#2ca02c", "alpha": 0.18, "linewidth": 0.0}
SIGMAS = 3.0
DPI = 150
WIDTH_IN = 7.0
SLIGHT_CURRENT_M_S = 0.05
"""Axes of currents show at least this much, so that still water looks still."""
_STYLE: Any = {
    "font.size": 9.0,
    "font.family": "DejaVu Sans",
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.alpha": 0.3,
    "grid.linewidth": 0.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
    "legend.fontsize": 8.0,
    "figure.constrained_layout.use": True,
}


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Scene:
    """What all figures need of a run."""

    flight: Flight
    track: Track
    """The truth (or the estimate if there is none), while armed."""
    tour: tuple[Visit, ...]
    laps: tuple[Span, ...]

    @property
    def basis(self) -> str:
        """Name of what is drawn."""
        return "truth" if self.flight.truth is not None else "estimate"

    def bound(self, name: str) -> float | None:
        """A bound that the controller was given."""
        return self.flight.run.paper_bounds.get(name) if self.flight.run is not None else None


def write_figures(log: Log, folder: Path) -> list[Path]:
    """Write every figure that the log has data for; their paths. LogError if there is nothing to draw."""
    scene = _scene(log)
    written = []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with mpl.rc_context(_STYLE):
            for name, draw in FIGURES.items():
                figure = draw(scene)
                if figure is not None:
                    path = folder / f"{name}.png"
                    figure.savefig(path, dpi=DPI)
                    written.append(path)
    except OSError as error:
        raise LogError(f"{folder}: figures cannot be written ({error.strerror}); choose another place") from error
    return written


def _scene(log: Log) -> Scene:
    flight = load_flight(log)
    track = flight.judged.between(flight.armed)
    if not len(track.t_s):
        raise LogError(f"{log.path}: the vehicle's track is empty; there is nothing to draw")
    tour = visits(track, flight.run) if flight.run is not None else []
    laps = lap_spans(tour, flight.run) if flight.run is not None else []
    return Scene(flight=flight, track=track, tour=tuple(tour), laps=tuple(laps))


def _axes(rows: int, height_in: float) -> tuple[Figure, list[Axes]]:
    figure = Figure(figsize=(WIDTH_IN, height_in))
    grid = figure.subplots(rows, 1, sharex=True, squeeze=False)
    return figure, [row[0] for row in grid]


def _time_axis(scene: Scene, axes: list[Axes]) -> None:
    """Label the lowest axes and mark the laps on all of them."""
    axes[-1].set_xlabel("time [s]")
    axes[-1].set_xlim(float(scene.track.t_s[0]), float(scene.track.t_s[-1]))
    for ax in axes:
        for lap in scene.laps:
            ax.axvline(lap.end_s, color="#999999", linewidth=0.6)


def _bounds(ax: Axes, *values: float | None) -> None:
    shown = [value for value in values if value is not None]
    for index, value in enumerate(shown):
        ax.axhline(value, label="bound" if index == 0 else None, **BOUND)


def _room(ax: Axes, *values: float | None) -> None:
    """Widen the y range so that bounds do not lie on the frame."""
    low, high = ax.get_ylim()
    lower, upper = min(low, high), max(low, high)
    known = [value for value in values if value is not None]
    lower, upper = min([lower, *known]), max([upper, *known])
    margin = 0.06 * (upper - lower)
    ax.set_ylim(lower - margin, upper + margin)


@contextmanager
def _legend(ax: Axes, columns: int = 3) -> Iterator[None]:
    """Put a legend above the axes once everything is drawn."""
    yield
    handles, labels = ax.get_legend_handles_labels()
    if labels:
        ax.legend(handles, labels, loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=columns, borderaxespad=0.1)


def trajectory(scene: Scene) -> Figure | None:
    """Paper, figure 4: the way in the horizontal plane, one colour per lap."""
    figure = Figure(figsize=(WIDTH_IN, 4.7))
    ax = figure.subplots()
    if scene.flight.run is not None:
        draw_plan(ax, scene.flight.run)
    with _legend(ax, 6):
        plane = scene.track.pos_ned_m
        label = "outside of laps" if scene.laps else scene.basis
        ax.plot(plane[:, 0], plane[:, 1], color="#aaaaaa", linewidth=0.8, label=label)
        for number, lap in enumerate(scene.laps):
            keep = lap.holds(scene.track.t_s)
            color = LAP_COLORS[number % len(LAP_COLORS)]
            ax.plot(plane[keep, 0], plane[keep, 1], color=color, linewidth=1.3, label=f"lap {number + 1}")
        ax.plot(plane[0, 0], plane[0, 1], "k^", markersize=4, label="start")
    ax.set_aspect("equal")
    ax.yaxis.set_inverted(True)
    ax.set_xlabel("x, north [m]")
    ax.set_ylabel("y, east [m]")
    return figure


def depth_and_yaw(scene: Scene) -> Figure | None:
    """Paper, figure 5: depth and heading with the acceptance bands of the waypoint that is approached."""
    figure, (top, bottom) = _axes(2, 4.6)
    run, track = scene.flight.run, scene.track
    with _legend(top):
        top.plot(track.t_s, track.pos_ned_m[:, 2], label=f"depth ({scene.basis})", **TRUTH)
        _bands(scene, top, lambda v: (v.waypoint.pos_ned_m[2], v.waypoint.accept_radius_m))
        limits = (run.accept.depth_min_m, run.accept.depth_max_m) if run is not None else (None, None)
        _bounds(top, *limits)
        _room(top, *limits)
    top.yaxis.set_inverted(True)
    top.set_ylabel("z, depth [m]")
    center = _yaw_center(scene)
    bottom.plot(*_broken(track.t_s, center + wrap(track.rpy_rad[:, 2] - center)), **TRUTH)
    _bands(scene, bottom, lambda visit: _yaw_band(visit, center))
    bottom.set_ylabel("yaw [rad]")
    _time_axis(scene, [top, bottom])
    return figure


def _yaw_band(visit: Visit, center_rad: float) -> tuple[float, float] | None:
    yaw = visit.waypoint.yaw_rad
    return None if yaw is None else (_near(yaw, center_rad), visit.waypoint.accept_yaw_rad)


def _near(angle_rad: float, center_rad: float) -> float:
    return center_rad + float(wrap(np.array([angle_rad - center_rad]))[0])


def _yaw_center(scene: Scene) -> float:
    """A heading opposite to which the curve may be cut: the middle of the waypoints' headings."""
    yaws = [visit.waypoint.yaw_rad for visit in scene.tour if visit.waypoint.yaw_rad is not None]
    return float(np.mean([min(yaws), max(yaws)])) if yaws else 0.0


def _broken(t_s: FloatArray, angles: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The curve with gaps where it jumps by a turn."""
    jumps = np.flatnonzero(np.abs(np.diff(angles)) > np.pi) + 1
    return np.insert(t_s, jumps, t_s[jumps]), np.insert(angles, jumps, np.nan)


def _bands(scene: Scene, ax: Axes, band: Callable[[Visit], tuple[float, float] | None]) -> None:
    """Shade the acceptance band of each waypoint for as long as it is approached."""
    start, label = float(scene.track.t_s[0]), "acceptance band"
    for visit in scene.tour:
        end = visit.t_s if visit.t_s is not None else float(scene.track.t_s[-1])
        around = band(visit)
        if around is not None:
            center, half = around
            ax.fill_between([start, end], center - half, center + half, label=label, **BAND)
            label = ""
        start = end


def planar_speed(scene: Scene) -> Figure | None:
    """Paper, figure 6: speed relative to the water in the horizontal plane."""
    figure, (ax,) = _axes(1, 2.6)
    limit = scene.bound("planar_speed_m_s")
    with _legend(ax):
        ax.plot(scene.track.t_s, scene.track.planar_speed_m_s, label="norm of (u, v)", **TRUTH)
        ax.plot(
            scene.track.t_s, scene.track.literal_speed_m_s, color="#bbbbbb", linewidth=0.7, label="|u + v|", zorder=1
        )
        _bounds(ax, limit)
    _room(ax, limit, 0.0)
    ax.set_ylabel("planar speed [m/s]")
    _time_axis(scene, [ax])
    return figure


def heave_and_yaw_rate(scene: Scene) -> Figure | None:
    """Paper, figure 7."""
    figure, (top, bottom) = _axes(2, 4.2)
    curves = (
        (top, scene.track.vel_water_frd_m_s[:, 2], scene.bound("heave_m_s"), "heave w [m/s]"),
        (bottom, scene.track.rate_frd_rad_s[:, 2], scene.bound("yaw_rate_rad_s"), "yaw rate r [rad/s]"),
    )
    for ax, values, limit, label in curves:
        both = () if limit is None else (-limit, limit)
        ax.plot(scene.track.t_s, values, label=scene.basis, **TRUTH)
        _bounds(ax, *both)
        _room(ax, *both)
        ax.set_ylabel(label)
    with _legend(top):
        pass
    _time_axis(scene, [top, bottom])
    return figure


def thrusters(scene: Scene) -> Figure | None:
    """Paper, figure 8: what the thrusters were told."""
    table = scene.flight.table("/out/thrusters")
    if table is None:
        return None
    run = scene.flight.run
    names = run.thruster_names if run is not None else tuple(f"thruster {i + 1}" for i in range(4))
    figure, axes = _axes(len(names), 1.6 * len(names) + 0.4)
    limit = scene.bound("thrust_n")
    both = () if limit is None else (-limit, limit)
    for index, (ax, name) in enumerate(zip(axes, names, strict=True)):
        ax.step(seconds(table), table["thrust_n"][:, index], where="post", label="command", **TRUTH)
        _bounds(ax, *both)
        _room(ax, *both)
        ax.set_ylabel(f"{name} [N]")
    with _legend(axes[0]):
        pass
    _time_axis(scene, axes)
    return figure


def estimate_errors(scene: Scene) -> Figure | None:
    """Estimate minus truth with the filter's own 3 sigma."""
    flight = scene.flight
    if flight.truth is None or flight.nav is None:
        return None
    error = estimate_error(flight.truth, flight.nav.between(flight.armed))
    if error is None:
        return None
    figure, axes = _axes(4, 6.4)
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
    with _legend(axes[0]):
        pass
    axes[0].set_title(f"rms {1000.0 * error.pos_rms_m:.1f} mm, {np.degrees(error.yaw_rms_rad):.2f} deg", loc="left")
    _time_axis(scene, axes)
    return figure


def _limit_to(ax: Axes, scene: Scene, t_s: FloatArray, sigma: FloatArray) -> None:
    """Show the band of the flight in full: before arming it may be far wider than anything of interest."""
    keep = scene.flight.armed.holds(t_s)
    if keep.any():
        height = 1.3 * float(np.max(sigma[keep]))
        low, high = ax.get_ylim()
        ax.set_ylim(max(low, -3.0 * height), min(high, 3.0 * height))


def solve_time(scene: Scene) -> Figure | None:
    """CPU time of the NMPC steps over time and as a histogram."""
    table = scene.flight.table("/ctl/nmpc")
    if table is None or not (table["solve_s"] > 0.0).any():
        return None
    figure = Figure(figsize=(WIDTH_IN, 2.8))
    left, right = figure.subplots(1, 2, width_ratios=(2.0, 1.0))
    keep = table["solve_s"] > 0.0
    t_s, solve_ms = seconds(table)[keep], 1000.0 * table["solve_s"][keep]
    left.plot(t_s, solve_ms, ".", markersize=2, color="#1f77b4")
    failed = table["fallback"][keep] != 0
    left.plot(t_s[failed], solve_ms[failed], "rx", markersize=4, label="fallback")
    left.set_xlabel("time [s]")
    left.set_ylabel("NMPC step [ms]")
    left.set_ylim(bottom=0.0)
    right.hist(solve_ms, bins=60, range=(0.0, float(np.percentile(solve_ms, 99.5)) * 1.2), color="#1f77b4")
    for share, style in ((50, "-"), (99, "--")):
        value = float(np.percentile(solve_ms, share))
        right.axvline(value, color="#d62728", linestyle=style, linewidth=1.0, label=f"p{share} {value:.2f} ms")
    right.set_xlabel("NMPC step [ms]")
    with _legend(right, 1):
        pass
    return figure


def energy(scene: Scene) -> Figure | None:
    """Electrical energy per lap, and power over time."""
    table = scene.flight.table("/sim/thrusters")
    if table is None:
        return None
    figure = Figure(figsize=(WIDTH_IN, 2.8))
    left, right = figure.subplots(1, 2, width_ratios=(2.0, 1.0))
    hotel_w = scene.flight.run.hotel_power_w if scene.flight.run is not None else 0.0
    with _legend(left):
        left.plot(seconds(table), table["power_w"] + hotel_w, label="thrusters and hotel load", **TRUTH)
        left.axhline(hotel_w, color="#999999", linewidth=0.8, label="hotel load")
    left.set_ylim(bottom=0.0)
    left.set_ylabel("power [W]")
    _time_axis(scene, [left])
    for number, lap in enumerate(scene.laps, 1):
        joules = energy_j(scene.flight, lap)
        if joules is not None:
            right.bar(number, joules, color=LAP_COLORS[(number - 1) % len(LAP_COLORS)], width=0.6)
            right.annotate(f"{joules:.0f} J", (number, joules), ha="center", va="bottom", fontsize=8)
    right.set_xticks(range(1, len(scene.laps) + 1))
    right.set_xlabel("lap")
    right.set_ylabel("energy [J]")
    right.margins(y=0.12)
    return figure


def current(scene: Scene) -> Figure | None:
    """Current at the vehicle: what the estimator believes and what there was."""
    nav = scene.flight.nav
    if nav is None:
        return None
    figure, axes = _axes(2, 3.8)
    nav = nav.between(scene.flight.armed)
    truth = scene.flight.truth.between(scene.flight.armed) if scene.flight.truth is not None else None
    for index, (ax, label) in enumerate(zip(axes, ("north [m/s]", "east [m/s]"), strict=True)):
        if truth is not None:
            ax.plot(truth.t_s, truth.current_ned_m_s[:, index], label="truth", **TRUTH)
        ax.plot(nav.t_s, nav.current_ned_m_s[:, index], color="#ff7f0e", linewidth=1.0, label="estimate")
        ax.set_ylabel(f"current {label}")
        _room(ax, -SLIGHT_CURRENT_M_S, SLIGHT_CURRENT_M_S)
    with _legend(axes[0]):
        pass
    _time_axis(scene, axes)
    return figure


Drawing: TypeAlias = Callable[[Scene], Figure | None]

FIGURES: dict[str, Drawing] = {
    "1_trajectory": trajectory,
    "2_depth_and_yaw": depth_and_yaw,
    "3_planar_speed": planar_speed,
    "4_heave_and_yaw_rate": heave_and_yaw_rate,
    "5_thrusters": thrusters,
    "6_estimate_error": estimate_errors,
    "7_solve_time": solve_time,
    "8_energy": energy,
    "9_current": current,
}
"""File name -> what draws it; 1 to 5 are the paper's."""
