"""Starts that nobody chose: vehicles, waters, fences, headings, velocities and parameters of all kinds, both guidances.

Whatever comes, the program of a step has a solution (its limits are soft), so no step may need a fallback.
"""

import math
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
import pytest
from control_loop import VEHICLE, fly, goal, nav_state
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from autopilot.control.controller import MotionController
from autopilot.control.energy.flow import FlowField
from autopilot.control.energy.request import Plan, TrajectoryRequest
from autopilot.control.energy.trajectory import Trajectory
from autopilot.control.nmpc import ocp
from autopilot.control.nmpc.grid import geometric_grid
from autopilot.control.nmpc.reversal import LEAST_SHARE
from autopilot.control.nmpc.unsolved import solve_again
from autopilot.control.step_program import MOST_QPS
from autopilot.control.thrust.thrust_tuning import BY_HAND
from autopilot.core.background import Cancel
from autopilot.core.frames import FloatArray
from autopilot.core.geometry import Circle, Fence, Polygon
from autopilot.core.messages import Fallback, Goal, SolveStatus
from autopilot.core.model4 import NX
from autopilot.core.params import ParamSet
from autopilot.core.vehicle import Vehicle
from autopilot.log.packing.programs import unpack

DEPTH_M = 20.0

PROGRAMS = Path(__file__).parents[1] / "data" / "programs"
"""Programs that failed in random closed loops with weights, thrusts and currents at extremes."""

NO_SHRINKING = (Phase.explicit, Phase.reuse, Phase.generate)
"""Building a prediction takes longer than finding the simplest one that fails is worth."""


def scaled(factors: FloatArray) -> Vehicle:
    """The LBV150 with its masses (4), linear (4) and quadratic drags (4) multiplied."""
    old = VEHICLE.model4
    names = ("mass_kg", "linear_drag", "quadratic_drag")
    new = {
        name: tuple(float(f * v) for f, v in zip(row, getattr(old, name), strict=True))
        for name, row in zip(names, factors, strict=True)
    }
    return msgspec.structs.replace(VEHICLE, model4=msgspec.structs.replace(old, **new))


OTHERS = (
    scaled(np.array([[1.6, 0.7, 1.0, 0.6], [0.5, 1.5, 1.0, 2.0], [0.6, 1.8, 1.0, 1.9]])),
    scaled(np.array([[0.6, 1.8, 1.5, 1.8], [1.5, 0.5, 1.0, 0.5], [1.7, 0.6, 1.0, 0.5]])),
)
"""Two other vehicles; each costs a build of the optimiser."""


@given(
    st.lists(st.floats(0.5, 2.0), min_size=12, max_size=12),
    st.lists(st.floats(-1.0, 1.0), min_size=8, max_size=8),
)
@settings(max_examples=40, deadline=None, phases=NO_SHRINKING)
def test_predictions_of_light_vehicles_with_much_drag_do_not_explode(factors: list[float], state: list[float]) -> None:
    model = scaled(np.array(factors).reshape(3, 4)).to_model()
    grid = geometric_grid()
    planar, heave, turn = (share * most for share, most in zip(state, ocp.fastest_guess(model), strict=False))
    way = math.pi * state[3]
    x = np.array([0.0, 0.0, 0.0, 0.0, planar * math.cos(way), planar * math.sin(way), heave, turn])
    steps = grid.substeps(ocp.longest_step_s(model))[-1]
    found = ocp.discrete_dynamics(model, float(grid.dt_s[-1]), steps)(x, 12.0 * np.array(state[4:]), np.zeros(3))
    assert np.abs(np.array(found[0])[4:]).max() < 3.0
    assert np.abs(np.array(found[1])).max() < 1e4


@pytest.mark.parametrize("turning", [0.5, 2.0, 3.0])
def test_a_light_vehicle_that_turns_against_much_drag_is_controlled(turning: float) -> None:
    """Twice the LBV150's damping of a turn to its full yaw rate and more."""
    factors = np.ones((3, 4))
    factors[0, 3], factors[2, 3] = 1.0 / turning, turning
    vehicle = scaled(factors)
    flight = fly(
        MotionController(vehicle, cpu_clock=lambda: 0.0),
        [goal(-2.0, 1.0, 0.5, 0.3)],
        [0.0, 0.0, 0.5, -0.2, 0.0, 0.0, 0.0, 0.4],
        fence=Fence(depth_max_m=DEPTH_M),
        params=ParamSet({"DEPTH_MAX": DEPTH_M}),
        limit_s=5.0,
        model=vehicle.to_model(),
    )
    assert {output.status.status for output in flight.outputs} == {SolveStatus.OK}
    assert {output.status.fallback for output in flight.outputs} == {Fallback.NONE}


