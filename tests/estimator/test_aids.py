"""Depth, velocity and external pose through the one aiding life cycle; lever arms and time offsets."""

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from makers import Make
from truth import Faults, World, no_current, uniform_current

from autopilot.core.frames import FloatArray, r_ned_from_frd, wrap_pi
from autopilot.core.messages import AidState, NavDoubt, NavHealth, NavState
from autopilot.core.samples import (
    AhrsSample,
    AltimeterSample,
    DepthSample,
    ExternalFrame,
    ExternalPoseSample,
    PoseSample,
    Sample,
    VelocityLock,
    VelocitySample,
)
from autopilot.core.vehicle import DvlMount, Vehicle
from autopilot.estimator.complementary import create_complementary
from autopilot.estimator.ekf import create_ekf
from autopilot.estimator.engine import AidedEstimator
from autopilot.estimator.inertial import AhrsMount
from autopilot.estimator.measure_heading import HEADING_EVERY_S, HeadingAid
from autopilot.estimator.options import EstimatorOptions

LEVER = (0.25, -0.1, 0.15)
MOUNT = {"position_frd_m": LEVER}


@dataclass
class Look:
    """What extra sensors see of the world now."""

    t_us: int
    pos: FloatArray
    rpy: FloatArray
    vel_frd: FloatArray
    water_frd: FloatArray
    rate_frd: FloatArray


def look(world: World) -> Look:
    roll, pitch = world.tilt_angles()
    t, a = 1e-6 * world.t_us, math.radians(1.0)
    rates = a * 1.7 * math.cos(1.7 * t + world.wobble_phase[0]), a * 1.3 * math.cos(1.3 * t + world.wobble_phase[1])
    level = r_ned_from_frd(np.array([roll, pitch, 0.0])).T
    cn, ce = world.current(world.n, world.e)
    c, s = math.cos(world.yaw), math.sin(world.yaw)
    water = np.array([world.u - c * cn - s * ce, world.v - c * ce + s * cn, world.w])
    return Look(
        world.t_us,
        np.array([world.n, world.e, world.d]),
        np.array([roll, pitch, world.yaw]),
        level @ np.array([world.u, world.v, world.w]),
        level @ water,
        np.array([*rates, world.r]),
    )


