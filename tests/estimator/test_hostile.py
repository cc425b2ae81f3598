"""Whatever arrives, in whatever order: never an exception, never a NaN; and lateness alone changes nothing."""

import math
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_aids import depth_of, external_of, look, velocity_of
from truth import Faults, World, uniform_current

from autopilot.core.frames import FloatArray
from autopilot.core.messages import NavState
from autopilot.core.samples import (
    AhrsSample,
    DepthSample,
    ExternalFrame,
    ExternalPoseSample,
    LaserSample,
    MarkerSighting,
    PoseSample,
    Sample,
    VelocityLock,
    VelocitySample,
)
from autopilot.core.sensors import AID_SENSORS
from autopilot.core.vehicle import load_vehicle
from autopilot.estimator.complementary import create_complementary
from autopilot.estimator.create import create_estimator
from autopilot.estimator.ekf import create_ekf
from autopilot.estimator.engine import AidedEstimator
from autopilot.estimator.options import EstimatorOptions

VEHICLE = load_vehicle("lbv150")

numbers = st.one_of(
    st.floats(-2.0, 2.0),
    st.sampled_from([math.nan, math.inf, -math.inf, 1e308, -1e308, 1e-308, 1e12, 0.0, -1.0]),
)
times = st.one_of(
    st.integers(-80_000, 5_000),
    st.sampled_from([-10_000_000, -1_500_000, -990_000, 3_000, 900_000, 10**15, -(10**15)]),
)
"""Relative to the tick."""


def arrays(*shape: int) -> st.SearchStrategy[FloatArray]:
    size = math.prod(shape)
    good = st.lists(numbers, min_size=size, max_size=size).map(lambda v: np.array(v).reshape(shape))
    return st.one_of(good, st.sampled_from([np.zeros(0), np.zeros(2), np.zeros((5, 5)), np.full(shape, math.nan)]))


@st.composite
def bad_samples(draw: Callable[..., Any]) -> tuple[int, Callable[[int], Sample]]:
    """A tick and what arrives then, made for the time of that tick."""
    tick, offset = draw(st.integers(0, 149)), draw(times)
    kind = draw(st.integers(0, 6))
    if kind == 0:
        rpy, rate, accel = draw(arrays(3)), draw(arrays(3)), draw(arrays(3))
        return tick, lambda t: AhrsSample(t_us=t + offset, rpy_rad=rpy, rate_frd_rad_s=rate, accel_frd_m_s2=accel)
    if kind == 1:
        pos, sigma, yaw, sigma_yaw = draw(arrays(3)), draw(arrays(3)), draw(numbers), draw(numbers)
        return tick, lambda t: PoseSample(
            t_us=t + offset, pos_ned_m=pos, yaw_rad=yaw, sigma_pos_m=sigma, sigma_yaw_rad=sigma_yaw
        )
    if kind == 2:
        range_m, sigma_m = draw(numbers), draw(numbers)
        return tick, lambda t: LaserSample(t_us=t + offset, range_m=range_m, sigma_m=sigma_m)
    if kind == 3:
        depth_m, sigma_m = draw(numbers), draw(numbers)
        return tick, lambda t: DepthSample(t_us=t + offset, depth_m=depth_m, sigma_m=sigma_m)
    if kind == 4:
        vel, sigma, lock = draw(arrays(3)), draw(arrays(3)), draw(st.sampled_from([*VelocityLock, 7]))
        return tick, lambda t: VelocitySample(t_us=t + offset, vel_frd_m_s=vel, sigma_m_s=sigma, lock=lock)
    if kind == 5:
        pos, yaw, p = draw(arrays(3)), draw(numbers), draw(st.one_of(st.none(), arrays(4, 4)))
        frame, count = draw(st.sampled_from([*ExternalFrame, 9])), draw(st.integers(0, 3))
        return tick, lambda t: ExternalPoseSample(
            t_us=t + offset, pos_m=pos, yaw_rad=yaw, covariance=p, frame=frame, reset_counter=count
        )
    ids = tuple(draw(st.lists(st.integers(-5, 2000), max_size=3)))
    corners, laser = draw(arrays(len(ids), 4, 2)), draw(st.one_of(st.none(), arrays(2)))
    return tick, lambda t: MarkerSighting(t_us=t + offset, ids=ids, corners_px=corners, laser_px=laser)


