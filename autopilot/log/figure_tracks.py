"""Several flights in one figure: their tracks in one plan, and curves over the time since arming."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from autopilot.core.disk import in_place_of, make_folder
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
BEYOND_S = 1e5
"""Longer than any flight goes on after its last waypoint."""
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
            with in_place_of(path) as part:
                figure.savefig(part, dpi=DPI)
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
    """Every track, and the one in the middle of them."""
    figure, ax = _around(scenes[0].track, scenes[0].flight.run)
    for number, scene in enumerate(scenes):
        plane = scene.track.pos_ned_m
        ax.plot(plane[:, 0], plane[:, 1], label=None if number else f"{len(scenes)} flights", **EACH)
    abreast = Abreast(scenes)
    plane = np.stack([abreast.sampled([scene.track.pos_ned_m[:, axis] for scene in scenes]) for axis in (0, 1)], axis=2)
    middle = plane[_medoid(plane)]
    ax.plot(middle[:, 0], middle[:, 1], label="median flight", **TRUTH)
    legend_above(ax, 3)
    return figure


class Abreast:
    """Flights of one tour, compared at the same places of it rather than at the same time.

    A leg lasts as long as in the median of the flights: each flight's time on it is stretched or compressed. At the
    same time a fast flight and a slow one are on different legs; their median is a way that nobody flew.
    """

    def __init__(self, scenes: Sequence[FigureScene]) -> None:
        self._own_s = [scene.track.t_s - scene.flight.armed.start_s for scene in scenes]
        tours = [
            [math.nan if visit.t_s is None else visit.t_s - scene.flight.armed.start_s for visit in scene.tour]
            for scene in scenes
        ]
        reached_s = np.array([[*tour, *[math.nan] * (max(map(len, tours)) - len(tour))] for tour in tours])
        by_most = np.isfinite(reached_s).sum(axis=0) > len(scenes) / 2
        reached_s = reached_s[:, by_most]
        common_s = np.maximum.accumulate(np.nanmedian(reached_s, axis=0))
        self._warps = [self._warp(common_s, own_s) for own_s in reached_s]
        last_s = [
            float(np.interp(own_s[-1], own, common))
            for own_s, (common, own) in zip(self._own_s, self._warps, strict=True)
        ]
        self.at_s: FloatArray = np.arange(0.0, float(np.median(last_s)), BAND_S)
        """Of the flight with legs of median length, as long as half of the flights last or more."""

    @staticmethod
    def _warp(common_s: FloatArray, own_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Common times and the flight's own; beyond its last waypoint time goes on as it is."""
        known = np.isfinite(own_s)
        common, own = np.append(0.0, common_s[known]), np.append(0.0, own_s[known])
        return np.append(common, common[-1] + BEYOND_S), np.append(own, own[-1] + BEYOND_S)

    def sampled(self, curves: Sequence[FloatArray]) -> FloatArray:
        """(flights, times); a flight that is over keeps its last value."""
        return np.array(
            [
                np.interp(np.interp(self.at_s, *warp), own_s, curve)
                for warp, own_s, curve in zip(self._warps, self._own_s, curves, strict=True)
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
        Panel("heave w [m/s]", lambda scene: scene.track.vel_level_m_s[:, 2], "heave_m_s", both_ways=True),
        Panel("yaw rate r [rad/s]", lambda scene: scene.track.rate_frd_rad_s[:, 2], "yaw_rate_rad_s", both_ways=True),
    ),
    "8_energy": (Panel("energy [J]", _energy),),
}
"""File name -> panels, of what several flights are compared by."""


def overlaid(name: str, scenes: Sequence[FigureScene]) -> Figure | None:
    """A curve per flight, None where none has data."""
    return _panels(name, scenes, _draw_each, "time since arming [s]")


def banded(name: str, scenes: Sequence[FigureScene]) -> Figure | None:
    """Median and band of SPREAD over the flights, None where none has data."""
    return _panels(name, scenes, _draw_band, "time since arming, legs of median length [s]")


def _draw_each(ax: Axes, _panel: Panel, scenes: Sequence[FigureScene], curves: Sequence[FloatArray]) -> None:
    for scene, color, curve in zip(scenes, lap_colors(len(scenes)), curves, strict=True):
        since_s = scene.track.t_s - scene.flight.armed.start_s
        ax.plot(since_s, curve, color=color, linewidth=1.0, label=scene.name)


def _draw_band(ax: Axes, panel: Panel, scenes: Sequence[FigureScene], curves: Sequence[FloatArray]) -> None:
    abreast = Abreast(scenes)
    sampled = abreast.sampled(curves)
    middle = None
    if panel.angle:  # flights that turned the other way round have the same heading: all are taken near one of them
        middle = sampled[_medoid(np.stack((np.cos(sampled), np.sin(sampled)), axis=2))]
        sampled = middle + wrap(sampled - middle)
    draw_band(ax, abreast.at_s, list(sampled.T), f"{len(scenes)} flights", middle)


def _medoid(samples: FloatArray) -> int:
    """Which of the flights (flights, times, k) is the least away from all others, over all times.

    Of flights that pass an obstacle on both sides, the median at each time is a way through it.
    """
    away = [float(np.linalg.norm(samples - each, axis=2).sum()) for each in samples]
    return int(np.argmin(away))


def _panels(
    name: str,
    scenes: Sequence[FigureScene],
    draw: Callable[[Axes, Panel, Sequence[FigureScene], Sequence[FloatArray]], None],
    time_label: str,
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
    axes[-1].set_xlabel(time_label)
    return figure
