"""One interval of a trajectory: the compiled functions, CasADi's own evaluation and the model agree."""

import math

import casadi as ca
import numpy as np
import pytest
from vehicles import drawn

from autopilot.control.energy import interval
from autopilot.control.energy.interval import FORCE, LENGTH, VARIABLES, Interval
from autopilot.control.energy.power import PowerModel
from autopilot.control.energy.shooting import ROWS, Shooting
from autopilot.control.nmpc.model_code import coefficients
from autopilot.core import compiled, model4
from autopilot.core.frames import FloatArray
from autopilot.core.model4 import NX

SAME = 1e-9
"""Compiled and interpreted may differ by the order of rounding."""


def functions(count: int, monkeypatch: pytest.MonkeyPatch, switch: str) -> Interval:
    with monkeypatch.context() as patch:
        patch.setenv(compiled.SWITCH, switch)
        return interval.steps(count)


def known(rng: np.random.Generator, thrusters: int) -> tuple[model4.Model4, list[FloatArray]]:
    model = drawn(rng, thrusters).to_model()
    q = np.concatenate([rng.normal(0.0, 0.4, NX), rng.normal(0.0, 2.0, 4), [rng.uniform(0.05, 0.2)]])
    water = [rng.normal(0.0, 0.2, 3), rng.normal(0.0, 0.1, 4), rng.normal(0.0, 1.0, 2)]
    return model, [q, *water, np.array(coefficients(model))]


@pytest.mark.parametrize("count", [1, 2])
def test_an_interval_is_the_model_integrated(count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    rng, found = np.random.default_rng(5), functions(count, monkeypatch, "yes")
    for thrusters in (4, 6, 8):
        model, arguments = known(rng, thrusters)
        q = arguments[0]
        hull = model4.Model4(
            mass_kg=model.mass_kg,
            linear_drag=model.linear_drag,
            quadratic_drag=model.quadratic_drag,
            buoyancy_excess_n=model.buoyancy_excess_n,
            allocation=tuple(tuple(float(i == j) for j in range(4)) for i in range(4)),
        )

        def slope(x: FloatArray, hull: model4.Model4 = hull, arguments: list[FloatArray] = arguments) -> FloatArray:
            _, current, gradient, place, _ = arguments
            water = current + np.append(gradient.reshape(2, 2) @ (x[:2] - place), 0.0)
            force = arguments[0][FORCE:LENGTH]
            return np.array(model4.state_derivative(hull, x.tolist(), force.tolist(), water.tolist(), math))

        x = q[:NX]
        for _ in range(count):
            x = model4.rk4(slope, x, q[LENGTH])
        assert np.allclose(found.moved(*arguments).full().ravel(), x, atol=1e-9)


@pytest.mark.parametrize("count", [1, 2])
def test_derivatives_of_an_interval_are_those_of_its_motion(count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Against differences: of the motion for the slopes, of the slopes for the second derivative."""
    rng, found = np.random.default_rng(6), functions(count, monkeypatch, "yes")
    for _ in range(5):
        _, (q, *rest) = known(rng, 4)
        weights, h = rng.normal(size=NX), 1e-5
        slopes, curved = np.empty((NX, VARIABLES)), np.empty((VARIABLES, VARIABLES))
        for i in range(VARIABLES):
            aside = h * np.eye(VARIABLES)[i]
            ahead, behind = found.moved(q + aside, *rest).full(), found.moved(q - aside, *rest).full()
            slopes[:, i] = (ahead - behind).ravel() / (2.0 * h)
            ahead, behind = (found.slopes(q + side, *rest).full() for side in (aside, -aside))
            curved[i] = (weights @ (ahead - behind)) / (2.0 * h)
        assert np.allclose(found.slopes(q, *rest).full(), slopes, atol=1e-5, rtol=1e-5)
        assert np.allclose(found.curved(q, *rest, weights).full(), curved, atol=1e-4, rtol=1e-4)


@pytest.mark.parametrize("count", [1, 2])
def test_compiled_or_not_an_interval_is_the_same(count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(7)
    fast, slow = functions(count, monkeypatch, "yes"), functions(count, monkeypatch, compiled.OFF)
    for thrusters in (4, 5, 6, 7, 8):
        _, arguments = known(rng, thrusters)
        weights = rng.normal(size=NX)
        for one, other, more in (
            (fast.moved, slow.moved, []),
            (fast.slopes, slow.slopes, []),
            (fast.curved, slow.curved, [weights]),
        ):
            a, b = one(*arguments, *more).full(), other(*arguments, *more).full()
            assert np.allclose(a, b, rtol=SAME, atol=SAME * max(1.0, float(np.abs(b).max())))


@pytest.mark.parametrize(("thrusters", "substeps"), [(4, 1), (6, 2), (8, 1)])
def test_sparse_derivatives_of_a_program_are_those_of_its_values(thrusters: int, substeps: int) -> None:
    """Of a short trajectory, against differences: what every thruster does comes through its column."""
    rng, n = np.random.default_rng(thrusters), 3
    vehicle = drawn(rng, thrusters)
    shooting = Shooting(vehicle.to_model(), PowerModel.of(vehicle), n, substeps)
    program, derivatives = shooting.program, shooting.derivatives
    values = ca.Function("values", [program["x"], program["p"]], [program["f"], program["g"]])
    z = rng.normal(0.0, 0.3, program["x"].shape[0])
    # Beside zero, where the curvature is raised on purpose, it is that of the power.
    thrusts = np.flatnonzero(np.arange(len(z) - 1) % (NX + thrusters) < thrusters)
    z[thrusts] = rng.uniform(20.0, 30.0, len(thrusts)) * rng.choice([-1.0, 1.0], len(thrusts))
    z[-1] = 1.5
    p = rng.normal(0.0, 0.3, program["p"].shape[0])
    weights, of_cost, h = rng.normal(size=ROWS * n + 3), 1.7, 1e-5

    def slopes(at: FloatArray) -> FloatArray:
        """Of the Lagrangian."""
        gradient = derivatives["grad_f"](at, p)[1].full().ravel()
        result: FloatArray = of_cost * gradient + weights @ derivatives["jac_g"](at, p)[1].full()
        return result

    by_differences, second = np.empty((len(z),)), np.empty((len(z), len(z)))
    for i in range(len(z)):
        aside = h * np.eye(len(z))[i]
        (f1, g1), (f0, g0) = ([v.full().ravel() for v in values(z + side, p)] for side in (aside, -aside))
        by_differences[i] = (of_cost * (f1 - f0) + weights @ (g1 - g0)).item() / (2.0 * h)
        second[i] = (slopes(z + aside) - slopes(z - aside)) / (2.0 * h)
    assert np.allclose(slopes(z), by_differences, rtol=1e-5, atol=1e-5)
    hessian = derivatives["hess_lag"](z, p, of_cost, weights).full()
    assert np.allclose(hessian, np.triu(second), rtol=1e-4, atol=2e-3)
