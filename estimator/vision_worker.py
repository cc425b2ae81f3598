"""Marker detection in the background: frames in, sightings out as samples of a later tick.

In lockstep a sighting is due a fixed time after its frame and the loop waits for it, so that a run does not depend on
the speed of the machine. In real time the loop does not wait: one frame is in work, the newest one waits and replaces
an older one, and a late sighting has the time of its frame (the estimator fuses it there).
"""

import time
from collections import deque
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Protocol

import cv2

from autopilot.core.guard import Guard
from autopilot.core.messages import NavHealth, NavState
from autopilot.core.samples import CameraFrame, FrameVerdict, MarkerSighting, PictureReport
from autopilot.estimator.frame_filter import FrameFilter
from autopilot.estimator.vision import Hint

SUSPECT_EVERY = 3
"""With a prediction that is not good every third frame is searched without it: a vehicle that is somewhere else would
not find itself among the markers that should be in view."""
ACQUISITION_EVERY, ACQUISITION_US = 2 * SUSPECT_EVERY, 380_000
"""Without a prediction the whole dictionary is searched, which is slow: every sixth frame (of 30 Hz at 5 Hz), of slow
cameras the first after so long: three must fall into the time in which fixes agree."""
FOUND_US = ACQUISITION_US // 2
"""Once markers have been found, but no position yet, the same with every third frame."""

_COUNTERS = tuple(f"frames.{verdict.value}" for verdict in FrameVerdict)

MAX_PENDING = 4
"""Frames that may wait in lockstep; a newer one is dropped and counted when detection cannot follow."""


class Detector(Protocol):
    """Pure function from a frame (and a predicted pose) to its detections."""

    def detect(self, frame: CameraFrame, hint: Hint | None) -> MarkerSighting: ...


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _FrameRequest:
    due_us: int
    frame: CameraFrame
    hint: Hint | None


@dataclass(slots=True, eq=False, kw_only=True)
class _Pending:
    """A frame in processing or done."""

    due_us: int
    sighting: "Future[MarkerSighting]"
    late: bool = False


class VisionWorker:
    def __init__(self, detector: Detector, *, delay_s: float, frame_filter: FrameFilter, paced: bool = False) -> None:
        """``paced``: time does not wait for the detector, so the newest frame wins."""
        self._detector = detector
        self._frame_filter = frame_filter
        self._delay_us = round(delay_s * 1e6)
        self._paced = paced
        self._pool = ThreadPoolExecutor(max_workers=1, thread_name_prefix="vision")
        self._pending: deque[_Pending] = deque()
        self._waiting: _FrameRequest | None = None
        """Paced only: the newest frame, behind the one that is in work."""
        self._searched_us = -ACQUISITION_US
        """When a frame was last searched without a prediction."""
        self._blind_frames = self._suspect_frames = 0
        """Frames since the last search without any prediction, and since the estimate was good."""
        self._found = False
        """Whether the last picture showed markers."""
        self.dropped = 0
        """Frames that were never looked at because detection did not follow."""
        self.late = 0
        """Sightings that were not there when they were due (paced only)."""
        self.guard = Guard()
        """Keeps exceptions of the detector that a picture does not explain."""
        self.failed = 0
        """Pictures at which detection raised an exception: no sighting."""

    def submit(self, t_us: int, frame: CameraFrame, nav: NavState | None) -> None:
        """Start the detection of a frame that came in at ``t_us``; one that is no picture of a floor is dropped."""
        if self._frame_filter.judge(frame) is not FrameVerdict.OK:
            return
        hint = None
        if nav is not None and nav.health is not NavHealth.INVALID:
            self._suspect_frames = self._suspect_frames + 1 if nav.health is not NavHealth.GOOD else 0
            if self._suspect_frames % SUSPECT_EVERY != 1:
                hint = Hint(pos_ned_m=nav.pos_ned_m, rpy_rad=nav.rpy_rad)
        else:
            found = nav is not None and self._found
            every, longest_us = (SUSPECT_EVERY, FOUND_US) if found else (ACQUISITION_EVERY, ACQUISITION_US)
            self._blind_frames += 1
            if self._blind_frames < every and t_us - self._searched_us < longest_us:
                return
            self._searched_us, self._blind_frames = t_us, 0
        request = _FrameRequest(due_us=t_us + self._delay_us, frame=frame, hint=hint)
        if self._paced:
            self.dropped += self._waiting is not None
            self._waiting = request
            self._begin_waiting()
        elif len(self._pending) >= MAX_PENDING:
            self.dropped += 1
        else:
            self._begin(request)

    def _begin(self, request: _FrameRequest) -> None:
        sighting = self._pool.submit(self._timed, request.frame, request.hint)
        self._pending.append(_Pending(due_us=request.due_us, sighting=sighting))

    def _begin_waiting(self) -> None:
        """Give the newest frame to the thread if it has nothing to do."""
        idle = not self._pending or self._pending[-1].sighting.done()
        if self._waiting is not None and idle:
            self._begin(self._waiting)
            self._waiting = None

    def _timed(self, frame: CameraFrame, hint: Hint | None) -> MarkerSighting:
        begin_s = time.thread_time()
        sighting = self._detector.detect(frame, hint)
        return replace(sighting, decode_us=round(1e6 * (time.thread_time() - begin_s)))

    def collect(self, t_us: int) -> list[MarkerSighting]:
        """Sightings that are due. In lockstep those that are not ready are waited for, in a paced run never."""
        found = []
        while self._pending and self._pending[0].due_us <= t_us:
            first = self._pending[0]
            if self._paced and not first.sighting.done():
                self.late += not first.late
                first.late = True
                break
            try:
                sighting = self._pending.popleft().sighting.result()
                self._found = len(sighting.ids) > 0
                found.append(sighting)
            except Exception as error:  # noqa: BLE001 - errors other than OpenCV's go to the guard
                self.failed += 1
                if not isinstance(error, cv2.error):
                    self.guard.t_us = t_us
                    self.guard.note("vision", error)
        self._begin_waiting()
        return found

    def take_reports(self) -> tuple[PictureReport, ...]:
        """Statistics of the images since the last call."""
        return self._frame_filter.take_reports()

    def counters(self) -> Mapping[str, int]:
        """Frames so far by result: ``frames.ok``, ``frames.dark``, ..., ``frames.failed``."""
        result = dict(zip(_COUNTERS, self._frame_filter.counts.values(), strict=True))
        result["frames.dropped"] = self.dropped
        result["frames.failed"] = self.failed
        if self._paced:
            result["frames.late"] = self.late
        return result

    def close(self) -> None:
        self._waiting = None
        self._pool.shutdown(wait=True, cancel_futures=True)
