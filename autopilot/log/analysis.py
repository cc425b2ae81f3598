"""Analysis of a log: tracks, waypoint visits, laps, clearances, energy, estimation errors.

Verdicts are in :mod:`autopilot.log.check`. Times are seconds of the service's clock, everything else SI.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from autopilot.core.errors import LogError
from autopilot.core.frames import FloatArray
from autopilot.core.geometry import Polygon, lengths_m
from autopilot.core.messages import ProgressState
from autopilot.core.shapes import clearance_m
from autopilot.log.description import FenceItemDescription, Obstacle, Point2, RunDescription, Waypoint
from autopilot.log.packing.record_values import COUNTER_NAMES, LAST_NAMES
from autopilot.log.reader import Log, MessageTable
from autopilot.log.schemas import layout
from autopilot.log.topics import type_of
from autopilot.log.visuals import read_path

BoolArray: TypeAlias = NDArray[np.bool_]

MICROSECOND_S = 1e-6
"""Resolution of the service's clock: a span ends this long before the message that ends it."""

TOPICS_OF_INTEREST = (
    *("/sim/truth", "/sim/thrusters", "/sim/contact", "/nav/state", "/nav/covariance", "/nav/status"),
    *("/ctl/nmpc", "/ctl/goal", "/out/thrusters", "/mission/progress", "/sys/mode", "/sys/loop", "/sys/process"),
    *("/nav/fit", "/ctl/drive", "/in/power_raw"),
)
"""Read in one pass; what a log does not have is left out."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class VehicleTrack:
    """The vehicle over time, true or estimated; (n,) and (n, 3) arrays."""

    t_s: FloatArray
    pos_ned_m: FloatArray
    rpy_rad: FloatArray
    vel_frd_m_s: FloatArray
    vel_water_frd_m_s: FloatArray
    rate_frd_rad_s: FloatArray
    current_ned_m_s: FloatArray

    def between(self, span: "Span") -> "VehicleTrack":
        keep = span.holds(self.t_s)
        return VehicleTrack(**{name: getattr(self, name)[keep] for name in self.__slots__})

    @property
    def vel_level_m_s(self) -> FloatArray:
        """(n, 3) surge, sway and heave relative to the water in the level frame, whose speeds are limited: of a vehicle
        that goes ahead nose up, no part of the velocity is heave."""
        (roll, pitch, _), (u, v, w) = self.rpy_rad.T, self.vel_water_frd_m_s.T
        down = np.sin(roll) * v + np.cos(roll) * w
        surge, heave = np.cos(pitch) * u + np.sin(pitch) * down, np.cos(pitch) * down - np.sin(pitch) * u
        return np.column_stack((surge, np.cos(roll) * v - np.sin(roll) * w, heave))

    @property
    def planar_speed_m_s(self) -> FloatArray:
        """(n,) norm of surge and sway relative to the water."""
        surge, sway, _ = self.vel_level_m_s.T
        result: FloatArray = np.hypot(surge, sway)
        return result

    @property
    def literal_speed_m_s(self) -> FloatArray:
        """(n,) abs(u + v), the paper's constraint (5a) taken literally."""
        surge, sway, _ = self.vel_level_m_s.T
        result: FloatArray = np.abs(surge + sway)
        return result


STATE_FIELDS = tuple(field.name for field in fields(VehicleTrack) if field.name != "t_s")
"""Of ``autopilot_msgs/VehicleState``, and of NavState."""


@dataclass(frozen=True, slots=True)
class Span:
    """A time from start to end, both included."""

    start_s: float
    end_s: float

    def holds(self, t_s: FloatArray) -> BoolArray:
        """(n,)"""
        return (t_s >= self.start_s) & (t_s <= self.end_s)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FlightRecord:
    """A log, loaded and cut into the times that are judged."""

    log: Log
    run: RunDescription | None
    truth: VehicleTrack | None
    nav: VehicleTrack | None
    armed: Span
    """From arming to disarming or the end of the log; the whole log if it has no arming state."""
    mission: Span
    """From arming to the completion of the mission, or as ``armed``."""

    @property
    def judged(self) -> VehicleTrack:
        """The truth, or the estimate for a log without truth. LogError without either."""
        track = self.truth if self.truth is not None else self.nav
        if track is None:
            raise self.log.lacks("neither /sim/truth nor /nav/state", "there is nothing to judge")
        return track

    def table(self, topic: str) -> MessageTable | None:
        """A topic of fixed size, None if the log does not have it."""
        return known_table(self.log, topic)


