"""Whether the computer at hand is quick enough: what the service takes of it while it listens, and in flight.

The service's threads are watched while the doctor runs it, first alone, then with a controller that flies a vehicle of
its own (:class:`autopilot.analysis.nmpc_flight.FlightTrial`): its steps are taken between the service's ticks, at their
pace. A loop of control steps alone would find its caches warm and take less.
"""

import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import psutil

from autopilot.core.clock import TICK_US
from autopilot.core.messages import LoopStats
from autopilot.core.vehicle import Vehicle
from autopilot.run.findings import Finding, FindingSeverity

MOST_LOAD = 0.7
"""Of a core: what is above stays for other programs, gusts of pictures and the log."""
MOST_TICK_S = 0.05
"""Of the loop, which is due every 10 ms: between two control steps."""
RATES_HZ = (5, 10, 15, 20, 30)
"""Usual rates of cameras."""
TICK_S, CONTROL_S = 1e-6 * TICK_US, 0.05
FLOWN_S = 6.0
"""So long each MPC_COST is flown."""
LOOP, VISION, CAMERA = "loop", "vision", "camera"
LEAST_SHARE = 0.005
"""Threads below this share of a core are not listed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ServiceLoad:
    """Of a service that flies nothing, in shares of one core."""

    whole: float
    threads: Mapping[str, float]
    """By name, the largest first."""
    worst_tick_s: float
    pictures_hz: float = 0.0
    """Pictures in a second's worth of ticks."""

    @property
    def picture_s(self) -> float:
        """CPU time of a picture, 0 without any."""
        share = self.threads.get(VISION, 0.0) + self.threads.get(CAMERA, 0.0)
        return share / self.pictures_hz if self.pictures_hz else 0.0


class ThreadMeter:
    """CPU time of this process and its threads between two moments, for a second's worth of ticks.

    A computer that is too busy loses ticks: divided by the time that has passed, those that are left would look cheap.
    """

    def __init__(self) -> None:
        self._process = psutil.Process()
        self._worst_tick_s = 0.0
        self.start()

    def start(self) -> None:
        """Measure from now on."""
        self._begin_s, self._begin_cpu_s, self._begin = time.monotonic(), time.process_time(), self._by_id()
        self._worst_tick_s, self._ticks, self._pictures = 0.0, 0, 0

    def tick(self, pictures: int) -> None:
        """The loop has taken one, and with it so many pictures."""
        self._ticks += 1
        self._pictures += pictures

    def note(self, stats: LoopStats) -> None:
        """The loop's statistics of a second."""
        self._worst_tick_s = max(self._worst_tick_s, stats.tick_s)

    def load(self) -> ServiceLoad:
        """Since the start; without ticks by the time that has passed."""
        seconds = self._ticks * TICK_S or max(time.monotonic() - self._begin_s, 1e-3)
        names = {thread.native_id: thread.name for thread in threading.enumerate()}
        shares: dict[str, float] = {}
        for number, cpu_s in self._by_id().items():
            name = names.get(number, "libraries").split("_")[0]
            name = LOOP if name == "MainThread" else name
            shares[name] = shares.get(name, 0.0) + (cpu_s - self._begin.get(number, 0.0)) / seconds
        listed = sorted(shares.items(), key=lambda entry: -entry[1])
        return ServiceLoad(
            whole=(time.process_time() - self._begin_cpu_s) / seconds,
            threads={name: share for name, share in listed if share >= LEAST_SHARE},
            worst_tick_s=self._worst_tick_s,
            pictures_hz=self._pictures / seconds,
        )

    def _by_id(self) -> dict[int, float]:
        return {thread.id: thread.user_time + thread.system_time for thread in self._process.threads()}


class Flight(Protocol):
    """A controller that flies a vehicle of its own."""

    def step(self) -> None:
        """A control step."""
        ...

    def close(self) -> None: ...


