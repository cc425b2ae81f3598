"""Tracks of several flights in one plan."""

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
from matplotlib.figure import Figure

from autopilot.core.disk import make_folder
from autopilot.core.errors import LogError
from autopilot.log.figure_parts import STYLE, WIDTH_IN, lap_colors, legend_above
from autopilot.log.figure_plan import draw_plan
from autopilot.log.flight_comparison import Column
from autopilot.log.plan_summary import moved_obstacles

HEIGHT_IN = 4.6
DPI = 150
_ENDINGS = "(unknown format); give it the ending .png, .pdf or .svg"


def write_tracks(shown: Sequence[Column], path: Path) -> Path:
    """Draw every track, coloured by column, into a file whose ending is its format (PNG, PDF, SVG).

    LogError if no flight has a track, or the file cannot be written.
    """
    drawn = [(c, [one.track for one in c.flights if one.track is not None]) for c in shown if c.name != "mean"]
    known = [(column, tracks) for column, tracks in drawn if tracks]
    if not known:
        raise LogError("none of the logs has a track; there is nothing to draw")
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH_IN, HEIGHT_IN))
        ax = figure.subplots()
        run = known[0][0].flights[0].run
        if run is not None:
            draw_plan(ax, run, moved_obstacles(known[0][1][0], run))
        for color, (column, tracks) in zip(lap_colors(len(known)), known, strict=True):
            more = f" and {len(column.flights) - 1} more" if len(column.flights) > 1 else ""
            name = column.flights[0].path.stem + more
            for number, track in enumerate(tracks):
                label = f"{column.name}: {name}" if number == 0 else None
                plane = track.pos_ned_m
                ax.plot(plane[:, 0], plane[:, 1], color=color, linewidth=1.2 / len(tracks) ** 0.5, label=label)
        legend_above(ax, 3)
        ax.set_aspect("equal")
        ax.yaxis.set_inverted(True)
        ax.set_xlabel("x, north [m]")
        ax.set_ylabel("y, east [m]")
        try:
            make_folder(path.parent)
            figure.savefig(path, dpi=DPI)
        except (OSError, ValueError) as error:  # matplotlib raises ValueError for an unknown ending
            reason = f"({error.strerror}); choose another place" if isinstance(error, OSError) else _ENDINGS
            raise LogError(f"{path}: the figure cannot be written {reason}") from error
    return path
