"""List of the plots of the HTML report, by subject."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any, TypeAlias

import numpy as np
from bokeh.models import ColumnDataSource
from bokeh.palettes import viridis
from numpy.typing import NDArray

from autopilot.core.frames import FloatArray
from autopilot.core.geometry import lengths_m
from autopilot.core.marks import ServiceThread
from autopilot.log import analysis
from autopilot.log.analysis import (
    FlightRecord,
    Prediction,
    VehicleTrack,
    along_track,
    energy_j,
    estimate_error,
    flown_laps,
    foreseen,
    position_nees,
    predictions,
    seconds,
    thruster_names,
)
from autopilot.log.check_more import MOST_REPROJECTION_PX
from autopilot.log.check_outside import LEAST_CPU_MS_S, round_trips
from autopilot.log.description import RunDescription
from autopilot.log.plan_summary import MetCurrent, MovedObstacle, met_current, moved_obstacles
from autopilot.log.report_draw import (
    BUCKETS,
    COLORS,
    EVENT_COLOR,
    PARAMETER_COLOR,
    Band,
    Curve,
    Items,
    Mark,
    TimeSheet,
    add_legend,
    density,
    histogram,
    plain_figure,
    spectrum,
)
from autopilot.log.scene import outline
from autopilot.log.thruster_energy import thruster_power
from autopilot.log.topics import AID_PREFIX

Subject: TypeAlias = dict[str, Any]
"""Title -> plot, None where the log has no data for it."""

TOPICS = (
    *("/ctl/horizon", "/ctl/thrusters", "/ctl/plan", "/nav/shadow", "/nav/thrust", "/in/ahrs_raw", "/in/imu"),
    *("/in/markers", "/in/mavlink", "/out/mavlink", "/in/power_raw", "/in/hull", "/sys/parameters", "/rosout"),
    *("/in/camera", "/in/tick"),
)
"""Beside those that are judged."""
MODE_COLORS = ("#dbe9f6", "#e5f5e0", "#fee8c8", "#efedf5", "#fde0ef", "#e0f3f3")
CONTROL_PERIOD_MS = 50.0
"""Time budget of a control step (docs/architecture.md)."""
TICK_MS = 10.0
AHEAD_S = 1.0
"""Prediction time of the comparison with the actual motion."""
HORIZONS = 12
"""Predictions that the plan shows."""
MARKED_LEVEL = 20
"""Least level of rcl_interfaces/Log of the events that are marked: messages to operators."""
MOST_MARKS = 300
MOST_TURNS_DEG = 1080.0
"""Beyond so many turns the axis is wrapped to -180 to 180 degrees."""
PLAN_ASPECT = 1.15
"""Width over height of the plan with its legend."""
MOST_LAPS = 8
"""Maximum number of laps with a colour of their own; more use a colour scale."""
LAPS_NAMED = 4
"""Maximum number of these that the plan names."""
HEADS = 8
"""Arrow heads of the last lap, which show its direction;"""
HEAD_FRACTION, HEAD_M = 0.018, 0.05
"""half their length as a share of the plan's, and the distance over which their direction is taken."""


