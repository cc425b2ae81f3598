"""Streams about as fast as the vehicle can go: drawn basins, and flights whose estimated current has to explain what
thrust and drag lack, as the estimator's does."""

import math
from dataclasses import dataclass, replace

import numpy as np
from control_loop import rk4

from autopilot.control.controller import MotionController
from autopilot.core import model4
from autopilot.core.frames import FloatArray, wrap_pi
from autopilot.core.geometry import Circle, Fence, Polygon
from autopilot.core.messages import ControlOutput, Goal, NavHealth, NavState
from autopilot.core.model4 import Model4
from autopilot.core.params import ParamSet
from autopilot.core.vehicle import load_vehicle

VEHICLES = ("lbv150", "bluerov2", "bluerov2-heavy")
STEP_US, SUBSTEPS = 50_000, 5
LAG_S, CURRENT_LAG_S = 0.15, 1.2
SPREAD = np.square([1e-3, 1e-3, 1e-3, 1e-3, 1e-3, 1e-2, 0.045, 0.04, 0.02, 0.045, 0.04, 0.02])
"""Variances of the estimate, as in flight with the camera."""
HALF_M = np.array([5.0, 3.0])
PILLAR_M = 0.16


@dataclass(frozen=True, kw_only=True)
class Draw:
    vehicle: str
    stream_m_s: FloatArray
    thrust: float
    drag: float
    start: FloatArray
    """(8,)"""
    goal: Goal
    pillar_m: FloatArray

    @property
    def fence(self) -> Fence:
        x, y = HALF_M
        corners = np.array([[-x, -y], [x, -y], [x, y], [-x, y]])
        pillar = Circle(center_ned_m=self.pillar_m, radius_m=PILLAR_M)
        return Fence(
            inclusions=(Polygon(vertices_ned_m=corners),), exclusions=(pillar,), depth_min_m=0.0, depth_max_m=1.2
        )


def made_m_s(params: ParamSet) -> float:
    """What is made with the fixed margin."""
    return params["SPD_PLANAR_MAX"] - params["MPC_SPEED_MARGIN"]


def draw(seed: int) -> Draw:
    """0.8 to 1.2 of that, any heading, thrust 0.8 to 1, drag 1 to 1.25, a pillar in the lee or beside the way."""
    rng = np.random.default_rng((301, seed))
    vehicle = VEHICLES[seed % len(VEHICLES)]
    speed, to = rng.uniform(0.8, 1.2) * made_m_s(ParamSet()), rng.uniform(-math.pi, math.pi)
    stream = speed * np.array([math.cos(to), math.sin(to), 0.0])
    keep = load_vehicle(vehicle).radius_m + 0.15
    here = rng.uniform(-1.0, 1.0, 2) * (HALF_M - keep)
    place = rng.uniform(-1.0, 1.0, 2) * (HALF_M - keep)
    pillar = here + rng.uniform(1.1, 2.0) * np.array([math.cos(to + (a := rng.normal() * 0.5)), math.sin(to + a)])
    if np.hypot(*(place - pillar)) < keep + PILLAR_M:
        place = 2.0 * here - place if (np.abs(2.0 * here - place) < HALF_M - keep).all() else here.copy()
    facing = rng.uniform(-math.pi, math.pi)
    yaw = wrap_pi(to + math.pi)
    goal = Goal(
        pos_ned_m=np.array([*place, 0.5]),
        yaw_rad=None if rng.uniform() < 0.2 else float(facing),
        speed_m_s=0.35,
        accept_radius_m=0.3,
        accept_yaw_rad=0.15,
        seq=0,
    )
    return Draw(
        vehicle=vehicle,
        stream_m_s=stream,
        thrust=float(rng.uniform(0.8, 1.0)),
        drag=float(rng.uniform(1.0, 1.25)),
        start=np.array([*here, 0.5, yaw, speed, 0.0, 0.0, 0.0]),
        goal=goal,
        pillar_m=pillar,
    )


@dataclass
class StreamFlight:
    x: FloatArray
    """(n, 8) per step."""
    thrust_n: FloatArray
    outputs: list[ControlOutput]
    current: FloatArray
    """(n, 2) estimated"""
    reached_s: float
    short: list[str]
    """Per step what is missing, "" nothing."""
    clearance_m: float
    """Least, of the hull."""


