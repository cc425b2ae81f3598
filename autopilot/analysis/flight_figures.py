"""Key figures of a flight, and their differences between two flights."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from autopilot.log.analysis import load_flight
from autopilot.log.check import acceptance_table, flown_commands
from autopilot.log.reader import Log

MACHINE = (
    *("solve time", "longest tick", "tick p50", "tick p99", "CPU, ", "loop overruns"),
    *("control steps beyond their period", "log messages lost", "log queue", "memory"),
    "longest garbage collection",
)
"""Rows of the acceptance table that measure the computer and not the flight, by how they begin."""

Figures = dict[str, float]
"""Name with unit -> value, in the order of the table."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Moved:
    figure: str
    before: float | None
    after: float | None

    @property
    def same(self) -> bool:
        """Bit for bit."""
        return self.before == self.after

    @property
    def relative_change(self) -> float | None:
        """Relative change."""
        if self.before is None or self.after is None or not self.before:
            return None
        return self.after / self.before - 1.0


def figures_of(log: Log) -> Figures:
    """All figures of a flight. LogError if it holds no track."""
    found: Figures = {}
    for row in acceptance_table(log):
        if row.worst is not None and not row.name.startswith(MACHINE):
            found[_named(found, row.name, row.unit)] = float(row.worst)
    flight = load_flight(log)
    commands = flown_commands(flight)
    if commands is not None and len(commands.thrust_n):
        found["thrust rms, N"] = float(np.sqrt(np.mean(commands.thrust_n**2)))
    track = flight.judged.between(flight.armed)
    if len(track.t_s):
        found["armed, s"] = float(track.t_s[-1] - track.t_s[0])
        found["way over ground, m"] = float(np.hypot(*np.diff(track.pos_ned_m[:, :2], axis=0).T).sum())
    nmpc = log.get("/ctl/nmpc")
    if nmpc is not None:
        found["QPs a step"] = float(nmpc["iterations"].mean())
    return found


def _named(found: Mapping[str, float], name: str, unit: str) -> str:
    label = f"{name}, {unit}" if unit else name
    return label if label not in found else f"{label} ({sum(key.startswith(label) for key in found) + 1})"


def moved(before: Mapping[str, float], after: Mapping[str, float]) -> Sequence[Moved]:
    names = dict.fromkeys((*before, *after))
    return [Moved(figure=name, before=before.get(name), after=after.get(name)) for name in names]
