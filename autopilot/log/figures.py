"""Figures of a run as PNG and PDF files: the five of the paper (section IV), and further ones."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias

import matplotlib as mpl
from matplotlib.figure import Figure

from autopilot.core.disk import in_place_of, make_folder
from autopilot.core.errors import LogError
from autopilot.core.names import unknown
from autopilot.log import figure_paper, figure_tracks
from autopilot.log.figure_parts import LEAST_FOR_BAND, STYLE, FigureScene, make_scene
from autopilot.log.reader import Log

DPI, PAPER_DPI = 150, 600

Drawing: TypeAlias = Callable[[FigureScene], Figure | None]

FIGURES: dict[str, Drawing] = {
    "1_trajectory": figure_paper.trajectory,
    "2_depth_and_yaw": figure_paper.depth_and_yaw,
    "3_planar_speed": figure_paper.planar_speed,
    "4_heave_and_yaw_rate": figure_paper.heave_and_yaw_rate,
    "5_thrusters": figure_paper.thrusters,
    "6_estimate_error": figure_paper.estimate_errors,
    "7_solve_time": figure_paper.solve_time,
    "8_energy": figure_paper.energy,
    "9_current": figure_paper.current,
}
"""File name -> what draws it; 1 to 5 are the paper's."""
OVERLAID: dict[str, Callable[[Sequence[FigureScene]], Figure | None]] = {
    "1_trajectory": figure_tracks.trajectories,
    **{name: partial(figure_tracks.overlaid, name) for name in figure_tracks.PANELS},
}
"""The same of several logs."""
BANDS: dict[str, Callable[[Sequence[FigureScene]], Figure | None]] = {
    "1_trajectory": figure_tracks.tracks_and_median,
    **{name: partial(figure_tracks.banded, name) for name in figure_tracks.PANELS},
}
"""The same as median and spread."""

FONT = "STIXGeneral"
"""Looks like Times, which both publishers take, and comes with matplotlib."""


@dataclass(frozen=True, slots=True)
class Paper:
    """What a publisher asks of figures."""

    widths_in: tuple[float, float]
    """Of one column of text, and of two."""
    size_pt: float

    def style(self, columns: int) -> dict[str, Any]:
        sizes = ("font.size", "axes.labelsize", "axes.titlesize", "xtick.labelsize", "ytick.labelsize")
        return {
            **dict.fromkeys((*sizes, "legend.fontsize"), self.size_pt),
            "font.family": FONT,
            "mathtext.fontset": "stix",
            "figure.figsize": (self.widths_in[columns - 1], 4.0),
            "savefig.dpi": PAPER_DPI,
        }


PAPERS = {
    "ieee": Paper((3.5, 7.16), 8.0),
    "elsevier": Paper((3.54, 7.48), 7.0),
}


def paper_style(name: str | None, columns: int = 1) -> dict[str, Any]:
    """Matplotlib's settings for figures of PAPERS, none for None."""
    return {} if name is None else PAPERS[name].style(columns)


def save(figure: Figure, path: Path) -> list[Path]:
    """Write a PNG file and a PDF file of the same name."""
    paths = [path, path.with_suffix(".pdf")]
    for each in paths:
        with in_place_of(each) as part:
            figure.savefig(part)
    return paths


def write_figures(
    logs: Log | Sequence[Log],
    folder: Path,
    *,
    only: Collection[str] = (),
    style: Any = None,
    band: bool = False,
) -> list[Path]:
    """Write every figure that the log has data for.

    Parameters
    ----------
    logs
        One log, or several that are drawn into the same figures (those of OVERLAID).
    folder
        Created if it is missing.
    only
        Names of the figures, empty = all.
    style
        Matplotlib's settings beside the common ones, as of :func:`paper_style`.
    band
        Several logs as median and spread instead of a curve each.

    Returns
    -------
    list of Path
        A PNG and a PDF file per figure.

    Raises
    ------
    LogError
        There are no data, or a file cannot be written.
    UnknownNameError
        There is no such figure.
    """
    scenes = [make_scene(log) for log in ([logs] if isinstance(logs, Log) else logs)]
    several = BANDS if band else OVERLAID
    known = FIGURES if len(scenes) == 1 else several
    if band and len(scenes) < LEAST_FOR_BAND:
        raise LogError(f"{folder}: a band needs {LEAST_FOR_BAND} logs or more, not {len(scenes)}")
    if missing := [name for name in only if name not in known]:
        raise unknown(f"a figure of {len(scenes)} logs", missing[0], tuple(known))
    written = []
    try:
        make_folder(folder)
        with mpl.rc_context({**STYLE, "savefig.dpi": DPI, **(style or {})}):
            for name in only or known:
                figure = FIGURES[name](scenes[0]) if len(scenes) == 1 else several[name](scenes)
                if figure is not None:
                    written += save(figure, folder / f"{name}.png")
    except OSError as error:
        raise LogError(f"{folder}: figures cannot be written ({error.strerror}); choose another place") from error
    return written
