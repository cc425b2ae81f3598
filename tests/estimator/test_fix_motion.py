"""Fixes against dead reckoning: what moves with the vehicle is believed, what does not is named."""

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from makers import Make
from truth import Faults, Truth, World, no_current

from autopilot.core.frames import FloatArray, wrap_pi
from autopilot.core.messages import NavDoubt, NavHealth, NavState
from autopilot.core.samples import PoseSample, Sample
from autopilot.estimator.engine import AidedEstimator
from autopilot.estimator.estimator_tuning import FIX_MOTION
from autopilot.estimator.fix_motion import FLOOR, FixMotion, FixResidual, FixRun, plausible
from autopilot.estimator.fix_trust import PROBATION_US

BEGIN_US, END_US = 6_000_000, 9_000_000
DRIFT = np.array([0.02, 0.02, 0.02, 0.005]) ** 2
FIX = np.array([0.002, 0.002, 0.001, 0.001])


def run_of(
    rng: np.random.Generator, fixes: Callable[[FloatArray], FloatArray], count: int = 30, heave_m_s: float = 0.0
) -> FixRun:
    """Fixes (n, 4) made of the true way (n, 4), from which dead reckoning drifts.

    ``heave_m_s``: standard deviation of its vertical speed, for which the other sensors correct its depth at random."""
    t_s = np.arange(count) / 30.0
    speed, swing = rng.normal(0.0, 0.2, 4), rng.normal(0.0, 0.02, 4)
    reckoned = t_s[:, None] * speed + swing * np.sin(3.0 * t_s[:, None] + rng.uniform(0.0, 6.0, 4))
    z = fixes(reckoned + t_s[:, None] * rng.normal(0.0, np.sqrt(DRIFT))) + rng.normal(0.0, 1.0, (count, 4)) * np.sqrt(
        FIX**2 + FLOOR**2
    )
    y = z - reckoned
    drift = DRIFT
    if heave_m_s:
        y[:, 2] += np.cumsum(rng.normal(0.0, 0.03, count))
        drift = np.array([*DRIFT[:2], heave_m_s**2, DRIFT[3]])
    seen = [FixResidual(round(1e6 * t), z[k], y[k], FIX**2, drift, False) for k, t in enumerate(t_s)]
    motion = FixMotion()
    for each in seen:
        motion.add(each)
    run = motion.last(count=count)
    assert run is not None
    return run


def test_what_moves_with_the_vehicle_is_rarely_denied() -> None:
    """One in a thousand by the gate, fewer as errors count as alike over some fixes."""
    rng = np.random.default_rng(1)
    runs = [run_of(rng, lambda way: way + np.array([0.5, -0.2, 0.1, 0.0])) for _ in range(2000)]
    assert np.mean([run.apart > 1.0 for run in runs]) <= 0.003
    assert np.mean([run.follows for run in runs]) > 0.99
    assert np.mean([run.moves > FIX_MOTION.sure for run in runs]) > 0.97
    assert np.mean([run.moves < -FIX_MOTION.sure for run in runs]) == 0.0


def test_what_stands_still_or_goes_its_own_way_is_denied() -> None:
    rng = np.random.default_rng(2)
    still = [run_of(rng, lambda way: way * 0.0) for _ in range(500)]
    assert np.mean([run.follows for run in still]) < 0.02
    assert np.mean([run.follows and run.moves > FIX_MOTION.sure for run in still]) == 0.0
    other = [run_of(rng, lambda way: -way) for _ in range(500)]
    assert np.mean([run.follows for run in other]) < 0.02


def test_a_vertical_speed_that_nobody_knows_does_not_count() -> None:
    """Without a depth sensor, some seconds after the last fix: right fixes were not believed for ten seconds."""
    rng = np.random.default_rng(4)
    right = [run_of(rng, lambda way: way + np.array([0.5, -0.2, 0.1, 0.0]), heave_m_s=0.6) for _ in range(500)]
    assert np.mean([run.follows for run in right]) > 0.99
    assert np.mean([run.moves > FIX_MOTION.sure for run in right]) > 0.95
    still = [run_of(rng, lambda way: way * 0.0, heave_m_s=0.6) for _ in range(500)]
    assert np.mean([run.follows for run in still]) < 0.03
    assert np.mean([run.moves > FIX_MOTION.sure for run in still]) == 0.0


def test_a_wrong_heading_of_dead_reckoning_turns_its_way() -> None:
    """After a gap the heading may be off by a lot: fixes that are right are not denied for it."""
    rng = np.random.default_rng(3)

    def turned(way: FloatArray) -> FloatArray:
        c, s = math.cos(1.2), math.sin(1.2)
        result = way + np.array([0.3, 0.1, 0.0, 1.2])
        result[:, 0], result[:, 1] = c * way[:, 0] - s * way[:, 1], s * way[:, 0] + c * way[:, 1]
        return result

    runs = [run_of(rng, turned) for _ in range(300)]
    assert np.mean([run.follows for run in runs]) > 0.97
    assert runs[0].turned_rad == pytest.approx(1.2, abs=0.05)


def test_one_run_covers_errors_that_are_alike() -> None:
    assert FIX_MOTION.alike >= 1.0
    assert plausible(np.array([0.3, 0.2, 0.0, 0.02]), FIX**2, np.full(4, 0.05**2), 3.0)
    assert not plausible(np.array([0.3, 0.2, 0.0, 1.5]), FIX**2, np.full(4, 0.05**2), 3.0), "gyros do not lose that"