class Plots:
    """Plots of one flight with a common time axis."""

    def __init__(self, flight: FlightRecord) -> None:
        """Lay out the time axis: the flight with a little before and after it."""
        self._flight = flight
        self._track = flight.judged
        self.bands, self.marks = mode_bands(flight), event_marks(flight)
        self._sheet = TimeSheet(flight.armed.start_s, flight.armed.end_s, self.bands, self.marks)
        self._predictions = predictions(flight.log)
        tracks = [("truth", flight.truth), ("estimate", flight.nav)]
        self._known = [(name, track) for name, track in tracks if track is not None]

    def all(self) -> dict[str, Subject]:
        """Subject -> its plots, of everything that the log has data for."""
        subjects: dict[str, Subject] = {
            "Overview": {"Modes and events": self._sheet.timeline(), "Plan": self._plan()},
            "Tracking": self._tracking(),
            "Bounds": self._bounds(),
            "Controller": self._controller(),
            "Estimator": self._estimator(),
            "Camera": self._camera(),
            "Thrusters": self._thrusters(),
            "Current": self._current(),
            "Power": self._power(),
            "Motion sensors": self._inertial(),
            "Links and loop": self._system(),
        }
        shown = {name: {title: p for title, p in plots.items() if p is not None} for name, plots in subjects.items()}
        return {name: plots for name, plots in shown.items() if plots}

    def _of(self, topic: str, label: str, *fields: tuple[str, str], scale: float = 1.0, **given: Any) -> Any | None:
        """Fields of a topic over time, each with the name of its curve; None without the topic. ``given``: bounds and
        scale of the axis; ``steps`` of the curves."""
        table, steps = self._flight.table(topic), given.pop("steps", False)
        if table is None:
            return None
        t_s = seconds(table)
        curves = [
            Curve(name=name, t_s=t_s, values=scale * table[field].astype(float), steps=steps) for name, field in fields
        ]
        return self._sheet.plot(label, curves, **given)

    def _tracking(self) -> Subject:
        """Positions and heading beside their references."""
        goal = self._flight.table("/ctl/goal")
        then_s, then_m = foreseen(self._predictions, AHEAD_S)
        planned = f"planned {AHEAD_S:g} s before"
        plots: Subject = {}
        for index, title in enumerate(("x, north", "y, east", "z, depth")):
            curves = [Curve(name=n, t_s=t.t_s, values=t.pos_ned_m[:, index]) for n, t in self._known]
            if goal is not None:
                values = goal["pos_ned_m"][:, index]
                curves.append(Curve(name="set point", t_s=seconds(goal), values=values, dashed=True, steps=True))
            if len(then_s):
                curves.append(Curve(name=planned, t_s=then_s, values=then_m[:, index], dashed=True))
            plots[title] = self._sheet.plot(f"{title} [m]", curves)
        yaw = [Curve(name=n, t_s=t.t_s, values=unwrapped_deg(t.rpy_rad[:, 2])) for n, t in self._known]
        yaw = yaw[:1] + [replace(curve, values=same_turn(curve, yaw[0])) for curve in yaw[1:]]
        if goal is not None and yaw:
            near = np.interp(seconds(goal), yaw[0].t_s, yaw[0].values)
            aimed = aimed_yaw(np.where(goal["yaw_free"] != 0, np.nan, np.degrees(goal["yaw_rad"])), near)
            yaw.append(Curve(name="set point", t_s=seconds(goal), values=aimed, dashed=True, steps=True))
        if yaw and float(np.ptp(yaw[0].values)) > MOST_TURNS_DEG:
            yaw = [replace(curve, values=(curve.values + 180.0) % 360.0 - 180.0, turns=True) for curve in yaw]
        plots["Yaw"] = self._sheet.plot("yaw [deg]", yaw)
        tilts = [
            Curve(name=f"{axis} {name}", t_s=track.t_s, values=np.degrees(track.rpy_rad[:, index]))
            for name, track in self._known
            for index, axis in enumerate(("roll", "pitch"))
        ]
        plots["Roll and pitch"] = self._sheet.plot("angle [deg]", tilts)
        track = self._track
        seen = then_s <= float(track.t_s[-1])
        then_s, then_m = then_s[seen], then_m[seen]
        if len(then_s):
            missed = [
                Curve(
                    name=axis,
                    t_s=then_s,
                    values=1e3 * (np.interp(then_s, track.t_s, track.pos_ned_m[:, i]) - then_m[:, i]),
                )
                for i, axis in enumerate("xyz")
            ]
            plots[f"Position: {AHEAD_S:g} s prediction error"] = self._sheet.plot("error [mm]", missed)
        return plots

    def _bounds(self) -> Subject:
        flight, track = self._flight, self._track
        speeds = [Curve(name=f"norm {name}", t_s=t.t_s, values=t.planar_speed_m_s) for name, t in self._known]
        speeds.append(Curve(name="|u + v|", t_s=track.t_s, values=track.literal_speed_m_s))
        return {
            "Clearance margins": self._sheet.plot("margin [m]", clearances(flight), (0.0,)),
            "Planar speed": self._sheet.plot("speed in the water [m/s]", speeds, self._bound("planar_speed_m_s")[1:]),
            "Heave": self._component("w [m/s]", "vel_level_m_s", self._bound("heave_m_s")),
            "Yaw rate": self._component("r [rad/s]", "rate_frd_rad_s", self._bound("yaw_rate_rad_s")),
        }

    def _controller(self) -> Subject:
        table = self._flight.table("/ctl/nmpc")
        if table is None:
            return {}
        t_s, solve_ms = seconds(table), 1e3 * table["solve_s"]
        solved = solve_ms > 0.0

        of = partial(self._of, "/ctl/nmpc")
        return {
            "Time of a control step": self._sheet.plot(
                "CPU time [ms]",
                [Curve(name="control step", t_s=t_s[solved], values=solve_ms[solved])],
                (CONTROL_PERIOD_MS,),
                log_scale=True,
            ),
            "Distribution of control step times": histogram(
                "CPU time of a step [ms]", solve_ms, CONTROL_PERIOD_MS, "deadline"
            ),
            "Quadratic programs solved": of("iterations [-]", ("iterations", "iterations")),
            "Status (0 ok) and fallback (1 shifted plan, 2 station keeping, 3 neutral)": of(
                "code [-]", ("status", "status"), ("fallback", "fallback"), steps=True
            ),
            "Cost": of("cost [-]", ("cost", "cost")),
            "Largest slack of soft limits": of("slack [-]", ("slack_max", "slack_max")),
            "Smallest clearance in the prediction, and tube": of(
                "distance [m]", ("clearance", "margin_m"), ("tube", "tube_m")
            ),
            "Predicted energy to the goal": self._of(
                "/ctl/plan", "energy [J]", ("energy to the goal", "energy_j"), steps=True
            ),
        }

    def _estimator(self) -> Subject:
        flight, plots = self._flight, Subject()
        covariance = flight.table("/nav/covariance")
        error = None
        if flight.truth is not None and flight.nav is not None:
            error = estimate_error(flight.truth, flight.nav.between(flight.armed))
        kinds = [(f"{axis} [mm]", 1e3, i) for i, axis in enumerate("xyz")] + [("yaw [deg]", float(np.degrees(1.0)), 5)]
        for label, scale, index in kinds:
            curves = []
            if error is not None:
                values = scale * (error.yaw_rad if index == 5 else error.pos_ned_m[:, index])
                curves.append(Curve(name="estimate minus truth", t_s=error.t_s, values=values))
            if covariance is not None:
                t_s, sigma = seconds(covariance), scale * np.sqrt(np.maximum(covariance["variance"][:, index], 0.0))
                keep = flight.armed.holds(t_s)
                for sign in (3.0, -3.0):
                    name = f"{sign:+.0f} sigma"
                    curves.append(Curve(name=name, t_s=t_s[keep], values=sign * sigma[keep], dashed=True))
            plots[f"Error of the estimate: {label.split()[0]}"] = self._sheet.plot(label, curves)
        if error is not None and covariance is not None:
            nees = position_nees(error.t_s, error.pos_ned_m, seconds(covariance), covariance["variance"])
            plots["NEES of the position (3 degrees of freedom, 95 % band)"] = self._sheet.plot(
                "NEES [-]", [Curve(name="NEES", t_s=error.t_s, values=nees)], CHI2_3, log_scale=True
            )
        ratios = []
        for topic in (name for name in flight.log.topics if name.startswith(AID_PREFIX)):
            table = flight.table(topic)
            if table is None:
                continue
            sensor, t_s = topic.removeprefix(AID_PREFIX), seconds(table)
            ratios.append(Curve(name=sensor, t_s=t_s, values=table["test_ratio"]))
            sigma = np.sqrt(table["innovation_var"])
            used = [i for i in range(3) if (sigma[:, i] > 0.0).any()]
            over = [
                Curve(name=f"{sensor} {i + 1}", t_s=t_s, values=_ratio(table["innovation"][:, i], sigma[:, i]))
                for i in used
            ]
            plots[f"Innovations of {sensor} over their sigma"] = self._sheet.plot(
                "innovation / sigma [-]", over, (-3.0, -2.0, 2.0, 3.0)
            )
        plots["Aiding: test ratio (above 1 = rejected)"] = self._sheet.plot("test ratio [-]", ratios, (1.0,))
        plots["Shadow estimator"] = self._of(
            "/nav/shadow", "ratio [-]", ("largest difference over its bound", "ratio"), bounds=(1.0,)
        )
        return plots

    def _camera(self) -> Subject:
        table = self._flight.table("/in/markers")
        if table is None:
            return {}
        t_s = seconds(table)
        gap = Curve(name="since the picture before", t_s=t_s[1:], values=1e3 * np.diff(t_s))
        decode = Curve(name="detection", t_s=t_s, values=1e-3 * table["decode_us"])
        return {
            "Markers in the picture": self._of("/in/markers", "markers [-]", ("markers", "count")),
            "Time between pictures and of detection": self._sheet.plot("time [ms]", [gap, decode]),
            "Reprojection error": self._of(
                "/nav/fit",
                "error [px]",
                *(("rms of the corners", "rms_px"), ("worst corner", "worst_px")),
                bounds=(MOST_REPROJECTION_PX,),
            ),
        }

    def _thrusters(self) -> Subject:
        table, acting = self._flight.table("/out/thrusters"), self._flight.table("/sim/thrusters")
        if table is None:
            return {}
        names = thruster_names(self._flight, table)
        t_s, thrust = seconds(table), table["thrust_n"]
        plots: Subject = {}
        bounds = self._bound("thrust_n")
        for index, name in enumerate(names):
            curves = [Curve(name="command", t_s=t_s, values=thrust[:, index], steps=True)]
            if acting is not None:
                curves.append(Curve(name="acting", t_s=seconds(acting), values=acting["thrust_n"][:, index]))
            plots[f"Thruster {name}"] = self._sheet.plot("thrust [N]", curves, bounds)
        spectra = [(name, density(t_s, thrust[:, index])) for index, name in enumerate(names)]
        plots["Spectra of the thrust commands"] = spectrum("density [N²/Hz]", spectra)
        health = self._flight.table("/ctl/thrusters")
        if health is not None:
            effectiveness = [
                Curve(name=name, t_s=seconds(health), values=100.0 * health["effectiveness"][:, index], steps=True)
                for index, name in enumerate(names)
            ]
            plots["Thruster effectiveness"] = self._sheet.plot("effectiveness [%]", effectiveness)
        return plots

    def _current(self) -> Subject:
        curves = [
            Curve(name=f"{axis} {name}", t_s=track.t_s, values=track.current_ned_m_s[:, index])
            for index, axis in enumerate(("north", "east"))
            for name, track in self._known
        ]
        along = [Curve(name=name, t_s=t.t_s, values=along_track(t)) for name, t in self._known]
        return {
            "Current": self._sheet.plot("current [m/s]", curves),
            "Current along the path (above 0 = following)": self._sheet.plot("current [m/s]", along, (0.0,)),
        }

    def _power(self) -> Subject:
        flight, plots = self._flight, Subject()
        acting = flight.table("/sim/thrusters")
        if acting is not None:
            t_s, power = seconds(acting), acting["power_w"]
            used = np.concatenate(([0.0], np.cumsum(0.5 * (power[1:] + power[:-1]) * np.diff(t_s))))
            plots["Electrical power"] = self._sheet.plot("power [W]", [Curve(name="power", t_s=t_s, values=power)])
            curves = [Curve(name="used", t_s=t_s, values=used), *self._thruster_energy()]
            plots["Energy, total and per thruster"] = self._sheet.plot("energy [J]", curves)
        plots["Battery"] = self._of("/in/power_raw", "voltage [V]", ("voltage", "voltage_v"))
        plots["Battery current"] = self._of("/in/power_raw", "current [A]", ("current", "current_a"))
        return plots

    def _thruster_energy(self) -> list[Curve]:
        found = thruster_power(self._flight)
        if found is None:
            return []
        lasts_s = np.diff(found.t_s, append=found.t_s[-1:])
        taken = np.cumsum(found.power_w * lasts_s[:, None], axis=0)
        return [Curve(name=name, t_s=found.t_s, values=taken[:, i]) for i, name in enumerate(found.names)]

    def _inertial(self) -> Subject:
        table = self._flight.table("/in/ahrs_raw")
        table = self._flight.table("/in/imu") if table is None else table
        if table is None:
            return {}
        t_s = seconds(table)
        norm = np.linalg.norm(table["accel_frd_m_s2"], axis=1)
        rates = [(axis, density(t_s, table["rate_frd_rad_s"][:, i])) for i, axis in enumerate("pqr")]
        forces = [(axis, density(t_s, table["accel_frd_m_s2"][:, i])) for i, axis in enumerate("xyz")]
        return {
            "Specific force": self._sheet.plot("specific force [m/s²]", [Curve(name="norm", t_s=t_s, values=norm)]),
            "Time between samples": self._sheet.plot(
                "interval [ms]", [Curve(name="since the sample before", t_s=t_s[1:], values=1e3 * np.diff(t_s))]
            ),
            "Spectra of the rates": spectrum("density [(rad/s)²/Hz]", rates),
            "Spectra of the specific force": spectrum("density [(m/s²)²/Hz]", forces),
        }

    def _system(self) -> Subject:
        flight, plots = self._flight, Subject()
        rates = []
        for topic, name in (("/in/mavlink", "received"), ("/out/mavlink", "sent")):
            table = flight.table(topic)
            if table is not None and len(table):
                at_s, counts = per_second(table["t_us"])
                rates.append(Curve(name=name, t_s=at_s, values=counts, steps=True))
        plots["MAVLink messages per second"] = self._sheet.plot("messages [1/s]", rates)
        tick = ("longest tick of a second", "tick_s")
        plots["Loop"] = self._of("/sys/loop", "time [ms]", tick, scale=1e3, bounds=(TICK_MS,), log_scale=True)
        loop = flight.table("/sys/loop")
        if loop is not None:
            whole = Curve(name="whole process", t_s=seconds(loop), values=loop["cpu_s"])
            plots["CPU time per second"] = self._sheet.plot("CPU time [s]", [whole, *self._threads()])
        plots["Overruns, lost messages of the log, lost pictures"] = self._of(
            "/sys/loop",
            "total [-]",
            *(("overruns", "overruns"), ("messages of the log", "dropped_log"), ("pictures", "dropped_frames")),
            steps=True,
        )
        received, sent = flight.table("/in/mavlink"), flight.table("/out/mavlink")
        if received is not None and sent is not None:
            at_s, trip_s = round_trips(received, sent)
            trips = [Curve(name="TIMESYNC", t_s=at_s, values=1e3 * trip_s)]
            plots["MAVLink round trip"] = self._sheet.plot("round trip [ms]", trips)
        for title, label, name, field, scale in (
            ("Memory", "memory [MB]", "in memory", "rss", 1e-6),
            ("Log queue", "messages [-]", "waiting", "log_queue", 1.0),
            ("Longest garbage collection of a second", "time [ms]", "longest", "collect_s", 1e3),
        ):
            plots[title] = self._of("/sys/process", label, (name, field), scale=scale, steps=True)
        return plots

    def _threads(self) -> list[Curve]:
        """CPU time of the threads that take some."""
        process = self._flight.table("/sys/process")
        if process is None or "thread_cpu_s" not in (process.dtype.names or ()):
            return []
        return [
            Curve(name=thread.name.lower(), t_s=seconds(process), values=process["thread_cpu_s"][:, thread])
            for thread in ServiceThread
            if 1e3 * process["thread_cpu_s"][:, thread].mean() >= LEAST_CPU_MS_S
        ]

    def _bound(self, name: str) -> tuple[float, ...]:
        run = self._flight.run
        value = run.paper_bounds.get(name) if run is not None else None
        return () if value is None else (-value, value)

    def _component(self, label: str, field: str, bounds: Sequence[float]) -> Any | None:
        """The third component of a vector, with bounds."""
        curves = [Curve(name=name, t_s=track.t_s, values=getattr(track, field)[:, 2]) for name, track in self._known]
        return self._sheet.plot(label, curves, bounds)

    def _plan(self) -> Any:
        """The tank from above: x to the right, y down. Path by lap, predictions, current."""
        run = self._flight.run
        track = self._track.between(self._flight.armed)
        plot = plain_figure("x, north [m]", "y, east [m]", match_aspect=True)
        plot.sizing_mode, plot.aspect_ratio = "scale_width", PLAN_ASPECT
        plot.y_range.flipped = True
        if run is not None:
            _draw_world(plot, run)
            for one in moved_obstacles(track, run):
                _draw_moved(plot, one, run)
        rows = np.arange(0, len(track.t_s), max(1, len(track.t_s) // (4 * BUCKETS)))
        x, y = track.pos_ned_m[rows, 0].astype(np.float32), track.pos_ned_m[rows, 1].astype(np.float32)
        items: Items = [("path", [_draw_path(plot, "path", x, y, line_color="#333333", line_width=1.5)])]
        laps = flown_laps(self._flight)
        colors = COLORS if len(laps) <= MOST_LAPS else viridis(len(laps))
        named = set(range(len(laps)))
        if len(laps) > MOST_LAPS:
            named = {round(fraction * (len(laps) - 1)) for fraction in np.linspace(0.0, 1.0, LAPS_NAMED)}
        for number, lap in enumerate(laps):
            keep = lap.holds(track.t_s[rows])
            line = _draw_path(plot, f"lap {number + 1}", x[keep], y[keep], line_color=colors[number], line_width=2)
            if number in named:
                used = energy_j(self._flight, lap)
                items.append((f"lap {number + 1}" + ("" if used is None else f": {used:.0f} J"), [line]))
        shown = laps[-1:] or [self._flight.armed]
        heads = _draw_heads(plot, track.between(shown[0]))
        items += [("direction of travel", [heads])] if heads is not None else []
        made = [one for one in self._predictions if self._flight.armed.start_s <= one.t_s <= self._flight.armed.end_s]
        if made:
            items.append(("predictions", [_draw_predictions(plot, made)]))
        met = met_current(track, run)
        if met is not None:
            items.append(("current", [_draw_current(plot, met)]))
        add_legend(plot, items, "below")
        return plot


CURRENT_COLOR, MOVED_COLOR = "#17a2b8", "#555555"
CHI2_3 = (0.216, 9.348)
"""95 % band of chi square with 3 degrees of freedom."""


def _draw_path(plot: Any, name: str, north: FloatArray, east: FloatArray, **style: Any) -> Any:
    """A line of the plan, which can be saved as CSV."""
    source = ColumnDataSource({"t": north, "y": east}, name=name)
    return plot.line("t", "y", source=source, **style)


def _draw_predictions(plot: Any, made: Sequence[Prediction]) -> Any:
    some = made[:: max(1, len(made) // HORIZONS)]
    xs = [one.pos_ned_m[:, 0].round(3).tolist() for one in some]
    ys = [one.pos_ned_m[:, 1].round(3).tolist() for one in some]
    return plot.multi_line(xs, ys, line_color="#7b3fa0", line_width=1, line_alpha=0.6)


def _draw_heads(plot: Any, track: VehicleTrack) -> Any | None:
    """Arrow heads along a path, evenly spaced; none on a path of zero length."""
    plane = track.pos_ned_m[:, :2]
    along = lengths_m(plane)
    if len(plane) < 2 or along[-1] <= 0.0:
        return None
    at = np.searchsorted(along, (np.arange(HEADS) + 0.5) / HEADS * along[-1])
    ahead = np.minimum(np.searchsorted(along, along[at] + HEAD_M), len(along) - 1)
    step = plane[ahead] - plane[at]
    length = np.hypot(*step.T)[:, None]
    direction = np.divide(step, length, out=np.zeros_like(step), where=length > 0.0)
    size_m = HEAD_FRACTION * max(float(np.ptp(plane, axis=0).max()), HEAD_M)
    across = np.column_stack((-direction[:, 1], direction[:, 0]))  # slender: an even triangle has three points
    corners = [plane[at] + size_m * direction]
    corners += [plane[at] + size_m * (side * 0.45 * across - direction) for side in (1.0, -1.0)]
    xs, ys = (np.stack([corner[:, i] for corner in corners], axis=1).round(4).tolist() for i in (0, 1))
    drawn = plot.patches(xs, ys, fill_color="#111111", line_color="white")
    # The legend would show a patch as a square: it shows this triangle, which is nowhere in the plot.
    key = plot.scatter([np.nan], [np.nan], marker="triangle", angle=-np.pi / 2, size=10, color="#111111")
    key.js_link("visible", drawn, "visible")
    return key


def _draw_current(plot: Any, met: MetCurrent) -> Any:
    """Arrows where the current was met, to scale with the plan, and one of a round figure as their key."""
    key, key_m = np.array(met.key_m), met.scale_m * met.key_m_s
    start = np.vstack((met.place_m, key))
    arrows = np.vstack((met.scale_m * met.flow_m_s, (key_m, 0.0)))
    tip, length = start + arrows, np.hypot(*arrows.T)[:, None]
    along = np.divide(arrows, length, out=np.zeros_like(arrows), where=length > 0.0)
    barb = np.minimum(0.3 * length, 0.12 * length.max())
    across = np.column_stack((-along[:, 1], along[:, 0]))
    corners = [tip, *(tip - barb * (along + side * 0.45 * across) for side in (1.0, -1.0))]
    xs, ys = (np.stack([corner[:, i] for corner in corners], axis=1).round(4).tolist() for i in (0, 1))
    color = {"line_color": CURRENT_COLOR, "line_alpha": 0.8}
    lines = plot.segment(start[:, 0], start[:, 1], tip[:, 0], tip[:, 1], **color)
    heads = plot.patches(xs, ys, fill_color=CURRENT_COLOR, fill_alpha=0.8, line_color=None)
    label = plot.text(
        [tip[-1, 0]],
        [tip[-1, 1]],
        text=[f"current {met.key_m_s:g} m/s"],
        x_offset=6,
        text_baseline="middle",
        text_font_size="9pt",
        text_color=CURRENT_COLOR,
    )
    for other in (heads, label):
        lines.js_link("visible", other, "visible")
    return lines


def clearances(flight: FlightRecord) -> list[Curve]:
    """Clearance beyond the limits: each obstacle, walls, fence, both ends of the depth band."""
    run, track = flight.run, flight.judged
    if run is None:
        return []
    accept, t_s = run.accept, track.t_s
    curves = [
        Curve(name=name, t_s=t_s, values=distance_m - limit)
        for name, distance_m, limit in analysis.clearances(track, run)
    ]
    for name, limit, sign in (("shallowest", accept.depth_min_m, 1.0), ("deepest", accept.depth_max_m, -1.0)):
        if limit is not None:
            curves.append(Curve(name=name, t_s=t_s, values=sign * (track.pos_ned_m[:, 2] - limit)))
    return curves


def per_second(t_us: NDArray[np.int64]) -> tuple[FloatArray, FloatArray]:
    """Seconds and how many messages came in each, 0 from where a silence begins: of a log whose clock was set within
    it, decades of silence are one point."""
    at_s, counts = np.unique(t_us // 1_000_000, return_counts=True)
    silent_s = np.setdiff1d(at_s[:-1] + 1, at_s)
    silences = np.searchsorted(at_s, silent_s)
    return np.insert(at_s, silences, silent_s).astype(float), np.insert(counts, silences, 0).astype(float)


def aimed_yaw(aimed_deg: FloatArray, yaw_deg: FloatArray) -> FloatArray:
    """(n,) headings that were aimed at, on the turn on which the vehicle (n,) was at the end of each, when it had
    reached it.
    """
    new = np.ones(len(aimed_deg), dtype=bool)
    new[1:] = np.diff(np.nan_to_num(aimed_deg, nan=1e9)) != 0.0
    ends = np.append(np.flatnonzero(new)[1:], len(aimed_deg) - 1)
    result: FloatArray = aimed_deg + 360.0 * np.round((yaw_deg[ends[np.cumsum(new) - 1]] - aimed_deg) / 360.0)
    return result


def unwrapped_deg(yaw_rad: FloatArray) -> FloatArray:
    """(n,) without jumps; NaN stays NaN."""
    result, known = np.full(len(yaw_rad), np.nan), np.isfinite(yaw_rad)
    result[known] = np.degrees(np.unwrap(yaw_rad[known]))
    return result


def same_turn(curve: Curve, other: Curve) -> FloatArray:
    """(n,) an unwrapped heading on the turn of another."""
    known = np.isfinite(other.values)
    if not known.any() or not np.isfinite(curve.values).any():
        return curve.values
    apart = curve.values - np.interp(curve.t_s, other.t_s[known], other.values[known])
    return curve.values - 360.0 * np.round(np.nanmedian(apart) / 360.0)


def _ratio(values: FloatArray, sigma: FloatArray) -> FloatArray:
    result: FloatArray = np.divide(values, sigma, out=np.full(len(values), np.nan), where=sigma > 0.0)
    return result


def _draw_world(plot: Any, run: RunDescription) -> None:
    if run.tank_polygon_m:
        corners = np.array(run.tank_polygon_m)
        plot.patch(corners[:, 0], corners[:, 1], fill_color=None, line_color="black", line_width=2)
    for shape in run.fence:
        corners = np.array(outline(shape))
        plot.patch(corners[:, 0], corners[:, 1], fill_color=None, line_color="#d62728", line_width=1)
    for obstacle in run.obstacles:
        if obstacle.path_m:
            continue
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


def _draw_moved(plot: Any, moved: MovedObstacle, run: RunDescription) -> None:
    """A moving obstacle: solid at the vehicle's closest approach, outlines at its first and last position."""
    radius, path = moved.obstacle.radius_m, moved.path_m
    plot.line(path[:, 0], path[:, 1], line_color=MOVED_COLOR, line_dash="dotted")
    for place, dash, text in ((path[0], "dashed", "start"), (path[-1], "solid", "end")):
        plot.circle([place[0]], [place[1]], radius=radius, fill_color=None, line_color=MOVED_COLOR, line_dash=dash)
        _draw_text(plot, place, text, MOVED_COLOR)
    north, east = moved.nearest_m
    plot.circle([north], [east], radius=radius, fill_color="#777777", line_color="black")
    plot.circle(
        [north], [east], radius=radius + run.body_radius_m, fill_color=None, line_color="red", line_dash="dashed"
    )
    _draw_text(plot, moved.nearest_m, f"{moved.nearest_s:.0f} s", "white")


def _draw_text(plot: Any, place: Sequence[float] | FloatArray, text: str, color: str) -> None:
    style = {"text_align": "center", "text_baseline": "middle", "text_font_size": "8pt", "text_color": color}
    plot.text([place[0]], [place[1]], text=[text], **style)


def mode_bands(flight: FlightRecord) -> list[Band]:
    """Every stretch of one mode while armed."""
    mode = flight.table("/sys/mode")
    if mode is None or not len(mode):
        return []
    known = flight.run.mode_names if flight.run is not None else {}
    t_s, key = seconds(mode), np.where(mode["armed"] != 0, mode["custom_mode"].astype(np.int64) + 1, 0)
    change = np.flatnonzero(np.diff(key)) + 1
    starts, ends = [0, *change.tolist()], [*change.tolist(), len(key)]
    numbers = sorted({int(value) for value in key if value})
    bands = []
    for first, after in zip(starts, ends, strict=True):
        if key[first]:
            end_s = float(t_s[after]) if after < len(t_s) else flight.armed.end_s
            name = known.get(str(int(key[first]) - 1), f"mode {int(key[first]) - 1}")
            color = MODE_COLORS[numbers.index(int(key[first])) % len(MODE_COLORS)]
            bands.append(Band(float(t_s[first]), end_s, name, color))
    return bands


def event_marks(flight: FlightRecord) -> list[Mark]:
    """Messages to operators and parameter changes, in order; the most severe if there are too many."""
    log, marks = flight.log, []
    if "/rosout" in log:
        for message in log.messages("/rosout"):
            level = message.value["level"]
            if level >= MARKED_LEVEL:
                color = EVENT_COLOR if level > MARKED_LEVEL else "#607d8b"
                marks.append((level, Mark(message.t_us * 1e-6, message.value["msg"], color)))
    changes = flight.table("/sys/parameters")
    if changes is not None:
        for t_s, name, value in zip(seconds(changes), changes["name"], changes["value"], strict=True):
            text = bytes(name).rstrip(b"\0").decode(errors="replace")
            marks.append((MARKED_LEVEL + 1, Mark(float(t_s), f"{text} = {value:g}", PARAMETER_COLOR)))
    gravest = sorted(marks, key=lambda mark: -mark[0])[:MOST_MARKS]
    return sorted((mark for _, mark in gravest), key=lambda mark: mark.t_s)
