"""The Kalman filter's parts: derivatives, the update, consistency of the covariance."""

import math

import numpy as np
import pytest
from filterpy.kalman import ExtendedKalmanFilter
from hypothesis import given, settings
from hypothesis import strategies as st
from makers import Make
from truth import Faults, World, fly, no_current, tank_jet

from autopilot.core.compiled import OFF, SWITCH
from autopilot.core.frames import FloatArray, wrap_pi
from autopilot.core.samples import VelocityLock
from autopilot.core.vehicle import load_vehicle
from autopilot.estimator.estimator_tuning import NOISE
from autopilot.estimator.inertial import Inertial, InertialStep, ProcessNoiseMode
from autopilot.estimator.kalman import LEANING_M_S2, KalmanCore
from autopilot.estimator.measure_depth import Depth
from autopilot.estimator.measure_heading import heading_of
from autopilot.estimator.measure_model import ModelAcceleration, VehicleAcceleration, model_aid_of, planar_mass_ratios
from autopilot.estimator.measure_pose import PoseFix
from autopilot.estimator.measure_range import LaserRange
from autopilot.estimator.measure_velocity import BodyVelocity
from autopilot.estimator.measurement import CHI2_999, Measurement, Moment
from autopilot.estimator.motion import fill_jacobian, moved
from autopilot.estimator.states import NX, YAW, FilterState
from autopilot.estimator.tuning import process_noise

VEHICLE = load_vehicle("lbv150")
ACCELERATION = VehicleAcceleration(VEHICLE.to_model(), planar_mass_ratios(VEHICLE))
unit = st.floats(-1.0, 1.0, allow_subnormal=False)
SCALE = np.array([2, 2, 1, 4, 0.5, 0.5, 0.2, 0.05, 0.1, 0.1, 0.1, 0.3, 0.3, 0.1, 0.1, 0.2, 0.02, 0.3, 0.1, 0.1, 0.3])


@st.composite
def states(draw: st.DrawFn) -> FloatArray:
    return np.array([draw(unit) for _ in range(NX)]) * SCALE


@st.composite
def moments(draw: st.DrawFn) -> Moment:
    inertial = Inertial(
        t_us=0,
        roll_rad=0.2 * draw(unit),
        pitch_rad=0.2 * draw(unit),
        ahrs_yaw_rad=3.0 * draw(unit),
        yaw_rate_rad_s=draw(unit),
        accel_level_m_s2=(draw(unit), draw(unit), draw(unit)),
        rate_frd_rad_s=np.array([0.2 * draw(unit), 0.2 * draw(unit), draw(unit)]),
        raw_tilt_rad=(0.0, 0.0),
        real=True,
    )
    return Moment(inertial, (12.0 * draw(unit), 12.0 * draw(unit), 12.0 * draw(unit), 12.0 * draw(unit)))


def numeric(function: object, x: FloatArray) -> FloatArray:
    assert callable(function)
    columns = []
    for i in range(len(x)):
        d = np.zeros(len(x))
        d[i] = 1e-6
        columns.append((np.asarray(function(x + d)) - np.asarray(function(x - d))) / 2e-6)
    return np.array(columns).T


@settings(max_examples=50)
@given(states(), st.floats(0.001, 0.05), unit, unit, unit)
def test_motion_jacobian(x: FloatArray, dt: float, ax: float, ay: float, r: float) -> None:
    step = InertialStep(dt, r, (ax, ay, 0.3), ProcessNoiseMode.NOMINAL)
    jac = np.eye(NX)
    fill_jacobian(
        jac, np.ones(NX), InertialStep(0.02, 1.0, (1.0, 2.0, 3.0), ProcessNoiseMode.NOMINAL)
    )  # leftovers must not survive
    fill_jacobian(jac, x, step)
    np.testing.assert_allclose(jac, numeric(lambda v: moved(v, step), x), atol=1e-7)


