"""Further figures and warnings from a log. None is a bound: nothing here fails a run."""

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from autopilot.core.frames import FloatArray
from autopilot.core.messages import ProgressState
from autopilot.core.params import PARAMETERS
from autopilot.log.analysis import (
    FlightRecord,
    Span,
    VehicleTrack,
    along_track,
    energy_j,
    estimate_error,
    foreseen,
    position_nees,
    predictions,
    seconds,
    thruster_count,
    thruster_names,
    visits,
)
from autopilot.log.check_outside import link_rows, process_rows
from autopilot.log.reader import MessageTable
from autopilot.log.rows import BoundRow, at_most, counted, judged, row, under
from autopilot.log.settling import Stay, stays
from autopilot.log.thruster_energy import drag_work, thruster_power
from autopilot.log.topics import AID_PREFIX

CONTROL_PERIOD_S = 0.05
LEAST_LENGTH_M = 0.1
"""Of a path with an energy per length."""
AHEAD_S = 1.0
CHI2_95 = (3.841, 5.991, 7.815)
"""95 % of chi square, by degrees of freedom from 1."""
LEAST_INSIDE = 0.80
"""Least share of innovations within their own 95 % interval: below, the estimator is overconfident in its sensor."""
MOST_BIAS = 1.0
"""Mean of an innovation over its sigma."""
MOST_NEES = 9.35
"""Greatest NEES of the position (3 expected): above, the covariance is too small."""
FEWEST = 50
"""Least number of messages for a share."""
LONGEST_SILENCE_S = 0.25
"""Of the motion sensor, while armed."""
MOST_REPROJECTION_PX = 1.0
"""Of corners from their projections, rms: more, and intrinsics, mounting or map are wrong."""
MOST_MISFIT = 0.10
"""Share of markers that are left out of the poses for not fitting."""
LEAST_RATE_RAD_S, LEAST_ACCEL_M_S2 = 1.0, 14.0
"""No sensor's range is smaller: below, equal values are steps of the digits."""
IN_A_ROW = 3


def clipped(rates_rad_s: FloatArray, accel_m_s2: FloatArray) -> tuple[int, int]:
    """How many samples (n, 3) have a turn rate, and how many a specific force, at the end of its range.

    The range is unknown to a log. A clipped axis shows the same extreme value several times in a row while other axes
    vary; a frozen sensor repeats all axes and is not counted here."""
    both = np.hstack((rates_rad_s, accel_m_s2))
    repeated = np.r_[False, (np.diff(both, axis=0) == 0.0).all(axis=1)] if len(both) else np.zeros(0, dtype=bool)
    fresh = ~repeated
    return _at_the_end(rates_rad_s[fresh], LEAST_RATE_RAD_S), _at_the_end(accel_m_s2[fresh], LEAST_ACCEL_M_S2)


def _at_the_end(values: FloatArray, least: float) -> int:
    found = np.zeros(len(values), dtype=bool)
    for axis in values.T:
        for side in (1.0, -1.0):
            largest = float((side * axis).max(initial=0.0))
            if largest >= least:
                found |= _in_a_row(side * axis == largest)
    return int(found.sum())


def _in_a_row(those: FloatArray) -> FloatArray:
    """(n,) which of those flags stand in a row that is long enough."""
    edges = np.flatnonzero(np.diff(np.r_[0, those.astype(np.int8), 0]))
    result = np.zeros(len(those), dtype=bool)
    for start, end in edges.reshape(-1, 2).tolist():
        result[start:end] = end - start >= IN_A_ROW
    return result


def more_rows(flight: FlightRecord) -> list[BoundRow]:
    """All of them, as far as the log has their data."""
    return [
        *_mission(flight),
        *_tracking(flight),
        *_settling(flight),
        *_controller(flight),
        *_estimator(flight),
        *_camera(flight),
        *_thrusters(flight),
        *_current(flight),
        *_power(flight),
        *_inertial(flight),
        *link_rows(flight),
        *process_rows(flight),
        *_events(flight),
    ]


def path_length_m(track: VehicleTrack) -> float:
    return float(np.linalg.norm(np.diff(track.pos_ned_m, axis=0), axis=1).sum())


