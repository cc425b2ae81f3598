"""Streams about as fast as the vehicle can go: drawn basins, and flights whose estimated current has to explain what
thrust and drag lack, as the estimator's does."""

import math
from dataclasses import dataclass, replace

import numpy as np
from control_loop import inside, rk4

from autopilot.command.command_tuning import MISSION_RUN
from autopilot.control.controller import MotionController
from autopilot.core import model4
from autopilot.core.control_allocator import ControlAllocator
from autopilot.core.frames import FloatArray, wrap_pi
from autopilot.core.geometry import Circle, Fence, Polygon
from autopilot.core.messages import ControlOutput, Goal, NavHealth, NavState
from autopilot.core.model4 import Model4
from autopilot.core.params import ParamSet
from autopilot.core.vehicle import load_vehicle
from autopilot.mission.upstream import MadeGood

VEHICLES = ("lbv150", "bluerov2", "bluerov2-heavy")
STEP_US, SUBSTEPS = 50_000, 5
LAG_S, CURRENT_LAG_S = 0.15, 1.2
SPREAD = np.square([1e-3, 1e-3, 1e-3, 1e-3, 1e-3, 1e-2, 0.045, 0.04, 0.02, 0.045, 0.04, 0.02])
"""Variances of the estimate, as in flight with the camera."""
UP_M, BESIDE_M, LEE_M, OPEN_M = 4.0, 2.5, 4.0, 60.0
"""Distances of the fence upstream, on both sides and in the lee: a wall there if the vehicle can hold, else open."""
PILLAR_M = 0.16


@dataclass(frozen=True, kw_only=True)
class Draw:
    vehicle: str
    stream_m_s: FloatArray
    """(3,)"""
    made_m_s: float
    """What the vehicle makes, bow on."""
    thrust: float
    drag: float
    start: FloatArray
    """(8,)"""
    goal: Goal
    pillar_m: FloatArray
    lee_m: float

    @property
    def along(self) -> FloatArray:
        """(2, 2) unit vectors along the stream and across."""
        north, east = self.stream_m_s[:2] / np.hypot(*self.stream_m_s[:2])
        return np.array([[north, east], [-east, north]])

    @property
    def fence(self) -> Fence:
        corners = [[-UP_M, -BESIDE_M], [self.lee_m, -BESIDE_M], [self.lee_m, BESIDE_M], [-UP_M, BESIDE_M]]
        pillar = Circle(center_ned_m=self.pillar_m, radius_m=PILLAR_M)
        basin = Polygon(vertices_ned_m=np.array(corners) @ self.along)
        return Fence(inclusions=(basin,), exclusions=(pillar,), depth_min_m=0.0, depth_max_m=1.2)

    def clearance_m(self, places: FloatArray) -> float:
        """Least distance of places (n, 2) from wall and pillar."""
        x, y = (places @ self.along.T).T
        wall = np.min([x + UP_M, self.lee_m - x, BESIDE_M - np.abs(y)])
        return float(min(wall, np.hypot(*(places - self.pillar_m).T).min() - PILLAR_M))


def fastest_m_s(real: Model4, params: ParamSet) -> float:
    """Speed ahead with all the thrust."""
    allocator, low, high = ControlAllocator(real), 0.0, 3.0
    for _ in range(20):
        middle = 0.5 * (low + high)
        thrust = allocator.hold_n(np.array([[middle, 0.0, 0.0, 0.0]]), np.full(real.thrusters, np.inf))
        low, high = (middle, high) if np.abs(thrust).max() <= params["THR_LIMIT"] else (low, middle)
    return low


def draw(seed: int) -> Draw:
    """0.8 to 1.2 of what can be made, any heading, thrust 0.8 to 1, drag 1 to 1.25, a pillar in the lee."""
    rng, params = np.random.default_rng((301, seed)), ParamSet()
    vehicle = load_vehicle(VEHICLES[seed % len(VEHICLES)])
    thrust, drag = float(rng.uniform(0.8, 1.0)), float(rng.uniform(1.0, 1.25))
    fastest = fastest_m_s(worse(vehicle.to_model(), thrust, drag), params)
    made = min(params["SPD_PLANAR_MAX"] - params["MPC_SPEED_MARGIN"], fastest)
    speed, to = rng.uniform(0.8, 1.2) * made, rng.uniform(-math.pi, math.pi)
    stream = speed * np.array([math.cos(to), math.sin(to), 0.0])
    along = np.array([[math.cos(to), math.sin(to)], [-math.sin(to), math.cos(to)]])
    keep, half = vehicle.radius_m + 0.15, np.array([UP_M, BESIDE_M])
    pillar = np.array([rng.uniform(-1.4, 3.0), rng.uniform(-1.5, 1.5)])
    # The pillar is in the lee of the start, more or less.
    here = np.clip(pillar - [rng.uniform(1.1, 2.0), 0.4 * rng.normal()], keep - half, half - keep)
    place = rng.uniform(-1.0, 1.0, 2) * (half - keep)
    if np.hypot(*(place - pillar)) < keep + PILLAR_M:
        place = here
    goal = Goal(
        pos_ned_m=np.array([*(place @ along), 0.5]),
        yaw_rad=None if rng.uniform() < 0.2 else float(rng.uniform(-math.pi, math.pi)),
        speed_m_s=0.35,
        accept_radius_m=0.3,
        accept_yaw_rad=0.15,
        seq=0,
    )
    return Draw(
        vehicle=vehicle.name,
        stream_m_s=stream,
        made_m_s=made,
        thrust=thrust,
        drag=drag,
        start=np.array([*(here @ along), 0.5, wrap_pi(to + math.pi), speed, 0.0, 0.0, 0.0]),
        goal=goal,
        pillar_m=pillar @ along,
        lee_m=LEE_M if speed < 0.95 * fastest else OPEN_M,
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
    given_up_s: float
    idle_s: float
    """Longest time without progress before."""
    why: str
    """What was missing when the goal was given up."""
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
    states, thrusts, outputs, currents = [], [], [], []
    goal, reached, given_up, longest, why = case.goal, math.inf, math.inf, 0.0, ""
    made_good = MadeGood()
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
        out = controller.step(nav.t_us, nav, goal, fence, params)
        outputs.append(out)
        thrusts.append(out.thrust_n)
        states.append(x)
        currents.append(estimate[:2].copy())
        if not math.isfinite(min(reached, given_up)):
            patience_s = MISSION_RUN.shortfall_s if controller.shortfall else params["WP_STUCK_TIME"]
            path = np.hypot(*np.diff(out.route_ned_m, axis=0).T).sum() if len(out.route_ned_m) > 1 else None
            idle_s = made_good.idle_s(nav.t_us, goal, nav, path, patience_s * params["SPD_GROUND_MIN"])
            longest = max(longest, idle_s)
            if idle_s >= patience_s:
                given_up, why = nav.t_us * 1e-6, controller.shortfall
                goal = replace(goal, pos_ned_m=nav.pos_ned_m.copy(), yaw_rad=float(nav.rpy_rad[2]), seq=-1)
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
        if not math.isfinite(given_up) and inside(x, case.goal):
            reached = min(reached, (step + 1) * STEP_US * 1e-6)
    track = np.array(states)
    return StreamFlight(
        x=track,
        thrust_n=np.array(thrusts),
        outputs=outputs,
        current=np.array(currents),
        reached_s=reached,
        given_up_s=given_up,
        idle_s=longest,
        why=why,
        clearance_m=case.clearance_m(track[:, :2]) - vehicle.radius_m,
    )
