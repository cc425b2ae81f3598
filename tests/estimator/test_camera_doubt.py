"""A calibration of yesterday: stamps that are late, a focal length that is off, and what the files say of both."""

import math
from dataclasses import replace

import msgspec
import numpy as np
import pytest
from laid_world import VEHICLE, LaidWorld, flown
from makers import Make
from truth import Track, rms

from autopilot.core.camera import CameraModel
from autopilot.core.frames import FloatArray, r_ned_from_frd
from autopilot.core.markers import MarkerMap
from autopilot.core.messages import NavDoubt, NavHealth
from autopilot.core.samples import MarkerSighting, PoseSample
from autopilot.core.vehicle import DISTORTION_SIGMA, FOCAL_SIGMA, load_vehicle
from autopilot.estimator.camera_monitor import CameraMonitor, focal_estimate
from autopilot.estimator.ekf import create_ekf
from autopilot.estimator.history import Node
from autopilot.estimator.inertial import Inertial
from autopilot.estimator.measurement import Moment
from autopilot.estimator.states import NX, FilterState
from tests.bench.calibrations import drawn, uncertain_map, with_camera

SOME = np.random.default_rng(20261122)
GENTLE_US, GENTLE_SHARE = 4_000_000, 0.05
JUMP_US = 8_000_000
"""When a camera's clock is set."""


def nees(track: Track, columns: slice) -> float:
    """Mean squared distance per coordinate, by the variance that is told."""
    variance = np.array([nav.variance[columns] for nav in track.nav])
    return float((track.pos_error()[:, columns] ** 2 / variance).mean())


@pytest.mark.parametrize("tilt_deg", [0.0, 3.5])
def test_a_tilted_camera_is_named(make_ekf: Make, floor: MarkerMap, tilt_deg: float) -> None:
    camera = CameraModel.of_vehicle(VEHICLE)
    tilted = camera.r_frd_from_cam @ r_ned_from_frd(np.array([math.radians(tilt_deg), 0.0, 0.0]))
    world = LaidWorld(floor, 9, camera=replace(camera, r_frd_from_cam=tilted))
    _, remarks = flown(make_ekf(markers=floor), world, 6.0)
    assert [text.startswith("Camera and AHRS tilt differ") for text in remarks] == [True] * (tilt_deg > 0.0)


def test_markers_that_fit_nowhere_on_the_map_are_named_once(make_ekf: Make, floor: MarkerMap) -> None:
    """Printed four fifths of their size, or of another floor: there was no position, and no word why."""
    middles = floor.corners_ned_m.mean(axis=1, keepdims=True)
    small = replace(floor, corners_ned_m=middles + 0.8 * (floor.corners_ned_m - middles))
    other = replace(floor, ids=np.random.default_rng(1).permutation(floor.ids))
    # Each turned by a quarter: what showed a single one later on was a good position, 1.6 m off.
    quarter = replace(floor, corners_ned_m=np.roll(floor.corners_ned_m, 1, axis=1))
    for true, seconds in ((small, 4.0), (other, 4.0), (quarter, 8.0)):
        track, texts = flown(make_ekf(markers=floor), LaidWorld(true, 5), seconds)
        assert not track.nav and texts == ["Markers in view do not fit the map: check size_m"]


@pytest.mark.parametrize("late_ms", [*(round(float(ms), 1) for ms in SOME.uniform(8.0, 130.0, 2)), -25.0])
def test_late_stamps_are_found_and_put_right(make_ekf: Make, floor: MarkerMap, late_ms: float) -> None:
    estimator = make_ekf(markers=floor)
    world = LaidWorld(floor, round(100 + late_ms), stamped_late_us=round(1e3 * late_ms))
    track, told = flown(estimator, world, 6.0)
    assert len(told) == 1
    words = told[0].split()
    assert told[0].startswith("Picture stamps ")
    assert told[0].endswith("ms late: calibrate latency" if late_ms > 0.0 else "ms early, or AHRS late: check")
    assert len(told[0]) <= 50
    # The world's Euler steps put it 2.5 ms ahead of its gyro.
    assert float(words[2]) == pytest.approx(abs(late_ms), abs=5.0)
    assert NavDoubt.CALIBRATION in track.nav[-1].doubts
    assert not any({NavDoubt.GYRO, NavDoubt.ACCELEROMETER} & nav.doubts for nav in track.nav)
    after = track.after(4.0)
    assert after.nav[0].reset_count == after.nav[-1].reset_count
    assert rms(after.pos_error()[:, :2]) < 0.003
    assert math.degrees(np.abs(after.yaw_error()).max()) < 0.3
    assert nees(after, slice(0, 2)) < 4.0


