"""Plots of the report over a common time axis: bounds, mode bands, event marks, spectra, histograms."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, TypeAlias

import numpy as np
from bokeh.models import BoxAnnotation, ColumnDataSource, HoverTool, Legend, Range1d, Span
from bokeh.plotting import figure

from autopilot.core.frames import FloatArray

BUCKETS = 400
"""Slices of time; each curve keeps the smallest and the largest value of each."""
HEIGHT_PX = 250
LEGEND_PX, LEGEND_ROW_PX, KEY_PX, LETTER_PX = 320, 20, 32, 6
"""Width of a legend on a phone, height of its rows, width of a key and of a letter."""
LEFT_PX, RIGHT_PX = 76, 12
"""Margin beside the frame of every plot, the same for all, so that time axes are aligned."""
COLORS = ("#1f77b4", "#ff7f0e", "#2ca02c", "#d62728", "#9467bd", "#8c564b", "#e377c2", "#17becf")
TOOLS = "xpan,xwheel_zoom,box_zoom,crosshair,reset,save"
BOUND_COLOR, EVENT_COLOR, PARAMETER_COLOR = "#c62828", "#d08700", "#7b3fa0"
NAME_FRACTION = 0.08
"""Width of a mode's name, as a share of the sheet."""
EDGE = 0.06
"""Share of a plot's height that stays free above and below the curves."""


Items: TypeAlias = list[tuple[str, list[Any]]]
"""Of a legend: name and what is drawn."""
SEGMENT = 1024
"""Samples of a window at most: 10 s at 100 Hz."""
FEWEST = 64
"""With fewer samples there is no spectrum worth showing."""


