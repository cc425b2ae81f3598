"""Frames of the page from a log: the snapshot that the loop would have left at that moment, encoded as any other."""

import base64
import time
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import cached_property
from types import SimpleNamespace
from typing import Any, Protocol

import numpy as np

from autopilot.core.errors import LogError
from autopilot.core.frames import FloatArray
from autopilot.core.geometry import Fence
from autopilot.core.messages import (
    AidStatus,
    ControlOutput,
    EnergyPlan,
    Event,
    Goal,
    LoopStats,
    MissionProgress,
    ModeState,
    NavDoubt,
    NavHealth,
    NavState,
    NmpcStatus,
    Outputs,
    ThrusterCommand,
    ThrusterHealthState,
)
from autopilot.core.samples import MarkerSighting, ObstacleTrack, PowerSample
from autopilot.core.vehicle import Vehicle
from autopilot.log.analysis import STATE_FIELDS, obstacle_position
from autopilot.log.description import Point2, Point3, RunDescription
from autopilot.log.log_session import LoggedTruth
from autopilot.log.moments import Fields, LogMoments
from autopilot.log.packing.records import reader_of
from autopilot.log.reader import Log
from autopilot.log.sample_table import SAMPLE_ROWS
from autopilot.log.topics import AID_PREFIX
from autopilot.log.visuals import ROS_LEVEL, read_path
from autopilot.view.controls import DragCurrent, DragObstacle, Steered, ViewError, dragged
from autopilot.view.encode import frame_of, message_of, picture_view, plan_points_m, scene_of
from autopilot.view.feed import CAMERA, DEVICES, TRACK_US, UNKNOWN_NED_M, LatestValues, TickSnapshot
from autopilot.view.page_state import (
    FlowView,
    LogFramesView,
    LogView,
    PictureView,
    SceneView,
    Solid,
    Steerable,
    ViewFrame,
)

NAV_US = 2_000_000
"""An estimate that is older has ended: the topic has one for each tick."""
SEVERITY = {level: severity for severity, level in reversed(list(enumerate(ROS_LEVEL)))}
"""Of a rcl_interfaces/Log level: the most severe."""
MAX_FRAMES = 200
"""Frames in one answer."""
MAX_REPEATS = 200
"""Equal readings that are looked at: two seconds of an AHRS, which is long silent then."""
MAX_TRACKS = 200
"""Reports of obstacles that are looked at for one frame."""
_status, _plan, _progress, _mode, _health, _power, _track = (
    reader_of(of)
    for of in (
        NmpcStatus,
        EnergyPlan,
        MissionProgress,
        ModeState,
        ThrusterHealthState,
        PowerSample,
        ObstacleTrack,
    )
)
_aid = reader_of(AidStatus, beside=("sensor", "fit"))
_loop = reader_of(LoopStats, beside=("part_s", "part_cpu_s", "ticks_s", "ticks_cpu_s", "process"))
_of_goal = reader_of(Goal, beside=("yaw_rad", "speed_asked", "following", "drive", "facing_ned_m"))


class World(Protocol):
    """The simulated world of the run; what the page has changed in it is in the messages of the log."""

    def solids(self, t_s: float, moved_m: Mapping[int, Point2]) -> tuple[Solid, ...]: ...

    def flow(self, t_s: float, pos_ned_m: FloatArray, shown_m: FloatArray, added_m_s: Point2) -> FlowView: ...