@pytest.mark.parametrize("late_ms", [9.5, -7.0])
def test_a_calibration_in_doubt_is_named(make_ekf: Make, floor: MarkerMap, late_ms: float) -> None:
    """Stamps about as late as is worth telling: what is found is not sure at once, and may never be."""
    estimator, told = make_ekf(markers=floor), False
    for truth, samples, command in LaidWorld(floor, 31, stamped_late_us=round(1e3 * late_ms)).run(5.0):
        nav = estimator.step(truth.t_us, samples, command)
        told |= bool(estimator.take_remarks())
        assert nav is None or told is (NavDoubt.CALIBRATION in nav.doubts)


def test_stamps_from_the_future_are_late(make_ekf: Make, floor: MarkerMap) -> None:
    """The driver adds what it should take off: pictures arrive before their stamps."""
    estimator = make_ekf(markers=floor)
    track, told = flown(estimator, LaidWorld(floor, 21, stamped_late_us=110_000, ahead=True), 5.0)
    assert [text.split()[:2] for text in told] == [["Picture", "stamps"]]
    assert float(told[0].split()[2]) == pytest.approx(110.0, abs=5.0)
    assert rms(track.after(4.0).pos_error()[:, :2]) < 0.003


def test_good_stamps_are_not_suspected(make_ekf: Make, floor: MarkerMap) -> None:
    estimator = make_ekf(markers=floor)
    track, told = flown(estimator, LaidWorld(floor, 12), 5.0)
    assert told == []
    assert not any(nav.doubts for nav in track.nav)
    counts = estimator.counters()
    assert counts["stamps.retimed"] == counts["focal.rescaled"] == 0
    assert rms(track.after(2.0).pos_error()[:, :2]) < 0.001


class JumpingWorld(LaidWorld):
    """The camera's clock is set in flight: from then on its stamps are later by ``by_us``."""

    def __init__(self, floor: MarkerMap, seed: int, by_us: int) -> None:
        super().__init__(floor, seed)
        self.by_us = by_us

    def _look(self, t: float) -> None:
        self._late_us = self.by_us if self.t_us >= JUMP_US else 0
        super()._look(t)


@pytest.mark.parametrize("by_ms", [int(sign * SOME.integers(40, 180)) for sign in (1, -1)])
def test_stamps_that_jump_in_flight_are_told_within_seconds(make_ekf: Make, floor: MarkerMap, by_ms: int) -> None:
    """However long they were good before; and nothing is called good meanwhile that is not."""
    estimator = make_ekf(markers=floor)
    world, told, silent, last = JumpingWorld(floor, 31, 1000 * by_ms), [], 0, None
    for truth, samples, command in world.run(1e-6 * JUMP_US + 6.0):
        nav = estimator.step(truth.t_us, samples, command)
        told += [(truth.t_us, text) for text in estimator.take_remarks()]
        if nav is None:
            continue
        last = math.hypot(*(nav.pos_ned_m - truth.pos)[:2])
        off = last > 3.7 * math.sqrt(float(nav.variance[:2].max()))  # 99.9 % in the plane
        silent += nav.health is NavHealth.GOOD and off
    first_us, text = told[0]
    assert JUMP_US < first_us < JUMP_US + 4_500_000
    jumped, rest = text.removeprefix("Picture stamps jumped ").split(" ms: ")
    assert float(jumped) == pytest.approx(by_ms, abs=20.0)
    assert rest == ("check its clock" if by_ms > 0 else "check clock, AHRS")
    assert NavDoubt.CALIBRATION in estimator.doubts
    assert silent < 50, "called good for half a second in which it was not"
    assert last is not None and last < 0.003
    assert estimator.counters()["stamps.retimed"] <= 4


