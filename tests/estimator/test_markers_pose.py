"""From corners to a pose: least squares, association with repeated ids, vote at start-up, all the way to a state."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from makers import Make
from truth import Faults, World, no_current, tank_jet

from autopilot.core.camera import CameraModel
from autopilot.core.frames import FloatArray, r_ned_from_frd, wrap_pi
from autopilot.core.markers import MarkerMap
from autopilot.core.messages import NavHealth
from autopilot.core.samples import MarkerSighting, Sample
from autopilot.core.vehicle import Vehicle, load_vehicle
from autopilot.estimator.estimator_tuning import PNP
from autopilot.estimator.history import Node
from autopilot.estimator.inertial import Inertial
from autopilot.estimator.markers_pose import MarkerSolver
from autopilot.estimator.measure_markers import MarkersAid
from autopilot.estimator.measurement import Moment
from autopilot.estimator.pictures import Pictures
from autopilot.estimator.pnp import inward_of, solve_pose
from autopilot.estimator.states import NX, POS, FilterState
from autopilot.sitl.floor import given_markers
from autopilot.sitl.scenario import load_scenario
from tests.bench.calibrations import calibrated

VEHICLE = calibrated()
CAMERA = CameraModel.of_vehicle(VEHICLE)


def sight(
    floor: MarkerMap,
    pos: FloatArray,
    rpy: FloatArray,
    rng: np.random.Generator,
    sigma_px: float = 0.15,
    t_us: int = 0,
    most: int = 1000,
    camera: CameraModel = CAMERA,
) -> MarkerSighting:
    """What a perfect detector would say of this pose, in random order."""
    r = r_ned_from_frd(rpy)
    seen = rng.permutation(floor.visible(camera, pos, r))[:most]
    pixels = camera.project(camera.cam_from_ned(floor.corners_ned_m[seen], pos, r))
    laser_origin = pos + r @ np.array(VEHICLE.laser.position_frd_m)
    laser = camera.laser_pixel((1.5 - laser_origin[2]) / r[2, 2])
    return MarkerSighting(
        t_us=t_us,
        ids=tuple(int(i) for i in floor.ids[seen]),
        corners_px=pixels + rng.normal(0.0, sigma_px, pixels.shape),
        laser_px=laser if bool(camera.inside(laser)) else None,
    )


@settings(max_examples=40)
@given(
    st.floats(-2.0, 2.0),
    st.floats(-1.0, 1.0),
    st.floats(0.3, 0.95),
    st.floats(-math.pi, math.pi),
    st.floats(-0.05, 0.05),
    st.floats(-0.05, 0.05),
    st.integers(0, 10_000),
)
def test_pose_from_anywhere(
    floor: MarkerMap, n: float, e: float, d: float, yaw: float, roll: float, pitch: float, seed: int
) -> None:
    """With and without a prediction, and although ids repeat, to millimetres and within the stated covariance."""
    rng = np.random.default_rng(seed)
    solver = MarkerSolver(CAMERA, floor)
    pos, rpy = np.array([n, e, d]), np.array([roll, pitch, yaw])
    sighting = sight(floor, pos, rpy, rng)
    tracked = solver.track(sighting, pos + rng.normal(0.0, 0.03, 3), rpy + rng.normal(0.0, 0.01, 3))
    located = solver.locate(sighting, roll + 0.01, pitch - 0.01)
    for fix in (tracked, located):
        assert fix is not None
        error = np.append(fix.z[:3] - pos, wrap_pi(float(fix.z[3]) - yaw))
        assert float(error @ np.linalg.solve(fix.noise, error)) < 30.0
        assert np.abs(error[:3]).max() < 0.02
        assert abs(error[3]) < math.radians(0.6)


def test_covariance_is_not_optimistic(floor: MarkerMap) -> None:
    rng = np.random.default_rng(5)
    solver = MarkerSolver(CAMERA, floor)
    values, tilts = [], []
    for _ in range(60):
        pos = np.array([rng.uniform(-1.8, 1.8), rng.uniform(-0.9, 0.9), 0.5])
        rpy = np.array([*rng.normal(0.0, 0.02, 2), rng.uniform(-3.0, 3.0)])
        fix = solver.track(sight(floor, pos, rpy, rng, sigma_px=0.3), pos + 0.01, rpy)
        assert fix is not None and fix.tilt_rad is not None
        error = np.append(fix.z[:3] - pos, wrap_pi(float(fix.z[3] - rpy[2])))
        values.append(float(error @ np.linalg.solve(fix.noise, error)))
        tilts.append(fix.tilt_rad[0] - rpy[0])
    assert 0.5 < np.mean(values) < 4.5
    assert math.degrees(float(np.std(tilts))) < 0.15


def test_one_marker_leans_on_the_ahrs_tilt(floor: MarkerMap) -> None:
    rng = np.random.default_rng(2)
    solver = MarkerSolver(CAMERA, floor)
    errors = []
    for _ in range(30):
        pos = np.array([rng.uniform(-1.5, 1.5), rng.uniform(-0.8, 0.8), 0.9])
        rpy = np.array([0.01, -0.02, rng.uniform(-3.0, 3.0)])
        fix = solver.track(sight(floor, pos, rpy, rng, most=1), pos + 0.02, rpy)
        assert fix is not None
        errors.append(fix.z[:3] - pos)
        assert fix.noise[0, 0] > 0.002**2
    assert float(np.abs(errors).max()) < 0.03


@pytest.mark.parametrize("most", [1, 2])
def test_few_large_markers_show_the_tilt_however_wrong_the_ahrs_is(most: int) -> None:
    """To within the stated variance, of which the AHRS's error has its share."""
    vehicle, floor = load_vehicle("bluerov2"), given_markers(load_scenario("pool"))
    assert floor is not None
    camera, rng, values = CameraModel.of_vehicle(vehicle), np.random.default_rng(8), []
    solver = MarkerSolver(camera, floor)
    for _ in range(80):
        pos = np.array([*rng.uniform(-2.0, 2.0, 2), 1.15])
        rpy = np.array([0.0, 0.15, rng.uniform(-3.0, 3.0)])
        wrong = rpy + np.array([*rng.normal(0.0, 0.009, 2), 0.0])
        seen = sight(floor, pos, rpy, rng, 0.1, most=most, camera=camera)
        blurred = seen.corners_px + PNP.shrink_px * inward_of(seen.corners_px).reshape(-1, 4, 2)
        fix = solver.track(replace(seen, corners_px=blurred), pos, wrong)
        if fix is not None:
            error = np.append(fix.z[:3] - pos, wrap_pi(float(fix.z[3] - rpy[2])))
            values.append(float(error @ np.linalg.solve(fix.noise, error)))
    assert len(values) > 60
    assert np.mean(values) < 4.0 and np.max(values) < 20.0


