"""Closed loop of the controller's benchmarks: the paper's tank, the model as the plant, a uniform current."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from autopilot.control.controller import MotionController
from autopilot.control.nmpc.ocp import discrete_dynamics
from autopilot.control.path.path_tuning import GUIDANCE
from autopilot.control.path.workers import BackgroundWorkers
from autopilot.core.frames import FloatArray, wrap_pi
from autopilot.core.geometry import Circle, Fence, Polygon
from autopilot.core.messages import ControlOutput, Goal, NavHealth, NavState
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

QUADRATIC = ParamSet({"MPC_COST": 0})


def estimate_of(
    t_us: int, x: FloatArray, *, current_ned_m_s: FloatArray | None = None, sigma: FloatArray | None = None
) -> NavState:
    """Estimate equal to the state ``x`` (8,); ``sigma`` (12,): its standard deviations (default: none)."""
    return NavState(
        t_us=t_us,
        health=NavHealth.GOOD,
        pos_ned_m=x[:3],
        rpy_rad=np.array([0.0, 0.0, wrap_pi(float(x[YAW]))]),
        vel_frd_m_s=x[4:7],
        vel_water_frd_m_s=x[4:7],
        rate_frd_rad_s=np.array([0.0, 0.0, x[7]]),
        current_ned_m_s=np.zeros(3) if current_ned_m_s is None else current_ned_m_s,
        variance=np.zeros(12) if sigma is None else sigma**2,
    )


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


class TankFlight:
    """A flight through the waypoints, beginning with number ``first``, step by step."""

    def __init__(
        self,
        controller: MotionController,
        vehicle: Vehicle,
        start: FloatArray,
        *,
        fence: Fence = TANK,
        first: int = 0,
        params: ParamSet = QUADRATIC,
    ) -> None:
        """``start`` (8,): the state."""
        self.x, self.cost = np.array(start, dtype=float), 0.0
        self._controller, self._fence, self._params = controller, fence, params
        self._move = discrete_dynamics(vehicle.to_model(), STEP_US * 1e-6, 1)
        self._goals, self._index, self._steps = [waypoint(*w) for w in WAYPOINTS], first, 0
        q = params["MPC_Q_POS"]
        self._weights = np.array([q, q, params["MPC_Q_Z"], params["MPC_Q_YAW"], *GUIDANCE.velocity_weights])
        self._acting = np.zeros(len(vehicle.thrusters))
        self._follows = 1.0 - math.exp(-STEP_US * 1e-6 / vehicle.drive.time_constant_s)

    def step(self) -> ControlOutput:
        """A control step, and the vehicle's motion until the next."""
        t_us, goal, x = self._steps * STEP_US, self._goals[self._index], self.x
        estimate = estimate_of(t_us, x, current_ned_m_s=CURRENT_NED_M_S)
        output = self._controller.step(t_us, estimate, goal, self._fence, self._params)
        self._acting += (output.thrust_n - self._acting) * self._follows
        self.x = x = self._move(x, self._acting, CURRENT_NED_M_S)[0].full().ravel()
        turned = wrap_pi(float(x[YAW]) - (goal.yaw_rad or 0.0))
        error = np.array([*(x[:3] - goal.pos_ned_m), turned, 0.0, 0.0, 0.0, x[7]])
        self.cost += float(error @ (self._weights * error))
        self.cost += float(self._params["MPC_R_THRUST"] * self._acting @ self._acting)
        if np.linalg.norm(error[:3]) < goal.accept_radius_m and abs(turned) < goal.accept_yaw_rad:
            self._index = 1 - self._index
        self._steps += 1
        return output


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
    flight = TankFlight(controller, vehicle, start, fence=fence, first=first, params=params)
    failures = 0
    states: list[FloatArray] = []
    solve_s: list[float] = []
    planning_s: list[float] = []
    for step in range(steps):
        output = flight.step()
        (solve_s if output.status.iterations == 1 else planning_s).append(output.status.solve_s)
        failures += output.status.status.name != "OK" or not bool(np.isfinite(output.thrust_n).all())
        watch(step, output)
        states.append(flight.x)
    return LoopFlight(
        x=np.array(states),
        solve_s=np.array(solve_s),
        planning_s=np.array(planning_s),
        failures=failures,
        cost=flight.cost,
    )


FROM_A = np.array([*WAYPOINTS[1], 0.0, 0.0, 0.0, 0.0])
WARM_STEPS = 2
HORIZONS = {8.0: 20, 16.0: 40, 32.0: 80}
"""Reach [s] of geometric grids -> intervals; the first is the controller's own."""
HORIZON_STEPS = 20


class FlightTrial:
    """The controller in the paper's tank beside a service that listens: its steps are called where the service's would
    be, at its pace, and its plans are made by threads, so that they cost what they cost in flight."""

    def __init__(self, vehicle: Vehicle, cost: int) -> None:
        """``cost``: MPC_COST."""
        self._desks = BackgroundWorkers.beside(blocking=False)
        controller = MotionController(vehicle, desks=self._desks)
        self._flight = TankFlight(controller, vehicle, FROM_A, params=ParamSet({"MPC_COST": cost}))
        for _ in range(WARM_STEPS):
            self.step()

    def step(self) -> None:
        self._flight.step()

    def close(self) -> None:
        """End the threads."""
        for desk in self._desks.executors:
            desk.close()


def horizon_times(vehicle: Vehicle) -> dict[float, float]:
    """Time of a control step by reach of its prediction [s], over that of the shortest."""
    times = {}
    for reach_s, n in HORIZONS.items():
        controller = MotionController(vehicle, n=n, horizon_s=reach_s)
        flown = fly(controller, vehicle, FROM_A, HORIZON_STEPS)
        times[reach_s] = float(np.median(flown.solve_s))
    return {reach_s: taken_s / times[min(times)] for reach_s, taken_s in times.items()}


class FlightTrials:
    """The flights of the doctor."""

    def start(self, vehicle: Vehicle, cost: int) -> FlightTrial:
        """In the paper's tank with this MPC_COST."""
        return FlightTrial(vehicle, cost)

    def horizons(self, vehicle: Vehicle) -> dict[float, float]:
        """See :func:`horizon_times`."""
        return horizon_times(vehicle)


def waypoint(x: float, y: float, z: float, yaw: float) -> Goal:
    """A goal with the paper's acceptance."""
    return Goal(
        pos_ned_m=np.array([x, y, z]), yaw_rad=yaw, speed_m_s=0.35, accept_radius_m=0.3, accept_yaw_rad=0.15, seq=-1
    )