@dataclass(frozen=True, eq=False, kw_only=True)
class Case:
    """A start that a random number generator has made."""

    vehicle: Vehicle
    start: FloatArray
    current: FloatArray
    goal: Goal
    fence: Fence
    params: ParamSet
    limit_n: FloatArray


def case(seed: int, cost: int) -> Case:
    """Currents up to 0.9 of the speed limit, fences from none to tight, up to six cylinders, weak thrusters."""
    rng = np.random.default_rng(seed)
    vehicle = VEHICLE if rng.random() < 0.5 else OTHERS[int(rng.integers(2))]
    speed = float(rng.choice([0.3, 0.5, 0.8]))
    params = ParamSet(
        {
            "DEPTH_MAX": DEPTH_M,
            "MPC_COST": cost,
            "MPC_MARGIN": float(rng.choice([0.0, 0.03, 0.1])),
            "MPC_TIGHTEN": float(rng.integers(3)),
            "SPD_PLANAR_MAX": speed,
        }
    )
    drift, way, yaw = rng.uniform(0.0, 0.9) * speed, rng.uniform(-math.pi, math.pi), rng.uniform(-math.pi, math.pi)
    current = np.array([drift * math.cos(way), drift * math.sin(way), 0.0])
    over_ground = current[:2] * rng.integers(2) + rng.uniform(-0.3, 0.3, 2) * rng.integers(2)
    north, east = over_ground - current[:2]
    c, s = math.cos(yaw), math.sin(yaw)
    surge, sway, turn = c * north + s * east, c * east - s * north, rng.uniform(-0.6, 0.6) * rng.integers(2)
    start = np.array([0.0, 0.0, rng.uniform(0.3, 3.0), yaw, surge, sway, 0.0, turn])
    far, bearing = float(rng.choice([0.5, 3.0, 15.0])), rng.uniform(-math.pi, math.pi)
    to = goal(
        far * math.cos(bearing),
        far * math.sin(bearing),
        rng.uniform(0.3, 3.0),
        None if rng.random() < 0.5 else float(rng.uniform(-math.pi, math.pi)),
        speed_m_s=float(rng.choice([0.2, 0.35, 0.6])),
    )
    ends, room = np.stack([np.zeros(2), to.pos_ned_m[:2]]), vehicle.radius_m + params["MPC_MARGIN"]
    (n0, e0), (n1, e1) = (
        ends.min(axis=0) - room - rng.uniform(0.05, 3.0, 2),
        ends.max(axis=0) + room + rng.uniform(0.05, 3.0, 2),
    )
    basin = (Polygon(vertices_ned_m=np.array([[n0, e0], [n1, e0], [n1, e1], [n0, e1]])),)
    cylinders = [
        Circle(center_ned_m=rng.uniform(0.0, 1.0) * ends[1] + rng.normal(0.0, 1.0, 2), radius_m=rng.uniform(0.05, 0.4))
        for _ in range(int(rng.integers(7)))
    ]
    clear = [one for one in cylinders if np.hypot(*(ends - one.center_ned_m).T).min() > one.radius_m + room + 0.02]
    return Case(
        vehicle=vehicle,
        start=start,
        current=current,
        goal=to,
        fence=Fence(inclusions=basin if rng.random() < 0.6 else (), exclusions=tuple(clear), depth_max_m=DEPTH_M),
        params=params,
        limit_n=12.0 * (rng.uniform(0.3, 1.0, 4) if rng.random() < 0.4 else np.ones(4)),
    )


class WildPlanner:
    """Trajectories from here to the goal that spin, jump and end too early, as an optimiser that failed leaves them."""

    def plan(self, request: TrajectoryRequest, cancel: Cancel) -> Plan:
        rng = np.random.default_rng(int(1e3 * abs(float(request.x0[2]))))
        t = np.linspace(0.0, float(rng.uniform(2.0, 20.0)), 41)
        x = np.zeros((len(t), NX))
        x[:, :3] = request.x0[:3] + np.outer(t / t[-1], np.asarray(request.goal.pos_ned_m) - request.x0[:3])
        x[:, 3] = request.x0[3] + rng.uniform(-6.0, 6.0) * np.minimum(1.0, t / 0.5)
        x[:, 4:] = np.gradient(x[:, :4], t, axis=0) + rng.normal(0.0, 0.3, (len(t), 4))
        x[0] = request.x0
        thrust = rng.uniform(-12.0, 12.0, (len(t) - 1, 4))
        found = Trajectory(t_s=t, x=x, thrust_n=thrust, energy_j=1.0, cost_j=1.0, solved=True)
        return Plan(
            goal=request.goal, trajectory=found, energy_j=1.0, eta_s=1.0, complete=True, flow=FlowField(request.flow)
        )

    def warm(self) -> None:
        """Nothing to do."""