@pytest.mark.parametrize(("most", "ratio"), [(1, 4.0), (2, 4.0), (3, 1.0)])
def test_few_markers_weigh_as_one_picture_of_a_series(floor: MarkerMap, most: int, ratio: float) -> None:
    """What they leave open is alike in the next pictures: a filter that took it for noise would be too sure of it."""
    pos, solver = np.array([0.2, -0.3, 0.9]), MarkerSolver(CAMERA, floor)
    level = Inertial(0, 0.0, 0.0, 0.0, 0.0, (0.0, 0.0, 0.0), np.zeros(3), (0.0, 0.0), True)
    x = np.zeros(NX)
    x[POS] = pos
    node = Node(0, Moment(level, (0.0,) * 4), None, FilterState(x, np.eye(NX)))
    seen = sight(floor, pos, np.zeros(3), np.random.default_rng(4), most=most)
    alone, fused = solver.track(seen, pos, np.zeros(3)), MarkersAid(Pictures(VEHICLE, solver)).fix(seen, node)
    assert alone is not None and fused is not None
    assert fused.noise == pytest.approx(ratio * alone.noise)
    assert fused.sigma_tilt_rad == pytest.approx(math.sqrt(ratio) * alone.sigma_tilt_rad)


def test_false_markers_are_left_out(floor: MarkerMap) -> None:
    rng = np.random.default_rng(3)
    solver = MarkerSolver(CAMERA, floor)
    pos, rpy = np.array([0.2, -0.3, 0.5]), np.array([0.0, 0.0, 1.0])
    good = sight(floor, pos, rpy, rng)
    corners = good.corners_px.copy()
    corners[0] += 25.0
    corners[1, 2] += 9.0
    ids = list(good.ids)
    ids[2] = int(floor.ids[0])
    ids[3] = 100_000
    bad = MarkerSighting(t_us=0, ids=tuple(ids), corners_px=corners, laser_px=None)
    for fix in (solver.track(bad, pos + 0.02, rpy), solver.locate(bad, 0.0, 0.0)):
        assert fix is not None
        assert np.abs(fix.z[:3] - pos).max() < 0.004