@dataclass(frozen=True, slots=True, kw_only=True)
class Visit:
    """Closest approach to one waypoint of the tour."""

    waypoint: Waypoint
    lap: int
    """From 1."""
    t_s: float | None
    """When it was first inside position and heading band, None = never."""
    distance_m: float
    """At the best moment of that stay, or of the time that was left for it."""
    yaw_error_rad: float


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class EstimateError:
    """Estimate minus truth at the times of the estimate."""

    t_s: FloatArray
    pos_ned_m: FloatArray
    yaw_rad: FloatArray
    current_ned_m_s: FloatArray

    @property
    def pos_rms_m(self) -> float:
        """Root of the mean squared distance."""
        return float(np.sqrt(np.mean(np.sum(self.pos_ned_m**2, axis=1))))

    @property
    def yaw_rms_rad(self) -> float:
        """Root of the mean squared yaw error."""
        return float(np.sqrt(np.mean(self.yaw_rad**2)))


def load_flight(log: Log) -> FlightRecord:
    log.load(TOPICS_OF_INTEREST)
    log.check_clock()
    truth, nav = _track(log, "/sim/truth"), _track(log, "/nav/state")
    times = [track.t_s for track in (truth, nav) if track is not None and len(track.t_s)]
    whole = Span(min(float(t[0]) for t in times), max(float(t[-1]) for t in times)) if times else Span(0.0, 0.0)
    armed = _armed_span(log, whole)
    return FlightRecord(
        log=log, run=log.description, truth=truth, nav=nav, armed=armed, mission=_mission_span(log, armed)
    )


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Prediction:
    t_s: float
    """When it was made."""
    at_s: FloatArray
    """(n,) times of its points, all ``t_s`` in logs without them."""
    pos_ned_m: FloatArray
    """(n, 3)"""


def predictions(log: Log) -> list[Prediction]:
    """Predictions of the controller, in order; empty if the log has none."""
    if "/ctl/horizon" not in log:
        return []
    found = []
    for time_ns, data in log.raw_messages("/ctl/horizon"):
        at_s, points = read_path(data)
        t_s = 1e-9 * (time_ns - log.epoch_ns)
        found.append(Prediction(t_s=t_s, at_s=at_s - 1e-9 * log.epoch_ns, pos_ned_m=points))
    return found


def foreseen(made: Sequence[Prediction], ahead_s: float) -> tuple[FloatArray, FloatArray]:
    """(n,) times and (n, 3) positions predicted for them ``ahead_s`` earlier."""
    known = [one for one in made if len(one.at_s) > 1 and one.at_s[-1] >= one.t_s + ahead_s > one.at_s[0]]
    times = np.array([one.t_s + ahead_s for one in known])
    places = [
        [np.interp(t, one.at_s, one.pos_ned_m[:, i]) for i in range(3)] for one, t in zip(known, times, strict=True)
    ]
    return times, np.array(places).reshape(-1, 3)


def along_track(track: VehicleTrack) -> FloatArray:
    """(n,) component of the current in the direction of travel over ground, 0 at rest."""
    if len(track.t_s) < 2:
        return np.zeros(len(track.t_s))
    moved = np.gradient(track.pos_ned_m[:, :2], track.t_s, axis=0)
    speed = np.hypot(moved[:, 0], moved[:, 1])
    going = speed > 0.02
    return np.where(going, np.sum(moved * track.current_ned_m_s[:, :2], axis=1) / np.where(going, speed, 1.0), 0.0)


def position_nees(t_s: FloatArray, error_m: FloatArray, known_s: FloatArray, variance: FloatArray) -> FloatArray:
    """(n,) squared errors of the position (n, 3) over their variances (m, 12), summed."""
    at = np.stack([np.interp(t_s, known_s, variance[:, i]) for i in range(3)], axis=1)
    result: FloatArray = np.sum(error_m**2 / np.maximum(at, 1e-12), axis=1)
    return result


def seconds(table: MessageTable) -> FloatArray:
    """(n,) times of a topic's messages."""
    result: FloatArray = table["t_us"] * 1e-6
    return result


