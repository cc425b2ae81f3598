"""Components of a plan's margins: tube over the horizon, Lipschitz growth, certificates, CPU cost."""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from autopilot.analysis.nmpc_flight import estimate_of
from autopilot.control.controller import MotionController
from autopilot.control.nmpc.grid import TimeGrid, geometric_grid, uniform_grid
from autopilot.control.path.path_tuning import GUIDANCE
from autopilot.control.robust.disturbance import DisturbanceBound
from autopilot.control.robust.error_model import disturbance_matrix, error_jacobian, input_matrix
from autopilot.control.robust.lipschitz import TUNED_SCALES, UNIT_SCALES, lipschitz_report
from autopilot.control.robust.margins import Margins
from autopilot.control.robust.riccati import exponential
from autopilot.control.robust.terminal import TerminalLimits, certify, terminal_law, unit_samples
from autopilot.core.control_allocator import ControlAllocator
from autopilot.core.frames import FloatArray
from autopilot.core.geometry import Fence
from autopilot.core.messages import Goal, NavState
from autopilot.core.model4 import Model4, U
from autopilot.core.params import ParamSet
from autopilot.core.vehicle import Vehicle
from autopilot.mission.fence import fence_clearance_m

ESTIMATES: dict[str, tuple[float, ...]] = {
    "perfect": (0.0, 0.0, 0.0, 0.0, 0.0),
    "pose": (0.0012, 0.0009, 0.0225, 0.0215, 0.0278),
    "camera": (0.0014, 0.0011, 0.040, 0.0234, 0.0417),
    "lost for 5 s": (0.05, 0.02, 0.06, 0.03, 0.08),
}
"""Standard deviations of place, depth [m], planar and heave speed and current [m/s], as the filter gave them in flights
of the paper's mission (medians), and after a gap."""

