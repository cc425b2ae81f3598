"""A vertical force that nobody has told the vehicle of: held without offset, by whatever flies it."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
from control_loop import STEP_US, goal, nav_state, rk4, still

from autopilot.control.controller import MotionController
from autopilot.control.nmpc import ocp
from autopilot.control.thrust.redundancy import tilt_of
from autopilot.control.thrust.thruster_health import ThrusterHealth
from autopilot.core.frames import FloatArray
from autopilot.core.geometry import Fence
from autopilot.core.messages import Fallback, Goal, NavState, Severity, SolveStatus, VelocityGoal
from autopilot.core.params import ParamSet
from autopilot.core.response import Response
from autopilot.core.vehicle import Vehicle, load_vehicle

VEHICLES = {name: load_vehicle(name) for name in ("lbv150", "bluerov2")}
LOW_M, HIGH_M = 0.2, 2.0
BAND = Fence(depth_min_m=LOW_M, depth_max_m=HIGH_M)

Push = Callable[[float], float]
"""Lift [N] that nobody knows of, at a time [s]."""


@dataclass
class Dive:
    """One row per step."""

    depth_m: FloatArray
    lift_n: FloatArray
    thrust_n: FloatArray
    fallbacks: set[Fallback]
    controller: MotionController

    def texts(self) -> list[str]:
        """What the operator was told."""
        return [text for severity, text in self.controller.take_news() if severity <= Severity.WARNING]


def dive(
    vehicle: Vehicle,
    push: Push,
    at: Callable[[float], Goal],
    seconds: float,
    *,
    start_m: float = 1.0,
    cost: int = 0,
    bottom_m: float = math.inf,
    top_m: float = -math.inf,
    share: Callable[[float], FloatArray] | None = None,
    look: Callable[[NavState, FloatArray], object] = lambda *_: None,
    controller: MotionController | None = None,
    noise: np.random.Generator | None = None,
    failing_s: float = math.inf,
) -> Dive:
    """The controller on its model with a force beyond it; the hull is stopped at ``bottom_m`` and ``top_m``. ``share``:
    what the thrusters (n,) really give at a time; ``look`` sees estimate and command. Thrusters tilt the hull, its
    righting moment swings it back. From ``failing_s`` on nothing is solved."""
    controller = controller or MotionController(vehicle, cpu_clock=lambda: 0.0)
    params = ParamSet({"DEPTH_MIN": LOW_M, "DEPTH_MAX": HIGH_M, "MPC_COST": cost})
    model, response = vehicle.to_model(), Response.of(vehicle.thrusters)
    x, acting = np.array([0.0, 0.0, start_m, 0.0, 0.0, 0.0, 0.0, 0.0]), np.zeros(model.thrusters)
    gives, tilting, tilt, swing = np.ones(model.thrusters), tilt_of(vehicle), np.zeros(2), np.zeros(2)
    depth, lift, thrust, fallbacks = [], [], [], set()
    for step in range(round(seconds * 1e6 / STEP_US)):
        t_s = step * STEP_US * 1e-6
        if t_s >= failing_s:
            controller.nmpc.solve = _unsolved(controller)  # type: ignore[method-assign]
        seen = x.copy()
        if noise is not None:
            seen[2] += noise.normal(0.0, 0.003)
            seen[4:7] += noise.normal(0.0, 0.01, 3)
        nav = nav_state(step * STEP_US, seen)
        output = controller.step(step * STEP_US, nav, at(t_s), BAND, params)
        fallbacks.add(output.status.fallback)
        gives = gives if share is None else share(t_s)
        rolling = np.random.default_rng(step).normal(0.0, 0.006, 2)
        rates = np.array([*(swing + rolling), nav.rate_frd_rad_s[2]])
        look(replace(nav, rpy_rad=np.array([*tilt, nav.rpy_rad[2]]), rate_frd_rad_s=rates), output.thrust_n)
        for _ in range(5):
            acting = acting + response.fraction(0.01) * (output.thrust_n - acting)
            pushed = replace(model, buoyancy_excess_n=model.buoyancy_excess_n + push(t_s))
            x = rk4(pushed, x, gives * acting, still, 0.01)
            swing = swing + 0.01 * (tilting @ (gives * acting) - 8.0 * np.sin(tilt) - 1.5 * swing)
            tilt = tilt + 0.01 * swing
            if not top_m < x[2] < bottom_m:
                x[2], x[6] = min(max(x[2], top_m), bottom_m), 0.0
        depth.append(x[2])
        lift.append(output.status.lift_n)
        thrust.append(output.thrust_n)
    return Dive(np.array(depth), np.array(lift), np.array(thrust), fallbacks, controller)


def _unsolved(controller: MotionController) -> Callable[..., object]:
    solve = type(controller.nmpc).solve

    def fails(problem: object) -> object:
        kept = controller.nmpc.x.copy(), controller.nmpc.u.copy()
        result = replace(solve(controller.nmpc, problem), status=SolveStatus.RESIDUAL)  # type: ignore[arg-type]
        controller.nmpc.set_plan(*kept)
        return result

    return fails


def station(_: float) -> Goal:
    return goal(0.0, 0.0, 1.0, 0.0)


def steered(down_m_s: float | None) -> Goal:
    return replace(station(0.0), drive=VelocityGoal(down_m_s=down_m_s))


@pytest.mark.parametrize("cost", [0, 1])
@pytest.mark.parametrize("name", list(VEHICLES))
def test_a_depth_is_held_against_any_force(name: str, cost: int) -> None:
    """0.42 m off the goal, and thrust that gave up, with 6 N before it was learned."""
    rng = np.random.default_rng([cost, len(name)])
    for push_n in (-6.0, 6.0):
        held = dive(VEHICLES[name], lambda _, n=push_n: n, station, 14.0, cost=cost, noise=rng)  # type: ignore[misc]
        assert held.fallbacks == {Fallback.NONE}
        assert np.abs(held.depth_m - 1.0).max() < 0.04 + 0.025 * abs(push_n), push_n
        assert np.abs(held.depth_m[200:] - 1.0).max() < 0.03, push_n
        assert abs(held.lift_n[-40:].mean() - push_n) < 0.25


@pytest.mark.parametrize("name", list(VEHICLES))
@pytest.mark.parametrize(("edge_m", "push_n"), [(HIGH_M - 0.3, -6.0), (LOW_M + 0.3, 6.0)])
def test_the_depth_band_is_kept_while_a_force_is_learned(name: str, edge_m: float, push_n: float) -> None:
    def near(_: float) -> Goal:
        return goal(0.0, 0.0, edge_m, 0.0)

    held = dive(VEHICLES[name], lambda _: push_n, near, 8.0, start_m=edge_m)
    assert held.depth_m.min() > LOW_M
    assert held.depth_m.max() < HIGH_M


@pytest.mark.parametrize("name", list(VEHICLES))
@pytest.mark.parametrize("push_n", [-3.5, 0.9, 6.0])
def test_a_stick_moves_it_as_fast_as_it_asks_for(name: str, push_n: float) -> None:
    """A dive at 0.12 m/s made good 0.05 m in 2.5 s with 0.9 N too much buoyancy."""

    def pilot(t_s: float) -> Goal:
        return steered(None if t_s < 5.0 else 0.12)

    held = dive(VEHICLES[name], lambda _: push_n, pilot, 9.0)
    way_m = float(held.depth_m[159] - held.depth_m[109])
    assert way_m == pytest.approx(2.5 * 0.12, abs=0.05)


def test_a_goal_above_is_reached_with_a_heavy_vehicle_by_least_energy() -> None:
    def up(t_s: float) -> Goal:
        return goal(0.0, 0.0, 1.0, 0.0) if t_s < 6.0 else goal(1.0, 0.0, 0.5, 0.0)

    held = dive(VEHICLES["lbv150"], lambda _: -4.0, up, 26.0, cost=1)
    assert abs(held.depth_m[-1] - 0.5) < 0.03


def test_a_wave_is_not_answered_as_if_it_lasted() -> None:
    """+-3 N every 6 s: a third of it is followed, and the depth is as calm as without any learning."""
    waves = dive(VEHICLES["lbv150"], lambda t: 3.0 * math.sin(2.0 * math.pi * t / 6.0), station, 40.0)
    assert np.abs(waves.lift_n[400:]).max() < 0.5 * 3.0
    assert np.abs(waves.depth_m[400:] - 1.0).max() < 0.13


def test_what_lies_on_the_ground_learns_no_lift_and_what_floats_no_weight() -> None:
    def below(t_s: float) -> Goal:
        return goal(0.0, 0.0, 2.0 if t_s < 20.0 else 1.5, 0.0)

    def above(t_s: float) -> Goal:
        return goal(0.0, 0.0, 0.2 if t_s < 20.0 else 0.6, 0.0)

    ground = dive(VEHICLES["lbv150"], lambda _: -2.0, below, 30.0, start_m=2.05, bottom_m=2.05)
    assert ground.lift_n.max() < 0.1
    assert abs(ground.depth_m[-1] - 1.5) < 0.05
    floating = dive(VEHICLES["lbv150"], lambda _: 2.0, above, 30.0, start_m=0.1, top_m=0.1)
    assert floating.lift_n.min() > -0.1
    assert abs(floating.depth_m[-1] - 0.6) < 0.05


def test_too_heavy_for_its_thrusters_is_said_and_no_thrust_is_kept_back() -> None:
    sinking = dive(VEHICLES["lbv150"], lambda _: -14.0, station, 12.0, bottom_m=2.3)
    assert "Too heavy for its thrusters: trim the vehicle" in sinking.texts()
    assert sinking.thrust_n[-1, 2] == pytest.approx(-12.0, abs=1.5)
    heavy = dive(VEHICLES["lbv150"], lambda _: -3.5, station, 18.0)
    assert heavy.texts() == ["Heavier than its file by 3.5 N: trim it"]
    assert dive(VEHICLES["lbv150"], lambda _: 0.5, station, 18.0).texts() == []


def test_a_new_flight_begins_with_nothing_learned() -> None:
    held = dive(VEHICLES["lbv150"], lambda _: -4.0, station, 8.0)
    assert held.lift_n[-1] < -3.0
    held.controller.reset()
    again = dive(VEHICLES["lbv150"], lambda _: 0.0, station, 6.0, controller=held.controller)
    assert abs(again.lift_n[1]) < 0.5
    assert np.abs(again.depth_m - 1.0).max() < 0.03


def test_station_keeping_counts_on_what_was_learned() -> None:
    held = dive(VEHICLES["lbv150"], lambda _: -5.0, station, 30.0, failing_s=8.0)
    assert Fallback.STATION_KEEPING in held.fallbacks
    assert np.abs(held.depth_m[300:] - 1.0).max() < 0.12


@pytest.mark.parametrize(
    ("name", "lost", "left", "push_n"), [("bluerov2", 5, 0.0, -3.5), ("lbv150", 2, 0.5, 3.5)], ids=["dead", "half"]
)
def test_what_is_learned_hides_no_lost_thruster(name: str, lost: int, left: float, push_n: float) -> None:
    """Nor does the force look like a lost thruster."""
    vehicle, at_s = VEHICLES[name], 14.0
    health = ThrusterHealth(vehicle.to_model(), Response.of(vehicle.thrusters), tilt=tilt_of(vehicle))
    rng, first = np.random.default_rng(7), []

    def up_and_down(t_s: float) -> Goal:
        return goal(0.0, 0.0, 0.7 if t_s % 8.0 < 4.0 else 1.5, 0.0)

    def gives(t_s: float) -> FloatArray:
        share = np.ones(len(vehicle.thrusters))
        share[lost] = left if t_s >= at_s else 1.0
        return share

    def look(nav: NavState, thrust_n: FloatArray) -> None:
        if health.step(nav.t_us, nav, thrust_n) and not first:
            first.append(nav.t_us * 1e-6)

    dive(vehicle, lambda _: push_n, up_and_down, 40.0, share=gives, look=look, noise=rng)
    assert first
    assert at_s < first[0] < at_s + 25.0
    assert health.faulty == tuple(i == lost for i in range(len(vehicle.thrusters)))


@pytest.mark.parametrize("backend", [ocp.HPIPM, ocp.PIQP], ids=lambda backend: backend.plugin)
def test_every_solver_counts_on_it(backend: ocp.QpBackend) -> None:
    made = MotionController(VEHICLES["lbv150"], cpu_clock=lambda: 0.0, backends=(backend,))
    held = dive(VEHICLES["lbv150"], lambda _: -5.0, station, 7.0, controller=made)
    assert abs(held.depth_m[-1] - 1.0) < 0.03