def thruster_count(commands: MessageTable) -> int:
    """How many of the columns of ``/out/thrusters`` are thrusters: the others have no pulse."""
    return int((commands["pwm_us"] != 0).any(axis=0).sum())


def thruster_names(flight: FlightRecord, commands: MessageTable) -> tuple[str, ...]:
    """As the vehicle file has them, else numbered."""
    known = () if flight.run is None else flight.run.thruster_names
    return known or tuple(f"thruster {i + 1}" for i in range(thruster_count(commands)))


def wrap(angles_rad: FloatArray) -> FloatArray:
    """The same angles in [-pi, pi)."""
    return (angles_rad + np.pi) % (2.0 * np.pi) - np.pi


def known_table(log: Log, topic: str) -> MessageTable | None:
    """Table of one of our topics, None if the log does not have it. LogError if its definition differs from this
    version's.
    """
    table = log.get(topic)
    if table is None:
        return None
    kind = type_of(topic)
    expected = set(layout(kind).dtype.names or ()) - {"header", "stamp"}
    if not expected <= set(table.dtype.names or ()):
        raise LogError(
            f"{log.path}: {topic} is not {kind} as this version defines it; use the version that wrote the log"
        )
    return table


def last_counts(log: Log) -> dict[str, int]:
    """Final values of the counters, by name; empty if the log has none, or those of another version."""
    table = log.get("/nav/counters")
    ours = layout("autopilot_msgs/NavCounters").dtype
    fields = (ours.names or ())[1:]
    has = () if table is None else table.dtype.names or ()
    if table is None or not len(table) or not set(fields[:-1]) <= set(has):
        return {}
    found = [(np.ravel(table[field][-1]), math.prod(ours[field].shape)) for field in fields if field in has]
    # Logs of earlier versions have room for fewer sensors.
    values = np.concatenate([np.pad(value, (0, max(0, width - len(value)))) for value, width in found]).tolist()
    return {name: int(count) for name, count in zip((*COUNTER_NAMES, *LAST_NAMES), values, strict=False) if name}


def _track(log: Log, topic: str) -> VehicleTrack | None:
    table = known_table(log, topic)
    return None if table is None else VehicleTrack(t_s=seconds(table), **{name: table[name] for name in STATE_FIELDS})


def _armed_span(log: Log, whole: Span) -> Span:
    mode = known_table(log, "/sys/mode")
    if mode is None:
        return whole
    t_s, armed = seconds(mode), mode["armed"] != 0
    if not armed.any():
        return whole
    first = int(np.argmax(armed))
    off = np.flatnonzero(~armed[first:])
    return Span(float(t_s[first]), float(t_s[first + off[0]]) - MICROSECOND_S if len(off) else whole.end_s)


def _mission_span(log: Log, armed: Span) -> Span:
    progress = known_table(log, "/mission/progress")
    if progress is None:
        return armed
    t_s = seconds(progress)
    active = np.flatnonzero((progress["state"] == ProgressState.ACTIVE) & armed.holds(t_s))
    if not len(active):
        return armed
    done = np.flatnonzero(progress["state"][active[0] :] == ProgressState.COMPLETE)
    end = float(t_s[active[0] + done[0]]) if len(done) else armed.end_s
    return Span(armed.start_s, min(end, armed.end_s))


def distance_to_polygon(points_m: FloatArray, vertices_m: Sequence[Point2]) -> FloatArray:
    """(n,) distance of points (n, 2) from the outline of a polygon, positive inside."""
    return -clearance_m(Polygon(vertices_ned_m=np.array(vertices_m, dtype=float)), points_m)


def distance_to_fence(points_m: FloatArray, shapes: Sequence[FenceItemDescription]) -> FloatArray:
    """(n,) distance of points (n, 2) from the nearest boundary of the fence, positive on the permitted side."""
    nearest: FloatArray = np.full(len(points_m), np.inf)
    for item in shapes:
        away_m = clearance_m(item.shape, points_m)
        nearest = np.minimum(nearest, -away_m if item.inclusion else away_m)
    return nearest


def distance_to_center(track: VehicleTrack, center_m: Sequence[float]) -> FloatArray:
    """(n,) distance from a vertical axis (center of 2) or a point (center of 3)."""
    offset = track.pos_ned_m[:, : len(center_m)] - np.array(center_m)
    result: FloatArray = np.linalg.norm(offset, axis=1)
    return result


