"""Common parts of all figures: data of a run, style, axes, bounds, legends."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from autopilot.core.errors import LogError
from autopilot.core.frames import FloatArray
from autopilot.log.analysis import FlightRecord, Span, VehicleTrack, Visit, flown_laps, load_flight, visits
from autopilot.log.reader import Log

LAP_COLORS = ("#1f77b4", "#ff7f0e", "#2ca02c", "#9467bd", "#8c564b", "#17becf")
LISTED_LAPS = len(LAP_COLORS)
"""More laps go over from one colour to another, and only some are named."""
NAMED_LAPS = 4
MOST_TURNS_RAD = 6.0 * math.pi
"""Beyond so many turns the axis is wrapped to -pi to pi."""
BOUND: dict[str, Any] = {"color": "red", "linestyle": "--", "linewidth": 1.0}
TRUTH: dict[str, Any] = {"color": "#1f77b4", "linewidth": 1.2}
ESTIMATE: dict[str, Any] = {"color": "#444444", "linewidth": 0.8, "linestyle": ":"}
BAND: dict[str, Any] = {"color": "#2ca02c", "alpha": 0.18, "linewidth": 0.0}
LEAST_FOR_BAND = 3
"""Flights; of fewer a band says nothing."""
SPREAD = (0.05, 0.95)
"""Quantiles between which a band lies."""
MARKED = 20
"""Fewer places of a band than that are marked."""
WIDTH_IN = 7.0
NARROW_IN = 5.0
"""Narrower figures have their pairs of axes below each other."""
LEAST_HEIGHT = 0.7
"""Of the height at WIDTH_IN."""
LEGEND_COLUMN_IN = 1.35
STYLE: Any = {
    "font.size": 9.0,
    "font.family": "DejaVu Sans",
    "figure.figsize": (WIDTH_IN, 4.8),
    "pdf.fonttype": 42,
    "ps.fonttype": 42,
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
class FigureScene:
    """Data of a run for all figures."""

    flight: FlightRecord
    track: VehicleTrack
    """The truth (or the estimate if there is none), while armed."""
    tour: tuple[Visit, ...]
    laps: tuple[Span, ...]

    @property
    def name(self) -> str:
        return self.flight.log.path.stem

    @property
    def basis(self) -> str:
        return "truth" if self.flight.truth is not None else "estimate"

    def bound(self, name: str) -> float | None:
        """A bound that the controller was given."""
        return self.flight.run.paper_bounds.get(name) if self.flight.run is not None else None


def make_scene(log: Log) -> FigureScene:
    flight = load_flight(log)
    track = flight.judged.between(flight.armed)
    if not len(track.t_s):
        raise LogError(f"{log.path}: the vehicle's track is empty; there is nothing to draw")
    tour = visits(track, flight.run) if flight.run is not None else []
    return FigureScene(flight=flight, track=track, tour=tuple(tour), laps=tuple(flown_laps(flight)))


def lap_colors(count: int) -> list[str]:
    if count <= LISTED_LAPS:
        return list(LAP_COLORS[:count])
    shades = mpl.colormaps["viridis"](np.linspace(0.0, 0.92, count))
    return [mpl.colors.to_hex(shade) for shade in shades]


def named_laps(count: int) -> set[int]:
    """Which laps (from 0) a legend names."""
    if count <= LISTED_LAPS:
        return set(range(count))
    return {round(fraction * (count - 1)) for fraction in np.linspace(0.0, 1.0, NAMED_LAPS)}


def width_in() -> float:
    """Width of figures by the style in force."""
    return float(mpl.rcParams["figure.figsize"][0])


def figure_of(height_in: float) -> Figure:
    """A figure of a height at WIDTH_IN, as wide as the style has it."""
    return Figure(figsize=(width_in(), height_in * min(max(width_in() / WIDTH_IN, LEAST_HEIGHT), 1.0)))


def pair_of_axes(height_in: float) -> tuple[Figure, Axes, Axes]:
    """A wide one and a narrow one beside it, or below it in a narrow figure."""
    wide = width_in() >= NARROW_IN
    figure = figure_of(height_in if wide else 2.2 * height_in)
    first, second = figure.subplots(1, 2, width_ratios=(2.0, 1.0)) if wide else figure.subplots(2, 1)
    return figure, first, second


def stacked_axes(rows: int, height_in: float) -> tuple[Figure, list[Axes]]:
    figure = figure_of(height_in)
    grid = figure.subplots(rows, 1, sharex=True, squeeze=False)
    return figure, [row[0] for row in grid]


def time_axis(scene: FigureScene, axes: list[Axes]) -> None:
    """Label the lowest axes and mark the laps on all of them."""
    axes[-1].set_xlabel("time [s]")
    axes[-1].set_xlim(float(scene.track.t_s[0]), float(scene.track.t_s[-1]))
    for ax in axes:
        for lap in scene.laps:
            ax.axvline(lap.end_s, color="#999999", linewidth=0.6)


def draw_band(
    ax: Axes,
    at: FloatArray,
    samples: Sequence[FloatArray | Sequence[float]],
    of: str,
    middle: FloatArray | None = None,
) -> None:
    """Median (or ``middle``) and SPREAD of the samples at each place. ``of``: how many of what they are of."""
    low, median, high = np.array([np.quantile(values, (SPREAD[0], 0.5, SPREAD[1])) for values in samples]).T
    ax.fill_between(at, low, high, label=f"{100.0 * SPREAD[0]:.0f} to {100.0 * SPREAD[1]:.0f} % of {of}", **BAND)
    label = "median" if middle is None else "median flight"
    middle = median if middle is None else middle
    ax.plot(at, middle, marker="." if len(at) < MARKED else "", label=label, **TRUTH)


def draw_bounds(ax: Axes, *values: float | None) -> None:
    shown = [value for value in values if value is not None]
    for index, value in enumerate(shown):
        ax.axhline(value, label="bound" if index == 0 else None, **BOUND)


def extend_limits(ax: Axes, *values: float | None) -> None:
    """Widen the y range so that bounds do not lie on the frame."""
    low, high = ax.get_ylim()
    lower, upper = min(low, high), max(low, high)
    known = [value for value in values if value is not None]
    lower, upper = min([lower, *known]), max([upper, *known])
    margin = 0.06 * (upper - lower)
    ax.set_ylim(lower - margin, upper + margin)


def legend_above(ax: Axes, columns: int = 3) -> None:
    """Put a legend above the axes, once everything is drawn."""
    handles, labels = ax.get_legend_handles_labels()
    columns = max(1, min(columns, int(width_in() / LEGEND_COLUMN_IN)))
    if labels:
        ax.legend(handles, labels, loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=columns, borderaxespad=0.1)
