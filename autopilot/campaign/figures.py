"""Figures of a campaign: histograms of margins and of energy."""

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from autopilot.campaign.results import RunResult
from autopilot.log.figure_parts import BOUND, STYLE, legend_above

BINS = 40
SHOWN = (
    ("cylinder 1", "cylinder 1 [mm]", 1000.0),
    ("cylinder 2", "cylinder 2 [mm]", 1000.0),
    ("fence", "fence [mm]", 1000.0),
    ("walls", "walls [mm]", 1000.0),
    ("planar speed", "planar speed [mm/s]", 1000.0),
    ("yaw rate", "yaw rate [mrad/s]", 1000.0),
)
"""Margins that are drawn when runs have them."""


def write_figures(results: Sequence[RunResult], title: str, folder: Path) -> list[Path]:
    """``margins.png`` and ``energy.png`` in ``folder``; nothing is written of what no run has."""
    flown = [result for result in results if result.error is None]
    written = []
    with mpl.rc_context(STYLE):
        for name, figure in (("margins", _margins(flown, title)), ("energy", _energy(flown, title))):
            if figure is not None:
                path = folder / f"{name}.png"
                figure.savefig(path, dpi=150)
                written.append(path)
    return written


def _margins(flown: Sequence[RunResult], title: str) -> Figure | None:
    """Worst margin of every run, one panel per bound."""
    shown = [entry for entry in SHOWN if any(entry[0] in result.margins for result in flown)]
    if not shown:
        return None
    rows = (len(shown) + 1) // 2
    figure = Figure(figsize=(7.0, 1.9 * rows))
    for ax, (name, label, scale) in zip(figure.subplots(rows, 2, squeeze=False).flat, shown, strict=False):
        found = [result.margins[name] for result in flown if name in result.margins]
        values, tolerance = [scale * margin.margin for margin in found], scale * found[0].tolerance
        _histogram(ax, values, (min(*values, -1.5 * tolerance), max(*values, tolerance)), label)
        ax.axvline(0.0, **BOUND)
        ax.axvspan(-tolerance, 0.0, color="red", alpha=0.12, linewidth=0.0)
    if len(shown) % 2:
        figure.axes[-1].set_visible(False)
    figure.suptitle(f"{title}: worst margin of each of {len(flown)} runs (red = the bound, shaded = its tolerance)")
    return figure


def _energy(flown: Sequence[RunResult], title: str) -> Figure | None:
    """Energy of every lap."""
    laps = [energy for result in flown for energy in result.energy_j]
    if not laps:
        return None
    figure = Figure(figsize=(7.0, 2.8))
    ax = figure.subplots()
    _histogram(ax, laps, (0.0, max(laps)), "energy of a lap, everything on board [J]")
    median = float(np.median(laps))
    ax.axvline(median, color="#444444", linewidth=1.0, linestyle=":", label=f"median {median:.0f} J")
    legend_above(ax)
    figure.suptitle(f"{title}: {len(laps)} laps of {len(flown)} runs")
    return figure


def _histogram(ax: Axes, values: Sequence[float], span: tuple[float, float], label: str) -> None:
    ax.hist(values, bins=BINS, range=span, color="#1f77b4", edgecolor="white", linewidth=0.5)
    ax.set_xlabel(label)
    ax.yaxis.set_major_locator(MaxNLocator(integer=True))
