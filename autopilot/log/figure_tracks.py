"""Several flights in one figure: their tracks in one plan, and curves over the time since arming."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from autopilot.core.disk import make_folder
from autopilot.core.errors import LogError
from autopilot.core.frames import FloatArray
from autopilot.log.analysis import Span, VehicleTrack, energy_j, wrap
from autopilot.log.description import RunDescription
from autopilot.log.figure_parts import (
    STYLE,
    TRUTH,
    FigureScene,
    draw_band,
    draw_bounds,
    extend_limits,
    figure_of,
    lap_colors,
    legend_above,
    stacked_axes,
)
from autopilot.log.figure_plan import draw_plan
from autopilot.log.flight_comparison import Column, own
from autopilot.log.plan_summary import moved_obstacles

HEIGHT_IN = 4.6
DPI = 150
BAND_S = 0.1
"""Between two points of a band."""
EACH: dict[str, Any] = {"color": "#bbbbbb", "linewidth": 0.4, "zorder": 1.2}
ENERGY_POINTS = 200
_ENDINGS = "(unknown format); give it the ending .png, .pdf or .svg"


def write_tracks(shown: Sequence[Column], path: Path) -> Path:
    """Draw every track, coloured by column, into a file whose ending is its format (PNG, PDF, SVG).

    LogError if no flight has a track, or the file cannot be written.
    """
    drawn = [(c, [one.track for one in c.flights if one.track is not None]) for c in own(shown)]
    known = [(column, tracks) for column, tracks in drawn if tracks]
    if not known:
        raise LogError("none of the logs has a track; there is nothing to draw")
    with mpl.rc_context(STYLE):
        named = []
        for column, tracks in known:
            more = f" and {len(column.flights) - 1} more" if len(column.flights) > 1 else ""
            named.append((f"{column.name}: {column.flights[0].path.stem}{more}", tracks))
        figure = _plan(named, known[0][0].flights[0].run)
        try:
            make_folder(path.parent)
            figure.savefig(path, dpi=DPI)
        except (OSError, ValueError) as error:  # matplotlib raises ValueError for an unknown ending
            reason = f"({error.strerror}); choose another place" if isinstance(error, OSError) else _ENDINGS
            raise LogError(f"{path}: the figure cannot be written {reason}") from error
    return path


def _plan(named: Sequence[tuple[str, Sequence[VehicleTrack]]], run: RunDescription | None) -> Figure:
    """Tracks of one name have one colour; around them is what the first flight was in."""
    figure, ax = _around(named[0][1][0], run)
    for color, (name, tracks) in zip(lap_colors(len(named)), named, strict=True):
        for number, track in enumerate(tracks):
            plane, width = track.pos_ned_m, 1.2 / len(tracks) ** 0.5
            ax.plot(plane[:, 0], plane[:, 1], color=color, linewidth=width, label=name if number == 0 else None)
    legend_above(ax, 3)
    return figure


def _around(track: VehicleTrack, run: RunDescription | None) -> tuple[Figure, Axes]:
    """A plan without tracks."""
    figure = figure_of(HEIGHT_IN)
    ax = figure.subplots()
    if run is not None:
        draw_plan(ax, run, moved_obstacles(track, run))
    ax.set_aspect("equal")
    ax.yaxis.set_inverted(True)
    ax.set_xlabel("x, north [m]")
    ax.set_ylabel("y, east [m]")
    return figure, ax


def trajectories(scenes: Sequence[FigureScene]) -> Figure:
    return _plan([(scene.name, [scene.track]) for scene in scenes], scenes[0].flight.run)


def tracks_and_median(scenes: Sequence[FigureScene]) -> Figure:
    """Every track, and the median of the positions at the same time since arming."""
    figure, ax = _around(scenes[0].track, scenes[0].flight.run)
    for number, scene in enumerate(scenes):
        plane = scene.track.pos_ned_m
        ax.plot(plane[:, 0], plane[:, 1], label=None if number else f"{len(scenes)} flights", **EACH)
    at_s = _common_times_s(scenes)
    north, east = (
        np.median(_sampled(scenes, [scene.track.pos_ned_m[:, axis] for scene in scenes], at_s), axis=0)
        for axis in (0, 1)
    )
    ax.plot(north, east, label="median", **TRUTH)
    legend_above(ax, 3)
    return figure


def _common_times_s(scenes: Sequence[FigureScene]) -> FloatArray:
    """Since arming, as long as more than half of the flights last."""
    last_s = [float(scene.track.t_s[-1] - scene.flight.armed.start_s) for scene in scenes]
    times: FloatArray = np.arange(0.0, float(np.median(last_s)), BAND_S)
    return times


def _sampled(scenes: Sequence[FigureScene], curves: Sequence[FloatArray], at_s: FloatArray) -> FloatArray:
    """(flights, times); a flight that is over keeps its last value."""
    return np.array(
        [
            np.interp(at_s, scene.track.t_s - scene.flight.armed.start_s, curve)
            for scene, curve in zip(scenes, curves, strict=True)
        ]
    )


def _energy(scene: FigureScene) -> FloatArray:
    """(n,) used since arming, NaN in a log without power."""
    t_s, start_s = scene.track.t_s, scene.flight.armed.start_s
    at = np.linspace(t_s[0], t_s[-1], ENERGY_POINTS)
    used = [energy_j(scene.flight, Span(start_s, end_s)) for end_s in at.tolist()]
    result: FloatArray = np.interp(t_s, at, np.array([np.nan if joules is None else joules for joules in used]))
    return result


@dataclass(frozen=True, slots=True)
class Panel:
    """One of the axes of a figure of several flights."""

    label: str
    values: Callable[[FigureScene], FloatArray]
    """Over the time of the track."""
    bound: str = ""
    """Name of its bound, if it has one."""
    both_ways: bool = False
    """The bound holds for the negative values, too."""
    angle: bool = False


PANELS: dict[str, tuple[Panel, ...]] = {
    "2_depth_and_yaw": (
        Panel("z, depth [m]", lambda scene: scene.track.pos_ned_m[:, 2]),
        Panel("yaw, unwrapped [rad]", lambda scene: np.unwrap(scene.track.rpy_rad[:, 2]), angle=True),
    ),
    "3_planar_speed": (Panel("planar speed [m/s]", lambda scene: scene.track.planar_speed_m_s, "planar_speed_m_s"),),
    "4_heave_and_yaw_rate": (
        Panel("heave w [m/s]", lambda scene: scene.track.vel_water_frd_m_s[:, 2], "heave_m_s", both_ways=True),
        Panel("yaw rate r [rad/s]", lambda scene: scene.track.rate_frd_rad_s[:, 2], "yaw_rate_rad_s", both_ways=True),
    ),
    "8_energy": (Panel("energy [J]", _energy),),
}
"""File name -> panels, of what several flights are compared by."""


def overlaid(name: str, scenes: Sequence[FigureScene]) -> Figure | None:
    """A curve per flight, None where none has data."""
    return _panels(name, scenes, _draw_each)


def banded(name: str, scenes: Sequence[FigureScene]) -> Figure | None:
    """Median and band of SPREAD over the flights, None where none has data."""
    return _panels(name, scenes, _draw_band)


def _draw_each(ax: Axes, _panel: Panel, scenes: Sequence[FigureScene], curves: Sequence[FloatArray]) -> None:
    for scene, color, curve in zip(scenes, lap_colors(len(scenes)), curves, strict=True):
        since_s = scene.track.t_s - scene.flight.armed.start_s
        ax.plot(since_s, curve, color=color, linewidth=1.0, label=scene.name)


def _draw_band(ax: Axes, panel: Panel, scenes: Sequence[FigureScene], curves: Sequence[FloatArray]) -> None:
    at_s = _common_times_s(scenes)
    sampled = _sampled(scenes, curves, at_s)
    if panel.angle:  # flights that turned the other way round have the same heading: all are taken near the mean's
        mean = np.unwrap(np.angle(np.exp(1j * sampled).mean(axis=0)))
        sampled = mean + wrap(sampled - mean)
    draw_band(ax, at_s, list(sampled.T), f"{len(scenes)} flights")


def _panels(
    name: str,
    scenes: Sequence[FigureScene],
    draw: Callable[[Axes, Panel, Sequence[FigureScene], Sequence[FloatArray]], None],
) -> Figure | None:
    panels = PANELS[name]
    curves = [[panel.values(scene) for scene in scenes] for panel in panels]
    if not any(np.isfinite(values).any() for panel in curves for values in panel):
        return None
    figure, axes = stacked_axes(len(panels), 0.6 + 1.9 * len(panels))
    for ax, panel, values in zip(axes, panels, curves, strict=True):
        draw(ax, panel, scenes, values)
        limit = scenes[0].bound(panel.bound)
        limits = () if limit is None else (limit, -limit) if panel.both_ways else (limit,)
        draw_bounds(ax, *limits)
        extend_limits(ax, *limits)
        ax.set_ylabel(panel.label)
    if "depth" in axes[0].get_ylabel():
        axes[0].yaxis.set_inverted(True)
    legend_above(axes[0])
    axes[-1].set_xlabel("time since arming [s]")
    return figure
