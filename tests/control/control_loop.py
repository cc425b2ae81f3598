"""Closed loop of the controller on its own model (floats, 10 ms steps), with thruster lag, the tank's jet and a current
estimate that lags and is noisy: what the controller sees is not what there is."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from autopilot.analysis.nmpc_flight import estimate_of
from autopilot.control.controller import MotionController
from autopilot.core import model4
from autopilot.core.frames import FloatArray, wrap_pi
from autopilot.core.geometry import Circle, Fence, Polygon
from autopilot.core.messages import ControlOutput, Goal, NavHealth, NavState
from autopilot.core.params import ParamSet
from autopilot.core.vehicle import load_vehicle

VEHICLE = load_vehicle("lbv150")
MODEL = VEHICLE.to_model()
STEP_US = 50_000

PILLARS = ((-0.625, -0.625), (0.9375, 0.0))
TANK = Fence(
    inclusions=(Polygon(vertices_ned_m=np.array([[-2.5, -1.5], [2.5, -1.5], [2.5, 1.5], [-2.5, 1.5]])),),
    exclusions=tuple(Circle(center_ned_m=np.array(c), radius_m=0.16) for c in PILLARS),
    depth_min_m=0.0,
    depth_max_m=1.2,
)
"""The paper's tank and obstacles."""


def goal(x: float, y: float, z: float, yaw_rad: float | None, *, speed_m_s: float = 0.35, seq: int = 0) -> Goal:
    return Goal(
        pos_ned_m=np.array([x, y, z]),
        yaw_rad=yaw_rad,
        speed_m_s=speed_m_s,
        accept_radius_m=0.3,
        accept_yaw_rad=0.15,
        seq=seq,
    )


A = goal(-1.60, -0.35, 0.45, 0.0)
B = goal(1.75, 0.0, 0.30, math.pi)


def still(_: FloatArray) -> FloatArray:
    return np.zeros(3)


def jet(pos_ned_m: FloatArray, top_m_s: float = 0.25) -> FloatArray:
    """Jet along the middle of the tank with return flow along the walls, free of divergence."""
    xi = (pos_ned_m[0] + 2.5) / 5.0
    h, dh = 6.75 * xi * (1.0 - xi) ** 2, 6.75 * ((1.0 - xi) ** 2 - 2.0 * xi * (1.0 - xi)) / 5.0
    a = 2.0 * math.pi * (pos_ned_m[1] + 1.5) / 3.0
    return np.array([-top_m_s * math.cos(a) * h, top_m_s * 1.5 / math.pi * math.sin(a) * dh, 0.0])


def nav_state(
    t_us: int, x: FloatArray, current: FloatArray | None = None, health: NavHealth = NavHealth.GOOD
) -> NavState:
    """A perfect estimate of the model state x (8,)."""
    return replace(estimate_of(t_us, np.array(x), current_ned_m_s=current), health=health)


@dataclass
class Flight:
    """What happened: rows per 10 ms (states) and per step (thrust, outputs)."""

    x: FloatArray
    thrust_n: FloatArray
    outputs: list[ControlOutput]
    reached_s: list[float]

    def pillar_distance_m(self) -> float:
        return min(float(np.hypot(self.x[:, 0] - cx, self.x[:, 1] - cy).min()) for cx, cy in PILLARS)

    def wall_distance_m(self) -> float:
        return float(min((2.5 - np.abs(self.x[:, 0])).min(), (1.5 - np.abs(self.x[:, 1])).min()))

    def planar_speed_m_s(self) -> float:
        return float(np.hypot(self.x[:, 4], self.x[:, 5]).max())


def fly(
    controller: MotionController,
    goals: Sequence[Goal],
    start: Sequence[float],
    *,
    fence: Fence = TANK,
    params: ParamSet | None = None,
    current: Callable[[FloatArray], FloatArray] = still,
    noise: float = 0.0,
    seed: int = 1,
    lag_s: float = 0.15,
    current_lag_s: float = 1.0,
    limit_s: float = 60.0,
    hold: bool = False,
    model: model4.Model4 = MODEL,
) -> Flight:
    """Fly to the goals one after the other (``hold``: stay at the last until the time is up)."""
    params = params or ParamSet()
    rng = np.random.default_rng(seed)
    x, acting, lagged = np.array(start, dtype=float), np.zeros(model.thrusters), np.zeros(3)
    states, thrusts, outputs, reached, index = [], [], [], [], 0
    for step in range(int(limit_s * 1e6 / STEP_US)):
        t_us = step * STEP_US
        truth = current(x[:2])
        lagged = lagged + (truth - lagged) * min(1.0, 0.05 / current_lag_s)
        jitter = rng.normal(size=8) * noise
        reported = lagged + np.array([jitter[0], jitter[1], 0.0])
        seen = x + np.concatenate([0.5 * jitter[2:6], np.zeros(4)])
        c, s = math.cos(x[3]), math.sin(x[3])
        error = truth - reported
        seen[4] += c * error[0] + s * error[1]
        seen[5] += c * error[1] - s * error[0]
        seen[7] += jitter[6]
        output = controller.step(t_us, nav_state(t_us, seen, reported), goals[index], fence, params)
        outputs.append(output)
        thrusts.append(output.thrust_n)
        for _ in range(5):
            acting = acting + (output.thrust_n - acting) * (1.0 - math.exp(-0.01 / lag_s))
            x = rk4(model, x, acting, current, 0.01)
            states.append(x)
        if inside(x, goals[index]) and not (hold and index == len(goals) - 1):
            reached.append((t_us + STEP_US) * 1e-6)
            index += 1
            if index == len(goals):
                break
    return Flight(x=np.array(states), thrust_n=np.array(thrusts), outputs=outputs, reached_s=reached)


def inside(x: FloatArray, target: Goal) -> bool:
    """In the terminal region of the paper."""
    turned = 0.0 if target.yaw_rad is None else abs(wrap_pi(float(x[3]) - target.yaw_rad))
    return float(np.linalg.norm(x[:3] - target.pos_ned_m)) < target.accept_radius_m and turned < target.accept_yaw_rad


def rk4(
    model: model4.Model4, x: FloatArray, thrust_n: FloatArray, current: Callable[[FloatArray], FloatArray], h: float
) -> FloatArray:
    thrust = [float(v) for v in thrust_n]

    def f(state: FloatArray) -> FloatArray:
        flow = current(state[:2])
        return np.array(model4.state_derivative(model, state.tolist(), thrust, flow.tolist(), math))

    k1 = f(x)
    k2 = f(x + h / 2 * k1)
    k3 = f(x + h / 2 * k2)
    k4 = f(x + h * k3)
    return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