class LogFrames:
    """Scene, frames, pictures and events of one log, by time. Safe for several threads."""

    def __init__(self, log: Log, vehicle: Vehicle, world: World | None = None) -> None:
        """``world``: of a simulation, where it is known. LogError if nothing in it can be shown."""
        self._log, self._vehicle, self._world = log, vehicle, world
        self._moments = LogMoments(log)
        self._begin_us, self._end_us = self._moments.span_us
        if not self._moments.topics:
            raise LogError(f"{log.path}: has no messages; give a log of a run")
        self._run = log.description or RunDescription(scenario=log.path.stem, vehicle=log.run.get("vehicle", ""))
        self._fence = _fence_of(self._run)
        topics = self._moments.topics
        self._aids = [topic for topic in topics if topic.startswith(AID_PREFIX)]
        self._devices = {row.topic: DEVICES[row.of] for row in SAMPLE_ROWS if row.of in DEVICES and row.topic in topics}

    def about(self) -> LogView:
        """The log as a whole."""
        return self._about

    @cached_property
    def _about(self) -> LogView:
        return LogView(
            name=self._log.path.name,
            begin_s=1e-6 * self._begin_us,
            end_s=1e-6 * self._end_us,
            scene=self._scene(),
            events=tuple(message_of(number, event) for number, event in enumerate(self._events(), start=1)),
        )

    def _scene(self) -> SceneView:
        missing = ("This is a log: the page only shows.", *(f"{problem}." for problem in self._log.problems))
        return scene_of(
            self._snapshot(self._begin_us),
            self._vehicle,
            Steerable(missing=missing),
            simulated="/sim/truth" in self._moments.topics,
            pictures="/in/camera" in self._moments.topics,
        )

    def frame(self, t_s: float) -> ViewFrame:
        """The page's state at that time, or at the nearest that the log has. Its messages are in :attr:`about`."""
        t_us = min(max(round(1e6 * t_s), self._begin_us), self._end_us)
        snapshot = self._snapshot(t_us)
        return frame_of(snapshot, self._vehicle, Steered(), now_s=snapshot.wall_s, viewers=1)

    def frames(self, from_s: float, to_s: float, step_s: float) -> LogFramesView:
        """Frames at regular times, no more than :data:`MAX_FRAMES`. ViewError for times that are none."""
        asked = {"from": from_s, "to": to_s, "step": step_s}
        if to_s < from_s or step_s <= 0.0 or (to_s - from_s) / step_s >= MAX_FRAMES:
            raise ViewError(f"{asked} is not 1 to {MAX_FRAMES} frames; give from <= to, and a longer step")
        count = int((to_s - from_s) / step_s + 1e-6) + 1
        frames = tuple(self.frame(from_s + index * step_s) for index in range(count))
        return LogFramesView(frames=frames, trail_ned_m=self._trail(from_s))

    def _trail(self, t_s: float) -> tuple[Point3, ...]:
        """Where it had been in the minutes before, oldest first."""
        found = self._moments.latest_raw("/viz/path", round(1e6 * t_s))
        points = () if found is None else _path(found[1]).tolist()
        return tuple((round(n, 4), round(e, 4), round(d, 4)) for n, e, d in points)

    def picture(self, t_s: float) -> PictureView | None:
        """The last picture before that time with what was found in it, None if there is none."""
        found = self._moments.latest_value("/in/camera", round(1e6 * t_s))
        if found is None:
            return None
        import cv2  # expensive: imported only where pictures are viewed

        image = cv2.imdecode(np.frombuffer(found["data"], np.uint8), cv2.IMREAD_GRAYSCALE)
        if image is None or found["format"] != "jpeg":
            return None
        t_us, (height_px, width_px) = found["t_us"], image.shape[:2]
        row = self._moments.latest("/in/markers", t_us)
        sighting = _sighting(row) if row is not None and row["t_us"] == t_us else None
        jpeg = base64.b64encode(found["data"]).decode()
        return picture_view(t_us=t_us, width_px=width_px, height_px=height_px, jpeg=jpeg, sighting=sighting)

    def flow(self, t_s: float) -> FlowView | None:
        """The simulated current at that time, None where it is not known."""
        t_us = min(max(round(1e6 * t_s), self._begin_us), self._end_us)
        if self._world is None:
            return None
        nav = self._latest("/nav/state", t_us)
        place = np.array(UNKNOWN_NED_M) if nav is None else nav["pos_ned_m"]
        return self._world.flow(1e-6 * t_us, place, plan_points_m(self._run, place), self._changes(t_us)[1])

    @cached_property
    def _dragged(self) -> tuple[tuple[int, DragObstacle | DragCurrent], ...]:
        """What the page has changed, in the order of time [us]."""
        return tuple((event.t_us, one) for event in self._events() if (one := dragged(event.text)) is not None)

    def _changes(self, t_us: int) -> tuple[dict[int, Point2], Point2]:
        """Where obstacles have been put by then, and the flow that was added [m/s]."""
        moved: dict[int, Point2] = {}
        added = (0.0, 0.0)
        for at_us, one in self._dragged:
            if at_us > t_us:
                break
            if isinstance(one, DragObstacle):
                moved[one.number] = (one.north_m, one.east_m)
            else:
                added = (one.north_m_s, one.east_m_s)
        return moved, added

    def _solids(self, t_us: int) -> tuple[Solid, ...]:
        if self._world is None:
            return _solids(self._run, 1e-6 * t_us)
        return self._world.solids(1e-6 * t_us, self._changes(t_us)[0])

    def _events(self) -> Iterator[Event]:
        for t_us, value in self._moments.every("/rosout"):
            yield Event(t_us=t_us, severity=SEVERITY.get(value.get("level", 0), 6), text=str(value.get("msg", "")))

    def _snapshot(self, t_us: int) -> TickSnapshot:
        """As :class:`~autopilot.view.feed.Feed` would have made it."""
        latest = self._latest
        nav_row = latest("/nav/state", t_us)
        now_us = t_us if nav_row is None else int(nav_row["t_us"])
        nav = None if nav_row is None or t_us - now_us > NAV_US else self._nav(nav_row, t_us)
        control, goal, mode = self._control(t_us), latest("/ctl/goal", t_us), latest("/sys/mode", t_us)
        plan, health, power = latest("/ctl/plan", t_us), latest("/ctl/thrusters", t_us), latest("/in/power_raw", t_us)
        ahrs, depth = latest("/in/ahrs_raw", t_us), latest("/in/depth", t_us)
        command, progress = latest("/out/thrusters", t_us), latest("/mission/progress", t_us)
        return TickSnapshot(
            number=0,
            wall_s=time.monotonic(),
            outputs=Outputs(
                t_us=t_us,
                command=ThrusterCommand(
                    t_us=t_us,
                    thrust_n=np.zeros(8) if command is None else command["thrust_n"],
                    pwm_us=() if command is None else tuple(command["pwm_us"].tolist()),
                ),
                nav=nav,
                mode=ModeState(t_us=t_us, armed=False, custom_mode=0, failsafes=0) if mode is None else _mode(mode),
                goal=None if goal is None else _goal(goal, t_us),
                control=control,
                progress=None if progress is None else _progress(progress),
            ),
            scene=1,
            description=self._run,
            fence=self._fence,
            truth=self._truth(t_us),
            solids=self._solids(t_us),
            latest=LatestValues(
                control=control,
                plan=None if plan is None else _plan(plan),
                plan_us=0 if plan is None else plan["t_us"],
                thrusters=None if health is None else self._effective(health),
                received_us=self._received_us(t_us),
                aids={aid.sensor: aid for topic in self._aids if (aid := self._aid(topic, t_us)) is not None},
                tracks=self._tracks(t_us),
                power=None if power is None else _power(power),
                ahrs_rpy_rad=None if ahrs is None else ahrs["rpy_rad"],
                depth_m=None if depth is None else float(depth["depth_m"]),
                loop=self._loop(t_us),
            ),
            messages=(),
            trail_ned_m=(),
            picture=None,
        )

    def _latest(self, topic: str, t_us: int) -> Fields | None:
        return self._moments.latest(topic, t_us)

    def _nav(self, row: Fields, t_us: int) -> NavState:
        covariance, status = self._latest("/nav/covariance", t_us), self._latest("/nav/status", t_us)
        bits = 0 if status is None else int(status["doubts"])
        return NavState(
            t_us=row["t_us"],
            health=NavHealth.INVALID if status is None else NavHealth(int(status["health"])),
            **{name: row[name] for name in STATE_FIELDS},
            variance=np.zeros(12) if covariance is None else covariance["variance"],
            reset_count=0 if status is None else int(status["reset_count"]),
            doubts=frozenset(doubt for bit, doubt in enumerate(NavDoubt) if bits >> bit & 1),
        )

    def _truth(self, t_us: int) -> LoggedTruth | None:
        row, acting = self._latest("/sim/truth", t_us), self._latest("/sim/thrusters", t_us)
        contact = self._latest("/sim/contact", t_us)
        if row is None:
            return None
        seen: Any = SimpleNamespace(
            **{name: row[name] for name in ("pos_ned_m", "rpy_rad", "current_ned_m_s")},
            thrust_n=np.zeros(8) if acting is None else acting["thrust_n"],
            power_w=0.0 if acting is None else float(acting["power_w"]),
            contact_count=0 if contact is None else int(contact["count"]),
            contact_depth_m=0.0 if contact is None else float(contact["penetration_m"]),
        )
        made: LoggedTruth = seen
        return made

    def _control(self, t_us: int) -> ControlOutput | None:
        status = self._latest("/ctl/nmpc", t_us)
        if status is None:
            return None
        paths = [self._moments.latest_raw(topic, t_us) for topic in ("/ctl/horizon", "/ctl/route")]
        horizon, route = (np.zeros((0, 3)) if found is None else _path(found[1]) for found in paths)
        tube, tube_m = self._latest("/ctl/tube", t_us), np.zeros(0)
        if tube is not None and paths[0] is not None and tube["t_us"] == paths[0][0]:
            tube_m = tube["radius_m"][: len(horizon)]
        return ControlOutput(
            thrust_n=np.zeros(0),
            status=_status(status),
            horizon_ned_m=horizon,
            route_ned_m=route[:, :2],
            tube_m=tube_m,
        )

    def _effective(self, row: Fields) -> ThrusterHealthState:
        health: ThrusterHealthState = _health(row)
        return replace(health, effectiveness=health.effectiveness[: len(self._vehicle.thrusters)])

    def _aid(self, topic: str, t_us: int) -> AidStatus | None:
        row = self._latest(topic, t_us)
        aid: AidStatus | None = None if row is None else _aid(row, sensor=topic.removeprefix(AID_PREFIX))
        return aid

    def _received_us(self, t_us: int) -> dict[str, int]:
        found: dict[str, int] = {}
        for topic, row in self._devices.items():
            received_us = self._news_us(topic, row.reading, t_us)
            if received_us is not None:
                found[row.device] = max(received_us, found.get(row.device, received_us))
        picture = self._moments.latest_raw("/in/markers", t_us) or self._moments.latest_raw("/in/camera", t_us)
        return found if picture is None else {**found, CAMERA: picture[0]}

    def _news_us(self, topic: str, reading: str, t_us: int) -> int | None:
        """When a device last said something new: of one whose ``reading`` repeats itself, the first of the same."""
        newest = self._latest(topic, t_us)
        if newest is None:
            return None
        at_us: int = newest["t_us"]
        for _ in range(MAX_REPEATS if reading else 0):
            before = self._latest(topic, at_us - 1)
            if before is None or not np.array_equal(before[reading], newest[reading]):
                break
            at_us = before["t_us"]
        return at_us

    def _tracks(self, t_us: int) -> dict[int, ObstacleTrack]:
        """The last report of each obstacle, the reports of some seconds looked at backwards."""
        found: dict[int, ObstacleTrack] = {}
        at_us = t_us
        for _ in range(MAX_TRACKS):
            row = self._latest("/in/tracks", at_us)
            if row is None or t_us - row["t_us"] >= TRACK_US:
                break
            found.setdefault(int(row["track_id"]), _track(row))
            at_us = row["t_us"] - 1
        return dict(sorted(found.items()))

    def _loop(self, t_us: int) -> LoopStats | None:
        row = self._latest("/sys/loop", t_us)
        if row is None:
            return None
        stats: LoopStats = _loop(row, **({"part_s": tuple(row["part_s"].tolist())} if "part_s" in row else {}))
        return stats