def obstacle_position(obstacle: Obstacle, t_s: FloatArray) -> FloatArray:
    """(n, 2) or (n, 3) where an obstacle was at times (n,)."""
    if not obstacle.path_m:
        return np.broadcast_to(np.array(obstacle.center_m), (len(t_s), len(obstacle.center_m)))
    corners = np.array([*obstacle.path_m, *(obstacle.path_m[:1] if obstacle.ends == "loop" else ())])
    s = lengths_m(corners)
    travelled = obstacle.speed_m_s * np.maximum(t_s - obstacle.start_s, 0.0)
    if obstacle.ends == "loop":
        travelled = travelled % s[-1]
    elif obstacle.ends == "bounce":
        travelled = s[-1] - np.abs(travelled % (2.0 * s[-1]) - s[-1])
    return np.stack([np.interp(travelled, s, corners[:, 0]), np.interp(travelled, s, corners[:, 1])], axis=1)


def distance_to_obstacle(track: VehicleTrack, obstacle: Obstacle) -> FloatArray:
    """(n,) distance from an obstacle's axis or centre, wherever it was at the time."""
    where = obstacle_position(obstacle, track.t_s)
    result: FloatArray = np.linalg.norm(track.pos_ned_m[:, : where.shape[1]] - where, axis=1)
    return result


def obstacle_limit_m(obstacle: Obstacle, run: RunDescription) -> float | None:
    """Least distance of the vehicle's centre from an obstacle's axis; None = not judged."""
    required_m = run.accept.cylinder_clearance_m
    if required_m is None:
        return None
    touch = obstacle.radius_m + run.body_radius_m
    return touch if obstacle.path_m else max(required_m, touch)


def clearances(track: VehicleTrack, run: RunDescription) -> list[tuple[str, FloatArray, float]]:
    """Name of each obstacle, the walls and the fence that are judged, the distance (n,) of the vehicle's centre from
    it, and the least that is asked for.
    """
    limits = [(obstacle, obstacle_limit_m(obstacle, run)) for obstacle in run.obstacles]
    found = [
        (obstacle.name or f"obstacle {number}", distance_to_obstacle(track, obstacle), limit)
        for number, (obstacle, limit) in enumerate(limits, 1)
        if limit is not None
    ]
    plane, wall_m = track.pos_ned_m[:, :2], run.accept.wall_clearance_m
    if run.tank_polygon_m and wall_m is not None:
        found.append(("walls", distance_to_polygon(plane, run.tank_polygon_m), wall_m))
    if run.fence and wall_m is not None:
        found.append(("fence", distance_to_fence(plane, run.fence), run.body_radius_m))
    return found


def waypoint_errors(track: VehicleTrack, waypoint: Waypoint) -> tuple[FloatArray, FloatArray]:
    """(n,) distance and (n,) absolute yaw error (0 for a free heading) to a waypoint."""
    distance = distance_to_center(track, waypoint.pos_ned_m)
    if waypoint.yaw_rad is None:
        return distance, np.zeros_like(distance)
    return distance, np.abs(wrap(track.rpy_rad[:, 2] - waypoint.yaw_rad))


def visit_order(run: RunDescription) -> list[tuple[Waypoint, int]]:
    """The tour required of the run: every waypoint in order, with its lap (from 1)."""
    points, laps = run.waypoints, run.accept.laps or 1
    if run.tour:
        return [(points[number], 1) for number in run.tour]
    closed = run.closed_tour and len(points) > 1
    return [(point, lap) for lap in range(1, laps + 1) for point in points] + [(points[0], laps) for _ in range(closed)]


def visits(track: VehicleTrack, run: RunDescription) -> list[Visit]:
    """The tour required of the run with the result of each visit."""
    errors = {id(waypoint): waypoint_errors(track, waypoint) for waypoint in run.waypoints}
    found: list[Visit] = []
    at = 0
    for waypoint, lap in visit_order(run):
        visit, at = _visit(track, waypoint, lap, errors[id(waypoint)], at)
        found.append(visit)
    return found


