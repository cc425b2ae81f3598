"""Cost of one control step: the whole Python step (route, half-planes, QP, checks) beside IPOPT and fatrop.

All run in one closed loop on the model, on the paper's tank with a uniform current: the controller flies, and every
few steps the others solve the same problem, warm-started from the same plan. CPU time of the thread, because wall
time on a shared machine depends on other loads. Steps that plan a new route have a row of their own.
"""

import json
import math
import subprocess
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from autopilot.analysis.ipopt import IpoptNmpc
from autopilot.analysis.nmpc_flight import TANK, WAYPOINTS, LoopFlight, basin, fly
from autopilot.control.constraints.obstacles import Features
from autopilot.control.controller import MotionController
from autopilot.control.nmpc import ocp
from autopilot.control.nmpc.grid import TimeGrid, geometric_grid, uniform_grid
from autopilot.control.nmpc.solver import Nmpc
from autopilot.control.path.guidance import RouteGuidance
from autopilot.control.robust.margins import Margins
from autopilot.control.robust.regions import TerminalRegions
from autopilot.core.frames import FloatArray
from autopilot.core.messages import ControlOutput
from autopilot.core.params import ParamSet
from autopilot.core.vehicle import Vehicle, load_vehicle
from autopilot.run.children import python_command

__all__ = ["NmpcBenchRow", "bench_nmpc", "standard_grids"]

LIMITS_MS = {("geometric", 20): (1.0, 0.5), ("uniform", 20): (0.55, 0.33), ("uniform", 40): (1.2, 0.74)}
LIMITS_MS |= {("uniform", 80): (2.3, 1.34)}
"""Bar and goal of the median: 1.25 and 0.75 times a tuned acados called from Python on such a machine."""

LIMITS_RATIO = {20: (2.4, 1.8), 40: (2.2, 1.5), 80: (1.5, 1.2)}
"""Bar and goal of the whole step over its QP, uniform grids: 5.5, 3.8 and 2.2 when they were set."""

START = np.array([*WAYPOINTS[1], 0.0, 0.0, 0.0, 0.0])
OBSTACLES = (2, 10, 50)
STARTS, STEPS_EACH = 200, 40
START_CLEARANCE_M = 0.1
"""Of random starts beyond the body radius."""

OTHERS = (("ipopt", "IPOPT, warm", 1e-6), ("fatrop", "fatrop, warm", 1e-4))
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


@dataclass(frozen=True, slots=True, kw_only=True)
class NmpcBenchRow:
    """One figure; times in CPU milliseconds of this machine."""

    what: str
    n: int | None = None
    solver: str = ""
    samples: int | None = None
    median_ms: float | None = None
    p99_ms: float | None = None
    max_ms: float | None = None
    bar_ms: float | None = None
    goal_ms: float | None = None
    note: str = ""


def standard_grids() -> tuple[tuple[str, TimeGrid], ...]:
    """The controller's own grid and the uniform ones that others publish."""
    uniform = (("uniform", uniform_grid(n)) for n in (20, 40, 80))
    return (("geometric", geometric_grid()), *uniform)


def bench_nmpc(
    steps: int = 400,
    others_every: int = 20,
    grids: Sequence[tuple[str, TimeGrid]] | None = None,
    cpu_clock: Callable[[], float] = time.thread_time,
    starts: int = STARTS,
) -> list[NmpcBenchRow]:
    """Fly ``steps`` steps (50 ms each) per row."""
    vehicle = load_vehicle("lbv150")
    rows: list[NmpcBenchRow] = []
    costs: dict[tuple[str, int], float] = {}
    for name, grid in grids or standard_grids():
        rows += _bench_grid(name, grid, steps, others_every, vehicle, cpu_clock, costs)
    if ("geometric", 20) in costs and ("uniform", 80) in costs:
        ratio = costs["geometric", 20] / costs["uniform", 80]
        note = f"cost of the closed loop over that of 80 uniform nodes: {ratio:.4f}"
        rows.append(NmpcBenchRow(what="20 geometric nodes over 8 s", n=20, note=note))
    for obstacles in OBSTACLES:
        controller = MotionController(vehicle, cpu_clock=cpu_clock)
        flight = fly(controller, vehicle, START, steps, fence=basin(obstacles))
        rows.append(_row(f"{obstacles} obstacles, geometric", 20, controller.nmpc.solver, flight.solve_s))
    if starts:
        rows.append(_random_starts(vehicle, starts))
    rows.append(_process())
    return rows


