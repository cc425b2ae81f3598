"""What ``autopilot sitl`` and ``autopilot run`` share: signals that end a run, and what is said at its end."""

import gc
import signal
from types import FrameType
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from autopilot.run.session import Session


class StopSignals:
    """SIGTERM and SIGINT let the tick end; a second one does not wait."""

    def __init__(self) -> None:
        self._came: list[int] = []
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, self._stop)

    def __bool__(self) -> bool:
        """Whether one has come."""
        return bool(self._came)

    @property
    def interrupted(self) -> bool:
        """Whether it was Ctrl-C."""
        return signal.SIGINT in self._came

    def _stop(self, number: int, _frame: FrameType | None) -> None:
        self._came.append(number)
        signal.signal(number, signal.SIG_DFL)


def settle_memory() -> None:
    """A full garbage collection over all that was imported would take five ticks: it leaves out what there is now."""
    gc.collect()
    gc.freeze()


def tell_losses(session: "Session") -> bool:
    """Warnings on stderr about what could not be kept; whether the log is not whole."""
    if session.kept.params.failure:
        click.echo(f"warning: {session.kept.params.failure}", err=True)
    if session.kept.plans is not None and session.kept.plans.failure:
        click.echo(f"warning: {session.kept.plans.failure}", err=True)
    if not session.recorder.failure:
        return False
    lost = f"{session.recorder.dropped} messages lost"
    click.echo(f"warning: the log is not whole, {lost}: {session.recorder.failure}", err=True)
    return True
