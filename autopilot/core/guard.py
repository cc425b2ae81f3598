"""Isolation of the parts of a tick: a part that raises does not stop the others.

An exception inside a part becomes a :class:`Fault`: stored with traceback and inputs, counted, and handled by
:mod:`autopilot.command.fault_response`. Where the guard is set to raise (tests, continuous integration), the exception
propagates.
"""

import os
import traceback
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias, TypeVar

import numpy as np

VARIABLE = "AUTOPILOT_GUARD"
"""Environment variable: ``raise`` lets exceptions through. Anything else, or none, guards."""

MAX_PENDING = 16
"""Faults of one tick that are kept with all they had; the rest is only counted."""

DESCRIBE_EVERY_US = 5_000_000
"""A fault that comes again and again is described in full this often; in between it is counted and acted upon."""

MAX_DESCRIBED = 64
"""Kinds of fault whose last description is remembered; the oldest goes."""

MAX_TEXT = 32_768
"""Longest traceback and longest description of inputs that is kept, in characters."""

T = TypeVar("T")

Work: TypeAlias = tuple[str, Callable[[], object]]
"""A part's name, and what it does."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Fault:
    t_us: int
    part: str
    """Which part of the tick: estimator, commander, controller, allocation, message, ..."""
    kind: str
    """Name of the exception's class."""
    place: str
    """File, line and function that raised it."""
    text: str
    """The exception's message."""
    traceback: str
    """"" where the same fault has been described of late."""
    inputs: str
    """What the part was given, as far as it fits; "" like the traceback."""

    @property
    def key(self) -> tuple[str, str]:
        """Faults of the same kind: the same exception from the same place."""
        return self.kind, self.place

    @property
    def line(self) -> str:
        return f"Internal fault: {self.part}: {self.kind}"[:50]


class Guard:
    def __init__(self, *, raises: bool | None = None) -> None:
        """``raises``: re-raise exceptions; None = by the environment variable."""
        self.raises = os.environ.get(VARIABLE) == "raise" if raises is None else raises
        self.t_us = 0
        """Time of the tick, set by the service."""
        self.counts: Counter[str] = Counter()
        """Faults so far, by part."""
        self._pending: list[Fault] = []
        self._described_us: dict[tuple[str, str], int] = {}

    def run(self, part: str, work: Callable[[], T], otherwise: T, given: Callable[[], object] = lambda: "") -> T:
        """``work()``, or ``otherwise`` if it raises. ``given`` describes its inputs, called only then."""
        try:
            return work()
        except Exception as error:  # noqa: BLE001 - the loop's one blanket; the fault is kept and acted upon
            self.note(part, error, given)
            return otherwise

    def run_all(self, works: Iterable[Work], given: Callable[[], object] = lambda: "") -> None:
        """As :meth:`run` for several functions without results: one that raises does not stop the others."""
        for part, work in works:
            try:
                work()
            except Exception as error:  # noqa: BLE001 - as in run
                self.note(part, error, given)

    def note(self, part: str, error: Exception, given: Callable[[], object] = lambda: "") -> None:
        """An exception that was caught. Raises it again where the guard is set to."""
        if self.raises:
            raise error
        self.counts[part] += 1
        if len(self._pending) < MAX_PENDING:
            self._pending.append(self._fault(part, error, given))

    def _fault(self, part: str, error: Exception, given: Callable[[], object]) -> Fault:
        kind, place = type(error).__name__, place_of(error)
        described_us = self._described_us.get((kind, place))
        brief = described_us is not None and 0 <= self.t_us - described_us < DESCRIBE_EVERY_US
        if not brief:
            self._described_us.pop((kind, place), None)
            while len(self._described_us) >= MAX_DESCRIBED:
                del self._described_us[next(iter(self._described_us))]
            self._described_us[kind, place] = self.t_us
        return Fault(
            t_us=self.t_us,
            part=part,
            kind=kind,
            place=place,
            text=_bounded(lambda: str(error)),
            traceback="" if brief else "".join(traceback.format_exception(error))[-MAX_TEXT:],
            inputs="" if brief else _bounded(lambda: _described(given)),
        )

    def take(self) -> tuple[Fault, ...]:
        if not self._pending:
            return ()
        faults, self._pending = tuple(self._pending), []
        return faults


def place_of(error: Exception) -> str:
    """File, line and function that raised it; of a module that is not Python, the line in it."""
    if isinstance(error, SyntaxError) and error.filename:
        return f"{Path(error.filename).name}:{error.lineno}"
    frames = traceback.extract_tb(error.__traceback__)
    return f"{Path(frames[-1].filename).name}:{frames[-1].lineno} in {frames[-1].name}" if frames else "unknown"


def _described(given: Callable[[], object]) -> str:
    """All digits, so that the numbers can be given again."""
    with np.printoptions(precision=17, floatmode="unique", threshold=2_000):
        return repr(given())


def _bounded(make: Callable[[], str]) -> str:
    """A description that must not raise, as it describes a failure."""
    try:
        return make()[:MAX_TEXT]
    except Exception as error:  # noqa: BLE001 - see above
        return f"cannot be described ({type(error).__name__})"
