"""Feeds the log from the runtime: every tick's inputs, outputs and, in simulation, truth.

A log describes its run (``run.json``, :mod:`autopilot.log.description`) at its start, at every arming and whenever a
plan comes while armed; readers take the last one.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Protocol

from autopilot.core.messages import Inputs, LoopStats, Outputs
from autopilot.core.samples import CameraFrame
from autopilot.log.description import RunDescription
from autopilot.log.packing.vehicle import TruthLike
from autopilot.log.session import RunLog


class LoggedTruth(TruthLike, Protocol):
    """The part of a simulated vehicle's truth that is logged."""

    @property
    def contact_count(self) -> int:
        """Contacts since the start."""
        ...

    @property
    def contact_depth_m(self) -> float:
        """Deepest penetration of now."""
        ...


class TruthSource(Protocol):
    """What a simulated vehicle can say that a real one cannot."""

    @property
    def truth(self) -> LoggedTruth:
        """Where the vehicle really is."""
        ...


class NullRecorder:
    """Logs nothing."""

    dropped = 0

    def record(self, inputs: Inputs, outputs: Outputs, frames: Sequence[CameraFrame]) -> None:
        """Ignore a tick."""

    def loop_stats(self, stats: LoopStats) -> None:
        """Ignore loop statistics."""

    def close(self) -> None:
        """Nothing to close."""


class RunRecorder:
    """One log per session (``path`` fixed) or one per arming (``open_log`` called at every arming)."""

    def __init__(
        self,
        open_log: Callable[[], RunLog],
        describe: Callable[[], tuple[RunDescription, Mapping[str, bytes]]],
        *,
        plan_revision: Callable[[], int],
        truth: TruthSource | None,
        per_arming: bool,
    ) -> None:
        self._open_log = open_log
        self._describe = describe
        self._truth = truth
        self._per_arming = per_arming
        self._armed = False
        self._log: RunLog | None = None if per_arming else open_log()
        self._plan_revision = plan_revision
        self._described = plan_revision()
        self.dropped = 0

    def record(self, inputs: Inputs, outputs: Outputs, frames: Sequence[CameraFrame]) -> None:
        """Log one tick."""
        self._describe_news(inputs.t_us, outputs.mode.armed)
        log = self._log
        if log is None:
            return
        log.inputs(inputs)
        for frame in frames:
            log.camera(frame)
        if self._truth is not None:
            truth = self._truth.truth
            log.truth(inputs.t_us, truth)
            log.contact(inputs.t_us, truth.contact_count, truth.contact_depth_m)
        log.outputs(outputs)
        self.dropped = log.dropped
        if self._per_arming and not self._armed:
            log.close()
            self._log = None

    def loop_stats(self, stats: LoopStats) -> None:
        """Log the health of the loop."""
        if self._log is not None:
            self._log.loop(stats)

    def close(self) -> None:
        """Finish the file."""
        if self._log is not None:
            self._log.close()
            self._log = None

    def _describe_news(self, t_us: int, armed: bool) -> None:
        """A description at every arming, and of every plan that comes while armed."""
        begins = armed and not self._armed
        self._armed = armed
        revision = self._plan_revision()
        if not begins and not (armed and revision != self._described):
            return
        self._described = revision
        if self._log is None:
            self._log = self._open_log()
        else:
            self._log.describe(t_us, *self._describe())