def _visit(
    track: VehicleTrack, waypoint: Waypoint, lap: int, errors: tuple[FloatArray, FloatArray], at: int
) -> tuple[Visit, int]:
    """The first stay at a waypoint from row ``at`` on, and the row where the search for the next one starts."""
    distance, yaw = errors
    score = np.maximum(distance / waypoint.accept_radius_m, yaw / waypoint.accept_yaw_rad)[at:]
    inside = np.flatnonzero(score <= 1.0)
    if not len(score):
        return Visit(waypoint=waypoint, lap=lap, t_s=None, distance_m=np.inf, yaw_error_rad=np.inf), at
    if not len(inside):
        best, end, t_s = at + int(np.argmin(score)), len(distance), None
    else:
        first = int(inside[0])
        outside = np.flatnonzero(score[first:] > 1.0)
        stay = int(outside[0]) if len(outside) else len(score) - first
        best, end = at + first + int(np.argmin(score[first : first + stay])), at + first
        t_s = float(track.t_s[at + first])
    visit = Visit(waypoint=waypoint, lap=lap, t_s=t_s, distance_m=float(distance[best]), yaw_error_rad=float(yaw[best]))
    return visit, end


def lap_spans(tour: Sequence[Visit], run: RunDescription, begun_s: float) -> list[Span]:
    """Start and end of every completed lap, from its first waypoint to its last. A lap of a single waypoint is the
    path to it, from ``begun_s`` or from the visit before.
    """
    size = len(run.tour or run.waypoints)
    closed = run.closed_tour and size > 1 and not run.tour
    spans: list[Span] = []
    for lap in range(run.accept.laps or 1):
        steps = tour[lap * size : (lap + 1) * size + closed]
        times = [visit.t_s for visit in steps if visit.t_s is not None]
        if steps and len(times) == size + closed:
            start_s = times[0] if size > 1 else (spans[-1].end_s if spans else begun_s)
            spans.append(Span(start_s, times[-1]))
    return spans


def flown_laps(flight: FlightRecord) -> list[Span]:
    """Completed laps, by the track that is judged."""
    run, track = flight.run, flight.judged.between(flight.armed)
    return [] if run is None else lap_spans(visits(track, run), run, flight.armed.start_s)


def energy_j(flight: FlightRecord, span: Span) -> float | None:
    """Energy [J] that thrusters and hotel load took in a span; None if the log holds no power."""
    thrusters = flight.table("/sim/thrusters")
    hotel_w = flight.run.hotel_power_w if flight.run is not None else 0.0
    if thrusters is not None:
        t_s = seconds(thrusters)
        keep = span.holds(t_s)
        return _integral(t_s[keep], thrusters["power_w"][keep] + hotel_w) if keep.any() else None
    power = flight.table("/in/power_raw")
    if power is None:
        return None
    used = np.interp([span.start_s, span.end_s], seconds(power), power["energy_used_j"])
    return float(used[1] - used[0])


def _integral(t_s: FloatArray, values: FloatArray) -> float:
    """Trapezoidal rule."""
    return float(np.sum(0.5 * (values[1:] + values[:-1]) * np.diff(t_s)))


def estimate_error(truth: VehicleTrack, nav: VehicleTrack) -> EstimateError | None:
    """Estimate against truth where both exist; truth is interpolated to the times of the estimate."""
    keep = Span(float(truth.t_s[0]), float(truth.t_s[-1])).holds(nav.t_s) if len(truth.t_s) else None
    if keep is None or not keep.any():
        return None
    t_s = nav.t_s[keep]
    yaw = np.interp(t_s, truth.t_s, np.unwrap(truth.rpy_rad[:, 2]))
    return EstimateError(
        t_s=t_s,
        pos_ned_m=nav.pos_ned_m[keep] - _interpolate(t_s, truth.t_s, truth.pos_ned_m),
        yaw_rad=wrap(nav.rpy_rad[keep, 2] - yaw),
        current_ned_m_s=nav.current_ned_m_s[keep] - _interpolate(t_s, truth.t_s, truth.current_ned_m_s),
    )


def _interpolate(t_s: FloatArray, known_s: FloatArray, values: FloatArray) -> FloatArray:
    return np.stack([np.interp(t_s, known_s, values[:, i]) for i in range(values.shape[1])], axis=1)


def sequence_gaps(log: Log) -> int:
    """Messages that are missing between the first and the last of each fixed-size topic that was loaded."""
    tables: list[Any] = [log[topic] for topic in TOPICS_OF_INTEREST if topic in log]
    return sum(int(table["sequence"][-1]) - int(table["sequence"][0]) + 1 - len(table) for table in tables)