@settings(max_examples=12, deadline=None)
@given(st.lists(bad_samples(), max_size=60), st.sampled_from(["ekf", "complementary"]), st.booleans(), st.booleans())
def test_never_a_nan_never_an_exception(
    bad: list[tuple[int, Callable[[int], Sample]]], name: str, current_3d: bool, late: bool
) -> None:
    """1.5 s of flight on all sensors with anything thrown in."""
    options = EstimatorOptions(current_3d=current_3d)
    estimator = create_estimator(name, VEHICLE, None, floor_depth_m=1.5, options=options, shadow=True)
    world = World(uniform_current, Faults(laser=True, jitter_us=20_000))
    for tick, (truth, samples, command) in enumerate(world.run(1.5)):
        now = look(world)
        extra: list[Sample] = [depth_of(now), velocity_of(now), external_of(now)] if tick % 10 == 0 else []
        thrown = [make(truth.t_us) for at, make in bad if at == tick]
        given_ = [*thrown, *samples, *extra] if late else [*samples, *extra, *thrown]
        nav = estimator.step(truth.t_us, given_, command)
        if nav is None:
            continue
        for values in (nav.pos_ned_m, nav.rpy_rad, nav.vel_frd_m_s, nav.vel_water_frd_m_s, nav.variance):
            assert np.isfinite(values).all()
        assert (nav.variance >= 0.0).all()
    for aid in estimator.take_aids():
        assert math.isfinite(aid.test_ratio) and np.isfinite(aid.innovation).all()


@cache
def flight() -> list[tuple[int, list[Sample], list[Sample], FloatArray]]:
    """1.3 s: times, AHRS samples, aiding samples as they are taken, thrusts."""
    world, ticks = World(uniform_current, Faults(latency_us=0, laser=True)), []
    for tick, (truth, samples, thrust_n) in enumerate(world.run(1.3)):
        now = look(world)
        aiding: list[Sample] = [s for s in samples if not isinstance(s, AhrsSample)]
        if tick % 10 == 5:
            aiding += [depth_of(now), velocity_of(now), external_of(now)]
        ahrs: list[Sample] = [s for s in samples if isinstance(s, AhrsSample)]
        ticks.append((truth.t_us, ahrs, aiding, thrust_n))
    return ticks


def end_of(estimator: AidedEstimator, late_ticks: list[int]) -> NavState:
    """The flight with every aiding sample late by as many ticks as the list says, in turn; all are there at the end."""
    queue: list[tuple[int, Sample]] = []
    nav, count, last = None, 0, len(flight()) - 17
    for tick, (t_us, ahrs, aiding, thrust_n) in enumerate(flight()):
        for sample in aiding:
            late = late_ticks[count % len(late_ticks)] if 40 <= tick < last else 0
            queue.append((tick + late, sample))
            count += 1
        due = [sample for at, sample in queue if at == tick]
        queue = [(at, sample) for at, sample in queue if at > tick]
        nav = estimator.step(t_us, [*reversed(due), *ahrs], thrust_n)
    assert nav is not None and not queue
    counts = estimator.counters()
    assert not any(counts[f"{sensor}.late"] for sensor in AID_SENSORS)
    return nav


@pytest.mark.parametrize(("create", "share"), [(create_ekf, 0.02), (create_complementary, 1e-7)])
@settings(max_examples=5, deadline=None)
@given(late_ticks=st.lists(st.integers(0, 15), min_size=1, max_size=20))
def test_out_of_order_ends_where_in_order_does(
    create: Callable[..., AidedEstimator], share: float, late_ticks: list[int]
) -> None:
    """Samples of all sensors, up to 150 ms late and mixed up, give the state that prompt ones give, to a share of the
    standard deviations: the Kalman filter carries small corrections on by the Jacobians that it had."""
    prompt, late = (end_of(create(VEHICLE, None, 1.5), ticks) for ticks in ([0], late_ticks))
    pos_sigma, water_sigma = np.sqrt(prompt.variance[:3]), np.sqrt(prompt.variance[6:9])
    assert (np.abs(late.pos_ned_m - prompt.pos_ned_m) <= share * pos_sigma).all()
    assert (np.abs(late.vel_water_frd_m_s - prompt.vel_water_frd_m_s) <= share * water_sigma).all()
    np.testing.assert_allclose(late.variance, prompt.variance, rtol=2.0 * share)