class GentleWorld(LaidWorld):
    """It moves little at first: that shows that stamps are not far off, and not yet by how much."""

    def _command(self) -> FloatArray:
        share = GENTLE_SHARE if self.t_us < GENTLE_US else 1.0
        return np.array([share, share, 1.0, share]) * super()._command()


@pytest.mark.parametrize("late_ms", [18, 26, 34])
def test_stamps_that_were_late_from_the_first_have_not_jumped(make_ekf: Make, floor: MarkerMap, late_ms: int) -> None:
    _, told = flown(make_ekf(markers=floor), GentleWorld(floor, late_ms, stamped_late_us=1000 * late_ms), 8.0)
    assert [" ms late: " in text for text in told] == [True]


def test_pictures_that_only_come_later_are_no_jump(make_ekf: Make, floor: MarkerMap) -> None:
    """A busy machine: the stamps are right, the results are late."""
    estimator, told = make_ekf(markers=floor), []
    world = LaidWorld(floor, 33)
    for truth, samples, command in world.run(10.0):
        nav = estimator.step(truth.t_us, samples, command)
        told += estimator.take_remarks()
        world._latency_us = 60_000 if truth.t_us < 4_000_000 or truth.t_us > 7_000_000 else 180_000
        assert nav is None or not nav.doubts
    assert told == []


def test_without_pictures_no_camera_is_blamed() -> None:
    watch = CameraMonitor(VEHICLE.camera)
    watch.stamps.late_s, watch.stamps.sigma_s = 0.06, 0.001
    watch.check_stamps()
    assert watch.take_texts() == ("Pose stamps 60 ms late: calibrate latency",)


def test_at_rest_nothing_is_found(make_ekf: Make, floor: MarkerMap) -> None:
    estimator = make_ekf(markers=floor)
    world = LaidWorld(floor, 22, stamped_late_us=60_000, rest_us=10_000_000)
    _, told = flown(estimator, world, 4.0)
    assert told == []
    assert estimator.counters()["stamps.retimed"] == 0


def test_poses_of_pictures_keep_the_stamps_of_the_pictures(make_ekf: Make, floor: MarkerMap) -> None:
    """What the other estimator gets says nothing of what this one thinks of stamps."""
    estimator, stamps, made = make_ekf(markers=floor), set(), set()
    for truth, samples, command in LaidWorld(floor, 23, stamped_late_us=40_000).run(3.0):
        estimator.step(truth.t_us, samples, command)
        stamps |= {s.t_us for s in samples if isinstance(s, MarkerSighting)}
        made |= {s.t_us for s in estimator.take_made() if isinstance(s, PoseSample)}
    assert estimator.counters()["stamps.retimed"] > 0
    assert len(made) > 60
    assert made <= stamps


@pytest.mark.parametrize("percent", [*(round(float(p), 1) for p in SOME.uniform(-4.0, -1.5, 1)), 5.0])
def test_a_wrong_focal_length_is_named_and_put_right(floor: MarkerMap, percent: float) -> None:
    focal = tuple((1.0 + 0.01 * percent) * f for f in VEHICLE.camera.focal_px)
    vehicle = with_camera(VEHICLE, focal_px=focal, focal_sigma=0.04, distortion_sigma=0.008)
    estimator = create_ekf(vehicle, floor, 1.5)
    track, told = flown(estimator, LaidWorld(floor, 13), 6.0)
    what = "long" if percent > 0.0 else "short"
    named = [text for text in told if text.startswith("Focal length ")]
    assert len(named) == 1
    assert named[0].endswith(f"% too {what}: recalibrate camera")
    assert float(named[0].split()[2]) == pytest.approx(abs(percent), rel=0.15)
    assert len(named[0]) <= 50
    assert not track.nav[-1].doubts, "the file said that it may be so far off"
    after = track.after(5.0)
    assert np.abs(after.pos_error()[:, 2]).max() < 0.003, "it was 10 to 50 mm"
    assert nees(after, slice(2, 3)) < 4.0
    assert rms(after.pos_error()[:, :2]) < 0.002


