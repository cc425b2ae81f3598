"""Common parts of ``autopilot sitl`` and ``autopilot run``: stop signals and final messages."""

import contextlib
import gc
import os
import signal
import time
from collections.abc import Callable, Iterator
from types import FrameType
from typing import TYPE_CHECKING, TypeVar

import click

if TYPE_CHECKING:
    from autopilot.run.boot_links import BootLinks
    from autopilot.run.session import Session, SessionOptions
    from autopilot.view.foxglove import FoxgloveServer
    from autopilot.view.hub import Hub

S = TypeVar("S", bound="Session")
_START_FIELD = 22 - 3
"""starttime in /proc/self/stat (proc_pid_stat(5), counted from 1), behind the name, which is the second of the fields
and may have blanks in it."""


def process_start_s() -> float:
    """Start of this process as Unix time; the present time if the system does not provide it."""
    now_s = time.time()
    try:
        with open("/proc/self/stat", encoding="ascii", errors="replace") as stream:
            fields = stream.read().rpartition(")")[2].split()
        began_s = int(fields[_START_FIELD]) / os.sysconf("SC_CLK_TCK")
        return now_s - max(0.0, time.clock_gettime(time.CLOCK_BOOTTIME) - began_s)
    except (OSError, ValueError, IndexError, AttributeError):
        return now_s


class StopSignals:
    """SIGTERM, SIGINT and SIGHUP (a terminal that closes) let the tick end; a second one does not wait."""

    def __init__(self) -> None:
        self._came: list[int] = []
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, self._stop)
        hang_up = getattr(signal, "SIGHUP", None)
        if hang_up is not None and signal.getsignal(hang_up) is not signal.SIG_IGN:  # nohup ignores it
            signal.signal(hang_up, self._stop)

    def __bool__(self) -> bool:
        """Whether a signal has arrived."""
        return bool(self._came)

    @property
    def interrupted(self) -> bool:
        """Whether it was Ctrl-C."""
        return signal.SIGINT in self._came

    def _stop(self, number: int, _frame: FrameType | None) -> None:
        self._came.append(number)
        signal.signal(number, signal.SIG_DFL)


class Flights:
    """Runs of one process, one after the other: signals, viewers and console are theirs in common."""

    def __init__(
        self, stop: StopSignals, view: "Hub | None", foxglove: "FoxgloveServer | None", *, quiet: bool
    ) -> None:
        self.stop = stop
        self.view, self._foxglove, self._quiet = view, foxglove, quiet
        self._began_s = process_start_s()

    @contextlib.contextmanager
    def ready(
        self, links: "Callable[[], BootLinks]", make: "Callable[[SessionOptions], S]"
    ) -> "Iterator[tuple[S, Callable[[str], None]]]":
        """A session, ready to run, and its console. ``links`` opens links before other modules are loaded;
        ``make`` opens the session with those options.
        """
        with links() as boot:
            from autopilot.run.console import Console

            console = None if self._quiet else Console()
            show: Callable[[str], None] = (lambda _: None) if console is None else console.print
            options: SessionOptions = {
                "links": boot.links,
                "now_s": self._began_s,
                "view": self.view,
                "foxglove": self._foxglove,
            }
            session = make(options)
            settle_memory()
        try:
            session.runtime.take_over(boot.take_unanswered())
            for warning in session.warnings:
                click.echo(f"warning: {warning}", err=True)
            yield session, show
        finally:
            self._began_s = time.time()
            if console is not None:
                console.close()


def settle_memory() -> None:
    """Exclude all imported objects from garbage collection: a full collection would take five ticks."""
    gc.collect()
    gc.freeze()


def tell_losses(session: "Session") -> bool:
    """Warn on stderr of data that could not be stored; whether the log is incomplete."""
    if session.kept.params.failure:
        click.echo(f"warning: {session.kept.params.failure}", err=True)
    if session.kept.plans is not None and session.kept.plans.failure:
        click.echo(f"warning: {session.kept.plans.failure}", err=True)
    if not session.recorder.failure:
        return False
    lost = f"{session.recorder.dropped} messages lost"
    click.echo(f"warning: the log is not whole, {lost}: {session.recorder.failure}", err=True)
    return True
