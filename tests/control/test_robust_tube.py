"""The mathematics of the margins: Riccati, feedback, tube, Lipschitz growth."""

import math

import numpy as np
import pytest
import scipy.linalg
from control_loop import MODEL, nav_state, rk4
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles import variances_along

from autopilot.control.nmpc.grid import geometric_grid, uniform_grid
from autopilot.control.robust.ancillary import Ancillary
from autopilot.control.robust.disturbance import DisturbanceBound, EstimateSpread, channel_variances
from autopilot.control.robust.error_model import (
    CHANNELS,
    disturbance_matrix,
    error_jacobian,
    error_of,
    input_matrix,
    velocity_jacobian,
)
from autopilot.control.robust.inner import InnerLoop, plan_error
from autopilot.control.robust.lipschitz import TUNED_SCALES, UNIT_SCALES, lipschitz_report
from autopilot.control.robust.margins import Margins
from autopilot.control.robust.riccati import dare, discretise, exponential, gain, lyapunov
from autopilot.control.robust.robust_tuning import ANCILLARY, DISTURBANCE, TUBE
from autopilot.core import model4
from autopilot.core.frames import FloatArray
from autopilot.core.messages import NavState
from autopilot.core.params import ParamSet

GRID = geometric_grid()
MARGINS = Margins(MODEL, GRID)
speeds = st.floats(-0.5, 0.5)


def nav_with(sigmas: FloatArray | None = None) -> NavState:
    """An estimate with these standard deviations (12,)."""
    nav = nav_state(0, np.zeros(8))
    if sigmas is not None:
        nav.variance[:] = sigmas**2
    return nav


def cruise(surge_m_s: float) -> tuple[FloatArray, FloatArray]:
    x = np.zeros((GRID.n + 1, 8))
    x[:, 4] = surge_m_s
    return x, np.zeros((GRID.n, 4))


