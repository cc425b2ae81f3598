"""Speed of the whole simulation: real-time factor, CPU time of one tick, memory."""

import os
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np
import psutil

from autopilot.core.marks import LoopPart
from autopilot.core.messages import Inputs, Outputs
from autopilot.mission.paper import paper_plan
from autopilot.mission.plan_files import write_plan
from autopilot.run.config import flight_settings
from autopilot.run.sitl_session import SitlSession, open_sitl

MODES = {"energy": 1.0, "quadratic": 0.0}
"""Costs of the controller, by MPC_COST."""
ASKED = {("pose", "energy"): 20.0, ("pose", "quadratic"): 40.0, ("camera", "energy"): 5.0, ("camera", "quadratic"): 8.0}
"""Required speed, simulated over wall time, on an otherwise idle machine."""

SHOWN_MS = 0.01
"""Parts of a tick below this time are not listed."""


class PartTimes:
    """CPU time of the stages of a mean tick."""

    def __init__(self) -> None:
        self._parts_s = np.zeros(len(LoopPart))
        self._ticks = 0

    def add(self, part_s: Sequence[float]) -> None:
        """The stage times of a tick [s]."""
        self._parts_s += part_s
        self._ticks += 1

    @property
    def mean_ms(self) -> dict[LoopPart, float]:
        """Mean per tick, the largest first; parts that take nothing left out."""
        mean_ms = 1e3 * self._parts_s / max(self._ticks, 1)
        parts = {part: float(mean_ms[part]) for part in LoopPart if mean_ms[part] > 0.0}
        return dict(sorted(parts.items(), key=lambda each: -each[1]))


@dataclass(frozen=True, slots=True, kw_only=True)
class SitlBenchRow:
    """Result of the paper's mission in one configuration."""

    sensors: str
    cost: str
    simulated_s: float
    speed: float
    """Simulated over wall time."""
    asked: float
    cpu_s_per_s: float
    """CPU seconds of all threads per simulated second."""
    beside_s_per_s: float
    """Of these what other threads take: energy plans, certificates, detection, the log."""
    tick_mean_ms: float
    """CPU time of the loop's thread in one tick, simulation included."""
    parts: str
    """Stages of the mean tick [ms], the largest first (:class:`LoopPart`)."""
    tick_median_ms: float
    tick_p99_ms: float
    step_median_ms: float
    """CPU time of ``Autopilot.step`` alone: the load of a vehicle's computer."""
    step_p99_ms: float
    step_max_ms: float
    rss_mb: float
    """Resident memory of the process."""

    @property
    def kept(self) -> bool:
        return self.speed >= self.asked


def bench_sitl(duration_s: float = 30.0) -> list[SitlBenchRow]:
    """Fly the paper's mission for ``duration_s`` with each kind of localisation and each cost, log included."""
    return [_run(sensors, cost, duration_s) for sensors, cost in ASKED]


def _run(sensors: str, cost: str, duration_s: float) -> SitlBenchRow:
    times = PartTimes()
    with tempfile.TemporaryDirectory() as folder:
        log, params = Path(folder) / "run.mcap", {"MPC_COST": MODES[cost]}
        session = paper_flight(Path(folder), log, sensors=sensors, duration_s=duration_s, params=params)
        steps = _timed_steps(session)
        ticks = _timed_ticks(session, times)
        cpu_s, begin_s, loop_s = time.process_time(), time.perf_counter(), time.thread_time()
        session.run()
        wall_s, cpu_s = time.perf_counter() - begin_s, time.process_time() - cpu_s
        loop_s = time.thread_time() - loop_s
    tick_ms, step_ms = 1e3 * np.array(ticks), 1e3 * np.array(steps)
    return SitlBenchRow(
        sensors=sensors,
        cost=cost,
        simulated_s=duration_s,
        speed=duration_s / wall_s,
        asked=ASKED[sensors, cost],
        cpu_s_per_s=cpu_s / duration_s,
        beside_s_per_s=(cpu_s - loop_s) / duration_s,
        tick_mean_ms=float(tick_ms.mean()),
        parts=", ".join(f"{part.name.lower()} {ms:.2f}" for part, ms in times.mean_ms.items() if ms >= SHOWN_MS),
        tick_median_ms=float(np.median(tick_ms)),
        tick_p99_ms=float(np.percentile(tick_ms, 99)),
        step_median_ms=float(np.median(step_ms)),
        step_p99_ms=float(np.percentile(step_ms, 99)),
        step_max_ms=float(step_ms.max()),
        rss_mb=psutil.Process(os.getpid()).memory_info().rss / 1e6,
    )


def paper_flight(
    folder: Path,
    log: Path,
    *,
    sensors: str,
    duration_s: float,
    seed: int = 1,
    params: Mapping[str, float] = MappingProxyType({}),
) -> SitlSession:
    """The paper's mission with a scripted operator and no sockets."""
    plan = folder / "paper.plan"
    write_plan(plan, paper_plan())
    given = {"sensors": sensors, "duration": duration_s, "plan": str(plan), "start": True, "seed": seed}
    return open_sitl(flight_settings(folder, {**given, "log": str(log)}), dict(params))


def _timed_ticks(session: SitlSession, times: PartTimes) -> list[float]:
    """CPU seconds of every tick, filled while the session runs."""
    seconds: list[float] = []
    runtime = session.runtime
    whole: Callable[[int], Outputs] = runtime.tick

    def timed(t_us: int) -> Outputs:
        begin_s = time.thread_time()
        outputs = whole(t_us)
        seconds.append(time.thread_time() - begin_s)
        times.add(runtime.watch.part_cpu_s)
        return outputs

    setattr(runtime, "tick", timed)  # noqa: B010 - a method, which cannot be assigned
    return seconds


def _timed_steps(session: SitlSession) -> list[float]:
    """CPU seconds of every ``step``, filled while the session runs."""
    seconds: list[float] = []
    step: Callable[[Inputs], Outputs] = session.service.step

    def timed(inputs: Inputs) -> Outputs:
        begin_s = time.thread_time()
        outputs = step(inputs)
        seconds.append(time.thread_time() - begin_s)
        return outputs

    session.runtime.wrap_step(timed)
    return seconds
