"""Snapshots that the loop leaves for the page: references to its results, nothing else.

The loop's part is a few comparisons per tick. Without viewers only messages and a coarse track are kept; with
viewers a :class:`TickSnapshot` replaces the previous one ten times per second of real time. Lock-free: a snapshot
is complete, immutable, and published by one assignment. All further work is done on the view's own thread
(:mod:`autopilot.view.hub`).
"""

import time
from collections import deque
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np

from autopilot.core.frames import FloatArray
from autopilot.core.geometry import Fence
from autopilot.core.messages import (
    AidStatus,
    ControlOutput,
    EnergyPlan,
    Event,
    Inputs,
    LoopStats,
    Outputs,
    ThrusterHealthState,
)
from autopilot.core.samples import (
    AhrsSample,
    CameraFrame,
    DepthSample,
    MarkerSighting,
    ObstacleTrack,
    PowerSample,
    Sample,
)
from autopilot.core.sensors import SENSOR_ROWS, SensorRow
from autopilot.log.description import RunDescription
from autopilot.log.log_session import LoggedTruth
from autopilot.view.page_state import Solid

FRAME_S = 0.1
"""Real time between two frames of the page."""
PICTURE_S = 0.2
"""Real time between two pictures."""
PICTURE_STEP = 2
"""Subsampling of pictures for the page, in both axes."""
MESSAGES = 60
TRAIL_US = 250_000
TRAIL_POINTS = 1200
"""Five minutes."""
TRACK_US = 5_000_000
"""Display time of an obstacle report."""
UNKNOWN_NED_M = (0.0, 0.0, 0.5)
"""Where the current is shown at first, while there is no estimate."""
CAMERA = "camera"
DEVICES = {kind: row for row in SENSOR_ROWS if row.device != CAMERA for kind in row.kinds}
"""Devices by sample type; pictures are handled separately."""


class Watched(Protocol):
    """Data beside the loop's inputs and outputs. Called by the loop only, while there are viewers."""

    def revision(self) -> Hashable:
        """Changes when the description may be another."""
        ...

    def describe(self) -> RunDescription:
        """The run as things stand now."""
        ...

    def fence(self) -> Fence: ...

    def truth(self) -> LoggedTruth | None:
        """Where a simulated vehicle really is."""
        ...

    def solids(self) -> tuple[Solid, ...]:
        """Obstacles of a simulated world where they are now."""
        ...


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class CapturedPicture:
    """A subsampled camera picture with its detections."""

    number: int
    t_us: int
    pixels: Any
    """(rows, columns, 3) uint8 BGR."""
    width_px: int
    height_px: int
    sighting: MarkerSighting | None


@dataclass(slots=True, eq=False, kw_only=True)
class LatestValues:
    """Latest values of what does not arrive on every tick."""

    control: ControlOutput | None = None
    """Of the last control step."""
    plan: EnergyPlan | None = None
    plan_us: int = 0
    """Time at which it came into force."""
    thrusters: ThrusterHealthState | None = None
    loop: LoopStats | None = None
    power: PowerSample | None = None
    ahrs_rpy_rad: FloatArray | None = None
    depth_m: float | None = None
    received_us: dict[str, int] = field(default_factory=dict)
    """When each device delivered last, by :data:`DEVICES` and :data:`CAMERA`."""
    aids: dict[str, AidStatus] = field(default_factory=dict)
    tracks: dict[int, ObstacleTrack] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class TickSnapshot:
    """All that a frame is made of, as it was at one tick."""

    number: int
    wall_s: float
    """On the monotonic clock."""
    outputs: Outputs
    scene: int
    description: RunDescription
    fence: Fence
    truth: LoggedTruth | None
    solids: tuple[Solid, ...]
    latest: LatestValues
    messages: tuple[tuple[int, Event], ...]
    trail_ned_m: tuple[FloatArray, ...]
    picture: CapturedPicture | None