def density(t_s: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray] | None:
    """Frequencies [Hz] and one-sided power density (Welch) [unit**2/Hz] of a curve (n,), its mean left
    out.

    Samples are put on even steps of their median interval first; None where there are too few.
    """
    finite = np.isfinite(values)
    t_s, values = t_s[finite], values[finite]
    if len(t_s) < FEWEST:
        return None
    step_s = float(np.median(np.diff(t_s)))
    if step_s <= 0.0:
        return None
    even = np.interp(np.arange(t_s[0], t_s[-1], step_s), t_s, values)
    size = min(SEGMENT, len(even))
    if size < FEWEST:
        return None
    window = np.hanning(size)
    starts = range(0, len(even) - size + 1, size // 2)
    parts = np.stack([even[start : start + size] for start in starts])
    parts = (parts - parts.mean(axis=1, keepdims=True)) * window
    power: Any = (np.abs(np.fft.rfft(parts, axis=1)) ** 2).mean(axis=0) * step_s / float((window**2).sum())
    power[1:-1] *= 2.0
    hz: Any = np.fft.rfftfreq(size, step_s)
    return hz[1:], power[1:]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Curve:
    name: str
    t_s: FloatArray
    values: FloatArray
    dashed: bool = False
    steps: bool = False
    """Holds its value until the next one."""
    turns: bool = False
    """Degrees on a circle: from +180 to -180 no line is drawn."""


@dataclass(frozen=True, slots=True)
class Band:
    start_s: float
    end_s: float
    name: str
    color: str


@dataclass(frozen=True, slots=True)
class Mark:
    t_s: float
    text: str
    color: str


def decimate(t_s: FloatArray, values: FloatArray, buckets: int = BUCKETS) -> tuple[FloatArray, FloatArray]:
    """The curve with at most two points per bucket of samples: its smallest and its largest value, in order of time."""
    count = len(values)
    if count <= 2 * buckets:
        return t_s, values
    edges = np.linspace(0, count, buckets + 1).astype(int)
    keep: set[int] = {0, count - 1}
    filled = np.nan_to_num(values, nan=0.0)
    for start, end in pairwise(edges.tolist()):
        part = filled[start:end]
        keep.update((start + int(part.argmin()), start + int(part.argmax())))
    rows = np.array(sorted(keep))
    return t_s[rows], values[rows]


def parted(t_s: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Degrees with a gap (NaN) wherever they go over the end of their circle."""
    jumps = np.flatnonzero(np.abs(np.diff(values)) > 180.0) + 1
    return np.insert(t_s, jumps, t_s[jumps]), np.insert(values, jumps, np.nan)


class TimeSheet:
    """Plots with a common time axis, shaded by mode, with the same marks."""

    def __init__(self, start_s: float, end_s: float, bands: Sequence[Band], marks: Sequence[Mark]) -> None:
        margin = 0.02 * max(end_s - start_s, 1.0)
        self.start_s, self.end_s = start_s - margin, end_s + margin
        self._range = Range1d(self.start_s, self.end_s)
        self._late_s = self.end_s - NAME_FRACTION * (self.end_s - self.start_s)
        self._bands, self._marks = bands, marks
        self._mark_source = ColumnDataSource(
            {"t": [mark.t_s for mark in marks], "color": [mark.color for mark in marks]}, name="marks"
        )

    def plot(
        self, label: str, curves: Sequence[Curve], bounds: Sequence[float] = (), *, log_scale: bool = False
    ) -> Any | None:
        """A plot over time, with its bounds in view; None without a curve that has values within its time."""
        shown = [curve for curve in curves if self._is_seen(curve, positive=log_scale)]
        if not shown:
            return None
        plot = self._figure(label, self._height(shown, bounds, log_scale=log_scale), log_scale=log_scale)
        for bound in bounds:
            plot.add_layout(
                Span(location=bound, dimension="width", line_color=BOUND_COLOR, line_dash="dashed", line_width=1)
            )
        items = []
        for index, curve in enumerate(shown):
            t_s, values = decimate(curve.t_s, curve.values)
            if curve.turns:
                t_s, values = parted(t_s, values)
            source = ColumnDataSource({"t": t_s.astype(np.float32), "y": values.astype(np.float32)}, name=curve.name)
            style = {"line_color": COLORS[index % len(COLORS)], "line_width": 1.3}
            style["line_dash"] = "dashed" if curve.dashed else "solid"
            draw = plot.step if curve.steps else plot.line
            mode = {"mode": "after"} if curve.steps else {}
            items.append((curve.name, [draw("t", "y", source=source, **mode, **style)]))
        add_legend(plot, items)
        return plot

    def _is_seen(self, curve: Curve, *, positive: bool) -> bool:
        """Whether it has at least the two points of a line."""
        known = np.isfinite(curve.values) & ((curve.values > 0.0) | (not positive))
        inside = (curve.t_s >= self.start_s) & (curve.t_s <= self.end_s)
        return int((known & inside).sum()) > 1

    def timeline(self) -> Any | None:
        """Modes by name and everything that is marked in the other plots, with its text."""
        if not self._bands and not self._marks:
            return None
        plot = self._figure("", Range1d(0.0, 1.0), height_px=150)
        plot.yaxis.visible = plot.ygrid.visible = False
        names = {band.name: band.color for band in self._bands}
        for name, color in names.items():
            mine = [band for band in self._bands if band.name == name]
            plot.quad(
                left=[band.start_s for band in mine],
                right=[band.end_s for band in mine],
                bottom=[0.0] * len(mine),
                top=[0.45] * len(mine),
                fill_color=color,
                line_color="#888888",
            )
            for late in (False, True):  # near the right edge the name is left of its band
                those = [band.start_s for band in mine if (band.start_s > self._late_s) is late]
                plot.text(
                    those,
                    [0.22] * len(those),
                    [name] * len(those),
                    text_font_size="9pt",
                    text_baseline="middle",
                    text_align="right" if late else "left",
                    x_offset=-3 if late else 3,
                )
        # Marks that lie close to each other stand at different heights.
        heights = [0.6 + 0.1 * (number % 4) for number in range(len(self._marks))]
        source = ColumnDataSource(
            {
                "t": [mark.t_s for mark in self._marks],
                "y": heights,
                "text": [mark.text for mark in self._marks],
                "color": [mark.color for mark in self._marks],
            },
            name="events",
        )
        dots = plot.scatter("t", "y", source=source, size=9, fill_color="color", line_color=None)
        plot.add_tools(HoverTool(renderers=[dots], tooltips=[("", "@text"), ("at", "@t{0.00} s")]))
        return plot

    def _figure(self, label: str, y_range: Any, *, log_scale: bool = False, height_px: int = HEIGHT_PX) -> Any:
        plot = figure(
            height=height_px,
            sizing_mode="stretch_width",
            x_range=self._range,
            y_range=y_range,
            y_axis_type="log" if log_scale else "linear",
            tools=TOOLS,
            toolbar_location="above",
            min_border_left=LEFT_PX,
            min_border_right=RIGHT_PX,
        )
        plot.toolbar.logo = None
        plot.xaxis.axis_label, plot.yaxis.axis_label = "time [s]", label
        if log_scale:
            plot.yaxis.ticker.desired_num_ticks = 3  # of one decade all labels would overlap
        for band in self._bands:
            plot.add_layout(
                BoxAnnotation(
                    left=band.start_s, right=band.end_s, fill_color=band.color, fill_alpha=0.5, level="underlay"
                )
            )
        if self._marks:
            plot.vspan("t", source=self._mark_source, line_color="color", line_width=1, line_alpha=0.35)
        return plot

    def _height(self, curves: Sequence[Curve], bounds: Sequence[float], *, log_scale: bool) -> Range1d:
        """Range of all curves within the time axis, and of every bound."""
        values = [np.array(bounds, dtype=float)]
        for curve in curves:
            inside = curve.values[(curve.t_s >= self.start_s) & (curve.t_s <= self.end_s)]
            values.append(inside if len(inside) else curve.values)
        found = np.concatenate(values)
        found = found[np.isfinite(found) & ((found > 0.0) | (not log_scale))]
        if not len(found):
            return Range1d(0.1, 1.0)
        low, high = float(found.min()), float(found.max())
        if log_scale:
            return Range1d(low / 1.5, high * 1.5)
        if high > low:
            margin = EDGE * (high - low)
        else:  # flat: the range of a count, a flag or a share is not narrowed to thousandths
            margin = max(0.1 * abs(high), 1.0) if high == round(high) else 0.5 * abs(high)
        return Range1d(low - margin, high + margin)


def add_legend(plot: Any, items: Items, place: str = "above") -> None:
    """A legend in as many columns as a phone has room for; the plot grows by its rows."""
    widest = max(len(name) for name, _ in items)
    columns = max(1, min(len(items), LEGEND_PX // (KEY_PX + LETTER_PX * widest)))
    legend = Legend(items=items, orientation="horizontal", ncols=columns, click_policy="hide", padding=2, margin=2)
    legend.label_text_font_size = "9pt"
    plot.height += LEGEND_ROW_PX * (-(-len(items) // columns) - 1)
    plot.add_layout(legend, place)


def plain_figure(x_label: str, y_label: str, **more: Any) -> Any:
    """A plot that is not over time."""
    plot = figure(
        height=260,
        sizing_mode="stretch_width",
        tools="pan,wheel_zoom,box_zoom,reset,save",
        toolbar_location="above",
        min_border_left=LEFT_PX,
        min_border_right=RIGHT_PX,
        **more,
    )
    plot.toolbar.logo = None
    plot.xaxis.axis_label, plot.yaxis.axis_label = x_label, y_label
    return plot


def spectrum(label: str, curves: Sequence[tuple[str, tuple[FloatArray, FloatArray] | None]]) -> Any | None:
    """Power densities over frequency, both on logarithmic axes."""
    shown = [(name, found) for name, found in curves if found is not None and (found[1] > 0.0).any()]
    if not shown:
        return None
    plot = plain_figure("frequency [Hz]", label, x_axis_type="log", y_axis_type="log")
    items = []
    for index, (name, (hz, power)) in enumerate(shown):
        keep = power > 0.0
        source = ColumnDataSource(
            {"t": hz[keep].astype(np.float32), "y": power[keep].astype(np.float32)}, name=f"{name} (over Hz)"
        )
        items.append((name, [plot.line("t", "y", source=source, line_color=COLORS[index % len(COLORS)])]))
    add_legend(plot, items)
    return plot


def histogram(label: str, values: FloatArray, limit: float, limit_name: str) -> Any | None:
    """How often which value was, on a logarithmic axis that holds the largest value and the limit."""
    values = values[np.isfinite(values) & (values > 0.0)]
    if not len(values):
        return None
    low, high = 0.8 * float(values.min()), 1.25 * max(float(values.max()), limit)
    edges = np.geomspace(low, high, 61)
    counts, _ = np.histogram(values, edges)
    top = 2.0 * float(counts.max())
    plot = plain_figure(
        label, "steps [-]", x_axis_type="log", y_axis_type="log", x_range=(low, high), y_range=(0.5, top)
    )
    some = counts > 0
    bars = {"t": edges[:-1][some], "right": edges[1:][some], "y": counts[some]}
    source = ColumnDataSource(bars, name="steps from here to the next")
    plot.quad(left="t", right="right", top="y", bottom=0.5, line_color="white", source=source)
    marks = (
        (f"median {np.median(values):.3g}", float(np.median(values)), "#444444"),
        (f"p99 {np.percentile(values, 99.0):.3g}", float(np.percentile(values, 99.0)), "#ff7f0e"),
        (f"longest {values.max():.3g}", float(values.max()), "#9467bd"),
        (f"{limit_name} {limit:g}", limit, BOUND_COLOR),
    )
    items = []
    for name, at, color in marks:
        line = plot.line([at, at], [0.5, top], line_color=color, line_width=2, line_dash="dashed")
        items.append((name, [line]))
    add_legend(plot, items)
    return plot
