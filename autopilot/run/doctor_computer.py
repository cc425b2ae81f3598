"""Whether the computer at hand is quick enough: what the service takes of it while it listens, and what flying adds.

The service's threads are watched while the doctor runs it; what the controller takes in flight is added
(:func:`autopilot.analysis.nmpc_flight.control_load`).
"""

import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass

import psutil

from autopilot.core.messages import LoopStats
from autopilot.run.findings import Finding, FindingSeverity

MOST_LOAD = 0.7
"""Of a core: what is above stays for other programs, gusts of pictures and the log."""
MOST_TICK_S = 0.05
"""Of the loop, which is due every 10 ms: between two control steps."""
LEAST_SHARE = 0.005
"""Threads below this share of a core are not listed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ServiceLoad:
    """Of a service that flies nothing, in shares of one core."""

    whole: float
    threads: Mapping[str, float]
    """By name, the largest first."""
    worst_tick_s: float


class ThreadMeter:
    """CPU time of this process and its threads between two moments."""

    def __init__(self) -> None:
        self._process = psutil.Process()
        self._worst_tick_s = 0.0
        self.start()

    def start(self) -> None:
        """Measure from now on."""
        self._begin_s, self._begin_cpu_s, self._begin = time.monotonic(), time.process_time(), self._by_id()
        self._worst_tick_s = 0.0

    def note(self, stats: LoopStats) -> None:
        """The loop's statistics of a second."""
        self._worst_tick_s = max(self._worst_tick_s, stats.tick_s)

    def load(self) -> ServiceLoad:
        """Since the start."""
        seconds = max(time.monotonic() - self._begin_s, 1e-3)
        names = {thread.native_id: thread.name for thread in threading.enumerate()}
        shares: dict[str, float] = {}
        for number, cpu_s in self._by_id().items():
            name = names.get(number, "libraries").split("_")[0]
            name = "loop" if name == "MainThread" else name
            shares[name] = shares.get(name, 0.0) + (cpu_s - self._begin.get(number, 0.0)) / seconds
        listed = sorted(shares.items(), key=lambda entry: -entry[1])
        return ServiceLoad(
            whole=(time.process_time() - self._begin_cpu_s) / seconds,
            threads={name: share for name, share in listed if share >= LEAST_SHARE},
            worst_tick_s=self._worst_tick_s,
        )

    def _by_id(self) -> dict[int, float]:
        return {thread.id: thread.user_time + thread.system_time for thread in self._process.threads()}


def judge_load(load: ServiceLoad, flying: tuple[float, float], cost: int, *, has_camera: bool) -> list[Finding]:
    """Findings; ``flying``: what each MPC_COST adds, ``cost``: the one that is set."""
    parts = ", ".join(f"{name} {share:.2f}" for name, share in load.threads.items())
    late = load.worst_tick_s > MOST_TICK_S
    remedy = "end other programs; a slower camera rate_hz, smaller pictures, no --view; or a quicker computer"
    listens = Finding(
        verdict=FindingSeverity.WARN if late else FindingSeverity.OK,
        what="computer",
        found=f"{load.whole:.2f} of a core ({parts}), longest tick {1e3 * load.worst_tick_s:.0f} ms",
        remedy=remedy if late else "",
    )
    totals = [load.whole + added for added in flying]
    fits = [total <= MOST_LOAD for total in totals]
    can = "both costs" if all(fits) else "MPC_COST 0 only" if fits[0] else "neither cost"
    rate = "" if has_camera else " without a camera"
    if fits[cost] or fits[0]:
        remedy = "" if fits[cost] else "set MPC_COST 0"
    flies = Finding(
        verdict=FindingSeverity.OK if fits[cost] else FindingSeverity.WARN,
        what="in flight",
        found=f"{totals[0]:.2f} of a core with MPC_COST 0, {totals[1]:.2f} with 1{rate}: {can} within {MOST_LOAD:g}",
        remedy=remedy,
    )
    return [listens, flies]