def test_nothing_from_nonsense(floor: MarkerMap) -> None:
    rng = np.random.default_rng(4)
    solver = MarkerSolver(CAMERA, floor)
    pos, rpy = np.array([0.0, 0.0, 0.5]), np.zeros(3)
    for _ in range(20):
        n = int(rng.integers(1, 20))
        ids = tuple(int(i) for i in rng.integers(0, 1000, n))
        noise = MarkerSighting(t_us=0, ids=ids, corners_px=rng.uniform(0.0, 480.0, (n, 4, 2)), laser_px=None)
        assert solver.locate(noise, 0.0, 0.0) is None
        solver.track(noise, pos, rpy)
    empty = MarkerSighting(t_us=0, ids=(), corners_px=np.empty((0, 4, 2)), laser_px=None)
    assert solver.track(empty, pos, rpy) is None
    assert solver.locate(empty, 0.0, 0.0) is None
    flat = MarkerSighting(t_us=0, ids=(1, 2), corners_px=np.zeros((2, 4, 2)), laser_px=None)
    assert solver.locate(flat, 0.0, 0.0) is None
    assert solver.track(flat, pos, rpy) is None


def test_solver_gives_up_behind_the_camera(floor: MarkerMap) -> None:
    points = floor.corners_ned_m[:3].reshape(-1, 3)
    assert solve_pose(CAMERA, points, np.full((12, 2), 200.0), np.array([0.0, 0.0, 2.0]), np.zeros(3), 9.0) is None


def test_laser_range_from_the_dot(floor: MarkerMap) -> None:
    solver = MarkerSolver(CAMERA, floor)
    for range_m in (0.3, 0.6, 1.1):
        dot = CAMERA.laser_pixel(range_m)
        found = solver.laser_range(MarkerSighting(t_us=0, ids=(), corners_px=np.empty((0, 4, 2)), laser_px=dot))
        assert found is not None
        assert found[0] == pytest.approx(range_m, abs=1e-4)
        assert 0.0 < found[1] < 0.06
        off = MarkerSighting(t_us=0, ids=(), corners_px=np.empty((0, 4, 2)), laser_px=dot + np.array([0.0, 30.0]))
        assert solver.laser_range(off) is None
    far_side = CAMERA.laser_pixel(0.5) * np.array([-1.0, 1.0]) + np.array([2.0 * CAMERA.center_px[0], 0.0])
    wrong = MarkerSighting(t_us=0, ids=(), corners_px=np.empty((0, 4, 2)), laser_px=far_side)
    assert solver.laser_range(wrong) is None


class MarkerWorld(World):
    """Sightings instead of poses."""

    floor: MarkerMap

    def _look(self, t: float) -> None:
        roll, pitch = self.tilt_angles()
        rpy = np.array([roll, pitch, wrap_pi(self.yaw)])
        pos = np.array([self.n, self.e, self.d])
        sighting = sight(self.floor, pos, rpy, self.rng, t_us=self.t_us)
        self.pending.append((self.t_us + self.f.latency_us, sighting))


@pytest.mark.parametrize(("start", "yaw"), [((-1.9, 0.6), 0.5), ((1.9, -1.1), -2.9), ((0.0, 0.0), 1.6)])
def test_start_up_anywhere(make: Make, floor: MarkerMap, start: tuple[float, float], yaw: float) -> None:
    """From the first images, wherever the vehicle stands; then follows with millimetres."""
    world = MarkerWorld(tank_jet, Faults(), start)
    world.floor, world.yaw = floor, yaw
    estimator = make(markers=floor)
    errors, first_us = [], None
    for truth, samples, command in world.run(4.0):
        nav = estimator.step(truth.t_us, samples, command)
        if nav is None:
            continue
        first_us = first_us or truth.t_us
        assert np.abs(nav.pos_ned_m - truth.pos).max() < 0.05
        assert nav.health is NavHealth.GOOD
        errors.append(np.append(nav.pos_ned_m - truth.pos, wrap_pi(float(nav.rpy_rad[2]) - truth.yaw)))
    assert first_us is not None and first_us <= 400_000
    settled = np.array(errors[150:])
    assert float(np.sqrt((settled[:, :3] ** 2).sum(axis=1).mean())) < 0.008
    assert {a.sensor for a in estimator.take_aids()} == {"markers", "laser", "heading", "model"}