def _path(data: bytes) -> Any:
    """(n, 3) points; none of a path that another program has written."""
    try:
        return read_path(data)[1]
    except LogError:
        return np.zeros((0, 3))


def _goal(row: Fields, t_us: int) -> Goal | None:
    """None for one that has ended: it is written every second."""
    if t_us - row["t_us"] > NAV_US:
        return None
    goal: Goal = _of_goal(row, yaw_rad=None if row["yaw_free"] else float(row["yaw_rad"]))
    return goal


def _sighting(row: Fields) -> MarkerSighting:
    count = int(row["count"])
    return MarkerSighting(
        t_us=row["t_us"],
        ids=tuple(row["ids"][:count].tolist()),
        corners_px=row["corners_px"][: 8 * count].reshape(count, 4, 2),
        laser_px=row["laser_px"] if row["laser_found"] else None,
    )


def _fence_of(run: RunDescription) -> Fence:
    """The fence in force, for the clearance."""
    items = [item for item in run.fence if item.center_m is not None or len(item.vertices_m) >= 3]
    return Fence(
        inclusions=tuple(item.shape for item in items if item.inclusion),
        exclusions=tuple(item.shape for item in items if not item.inclusion),
    )


def _solids(run: RunDescription, t_s: float) -> tuple[Solid, ...]:
    """Obstacles as described, at that time."""
    found = []
    for number, obstacle in enumerate(run.obstacles, start=1):
        north, east, *depth = obstacle_position(obstacle, np.array([t_s]))[0].tolist()
        found.append(
            Solid(
                number=number,
                kind="sphere" if depth else "cylinder",
                center_m=(north, east),
                depth_m=depth[0] if depth else None,
                radius_m=obstacle.radius_m,
                corners_m=(),
            )
        )
    return tuple(found)