def _mission(flight: FlightRecord) -> list[BoundRow]:
    track = flight.judged.between(flight.armed)
    rows = [
        row(
            "Mission", "path length", "m", path_length_m(track), f"in {flight.armed.end_s - flight.armed.start_s:.1f} s"
        )
    ]
    rows += _detour(flight)
    progress, mode = flight.table("/mission/progress"), flight.table("/sys/mode")
    if progress is not None and mode is not None and len(progress) and len(mode):
        cut = bool(mode["armed"][-1]) and int(progress["state"][-1]) == ProgressState.ACTIVE
        note = "the mission was still flown" if cut else ""
        rows.append(under("Mission", counted("log ended within a mission", int(cut), note)))
    return rows


def _detour(flight: FlightRecord) -> list[BoundRow]:
    """Path length over straight-line length between waypoints."""
    if flight.run is None:
        return []
    came = [(visit.waypoint, visit.t_s) for visit in visits(flight.judged, flight.run) if visit.t_s is not None]
    straight = sum(math.dist(a.pos_ned_m, b.pos_ned_m) for (a, _), (b, _) in pairwise(came))
    if not straight > 0.0:
        return []
    flown = path_length_m(flight.judged.between(Span(came[0][1], came[-1][1])))
    note = "" if flown >= straight else "through the edges of acceptance balls"
    return [row("Mission", "path length / straight-line length", "", flown / straight, note)]


def _tracking(flight: FlightRecord) -> list[BoundRow]:
    """Prediction error of the controller, and delay from command to thrust."""
    made = [one for one in predictions(flight.log) if flight.mission.start_s <= one.t_s <= flight.mission.end_s]
    then_s, then_m = foreseen(made, AHEAD_S)
    track = flight.judged
    seen = then_s <= min(float(track.t_s[-1]), flight.mission.end_s)
    rows = []
    if seen.any():
        for index, axis in enumerate("xyz"):
            away = np.interp(then_s[seen], track.t_s, track.pos_ned_m[:, index]) - then_m[seen, index]
            note = f"p95 {np.percentile(np.abs(away), 95.0):.3f}, largest {np.abs(away).max():.3f} m"
            name = f"{AHEAD_S:g} s prediction error, {axis} rms"
            rows.append(row("Tracking", name, "m", float(np.sqrt(np.mean(away**2))), note))
    commands, acting = flight.table("/out/thrusters"), flight.table("/sim/thrusters")
    if commands is not None and acting is not None and len(commands) > FEWEST and len(acting) > FEWEST:
        delay = _delay_s(flight, commands, acting)
        if delay is not None:
            rows.append(row("Tracking", "latency from command to thrust", "s", delay, "dead time and lag together"))
    return rows


def _delay_s(flight: FlightRecord, commands: MessageTable, acting: MessageTable) -> float | None:
    """The shift at which acting thrust is most like the commands; None if nothing moved."""
    t_s = np.arange(flight.armed.start_s, flight.armed.end_s, 0.01)
    count = thruster_count(commands)
    if len(t_s) < 200 or not count:
        return None
    best, delay = 0.0, None
    moving = int(np.argmax(commands["thrust_n"][:, :count].std(axis=0)))
    commanded = np.interp(t_s, seconds(commands), commands["thrust_n"][:, moving])
    done = np.interp(t_s, seconds(acting), acting["thrust_n"][:, moving])
    for shift in range(60):
        a, b = commanded[: len(commanded) - shift or None], done[shift:]
        if a.std() > 0.05 and b.std() > 0.05:
            alike = float(np.corrcoef(a, b)[0, 1])
            if alike > best:
                best, delay = alike, 0.01 * shift
    return delay


def _settling(flight: FlightRecord) -> list[BoundRow]:
    found = stays(flight)
    if not found:
        return []
    farthest = max(found, key=lambda stay: stay.overshoot_m / stay.accept_radius_m)
    far = f"of {len(found)} goals that were held; at item {farthest.seq}, {farthest.entered_s:.1f} s"
    restless = [stay for stay in found if stay.settled_after_s is None]
    rows = [
        at_most("Tracking", "overshoot at a goal", "m", farthest.accept_radius_m, farthest.overshoot_m, far),
        under("Tracking", counted("goals without coming to rest", len(restless), _goals(restless))),
    ]
    times = [(stay.settled_after_s, stay) for stay in found if stay.settled_after_s is not None]
    if times:
        slowest, stay = max(times, key=lambda pair: pair[0])
        note = f"longest, at item {stay.seq}; median {float(np.median([time for time, _ in times])):.1f} s"
        rows.append(row("Tracking", "settling time in a goal's region", "s", slowest, note))
    return rows