def test_vision_trims_the_tilt(make_ekf: Make, floor: MarkerMap) -> None:
    """Half a degree of AHRS tilt error is gone from roll and pitch a few seconds after start-up."""
    world = MarkerWorld(no_current, Faults(tilt_error=math.radians(0.8)))
    world.floor = floor
    estimator = make_ekf(markers=floor)
    errors = []
    for truth, samples, command in world.run(5.0):
        nav = estimator.step(truth.t_us, samples, command)
        if nav is not None and truth.t_us > 2_000_000:
            errors.append(nav.rpy_rad[:2] - np.array(world.tilt_angles()))
    assert math.degrees(float(np.sqrt(np.mean(np.square(errors))))) < 0.2
    assert nav is not None and nav.variance[3] == pytest.approx(math.radians(0.1) ** 2)


def test_kidnapped_over_the_marker_floor(make: Make, floor: MarkerMap) -> None:
    """The vehicle is carried to the other side of the tank between two images: found again within a second."""
    world = MarkerWorld(no_current, Faults())
    world.floor = floor
    estimator = make(markers=floor)
    nav = None
    for truth, samples, command in world.run(5.0):
        if truth.t_us == 3_000_000:
            world.n, world.e, world.yaw = 1.2, 0.7, world.yaw + 1.0
            world.pending.clear()
        nav = estimator.step(truth.t_us, samples, command)
        if truth.t_us > 4_100_000:
            assert nav is not None
            assert np.abs(nav.pos_ned_m - truth.pos).max() < 0.05
            assert abs(wrap_pi(float(nav.rpy_rad[2]) - truth.yaw)) < 0.05
    assert nav is not None and nav.reset_count >= 1


@pytest.mark.parametrize("shape", [(2, 4), (1, 4, 3), (0,)])
def test_malformed_sightings_are_counted(make: Make, floor: MarkerMap, shape: tuple[int, ...]) -> None:
    world = World(no_current, Faults())
    estimator = make(markers=floor)
    for truth, samples, command in world.run(1.0):
        bad: list[Sample] = [
            MarkerSighting(t_us=truth.t_us - 50_001, ids=(1,), corners_px=np.zeros(shape), laser_px=None),
            MarkerSighting(t_us=truth.t_us - 50_002, ids=(1,), corners_px=np.full((1, 4, 2), math.nan), laser_px=None),
        ]
        nav = estimator.step(truth.t_us, bad + samples, command)
    assert nav is not None
    assert estimator.counters()["markers.malformed"] > 150


@pytest.mark.parametrize("value", [math.nan, math.inf, -1e200])
def test_pixels_beyond_any_image_are_malformed(floor: MarkerMap, value: float) -> None:
    solver = MarkerSolver(CAMERA, floor)
    pos, rpy = np.array([0.0, 0.0, 0.5]), np.zeros(3)
    good = sight(floor, pos, rpy, np.random.default_rng(1))
    assert solver.well_formed(good)
    corners = good.corners_px.copy()
    corners[0, 2, 1] = value
    assert not solver.well_formed(replace(good, corners_px=corners))
    assert not solver.well_formed(replace(good, laser_px=np.array([1.0, value])))


def test_vehicle_file_and_camera_agree(vehicle: Vehicle) -> None:
    """Image x is starboard, image y aft: a marker to starboard of the vehicle shows on the right."""
    right = CAMERA.project(CAMERA.cam_from_ned(np.array([0.0, 0.2, 1.5]), np.array([0.0, 0.0, 0.5]), np.eye(3)))
    ahead = CAMERA.project(CAMERA.cam_from_ned(np.array([0.2, 0.0, 1.5]), np.array([0.0, 0.0, 0.5]), np.eye(3)))
    assert right[0] > CAMERA.center_px[0] + 100.0
    assert ahead[1] < CAMERA.center_px[1] - 100.0