def _bench_grid(
    name: str,
    grid: TimeGrid,
    steps: int,
    others_every: int,
    vehicle: Vehicle,
    cpu_clock: Callable[[], float],
    costs: dict[tuple[str, int], float],
) -> list[NmpcBenchRow]:
    """The controller with its default solver and with those of PyPI wheels, and converged solvers."""
    controller = MotionController(vehicle, grid=grid, cpu_clock=cpu_clock)
    others = [_Other(plugin, controller, vehicle, grid, tol, cpu_clock) for plugin, _, tol in OTHERS]

    def compare(step: int, output: ControlOutput) -> None:
        if step % others_every == others_every // 2:
            for other in others:
                other.solve(output)

    flight = fly(controller, vehicle, START, steps, watch=compare)
    costs[name, grid.n] = flight.cost
    limits = LIMITS_MS.get((name, grid.n))
    rows = [_step_row(name, grid.n, controller.nmpc.solver, flight, limits, others[0].gap_n())]
    if controller.nmpc.solver == ocp.NATIVE.plugin:
        wheel = MotionController(vehicle, grid=grid, cpu_clock=cpu_clock, backends=(ocp.HPIPM, ocp.PIQP))
        again = fly(wheel, vehicle, START, steps)
        rows.append(_step_row(name, grid.n, wheel.nmpc.solver, again, limits, math.nan))
        flights = np.concatenate([flight.planning_s, again.planning_s])
    else:
        flights = flight.planning_s
    rows += _part_rows(name, grid, steps, vehicle, cpu_clock)
    for other, (_, title, _) in zip(others, OTHERS, strict=True):
        note = f"{other.failed} of {len(other.seconds)} not solved" if other.failed else ""
        rows.append(_row(f"{name}, the same problems", grid.n, title, np.array(other.seconds), note))
    rows.append(_row(f"{name}, steps with a new route", grid.n, "", flights))
    return rows


def _part_rows(
    name: str,
    grid: TimeGrid,
    steps: int,
    vehicle: Vehicle,
    cpu_clock: Callable[[], float],
) -> list[NmpcBenchRow]:
    """CPU time of the step by parts, and of the whole step over its QP, in a flight of their own."""
    controller = MotionController(vehicle, grid=grid, cpu_clock=cpu_clock)
    flight, parts = parts_of(controller, vehicle, START, steps, cpu_clock)
    whole = float(np.median(flight.solve_s))
    ratio, limits = whole / parts[QP], LIMITS_RATIO.get(grid.n) if name == "uniform" else None
    wanted = f" (bar {limits[0]}, goal {limits[1]})" if limits else ""
    parts["rest"] = whole - sum(parts.values())
    return [
        NmpcBenchRow(
            what=f"{name}, part: {part}",
            n=grid.n,
            solver=controller.nmpc.solver if part == QP else "",
            samples=len(flight.solve_s),
            median_ms=1e3 * seconds,
            note=f"{100.0 * seconds / whole:.0f} % of {1e3 * whole:.3f} ms"
            + (f"; whole step / QP {ratio:.2f}{wanted}" if part == QP else ""),
        )
        for part, seconds in parts.items()
    ]