def _goals(those: Sequence[Stay]) -> str:
    return ", ".join(f"item {stay.seq} at {stay.entered_s:.1f} s" for stay in those[:5])


def _controller(flight: FlightRecord) -> list[BoundRow]:
    table = flight.table("/ctl/nmpc")
    if table is None or not len(table):
        return []
    mine = table[flight.armed.holds(seconds(table))]
    flags = np.concatenate(([0], mine["fallback"] != 0, [0]))
    runs = np.diff(np.flatnonzero(np.diff(flags))) if flags.any() else np.zeros(1, dtype=int)
    late = int((mine["solve_s"] > CONTROL_PERIOD_S).sum())
    rows = [row("Service", "longest run of fallbacks", "steps", float(runs[::2].max(initial=0)))]
    in_time = flight.run is None or flight.run.speed != 0.0
    if in_time:
        rows.append(under("Service", counted("control steps beyond their period", late, f"of {len(mine)}")))
    else:
        rows.append(row("Service", "control steps beyond their period", "", float(late), "in lockstep: none waited"))
    rows.append(row("Service", "largest slack of a soft limit", "", float(mine["slack_max"].max(initial=0.0))))
    return rows


def _estimator(flight: FlightRecord) -> list[BoundRow]:
    rows = []
    for topic in (name for name in flight.log.topics if name.startswith(AID_PREFIX)):
        table = flight.table(topic)
        if table is None:
            continue
        mine = table[flight.armed.holds(seconds(table))]
        used = mine["innovation_var"] > 0.0
        degrees = used.sum(axis=1)
        keep = degrees > 0
        if int(keep.sum()) < FEWEST:
            continue
        sensor = topic.removeprefix(AID_PREFIX)
        over = np.where(used, mine["innovation"], 0.0) / np.sqrt(np.where(used, mine["innovation_var"], 1.0))
        inside = float(np.mean((over[keep] ** 2).sum(axis=1) <= np.array(CHI2_95)[degrees[keep] - 1]))
        name, margin = f"{sensor}: innovations within 95 %", 100.0 * (inside - LEAST_INSIDE)
        rows.append(judged(name, "%", 100.0 * LEAST_INSIDE, 100.0 * inside, margin, subject="Estimate"))
        means = np.abs(over[keep].mean(axis=0))
        lag = _lag_one(over[keep][:, int(np.argmax(over[keep].std(axis=0)))])
        note = f"lag-1 autocorrelation {lag:.2f}"
        rows.append(at_most("Estimate", f"{sensor}: bias over sigma", "", MOST_BIAS, float(means.max()), note))
        fused_s = seconds(mine)[mine["fused"] != 0]
        if len(fused_s) > 1:
            rows.append(row("Estimate", f"{sensor}: longest gap", "s", float(np.diff(fused_s).max())))
    covariance = flight.table("/nav/covariance")
    if flight.truth is not None and flight.nav is not None and covariance is not None and len(covariance):
        error = estimate_error(flight.truth, flight.nav.between(flight.mission))
        if error is not None:
            nees = position_nees(error.t_s, error.pos_ned_m, seconds(covariance), covariance["variance"])
            rows.append(at_most("Estimate", "NEES of the position", "", MOST_NEES, float(nees.mean()), "3 expected"))
    return rows


def _lag_one(values: FloatArray) -> float:
    a, b = values[1:] - values.mean(), values[:-1] - values.mean()
    power = float((b * b).sum())
    return float((a * b).sum()) / power if power > 0.0 else 0.0


def _camera(flight: FlightRecord) -> list[BoundRow]:
    table = flight.table("/in/markers")
    if table is None or not len(table):
        return []
    mine = table[flight.armed.holds(seconds(table))]
    if len(mine) < 2:
        return []
    t_s, some = seconds(mine), mine["count"] > 0
    rows = [
        row("Camera", "pictures per second", "1/s", len(mine) / max(float(t_s[-1] - t_s[0]), 1e-9)),
        row("Camera", "pictures with markers", "%", 100.0 * float(some.mean())),
        *_fit(flight),
    ]
    seen_s = t_s[some]
    if len(seen_s) > 1:
        rows.append(row("Camera", "longest time without a marker", "s", float(np.diff(seen_s).max())))
    aid = flight.table(AID_PREFIX + "markers")
    if aid is not None and len(aid):
        age = float(np.percentile(aid["age_s"], 95.0))
        rows.append(row("Camera", "age of a fix, p95", "s", age))
    return rows


