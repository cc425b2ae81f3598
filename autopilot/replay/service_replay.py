"""Replays a logged run through the whole service and compares the outputs with the log, message by message.

Inputs come from the log (:mod:`autopilot.replay.service_inputs`): samples, detections, received bytes, and recorded
results of disk access and background work. Outputs are written to a log of their own by the code that logs a
flight.
"""

import tempfile
from collections.abc import Iterable
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from autopilot.command.service import Autopilot
from autopilot.command.service_parts import ServiceParts
from autopilot.core.errors import LogError
from autopilot.core.messages import Inputs, MavlinkFrame, Outputs
from autopilot.core.nondeterminism import NondeterminismReplay
from autopilot.log.compare import WALL_CLOCK_FIELDS, WALL_CLOCK_TOPICS, Difference, compare_logs
from autopilot.log.description import RunDescription
from autopilot.log.log_session import RunLog
from autopilot.log.reader import Log, open_log
from autopilot.log.writer import LogWriter
from autopilot.replay.again import service_again
from autopilot.replay.service_inputs import ServiceInputs
from autopilot.run.compose import end_slow_work
from autopilot.run.recorded_answers import SHELF_ASKED

NOT_OURS = ("/sim/", "/viz/", "/in/camera")
"""How topics begin that are the world's, or for viewers alone."""
MAVLINK_OUT = "/out/mavlink"
_SIGNED = 0x01
_V2 = 0xFD
_TAG = 6


@dataclass(frozen=True, slots=True, kw_only=True)
class ReplayResult:
    ticks: int
    messages: int
    """That were compared."""
    topics: int
    differences: tuple[Difference, ...]
    """The first of each field, in the order of time."""
    stopped: str
    """Why it ended before the log, "" if it did not."""
    remarks: tuple[str, ...]
    """Limits of the comparison."""

    @property
    def same(self) -> bool:
        return not self.differences


@dataclass(slots=True)
class Rerun:
    """Service that is stepped with the inputs of a log, tick by tick; use as a context manager."""

    log: Log
    changes: tuple[tuple[str, float], ...] = ()
    """Parameters that differ from the log's."""
    _end: ExitStack = field(default_factory=ExitStack)
    _nondeterminism: NondeterminismReplay = field(default_factory=NondeterminismReplay)
    service: Autopilot = field(init=False)
    parts: ServiceParts = field(init=False)
    inputs: ServiceInputs = field(init=False)
    looked_at_logs_us: int | None = None
    """Time of a client's first access to logs on board, which are not in this one."""

    def __enter__(self) -> "Rerun":
        with ExitStack() as undo:
            folder = Path(undo.enter_context(tempfile.TemporaryDirectory(prefix="replay-")))
            self.inputs = ServiceInputs(self.log)
            self.service, self.parts = service_again(
                self.log, nondeterminism=self._nondeterminism, folder=folder, changes=self.changes
            )
            undo.callback(end_slow_work, self.parts)
            self._end = undo.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._end.close()

    def step(self, inputs: Inputs) -> Outputs:
        """Replay the calls between the previous tick and this one, then this tick."""
        self._nondeterminism.tell(inputs.answers)
        if self.looked_at_logs_us is None and any(note.kind == SHELF_ASKED for note in inputs.answers):
            self.looked_at_logs_us = inputs.t_us
        sent: list[MavlinkFrame] = []
        at = 0
        for call in inputs.between:
            if call.t_us is None:
                sent += self.service.beat()
            else:
                sent += self.service.serve(call.t_us, inputs.mavlink_rx[at : at + call.frames])
                at += call.frames
        outputs = self.service.step(replace(inputs, mavlink_rx=inputs.mavlink_rx[at:]))
        if sent:
            outputs = replace(outputs, mavlink_tx=(*sent, *outputs.mavlink_tx))
        return replace(outputs, faults=outputs.faults + inputs.faults) if inputs.faults else outputs


def replay_service(
    log: Log,
    *,
    changes: Iterable[tuple[str, float]] = (),
    out: Path | None = None,
) -> ReplayResult:
    """Replay the inputs of a log into its service and compare all outputs with the log.

    Parameters
    ----------
    log
        Log of the service from its start.
    changes
        Parameter name and value of each parameter that differs from the log's.
    out
        Where to keep the log of the replay, None = it is deleted.

    Returns
    -------
    ReplayResult
        Differences, and what could not be compared.

    Raises
    ------
    LogError
        The log lacks inputs or the record of the service.
    """
    with tempfile.TemporaryDirectory(prefix="replay-") as folder, Rerun(log, tuple(changes)) as rerun:
        path = out or Path(folder) / "replay.mcap"
        ticks = 0
        record = _record(log, path)
        try:
            for inputs in rerun.inputs:
                outputs = rerun.step(inputs)
                record.inputs(inputs)
                record.outputs(outputs)
                ticks += 1
        finally:
            record.close()
        if not ticks:
            raise LogError(f"{log.path}: holds no whole tick: {rerun.inputs.stopped}")
        return _compared(log, open_log(path), ticks, rerun)


def _record(log: Log, path: Path) -> RunLog:
    """Log of a replay: topics of the service, without those of the world."""
    run = {**log.run, "replay_of": log.path.name}
    keep = {name: log.attachments[name] for name in ("vehicle.json", "run.json") if name in log.attachments}
    writer = LogWriter(path, epoch_ns=log.epoch_ns, metadata=run, attachments=keep, lossless=True)
    return RunLog(writer, log.description or RunDescription(scenario="", vehicle=""), camera_period_us=None)


def _compared(log: Log, again: Log, ticks: int, rerun: Rerun) -> ReplayResult:
    stopped, remarks = rerun.inputs.stopped, []
    for topic in (MAVLINK_OUT,):
        for one in (log, again):
            if topic in one:
                _without_tags(one[topic])
    out_of_sight = [topic for topic in (*log.topics, *again.topics) if topic.startswith(NOT_OURS)]
    ignored = {*WALL_CLOCK_TOPICS, *out_of_sight}
    found = compare_logs(log, again, ignored, WALL_CLOCK_FIELDS, prefix=bool(stopped))
    if rerun.looked_at_logs_us is not None:
        since_s = 1e-6 * rerun.looked_at_logs_us
        remarks.append(
            f"{MAVLINK_OUT} from {since_s:.2f} s on: a client looked at logs on board, which are not in this"
        )
        found = [one for one in found if one.topic != MAVLINK_OUT or (one.t_s is not None and one.t_s < since_s)]
    both = {topic: again.topics[topic].count for topic in log.topics if topic in again.topics and topic not in ignored}
    return ReplayResult(
        ticks=ticks,
        messages=sum(min(log.topics[topic].count, count) for topic, count in both.items()),
        topics=len(both),
        differences=tuple(sorted(found, key=lambda one: (float("inf") if one.t_s is None else one.t_s, one.topic))),
        stopped=stopped,
        remarks=tuple(remarks),
    )


def _without_tags(table: Any) -> None:
    """Remove signature hashes, which are not comparable: the key is in no log."""
    data = table["data"]
    signed = np.flatnonzero((data[:, 0] == _V2) & (data[:, 2] & _SIGNED > 0))
    for row in signed:
        length = int(table["length"][row])
        data[row, max(length - _TAG, 0) : length] = 0