@pytest.mark.parametrize("cost", [0, 1])
@pytest.mark.parametrize("block", range(2))
def test_no_start_needs_a_fallback(block: int, cost: int) -> None:
    """At the end of the plan's first second everything has come to a plan that holds."""
    for seed in range(8 * block, 8 * block + 8):
        one = case(seed, cost)
        controller = MotionController(one.vehicle, cpu_clock=lambda: 0.0, trajectories=WildPlanner())
        for step in range(10):
            x, t_us = one.start, 50_000 * step
            output = controller.step(
                t_us, nav_state(t_us, x, one.current), one.goal, one.fence, one.params, one.limit_n
            )
            assert output.status.status is SolveStatus.OK, (seed, step)
            assert output.status.fallback is Fallback.NONE, (seed, step)
            assert (np.abs(output.thrust_n) <= one.limit_n + 1e-9).all()


def test_the_first_thrust_of_a_start_has_converged() -> None:
    """One more QP changes nothing, at a start and when the goal changes under way. (Where the speed limit decides and
    the current is nearly as fast, some need more QPs than a step has.)"""
    off = []
    for seed in range(20):
        one = case(1000 + seed, 0)
        controller = MotionController(one.vehicle, cpu_clock=lambda: 0.0)
        back, last = goal(-1.0, 0.5, 1.0, 0.0, seq=1), None
        for step, to in enumerate((one.goal, one.goal, one.goal, back, back)):
            t_us = 50_000 * step
            told = nav_state(t_us, one.start, one.current)
            output = controller.step(t_us, told, to, Fence(depth_max_m=DEPTH_M), one.params, one.limit_n)
            task = controller.nmpc.last_problem
            assert task is not None
            if output.restarted:
                x, u = controller.nmpc.x.copy(), controller.nmpc.u.copy()
                thrust = controller.nmpc.solve(task).thrust_n[0]
                if last is not None:
                    most = BY_HAND.slew_fraction_1_s * one.limit_n * 0.05
                    thrust = np.clip(thrust, last - most, last + most)
                least_n = LEAST_SHARE * one.vehicle.drive.limit_n
                thrust[(output.thrust_n == 0.0) & (np.abs(thrust) < least_n)] = 0.0  # not turned round for that
                off.append(float(np.abs(thrust - output.thrust_n).max()))
                controller.nmpc.set_plan(x, u)
            last = output.thrust_n
    assert len(off) >= 40
    assert np.quantile(off, 0.9) < 0.1


@pytest.mark.parametrize("seed", [1014, 1030, 1041, 1072])
def test_a_step_that_was_halved_grows_again(seed: int) -> None:
    """Steps that stayed at a quarter came nearer by a quarter each: they used up the QPs of a step."""
    one = case(seed, 0)
    one.params.set("MPC_SPEED_MARGIN", 0.08 * min(1.0, 0.5 / one.params["SPD_PLANAR_MAX"]))  # 0.08 m/s at any limit
    controller = MotionController(one.vehicle, cpu_clock=lambda: 0.0)
    told = nav_state(0, one.start, one.current)
    output = controller.step(0, told, one.goal, Fence(depth_max_m=DEPTH_M), one.params, one.limit_n)
    assert output.status.iterations < MOST_QPS


@pytest.mark.parametrize("path", sorted(PROGRAMS.glob("program-*.npz")), ids=lambda path: path.stem)
def test_programs_that_were_not_solved_once_are_solved_now(path: Path) -> None:
    """By every solver that there is, with the same plan where the plan is well determined."""
    trials = [one for one in solve_again(unpack(path.name, path.read_bytes())) if one.status is not None]
    assert {one.status for one in trials} == {SolveStatus.OK}
    first = np.array([one.thrust_n for one in trials])
    assert np.abs(first - first[-1]).max() < 0.3
