"""The prediction: the same equations on floats and on CasADi, the order of RK4, its Jacobians, the time grids."""

import math

import casadi as ca
import numpy as np
import pytest
from control_loop import MODEL, rk4, still
from hypothesis import given, settings
from hypothesis import strategies as st

from autopilot.control.nmpc import ocp
from autopilot.control.nmpc.grid import MAX_RK4_STEP_S, geometric_grid, shift_matrices, uniform_grid
from autopilot.core import model4
from autopilot.core.control_allocator import ControlAllocator

state = st.tuples(
    *[st.floats(-3, 3)] * 3, st.floats(-7, 7), st.floats(-0.6, 0.6), st.floats(-0.6, 0.6), st.floats(-0.3, 0.3),
    st.floats(-1.2, 1.2),
)  # fmt: skip
thrust = st.tuples(*[st.floats(-12, 12)] * 4)
current = st.tuples(*[st.floats(-0.4, 0.4)] * 3)


def _symbolic_derivative() -> ca.Function:
    x, u, c = ca.SX.sym("x", 8), ca.SX.sym("u", 4), ca.SX.sym("c", 3)
    dx = model4.state_derivative(MODEL, ca.vertsplit(x), ca.vertsplit(u), ca.vertsplit(c), ca)
    return ca.Function("f", [x, u, c], [ca.vertcat(*dx)])


DERIVATIVE = _symbolic_derivative()
INTERVAL = ocp.discrete_dynamics(MODEL, 0.1, 1)


@given(state, thrust, current)
@settings(max_examples=60, deadline=None)
def test_casadi_and_floats_agree(x, u, c) -> None:
    assert np.allclose(
        DERIVATIVE(x, u, c).full().ravel(), model4.state_derivative(MODEL, x, u, c, math), rtol=1e-12, atol=1e-12
    )


@given(state, thrust, current)
@settings(max_examples=30, deadline=None)
def test_prediction_is_rk4_with_exact_jacobians(x, u, c) -> None:
    after, a, b = (v.full() for v in INTERVAL(x, u, c))
    flow = np.array(c)
    assert np.allclose(after.ravel(), rk4(MODEL, np.array(x), np.array(u), lambda _: flow, 0.1), atol=1e-12)
    e = 1e-6
    for i in range(12):
        d = np.zeros(12)
        d[i] = e
        ahead = INTERVAL(np.array(x) + d[:8], np.array(u) + d[8:], c)[0].full()
        behind = INTERVAL(np.array(x) - d[:8], np.array(u) - d[8:], c)[0].full()
        assert np.allclose(np.hstack([a, b])[:, i], (ahead - behind).ravel() / (2.0 * e), atol=1e-5)


def test_order_of_the_integrator_is_four() -> None:
    x = np.array([0.0, 0.0, 0.5, 0.3, 0.3, 0.1, 0.05, 0.4])
    u = np.array([5.0, 3.0, 1.0, 2.0])
    exact = x
    for _ in range(2000):
        exact = rk4(MODEL, exact, u, still, 0.4 / 2000)
    errors = []
    for n in (1, 2, 4):
        after = ocp.discrete_dynamics(MODEL, 0.4, n)(x, u, [0, 0, 0])[0].full().ravel()
        errors.append(np.abs(after - exact).max())
    orders = [math.log2(errors[i] / errors[i + 1]) for i in range(2)]
    assert all(3.4 < order < 5.0 for order in orders), orders


def test_substeps_chain_their_jacobians() -> None:
    x, u, c = [0.1, 0.2, 0.5, 0.4, 0.3, 0.1, 0.0, 0.3], [4.0, 3.0, 0.5, 1.0], [0.1, 0.0, 0.0]
    _, a, b = (v.full() for v in ocp.discrete_dynamics(MODEL, 0.2, 2)(x, u, c))
    first = [v.full() for v in INTERVAL(x, u, c)]
    second = [v.full() for v in INTERVAL(first[0], u, c)]
    assert np.allclose(a, second[1] @ first[1], atol=1e-12)
    assert np.allclose(b, second[1] @ first[2] + second[2], atol=1e-12)


def test_steady_thrust_holds_the_velocity() -> None:
    nu = [0.3, -0.1, 0.05, 0.4]
    tau = ControlAllocator(MODEL).hold_n(np.array([nu]), np.full(4, np.inf))[0]
    assert np.allclose(model4.body_acceleration(MODEL, nu, tau.tolist(), math), 0.0, atol=1e-9)


@given(st.integers(5, 60), st.floats(2.0, 20.0))
@settings(max_examples=40, deadline=None)
def test_geometric_grid(n: int, horizon_s: float) -> None:
    grid = geometric_grid(n, horizon_s)
    assert grid.n == n
    assert grid.t_s[-1] == pytest.approx(horizon_s)
    ratio = grid.dt_s[1:] / grid.dt_s[:-1]
    assert np.allclose(ratio, ratio[0])
    assert ratio[0] >= 1.0 - 1e-9
    assert all(dt / k <= MAX_RK4_STEP_S + 1e-9 for dt, k in zip(grid.dt_s, grid.substeps(), strict=True))


@pytest.mark.parametrize("grid", [geometric_grid(20, 8.0), uniform_grid(10)])
@pytest.mark.parametrize("delta_s", [0.0, 0.05, 0.13])
def test_shift_moves_a_plan_in_time(grid, delta_s: float) -> None:
    states, inputs = shift_matrices(grid, delta_s)
    line = np.stack([0.3 * grid.t_s, 1.0 - 0.1 * grid.t_s], axis=1)
    assert np.allclose(states @ line, np.stack([0.3 * (grid.t_s + delta_s), 1.0 - 0.1 * (grid.t_s + delta_s)], axis=1))
    assert np.allclose(inputs.sum(axis=1), 1.0)
    assert (inputs >= 0.0).all()
    if delta_s == 0.0:
        assert np.allclose(inputs, np.eye(grid.n))
    step = np.zeros(grid.n)
    step[3:] = 1.0
    moved = inputs @ step
    impulse_before = (1.0 - step) @ grid.dt_s
    assert (1.0 - moved) @ grid.dt_s == pytest.approx(impulse_before - delta_s)