STEP_US = 50_000
SPEEDS_M_S = (0.0, 0.35, 0.5)
NODES = (1, 8, 19)
"""Nodes of the table: 0.1, 1.3 and 7 s ahead."""
AS_CERTIFIED = ("alpha", "radius_m", "depth_m", "binding", "samples", "violations", "shrunk", "fits", "text")
"""Attributes of a certificate that its row has as they are."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TubeRow:
    """Back-offs of one estimate and speed."""

    estimate: str
    speed_m_s: float
    clearance_m: tuple[float, ...]
    """Beyond the body, at NODES."""
    planar_m_s: float
    """At the horizon's end, as the others."""
    heave_m_s: float
    yaw_rate_rad_s: float
    depth_m: float
    thrust_n: float
    speed_cap_m_s: float
    worst_case_m: float
    """Interval bound of the position for disturbances that stay at their worst-case bounds."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LipschitzRow:
    """Growth on one grid in one norm."""

    grid: str
    norm: str
    constant: float
    gamma_05_m: float
    """Place after 0.5 s, 1 s and 2 s."""
    gamma_1_m: float
    gamma_2_m: float
    empty_node: int | None
    empty_s: float | None
    limited_by: str


@dataclass(frozen=True, slots=True, kw_only=True)
class CertificateRow:
    """Terminal region of one waypoint in one current (:class:`autopilot.control.robust.terminal.Certificate`)."""

    item: int
    current_n_e_m_s: str
    alpha: float
    radius_m: float
    depth_m: float
    yaw_deg: float
    speed_m_s: float
    binding: str
    samples: int
    violations: int
    shrunk: int
    fits: bool
    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class CostRow:
    """CPU time of a control step in one mode."""

    mode: str
    step_median_ms: float
    step_p99_ms: float
    margins_share: float
    """Of the step, spent on back-offs."""
    regions_share: float
    """Of the step, spent on the terminal region (its certificate is made between steps)."""
    tick_share: float
    """One tick of the inner loop over one step."""


def tube_table(vehicle: Vehicle, params: ParamSet) -> list[TubeRow]:
    """Back-offs over the horizon for every kind of estimate."""
    model, grid = vehicle.to_model(), geometric_grid()
    margins = Margins(model, grid)
    rows = []
    for name, sigmas in ESTIMATES.items():
        for speed in SPEEDS_M_S:
            x = np.zeros((grid.n + 1, 8))
            x[:, U] = speed
            back = margins.back_offs(_nav(sigmas), x, np.zeros((grid.n, model.thrusters)), params)
            planar = float(back.planar_speed_m_s[-1])
            rows.append(
                TubeRow(
                    estimate=name,
                    speed_m_s=speed,
                    clearance_m=tuple(float(back.clearance_m[k - 1]) for k in NODES),
                    planar_m_s=planar,
                    heave_m_s=float(back.heave_m_s[-1]),
                    yaw_rate_rad_s=float(back.yaw_rate_rad_s[-1]),
                    depth_m=float(back.depth_m[-1]),
                    thrust_n=float(back.thrust_n[-1].max()),
                    speed_cap_m_s=params["SPD_PLANAR_MAX"] - planar,
                    worst_case_m=interval_bound_m(model, margins, speed, DisturbanceBound.of(params).per_channel()),
                )
            )
    return rows


def interval_bound_m(model: Model4, margins: Margins, surge_m_s: float, bound: FloatArray) -> float:
    """Largest |(e_x, e_y)| under any disturbances within ``bound`` (7,): integral of |C e^(A+BK)t G| w, per axis."""
    nu, h = np.array([surge_m_s, 0.0, 0.0, 0.0]), 0.01
    closed = error_jacobian(model, nu) + input_matrix(model) @ margins.ancillary.gain(surge_m_s)
    step, response = exponential(closed * h), disturbance_matrix(model, nu)
    reach = np.zeros(2)
    for _ in range(1500):
        reach += h * np.abs(response[:2]) @ bound
        response = step @ response
    return float(np.hypot(*reach))


def lipschitz_table(vehicle: Vehicle, params: ParamSet, free_m: float | None) -> list[LipschitzRow]:
    """Growth on the controller's grid and on the published kind, in the plain norm and in a tuned one."""
    model, bound = vehicle.to_model(), DisturbanceBound.of(params)
    grids: tuple[tuple[str, TimeGrid], ...] = (("uniform 0.1 s", uniform_grid(80)), ("geometric", geometric_grid()))
    rows = []
    for grid_name, grid in grids:
        for norm, scales in (("2-norm", UNIT_SCALES), ("scaled", TUNED_SCALES)):
            report = lipschitz_report(model, grid, params, bound, scales=scales, free_m=free_m)
            at = [float(np.interp(t, grid.t_s, report.back_off[:, 0])) for t in (0.5, 1.0, 2.0)]
            node = report.empty_node
            rows.append(
                LipschitzRow(
                    grid=grid_name,
                    norm=norm,
                    constant=float(report.lipschitz[0]),
                    gamma_05_m=at[0],
                    gamma_1_m=at[1],
                    gamma_2_m=at[2],
                    empty_node=node,
                    empty_s=None if node is None else float(grid.t_s[node]),
                    limited_by=report.limited_by,
                )
            )
    return rows


