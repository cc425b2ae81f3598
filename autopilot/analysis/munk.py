"""The yaw-sway (Munk) instability, which the feedback between optimiser steps stabilises.

The model vehicle runs straight ahead near its speed limit while a small random moment disturbs its yaw. The
optimiser steps at 20, 5 or 2 Hz, with the ancillary feedback at 100 Hz between its steps or with thrust held.
"""

import math
from dataclasses import dataclass

import numpy as np

from autopilot.analysis.nmpc_flight import estimate_of
from autopilot.control.controller import MotionController
from autopilot.control.nmpc.ocp import discrete_dynamics
from autopilot.core.clock import TICK_US
from autopilot.core.control_allocator import ControlAllocator
from autopilot.core.geometry import Fence
from autopilot.core.messages import Goal
from autopilot.core.params import ParamSet
from autopilot.core.vehicle import load_vehicle

MOMENT_N_M = 0.1
"""Standard deviation of the disturbing moment."""

FORCE_N = 1.0
"""The same of the disturbing side force."""

CORRELATION_S = 0.3
SETTLE_S = 4.0
"""Time to reach speed: not counted."""

SEED = 5


@dataclass(frozen=True, slots=True, kw_only=True)
class MunkRow:
    """One rate with or without the inner loop."""

    optimiser_hz: float
    inner_loop: bool
    speed_m_s: float
    """Mean through the water."""
    yaw_rms_deg: float
    """Off the heading of the leg."""
    yaw_max_deg: float
    side_rms_m: float
    """Off the line."""
    thrust_travel_n_s: float
    """Sum of changes of all thrusts per second: a measure of wear."""


def bench_munk(seconds: float = 20.0) -> list[MunkRow]:
    """20, 5 and 2 Hz, with and without."""
    return [
        munk_case(step_ticks=ticks, inner=inner, seconds=seconds) for ticks in (5, 20, 50) for inner in (True, False)
    ]


def munk_case(*, step_ticks: int = 20, inner: bool, seconds: float) -> MunkRow:
    """Fly one case; ``step_ticks`` of 10 ms between steps of the optimiser."""
    vehicle = load_vehicle("lbv150")
    model = vehicle.to_model()
    controller = MotionController(vehicle, cpu_clock=lambda: 0.0)
    move = discrete_dynamics(model, TICK_US * 1e-6, 1)
    params = ParamSet(
        {"MPC_COST": 0, "MPC_SPEED_MARGIN": 0.0, "MPC_W_FORCE": 0.0, "MPC_W_MOMENT": 0.0, "MPC_W_CURRENT": 0.0}
    )
    goal = Goal(
        pos_ned_m=np.array([1000.0, 0.0, 1.0]),
        yaw_rad=0.0,
        speed_m_s=0.5,
        accept_radius_m=0.3,
        accept_yaw_rad=0.15,
        seq=-1,
    )
    rng = np.random.default_rng(SEED)
    allocator, no_limit = ControlAllocator(model), np.full(model.thrusters, np.inf)
    fade = math.exp(-TICK_US * 1e-6 / CORRELATION_S)
    x, acting, command, moment = np.zeros(8), np.zeros(4), np.zeros(4), np.zeros(2)
    x[2] = 1.0
    rows, commands = [], []
    lag = 1.0 - math.exp(-TICK_US * 1e-6 / vehicle.drive.time_constant_s)
    for tick in range(int(seconds * 1e6 / TICK_US)):
        nav = estimate_of(tick * TICK_US, x)
        if tick % step_ticks == 0:
            command = controller.step(tick * TICK_US, nav, goal, Fence(depth_max_m=5.0), params).thrust_n
        elif inner:
            between = controller.tick(tick * TICK_US, nav)
            command = command if between is None else between
        moment = fade * moment + math.sqrt(1.0 - fade * fade) * rng.normal(size=2) * (FORCE_N, MOMENT_N_M)
        acting = acting + lag * (command - acting)
        push = allocator.thrust_n(np.array([0.0, moment[0], 0.0, moment[1]]), no_limit)
        x = move(x, acting + push, np.zeros(3))[0].full().ravel()
        rows.append(x)
        commands.append(command)
    after = int(SETTLE_S * 1e6 / TICK_US)
    flown, travel = np.array(rows)[after:], np.abs(np.diff(np.array(commands)[after:], axis=0)).sum()
    yaw_deg = np.degrees(flown[:, 3])
    return MunkRow(
        optimiser_hz=1e6 / (TICK_US * step_ticks),
        inner_loop=inner,
        speed_m_s=float(np.hypot(flown[:, 4], flown[:, 5]).mean()),
        yaw_rms_deg=float(np.sqrt((yaw_deg**2).mean())),
        yaw_max_deg=float(np.abs(yaw_deg).max()),
        side_rms_m=float(np.sqrt((flown[:, 1] ** 2).mean())),
        thrust_travel_n_s=float(travel / (seconds - SETTLE_S)),
    )
