"""Still pictures: single, and sequences by time and by distance, with the vehicle's pose at each exposure.

Pixels are not handled here. The service requests a still by its number (``Outputs.shots``). The camera's driver
takes the first picture exposed from then on, stores it and reports it (``Inputs.stills``); the estimate at the time
of exposure is attached to it.
"""

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from autopilot.command.command_tuning import PHOTOGRAPHER
from autopilot.core import operator_messages as notices
from autopilot.core.camera import CameraModel
from autopilot.core.frames import FloatArray, wrap_pi
from autopilot.core.messages import Event, Inputs, NavHealth, NavState
from autopilot.core.stills import CameraReport, StillRecord, StoredStill
from autopilot.core.vehicle import Vehicle
from autopilot.mavlink.api import ACCEPTED, CameraIdentity, CameraState, CommandReply, CommandResult

_R_CAM_FROM_VIEW: FloatArray = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
"""(3, 3) rotation from the FRD axes of a body that faces along the optical axis to OpenCV's (x right, y down, z
ahead)."""


@dataclass(slots=True)
class _Sequence:
    left: int | None
    """None = until it is stopped."""
    interval_us: int
    next_us: int
    seq: int


@dataclass(slots=True)
class _Survey:
    distance_m: float
    place_ned_m: FloatArray | None
    """(3,) of the last one, None = the next one at once."""
    seq: int