class _Other:
    """A converged solver beside the controller."""

    def __init__(
        self,
        plugin: str,
        controller: MotionController,
        vehicle: Vehicle,
        grid: TimeGrid,
        tolerance: float,
        cpu_clock: Callable[[], float],
    ) -> None:
        self._nmpc, self._cpu_clock = controller.nmpc, cpu_clock
        self._solver = IpoptNmpc(vehicle.to_model(), grid, controller.nmpc.planes, tolerance, plugin)
        self.seconds: list[float] = []
        self.failed = 0
        self._gaps: list[float] = []

    def solve(self, output: ControlOutput) -> None:
        """The problem that the controller has just solved."""
        problem = self._nmpc.last_problem
        if problem is None:
            return
        began = self._cpu_clock()
        self._solver.set_plan(self._nmpc.x, self._nmpc.u)
        _, thrust, solved = self._solver.solve(problem)
        self.seconds.append(self._cpu_clock() - began)
        if solved:
            self._gaps.append(float(np.abs(thrust[0] - output.thrust_n).max()))
        else:
            self.failed += 1

    def gap_n(self) -> float:
        """Median difference of the first thrust."""
        return float(np.median(self._gaps)) if self._gaps else math.nan


def _step_row(
    name: str,
    n: int,
    solver: str,
    flight: LoopFlight,
    limits: tuple[float, float] | None,
    gap_n: float,
) -> NmpcBenchRow:
    times = flight.solve_s
    tail = float(np.percentile(times, 99) / np.median(times)) if len(times) else math.nan
    note = f"p99 = {tail:.2f} medians (bar 2)"
    if math.isfinite(gap_n):
        note += f", thrust within {gap_n:.2g} N of IPOPT's (median)"
    return _row(f"{name}, whole step", n, solver, times, note, limits)


def _row(
    what: str,
    n: int,
    solver: str,
    seconds: FloatArray,
    note: str = "",
    limits: tuple[float, float] | None = None,
) -> NmpcBenchRow:
    times = 1e3 * seconds if len(seconds) else np.array([math.nan])
    return NmpcBenchRow(
        what=what,
        n=n,
        solver=solver,
        samples=len(seconds),
        median_ms=float(np.median(times)),
        p99_ms=float(np.percentile(times, 99)),
        max_ms=float(times.max()),
        bar_ms=limits[0] if limits else None,
        goal_ms=limits[1] if limits else None,
        note=note,
    )


def _random_starts(vehicle: Vehicle, starts: int) -> NmpcBenchRow:
    """Closed loops from random positions, headings and speeds in the tank: failures and the worst violation."""
    rng = np.random.default_rng(42)
    features, params = Features(TANK), ParamSet({"MPC_COST": 0})
    controller = MotionController(vehicle)
    failures, into_m, over_m_s = 0, 0.0, 0.0
    for _ in range(starts):
        while True:
            x = np.array([*rng.uniform([-2.2, -1.2, 0.2], [2.2, 1.2, 1.0]), rng.uniform(-math.pi, math.pi)])
            if features.clearance_m(x[None, :2])[0] > vehicle.radius_m + START_CLEARANCE_M:
                break
        start = np.concatenate([x, rng.uniform(-1.0, 1.0, 4) * [0.2, 0.1, 0.1, 0.2]])
        controller.reset()
        flight = fly(controller, vehicle, start, STEPS_EACH, first=int(rng.integers(2)))
        failures += flight.failures
        into_m = max(into_m, vehicle.radius_m - float(features.clearance_m(flight.x[:, :2]).min()))
        over_m_s = max(over_m_s, float(np.hypot(flight.x[:, 4], flight.x[:, 5]).max()) - params["SPD_PLANAR_MAX"])
    return NmpcBenchRow(
        what=f"{starts * STEPS_EACH} steps from {starts} random starts",
        n=controller.nmpc.grid.n,
        solver=controller.nmpc.solver,
        samples=starts * STEPS_EACH,
        note=f"{failures} failures (bar 0), worst into a keep-out {1e3 * max(into_m, 0.0):.1f} mm, "
        f"over the planar speed {max(over_m_s, 0.0):.3f} m/s",
    )


def _process() -> NmpcBenchRow:
    """Start-up and memory of a process that holds nothing but the controller (and the model it flies)."""
    command = python_command("from autopilot.bench.controller_process import main; main()")
    values = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    return NmpcBenchRow(
        what="start-up, controller alone",
        n=20,
        samples=1,
        median_ms=values["build_ms"],
        bar_ms=500.0,
        note=f"imports {values['import_ms']:.0f} ms, memory {values['rss_mb']:.0f} MB (bar 80)",
    )