@pytest.mark.parametrize(
    ("share", "stated", "focal_sigma"),
    [
        (0.015, 0.008, FOCAL_SIGMA),
        (-0.2, DISTORTION_SIGMA, FOCAL_SIGMA),
        (0.2, DISTORTION_SIGMA, 0.0),
    ],
)
def test_a_distortion_that_is_off_is_not_taken_for_a_focal_length(
    floor: MarkerMap, share: float, stated: float, focal_sigma: float
) -> None:
    """It leaves the pattern of a wrong focal length: the height is off by no more than the variance says."""
    distortion = tuple((1.0 + share) * k for k in VEHICLE.camera.distortion)
    vehicle = with_camera(VEHICLE, distortion=distortion, distortion_sigma=stated, focal_sigma=focal_sigma)
    track, told = flown(create_ekf(vehicle, floor, 1.5), LaidWorld(floor, 15), 5.0)
    assert nees(track.after(1.0), slice(2, 3)) < 9.0
    assert rms(track.after(4.5).pos_error()) < 0.02, "20 % of distortion were 90 mm of height"
    assert not any(nav.doubts for nav in track.nav)
    assert [text.split(" % ")[1] for text in told] == (["off: calibrate camera"] if abs(share) > 0.1 else [])


class ZoomingWorld(LaidWorld):
    """The focal length grows by a share in flight."""

    share = 0.0

    def _look(self, t: float) -> None:
        before = len(self.pending)
        super()._look(t)
        if self.t_us >= JUMP_US // 2:
            center = np.array(VEHICLE.eye.center_px)
            for n in range(before, len(self.pending)):
                due_us, seen = self.pending[n]
                grown = center + (1.0 + self.share) * (seen.corners_px - center)
                self.pending[n] = (due_us, replace(seen, corners_px=grown))


@pytest.mark.parametrize("share", [0.03, -0.05])
def test_a_lens_that_changes_in_flight_is_in_doubt_and_followed(floor: MarkerMap, share: float) -> None:
    """However little of its calibration is known: that is no error of it."""
    world = ZoomingWorld(floor, 17)
    world.share = share
    track, told = flown(create_ekf(load_vehicle("lbv150"), floor, 1.5), world, 12.0)
    changed_us = JUMP_US // 2
    before = [nav for nav in track.nav if nav.t_us < changed_us]
    assert not any(nav.doubts for nav in before)
    doubted = [nav.t_us for nav in track.nav if NavDoubt.CALIBRATION in nav.doubts]
    assert doubted[0] - changed_us < 4_000_000
    assert track.nav[-1].t_us == doubted[-1]
    assert told[-1].startswith("Focal length ")
    assert np.abs(track.after(11.0).pos_error()[:, 2]).max() < 0.02, "3 to 5 % of the height are 30 to 50 mm"


@pytest.mark.parametrize("percent", [-2.0, 3.0])
def test_a_lens_that_is_not_what_its_file_says_is_in_doubt(floor: MarkerMap, percent: float) -> None:
    focal = tuple((1.0 + 0.01 * percent) * f for f in VEHICLE.camera.focal_px)
    vehicle = with_camera(VEHICLE, focal_px=focal, focal_sigma=0.002, distortion_sigma=0.008)
    track, told = flown(create_ekf(vehicle, floor, 1.5), LaidWorld(floor, 16), 4.0)
    assert NavDoubt.CALIBRATION in track.nav[-1].doubts
    assert len(told) == 1


def test_a_lens_that_does_not_bend_tells_nothing() -> None:
    straight = CameraModel.of(msgspec.structs.replace(VEHICLE.camera, distortion=(0.0,) * 5), VEHICLE.laser)
    rng = np.random.default_rng(1)
    x, y = rng.uniform(-300.0, 300.0, (2, 40))
    pixels = np.column_stack((x, y)) + np.array(straight.center_px)
    jacobian = np.zeros((80, 3))
    jacobian[0::2, 0] = jacobian[1::2, 1] = 1.0
    jacobian[:, 2] = (pixels - np.array(straight.center_px)).reshape(-1)  # height
    for noise_px in (0.0, 0.1, 1.0):
        off = rng.normal(0.0, noise_px, 80)
        assert focal_estimate(straight, pixels + off.reshape(-1, 2), off, jacobian) is None


