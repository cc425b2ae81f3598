"""Figures of a run as PNG and PDF files: the five of the paper (section IV), and further ones."""

from collections.abc import Callable
from pathlib import Path
from typing import TypeAlias

import matplotlib as mpl
from matplotlib.figure import Figure

from autopilot.core.disk import make_folder
from autopilot.core.errors import LogError
from autopilot.log import figure_more, figure_paper
from autopilot.log.figure_parts import STYLE, FigureScene, make_scene
from autopilot.log.reader import Log

DPI = 150

Drawing: TypeAlias = Callable[[FigureScene], Figure | None]

FIGURES: dict[str, Drawing] = {
    "1_trajectory": figure_paper.trajectory,
    "2_depth_and_yaw": figure_paper.depth_and_yaw,
    "3_planar_speed": figure_paper.planar_speed,
    "4_heave_and_yaw_rate": figure_paper.heave_and_yaw_rate,
    "5_thrusters": figure_paper.thrusters,
    "6_estimate_error": figure_more.estimate_errors,
    "7_solve_time": figure_more.solve_time,
    "8_energy": figure_more.energy,
    "9_current": figure_more.current,
}
"""File name -> what draws it; 1 to 5 are the paper's."""


def write_figures(log: Log, folder: Path) -> list[Path]:
    """Write every figure that the log has data for.

    Parameters
    ----------
    log
        The log.
    folder
        Created if it is missing.

    Returns
    -------
    list of Path
        A PNG and a PDF file per figure.

    Raises
    ------
    LogError
        There are no data, or a file cannot be written.
    """
    scene = make_scene(log)
    written = []
    try:
        make_folder(folder)
        with mpl.rc_context(STYLE):
            for name, draw in FIGURES.items():
                figure = draw(scene)
                if figure is not None:
                    path = folder / f"{name}.png"
                    figure.savefig(path, dpi=DPI)
                    figure.savefig(path.with_suffix(".pdf"))
                    written += [path, path.with_suffix(".pdf")]
    except OSError as error:
        raise LogError(f"{folder}: figures cannot be written ({error.strerror}); choose another place") from error
    return written
