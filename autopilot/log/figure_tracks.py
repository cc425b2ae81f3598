"""Several flights in one figure: their tracks in one plan, and curves over the time since arming."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeAlias

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from autopilot.core.disk import make_folder
from autopilot.core.errors import LogError
from autopilot.core.frames import FloatArray
from autopilot.log.analysis import Span, VehicleTrack, energy_j
from autopilot.log.description import RunDescription
from autopilot.log.figure_parts import (
    STYLE,
    FigureScene,
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
    figure = figure_of(HEIGHT_IN)
    ax = figure.subplots()
    if run is not None:
        draw_plan(ax, run, moved_obstacles(named[0][1][0], run))
    for color, (name, tracks) in zip(lap_colors(len(named)), named, strict=True):
        for number, track in enumerate(tracks):
            plane, width = track.pos_ned_m, 1.2 / len(tracks) ** 0.5
            ax.plot(plane[:, 0], plane[:, 1], color=color, linewidth=width, label=name if number == 0 else None)
    legend_above(ax, 3)
    ax.set_aspect("equal")
    ax.yaxis.set_inverted(True)
    ax.set_xlabel("x, north [m]")
    ax.set_ylabel("y, east [m]")
    return figure


def trajectories(scenes: Sequence[FigureScene]) -> Figure:
    return _plan([(scene.name, [scene.track]) for scene in scenes], scenes[0].flight.run)


def _energy(scene: FigureScene) -> FloatArray:
    """(n,) used since arming, NaN in a log without power."""
    t_s, start_s = scene.track.t_s, scene.flight.armed.start_s
    at = np.linspace(t_s[0], t_s[-1], ENERGY_POINTS)
    used = [energy_j(scene.flight, Span(start_s, end_s)) for end_s in at.tolist()]
    result: FloatArray = np.interp(t_s, at, np.array([np.nan if joules is None else joules for joules in used]))
    return result


Panel: TypeAlias = tuple[str, str, float, Callable[[FigureScene], FloatArray]]
"""Label, name of its bound, sign of its lower bound (0: none), values over the time of the track."""

PANELS: dict[str, tuple[Panel, ...]] = {
    "2_depth_and_yaw": (
        ("z, depth [m]", "", 0.0, lambda scene: scene.track.pos_ned_m[:, 2]),
        ("yaw, unwrapped [rad]", "", 0.0, lambda scene: np.unwrap(scene.track.rpy_rad[:, 2])),
    ),
    "3_planar_speed": (("planar speed [m/s]", "planar_speed_m_s", 0.0, lambda scene: scene.track.planar_speed_m_s),),
    "4_heave_and_yaw_rate": (
        ("heave w [m/s]", "heave_m_s", -1.0, lambda scene: scene.track.vel_water_frd_m_s[:, 2]),
        ("yaw rate r [rad/s]", "yaw_rate_rad_s", -1.0, lambda scene: scene.track.rate_frd_rad_s[:, 2]),
    ),
    "8_energy": (("energy [J]", "", 0.0, _energy),),
}
"""File name -> panels, of what several flights are compared by."""


def overlaid(name: str, scenes: Sequence[FigureScene]) -> Figure | None:
    """A figure of several flights, None where none has data."""
    curves = [[panel[3](scene) for scene in scenes] for panel in PANELS[name]]
    if not any(np.isfinite(values).any() for panel in curves for values in panel):
        return None
    figure, axes = stacked_axes(len(curves), 0.6 + 1.9 * len(curves))
    for ax, (label, bound, sign, _), values in zip(axes, PANELS[name], curves, strict=True):
        for scene, color, curve in zip(scenes, lap_colors(len(scenes)), values, strict=True):
            since_s = scene.track.t_s - scene.flight.armed.start_s
            ax.plot(since_s, curve, color=color, linewidth=1.0, label=scene.name)
        limit = scenes[0].bound(bound)
        both = () if limit is None else (limit, sign * limit) if sign else (limit,)
        draw_bounds(ax, *both)
        extend_limits(ax, *both)
        ax.set_ylabel(label)
    if "depth" in axes[0].get_ylabel():
        axes[0].yaxis.set_inverted(True)
    legend_above(axes[0])
    axes[-1].set_xlabel("time since arming [s]")
    return figure
