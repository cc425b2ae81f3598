"""Streams about as fast as the vehicle can go: what becomes of goals, clearance and smoothness.

Closed loop of the controller on its own model, whose thrust and drag are worse than the vehicle file says. As that of
the estimator, the estimated current explains what they lack. The goal is given up as by the mission, and the place is
held.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import click
import numpy as np

from autopilot.cli.console_output import print_table
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
from autopilot.log.smoothness import BARS, Smoothness, ThrustCommands, measure
from autopilot.mission.upstream import MadeGood
from tests.control.control_loop import goal as goal_at
from tests.control.control_loop import inside, rk4

VEHICLES = ("lbv150", "bluerov2", "bluerov2-heavy")
STEP_US, SUBSTEPS = 50_000, 5
LAG_S, CURRENT_LAG_S = 0.15, 1.2
SPREAD = np.square([1e-3, 1e-3, 1e-3, 1e-3, 1e-3, 1e-2, 0.045, 0.04, 0.02, 0.045, 0.04, 0.02])
"""Variances of the estimate, as in flight with the camera."""
UP_M, BESIDE_M, LEE_M, OPEN_M = 4.0, 2.5, 4.0, 60.0
"""Distances of the fence upstream, on both sides and in the lee: a wall there if the vehicle can hold, else open."""
PILLAR_M = 0.16
IDLE_M, MAX_IDLE_S = 0.1, 15.0
JUDGED = ("alternating", "step_n", "reversals_1_s")
"""Bars of ``autopilot log check``."""


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
    north, east = (place @ along).tolist()
    yaw_rad = None if rng.uniform() < 0.2 else float(rng.uniform(-math.pi, math.pi))
    return Draw(
        vehicle=vehicle.name,
        stream_m_s=stream,
        made_m_s=made,
        thrust=thrust,
        drag=drag,
        start=np.array([*(here @ along), 0.5, wrap_pi(to + math.pi), speed, 0.0, 0.0, 0.0]),
        goal=goal_at(north, east, 0.5, yaw_rad),
        pillar_m=pillar @ along,
        lee_m=LEE_M if speed < 0.95 * fastest else OPEN_M,
    )


@dataclass(frozen=True, kw_only=True)
class StreamFlight:
    x: FloatArray
    """(n, 8) per step."""
    outputs: list[ControlOutput]
    reached_s: float
    given_up_s: float
    """inf = not."""
    idle_s: float
    """Longest time before without getting IDLE_M nearer."""
    shortfall: str
    """What was missing when the goal was given up."""
    clearance_m: float
    """Least, of the hull."""
    smoothness: Smoothness

    @property
    def problem(self) -> str:
        """What is wrong with it, "" if nothing is."""
        if self.clearance_m < 0.0:
            return f"contact {self.clearance_m:.3f} m"
        if self.idle_s > MAX_IDLE_S:
            return f"no progress for {self.idle_s:.0f} s"
        return " ".join(name for name in BARS.broken(self.smoothness) if name in JUDGED)


def worse(model: Model4, thrust: float, drag: float) -> Model4:
    (u, v, w, r), (uu, vv, ww, rr) = (drag * np.array((model.linear_drag, model.quadratic_drag))).tolist()
    allocation = tuple(tuple(thrust * each for each in row) for row in model.allocation)
    return replace(model, linear_drag=(u, v, w, r), quadratic_drag=(uu, vv, ww, rr), allocation=allocation)


def fly_stream(case: Draw, limit_s: float = 60.0, noise: float = 0.003) -> StreamFlight:
    params, vehicle, fence = ParamSet(), load_vehicle(case.vehicle), case.fence
    known = vehicle.to_model()
    real, made_good = worse(known, case.thrust, case.drag), MadeGood()
    controller, rng = MotionController(vehicle, cpu_clock=lambda: 0.0), np.random.default_rng(1)
    x, acting = case.start.copy(), np.zeros(known.thrusters)
    estimate, water = case.stream_m_s.copy(), case.start[4:6].copy()
    states, outputs, goal, shortfall = [], [], case.goal, ""
    reached_s = given_up_s = nearest_m = math.inf
    nearest_step, idle_s, h = 0, 0.0, STEP_US * 1e-6 / SUBSTEPS
    for step in range(round(limit_s * 1e6 / STEP_US)):
        ground = _turn(x) @ x[4:6] + case.stream_m_s[:2]
        seen = x.copy()
        seen[:4] += 0.5 * noise * rng.normal(size=4)
        seen[4:6] = _turn(x).T @ (ground - estimate[:2]) + noise * rng.normal(size=2)
        nav = NavState(
            t_us=step * STEP_US,
            health=NavHealth.GOOD,
            pos_ned_m=seen[:3],
            rpy_rad=np.array([0.0, 0.0, wrap_pi(float(seen[3]))]),
            vel_frd_m_s=np.array([*(_turn(x).T @ ground), x[6]]),
            vel_water_frd_m_s=seen[4:7],
            rate_frd_rad_s=np.array([0.0, 0.0, x[7]]),
            current_ned_m_s=estimate.copy(),
            variance=SPREAD,
        )
        out = controller.step(nav.t_us, nav, goal, fence, params)
        outputs.append(out)
        states.append(x)
        if math.isinf(min(reached_s, given_up_s)):
            left_m = float(np.linalg.norm(x[:3] - goal.pos_ned_m))
            if left_m < nearest_m - IDLE_M:
                nearest_m, nearest_step = left_m, step
            idle_s = max(idle_s, 1e-6 * STEP_US * (step - nearest_step))
            path_m = float(np.hypot(*np.diff(out.route_ned_m, axis=0).T).sum())
            least_m = MISSION_RUN.shortfall_s * params["SPD_GROUND_MIN"]
            stuck = made_good.idle_s(nav.t_us, goal, nav, path_m, least_m) >= MISSION_RUN.shortfall_s
            if controller.shortfall and stuck:
                given_up_s, shortfall = nav.t_us * 1e-6, controller.shortfall
                goal = replace(goal, pos_ned_m=nav.pos_ned_m.copy(), yaw_rad=float(nav.rpy_rad[2]), seq=-1)
        for _ in range(SUBSTEPS):
            acting = acting + (out.thrust_n - acting) * (1.0 - math.exp(-h / LAG_S))
            # The estimator's velocity through the water is that of the model ...
            predicted = [*x[:4].tolist(), *water.tolist(), *x[6:].tolist()]
            water = water + h * np.array(
                model4.state_derivative(known, predicted, acting.tolist(), [0.0] * 3, math)[4:6]
            )
            x = rk4(real, x, acting, lambda _: case.stream_m_s, h)
        # ... and the current what it lacks of that over ground.
        lacks = _turn(x) @ (x[4:6] - water) + case.stream_m_s[:2] - estimate[:2]
        estimate[:2] += lacks * STEP_US * 1e-6 / CURRENT_LAG_S
        if math.isinf(given_up_s) and inside(x, case.goal):
            reached_s = min(reached_s, (step + 1) * STEP_US * 1e-6)
    track = np.array(states)
    return StreamFlight(
        x=track,
        outputs=outputs,
        reached_s=reached_s,
        given_up_s=given_up_s,
        idle_s=idle_s,
        shortfall=shortfall,
        clearance_m=case.clearance_m(track[:, :2]) - vehicle.radius_m,
        smoothness=_smoothness(outputs, min(given_up_s, limit_s), params["THR_LIMIT"]),
    )


def _turn(x: FloatArray) -> FloatArray:
    """(2, 2) from the body to the world."""
    c, s = math.cos(x[3]), math.sin(x[3])
    return np.array([[c, -s], [s, c]])


def _smoothness(outputs: list[ControlOutput], goal_s: float, limit_n: float) -> Smoothness:
    found = measure(
        ThrustCommands(
            t_s=1e-6 * STEP_US * np.arange(len(outputs), dtype=np.float64),
            thrust_n=np.array([out.thrust_n for out in outputs]),
            fallback=np.array([out.status.fallback for out in outputs], dtype=np.uint8),
            starts_s=np.array([0.0, goal_s]),
            reported_s=np.zeros(0),
            limit_n=limit_n,
        )
    )
    assert found is not None
    return found


COLUMNS = (
    "draw", "vehicle", "m/s", "made", "thrust", "drag", "reached s", "given up s", "idle s", "clear m", "alternating %",
    "reversals 1/s", "step N", "missing", "problem",
)  # fmt: skip


def rows(seeds: range) -> Iterator[list[str]]:
    for seed in seeds:
        case = draw(seed)
        flight = fly_stream(case)
        smooth = flight.smoothness
        yield [
            str(seed),
            case.vehicle,
            f"{np.hypot(*case.stream_m_s[:2]):.3f}",
            f"{case.made_m_s:.3f}",
            f"{case.thrust:.2f}",
            f"{case.drag:.2f}",
            f"{flight.reached_s:.1f}",
            f"{flight.given_up_s:.1f}",
            f"{flight.idle_s:.1f}",
            f"{flight.clearance_m:.3f}",
            f"{100.0 * smooth.alternating:.2f}",
            f"{smooth.reversals_1_s:.2f}",
            f"{smooth.step_n:.2f}",
            flight.shortfall.split(" ")[0],
            flight.problem,
        ]


@click.command()
@click.option("--draws", type=click.IntRange(1), default=200, show_default=True)
@click.option("--seed", type=int, default=1, show_default=True, help="First one.")
def main(draws: int, seed: int) -> None:
    """Streams of 0.8 to 1.2 of what can be made, a flight of a minute each. Exit code 1 with a problem."""
    found = list(rows(range(seed, seed + draws)))
    print_table("streams", list(COLUMNS), found)
    raise SystemExit(any(row[-1] for row in found))


if __name__ == "__main__":
    main()