@given(st.integers(0, 10_000))
@settings(max_examples=40, deadline=None)
def test_riccati_solves_its_equation_and_agrees_with_scipy(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, b = rng.normal(size=(6, 6)) * 0.6, rng.normal(size=(6, 3))
    q, r = np.diag(rng.uniform(0.1, 10.0, 6)), np.diag(rng.uniform(0.1, 2.0, 3))
    p = dare(a, b, q, r)
    k = gain(a, b, p, r)
    closed = a + b @ k
    residual = closed.T @ p @ closed + q + k.T @ r @ k - p
    assert np.abs(residual).max() < 1e-9 * np.abs(p).max()
    assert np.abs(p - scipy.linalg.solve_discrete_are(a, b, q, r)).max() < 1e-7 * np.abs(p).max()
    assert np.abs(np.linalg.eigvals(closed)).max() < 1.0
    s = lyapunov(closed, q)
    assert np.abs(closed @ s @ closed.T + q - s).max() < 1e-9 * np.abs(s).max()


@given(st.integers(0, 10_000), st.floats(0.001, 3.0))
@settings(max_examples=30, deadline=None)
def test_exponential_and_zero_order_hold(seed: int, h_s: float) -> None:
    rng = np.random.default_rng(seed)
    a, b = rng.normal(size=(5, 5)), rng.normal(size=(5, 2))
    assert np.allclose(exponential(a * h_s), scipy.linalg.expm(a * h_s), rtol=1e-9, atol=1e-9)
    a_d, b_d = discretise(a, b, h_s)
    wanted = scipy.linalg.expm(np.block([[a, b], [np.zeros((2, 7))]]) * h_s)
    assert np.allclose(np.hstack([a_d, b_d]), wanted[:5], rtol=1e-9, atol=1e-9)


@given(speeds, speeds, speeds, st.floats(-1.0, 1.0))
@settings(max_examples=50, deadline=None)
def test_velocity_jacobian_is_that_of_the_model(u: float, v: float, w: float, r: float) -> None:
    nu, h = np.array([u, v, w, r]), 1e-6
    wanted = np.empty((4, 4))
    for i in range(4):
        step = np.zeros(4)
        step[i] = h
        ahead = model4.body_acceleration(MODEL, (nu + step).tolist(), [0.0] * 4, math)
        behind = model4.body_acceleration(MODEL, (nu - step).tolist(), [0.0] * 4, math)
        wanted[:, i] = (np.array(ahead) - np.array(behind)) / (2.0 * h)
    assert np.allclose(velocity_jacobian(MODEL, nu), wanted, atol=1e-4)


@given(speeds, speeds, st.floats(-1.0, 1.0), st.floats(-3.0, 3.0), st.integers(0, 1000))
@settings(max_examples=30, deadline=None)
def test_error_dynamics_are_those_of_two_neighbouring_vehicles(
    u: float, v: float, r: float, yaw: float, seed: int
) -> None:
    """Fly planned and real vehicle side by side with the same thrust: their error moves as the Jacobian says."""
    rng = np.random.default_rng(seed)
    z = np.array([1.0, 2.0, 0.5, yaw, u, v, 0.0, r])
    e0, h = rng.normal(size=8) * 1e-5, 0.01
    c, s = math.cos(yaw), math.sin(yaw)
    x = z + e0
    x[0], x[1] = z[0] + c * e0[0] - s * e0[1], z[1] + s * e0[0] + c * e0[1]
    assert np.allclose(error_of(x, z), e0, atol=1e-12)

    def water(_: FloatArray) -> FloatArray:
        return np.array([0.1, -0.2, 0.0])

    thrust = np.array([3.0, 2.0, -0.6, 1.0])
    e1 = error_of(rk4(MODEL, x, thrust, water, h), rk4(MODEL, z, thrust, water, h))
    predicted = exponential(error_jacobian(MODEL, z[4:]) * h) @ e0
    # The Jacobian drifts a little within the step as the planned velocity changes.
    assert np.abs(e1 - predicted).max() < 0.03 * np.abs(e0).max()


def test_munk_instability_and_its_cure() -> None:
    """Open loop the vehicle is unstable ahead from 0.2 m/s on; the scheduled gain is stable on the whole envelope."""
    ancillary = MARGINS.ancillary
    growth = [
        max(np.linalg.eigvals(error_jacobian(MODEL, np.array([u, 0.0, 0.0, 0.0]))[4:, 4:]).real)
        for u in (0.1, 0.2, 0.5)
    ]
    assert growth[0] < 0.1 and 0.1 < growth[1] < 0.3 and 1.0 < growth[2] < 1.5
    worst = -math.inf
    for u in np.linspace(-0.5, 0.5, 11):
        for v in (-0.35, 0.0, 0.35):
            for r in (-1.0, -0.5, 0.0, 0.5, 1.0):
                if math.hypot(u, v) <= 0.5:
                    closed = error_jacobian(MODEL, np.array([u, v, 0.0, r])) + input_matrix(MODEL) @ ancillary.gain(u)
                    worst = max(worst, float(np.linalg.eigvals(closed).real.max()))
    assert worst < -0.5


def test_gain_is_the_lqr_gain_at_the_points_of_the_table_and_continuous_between() -> None:
    ancillary = Ancillary(MODEL)
    a, b = discretise(error_jacobian(MODEL, np.array([0.4, 0.0, 0.0, 0.0])), input_matrix(MODEL), 0.02)
    p = scipy.linalg.solve_discrete_are(a, b, np.diag(ANCILLARY.state_weights), ANCILLARY.thrust_weight * np.eye(4))
    k = -np.linalg.solve(ANCILLARY.thrust_weight * np.eye(4) + b.T @ p @ b, b.T @ p @ a)
    assert np.allclose(ancillary.gain(0.4), k, atol=1e-6)
    for surge in np.linspace(-1.0, 1.0, 41):
        assert np.abs(ancillary.gain(surge + 1e-6) - ancillary.gain(surge)).max() < 1e-3


def test_tube_table_is_the_stationary_covariance() -> None:
    """At the horizon's end the tabulated growth has reached the Lyapunov solution."""
    rate = np.array([TUBE.force_correlation_s] * 4 + [TUBE.current_correlation_s] * 3)
    nu = np.array([0.4, 0.0, 0.0, 0.0])
    closed = error_jacobian(MODEL, nu) + input_matrix(MODEL) @ MARGINS.ancillary.gain(0.4)
    system = np.zeros((8 + CHANNELS, 8 + CHANNELS))
    system[:8, :8], system[:8, 8:], system[8:, 8:] = closed, disturbance_matrix(MODEL, nu), -np.diag(1.0 / rate)
    variances = np.array([0.04, 0.0004, 0.0009])
    noise = np.zeros_like(system)
    noise[8:, 8:] = np.diag(2.0 / rate * np.array([variances[0]] * 3 + [variances[1]] + [variances[2]] * 3))
    p = scipy.linalg.solve_continuous_lyapunov(system, -noise)
    row = variances_along(MARGINS.tube.table, np.full(GRID.n + 1, 0.4), variances)
    assert np.allclose(row[0], 0.0)
    wanted = np.array([p[0, 0], p[1, 1], p[2, 2], p[3, 3], p[4, 4], p[5, 5], p[6, 6], p[7, 7]])
    assert np.allclose(row[-1][[0, 2, 3, 4, 5, 7, 8, 9]], wanted, rtol=0.06)
    assert (np.diff(row[:, 0]) > -1e-3 * row[-1, 0]).all(), "the tube never shrinks along the prediction"


def test_margins_follow_estimate_and_bounds() -> None:
    x, thrust = cruise(0.35)
    low_floor = ParamSet({"MPC_SPEED_MARGIN": 0.02})
    perfect = MARGINS.back_offs(nav_with(), x, thrust, low_floor)
    sigmas = np.array([0.01, 0.01, 0.005, 0.01, 0.01, 0.01, 0.04, 0.04, 0.02, 0.05, 0.05, 0.02])
    worse = MARGINS.back_offs(nav_with(sigmas), x, thrust, low_floor)
    assert 0.015 < perfect.clearance_m[-1] < 0.035, "small with perfect knowledge"
    for name in ("clearance_m", "depth_m", "planar_speed_m_s", "heave_m_s"):
        assert (getattr(worse, name) > getattr(perfect, name)).all(), name
    assert worse.clearance_m[-1] > 1.5 * perfect.clearance_m[-1]
    assert worse.planar_speed_m_s[-1] > perfect.planar_speed_m_s[-1] + 0.03, "a worse estimate lowers the speed cap"
    rough = MARGINS.back_offs(nav_with(), x, thrust, ParamSet({"MPC_W_FORCE": 4.0}))
    assert rough.clearance_m[-1] > 2.0 * perfect.clearance_m[-1] and (rough.thrust_n[-1] > perfect.thrust_n[-1]).any()
    calm = MARGINS.back_offs(
        nav_with(), x, thrust, ParamSet({"MPC_W_FORCE": 0.0, "MPC_W_MOMENT": 0.0, "MPC_W_CURRENT": 0.0})
    )
    assert (calm.clearance_m == ParamSet()["MPC_MARGIN"]).all(), "the fixed margin is the floor"


@pytest.mark.parametrize("limit_m_s", [0.3, 0.5, 0.65, 0.9, 1.5])
@pytest.mark.parametrize("mode", [0, 1])
def test_the_speed_margin_grows_with_the_limit(mode: int, limit_m_s: float) -> None:
    """What unknown drag and thrust falsify is a share of the speed: 15 % and 20 % at once are 0.16."""
    x, thrust = cruise(0.3)
    params = ParamSet({"MPC_TIGHTEN": mode, "SPD_PLANAR_MAX": limit_m_s, "SPD_CRUISE": 0.2})
    back_off = MARGINS.back_offs(nav_with(), x, thrust, params)
    assert back_off.planar_speed_m_s.min() >= max(0.08, 0.16 * limit_m_s) - 1e-9


@pytest.mark.parametrize("bad", [math.nan, math.inf, 1e12, -1.0])
def test_margins_stay_finite_whatever_the_estimator_says(bad: float) -> None:
    x, thrust = cruise(0.3)
    nav = nav_with()
    nav.variance[:] = bad
    for mode in (0, 1, 2):
        params = ParamSet({"MPC_TIGHTEN": mode})
        margins = MARGINS.back_offs(nav, x, thrust, params)
        for name in ("clearance_m", "depth_m", "planar_speed_m_s", "heave_m_s", "yaw_rate_rad_s", "thrust_n"):
            values = getattr(margins, name)
            assert np.isfinite(values).all() and (values >= 0.0).all(), name


def _flown_errors(seed: int, surge: float, turn: float, seconds: float) -> tuple[FloatArray, FloatArray]:
    """Errors (t, 8) and times of a model vehicle that random bounded disturbances push while it follows a plan with
    the inner loop; disturbances are Gauss-Markov, cut at their bounds."""
    rng = np.random.default_rng(seed)
    params, h = ParamSet(), 0.02
    bound = DisturbanceBound.of(params).per_channel()
    fade = np.exp(-h / np.array([TUBE.force_correlation_s] * 4 + [TUBE.current_correlation_s] * 3))
    nu = np.array([surge, 0.0, 0.0, turn])
    feed = np.linalg.solve(np.array(MODEL.allocation), np.array(model4.steady_force(MODEL, nu.tolist(), math)))
    z = np.array([0.0, 0.0, 0.5, 0.3, *nu])
    x, w = z.copy(), rng.normal(size=CHANNELS) * bound / DISTURBANCE.bound_sigmas
    mass, inverse = np.array(MODEL.mass_kg), np.linalg.inv(np.array(MODEL.allocation))

    def still(_: FloatArray) -> FloatArray:
        return np.zeros(3)

    errors = []
    for _ in range(int(seconds / h)):
        e = error_of(x, z)
        errors.append(e)
        w = np.clip(
            fade * w + np.sqrt(1.0 - fade**2) * rng.normal(size=CHANNELS) * bound / DISTURBANCE.bound_sigmas,
            -bound,
            bound,
        )
        push = mass * (disturbance_matrix(MODEL, z[4:]) @ w)[4:]
        x = rk4(MODEL, x, feed + MARGINS.ancillary.gain(z[4]) @ e + inverse @ push, still, h)
        z = rk4(MODEL, z, feed, still, h)
    return np.array(errors), h * np.arange(len(errors))


@pytest.mark.parametrize(("surge", "turn"), [(0.0, 0.0), (0.35, 0.0), (0.35, 0.5)])
def test_random_bounded_disturbances_stay_in_the_tube(surge: float, turn: float) -> None:
    """At least 99.9 % of the samples of disturbed flights on the nonlinear model are inside the predicted tube."""
    variances = channel_variances(DisturbanceBound.of(ParamSet()), EstimateSpread.of(nav_with()))
    rows = variances_along(MARGINS.tube.table, np.full(GRID.n + 1, surge), variances)
    radius = 3.72 * np.sqrt(
        0.5 * (rows[:, 0] + rows[:, 2]) + np.sqrt(0.25 * (rows[:, 0] - rows[:, 2]) ** 2 + rows[:, 1] ** 2)
    )
    inside = total = 0
    worst = 0.0
    for seed in range(3):
        errors, t_s = _flown_errors(seed, surge, turn, 12.0)
        away = np.hypot(errors[:, 0], errors[:, 1])
        tube = np.interp(t_s, GRID.t_s, radius)
        inside += int((away <= tube + 1e-12).sum())
        total += len(away)
        worst = max(worst, float(away.max()))
    assert inside >= 0.999 * total
    assert worst > 0.3 * radius[-1], "a tube that nothing ever comes near would be no figure"


def test_lipschitz_growth_is_the_published_formula_and_soon_vacuous() -> None:
    params, bound = ParamSet(), DisturbanceBound.of(ParamSet())
    grid = uniform_grid(40)
    report = lipschitz_report(MODEL, grid, params, bound, scales=UNIT_SCALES)
    growth = float(report.lipschitz[0])
    assert (report.lipschitz == growth).all() and 1.3 < growth < 1.7
    w = float(report.gamma[1])
    j = np.arange(grid.n + 1)
    assert np.allclose(report.gamma, w * (growth**j - 1.0) / (growth - 1.0), rtol=1e-9)
    assert report.empty_node is not None and report.t_s[report.empty_node] < 1.0
    assert "empty from node" in report.text and "speed" in report.text
    tuned = lipschitz_report(MODEL, grid, params, bound, scales=TUNED_SCALES)
    assert float(tuned.lipschitz[0]) < 1.2 and tuned.empty_node is not None
    assert tuned.empty_node > report.empty_node
    nothing = DisturbanceBound(force_n=0.0, moment_n_m=0.0, current_m_s=0.0)
    calm = lipschitz_report(MODEL, grid, params, nothing)
    assert calm.empty_node is None and "hold" in calm.text


def test_the_lipschitz_mode_says_how_far_it_reaches_when_it_comes_into_force() -> None:
    margins, (x, thrust) = Margins(MODEL, GRID), cruise(0.3)
    margins.back_offs(nav_with(), x, thrust, ParamSet())
    assert margins.take_notices() == []
    for _ in range(3):
        margins.back_offs(nav_with(), x, thrust, ParamSet({"MPC_TIGHTEN": 2}))
    news = margins.take_notices()
    assert len(news) == 1 and "Lipschitz sets are empty from node" in news[0][1]


def test_refusals_name_what_is_used_up() -> None:
    nav = nav_with()
    assert MARGINS.refusals(nav, 1.0, ParamSet()) == ()
    rough = ParamSet({"MPC_TIGHTEN": 2, "MPC_W_FORCE": 100.0, "SPD_PLANAR_MAX": 0.2})
    reasons = MARGINS.refusals(nav, math.inf, rough)
    assert any(reason.startswith("Lipschitz sets are empty from node 1") for reason in reasons)
    narrow = MARGINS.refusals(nav, 0.001, ParamSet())
    assert len(narrow) == 1 and "fence leaves nothing" in narrow[0]


def test_inner_loop_follows_plan_and_ignores_a_change_of_believed_current() -> None:
    loop = InnerLoop(MARGINS.ancillary, GRID)
    x, thrust = cruise(0.3)
    x[:, 0] = 0.3 * GRID.t_s
    thrust[:] = [2.0, 2.0, -0.6, 0.0]
    loop.start(1_000_000, x, thrust, np.zeros(3))
    limit = np.full(4, 12.0)
    on_plan = np.array([0.015, 0.0, 0.0, 0.0, 0.3, 0.0, 0.0, 0.0])
    assert np.allclose(loop.thrust(1_050_000, on_plan, np.zeros(3), limit), thrust[0])
    told = np.array([0.1, -0.05, 0.0])
    same = on_plan.copy()
    same[4:6] -= told[:2]
    assert np.allclose(plan_error(same, on_plan, told, np.zeros(3)), 0.0, atol=1e-12)
    assert np.allclose(loop.thrust(1_050_000, same, told, limit), thrust[0])
    turned = on_plan + np.array([0.0, 0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 0.0])
    port, starboard, _, _ = loop.thrust(1_050_000, turned, np.zeros(3), limit)
    assert port < 2.0 < starboard, "turned to starboard: pushed back to port"
    far = on_plan + np.array([-5.0, 0, 0, 0, 0, 0, 0, 0])
    assert np.abs(loop.thrust(1_050_000, far, np.zeros(3), limit)).max() == 12.0
