"""CPU time of a control step by parts, timed from outside while the controller flies."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from autopilot.analysis.nmpc_flight import LoopFlight, fly
from autopilot.control.constraints.obstacles import Features
from autopilot.control.controller import MotionController
from autopilot.control.nmpc.solver import Nmpc
from autopilot.control.path.guidance import RouteGuidance
from autopilot.control.robust.margins import Margins
from autopilot.control.robust.regions import TerminalRegions
from autopilot.core.frames import FloatArray
from autopilot.core.messages import ControlOutput
from autopilot.core.vehicle import Vehicle

QP = "QP (shift, set, solve, get)"
PARTS: tuple[tuple[str, type, tuple[str, ...]], ...] = (
    (QP, Nmpc, ("shift", "solve")),
    ("reference", RouteGuidance, ("reference",)),
    ("half-planes", Features, ("half_planes", "margin_m")),
    ("margins", Margins, ("update", "back_offs")),
    ("terminal", TerminalRegions, ("follow", "cost_at")),
)
"""Name and the calls that make it up; none of them calls another one's."""


class PartTimer:
    """CPU time per part and step."""

    def __init__(self, cpu_clock: Callable[[], float]) -> None:
        self._cpu_clock = cpu_clock
        self._now: dict[str, float] = {}
        self.steps: list[dict[str, float]] = []

    def wrap(self, name: str, call: Callable[..., Any]) -> Callable[..., Any]:

        def timed(*args: Any, **named: Any) -> Any:
            began = self._cpu_clock()
            try:
                return call(*args, **named)
            finally:
                self._now[name] = self._now.get(name, 0.0) + self._cpu_clock() - began

        return timed

    def lap(self) -> None:
        self.steps.append(self._now)
        self._now = {}

    def median_s(self, name: str, keep: list[bool]) -> float:
        """Of the steps that are kept."""
        return float(np.median([step.get(name, 0.0) for step, kept in zip(self.steps, keep, strict=True) if kept]))


@contextmanager
def watched(watch: PartTimer) -> Iterator[None]:
    """Every part is timed as long as this lasts."""
    before = [(owner, call, getattr(owner, call), name) for name, owner, calls in PARTS for call in calls]
    for owner, call, own, name in before:
        setattr(owner, call, watch.wrap(name, own))
    try:
        yield
    finally:
        for owner, call, own, _ in before:
            setattr(owner, call, own)


def parts_of(
    controller: MotionController,
    vehicle: Vehicle,
    start: FloatArray,
    steps: int,
    cpu_clock: Callable[[], float] = time.thread_time,
) -> tuple[LoopFlight, dict[str, float]]:
    """A flight, and the median seconds of every part in the steps that solve one QP."""
    watch, kept = PartTimer(cpu_clock), list[bool]()

    def each(step: int, output: ControlOutput) -> None:
        watch.lap()
        kept.append(output.status.iterations == 1)

    with watched(watch):
        flight = fly(controller, vehicle, start, steps, watch=each)
    return flight, {name: watch.median_s(name, kept) for name, _, _ in PARTS}
