"""Forces to thrust for any thrusters: what is wanted is made, with least energy, within bounds, in any order."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

sys.path.insert(0, str(Path(__file__).parents[1] / "control"))

from vehicles import BLUEROV2_HULL, LBV150, vectored, vehicle_with

from autopilot.core.control_allocator import ControlAllocator, lacking_thrust
from autopilot.core.frames import FloatArray
from autopilot.core.model4 import Model4

MODEL = LBV150.to_model()
LIMIT_N = np.full(4, 12.0)
WANTED = np.array([8.0, -5.0, 3.0, 0.6])


def with_columns(allocation: FloatArray) -> Model4:
    return replace(MODEL, allocation=tuple(map(tuple, allocation.tolist())))


def made(seed: int) -> tuple[Model4, np.random.Generator]:
    """Thrusters that push along every axis, somehow."""
    rng = np.random.default_rng(seed)
    while True:
        columns = rng.normal(size=(4, int(rng.integers(4, 9)))) * np.array([[1.0], [1.0], [1.0], [0.15]])
        if np.linalg.cond(columns) < 100.0:
            return with_columns(columns), rng


@settings(max_examples=40)
@given(st.integers(0, 10_000))
def test_a_force_within_reach_is_made_with_least_energy(seed: int) -> None:
    model, rng = made(seed)
    watts = rng.uniform(0.5, 2.0, model.thrusters)
    t, allocator = np.array(model.allocation), ControlAllocator(model, watts.tolist())
    force = rng.normal(size=4) * [5.0, 5.0, 5.0, 1.0]
    thrust = allocator.thrust_n(force, np.full(model.thrusters, np.inf))
    assert np.allclose(t @ thrust, force, atol=1e-9)
    # Any other way of making it differs by what makes no force, and costs more.
    idle = np.linalg.svd(t)[2][4:]
    for other in idle:
        for step in (0.1, -0.1):
            assert (watts * (thrust + step * other) ** 2).sum() > (watts * thrust**2).sum()


@settings(max_examples=40)
@given(st.integers(0, 10_000))
def test_bounds_are_hard_and_what_is_out_of_reach_comes_nearest(seed: int) -> None:
    model, rng = made(seed)
    n, allocator = model.thrusters, ControlAllocator(model)
    # Weak ones, and now and then one that is lost.
    limit = rng.uniform(0.0, 6.0, n) * (rng.uniform(size=n) > 0.15)
    force = rng.normal(size=4) * [10.0, 10.0, 10.0, 2.0]
    thrust = allocator.thrust_n(force, limit)
    assert (np.abs(thrust) <= limit).all()
    t = np.array(model.allocation)
    root = np.linalg.cholesky(np.linalg.inv(t @ t.T)).T
    wishes, wished = np.vstack([np.eye(n), 1e3 * root @ t]), np.append(np.zeros(n), 1e3 * root @ force)
    best = lsq_linear(wishes, wished, (-limit - 1e-12, limit + 1e-12)).x
    missed, least = (float(np.linalg.norm(root @ (t @ f - force))) for f in (thrust, best))
    assert missed <= least + 1e-3
    if missed < 1e-6:
        assert (thrust**2).sum() <= (best**2).sum() + 1e-3


@settings(max_examples=40)
@given(st.integers(0, 10_000))
def test_the_order_of_thrusters_does_not_matter(seed: int) -> None:
    model, rng = made(seed)
    order = rng.permutation(model.thrusters)
    other = with_columns(np.array(model.allocation)[:, order])
    limit, force = rng.uniform(0.0, 6.0, model.thrusters), rng.normal(size=4) * [10.0, 10.0, 10.0, 2.0]
    for bound in (limit, np.full(model.thrusters, np.inf)):
        plain, mixed = (
            ControlAllocator(model).thrust_n(force, bound),
            ControlAllocator(other).thrust_n(force, bound[order]),
        )
        assert np.allclose(plain[order], mixed, atol=1e-4)


def test_as_many_thrusters_as_axes_have_one_answer_each_cut_at_its_bound() -> None:
    thrust = ControlAllocator(MODEL).thrust_n(np.array([WANTED, 4.0 * WANTED]), LIMIT_N)
    exact = np.linalg.solve(np.array(MODEL.allocation), WANTED)
    assert np.allclose(thrust, [exact, np.clip(4.0 * exact, -12.0, 12.0)], atol=1e-12)


def test_a_lost_thruster_is_made_up_for() -> None:
    model = with_columns(vectored(4))
    allocator, limit = ControlAllocator(model), np.array([12.0, 0.0, 12.0, 12.0, 12.0, 12.0, 0.0, 12.0])
    thrust = allocator.thrust_n(WANTED, limit)
    assert thrust[1] == thrust[6] == 0.0 and np.allclose(np.array(model.allocation) @ thrust, WANTED)


def test_reach_is_what_one_axis_gives_with_no_other() -> None:
    assert ControlAllocator(MODEL).reach(LIMIT_N) == pytest.approx([24.0, 12.0, 12.0, 2.88], rel=3e-3)
    half = np.array([6.0, 12.0, 12.0, 12.0])
    # Twice the weaker of the pair: more would turn the vehicle.
    assert ControlAllocator(MODEL).reach(half)[0] == pytest.approx(12.0, rel=3e-3)


@pytest.mark.parametrize(
    ("drop", "says"),
    [
        ([], ""),
        ([3], "no thrust in sway: no thruster pushes that way"),
        ([2], "no thrust in heave"),
        ([0, 1], "no thrust in surge and yaw"),
        ([1], "no thrust in yaw alone: it comes only with surge; turn a thruster or add one"),
    ],
)
def test_the_axis_that_lacks_thrust_is_named(drop: list[int], says: str) -> None:
    columns = np.delete(np.array(MODEL.allocation), drop, axis=1)
    found = lacking_thrust(with_columns(columns), np.full(columns.shape[1], 12.0))
    assert found.startswith(says) and bool(found) == bool(says)


def test_too_little_thrust_is_named_with_what_it_needs() -> None:
    weak = np.array([12.0, 12.0, 0.5, 12.0])
    assert lacking_thrust(MODEL, weak).startswith("too little thrust in heave: 0.50 N alone, needs 1.")
    assert lacking_thrust(vehicle_with(vectored(2), **BLUEROV2_HULL).to_model(), np.full(6, 12.0)) == ""