def measurements(inertial: Inertial) -> list[Measurement]:
    return [
        PoseFix(sensor="markers", t_us=0, z=np.zeros(4), noise=np.eye(4)),
        heading_of(inertial),
        LaserRange(
            sensor="laser",
            t_us=0,
            z=np.ones(1),
            noise=np.eye(1),
            floor_depth_m=1.5,
            mount_frd_m=(0.1, 0.05, 0.1),
        ),
        model_aid_of(inertial, ACCELERATION),
        model_aid_of(inertial, ACCELERATION, vertical=True),
        Depth(sensor="depth", t_us=0, z=np.ones(1), noise=np.eye(1), mount_frd_m=(0.2, -0.1, 0.15)),
        *(
            BodyVelocity(
                sensor="velocity", t_us=0, z=np.ones(3), noise=np.eye(3), lock=lock, mount_frd_m=(0.2, -0.1, 0.15)
            )
            for lock in VelocityLock
        ),
    ]


@settings(max_examples=50)
@given(states(), moments(), st.floats(0.0, 0.02))
def test_measurement_jacobians(x: FloatArray, moment: Moment, after_s: float) -> None:
    for m in measurements(moment.inertial):
        wanted = numeric(lambda v, m=m: m.predicted(v, moment, after_s), x)
        # Drag has a bend at rest that is 1 mm/s wide: compare there with a coarser tolerance.
        atol = 2e-2 if isinstance(m, ModelAcceleration) else 1e-6
        np.testing.assert_allclose(m.jacobian(x, moment, after_s), wanted, atol=atol, err_msg=m.sensor)


def textbook(state: FilterState, m: Measurement, moment: Moment, after_s: float) -> tuple[FilterState, float]:
    """The optimal update in its shortest form, and the squared distance of the residual."""
    h = m.jacobian(state.x, moment, after_s)
    spread = state.p @ h.T
    s = h @ spread + m.noise
    y = m.residual(m.z, m.predicted(state.x, moment, after_s))
    gain = spread @ np.linalg.inv(s)
    return FilterState(state.x + gain @ y, state.p - gain @ spread.T), float(y @ np.linalg.solve(s, y))