class FlightTests(Protocol):
    """Flights, and what a longer horizon takes."""

    def start(self, vehicle: Vehicle, cost: int) -> Flight:
        """A flight with this MPC_COST."""
        ...

    def horizons(self, vehicle: Vehicle) -> Mapping[float, float]:
        """Time of a control step by the prediction's reach [s], over that of the controller's own, the shortest."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class FlightLoads:
    """Of the service that listens while a controller takes its steps as in flight."""

    by_cost: tuple[ServiceLoad, ServiceLoad]
    """With MPC_COST 0, 1."""
    horizons: Mapping[float, float]
    """As :meth:`FlightTests.horizons`."""


def judge_load(load: ServiceLoad, flying: FlightLoads, cost: int) -> list[Finding]:
    """Findings; ``cost``: the MPC_COST that is set."""
    parts = ", ".join(f"{name} {share:.2f}" for name, share in load.threads.items())
    late = load.worst_tick_s > MOST_TICK_S
    remedy = "end other programs; a slower camera rate_hz, smaller pictures, no --view; or a quicker computer"
    listens = Finding(
        verdict=FindingSeverity.WARN if late else FindingSeverity.OK,
        what="computer",
        found=f"{load.whole:.2f} of a core ({parts}), longest tick {1e3 * load.worst_tick_s:.0f} ms",
        remedy=remedy if late else "",
    )
    totals = [each.whole for each in flying.by_cost]
    fits = [total <= MOST_LOAD for total in totals]
    can = "both costs" if all(fits) else "MPC_COST 0 only" if fits[0] else "neither cost"
    rate_hz = flying.by_cost[cost].pictures_hz
    rate = f" at {rate_hz:.0f} Hz" if rate_hz else " without a camera"
    if fits[cost] or fits[0]:
        remedy = "" if fits[cost] else "set MPC_COST 0"
    flies = Finding(
        verdict=FindingSeverity.OK if fits[cost] else FindingSeverity.WARN,
        what="in flight",
        found=f"{totals[0]:.2f} of a core with MPC_COST 0, {totals[1]:.2f} with 1{rate}: {can} within {MOST_LOAD:g}",
        remedy=remedy,
    )
    most = "; ".join(f"MPC_COST {each}: {_most(load, flying, each)}" for each in range(len(totals)))
    return [
        listens,
        flies,
        Finding(verdict=FindingSeverity.OK, what="at most", found=f"{most} ({_each(load, flying)})"),
    ]


def _most(load: ServiceLoad, flying: FlightLoads, cost: int) -> str:
    """The highest camera rate, and the longest horizon, within the bound."""
    flown = flying.by_cost[cost]
    rate_hz, picture_s = flown.pictures_hz, flown.picture_s
    rates = [each for each in RATES_HZ if flown.whole + (each - rate_hz) * picture_s <= MOST_LOAD]
    control = max(flown.threads.get(LOOP, 0.0) - load.threads.get(LOOP, 0.0), 0.0)
    reaches = [reach for reach, times in flying.horizons.items() if flown.whole + (times - 1.0) * control <= MOST_LOAD]
    found = [f"{max(rates)} Hz"] if rates and rate_hz else []
    found += [f"horizon {max(reaches):.0f} s"] if reaches else []
    return " or ".join(found) or "nothing"


def _each(load: ServiceLoad, flying: FlightLoads) -> str:
    """CPU times of the parts."""
    loop = load.threads.get(LOOP, 0.0)
    steps = [1e3 * CONTROL_S * max(each.threads.get(LOOP, 0.0) - loop, 0.0) for each in flying.by_cost]
    plans = flying.by_cost[1].threads.get("trajectories", 0.0)
    parts = [f"tick {1e3 * TICK_S * loop:.1f} ms", f"control step {max(steps):.1f} ms", f"energy plans {plans:.2f}"]
    picture_s = max(each.picture_s for each in flying.by_cost)
    if picture_s:
        parts.insert(0, f"picture {1e3 * picture_s:.1f} ms")
    return ", ".join(parts)