class Photographer:
    """Camera orders and their results. Call :meth:`note` before and :meth:`step` after the other parts."""

    def __init__(self, vehicle: Vehicle) -> None:
        """ConfigError if the vehicle has no camera."""
        eye, model = vehicle.eye, CameraModel.of_vehicle(vehicle)
        self.identity = CameraIdentity(
            vehicle=vehicle.name,
            width_px=eye.width_px,
            height_px=eye.height_px,
            r_frd_from_view=model.r_frd_from_cam @ _R_CAM_FROM_VIEW,
        )
        self._report: CameraReport | None = None
        self._t_us = 0
        self._sequence: _Sequence | None = None
        self._survey: _Survey | None = None
        self._wanted: list[tuple[int, int]] = []
        """Numbers of stills to be asked for on this tick, and the mission items that want them."""
        self._pending: dict[int, tuple[int, int]] = {}
        """Number -> when it was asked for, mission item."""
        self._count = 0
        self._nav: deque[NavState] = deque(maxlen=PHOTOGRAPHER.nav_kept)
        self._records: dict[int, StillRecord] = {}
        self._news: list[StillRecord] = []
        self._fresh: list[StillRecord] = []
        self._events: list[Event] = []
        self._skipped = self._armed = False

    # Requests

    @property
    def state(self) -> CameraState:
        sequence, survey = self._sequence, self._survey
        return CameraState(
            exposing=bool(self._pending or self._wanted),
            interval_s=None if sequence is None else sequence.interval_us * 1e-6,
            distance_m=None if survey is None else survey.distance_m,
            count=self._count,
            report=self._report,
        )

    def shoot(self, count: int | None, interval_s: float, seq: int = -1) -> CommandReply:
        """A number of stills (None = until stopped) at an interval."""
        refusal = self.refusal
        if refusal:
            return CommandReply(result=CommandResult.TEMPORARILY_REJECTED, reason=f"Photo refused: {refusal}")
        if count == 1:
            if len(self._pending) + len(self._wanted) >= PHOTOGRAPHER.max_pending:
                return CommandReply(result=CommandResult.TEMPORARILY_REJECTED, reason="Photo refused: camera is busy")
            self._request(seq)
            return ACCEPTED
        if not PHOTOGRAPHER.min_interval_s <= interval_s < math.inf:
            reason = f"Photo refused: interval {interval_s:g} s, use {PHOTOGRAPHER.min_interval_s:g} s or more"
            return CommandReply(result=CommandResult.DENIED, reason=reason)
        interval_us = round(min(interval_s, 1e6) * 1e6)
        self._sequence = _Sequence(left=count, interval_us=interval_us, next_us=self._t_us, seq=seq)
        return ACCEPTED

    def shoot_every(self, distance_m: float, *, now: bool, seq: int = -1) -> CommandReply:
        """A still after every distance [m]; 0 ends the sequence."""
        if distance_m == 0.0:
            self._survey = None
            return ACCEPTED
        refusal = self.refusal
        if refusal:
            return CommandReply(result=CommandResult.TEMPORARILY_REJECTED, reason=f"Photos refused: {refusal}")
        if not PHOTOGRAPHER.min_distance_m <= distance_m < math.inf:
            reason = f"Photos refused: every {distance_m:g} m, use {PHOTOGRAPHER.min_distance_m:g} m or more, 0 to stop"
            return CommandReply(result=CommandResult.DENIED, reason=reason)
        here = self._here()
        self._survey = _Survey(distance_m=distance_m, place_ned_m=None if now else here, seq=seq)
        return ACCEPTED

    def stop(self) -> CommandReply:
        """End the sequence, by time or by distance."""
        self._sequence = self._survey = None
        return ACCEPTED

    @property
    def refusal(self) -> str:
        """Why no still can be taken now, "" when it can."""
        return "no word of the camera yet" if self._report is None else self._report.refusal

    def record(self, index: int) -> StillRecord | None:
        """A still of this run by its number."""
        return self._records.get(index)

    def take_records(self) -> tuple[StillRecord, ...]:
        """Stills stored since the last call."""
        news, self._news = tuple(self._news), []
        return news

    # One tick

    def note(self, inputs: Inputs) -> None:
        self._t_us = inputs.t_us
        if inputs.camera is not None:
            self._report = inputs.camera
        for still in inputs.stills:
            if still.index in self._pending:
                self._conclude(still)
        for index in [
            number
            for number, (requested_us, _) in self._pending.items()
            if inputs.t_us - requested_us > PHOTOGRAPHER.answer_timeout_us
        ]:
            self._conclude(StoredStill(index=index, exposure_us=inputs.t_us, problem="nothing heard of it"))

    def step(self, t_us: int, nav: NavState | None, *, armed: bool) -> tuple[tuple[int, ...], tuple[StillRecord, ...]]:
        """Numbers of the stills to take from now on, and results of earlier requests. Disarming ends sequences of a
        mission and sequences by distance.
        """
        if self._armed and not armed:
            self._survey = None
            if self._sequence is not None and self._sequence.seq >= 0:
                self._sequence = None
        self._armed = armed
        if nav is not None:
            self._nav.append(nav)
        if self._sequence is not None or self._survey is not None:
            refusal = self.refusal
            if refusal:
                self._sequence = self._survey = None
                self._events.append(notices.PHOTOS_STOPPED.event(self._t_us, reason=refusal))
        self._by_time(t_us)
        self._by_distance()
        for index, seq in self._wanted:
            self._pending[index] = (t_us, seq)
        wanted, self._wanted = tuple(index for index, _ in self._wanted), []
        fresh, self._fresh = tuple(self._fresh), []
        return wanted, fresh

    def take_events(self) -> tuple[Event, ...]:
        """Lines for the operator since the last call."""
        events, self._events = tuple(self._events), []
        return events

    def _by_time(self, t_us: int) -> None:
        sequence = self._sequence
        if sequence is None or t_us < sequence.next_us:
            return
        sequence.next_us += sequence.interval_us
        if self._may_request():
            self._request(sequence.seq)
        if sequence.left is not None:
            sequence.left -= 1
            if sequence.left <= 0:
                self._sequence = None

    def _by_distance(self) -> None:
        survey = self._survey
        here = None if survey is None else self._here()
        if survey is None or here is None:
            return
        last = survey.place_ned_m
        if last is None or float(np.linalg.norm(here - last)) >= survey.distance_m:
            survey.place_ned_m = here
            if self._may_request():
                self._request(survey.seq)

    def _may_request(self) -> bool:
        """Whether the camera responds; reports once that it does not."""
        if len(self._pending) + len(self._wanted) < PHOTOGRAPHER.max_pending:
            self._skipped = False
            return True
        if not self._skipped:
            self._skipped = True
            self._events.append(notices.PHOTOS_SKIPPED.event(self._t_us))
        return False

    def _request(self, seq: int) -> None:
        self._wanted.append((self._count, seq))
        self._count += 1

    def _here(self) -> FloatArray | None:
        """(3,) where the vehicle is, None while that is not known."""
        nav = self._nav[-1] if self._nav else None
        if nav is None or nav.health is NavHealth.INVALID or not bool(np.all(np.isfinite(nav.pos_ned_m))):
            return None
        return nav.pos_ned_m

    def _conclude(self, still: StoredStill) -> None:
        _, seq = self._pending.pop(still.index)
        pose = None if still.problem else self._pose_at(still.exposure_us)
        pos, rpy, variance = (None, None, None) if pose is None else pose
        record = StillRecord(t_us=self._t_us, still=still, seq=seq, pos_ned_m=pos, rpy_rad=rpy, variance=variance)
        while len(self._records) >= PHOTOGRAPHER.max_records:
            del self._records[next(iter(self._records))]
        self._records[still.index] = record
        self._news.append(record)
        self._fresh.append(record)
        if still.problem:
            self._events.append(notices.PHOTO_FAILED.event(self._t_us, index=still.index, reason=still.problem))

    def _pose_at(self, t_us: int) -> tuple[FloatArray, FloatArray, FloatArray] | None:
        """Position, attitude and their variances at a time, between the estimates before and after it."""
        before: NavState | None = None
        for after in self._nav:
            if after.t_us >= t_us:
                break
            before = after
        else:
            return None
        if after.health is NavHealth.INVALID or (before is None and after.t_us != t_us):
            return None
        if before is None or after.t_us == t_us or before.reset_count != after.reset_count:
            return after.pos_ned_m, after.rpy_rad, after.variance[:6]
        fraction = (t_us - before.t_us) / (after.t_us - before.t_us)
        pos = before.pos_ned_m + fraction * (after.pos_ned_m - before.pos_ned_m)
        turn = [wrap_pi(b - a) for a, b in zip(before.rpy_rad.tolist(), after.rpy_rad.tolist(), strict=True)]
        rpy = np.array([wrap_pi(a + fraction * d) for a, d in zip(before.rpy_rad.tolist(), turn, strict=True)])
        return pos, rpy, np.maximum(before.variance[:6], after.variance[:6])