def _fit(flight: FlightRecord) -> list[BoundRow]:
    """Reprojection: how far corners lie from where map, camera and pose have them."""
    table = flight.table("/nav/fit")
    if table is None:
        return []
    mine = table[flight.armed.holds(seconds(table))]
    if len(mine) < FEWEST:
        return []
    rms = float(np.sqrt(np.mean(mine["rms_px"] ** 2)))
    note = f"p95 {np.percentile(mine['rms_px'], 95.0):.2f}, worst corner {mine['worst_px'].max():.2f} px"
    out = 100.0 * float(1.0 - mine["used"].sum() / max(int(mine["known"].sum()), 1))
    return [
        at_most("Camera", "reprojection error, rms", "px", MOST_REPROJECTION_PX, rms, note),
        at_most("Camera", "rejected markers", "%", 100.0 * MOST_MISFIT, out),
    ]


def _thrusters(flight: FlightRecord) -> list[BoundRow]:
    commands = flight.table("/out/thrusters")
    if commands is None or not len(commands):
        return []
    mine = commands[flight.armed.holds(seconds(commands))]
    names = thruster_names(flight, commands)
    if not len(mine):
        return []
    thrust = np.abs(mine["thrust_n"][:, : len(names)])
    limit = math.inf if flight.run is None else flight.run.paper_bounds.get("thrust_n", math.inf)
    full = thrust >= 0.999 * limit
    percent = 100.0 * float(full.any(axis=1).mean())
    hits = np.diff(full.astype(np.int8), axis=0, prepend=0) > 0
    by_name = ", ".join(f"{name} {count}" for name, count in zip(names, hits.sum(axis=0).tolist(), strict=False))
    means = ", ".join(f"{name} {value:.2f}" for name, value in zip(names, thrust.mean(axis=0), strict=False))
    return [
        row("Thrust", "time at the thrust limit", "%", percent),
        row("Thrust", "thruster saturations", "", float(hits.sum()), by_name),
        row("Thrust", "mean total thrust", "N", float(thrust.sum(axis=1).mean()), means),
        *_balance(names, thrust.mean(axis=0)),
    ]


def _balance(names: Sequence[str], mean_n: FloatArray) -> list[BoundRow]:
    """Port minus starboard thrust over their sum; none on vehicles without such names."""
    sides = []
    for side in ("port", "starboard"):
        found = [at for at, name in enumerate(names) if side in name.lower()]
        sides.append(float(mean_n[found].sum()) if found else math.nan)
    port, starboard = sides
    if not port + starboard > 0.0:
        return []
    percent = 100.0 * (port - starboard) / (port + starboard)
    return [
        row(
            "Thrust",
            "thrust imbalance, port over starboard",
            "%",
            percent,
            f"{port:.2f} and {starboard:.2f} N on average",
        )
    ]


def _current(flight: FlightRecord) -> list[BoundRow]:
    track = flight.judged.between(flight.mission)
    along = along_track(track)
    rows = []
    if len(along):
        rows.append(row("Current", "path with a following current", "%", 100.0 * float((along > 0.0).mean())))
    worked = drag_work(flight)
    if worked is not None:
        percent = 100.0 * worked.flown_j / worked.still_j
        note = f"{worked.flown_j:.0f} of {worked.still_j:.0f} J: same path and ground speed, drag of the vehicle file"
        rows.append(row("Current", "drag work relative to still water", "%", percent, note))
    if flight.truth is not None and flight.nav is not None:
        error = estimate_error(flight.truth, flight.nav.between(flight.mission))
        if error is not None:
            rms = float(np.sqrt(np.mean(np.sum(error.current_ned_m_s[:, :2] ** 2, axis=1))))
            rows.append(row("Current", "estimate of the current, rms", "m/s", rms))
    return rows


def _power(flight: FlightRecord) -> list[BoundRow]:
    rows = []
    used, length_m = energy_j(flight, flight.armed), path_length_m(flight.judged.between(flight.armed))
    if used is not None:
        rows.append(
            row("Power", "energy", "J", used, f"{used / length_m:.1f} J/m" if length_m > LEAST_LENGTH_M else "")
        )
    rows += _energy_of_waypoints(flight)
    rows += _energy_of_thrusters(flight, used)
    battery = flight.table("/in/power_raw")
    if battery is not None and len(battery):
        lowest = float(np.nanmin(battery["voltage_v"]))
        limit = 0.0 if flight.run is None else flight.run.parameters.get("BATT_LOW_VOLT", 0.0)
        if limit > 0.0:
            made = judged("lowest voltage", "V", limit, lowest, lowest - limit, note="BATT_LOW_VOLT")
            rows.append(under("Power", made))
        else:
            rows.append(row("Power", "lowest voltage", "V", lowest))
    return rows


