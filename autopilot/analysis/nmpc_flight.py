"""Closed loop of the controller's benchmarks: the paper's tank, the model as the plant, a uniform current."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from autopilot.analysis.estimates import estimate_of
from autopilot.control.controller import MotionController
from autopilot.control.nmpc.ocp import discrete_dynamics
from autopilot.control.path.path_tuning import GUIDANCE
from autopilot.core.frames import FloatArray, wrap_pi
from autopilot.core.geometry import Circle, Fence, Polygon
from autopilot.core.messages import ControlOutput, Goal
from autopilot.core.model4 import YAW
from autopilot.core.params import ParamSet
from autopilot.core.vehicle import Vehicle

STEP_US = 50_000
CURRENT_NED_M_S = np.array([0.12, -0.08, 0.0])
PILLARS = ((-0.625, -0.625), (0.9375, 0.0))
TANK = Fence(
    inclusions=(Polygon(vertices_ned_m=np.array([[-2.5, -1.5], [2.5, -1.5], [2.5, 1.5], [-2.5, 1.5]])),),
    exclusions=tuple(Circle(center_ned_m=np.array(center), radius_m=0.16) for center in PILLARS),
    depth_max_m=1.2,
)
"""Tank and obstacles of the paper, section IV."""

WAYPOINTS = ((1.75, 0.0, 0.30, math.pi), (-1.60, -0.35, 0.45, 0.0))
"""B and A of the paper: x, y, z [m], yaw [rad]."""

FLOWN_STEPS = 160
"""8 s of flight: from A to B and a new goal."""

QUADRATIC = ParamSet({"MPC_COST": 0})


def basin(obstacles: int, seed: int = 3) -> Fence:
    """The paper's two pillars and further ones, scattered over a basin of 12 x 9 m beside the path between the
    goals.
    """
    rng = np.random.default_rng(seed)
    centers = [np.array(center) for center in PILLARS]
    while len(centers) < obstacles:
        center = rng.uniform([-5.5, -4.0], [5.5, 4.0])
        if abs(center[1]) > 1.2 or abs(center[0]) > 2.8:
            centers.append(center)
    return Fence(
        inclusions=(Polygon(vertices_ned_m=np.array([[-6.0, -4.5], [6.0, -4.5], [6.0, 4.5], [-6.0, 4.5]])),),
        exclusions=tuple(Circle(center_ned_m=center, radius_m=0.16) for center in centers),
        depth_max_m=1.2,
    )


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LoopFlight:
    x: FloatArray
    """(steps, 8) states after each step."""
    solve_s: FloatArray
    """(m,) CPU time of the steps along a route."""
    planning_s: FloatArray
    """(k,) CPU time of the steps that began a new one."""
    failures: int
    """Steps without a solved program."""
    cost: float
    """Distance to the goal and thrust, weighed as the controller weighs them, summed over time."""


def fly(
    controller: MotionController,
    vehicle: Vehicle,
    start: FloatArray,
    steps: int,
    *,
    fence: Fence = TANK,
    first: int = 0,
    params: ParamSet = QUADRATIC,
    watch: Callable[[int, ControlOutput], None] = lambda step, output: None,
) -> LoopFlight:
    """Fly from ``start`` (8,) through the waypoints, beginning with number ``first``."""
    move = discrete_dynamics(vehicle.to_model(), STEP_US * 1e-6, 1)
    goals, index = [waypoint(*w) for w in WAYPOINTS], first
    q = params["MPC_Q_POS"]
    weights = np.array([q, q, params["MPC_Q_Z"], params["MPC_Q_YAW"], *GUIDANCE.velocity_weights])
    x, acting, cost, failures = np.array(start, dtype=float), np.zeros(len(vehicle.thrusters)), 0.0, 0
    states: list[FloatArray] = []
    solve_s: list[float] = []
    planning_s: list[float] = []
    for step in range(steps):
        output = controller.step(
            step * STEP_US, estimate_of(step * STEP_US, x, current_ned_m_s=CURRENT_NED_M_S), goals[index], fence, params
        )
        (solve_s if output.status.iterations == 1 else planning_s).append(output.status.solve_s)
        failures += output.status.status.name != "OK" or not bool(np.isfinite(output.thrust_n).all())
        watch(step, output)
        acting += (output.thrust_n - acting) * (1.0 - math.exp(-STEP_US * 1e-6 / vehicle.drive.time_constant_s))
        x = move(x, acting, CURRENT_NED_M_S)[0].full().ravel()
        states.append(x)
        goal = goals[index]
        turned = wrap_pi(float(x[YAW]) - (goal.yaw_rad or 0.0))
        error = np.array([*(x[:3] - goal.pos_ned_m), turned, 0.0, 0.0, 0.0, x[7]])
        cost += float(error @ (weights * error) + params["MPC_R_THRUST"] * acting @ acting)
        if np.linalg.norm(error[:3]) < goal.accept_radius_m and abs(turned) < goal.accept_yaw_rad:
            index = 1 - index
    return LoopFlight(
        x=np.array(states),
        solve_s=np.array(solve_s),
        planning_s=np.array(planning_s),
        failures=failures,
        cost=cost,
    )


def control_load(vehicle: Vehicle, cost: int) -> float:
    """Share of a core that the controller takes in flight with this MPC_COST, in the paper's tank."""
    controller = MotionController(vehicle)
    start = np.array([*WAYPOINTS[1], 0.0, 0.0, 0.0, 0.0])
    params = ParamSet({"MPC_COST": cost})
    fly(controller, vehicle, start, 2, params=params)
    begin_s = time.process_time()
    fly(controller, vehicle, start, FLOWN_STEPS, params=params)
    return (time.process_time() - begin_s) / (FLOWN_STEPS * STEP_US * 1e-6)


def waypoint(x: float, y: float, z: float, yaw: float) -> Goal:
    """A goal with the paper's acceptance."""
    return Goal(
        pos_ned_m=np.array([x, y, z]), yaw_rad=yaw, speed_m_s=0.35, accept_radius_m=0.3, accept_yaw_rad=0.15, seq=-1
    )
