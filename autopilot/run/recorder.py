"""Feeds the log from the runtime: inputs, outputs and, in simulation, the truth of every tick.

A log describes its run (``run.json``, :mod:`autopilot.log.description`) at its start, at every arming and whenever
a plan is changed while armed; readers use the last description. A log that cannot be written does not end a run:
the operator is notified at once, and a new log is tried at every arming.
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Protocol

from autopilot.core import operator_messages as notices
from autopilot.core.disk import cause_of
from autopilot.core.errors import LogError
from autopilot.core.messages import Inputs, LoopStats, Outputs, Severity
from autopilot.core.notice_queue import NoticeQueue
from autopilot.core.samples import CameraFrame
from autopilot.log.description import RunDescription
from autopilot.log.log_session import LoggedTruth, RunLog, SimulationRecord
from autopilot.log.writer import NO_FILE, Payload

CLOSE_S = 30.0
"""How long the end of a run waits for a disk that does not answer."""


class TruthSource(Protocol):
    """Ground truth of a simulated vehicle."""

    @property
    def truth(self) -> LoggedTruth: ...

    @property
    def payload_levels(self) -> tuple[float, ...]:
        """Where each thing that it carries is, 0 to 1; in the order of the vehicle file."""
        ...


class NullRecorder:
    dropped = 0
    queued = (0, 0)
    lost = False
    failure: str | None = None
    path: Path | None = None

    def still(self, exposure_us: int, png: bytes) -> None: ...

    def take_notices(self) -> tuple[tuple[Severity, str], ...]:
        return ()

    def record(self, inputs: Inputs, outputs: Outputs, frames: Sequence[CameraFrame]) -> None: ...

    def loop_stats(self, stats: LoopStats) -> None: ...

    def close(self) -> None: ...


class RunRecorder(NoticeQueue):
    """One log per session (``path`` fixed) or one per arming (``open_log`` called at every arming, with its time).

    ``waits``: in lockstep a log is finished at the disarming; where time does not wait, beside the loop.
    """

    def __init__(
        self,
        open_log: Callable[[int], RunLog],
        describe: Callable[[], tuple[RunDescription, Mapping[str, Payload]]],
        *,
        plan_revision: Callable[[], int],
        truth: TruthSource | None,
        per_arming: bool,
        waits: bool = True,
    ) -> None:
        """LogError if the session's log cannot be made: nothing runs yet."""
        super().__init__()
        self._open_log = open_log
        self._describe = describe
        self._truth = truth
        self._per_arming = per_arming
        self._waits = waits
        self._armed = False
        self._log: RunLog | None = None if per_arming else open_log(0)
        self._ending: list[tuple[RunLog, bool]] = []
        """Logs being finished, and whether their problem has been reported to the operator."""
        self._dropped_before = 0
        self._slow_reported = False
        self._plan_revision = plan_revision
        self._described = plan_revision()
        self.lost = False
        """Recording has failed although it should be active."""
        self.failure: str | None = None
        """Why a log of this run is not whole, the last reason; None while all is well."""

    @property
    def path(self) -> Path | None:
        """Path of the present log, None without one (or while it is being created in the background)."""
        log = self._log
        return None if log is None or log.writer.failure is not None or log.writer.path == NO_FILE else log.writer.path

    def still(self, exposure_us: int, png: bytes) -> None:
        if self._log is not None:
            self._log.still(exposure_us, png)

    @property
    def dropped(self) -> int:
        """Messages of all logs that were lost so far."""
        now = 0 if self._log is None else self._log.writer.dropped
        return self._dropped_before + now + sum(log.writer.dropped for log, _ in self._ending)

    @property
    def queued(self) -> tuple[int, int]:
        """Messages and bytes that wait to be written to the present log."""
        return (0, 0) if self._log is None else self._log.writer.queued

    def record(self, inputs: Inputs, outputs: Outputs, frames: Sequence[CameraFrame]) -> None:
        self._describe_news(inputs.t_us, outputs.mode.armed)
        self._close_ended()
        log = self._log
        if log is None:
            return
        source = self._truth
        log.tick(
            inputs, outputs, frames, None if source is None else SimulationRecord(source.truth, source.payload_levels)
        )
        if log.writer.failure is not None:
            self._failed(log)
        elif log.writer.dropped and not self._slow_reported:
            self._slow_reported = True
            self._tell(notices.LOG_DISK_SLOW(), f"log {log.writer.path}: messages lost, the disk is too slow")
        if self._per_arming and not self._armed:
            self._end()
        error = log.writer.take_error()
        if error is not None:
            raise error  # to the guard, as if it had occurred here

    def loop_stats(self, stats: LoopStats) -> None:
        if self._log is not None:
            self._log.loop(stats)

    def close(self) -> None:
        """Finish all files, with a bounded wait for the disk. ``failure`` names what is missing."""
        logs = self._ending + ([] if self._log is None else [(self._log, False)])
        self._log, self._ending = None, []
        for log, reported in logs:
            self._close(log, CLOSE_S, reported=reported)

    def _describe_news(self, t_us: int, armed: bool) -> None:
        """Write a description at every arming, and for every plan changed while armed."""
        begins = armed and not self._armed
        self._armed = armed
        revision = self._plan_revision()
        if not begins and not (armed and revision != self._described):
            return
        self._described = revision
        if self._log is not None:
            self._log.describe(t_us, *self._describe())
        elif begins:
            self._begin(t_us)

    def _begin(self, t_us: int) -> None:
        self._slow_reported = False
        try:
            self._log = self._open_log(t_us)
            self.lost = False
        except (LogError, OSError) as error:
            self.lost = True
            self._tell(notices.LOG_STOPPED(cause=cause_of(error)), str(error))

    def _end(self) -> None:
        """The log is complete: finish it at once, or beside the loop where time does not wait."""
        log, self._log = self._log, None
        if log is None:
            return
        if self._waits:
            self._close(log, None, reported=False)
        else:
            log.writer.end()
            self._ending.append((log, False))

    def _close_ended(self) -> None:
        """Logs that were being finished beside the loop."""
        if not any(log.writer.finished for log, _ in self._ending):
            return
        done = [(log, reported) for log, reported in self._ending if log.writer.finished]
        self._ending = [(log, reported) for log, reported in self._ending if not log.writer.finished]
        for log, reported in done:
            self._close(log, None, reported=reported)

    def _failed(self, log: RunLog) -> None:
        """Continue without a log that has failed; the next arming tries again."""
        self._tell(notices.LOG_STOPPED(cause=log.writer.cause), f"log {log.writer.path}: {log.writer.failure}")
        self._log = None
        self.lost = True
        log.writer.end()
        self._ending.append((log, True))

    def _close(self, log: RunLog, timeout_s: float | None, *, reported: bool) -> None:
        try:
            log.close(timeout_s)
        except LogError as error:
            if not reported:
                self._tell(notices.LOG_STOPPED(cause=log.writer.cause or "disk does not answer"), str(error))
        missed = log.writer.take_error()
        if missed is not None:
            self._tell(notices.LOG_INCOMPLETE(), f"log {log.writer.path}: {type(missed).__name__}: {missed}")
        self._dropped_before += log.writer.dropped

    def _tell(self, text: notices.OperatorText, reason: str) -> None:
        self.failure = reason
        self._notices.append(text)
