"""Local minima: does the vehicle reach its goal where a controller that only looks ahead gets stuck?

Closed loop of the controller on its own model (50 ms steps, thruster lag, no current): a pocket of three cylinders that
opens towards the vehicle, a cylinder exactly on the straight line to the goal, and two walls with gaps on opposite
sides. From every one of many starts, inside the pocket too, the goal has to be reached without touching anything.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from autopilot.analysis.nmpc_flight import estimate_of
from autopilot.control.constraints.obstacles import clearance_m
from autopilot.control.controller import MotionController
from autopilot.control.nmpc.ocp import discrete_dynamics
from autopilot.core.frames import FloatArray
from autopilot.core.geometry import Circle, Fence, Polygon
from autopilot.core.messages import Goal
from autopilot.core.params import ParamSet
from autopilot.core.vehicle import Vehicle, load_vehicle

STEP_US = 50_000
LIMIT_S = 90.0
"""A goal that is not reached by then counts as missed; the longest way takes 40 s."""

STARTS = 60
SHORT_STARTS = 6
DEPTH_M = 0.4
GOAL_M = (2.5, 0.0)
START_CLEARANCE_M = 0.38
"""From every boundary, of places to start from."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PocketRow:
    world: str
    starts: int
    reached: int
    slowest_s: float
    nearest_m: float
    """Smallest distance of the vehicle's centre from a boundary beyond the body radius."""
    waits: int
    """Steps in which the planner found no way."""


def _circle(x: float, y: float, radius_m: float) -> Circle:
    return Circle(center_ned_m=np.array([x, y]), radius_m=radius_m)


def _box(x0: float, y0: float, x1: float, y1: float) -> Polygon:
    return Polygon(vertices_ned_m=np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]]))


WORLDS: dict[str, Fence] = {
    "pocket of three cylinders": Fence(
        exclusions=(_circle(1.0, 0.0, 0.5), _circle(0.4, 0.9, 0.5), _circle(0.4, -0.9, 0.5)), depth_max_m=1.2
    ),
    "cylinder on the line": Fence(exclusions=(_circle(0.5, 0.0, 0.4),), depth_max_m=1.2),
    "double gap": Fence(
        inclusions=(_box(-3.0, -2.0, 3.5, 2.0),),
        exclusions=(_box(-0.6, -2.0, -0.5, 1.1), _box(0.9, -1.1, 1.0, 2.0)),
        depth_max_m=1.2,
    ),
}


def starts(world: str, count: int) -> list[tuple[float, float, float]]:
    """Places (x, y, yaw) to begin from: the line of symmetry first, where the pull of both sides is equal, then spread
    evenly over the free ground on the far side of the obstacles."""
    fence, rng = WORLDS[world], np.random.default_rng(11)
    chosen = [(-1.5, 0.0, 0.0), (-2.0, 0.0, math.pi)]
    if world == "pocket of three cylinders":
        chosen.append((0.0, 0.0, 0.0))
    while len(chosen) < count:
        x, y, yaw = rng.uniform([-2.5, -1.5, -math.pi], [0.2, 1.5, math.pi]).tolist()
        if clearance_m(fence, [[x, y]])[0] > START_CLEARANCE_M:
            chosen.append((x, y, yaw))
    return chosen[:count]


def bench_pockets(count: int = STARTS) -> list[PocketRow]:
    """One row per world, from ``count`` starts each."""
    vehicle = load_vehicle("lbv150")
    model = vehicle.to_model()
    dynamics = discrete_dynamics(model, STEP_US * 1e-6, 1)

    def move(x: FloatArray, thrust_n: FloatArray) -> FloatArray:
        result: FloatArray = dynamics(x, thrust_n, np.zeros(3))[0].full().ravel()
        return result

    controller = MotionController(vehicle, cpu_clock=_no_clock)
    rows = []
    for world, fence in WORLDS.items():
        flights = [fly_to_goal(controller, move, fence, start, vehicle) for start in starts(world, count)]
        rows.append(
            PocketRow(
                world=world,
                starts=len(flights),
                reached=sum(math.isfinite(flight[0]) for flight in flights),
                slowest_s=max(flight[0] for flight in flights),
                nearest_m=min(flight[1] for flight in flights),
                waits=sum(flight[2] for flight in flights),
            )
        )
    return rows


def fly_to_goal(
    controller: MotionController,
    move: Callable[[FloatArray, FloatArray], FloatArray],
    fence: Fence,
    start: tuple[float, float, float],
    vehicle: Vehicle,
) -> tuple[float, float, int]:
    """Time to the goal [s] (inf = missed), smallest clearance beyond the body radius [m], steps without a way."""
    params, goal = ParamSet({"MPC_COST": 0}), _goal()
    x, acting = np.array([start[0], start[1], DEPTH_M, start[2], 0.0, 0.0, 0.0, 0.0]), np.zeros(4)
    gain = 1.0 - math.exp(-STEP_US * 1e-6 / vehicle.drive.time_constant_s)
    track, waits, reached_s = [x[:2].copy()], 0, math.inf
    controller.reset()
    for step in range(round(LIMIT_S * 1e6 / STEP_US)):
        thrust = controller.step(step * STEP_US, estimate_of(step * STEP_US, x), goal, fence, params).thrust_n
        waits += controller.unreachable
        acting = acting + (thrust - acting) * gain
        x = move(x, acting)
        track.append(x[:2].copy())
        if float(np.linalg.norm(x[:3] - goal.pos_ned_m)) < goal.accept_radius_m:
            reached_s = (step + 1) * STEP_US * 1e-6
            break
    return reached_s, float(clearance_m(fence, np.array(track)).min()) - vehicle.radius_m, waits


def _no_clock() -> float:
    return 0.0


def _goal() -> Goal:
    return Goal(
        pos_ned_m=np.array([*GOAL_M, DEPTH_M]),
        yaw_rad=None,
        speed_m_s=0.35,
        accept_radius_m=0.2,
        accept_yaw_rad=0.15,
        seq=-1,
    )