def worse(model: Model4, thrust: float, drag: float) -> Model4:
    return replace(
        model,
        linear_drag=tuple(drag * each for each in model.linear_drag),
        quadratic_drag=tuple(drag * each for each in model.quadratic_drag),
        allocation=tuple(tuple(thrust * each for each in row) for row in model.allocation),
    )


def fly_stream(case: Draw, limit_s: float = 40.0, params: ParamSet | None = None, noise: float = 0.003) -> StreamFlight:
    params = params or ParamSet()
    vehicle = load_vehicle(case.vehicle)
    known, fence = vehicle.to_model(), case.fence
    real = worse(known, case.thrust, case.drag)
    controller, rng = MotionController(vehicle, cpu_clock=lambda: 0.0), np.random.default_rng(1)
    x, acting = case.start.copy(), np.zeros(known.thrusters)
    estimate, water = case.stream_m_s.copy(), case.start[4:6].copy()
    states, thrusts, outputs, currents, short, reached = [], [], [], [], [], math.inf
    h = STEP_US * 1e-6 / SUBSTEPS

    def flow(_: FloatArray) -> FloatArray:
        return case.stream_m_s

    for step in range(round(limit_s * 1e6 / STEP_US)):
        c, s = math.cos(x[3]), math.sin(x[3])
        turn = np.array([[c, -s], [s, c]])
        ground = turn @ x[4:6] + case.stream_m_s[:2]
        seen = x + noise * np.concatenate([0.5 * rng.normal(size=4), np.zeros(4)])
        seen[4:6] = turn.T @ (ground - estimate[:2]) + noise * rng.normal(size=2)
        nav = NavState(
            t_us=step * STEP_US,
            health=NavHealth.GOOD,
            pos_ned_m=seen[:3],
            rpy_rad=np.array([0.0, 0.0, wrap_pi(float(seen[3]))]),
            vel_frd_m_s=np.array([*(turn.T @ ground), x[6]]),
            vel_water_frd_m_s=seen[4:7],
            rate_frd_rad_s=np.array([0.0, 0.0, x[7]]),
            current_ned_m_s=estimate.copy(),
            variance=SPREAD,
        )
        out = controller.step(nav.t_us, nav, case.goal, fence, params)
        outputs.append(out)
        thrusts.append(out.thrust_n)
        states.append(x)
        currents.append(estimate[:2].copy())
        short.append(getattr(controller, "shortfall", ""))
        for _ in range(SUBSTEPS):
            acting = acting + (out.thrust_n - acting) * (1.0 - math.exp(-h / LAG_S))
            # The estimator's velocity through the water is that of the model ...
            predicted = np.array([*x[:4], *water, *x[6:]])
            rate = model4.state_derivative(known, predicted.tolist(), acting.tolist(), [0.0] * 3, math)
            water = water + h * np.array(rate[4:6])
            x = rk4(real, x, acting, flow, h)
        # ... and the current what it lacks of that over ground.
        c, s = math.cos(x[3]), math.sin(x[3])
        turn = np.array([[c, -s], [s, c]])
        lacks = turn @ x[4:6] + case.stream_m_s[:2] - turn @ water
        estimate[:2] += (lacks - estimate[:2]) * STEP_US * 1e-6 / CURRENT_LAG_S
        away = float(np.linalg.norm(x[:3] - case.goal.pos_ned_m))
        turned = 0.0 if case.goal.yaw_rad is None else abs(wrap_pi(float(x[3]) - case.goal.yaw_rad))
        if away < case.goal.accept_radius_m and turned < case.goal.accept_yaw_rad:
            reached = min(reached, (step + 1) * STEP_US * 1e-6)
    track = np.array(states)
    pillar = np.hypot(*(track[:, :2] - case.pillar_m).T).min() - PILLAR_M
    wall = (HALF_M - np.abs(track[:, :2])).min()
    return StreamFlight(
        x=track,
        thrust_n=np.array(thrusts),
        outputs=outputs,
        current=np.array(currents),
        reached_s=reached,
        short=short,
        clearance_m=float(min(pillar, wall)) - vehicle.radius_m,
    )