Alter = Callable[[PoseSample, Truth], PoseSample]


def fly(estimator: AidedEstimator, alter: Alter, seconds: float = 15.0, seed: int = 1) -> list[tuple[Truth, NavState]]:
    """The tour with poses altered by ``alter`` from 6 to 9 s."""
    world, track = World(no_current, Faults(seed=seed)), []
    for truth, samples, command in world.run(seconds):
        given: list[Sample] = [
            alter(s, truth) if isinstance(s, PoseSample) and BEGIN_US <= s.t_us < END_US else s for s in samples
        ]
        nav = estimator.step(truth.t_us, given, command)
        if nav is not None:
            track.append((truth, nav))
    return track


class Frozen:
    """The first pose again and again, with noise of its own."""

    def __init__(self) -> None:
        self._first: PoseSample | None = None
        self._rng = np.random.default_rng(5)

    def __call__(self, sample: PoseSample, truth: Truth) -> PoseSample:
        first = self._first = self._first or sample
        pos = first.pos_ned_m + self._rng.normal(0.0, 0.001, 3)
        return replace(sample, pos_ned_m=pos, yaw_rad=first.yaw_rad)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_frozen_fixes_do_not_relocate(make_ekf: Make, seed: int) -> None:
    estimator = make_ekf()
    track = fly(estimator, Frozen(), seed=seed)
    counts = estimator.counters()
    assert counts["resets"] <= 1 and counts["doubt.camera"] == 1
    assert counts["doubt.accel"] == counts["doubt.gyro"] == 0, "the camera deviates, no other"
    for truth, nav in track:
        if nav.t_us < END_US:
            assert nav.reset_count == 0
        if BEGIN_US + 500_000 < nav.t_us < END_US:
            assert nav.health is not NavHealth.GOOD
        if BEGIN_US + 1_000_000 < nav.t_us < END_US:
            assert NavDoubt.CAMERA in nav.doubts and NavDoubt.FIXES not in nav.doubts
        assert np.linalg.norm(nav.pos_ned_m - truth.pos) < 0.2
        assert abs(wrap_pi(float(nav.rpy_rad[2]) - truth.yaw)) < math.radians(3.0)
    back = [nav for _, nav in track if nav.t_us > END_US + 2_000_000]
    assert np.linalg.norm(back[0].pos_ned_m - {n.t_us: t for t, n in track}[back[0].t_us].pos) < 0.03
    good = [nav.t_us for nav in back if nav.health is NavHealth.GOOD]
    assert good and good[0] <= END_US + PROBATION_US + 2_000_000 and len(good) > 100


def test_all_fixes_shifted_relocate_once_and_name_the_camera(make_ekf: Make) -> None:
    """There is one reset, for good: the same again within 3 s and the camera is not believed."""
    estimator = make_ekf()

    def shift(sample: PoseSample, truth: Truth) -> PoseSample:
        far = sample.t_us < BEGIN_US + 1_200_000
        return replace(sample, pos_ned_m=sample.pos_ned_m + np.array([0.5 if far else -0.4, 0.0, 0.0]))

    track = fly(estimator, shift)
    jumped = [nav for _, nav in track if nav.reset_count == 1]
    assert BEGIN_US + 300_000 < jumped[0].t_us < BEGIN_US + 700_000
    assert {NavDoubt.CAMERA, NavDoubt.FIXES} <= jumped[0].doubts and jumped[0].variance[1] >= 0.2, "in any direction"
    assert estimator.counters()["doubt.camera"] >= 1
    resets = [nav.t_us for (_, before), (_, nav) in pairwise(track) if nav.reset_count > before.reset_count]
    assert len(resets) <= 3 and not [t for t in resets if BEGIN_US + 1_200_000 < t < BEGIN_US + 2_200_000]
    for _, nav in track:
        if BEGIN_US + 500_000 < nav.t_us < END_US:
            assert nav.health is not NavHealth.GOOD
    truth, last = track[-1]
    assert np.linalg.norm(last.pos_ned_m - truth.pos) < 0.02


def test_a_far_jump_after_a_gap_needs_more_than_three_fixes(make_ekf: Make) -> None:
    """A heading that is 90 deg off after two seconds without a fix: gyros do not lose that."""
    estimator = make_ekf()
    rng = np.random.default_rng(4)

    def wrong(sample: PoseSample, truth: Truth) -> PoseSample:
        if sample.t_us < END_US - 1_000_000:  # no fixes at all: malformed
            return replace(sample, sigma_yaw_rad=math.nan)
        pos = np.array([0.4, 0.2, 0.5]) + rng.normal(0.0, 0.02, 3)
        return replace(sample, pos_ned_m=pos, yaw_rad=wrap_pi(truth.yaw + 1.6), sigma_pos_m=np.full(3, 0.02))

    track = fly(estimator, wrong)
    assert estimator.counters()["resets"] <= 1
    for truth, nav in track:
        if END_US - 1_000_000 < nav.t_us < END_US + 200_000:
            assert abs(wrap_pi(float(nav.rpy_rad[2]) - truth.yaw)) < math.radians(5.0)
            assert nav.health is not NavHealth.GOOD