def test_what_pictures_say_of_the_focal_length_counts_before_it_is_sure() -> None:
    camera = with_camera(VEHICLE, focal_sigma=0.04, distortion_sigma=0.008).eye
    watch = CameraMonitor(camera, floor_m=1.0 + camera.position_frd_m[2])
    watch.note_picture()
    assert not watch.update_focal(0.02, 0.005)
    still = Inertial(0, 0.0, 0.0, 0.0, 0.0, (0.0, 0.0, 0.0), np.zeros(3), (0.0, 0.0), True)
    node = Node(0, Moment(still, (0.0,) * 4), None, FilterState(np.zeros(NX), np.eye(NX)))
    variance = watch.systematic_variance(0, node)
    assert math.sqrt(variance[2]) == pytest.approx(math.hypot(0.04, 0.02), rel=0.05)
    assert watch.take_texts() == ()


def test_what_calibration_leaves_open_is_in_the_variance(floor: MarkerMap) -> None:
    """As the ``calibrate`` commands write it."""
    open_ = {
        "focal_sigma": 0.01,
        "time_offset_sigma_s": 0.02,
        "position_sigma_m": (0.003, 0.004, 0.005),
        "mounting_sigma_rad": (0.01, 0.02, 0.03),
    }
    variance = []
    for vehicle in (VEHICLE, with_camera(VEHICLE, **open_)):
        estimator = create_ekf(vehicle, floor, 1.5)
        track, _ = flown(estimator, LaidWorld(floor, 14), 4.0)
        variance.append(track.nav[-1].variance)
        speed = float(np.linalg.norm(track.truth[-1].vel[:2]))
        height = 1.5 - float(track.truth[-1].pos[2]) - VEHICLE.camera.position_frd_m[2]
    more = variance[1] - variance[0]
    arm = VEHICLE.camera.position_frd_m[2]
    assert more[2] == pytest.approx((0.01 * height) ** 2 + 0.005**2, rel=0.2)
    across = (0.02 * speed) ** 2 + 0.003**2 + 0.004**2 + (0.01**2 + 0.02**2) * arm**2
    assert more[0] + more[1] == pytest.approx(across, rel=0.1)
    assert more[5] > 0.03**2


def test_nobodys_calibration_is_perfect(floor: MarkerMap) -> None:
    """The truth is where the estimate says that it may be, whatever a person with a ruler did."""
    inside, squares = [], []
    for seed in range(10):
        told = drawn(uncertain_map(floor), np.random.default_rng(1000 + seed))
        world = LaidWorld(floor, seed, stamped_late_us=told.late_us)
        track, _ = flown(create_ekf(told.vehicle, told.markers, 1.5), world, 4.0)
        error = np.column_stack((track.pos_error(), track.yaw_error()))
        in_sigmas = error / np.sqrt([nav.variance[[0, 1, 2, 5]] for nav in track.nav])
        inside.append((np.abs(in_sigmas) < 3.0).all(axis=1).mean())
        squares.append((in_sigmas**2).mean())
    assert np.mean(inside) > 0.95, inside
    assert 0.4 < np.mean(squares) < 2.0, squares


@pytest.mark.parametrize(("scatter_s", "late_us"), [(0.003, 15_000), (0.02, 0), (0.02, 15_000)])
def test_stamps_that_scatter_are_no_doubt(make_ekf: Make, floor: MarkerMap, scatter_s: float, late_us: int) -> None:
    """A camera of a network, stamped by arrival: a few millimetres more, and nothing is suspected."""
    estimator = make_ekf(markers=floor)
    world = LaidWorld(floor, 11, scatter_s=scatter_s, stamped_late_us=late_us)
    track, remarks = flown(estimator, world, 20.0)
    track = track.after(3.0)
    assert estimator.counters()["resets"] == 0
    assert estimator.counters()["markers.rejected"] < 20, "of 500"
    assert not any(nav.doubts for nav in track.nav)
    assert all("stamps" in text for text in remarks)
    error = track.pos_error()[:, :2]
    assert np.abs(error).max() < 0.02 + 0.3 * 1e-6 * late_us
