"""Missing or unwritable state files, as reasons against arming until an operator accepts them.

Reported are files of earlier runs that are not in force (:class:`autopilot.core.state_file.Loss`), and a disk that
rejects writes. Each gets a number; the parameter ``STATE_ACCEPT`` at a number accepts all up to it.
"""

import contextlib
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from autopilot.core import operator_messages as notices
from autopilot.core.background import BackgroundTask, BackgroundWorker, Cancel
from autopilot.core.clock import TICK_US
from autopilot.core.disk import cause_of
from autopilot.core.latest_value_writer import KEEP_TICKS, RETRY_TICKS
from autopilot.core.notice_queue import NoticeQueue
from autopilot.core.params import ParamSet
from autopilot.core.state_file import Loss

ACCEPT = "STATE_ACCEPT"
PROBE_BYTES = 65_536
"""Bytes of a test write, as many as a long mission needs: a nearly full disk accepts the first bytes of anything."""


def probe(folder: Path) -> str:
    """Why ``folder`` takes no writes, "" when it does or does not exist (nothing has been kept there)."""
    path = folder / ".probe"
    try:
        if not folder.is_dir():
            return ""
        try:
            with open(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600), "wb") as stream:
                stream.write(bytes(PROBE_BYTES))
                stream.flush()
                os.fsync(stream.fileno())
        finally:
            with contextlib.suppress(OSError):
                path.unlink(missing_ok=True)
    except OSError as error:
        return cause_of(error)
    return ""


@dataclass(slots=True, kw_only=True)
class _Open:
    """Something that is missing or cannot be kept."""

    number: int
    loss: Loss | None
    """Lost file, None for a disk that rejects writes."""
    accepted: bool = False


class StateCheck(NoticeQueue):
    """State check of one vehicle; called once per tick."""

    def __init__(
        self,
        params: ParamSet,
        folder: Path,
        worker: BackgroundWorker,
        losses: Sequence[Loss],
        unsaved: Sequence[Callable[[], str]] = (),
    ) -> None:
        """``desk``: worker for disk access; ``losses``: found at the start; ``unsaved``: returns what cannot be
        saved at the moment, "" = nothing.
        """
        super().__init__()
        self._params, self._folder, self._worker = params, folder, worker
        self._unsaved = unsaved
        self._count = 0
        self._open: dict[str, _Open] = {}
        self._failing: list[str] = []
        self._accepted = -1.0
        self._reasons: tuple[str, ...] = ()
        self._disk = probe(folder)
        self._probing: BackgroundTask[str] | None = None
        self._probe_at = RETRY_TICKS
        for loss in losses:
            self._begin(loss.text, loss)
        self._update(0)

    def refusals(self, t_us: int) -> tuple[str, ...]:
        """Reasons against arming, each with the parameter value that accepts it."""
        tick = t_us // TICK_US
        if self._disk:
            self._probe_again(tick)
        if self._failures() != self._failing or self._params[ACCEPT] != self._accepted:
            self._update(tick)
        return self._reasons

    def _failures(self) -> list[str]:
        found = [text for failure_of in self._unsaved if (text := failure_of())]
        return [f"disk takes no writes ({self._disk})", *found] if self._disk else found

    def _update(self, tick: int) -> None:
        self._failing = failing = self._failures()
        for text in [text for text, it in self._open.items() if it.loss is None and text not in failing]:
            del self._open[text]
        for text in failing:
            if text not in self._open:
                self._begin(text, None)
        self._accepted = self._params[ACCEPT]
        if self._accepted <= self._count:  # a number that is not given yet accepts nothing in advance
            self._accept(tick, int(self._accepted))
        remedy = f": {ACCEPT} {self._count} accepts it"
        self._reasons = tuple(text + remedy for text, it in self._open.items() if not it.accepted)

    def _begin(self, text: str, loss: Loss | None) -> None:
        self._count += 1
        self._open[text] = _Open(number=self._count, loss=loss)
        self._notices.append(notices.STATE_NOT_KEPT(text=text))

    def _accept(self, tick: int, number: int) -> None:
        for text, it in self._open.items():
            if not it.accepted and it.number <= number:
                it.accepted = True
                self._notices.append(notices.STATE_ACCEPTED(text=text))
                if it.loss is not None:
                    it.loss.accept(tick)

    def _probe_again(self, tick: int) -> None:
        """Whether the disk accepts writes by now, probed periodically."""
        if self._probing is None:
            if tick < self._probe_at:
                return

            def work(folder: Path, _: Cancel) -> str:
                return probe(folder)

            self._probing = self._worker.submit(tick + KEEP_TICKS, work, self._folder)
            return
        answer = self._probing.poll(tick)
        if answer is not None:
            self._disk = answer.value or ""
            self._probing, self._probe_at = None, tick + RETRY_TICKS
