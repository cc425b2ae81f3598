"""Verdicts on a run: its log against its bounds.

Judged is the ground truth where the log has it, else the estimate (the rows say which). Clearances, contacts and
thrust are judged while armed; depth, speeds and estimation errors until the mission is complete, because a mission
may end by surfacing.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from autopilot.core.errors import LogError
from autopilot.core.frames import FloatArray
from autopilot.core.marks import LoopPart
from autopilot.core.messages import ProgressState
from autopilot.log.analysis import (
    FlightRecord,
    Span,
    Visit,
    clearances,
    energy_j,
    estimate_error,
    lap_spans,
    load_flight,
    seconds,
    sequence_gaps,
    thruster_count,
    visits,
)
from autopilot.log.check_more import more_rows
from autopilot.log.description import AcceptBounds, RunDescription
from autopilot.log.reader import Log, MessageTable
from autopilot.log.rows import BoundRow, BoundVerdict, counted, info, judged
from autopilot.log.smoothness import BARS, ThrustCommands, is_reported, measure

__all__ = (
    "BoundRow",
    "BoundVerdict",
    "acceptance_table",
    "flown_commands",
    "format_figure",
    "overall",
    "short_form",
    "slowest_part",
)


def acceptance_table(log: Log) -> list[BoundRow]:
    """All rows of a log. LogError if it holds neither truth nor estimate."""
    flight = load_flight(log)
    rows: list[BoundRow] = []
    if not len(flight.judged.t_s):
        raise LogError(f"{log.path}: the vehicle's track is empty; there is nothing to judge")
    if flight.run is not None:
        rows += _of("Mission", _mission_rows(flight, flight.run))
        rows += _of("Bounds", _clearance_rows(flight, flight.run) + _motion_rows(flight, flight.run.accept))
    else:
        rows += _of("Mission", [info("bounds", "", None, "the log has no run.json: nothing is judged")])
    rows += _of("Bounds", _contact_rows(flight))
    rows += _of("Estimate", _estimate_rows(flight, flight.run.accept if flight.run is not None else AcceptBounds()))
    rows += _of("Thrust", _smoothness_rows(flight))
    rows += _of("Service", _health_rows(flight))
    if flight.truth is None:
        rows += _of("Estimate", [info("judged on", "", None, "the estimate: the log has no truth")])
    rows += more_rows(flight)
    order = list(dict.fromkeys(row.subject for row in rows))
    return sorted(rows, key=lambda row: order.index(row.subject))


def _of(subject: str, rows: Iterable[BoundRow]) -> list[BoundRow]:
    return [replace(row, subject=subject) for row in rows]


def overall(rows: Iterable[BoundRow]) -> BoundVerdict:
    """FAIL if any row fails, else WARN if any warns, else PASS."""
    verdicts = {row.verdict for row in rows}
    for verdict in (BoundVerdict.FAIL, BoundVerdict.WARN):
        if verdict in verdicts:
            return verdict
    return BoundVerdict.PASS


SHORT_ROWS = 12
"""Rows of the short form, if not more of them fail or warn."""
_FIRST: Sequence[tuple[str, ...]] = (
    *(("laps",), ("time of a lap", "time lap"), ("energy of a lap", "energy lap"), ("distance to",), ("contacts",)),
    *(("planar speed",), ("thrust command",), ("estimate position rms",), ("estimate yaw rms",), ("waypoint",)),
    *(("largest step of thrust",), ("NMPC fallbacks",), ("energy",), ("path length",), ("judged on", "bounds")),
)
"""How the rows of the short form begin, in order, each with what stands in for it."""


def short_form(rows: Sequence[BoundRow]) -> list[BoundRow]:
    """Rows that fail, rows that warn, and the most important of the others: of several the one of the least margin."""
    found = [row for verdict in (BoundVerdict.FAIL, BoundVerdict.WARN) for row in rows if row.verdict is verdict]
    for starts in _FIRST:
        by_start = ([row for row in rows if row.name.startswith(start) and row not in found] for start in starts)
        mine = next(filter(None, by_start), [])
        if mine and len(found) < SHORT_ROWS:
            found.append(min(mine, key=lambda row: math.inf if row.margin is None else row.margin))
    return found


def format_figure(value: float | None) -> str:
    """A figure of a row as text: empty without a value, whole and large numbers without decimals."""
    if value is None:
        return ""
    whole = math.isfinite(value) and (value == int(value) or abs(value) >= 1000.0)
    return f"{value:.0f}" if whole else f"{value:.4g}"


def _at_most(
    name: str, unit: str, limit: float | None, t_s: FloatArray, values: FloatArray, note: str = ""
) -> list[BoundRow]:
    """Row of the largest value against an upper limit; none without a limit."""
    if limit is None:
        return []
    if not len(values):
        return [_missing(name, unit, limit)]
    at = int(np.argmax(np.where(np.isnan(values), np.inf, values)))
    worst = float(values[at])
    note = "; ".join(part for part in (note, _beyond(t_s, values > limit) if unit else "") if part)
    return [judged(name, unit, limit, worst, limit - worst, broken=BoundVerdict.FAIL, at_s=float(t_s[at]), note=note)]


def _at_least(
    name: str, unit: str, limit: float | None, tolerance: float, t_s: FloatArray, values: FloatArray
) -> list[BoundRow]:
    """The smallest of the values against a lower limit that may be missed by a tolerance."""
    if limit is None:
        return []
    if not len(values):
        return [_missing(name, unit, limit)]
    at = int(np.argmin(np.where(np.isnan(values), -np.inf, values)))
    worst = float(values[at])
    margin = worst - (limit - tolerance)
    note = f"tol. {tolerance * 1000:.0f} mm" if tolerance else ""
    note = "; ".join(part for part in (note, _beyond(t_s, values < limit - tolerance)) if part)
    row = judged(name, unit, limit, worst, margin, broken=BoundVerdict.FAIL, at_s=float(t_s[at]), note=note)
    used = row.verdict is BoundVerdict.PASS and worst < limit
    return [replace(row, verdict=BoundVerdict.WARN) if used else row]


def _missing(name: str, unit: str, limit: float | None) -> BoundRow:
    note = "the log holds no data for this"
    return BoundRow(name=name, unit=unit, limit=limit, worst=None, margin=None, verdict=BoundVerdict.FAIL, note=note)


def _beyond(t_s: FloatArray, broken: NDArray[np.bool_]) -> str:
    """For how long, and how often."""
    if len(t_s) < 2 or not broken.any():
        return ""
    edges = np.diff(broken.astype(np.int8), prepend=np.int8(0))
    lasted_s = float(np.sum(np.diff(t_s, append=t_s[-1])[broken]))
    times = int((edges > 0).sum())
    return f"beyond for {lasted_s:.2f} s" + (f", {times} times" if times > 1 else "")


LISTED_LAPS = 6
"""More of them are not listed one by one."""
FIRST_STATS_S = 1.5
"""A log whose loop statistics (1 Hz) begin by then began with the service."""


def _was_started(flight: FlightRecord) -> bool:
    """Whether the log shows a running mission; a log without mission state counts as one."""
    progress = flight.table("/mission/progress")
    return progress is None or bool((progress["state"] == ProgressState.ACTIVE).any())


def _mission_rows(flight: FlightRecord, run: RunDescription) -> list[BoundRow]:
    if not run.waypoints:
        return []
    tour = visits(flight.judged.between(flight.armed), run)
    spans = lap_spans(tour, run, flight.armed.start_s)
    rows = []
    if run.accept.laps is not None:
        done, limit = float(len(spans)), float(run.accept.laps)
        if not _was_started(flight):
            return [info("laps", "", 0.0, "the mission on board was not started")]
        rows.append(judged("laps", "", limit, done, done - limit, broken=BoundVerdict.FAIL))
    for waypoint in run.waypoints:
        rows += _waypoint_rows([visit for visit in tour if visit.waypoint is waypoint])
    return rows + _lap_rows(flight, run, spans)


def _lap_rows(flight: FlightRecord, run: RunDescription, spans: Sequence[Span]) -> list[BoundRow]:
    """Time and energy of every lap, or mean and spread of many."""
    times = [span.end_s - span.start_s for span in spans]
    used = [energy_j(flight, span) for span in spans]
    note = f"{run.hotel_power_w:g} W hotel load" if run.hotel_power_w else ""
    rows = []
    if len(spans) <= LISTED_LAPS:
        for number, (time_s, energy) in enumerate(zip(times, used, strict=True), 1):
            rows.append(info(f"time lap {number}", "s", time_s))
            rows += [] if energy is None else [info(f"energy lap {number}", "J", energy, note)]
    energies = [energy for energy in used if energy is not None]
    for name, unit, values in (("time", "s", times), ("energy", "J", energies)):
        if len(values) > 1:
            least, most = int(np.argmin(values)), int(np.argmax(values))
            apart = f"{values[least]:.1f} in lap {least + 1}, {values[most]:.1f} in lap {most + 1}"
            rows.append(info(f"{name} of a lap, median of {len(values)}", unit, float(np.median(values)), apart))
    return rows


def _waypoint_rows(stays: Sequence[Visit]) -> list[BoundRow]:
    """Position and heading of the worst visit of one waypoint."""
    waypoint = stays[0].waypoint
    reached = sum(visit.t_s is not None for visit in stays)
    note = f"reached {reached} of {len(stays)}"
    far = max(stays, key=lambda visit: visit.distance_m)
    rows = [_reached(f"waypoint {waypoint.name} position", "m", waypoint.accept_radius_m, far.distance_m, far, note)]
    if waypoint.yaw_rad is not None:
        turned = max(stays, key=lambda visit: visit.yaw_error_rad)
        name = f"waypoint {waypoint.name} heading"
        rows.append(_reached(name, "rad", waypoint.accept_yaw_rad, turned.yaw_error_rad, turned, note))
    if reached < len(stays) and all(row.verdict is BoundVerdict.PASS for row in rows):
        missed = "never inside position and heading at once"
        rows[0] = replace(rows[0], verdict=BoundVerdict.FAIL, at_s=None, note=f"{note}; {missed}")
    return rows


def _reached(name: str, unit: str, limit: float, value: float, visit: Visit, note: str) -> BoundRow:
    shown = value if math.isfinite(value) else None
    return BoundRow(
        name=name,
        unit=unit,
        limit=limit,
        worst=shown,
        margin=None if shown is None else limit - value,
        verdict=BoundVerdict.PASS if value <= limit else BoundVerdict.FAIL,
        at_s=visit.t_s,
        note=note,
    )


def _clearance_rows(flight: FlightRecord, run: RunDescription) -> list[BoundRow]:
    """Distances from cylinders, walls and fence while armed."""
    track, accept = flight.judged.between(flight.armed), run.accept
    rows: list[BoundRow] = []
    for name, values, limit in clearances(track, run):
        rows += _at_least(f"distance to {name}", "m", limit, accept.tolerance_m, track.t_s, values)
    return rows


def _motion_rows(flight: FlightRecord, accept: AcceptBounds) -> list[BoundRow]:
    """Depth band, speeds and thrust commands."""
    track = flight.judged.between(flight.mission)
    t_s, depth = track.t_s, track.pos_ned_m[:, 2]
    rows = _at_least("depth, shallowest", "m", accept.depth_min_m, 0.0, t_s, depth)
    rows += _at_most("depth, deepest", "m", accept.depth_max_m, t_s, depth)
    rows += _at_most("planar speed", "m/s", accept.planar_speed_m_s, t_s, track.planar_speed_m_s)
    if len(t_s):
        literal = float(np.max(track.literal_speed_m_s))
        rows.append(info("planar speed |u+v|", "m/s", literal, "paper (5a), literal"))
    rows += _at_most("heave", "m/s", accept.heave_m_s, t_s, np.abs(track.vel_level_m_s[:, 2]))
    rows += _at_most("yaw rate", "rad/s", accept.yaw_rate_rad_s, t_s, np.abs(track.rate_frd_rad_s[:, 2]))
    commands = flight.table("/out/thrusters")
    if commands is None:
        return rows + ([] if accept.thrust_n is None else [_missing("thrust command", "N", accept.thrust_n)])
    values = np.max(np.abs(commands["thrust_n"]), axis=1)
    return rows + _at_most("thrust command", "N", accept.thrust_n, seconds(commands), values)


def _contact_rows(flight: FlightRecord) -> list[BoundRow]:
    """Contacts of the simulated hull while armed."""
    table = flight.table("/sim/contact")
    if table is None:
        return []
    t_s = seconds(table)
    keep = flight.armed.holds(t_s)
    before = table["count"][t_s < flight.armed.start_s]
    counts = table["count"][keep].astype(float) - (float(before[-1]) if len(before) else 0.0)
    deepest = float(np.max(table["penetration_m"][keep], initial=0.0))
    note = f"deepest {deepest * 1000:.1f} mm" if deepest > 0.0 else ""
    return _at_most("contacts", "", 0.0, t_s[keep], counts, note) if keep.any() else []


def _estimate_rows(flight: FlightRecord, accept: AcceptBounds) -> list[BoundRow]:
    """Estimate against truth until the mission is complete."""
    if flight.truth is None or flight.nav is None:
        return []
    error = estimate_error(flight.truth, flight.nav.between(flight.mission))
    if error is None:
        return [_missing("estimate position rms", "m", accept.pos_rms_m)]
    yaw_limit = None if accept.yaw_rms_deg is None else math.radians(accept.yaw_rms_deg)
    end = error.t_s[-1:]
    yaw_note = f"{math.degrees(error.yaw_rms_rad):.2f} deg"
    rows = _at_most("estimate position rms", "m", accept.pos_rms_m, end, np.array([error.pos_rms_m]))
    return rows + _at_most("estimate yaw rms", "rad", yaw_limit, end, np.array([error.yaw_rms_rad]), yaw_note)


def flown_commands(flight: FlightRecord) -> ThrustCommands | None:
    """The commands of the control steps of the mission, None if the log does not have them."""
    nmpc, commands, goals = flight.table("/ctl/nmpc"), flight.table("/out/thrusters"), flight.table("/ctl/goal")
    if nmpc is None or commands is None:
        return None
    nmpc = nmpc[flight.mission.holds(seconds(nmpc)) & np.isin(nmpc["t_us"], commands["t_us"])]
    rows = commands[np.searchsorted(commands["t_us"], nmpc["t_us"])]
    starts_s = [np.array([flight.armed.start_s])]
    if goals is not None:
        moved = (np.diff(goals["pos_ned_m"], axis=0) != 0.0).any(axis=1) | (np.diff(goals["seq"]) != 0)
        starts_s.append(seconds(goals)[1:][moved])
    events = flight.log.messages("/rosout") if "/rosout" in flight.log else []
    reported = is_reported([event.value["msg"] for event in events])
    return ThrustCommands(
        t_s=seconds(nmpc),
        thrust_n=rows["thrust_n"][:, : thruster_count(commands)],
        fallback=nmpc["fallback"],
        starts_s=np.concatenate(starts_s),
        reported_s=np.array([event.t_us * 1e-6 for event in events])[reported],
        limit_n=flight.run.parameters.get("THR_LIMIT", math.inf) if flight.run is not None else math.inf,
    )


def _smoothness_rows(flight: FlightRecord) -> list[BoundRow]:
    """Commands of the control steps against the bars of :mod:`autopilot.log.smoothness`."""
    commands = flown_commands(flight)
    found = None if commands is None else measure(commands)
    if found is None:
        return []
    end_s, bars = flight.mission.end_s, BARS.of(found)
    slow = f"{found.variation_n_s:.2f} N/s, {found.low_passed_n_s:.2f} below 2 Hz"
    if found.low_passed_n_s < found.least_n_s:
        slow += f", taken as {found.least_n_s:.2g}"
    return [
        _smooth("alternating commands", "%", 100.0 * bars.alternating, 100.0 * found.alternating, end_s, "by 2 N"),
        _smooth("thrust variation / that below 2 Hz", "", bars.ratio, found.ratio, end_s, slow),
        _smooth("largest step of thrust", "N", bars.step_n, found.step_n, found.step_at_s, "without starts and limits"),
        _smooth("reversals of a thruster", "1/s", bars.reversals_1_s, found.reversals_1_s, end_s, "worst thruster"),
        _smooth("unreported fallback steps", "", bars.silent, float(found.silent), end_s),
    ]


def _smooth(name: str, unit: str, limit: float, value: float, at_s: float, note: str = "") -> BoundRow:
    """Limit of smoothness: a warning, not a bound of the vehicle."""
    return judged(name, unit, limit, value, limit - value, at_s=at_s, note=note)


def _health_rows(flight: FlightRecord) -> list[BoundRow]:
    """Solver, loop, log and failsafes: figures and warnings."""
    rows: list[BoundRow] = []
    nmpc = flight.table("/ctl/nmpc")
    if nmpc is not None:
        solved = nmpc["solve_s"][nmpc["solve_s"] > 0.0]
        for name, percent in (("p50", 50.0), ("p95", 95.0), ("p99", 99.0), ("max", 100.0)):
            if len(solved):
                rows.append(info(f"solve time {name}", "ms", 1000.0 * float(np.percentile(solved, percent))))
        mine = flight.armed.holds(seconds(nmpc))
        rows.append(counted("NMPC fallbacks", int(np.sum(nmpc["fallback"][mine] != 0)), f"of {int(mine.sum())} steps"))
    status = flight.table("/nav/status")
    if status is not None:
        rows.append(info("estimator resets", "", float(status["reset_count"].max())))
    mode = flight.table("/sys/mode")
    if mode is not None:
        bits = int(np.bitwise_or.reduce(mode["failsafes"][flight.armed.holds(seconds(mode))], initial=0))
        rows.append(counted("failsafes raised", bits.bit_count(), f"bits {bits:#x}" if bits else ""))
    thrusters, commands = flight.table("/ctl/thrusters"), flight.table("/out/thrusters")
    if thrusters is not None and commands is not None:
        weakest = float(thrusters["effectiveness"][:, : thruster_count(commands)].min())
        rows.append(info("lowest thruster effectiveness", "%", 100.0 * weakest))
    loop = flight.table("/sys/loop")
    if loop is not None:
        # The counter runs since the service started, which may have been long before this log.
        earlier = int(loop["overruns"][0]) if seconds(loop)[0] > FIRST_STATS_S else 0
        rows.append(counted("loop overruns", int(loop["overruns"].max()) - earlier))
        rows += tick_rows(loop)
        rows.append(info("longest tick", "ms", 1000.0 * float(loop["tick_s"].max()), slowest_part(loop)))
    dropped = int(loop["dropped_log"].max()) if loop is not None else 0
    rows.append(counted("log messages lost", max(dropped, sequence_gaps(flight.log))))
    if flight.log.problems:
        rows.append(counted("log damage", len(flight.log.problems), "; ".join(flight.log.problems)))
    return rows


def tick_rows(loop: MessageTable) -> list[BoundRow]:
    """Wall time of the ticks, with their CPU time; none of a log of older versions."""
    names = loop.dtype.names or ()
    if "ticks_s" not in names or not loop["ticks_s"].any():
        return []
    return [
        info(
            f"tick p{percent}",
            "ms",
            1e3 * float(np.percentile(loop["ticks_s"], percent)),
            f"of the wall's clock; of CPU {1e3 * float(np.percentile(loop['ticks_cpu_s'], percent)):.2f} ms",
        )
        for percent in (50, 99)
    ]


def slowest_part(loop: MessageTable) -> str:
    """Stage that took most of the slowest tick of a log, "" if unknown."""
    if "part_s" not in (loop.dtype.names or ()):
        return ""
    by_part_s = loop["part_s"][int(np.argmax(loop["part_s"].sum(axis=1)))]
    part = int(np.argmax(by_part_s))
    return f"{1000.0 * float(by_part_s[part]):.1f} ms of it {LoopPart(part).name.lower()}"