def _energy_of_waypoints(flight: FlightRecord) -> list[BoundRow]:
    """Energy from one waypoint of the tour to the next: the median, and the dearest with its name and lap."""
    if flight.run is None:
        return []
    came = [(visit, visit.t_s) for visit in visits(flight.judged, flight.run) if visit.t_s is not None]
    spent = []
    for (_, start_s), (visit, end_s) in pairwise(came):
        used = energy_j(flight, Span(start_s, end_s)) if end_s > start_s else None
        if used is not None:
            spent.append((used, visit))
    if not spent:
        return []
    most, dearest = max(spent, key=lambda pair: pair[0])
    note = f"most to {dearest.waypoint.name} in lap {dearest.lap}: {most:.0f} J; {len(spent)} legs"
    return [
        row("Power", "energy from waypoint to waypoint, median", "J", float(np.median([u for u, _ in spent])), note)
    ]


def _energy_of_thrusters(flight: FlightRecord, used_j: float | None) -> list[BoundRow]:
    """Energy per thruster by the vehicle file's model, and the remaining energy."""
    found = thruster_power(flight)
    if found is None:
        return []
    taken = found.energy_j(flight.armed)
    each = ", ".join(f"{name} {joules:.0f}" for name, joules in zip(found.names, taken, strict=True))
    rows = [row("Power", "energy of the thrusters", "J", float(taken.sum()), each)]
    if used_j is not None:
        hotel_j = found.hotel_w * (flight.armed.end_s - flight.armed.start_s)
        note = f"{hotel_j:.0f} J by the vehicle file"
        rows.append(row("Power", "energy of other loads", "J", used_j - float(taken.sum()), note))
    return rows


def _inertial(flight: FlightRecord) -> list[BoundRow]:
    raw = flight.table("/in/ahrs_raw")
    table = flight.table("/in/imu") if raw is None else raw
    if table is None:
        return []
    mine = table[flight.armed.holds(seconds(table))]
    if len(mine) < FEWEST:
        return []
    gaps, norm = np.diff(seconds(mine)), np.linalg.norm(mine["accel_frd_m_s2"], axis=1)
    usual = f"median {1e3 * float(np.median(gaps)):.1f} ms"
    shaking = float(np.diff(norm).std() / math.sqrt(2.0))
    return [
        at_most("Motion sensor", "longest time between samples", "s", LONGEST_SILENCE_S, float(gaps.max()), usual),
        row("Motion sensor", "vibration (from sample to sample)", "m/s2", shaking),
        _clipping(mine),
    ]


def _clipping(samples: MessageTable) -> BoundRow:
    rates, forces = clipped(samples["rate_frd_rad_s"], samples["accel_frd_m_s2"])
    note = f"turn rate {rates}, specific force {forces}" if rates + forces else ""
    return under("Motion sensor", counted("saturated samples", rates + forces, note))


def _events(flight: FlightRecord) -> list[BoundRow]:
    """Warnings to the operator, and parameters."""
    rows = []
    if "/rosout" in flight.log:
        warned = [m.value["msg"] for m in flight.log.messages("/rosout") if m.value["level"] >= 30]
        rows.append(row("Events", "warnings to the operator", "", float(len(warned)), warned[0] if warned else ""))
    changes = flight.table("/sys/parameters")
    if changes is not None:
        names = dict.fromkeys(bytes(name).rstrip(b"\0").decode(errors="replace") for name in changes["name"])
        rows.append(row("Events", "parameters changed", "", float(len(changes)), ", ".join(names)))
    if flight.run is not None and flight.run.parameters:
        defaults = {spec.name: spec.default for spec in PARAMETERS}
        other = [
            n
            for n, v in flight.run.parameters.items()
            if n in defaults and not math.isclose(v, defaults[n], rel_tol=1e-6)
        ]
        rows.append(row("Events", "parameters not at their defaults", "", float(len(other)), ", ".join(other[:8])))
    return rows
