"""What one control step costs: the whole Python step (route, half-planes, QP, checks) beside IPOPT on its problems.

Both run in one closed loop on the model, on the paper's tank with a uniform current: the controller flies, and every
few steps IPOPT gets the problem that the controller has just solved, warm-started from the same plan. CPU time of the
thread, because wall-clock time on a shared machine measures the neighbours.
"""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from autopilot.bench.ipopt import IpoptNmpc
from autopilot.control.controller import MotionController
from autopilot.control.grid import TimeGrid, geometric_grid, uniform_grid
from autopilot.control.ocp import discrete_dynamics
from autopilot.core.frames import FloatArray, wrap_pi
from autopilot.core.geometry import Circle, Fence, Polygon
from autopilot.core.messages import Goal, NavHealth, NavState
from autopilot.core.model4 import YAW
from autopilot.core.params import ParamSet
from autopilot.core.vehicle import Vehicle, load_vehicle

STEP_US = 50_000
CURRENT_NED_M_S = np.array([0.12, -0.08, 0.0])
TANK = Fence(
    inclusions=(Polygon(vertices_ned_m=np.array([[-2.5, -1.5], [2.5, -1.5], [2.5, 1.5], [-2.5, 1.5]])),),
    exclusions=tuple(
        Circle(center_ned_m=np.array(center), radius_m=0.16) for center in ((-0.625, -0.625), (0.9375, 0.0))
    ),
    depth_max_m=1.2,
)
"""Tank and obstacles of the paper, section IV."""

WAYPOINTS = ((1.75, 0.0, 0.30, math.pi), (-1.60, -0.35, 0.45, 0.0))
"""B and A of the paper: x, y, z [m], yaw [rad]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NmpcBenchRow:
    """One grid with one solver."""

    grid: str
    n: int
    horizon_s: float
    solver: str
    samples: int
    median_ms: float
    p99_ms: float
    max_ms: float
    thrust_gap_n: float
    """Median difference between the controller's first thrust and IPOPT's on the same problem."""


def standard_grids() -> tuple[tuple[str, TimeGrid], ...]:
    """The controller's own grid and the uniform ones that others publish."""
    uniform = (("uniform", uniform_grid(n)) for n in (20, 40, 80))
    return (("geometric", geometric_grid()), *uniform)


def bench_nmpc(
    steps: int = 400,
    ipopt_every: int = 20,
    grids: Sequence[tuple[str, TimeGrid]] | None = None,
    vehicle: Vehicle | None = None,
    cpu_clock: Callable[[], float] = time.thread_time,
) -> list[NmpcBenchRow]:
    """Fly ``steps`` steps (50 ms each) per grid; two rows per grid, the controller's and IPOPT's."""
    vehicle = vehicle or load_vehicle("lbv150")
    rows = []
    for name, grid in grids or standard_grids():
        rows += _bench_grid(name, grid, steps, ipopt_every, vehicle, cpu_clock)
    return rows


def _bench_grid(
    name: str, grid: TimeGrid, steps: int, ipopt_every: int, vehicle: Vehicle, cpu_clock: Callable[[], float]
) -> list[NmpcBenchRow]:
    model = vehicle.model4.to_model()
    controller = MotionController(vehicle, grid=grid, cpu_clock=cpu_clock)
    ipopt = IpoptNmpc(model, grid, controller.nmpc.planes)
    move = discrete_dynamics(model, STEP_US * 1e-6, 1)
    params, goals, index = ParamSet(), [_goal(*w) for w in WAYPOINTS], 0
    x, acting = np.array([*WAYPOINTS[1], 0.0, 0.0, 0.0, 0.0]), np.zeros(4)
    ours: list[float] = []
    theirs: list[float] = []
    gaps: list[float] = []
    for step in range(steps):
        output = controller.step(step * STEP_US, _nav(step * STEP_US, x), goals[index], TANK, params)
        ours.append(output.status.solve_s)
        problem = controller.nmpc.last_problem
        if step % ipopt_every == ipopt_every // 2 and problem is not None:
            began = cpu_clock()
            ipopt.set_plan(controller.nmpc.x, controller.nmpc.u)
            _, thrust, solved = ipopt.solve(problem)
            theirs.append(cpu_clock() - began)
            if solved:
                gaps.append(float(np.abs(thrust[0] - output.thrust_n).max()))
        acting += (output.thrust_n - acting) * (1.0 - math.exp(-STEP_US * 1e-6 / vehicle.drive.time_constant_s))
        x = move(x, acting, CURRENT_NED_M_S)[0].full().ravel()
        goal = goals[index]
        turned = abs(wrap_pi(float(x[YAW]) - (goal.yaw_rad or 0.0)))
        if np.linalg.norm(x[:3] - goal.pos_ned_m) < goal.accept_radius_m and turned < goal.accept_yaw_rad:
            index = 1 - index
    gap = float(np.median(gaps)) if gaps else math.nan
    return [
        _row(name, grid, f"controller step ({controller.nmpc.solver})", ours, gap),
        _row(name, grid, "IPOPT, warm", theirs, 0.0),
    ]


def _row(name: str, grid: TimeGrid, solver: str, seconds: list[float], gap_n: float) -> NmpcBenchRow:
    times = 1e3 * np.array(seconds) if seconds else np.array([math.nan])
    return NmpcBenchRow(
        grid=name,
        n=grid.n,
        horizon_s=float(grid.t_s[-1]),
        solver=solver,
        samples=len(seconds),
        median_ms=float(np.median(times)),
        p99_ms=float(np.percentile(times, 99)),
        max_ms=float(times.max()),
        thrust_gap_n=gap_n,
    )


def _goal(x: float, y: float, z: float, yaw: float) -> Goal:
    return Goal(
        pos_ned_m=np.array([x, y, z]),
        yaw_rad=yaw,
        speed_m_s=0.35,
        accept_radius_m=0.3,
        accept_yaw_rad=0.15,
        seq=-1,
    )


def _nav(t_us: int, x: FloatArray) -> NavState:
    return NavState(
        t_us=t_us,
        health=NavHealth.GOOD,
        pos_ned_m=x[:3],
        rpy_rad=np.array([0.0, 0.0, wrap_pi(float(x[YAW]))]),
        vel_frd_m_s=x[4:7],
        vel_water_frd_m_s=x[4:7],
        rate_frd_rad_s=np.array([0.0, 0.0, x[7]]),
        current_ned_m_s=CURRENT_NED_M_S,
        variance=np.zeros(12),
    )