@settings(max_examples=30)
@given(states(), moments(), st.integers(0, 1000))
def test_update_is_filterpys(x: FloatArray, moment: Moment, seed: int) -> None:
    """Every kind of measurement comes out of the update as of filterpy's, and as the textbook has it."""
    rng = np.random.default_rng(seed)
    a = rng.normal(size=(NX, NX)) * 0.1
    p = a @ a.T + 1e-4 * np.eye(NX)
    core = KalmanCore()
    for m in measurements(moment.inertial):
        state = FilterState(x.copy(), p.copy())
        innovation = core.innovation(state, m, moment, 0.004)
        ours = core.correct(state, innovation)
        kf = ExtendedKalmanFilter(NX, len(m.z))
        kf.x, kf.P = x, p
        args = (moment, 0.004)
        kf.update(m.z, m.jacobian, m.predicted, R=m.noise, args=args, hx_args=args, residual=m.residual)
        np.testing.assert_allclose(ours.x, kf.x, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(ours.p, kf.P, atol=1e-14)
        np.testing.assert_allclose(ours.p, ours.p.T, atol=0.0)
        expected, distance2 = textbook(state, m, moment, 0.004)
        np.testing.assert_allclose(ours.x, expected.x, atol=1e-9)
        np.testing.assert_allclose(ours.p, expected.p, atol=1e-9)
        assert innovation.test_ratio == pytest.approx(distance2 / CHI2_999[len(m.z)], rel=1e-6, abs=1e-12)
        np.testing.assert_array_equal(state.x, x)  # states are never changed in place
        np.testing.assert_array_equal(state.p, p)


def test_the_filter_is_filterpys_where_nothing_is_compiled(make_ekf: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every step and every measurement of an estimator at work is one call of filterpy's predict() or update()."""
    monkeypatch.setenv(SWITCH, OFF)
    calls = {"predict": 0, "update": 0}
    for name in calls:
        whole = getattr(ExtendedKalmanFilter, name)

        def counted(self: object, *args: object, name: str = name, whole: object = whole, **more: object) -> object:
            assert callable(whole)
            calls[name] += 1
            return whole(self, *args, **more)

        monkeypatch.setattr(ExtendedKalmanFilter, name, counted)
    estimator = make_ekf()
    world = World(tank_jet, Faults(seed=3))
    for truth, samples, command in world.run(2.0):
        estimator.step(truth.t_us, samples, command)
    fused = sum(estimator.counters()[f"{aid}.fused"] for aid in ("markers", "heading", "model"))
    assert calls["predict"] >= estimator.counters()["ahrs.good"] - 20
    assert calls["update"] >= fused > 100


@settings(max_examples=30)
@given(states(), st.floats(0.001, 0.05), unit, unit, st.integers(0, 1000))
def test_prediction_is_the_textbooks(x: FloatArray, dt: float, ax: float, r: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    a = rng.normal(size=(NX, NX)) * 0.1
    p = a @ a.T + 1e-4 * np.eye(NX)
    step = InertialStep(dt, r, (ax, -ax, 0.3), ProcessNoiseMode.NOMINAL)
    f = np.eye(NX)
    fill_jacobian(f, x, step)
    noise = process_noise(ProcessNoiseMode.NOMINAL)
    if math.hypot(x[8], x[9]) > LEANING_M_S2:
        noise[YAW, YAW] += NOISE.tilted_gyro_noise**2
    after = KalmanCore().predict(FilterState(x, p), step)
    np.testing.assert_allclose(after.x, moved(x, step), atol=1e-12)
    np.testing.assert_allclose(after.p, f @ p @ f.T + dt * noise, atol=1e-12)


def test_an_accelerometer_believed_with_a_tilts_offset_leaves_the_heading_unsure() -> None:
    """Pitching at 0.1 rad/s with 0.3 rad of false roll turns the heading by 0.03 rad/s that is not there."""
    sure, leaning = np.zeros(NX), np.zeros(NX)
    leaning[9] = 0.3 * 9.81
    grown = []
    for x in (sure, leaning):
        state = FilterState(x, np.zeros((NX, NX)))
        for _ in range(100):
            state = KalmanCore().predict(
                state, InertialStep(0.01, 0.0, (0.0, float(x[9]), 0.0), ProcessNoiseMode.TRIMMED)
            )
        grown.append(math.sqrt(state.p[YAW, YAW]))
    assert grown[0] < math.radians(0.1)
    assert grown[1] > math.radians(0.5)


@given(st.floats(-20.0, 20.0), st.floats(-3.1, 3.1))
def test_heading_residual_is_wrapped(yaw: float, seen: float) -> None:
    fix = PoseFix(sensor="markers", t_us=0, z=np.array([0.0, 0.0, 0.0, seen]), noise=np.eye(4))
    h = np.array([0.0, 0.0, 0.0, yaw])
    y = fix.residual(fix.z, h)
    assert abs(y[3]) <= math.pi + 1e-9
    assert wrap_pi(float(y[3] - (seen - yaw))) == pytest.approx(0.0, abs=1e-9)


def test_covariance_is_consistent(make_ekf: Make) -> None:
    """NEES of (position, yaw, velocity) over seeds, NIS and whiteness of the vision innovations."""
    nees, nis, rows = [], [], []
    for seed in range(3):
        estimator = make_ekf()
        world = World(tank_jet, Faults(seed=seed))
        for truth, samples, command in world.run(12.0):
            nav = estimator.step(truth.t_us, samples, command)
            if nav is None or truth.t_us < 4_000_000:
                continue
            if truth.t_us % 100_000 == 0:
                error = np.append(nav.pos_ned_m - truth.pos, wrap_pi(float(nav.rpy_rad[2]) - truth.yaw))
                nees.append(float((error**2 / nav.variance[[0, 1, 2, 5]]).sum()))
        aids = [a for a in estimator.take_aids() if a.sensor == "markers" and a.t_us > 4_000_000]
        nis += [18.47 * a.test_ratio for a in aids]
        rows.append(np.array([a.innovation[0] / math.sqrt(a.innovation_var[0]) for a in aids]))
    assert 1.5 < np.mean(nees) < 6.0  # 4 degrees of freedom
    assert 2.0 < np.mean(nis) < 5.0
    assert np.mean(np.array(nis) > 9.49) < 0.10  # 95 % point
    for row in rows:
        assert abs(np.corrcoef(row[1:], row[:-1])[0, 1]) < 0.25


def test_yaw_counts_turns_inside_and_is_wrapped_outside(make_ekf: Make) -> None:
    track = fly(make_ekf(), World(no_current), 20.0)
    assert all(-math.pi <= nav.rpy_rad[2] < math.pi for nav in track.nav)
    assert np.abs(track.after(4.0).yaw_error()).max() < math.radians(0.5)
    assert YAW == 3