class Feed:
    """The loop's end of the view. One loop calls ``tick``; the view's thread reads ``snapshot``."""

    def __init__(self, watched: Watched, scenes: int = 0) -> None:
        """``scenes``: how many scenes other runs have had on the same page."""
        self._watched_run = watched
        self._kept = LatestValues()
        self._readings: dict[str, bytes] = {}
        self._messages: deque[tuple[int, Event]] = deque(maxlen=MESSAGES)
        self._message_count = 0
        self._trail: deque[FloatArray] = deque(maxlen=TRAIL_POINTS)
        self._trail_us = -TRAIL_US
        self._due_s = self._scene_due_s = self._picture_due_s = 0.0
        self._scene = scenes
        self._described: tuple[Hashable, RunDescription] | None = None
        self._unseen: CapturedPicture | None = None
        """Waits for what detection finds in it."""
        self._picture: CapturedPicture | None = None
        self.watched = False
        """There are viewers; set by the view's thread."""
        self.pictured = False
        """There are viewers of pictures."""
        self.snapshot: TickSnapshot | None = None
        """The newest; None before the first."""

    def tick(self, inputs: Inputs, outputs: Outputs, frames: Sequence[CameraFrame]) -> None:
        if outputs.events:
            for event in outputs.events:
                self._message_count += 1
                self._messages.append((self._message_count, event))
        if outputs.nav is not None and outputs.t_us - self._trail_us >= TRAIL_US:
            self._trail_us = outputs.t_us
            self._trail.append(outputs.nav.pos_ned_m)
        if not self.watched:
            return
        self._keep(inputs, outputs)
        if frames:
            self._kept.received_us[CAMERA] = inputs.t_us
        now_s = time.monotonic()
        if self.pictured:
            self._queue_picture(now_s, inputs, frames)
        if now_s >= self._due_s:
            self._due_s = now_s + FRAME_S
            self._put(now_s, outputs)

    def loop_stats(self, stats: LoopStats) -> None:
        self._kept.loop = stats

    def _keep(self, inputs: Inputs, outputs: Outputs) -> None:
        kept = self._kept
        if outputs.control is not None:
            kept.control = outputs.control
            if outputs.control.plan is not None:
                kept.plan, kept.plan_us = outputs.control.plan, outputs.t_us
        if outputs.goal is None:
            kept.plan = None
        if outputs.thrusters is not None:
            kept.thrusters = outputs.thrusters
        for aid in outputs.aids:
            kept.aids[aid.sensor] = aid
        for sample in inputs.samples:
            row = DEVICES.get(type(sample))
            if row is not None and self._is_news(row, sample):
                kept.received_us[row.device] = inputs.t_us
            if isinstance(sample, AhrsSample):
                kept.ahrs_rpy_rad = sample.rpy_rad
            elif isinstance(sample, DepthSample):
                kept.depth_m = sample.depth_m
            elif isinstance(sample, PowerSample):
                kept.power = sample
            elif isinstance(sample, ObstacleTrack):
                kept.tracks[sample.track_id] = sample

    def _is_news(self, row: SensorRow, sample: Sample) -> bool:
        """Whether a device reports a change."""
        if not row.reading:
            return True
        reading: bytes = np.asarray(getattr(sample, row.reading)).tobytes()
        before, self._readings[row.device] = self._readings.get(row.device), reading
        return reading != before

    def _queue_picture(self, now_s: float, inputs: Inputs, frames: Sequence[CameraFrame]) -> None:
        """A picture waits until its detections are done, or the next one arrives."""
        waiting = self._unseen
        if waiting is not None:
            for sample in inputs.samples:
                if isinstance(sample, MarkerSighting) and sample.t_us == waiting.t_us:
                    self._show(waiting, sample)
                    return
        if not frames or now_s < self._picture_due_s:
            return
        if waiting is not None:
            self._show(waiting, None)
        frame = frames[-1]
        image = frame.image_bgr
        self._picture_due_s = now_s + PICTURE_S
        self._unseen = CapturedPicture(
            number=0 if self._picture is None else self._picture.number + 1,
            t_us=frame.t_us,
            pixels=image[::PICTURE_STEP, ::PICTURE_STEP].copy(),  # a driver may use its buffer again
            width_px=image.shape[1],
            height_px=image.shape[0],
            sighting=None,
        )

    def _show(self, picture: CapturedPicture, sighting: MarkerSighting | None) -> None:
        self._unseen = None
        self._picture = replace(picture, sighting=sighting)

    def _put(self, now_s: float, outputs: Outputs) -> None:
        run, kept, t_us = self._watched_run, self._kept, outputs.t_us
        described = self._described
        if described is None or now_s >= self._scene_due_s:
            self._scene_due_s = now_s + 1.0
            revision = run.revision()
            if described is None or revision != described[0]:
                self._described = described = (revision, run.describe())
                self._scene += 1
        before = self.snapshot
        self.snapshot = TickSnapshot(
            number=1 if before is None else before.number + 1,
            wall_s=now_s,
            outputs=outputs,
            scene=self._scene,
            description=described[1],
            fence=run.fence(),
            truth=run.truth(),
            solids=run.solids(),
            latest=replace(
                kept,
                received_us=dict(kept.received_us),
                aids=dict(kept.aids),
                tracks={number: track for number, track in kept.tracks.items() if t_us - track.t_us < TRACK_US},
            ),
            messages=tuple(self._messages),
            trail_ned_m=tuple(self._trail),
            picture=self._picture,
        )