def certificate_table(
    vehicle: Vehicle,
    params: ParamSet,
    goals: Sequence[Goal],
    fence: Fence,
    currents_ned_m_s: Sequence[FloatArray],
    samples: int,
) -> list[CertificateRow]:
    """Terminal certificate of every goal in every current, with the margins of a perfect estimate."""
    model, grid = vehicle.to_model(), geometric_grid()
    back = Margins(model, grid).back_offs(
        _nav(ESTIMATES["perfect"]), np.zeros((grid.n + 1, 8)), np.zeros((grid.n, model.thrusters)), params
    )
    q = np.array([params["MPC_Q_POS"]] * 2 + [params["MPC_Q_Z"], params["MPC_Q_YAW"], *GUIDANCE.velocity_weights])
    r, points = np.full(model.thrusters, params["MPC_R_THRUST"]), unit_samples(samples)
    rows = []
    for goal in goals:
        clearance = float(fence_clearance_m(fence, goal.pos_ned_m[None, :2])[0])
        limits = TerminalLimits(
            thrust_n=params["THR_LIMIT"] - back.thrust_n[-1],
            planar_speed_m_s=params["SPD_PLANAR_MAX"] - float(back.planar_speed_m_s[-1]),
            heave_m_s=params["SPD_HEAVE_MAX"] - float(back.heave_m_s[-1]),
            yaw_rate_rad_s=params["SPD_YAW_MAX"] - float(back.yaw_rate_rad_s[-1]),
            depth_min_m=params["DEPTH_MIN"] + float(back.depth_m[-1]),
            depth_max_m=params["DEPTH_MAX"] - float(back.depth_m[-1]),
            clearance_m=clearance - vehicle.radius_m - float(back.clearance_m[-1]),
        )
        for current in currents_ned_m_s:
            law = terminal_law(ControlAllocator.of(vehicle), goal.yaw_rad or 0.0, current, q, r, limits.thrust_n)
            made = certify(model, law, goal, limits, points)
            rows.append(
                CertificateRow(
                    item=goal.seq,
                    current_n_e_m_s=f"{current[0]:g}, {current[1]:g}",
                    yaw_deg=math.degrees(made.yaw_rad),
                    speed_m_s=made.planar_speed_m_s,
                    **{name: getattr(made, name) for name in AS_CERTIFIED},
                )
            )
    return rows


def cost_table(vehicle: Vehicle, goal: Goal, fence: Fence, steps: int) -> list[CostRow]:
    """CPU time of the step in every mode, and of margins and regions in it (same run, interleaved parts)."""
    rows = []
    for mode, name in ((0, "fixed"), (1, "tube"), (2, "lipschitz")):
        controller = MotionController(vehicle, cpu_clock=time.thread_time)
        spent: dict[str, list[float]] = {"margins": [], "regions": []}
        margins, regions = controller.margins, controller.regions
        setattr(margins, "back_offs", _timed(margins.back_offs, spent["margins"]))  # noqa: B010
        setattr(regions, "follow", _timed(regions.follow, spent["regions"]))  # noqa: B010
        params, whole, ticks = ParamSet({"MPC_COST": 0, "MPC_TIGHTEN": mode}), [], []
        x = np.array([-1.6, -0.35, 0.45, 0.0, 0.0, 0.0, 0.0, 0.0])
        for step in range(steps):
            t_us = step * STEP_US
            output = controller.step(t_us, _nav(ESTIMATES["pose"], x, t_us), goal, fence, params)
            whole.append(output.status.solve_s)
            began = time.thread_time()
            controller.tick(t_us + 10_000, _nav(ESTIMATES["pose"], x, t_us))
            ticks.append(time.thread_time() - began)
            x = controller.nmpc.x[0] + 0.5 * (controller.nmpc.x[1] - controller.nmpc.x[0])
        total = float(np.sum(whole))
        rows.append(
            CostRow(
                mode=name,
                step_median_ms=1e3 * float(np.median(whole)),
                step_p99_ms=1e3 * float(np.percentile(whole, 99)),
                margins_share=float(np.sum(spent["margins"])) / total,
                regions_share=float(np.sum(spent["regions"])) / total,
                tick_share=float(np.median(ticks)) / float(np.median(whole)),
            )
        )
    return rows


def _timed(call: Callable[..., object], spent: list[float]) -> Callable[..., object]:
    def timed(*args: object, **named: object) -> object:
        began = time.thread_time()
        result = call(*args, **named)
        spent.append(time.thread_time() - began)
        return result

    return timed


def _nav(sigmas: Sequence[float], x: FloatArray | None = None, t_us: int = 0) -> NavState:
    """An estimate of the state ``x`` (8,) with these standard deviations (see ESTIMATES)."""
    place, depth, planar, heave, current = sigmas
    yaw = 0.001 if place else 0.0
    sigma = np.array([place, place, depth, 0, 0, yaw, planar, planar, heave, current, current, 0.02])
    return estimate_of(t_us, np.zeros(8) if x is None else x, sigma=sigma)