def depth_of(now: Look, offset_m: float = 0.0, lever: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> DepthSample:
    below = float((r_ned_from_frd(now.rpy) @ np.array(lever))[2])
    return DepthSample(t_us=now.t_us, depth_m=float(now.pos[2]) + below + offset_m, sigma_m=0.005)


def velocity_of(
    now: Look, lock: VelocityLock = VelocityLock.BOTTOM, lever: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> VelocitySample:
    vel = now.vel_frd if lock is VelocityLock.BOTTOM else now.water_frd
    moved = vel + np.cross(now.rate_frd, lever)
    return VelocitySample(t_us=now.t_us, vel_frd_m_s=moved, sigma_m_s=np.full(3, 0.005), lock=lock)


def external_of(now: Look, lever: tuple[float, float, float] = (0.0, 0.0, 0.0), reset: int = 0) -> ExternalPoseSample:
    return ExternalPoseSample(
        t_us=now.t_us,
        pos_m=now.pos + r_ned_from_frd(now.rpy) @ np.array(lever),
        yaw_rad=wrap_pi(float(now.rpy[2])),
        covariance=np.diag([1e-4, 1e-4, 1e-4, 1e-4]),
        reset_counter=reset,
    )


def run(
    estimator: AidedEstimator, world: World, seconds: float, extra: Callable[[Look], list[Sample]]
) -> list[tuple[Look, NavState]]:
    """Fly; ``extra`` makes the samples of what is seen at each tick."""
    track = []
    for truth, samples, command in world.run(seconds):
        now = look(world)
        nav = estimator.step(truth.t_us, samples + extra(now), command)
        if nav is not None:
            track.append((now, nav))
    return track


def mounted(vehicle: Vehicle, **tables: object) -> Vehicle:
    """The vehicle with other mountings."""
    built: Vehicle = msgspec.convert(msgspec.to_builtins(vehicle) | tables, Vehicle)
    return built


def aid(estimator: AidedEstimator, sensor: str) -> list[AidState]:
    return [status.state for status in estimator.take_aids() if status.sensor == sensor]


def planar(track: list[tuple[Look, NavState]]) -> FloatArray:
    return np.array([np.linalg.norm((nav.pos_ned_m - now.pos)[:2]) for now, nav in track])


def test_depth_with_an_offset_and_a_lever_arm(vehicle: Vehicle) -> None:
    """The offset is learned while markers are seen and holds the depth when they are gone."""
    estimator = create_ekf(mounted(vehicle, depth_sensor=MOUNT), None, None)
    world = World(no_current, Faults(vision_gap_s=(8.0, 12.0)))
    track = run(estimator, world, 12.0, lambda now: [depth_of(now, 0.2, LEVER)] if now.t_us % 100_000 == 0 else [])
    error = [abs(float(nav.pos_ned_m[2] - now.pos[2])) for now, nav in track if now.t_us > 8_000_000]
    assert max(error) < 0.02
    counts = estimator.counters()
    assert counts["depth.fused"] > 100
    assert counts["depth.resets"] <= 1
    assert aid(estimator, "depth")[-1] is AidState.ACTIVE


def test_a_depth_sensor_that_jumps_is_taken_up_again(make_ekf: Make) -> None:
    """Twelve misses by the same amount reopen its offset; the depth itself does not move."""
    estimator = make_ekf()
    track = run(
        estimator,
        World(no_current),
        12.0,
        lambda now: [depth_of(now, 0.0 if now.t_us < 6_000_000 else 0.5)] if now.t_us % 50_000 == 0 else [],
    )
    assert estimator.counters()["depth.resets"] == 1
    states = aid(estimator, "depth")
    assert AidState.STARTING in states[len(states) // 2 :]
    assert states[-1] is AidState.ACTIVE
    assert max(abs(float(nav.pos_ned_m[2] - now.pos[2])) for now, nav in track if now.t_us > 4_000_000) < 0.02


@pytest.mark.parametrize(
    ("offset_m", "noise_m", "outliers", "told"),
    [(0.1, 0.005, 0.1, False), (0.5, 0.005, 0.0, True), (-0.5, 0.005, 0.0, True), (0.0, 0.1, 0.0, True)],
    ids=["sound", "deep", "shallow", "noisy"],
)
def test_a_depth_sensor_that_is_off_is_named_and_moves_nothing(
    make_ekf: Make, offset_m: float, noise_m: float, outliers: float, told: bool
) -> None:
    rng = np.random.default_rng(3)

    def depth(now: Look) -> list[Sample]:
        if now.t_us % 100_000:
            return []
        wild = 0.5 * rng.standard_normal() if rng.random() < outliers else 0.0
        return [depth_of(now, offset_m + noise_m * rng.standard_normal() + wild)]

    track = run(make_ekf(), World(no_current), 15.0, depth)
    settled = [(now, nav) for now, nav in track if now.t_us > 5_000_000]
    assert {NavDoubt.DEPTH in nav.doubts for _, nav in settled[-500:]} == {told}
    assert told or not any(nav.doubts for _, nav in track)
    assert max(abs(float(nav.pos_ned_m[2] - now.pos[2])) for now, nav in settled) < 0.02
    assert all(nav.health is NavHealth.GOOD for _, nav in settled)


def test_an_ahrs_that_was_restarted_is_judged_anew(make_ekf: Make) -> None:
    """Or a vehicle at rest, where nothing clears the doubt, could never arm again."""
    estimator, world = make_ekf(), World(no_current, Faults(ahrs_gap_s=(8.0, 10.0)))
    doubted: dict[float, bool] = {}
    for truth, samples, command in world.run(10.4):
        wrong = 2.0 if 5e6 < truth.t_us < 8e6 else 0.0
        given = [
            replace(sample, accel_frd_m_s2=sample.accel_frd_m_s2 + wrong) if isinstance(sample, AhrsSample) else sample
            for sample in samples
        ]
        nav = estimator.step(truth.t_us, given, command)
        if nav is not None:
            doubted[1e-6 * truth.t_us] = NavDoubt.ACCELEROMETER in nav.doubts
    assert not any(on for t_s, on in doubted.items() if t_s < 5.0)
    assert all(on for t_s, on in doubted.items() if 7.0 < t_s < 10.0)
    assert not any(on for t_s, on in doubted.items() if t_s > 10.05)


FLOOR_M = 1.5


def altimeter_of(now: Look, factor: float = 1.0) -> AltimeterSample:
    height_m = FLOOR_M - float(now.pos[2]) - float((r_ned_from_frd(now.rpy) @ np.array(LEVER))[2])
    return AltimeterSample(t_us=now.t_us, range_m=factor * height_m, sigma_m=0.01)


@pytest.mark.long
@pytest.mark.parametrize("create", [create_ekf, create_complementary])
def test_an_altimeter_holds_the_depth_when_markers_are_gone_and_only_then(create: Make, vehicle: Vehicle) -> None:
    """Its scale is 2 % off, one echo in four has come back twice, half are lost: what markers say of the depth stays as
    it is, and 25 s without them the depth is known as well as the altimeter knows it."""
    end_s = 33.0
    ends: dict[bool, float] = {}
    for on in (True, False):
        estimator = create(mounted(vehicle, altimeter=MOUNT), None, FLOOR_M)
        world = World(no_current, Faults(vision_gap_s=(8.0, end_s)))

        def extra(now: Look, on: bool = on) -> list[Sample]:
            count = now.t_us // 100_000
            if not on or now.t_us % 100_000 or count % 2:
                return []
            return [altimeter_of(now, 2.04 if count % 8 == 0 else 1.02)]

        track = run(estimator, world, end_s, extra)
        before = [abs(float(nav.pos_ned_m[2] - now.pos[2])) for now, nav in track if 4e6 < now.t_us < 8e6]
        assert max(before) < 0.01
        ends[on] = float(np.sqrt(track[-1][1].variance[2]))
        if on:
            after = [(now, nav) for now, nav in track if now.t_us > 8_000_000]
            error = [abs(float(nav.pos_ned_m[2] - now.pos[2])) for now, nav in after]
            assert max(error) < 0.1
            inside = [e < 3.0 * math.sqrt(float(nav.variance[2])) for e, (_, nav) in zip(error, after, strict=True)]
            assert np.mean(inside) > 0.95
            assert estimator.counters()["altimeter.received"] > 100
    assert ends[True] < 0.5 * ends[False], "without it the depth is not known any more"
    assert create is not create_ekf or ends[True] < 0.05


def test_an_echo_that_came_back_twice_is_not_believed_after_a_silence_either(vehicle: Vehicle) -> None:
    """Ten seconds with neither markers nor altimeter leave the depth open: then the first echoes are multiples."""
    estimator = create_ekf(mounted(vehicle, altimeter=MOUNT), None, FLOOR_M)
    end_s, heard_s = 22.0, 18.0

    def extra(now: Look) -> list[Sample]:
        count = now.t_us // 100_000
        if now.t_us % 100_000 or 8.0 < 1e-6 * now.t_us < heard_s:
            return []
        return [altimeter_of(now, 2.0 if count % 5 == 0 else 1.0)]

    track = run(estimator, World(no_current, Faults(vision_gap_s=(8.0, end_s))), end_s, extra)
    before = next(nav for now, nav in track if now.t_us >= 1e6 * heard_s)
    assert float(np.sqrt(before.variance[2])) > 0.3, "or the gate would do"
    after = [(now, nav) for now, nav in track if now.t_us > 1e6 * (heard_s + 1.0)]
    assert max(abs(float(nav.pos_ned_m[2] - now.pos[2])) for now, nav in after) < 0.1


@pytest.mark.parametrize("create", [create_ekf, create_complementary])
def test_velocity_over_ground_carries_a_long_gap(create: Make, vehicle: Vehicle) -> None:
    """Ten seconds blind: the drift stays below 0.1 m, the state stays usable and inside three sigma."""
    estimator = create(mounted(vehicle, dvl=MOUNT), None, None)
    world = World(uniform_current, Faults(vision_gap_s=(8.0, 18.0)))
    every = 120_000
    track = run(estimator, world, 18.0, lambda now: [velocity_of(now, lever=LEVER)] if now.t_us % every == 0 else [])
    end = planar(track)[-1]
    nav = track[-1][1]
    assert end < 0.1
    assert end < 3.0 * math.sqrt(float(nav.variance[:2].sum()))
    assert nav.health is NavHealth.DEAD_RECKONING
    assert estimator.counters()["velocity.fused"] > 120


def test_velocity_through_water_gives_the_current_without_a_vehicle_model(make_ekf: Make) -> None:
    estimator = make_ekf(EstimatorOptions(model_aid=False))
    track = run(
        estimator,
        World(uniform_current),
        10.0,
        lambda now: [velocity_of(now, VelocityLock.WATER)] if now.t_us % 120_000 == 0 else [],
    )
    current = track[-1][1].current_ned_m_s
    np.testing.assert_allclose(current[:2], uniform_current(0.0, 0.0), atol=0.02)


def test_vertical_current_as_a_state(make_ekf: Make) -> None:
    """A water-locked velocity in water that rises: seen with the option, held at zero without."""
    rising = np.array([0.0, 0.0, -0.08])

    def extra(now: Look) -> list[Sample]:
        if now.t_us % 120_000:
            return []
        sample = velocity_of(now, VelocityLock.WATER)
        return [replace(sample, vel_frd_m_s=sample.vel_frd_m_s - r_ned_from_frd(now.rpy).T @ rising)]

    found = []
    for on in (True, False):
        estimator = make_ekf(EstimatorOptions(model_aid=False, current_3d=on))
        found.append(run(estimator, World(no_current), 8.0, extra)[-1][1].current_ned_m_s[2])
    assert found[0] == pytest.approx(-0.08, abs=0.01)
    assert found[1] == 0.0


def test_starts_and_flies_on_an_external_pose_alone(vehicle: Vehicle) -> None:
    estimator = create_ekf(mounted(vehicle, external_pose=MOUNT), None, None)
    world = World(no_current, Faults(vision=False))
    track = run(estimator, world, 8.0, lambda now: [external_of(now, LEVER)] if now.t_us % 100_000 == 0 else [])
    assert planar(track[200:]).max() < 0.03
    assert track[-1][1].health is NavHealth.GOOD
    assert aid(estimator, "external")[-1] is AidState.ACTIVE


def test_reset_counter_makes_the_filter_follow_a_jump_at_once(make_ekf: Make) -> None:
    """The source lies a metre further and says so: three poses are enough, nothing is lost in between."""
    jump = np.array([1.0, 0.0, 0.0])

    def extra(now: Look) -> list[Sample]:
        if now.t_us % 100_000:
            return []
        jumped = now.t_us >= 5_000_000
        sample = external_of(now, reset=int(jumped))
        return [replace(sample, pos_m=sample.pos_m + jumped * jump, covariance=None)]

    estimator = make_ekf()
    track = run(estimator, World(no_current, Faults(vision=False)), 8.0, extra)
    late = [float(np.linalg.norm(nav.pos_ned_m - now.pos - jump)) for now, nav in track if now.t_us > 5_400_000]
    assert max(late) < 0.15
    assert track[-1][1].reset_count == 1


def test_a_frame_of_its_own_is_laid_onto_the_estimate(make_ekf: Make) -> None:
    """A source with another origin and direction keeps the vehicle where it was when markers vanish."""
    turn, origin = 1.1, np.array([30.0, -20.0, 4.0])
    c, s = math.cos(turn), math.sin(turn)
    theirs_from_ned = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])

    def extra(now: Look) -> list[Sample]:
        if now.t_us % 100_000:
            return []
        ours = external_of(now)
        pos_m = theirs_from_ned @ (ours.pos_m - origin)
        return [replace(ours, pos_m=pos_m, yaw_rad=ours.yaw_rad - turn, frame=ExternalFrame.FRD)]

    estimator = make_ekf()
    track = run(estimator, World(uniform_current, Faults(vision_gap_s=(6.0, 16.0))), 16.0, extra)
    assert planar(track)[-1] < 0.05
    assert track[-1][1].health is NavHealth.GOOD


def test_markers_win_against_an_external_pose(make_ekf: Make) -> None:
    def extra(now: Look) -> list[Sample]:
        sample = external_of(now)
        return [replace(sample, pos_m=sample.pos_m + 1.0)] if now.t_us % 100_000 == 0 and now.t_us > 3_000_000 else []

    estimator = make_ekf()
    track = run(estimator, World(no_current), 8.0, extra)
    assert planar(track)[-1] < 0.02
    assert track[-1][1].reset_count == 0
    assert aid(estimator, "external")[-1] is AidState.REJECTING


def test_time_offsets_are_taken_off(vehicle: Vehicle) -> None:
    """Stamps that come out 40 ms late, and the same with the offset in the vehicle file."""

    def flown(offset_s: float) -> float:
        camera = msgspec.to_builtins(vehicle.camera) | {"time_offset_s": offset_s}
        estimator = create_ekf(mounted(vehicle, camera=camera), None, None)
        world = World(no_current)
        errors = []
        for truth, samples, command in world.run(10.0):
            shifted: list[Sample] = [
                replace(s, t_us=s.t_us + 40_000) if isinstance(s, PoseSample) else s for s in samples
            ]
            nav = estimator.step(truth.t_us, shifted, command)
            if nav is not None and truth.t_us > 4_000_000:
                errors.append(float(np.linalg.norm((nav.pos_ned_m - truth.pos)[:2])))
        return float(np.sqrt(np.mean(np.square(errors))))

    wrong, right = flown(0.0), flown(-0.04)
    assert right < 0.005
    assert wrong > 2.0 * right


def test_ahrs_lever_arm_leaves_no_centrifugal_force() -> None:
    """A sensor off the centre of a body that spins up feels forces which are not there at the centre."""
    lever = np.array([0.2, 0.1, -0.05])
    mount = AhrsMount((0.2, 0.1, -0.05))
    worst = 0.0
    for k in range(100):
        t = 0.01 * k
        rate, turn = np.array([0.1, -0.2, 1.5 * math.sin(t)]), np.array([0.0, 0.0, 1.5 * math.cos(t)])
        felt = np.array([0.0, 0.0, -9.81]) + np.cross(turn, lever) + np.cross(rate, np.cross(rate, lever))
        sample = AhrsSample(t_us=10_000 * k, rpy_rad=np.zeros(3), rate_frd_rad_s=rate, accel_frd_m_s2=felt)
        center = mount.at_center(sample)
        if k > 0:
            worst = max(worst, float(np.abs(center.accel_frd_m_s2 - [0.0, 0.0, -9.81]).max()))
    assert worst < 0.005


@pytest.mark.parametrize(
    ("range_m", "sigma_m", "confidence"),
    [(1e308, 1e4, 0.6), (1.0, 1e308, 1.0), (math.nan, 0.01, 1.0), (-1.0, 0.01, 1.0), (1.0, 0.01, math.inf)],
)
def test_what_no_altimeter_says_is_counted_as_malformed(
    range_m: float, sigma_m: float, confidence: float, vehicle: Vehicle
) -> None:
    estimator = create_ekf(vehicle, None, FLOOR_M)

    def extra(now: Look) -> list[Sample]:
        if now.t_us % 100_000:
            return []
        return [AltimeterSample(t_us=now.t_us, range_m=range_m, sigma_m=sigma_m, confidence=confidence)]

    run(estimator, World(no_current), 2.0, extra)
    counts = estimator.counters()
    assert counts["altimeter.malformed"] > 10 and counts["altimeter.fused"] == 0


def drawn_log(rng: np.random.Generator) -> Callable[[Look], list[Sample]]:
    """A Doppler log at 10 Hz as it comes from the shop, turned by as much as somebody sees by eye."""
    stated = DvlMount()
    turn = r_ned_from_frd(rng.normal(0.0, stated.heading_sigma_rad, 3))
    scale, bias = 1.0 + rng.normal(0.0, stated.scale_sigma), rng.normal(0.0, stated.bias_sigma_m_s, 3)

    def samples(now: Look) -> list[Sample]:
        if now.t_us % 100_000:
            return []
        exact = velocity_of(now)
        measured = scale * (turn @ exact.vel_frd_m_s) + bias + rng.normal(0.0, 0.005, 3)
        return [replace(exact, vel_frd_m_s=measured)]

    return samples


@pytest.mark.long
@pytest.mark.parametrize("create", [create_ekf, create_complementary])
def test_a_doppler_log_is_as_good_as_its_mounting(vehicle: Vehicle, create: Callable[..., AidedEstimator]) -> None:
    """On it alone for a while: the truth is where the estimate says that it may be, and fixes find it again."""
    inside, squares = [], []
    for seed in range(8):
        world = World(no_current, Faults(seed=seed, vision_gap_s=(4.0, 16.0)))
        estimator = create(vehicle, None, None)
        track = run(estimator, world, 17.0, drawn_log(np.random.default_rng((seed, 1))))
        gap = [(now, nav) for now, nav in track if 4.0 < 1e-6 * now.t_us < 16.0]
        error = np.array([nav.pos_ned_m - now.pos for now, nav in gap])
        in_sigmas = error / np.sqrt([nav.variance[:3] for _, nav in gap])
        inside.append((np.abs(in_sigmas) < 3.0).all(axis=1).mean())
        squares.append((in_sigmas**2).mean())
        assert estimator.counters()["resets"] == 0
        assert np.linalg.norm(track[-1][1].pos_ned_m - track[-1][0].pos) < 0.02
    assert np.mean(inside) > 0.95, inside
    assert np.mean(squares) < 2.0, squares


@given(st.floats(20.0, 400.0), st.floats(0.0, 0.4))
def test_parts_of_the_ahrs_are_measured_as_often_at_any_rate(rate_hz: float, jitter: float) -> None:
    """Stamps that are off by up to ``jitter`` of a period."""
    aid = HeadingAid()
    stamps_s = [(n + jitter * (-1) ** n) / rate_hz for n in range(round(40.0 * rate_hz))]
    due_s = [aid.due_s(after - before) for before, after in itertools.pairwise(stamps_s)]
    used_s = [passed_s for passed_s in due_s if passed_s]
    assert sum(used_s) == pytest.approx(40.0, abs=1.0)
    assert max(abs(passed_s - HEADING_EVERY_S) for passed_s in used_s) <= (0.5 + 3.0 * jitter) / rate_hz + 1e-9
