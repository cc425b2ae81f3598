"""Figures of a campaign: histograms of margins and energy, and failures over the drawn values."""

import math
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from autopilot.campaign.results import RunResult
from autopilot.campaign.summary import margin_unit
from autopilot.core.frames import FloatArray
from autopilot.log.figure_parts import (
    BOUND,
    LEAST_FOR_BAND,
    NARROW_IN,
    STYLE,
    draw_band,
    figure_of,
    legend_above,
    stacked_axes,
    width_in,
)
from autopilot.log.figures import DPI, save

BINS = 40
LETTERS_AN_IN = 14.0
"""Of a title."""
FEWEST_LAPS = 2
"""Of a curve over laps."""
FINER = {"m": ("mm", 1000.0), "m/s": ("mm/s", 1000.0), "rad/s": ("mrad/s", 1000.0)}
"""Unit of a margin -> unit in which it is drawn, and factor."""


def write_figures(results: Sequence[RunResult], title: str, folder: Path, style: Any = None) -> list[Path]:
    """``margins``, ``energy``, ``laps`` and ``failures`` in ``folder``, each as PNG and PDF; one without data is not
    written. ``style``: Matplotlib's settings, as of :func:`autopilot.log.figures.paper_style`.
    """
    flown = [result for result in results if result.flown]
    written = []
    with mpl.rc_context({**STYLE, "savefig.dpi": DPI, **(style or {})}):
        for name, figure in (
            ("margins", _margins(flown, title)),
            ("energy", _energy(flown, title)),
            ("laps", _laps(flown, title)),
            ("failures", _failure_map(results, title)),
        ):
            if figure is not None:
                written += save(figure, folder / f"{name}.png")
    return written


def _margins(flown: Sequence[RunResult], title: str) -> Figure | None:
    """Worst margin of every run, one panel per bound."""
    shown = list(dict.fromkeys(name for result in flown for name in result.margins))
    if not shown:
        return None
    rows = (len(shown) + 1) // 2
    figure = figure_of(1.9 * rows)
    for ax, name in zip(figure.subplots(rows, 2, squeeze=False).flat, shown, strict=False):
        unit, scale = FINER.get(margin_unit(name), (margin_unit(name), 1.0))
        found = [result.margins[name] for result in flown if name in result.margins]
        values, tolerance = [scale * margin.margin for margin in found], scale * found[0].tolerance
        _histogram(ax, values, (min(*values, -1.5 * tolerance), max(*values, tolerance)), f"{name} [{unit}]")
        ax.axvline(0.0, **BOUND)
        ax.axvspan(-tolerance, 0.0, color="red", alpha=0.12, linewidth=0.0)
    if len(shown) % 2:
        figure.axes[-1].set_visible(False)
    _title(figure, f"{title}: worst margin of each of {len(flown)} runs (red = the bound, shaded = its tolerance)")
    return figure


def _energy(flown: Sequence[RunResult], title: str) -> Figure | None:
    laps = [energy for result in flown for energy in result.energy_j]
    if not laps:
        return None
    figure = figure_of(2.8)
    ax = figure.subplots()
    _histogram(ax, laps, (0.0, max(laps)), "energy of a lap, everything on board [J]")
    median = float(np.median(laps))
    ax.axvline(median, color="#444444", linewidth=1.0, linestyle=":", label=f"median {median:.0f} J")
    legend_above(ax)
    _title(figure, f"{title}: {len(laps)} laps of {len(flown)} runs")
    return figure


def _laps(flown: Sequence[RunResult], title: str) -> Figure | None:
    """Median and band of SPREAD over the runs that flew as many laps."""
    laps = max((len(result.energy_j) for result in flown), default=0)
    if laps < FEWEST_LAPS or len(flown) < LEAST_FOR_BAND:
        return None
    figure, axes = stacked_axes(2, 4.2)
    numbers = np.arange(1.0, laps + 1.0)
    for ax, label, runs in (
        (axes[0], "energy of a lap [J]", [result.energy_j for result in flown]),
        (axes[1], "time of a lap [s]", [result.lap_s for result in flown]),
    ):
        of_lap = [[values[lap] for values in runs if len(values) > lap] for lap in range(laps)]
        draw_band(ax, numbers, of_lap, f"{len(flown)} runs")
        ax.set_ylabel(label)
        ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    legend_above(axes[0])
    axes[1].set_xlabel("lap")
    _title(figure, title)
    return figure


def _failure_map(results: Sequence[RunResult], title: str) -> Figure | None:
    """Least clearance of every run over each drawn value, failed runs in red; the most influential value first. A
    run that was not flown to its end has no clearance: it is drawn on the lower edge.
    """
    keys = [
        key
        for key in dict.fromkeys(key for result in results for key in result.drawn)
        if len({result.drawn.get(key) for result in results}) > 1
        and all(isinstance(result.drawn.get(key), float | int) for result in results)
    ]
    if not keys:
        return None
    clearance = np.array([math.nan if result.least_m is None else 1000.0 * result.least_m for result in results])
    failed = np.array([result.failed for result in results])
    lowest = float(np.nanmin(clearance)) if np.isfinite(clearance).any() else 0.0
    shown = np.where(np.isnan(clearance), min(lowest, 0.0) - 5.0, clearance)
    drawn = {key: np.array([float(result.drawn[key]) for result in results]) for key in keys}
    ranked = sorted(keys, key=lambda key: -abs(_rank_correlation(drawn[key], shown)))[:PANELS]
    columns = min(3 if width_in() >= NARROW_IN else 2, len(ranked))
    rows = -(-len(ranked) // columns)
    figure = figure_of(0.6 + 1.9 * rows)
    panels = figure.subplots(rows, columns, squeeze=False, sharey=True)
    for ax in panels.flat[len(ranked) :]:
        ax.set_visible(False)
    for ax, key in zip(panels.flat, ranked, strict=False):
        ax.plot(drawn[key][~failed], shown[~failed], ".", color="#1f77b4", markersize=3.0)
        ax.plot(drawn[key][failed], shown[failed], "x", color="red", markersize=5.0)
        ax.axhline(0.0, **BOUND)
        correlation = _rank_correlation(drawn[key], shown)
        ax.set_xlabel(f"{key.removeprefix('vehicle.')}\n(rank correlation {correlation:+.2f})")
        ax.xaxis.label.set_size(6.0)
    for ax in panels[:, 0]:
        ax.set_ylabel("least clearance [mm]")
    _title(figure, f"{title}: {int(failed.sum())} of {len(results)} runs failed (x)")
    return figure


PANELS = 12
"""Of the failure map: numbers that were drawn."""


def _rank_correlation(one: FloatArray, other: FloatArray) -> float:
    """Spearman's, without regard to ties; 0 if one of them does not vary."""
    ranks = [np.argsort(np.argsort(values)).astype(float) for values in (one, other)]
    if len(one) < 3 or np.ptp(one) == 0.0 or np.ptp(other) == 0.0:
        return 0.0
    return float(np.corrcoef(ranks[0], ranks[1])[0, 1])


def _title(figure: Figure, text: str) -> None:
    figure.suptitle(textwrap.fill(text, int(LETTERS_AN_IN * width_in())), fontsize=mpl.rcParams["font.size"])


def _histogram(ax: Axes, values: Sequence[float], span: tuple[float, float], label: str) -> None:
    ax.hist(values, bins=BINS, range=span, color="#1f77b4", edgecolor="white", linewidth=0.5)
    ax.set_xlabel(label)
    ax.yaxis.set_major_locator(MaxNLocator(integer=True))
