"""The interactive plots of the HTML report: linked in time, shaded by mode, decimated so that no spike is lost."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from bokeh.models import BoxAnnotation, Legend, Range1d, Span
from bokeh.plotting import figure

from autopilot.core.frames import FloatArray
from autopilot.log.analysis import Flight, Track, estimate_error, lap_spans, seconds, thruster_names, visits
from autopilot.log.description import RunDescription
from autopilot.log.scene import outline
from autopilot.log.topics import AID_PREFIX

BUCKETS = 700
"""Each curve keeps the smallest and the largest value of so many slices of time."""
HEIGHT_PX = 230
COLORS = ("#1f77b4", "#ff7f0e", "#2ca02c", "#d62728", "#9467bd", "#8c564b", "#e377c2", "#17becf")
MODE_COLORS = ("#dbe9f6", "#e5f5e0", "#fee8c8", "#efedf5", "#fde0ef")
TOOLS = "xpan,xwheel_zoom,box_zoom,crosshair,reset,save"


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Curve:
    """One line of a plot."""

    name: str
    t_s: FloatArray
    values: FloatArray


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


class Plots:
    """Plots of one flight with a common time axis."""

    def __init__(self, flight: Flight) -> None:
        """Lay out the time axis: the flight with a little before and after it."""
        self._flight = flight
        self._track = flight.judged
        start, end = flight.armed.start_s, flight.armed.end_s
        margin = 0.02 * max(end - start, 1.0)
        self._range = Range1d(start - margin, end + margin)
        self._modes = _mode_spans(flight)

    def all(self) -> dict[str, Any]:
        """Title -> plot, of everything that the log has data for."""
        flight = self._flight
        plots: dict[str, Any] = {"Plan": self._plan()}
        tracks = [("truth", flight.truth), ("estimate", flight.nav)]
        known = [(name, track) for name, track in tracks if track is not None]
        for index, title in enumerate(("x, north", "y, east", "z, depth")):
            curves = [Curve(name=n, t_s=t.t_s, values=t.pos_ned_m[:, index]) for n, t in known]
            plots[title] = self._plot(f"{title} [m]", curves)
        plots["Attitude"] = self._attitude(known)
        plots["Planar speed"] = self._speed(known)
        plots["Heave"] = self._component("w [m/s]", known, "vel_water_frd_m_s", self._bound("heave_m_s"))
        plots["Yaw rate"] = self._component("r [rad/s]", known, "rate_frd_rad_s", self._bound("yaw_rate_rad_s"))
        plots["Thrust commands"] = self._thrust()
        plots["Estimate minus truth"] = self._errors()
        plots["Current"] = self._current(known)
        plots["Aiding: test ratio (above 1 = rejected)"] = self._aids()
        plots["NMPC step"] = self._topic_plot("/ctl/nmpc", "solve_s", "solve time [ms]", 1000.0)
        plots["Smallest clearance in the prediction"] = self._topic_plot("/ctl/nmpc", "margin_m", "margin [m]", 1.0)
        plots["Electrical power"] = self._topic_plot("/sim/thrusters", "power_w", "power [W]", 1.0)
        plots["Battery"] = self._topic_plot("/in/power_raw", "voltage_v", "voltage [V]", 1.0)
        return {title: plot for title, plot in plots.items() if plot is not None}

    def _bound(self, name: str) -> tuple[float, ...]:
        run = self._flight.run
        value = run.paper_bounds.get(name) if run is not None else None
        return () if value is None else (-value, value)

    def _plot(self, label: str, curves: Sequence[Curve], bounds: Sequence[float] = ()) -> Any | None:
        """A plot over time; None without a curve that has values."""
        shown = [curve for curve in curves if len(curve.t_s)]
        if not shown:
            return None
        plot = figure(height=HEIGHT_PX, sizing_mode="stretch_width", x_range=self._range, tools=TOOLS)
        plot.toolbar.logo = None
        plot.xaxis.axis_label, plot.yaxis.axis_label = "time [s]", label
        for start, end, color in self._modes:
            plot.add_layout(BoxAnnotation(left=start, right=end, fill_color=color, fill_alpha=0.6, level="underlay"))
        for bound in bounds:
            line = Span(location=bound, dimension="width", line_color="red", line_dash="dashed", line_width=1)
            plot.add_layout(line)
        items = []
        for index, curve in enumerate(shown):
            t_s, values = decimate(curve.t_s, curve.values)
            color = COLORS[index % len(COLORS)]
            line = plot.line(t_s, values.astype(np.float32), line_color=color, line_width=1.3)
            items.append((curve.name, [line]))
        legend = Legend(items=items, orientation="horizontal", label_text_font_size="9pt", padding=2, margin=2)
        legend.click_policy = "hide"
        plot.add_layout(legend, "above")
        return plot

    def _component(
        self, label: str, known: Sequence[tuple[str, Track]], field: str, bounds: Sequence[float]
    ) -> Any | None:
        """The third component of a vector, with bounds."""
        curves = [Curve(name=name, t_s=track.t_s, values=getattr(track, field)[:, 2]) for name, track in known]
        return self._plot(label, curves, bounds)

    def _attitude(self, known: Sequence[tuple[str, Track]]) -> Any | None:
        curves = []
        for name, track in known:
            degrees = np.degrees(np.unwrap(track.rpy_rad, axis=0))
            for index, axis in enumerate(("roll", "pitch", "yaw")):
                curves.append(Curve(name=f"{axis} {name}", t_s=track.t_s, values=degrees[:, index]))
        return self._plot("angle [deg]", curves)

    def _speed(self, known: Sequence[tuple[str, Track]]) -> Any | None:
        curves = [Curve(name=f"norm {name}", t_s=track.t_s, values=track.planar_speed_m_s) for name, track in known]
        curves.append(Curve(name="|u + v|", t_s=self._track.t_s, values=self._track.literal_speed_m_s))
        return self._plot("speed in the water [m/s]", curves, self._bound("planar_speed_m_s")[1:])

    def _thrust(self) -> Any | None:
        table = self._flight.table("/out/thrusters")
        if table is None:
            return None
        names = thruster_names(self._flight, table)
        t_s, thrust = seconds(table), table["thrust_n"]
        curves = [Curve(name=name, t_s=t_s, values=thrust[:, index]) for index, name in enumerate(names)]
        return self._plot("thrust [N]", curves, self._bound("thrust_n"))

    def _errors(self) -> Any | None:
        flight = self._flight
        if flight.truth is None or flight.nav is None:
            return None
        error = estimate_error(flight.truth, flight.nav.between(flight.armed))
        if error is None:
            return None
        curves = [Curve(name=f"{'xyz'[i]} [mm]", t_s=error.t_s, values=1e3 * error.pos_ned_m[:, i]) for i in range(3)]
        curves.append(Curve(name="yaw [0.1 deg]", t_s=error.t_s, values=10.0 * np.degrees(error.yaw_rad)))
        return self._plot("error", curves)

    def _current(self, known: Sequence[tuple[str, Track]]) -> Any | None:
        curves = [
            Curve(name=f"{axis} {name}", t_s=track.t_s, values=track.current_ned_m_s[:, index])
            for index, axis in enumerate(("north", "east"))
            for name, track in known
        ]
        return self._plot("current [m/s]", curves)

    def _aids(self) -> Any | None:
        log = self._flight.log
        tables = {topic: self._flight.table(topic) for topic in log.topics if topic.startswith(AID_PREFIX)}
        curves = [
            Curve(name=topic.removeprefix(AID_PREFIX), t_s=seconds(table), values=table["test_ratio"])
            for topic, table in tables.items()
            if table is not None
        ]
        return self._plot("test ratio", curves, (1.0,))

    def _topic_plot(self, topic: str, field: str, label: str, scale: float) -> Any | None:
        table = self._flight.table(topic)
        if table is None:
            return None
        return self._plot(label, [Curve(name=topic, t_s=seconds(table), values=scale * table[field])])

    def _plan(self) -> Any:
        """The tank from above: x to the right, y down."""
        plot = figure(
            height=460,
            sizing_mode="stretch_width",
            match_aspect=True,
            tools="pan,wheel_zoom,box_zoom,reset,save",
        )
        plot.toolbar.logo = None
        plot.xaxis.axis_label, plot.yaxis.axis_label = "x, north [m]", "y, east [m]"
        plot.y_range.flipped = True
        run = self._flight.run
        track = self._track.between(self._flight.armed)
        if run is not None:
            _draw_world(plot, run)
        rows = np.arange(0, len(track.t_s), max(1, len(track.t_s) // (4 * BUCKETS)))
        x, y = track.pos_ned_m[rows, 0].astype(np.float32), track.pos_ned_m[rows, 1].astype(np.float32)
        plot.line(x, y, line_color="#bbbbbb", line_width=1)
        laps = lap_spans(visits(track, run), run) if run is not None else []
        for number, lap in enumerate(laps):
            keep = lap.holds(track.t_s[rows])
            color = COLORS[number % len(COLORS)]
            plot.line(x[keep], y[keep], line_color=color, line_width=1.5, legend_label=f"lap {number + 1}")
        if laps:
            plot.legend.click_policy = "hide"
        return plot


def _draw_world(plot: Any, run: RunDescription) -> None:
    if run.tank_polygon_m:
        corners = np.array(run.tank_polygon_m)
        plot.patch(corners[:, 0], corners[:, 1], fill_color=None, line_color="black", line_width=2)
    for shape in run.fence:
        corners = np.array(outline(shape))
        plot.patch(corners[:, 0], corners[:, 1], fill_color=None, line_color="#d62728", line_width=1)
    for obstacle in run.obstacles:
        north, east = obstacle.center_m[0], obstacle.center_m[1]
        zone = obstacle.radius_m + run.body_radius_m
        plot.circle([north], [east], radius=obstacle.radius_m, fill_color="#777777", line_color="black")
        plot.circle([north], [east], radius=zone, fill_color=None, line_color="red", line_dash="dashed")
    for waypoint in run.waypoints:
        north, east, _ = waypoint.pos_ned_m
        plot.circle(
            [north], [east], radius=waypoint.accept_radius_m, fill_color="#2ca02c", fill_alpha=0.2, line_color=None
        )
        plot.text([north], [east], text=[waypoint.name], text_align="center", text_baseline="middle")


def _mode_spans(flight: Flight) -> list[tuple[float, float, str]]:
    """Start, end and colour of every stretch of one mode while armed."""
    mode = flight.table("/sys/mode")
    if mode is None:
        return []
    t_s, key = seconds(mode), np.where(mode["armed"] != 0, mode["custom_mode"].astype(np.int64) + 1, 0)
    change = np.flatnonzero(np.diff(key)) + 1
    starts, ends = [0, *change.tolist()], [*change.tolist(), len(key)]
    numbers = sorted({int(value) for value in key if value})
    spans = []
    for first, after in zip(starts, ends, strict=True):
        if key[first]:
            end_s = float(t_s[after]) if after < len(t_s) else flight.armed.end_s
            spans.append((float(t_s[first]), end_s, MODE_COLORS[numbers.index(int(key[first])) % len(MODE_COLORS)]))
    return spans
