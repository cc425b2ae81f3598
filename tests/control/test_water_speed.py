"""Drag and thrust told apart from the current: only where the water is uniform, and forgotten when anything jumps."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from control_loop import goal
from hypothesis import given, settings
from hypothesis import strategies as st

from autopilot.control.controller import MotionController
from autopilot.control.nmpc.grid import geometric_grid
from autopilot.control.robust.margins import AT_REST, Margins
from autopilot.control.robust.robust_tuning import WATER_SPEED
from autopilot.control.robust.water_speed import WaterSpeed
from autopilot.core.frames import FloatArray
from autopilot.core.geometry import Fence
from autopilot.core.messages import NavHealth, NavState
from autopilot.core.model4 import Model4
from autopilot.core.params import ParamSet
from autopilot.core.vehicle import load_vehicle

MODEL = load_vehicle("lbv150").to_model()
STEP_S, NOISE_M_S = 0.05, 0.006
LIMIT_M_S = ParamSet()["SPD_PLANAR_MAX"]

Water = Callable[[float, float], tuple[float, float]]
"""Current north, east at a place."""


def uniform(north: float, east: float) -> Water:
    return lambda x, y: (north, east)


def shear(x: float, y: float) -> tuple[float, float]:
    return 0.3 * math.sin(0.8 * x), 0.2 * math.cos(0.7 * y)


class Sailing:
    """A vehicle whose drag is ``factor`` times the file's, driven at a pattern of speeds, and its estimate.

    As that of the estimator, the estimated velocity through the water is that of the file's model.
    """

    def __init__(self, water: Water, factor: float, seed: int = 1, model: Model4 = MODEL) -> None:
        self.water, self.factor, self.model = water, factor, model
        self.rng = np.random.default_rng(seed)
        self.place, self.true, self.believed = np.zeros(2), np.array([0.2, 0.0]), np.array([0.2, 0.0])
        self.t_us, self.yaw = 1_000_000, 0.0

    def drag_n(self, velocity: FloatArray) -> FloatArray:
        linear, square = (np.array(each[:2]) for each in (self.model.linear_drag, self.model.quadratic_drag))
        return (linear + square * np.abs(velocity)) * velocity

    def step(self, aim: FloatArray, yaw: float) -> tuple[NavState, FloatArray]:
        """The estimate and thrust (n,) after a step towards a velocity through the water (2,), body frame."""
        mass = np.array(self.model.mass_kg[:2])
        thrust = np.zeros(self.model.thrusters)
        force = self.drag_n(aim) + 4.0 * (aim - self.believed)
        thrust[:] = np.linalg.pinv(np.array(self.model.allocation)[:2]) @ force
        self.yaw = yaw
        c, s = math.cos(yaw), math.sin(yaw)
        turn = np.array([[c, -s], [s, c]])
        for _ in range(5):
            self.true = self.true + 0.2 * STEP_S * (force - self.factor * self.drag_n(self.true)) / mass
            self.believed = self.believed + 0.2 * STEP_S * (force - self.drag_n(self.believed)) / mass
            ground = turn @ self.true + np.array(self.water(*self.place.tolist()))
            self.place = self.place + 0.2 * STEP_S * ground
        self.t_us += round(1e6 * STEP_S)
        seen = turn.T @ ground + NOISE_M_S * self.rng.normal(size=2)
        nav = replace(
            AT_REST,
            t_us=self.t_us,
            rpy_rad=np.array([0.0, 0.0, yaw]),
            vel_frd_m_s=np.array([*seen, 0.0]),
            vel_water_frd_m_s=np.array([*self.believed, 0.0]),
        )
        return nav, thrust


def pattern(t_s: float) -> tuple[FloatArray, float]:
    """Speeds through the water and headings of a flight with three legs."""
    speed = 0.4 if t_s % 20.0 > 4.0 else 0.25
    return np.array([speed, 0.05 * math.sin(0.3 * t_s)]), 0.6 * math.floor(t_s / 20.0)


def fly(sailing: Sailing, water_speed: WaterSpeed, seconds: float) -> list[tuple[float | None, float]]:
    """Bound and true ratio of the speeds of every step."""
    found = []
    for k in range(round(seconds / STEP_S)):
        nav, thrust = sailing.step(*pattern(k * STEP_S))
        water_speed.push(thrust, STEP_S)
        water_speed.update(nav)
        found.append((water_speed.bound, math.hypot(*sailing.true) / math.hypot(*sailing.believed)))
    return found


@pytest.mark.parametrize("factor", [0.7, 1.0, 1.35])
def test_the_drag_is_found_in_a_uniform_stream(factor: float) -> None:
    water_speed = WaterSpeed(MODEL)
    found = fly(Sailing(uniform(-0.2, 0.1), factor), water_speed, 45.0)
    assert abs(water_speed.excess - math.log(factor)) < 3.0 * water_speed.excess_sigma
    assert water_speed.excess_sigma < 0.05
    assert water_speed.bound is not None
    assert water_speed.bound < found[-1][1] + 0.1


@settings(max_examples=15, deadline=None)
@given(
    factor=st.floats(0.65, 1.45),
    speed=st.floats(0.0, 0.35),
    to=st.floats(-math.pi, math.pi),
    seed=st.integers(0, 1_000),
)
def test_the_true_speed_stays_below_the_bound(factor: float, speed: float, to: float, seed: int) -> None:
    sailing = Sailing(uniform(speed * math.cos(to), speed * math.sin(to)), factor, seed)
    for bound, ratio in fly(sailing, WaterSpeed(MODEL), 25.0):
        if bound is not None:
            assert ratio * (LIMIT_M_S - WATER_SPEED.floor_m_s) < bound * LIMIT_M_S


@settings(max_examples=8, deadline=None)
@given(factor=st.floats(0.65, 1.45), seed=st.integers(0, 1_000))
def test_nothing_is_known_where_the_current_changes_along_the_way(factor: float, seed: int) -> None:
    found = fly(Sailing(shear, factor, seed), WaterSpeed(MODEL), 30.0)
    assert all(bound is None for bound, _ in found)


def test_a_stream_that_begins_to_change_ends_what_is_known() -> None:
    sailing, water_speed = Sailing(uniform(-0.2, 0.0), 1.2), WaterSpeed(MODEL)
    fly(sailing, water_speed, 30.0)
    assert water_speed.bound is not None
    start = sailing.place.copy()
    sailing.water = lambda x, y: (-0.2 + 0.25 * math.sin(1.5 * (x - start[0])), 0.2 * math.sin(y - start[1]))
    found = fly(sailing, water_speed, 25.0)
    assert found[-1][0] is None


@pytest.mark.parametrize("what", ["jump", "lost", "pause", "not finite"])
def test_all_is_forgotten_at(what: str) -> None:
    sailing, water_speed = Sailing(uniform(-0.2, 0.0), 1.3), WaterSpeed(MODEL)
    fly(sailing, water_speed, 30.0)
    assert water_speed.bound is not None
    nav, thrust = sailing.step(*pattern(0.0))
    changed = {
        "jump": replace(nav, reset_count=1),
        "lost": replace(nav, health=NavHealth.DEAD_RECKONING),
        "pause": replace(nav, t_us=nav.t_us + 2_000_000),
        "not finite": replace(nav, vel_frd_m_s=np.full(3, math.nan)),
    }[what]
    water_speed.push(thrust, STEP_S)
    water_speed.update(changed)
    assert water_speed.bound is None
    assert (water_speed.excess, water_speed.excess_sigma) == (0.0, WATER_SPEED.excess_sigma)


@pytest.mark.parametrize(("pitch_rad", "known"), [(0.0, True), (0.05, True), (0.25, False), (-0.25, False)])
def test_nothing_is_known_of_a_vehicle_that_dives_aslant(pitch_rad: float, known: bool) -> None:
    """Its heave is horizontal speed in part: 0.04 m/s beyond the limit in a room of `campaign rooms`."""
    controller, water_speed = MotionController(load_vehicle("lbv150"), cpu_clock=lambda: 0.0), WaterSpeed(MODEL)
    controller.margins.water_speed = water_speed
    water_speed.update = lambda _: None  # type: ignore[method-assign]
    water_speed.bound = water_speed.likely = 0.9
    velocity = np.array([0.3, 0.0, 0.2])
    nav = replace(
        AT_REST, t_us=50_000, rpy_rad=np.array([0.0, pitch_rad, 0.0]), vel_frd_m_s=velocity, vel_water_frd_m_s=velocity
    )
    controller.step(
        nav.t_us, nav, goal(5.0, 0.0, 1.0, None, speed_m_s=0.3), Fence(depth_max_m=5.0), ParamSet({"MPC_COST": 0})
    )
    assert (water_speed.bound is not None) is known


@pytest.mark.parametrize(("bound", "likely", "below"), [(1.03, 1.0, True), (0.9, 0.85, True), (1.25, 1.2, False)])
def test_the_margin_moves_to_what_is_known_and_back(bound: float, likely: float, below: bool) -> None:
    margins, params = Margins(MODEL, geometric_grid()), ParamSet()
    least_m_s, nav = params["MPC_SPEED_MARGIN"], replace(AT_REST, t_us=1_000_000)
    moved: list[float] = []

    def step(k: int) -> None:
        margins.water_speed.update = lambda _: None  # type: ignore[method-assign]
        margins.update(replace(nav, t_us=nav.t_us + 50_000 * k), params)
        moved.append(least_m_s if margins.speed_margin_m_s is None else margins.speed_margin_m_s)

    margins.update(nav, params)
    assert margins.speed_margin_m_s is None
    margins.water_speed.bound, margins.water_speed.likely = bound, likely
    for k in range(1, 400):
        step(k)
    left_m_s = LIMIT_M_S - WATER_SPEED.floor_m_s
    known_m_s = LIMIT_M_S - left_m_s / (bound if below else likely)
    assert moved[-1] == pytest.approx(known_m_s, abs=1e-9)
    assert (moved[-1] < least_m_s) is below
    margins.water_speed.bound = margins.water_speed.likely = None
    for k in range(400, 500):
        step(k)
    assert margins.speed_margin_m_s is None
    assert np.abs(np.diff(moved)).max() <= WATER_SPEED.grow_m_s2 * STEP_S + 1e-9 or moved[0] != moved[1]


def test_little_knowledge_makes_the_vehicle_no_slower() -> None:
    margins, params = Margins(MODEL, geometric_grid()), ParamSet()
    margins.update(replace(AT_REST, t_us=1_000_000), params)
    margins.water_speed.bound, margins.water_speed.likely = 1.3, 1.05
    margins.water_speed.update = lambda _: None  # type: ignore[method-assign]
    for k in range(1, 200):
        margins.update(replace(AT_REST, t_us=1_000_000 + 50_000 * k), params)
    assert margins.speed_margin_m_s == pytest.approx(params["MPC_SPEED_MARGIN"], abs=0.03)
