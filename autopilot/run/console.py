"""Console output of a run: messages to the operator."""

import queue
import threading
from collections.abc import Callable

from autopilot.core.messages import Outputs, RunEnd, Severity

REPEAT_US = 5_000_000
"""The same line is not printed twice within this time."""
MAX_WAITING = 1000
"""Lines that wait for a console that does not take them."""

Print = Callable[[str], None]


class Console:
    """Prints from a thread: a paused terminal or an unread pipe must not stop the loop."""

    def __init__(self) -> None:
        self._lines: queue.Queue[str | None] = queue.Queue(MAX_WAITING)
        self._thread = threading.Thread(target=self._run, name="console", daemon=True)
        self._thread.start()

    def print(self, line: str) -> None:
        """Queue lines; dropped when the queue is full."""
        try:
            self._lines.put_nowait(line)
        except queue.Full:
            return

    def close(self, patience_s: float = 2.0) -> None:
        try:
            self._lines.put(None, timeout=patience_s)
        except queue.Full:
            return
        self._thread.join(patience_s)

    def _run(self) -> None:
        while (line := self._lines.get()) is not None:
            try:
                print(line, flush=True)
            except (OSError, ValueError):  # the reader has gone
                return


class EventLines:
    def __init__(self, show: Print) -> None:
        self._show = show
        self._shown_us: dict[str, int] = {}
        self.run_end: RunEnd | None = None
        """How an operator has ended the run."""

    def step(self, outputs: Outputs) -> None:
        self.run_end = self.run_end or outputs.run_end
        for event in outputs.events:
            if event.severity < Severity.DEBUG:
                mark = "" if event.severity > Severity.WARNING else "! "
                self.line(outputs.t_us, f"{mark}{event.text}")

    def line(self, t_us: int, text: str) -> None:
        """Print a message with its time, unless it repeats the last one."""
        if t_us - self._shown_us.get(text, -REPEAT_US) >= REPEAT_US:
            self._shown_us = {line: when for line, when in self._shown_us.items() if t_us - when < REPEAT_US}
            self._shown_us[text] = t_us
            self._show(f"{t_us * 1e-6:8.2f} s  {text}")
