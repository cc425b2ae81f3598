"""Pictures that are none, and pictures of something else: refused by name, survived, no wrong pose of them."""

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from makers import Make
from test_markers_pose import CAMERA, sight
from test_vision import truth_at
from truth import Faults, World, no_current

from autopilot.core.camera import CameraModel
from autopilot.core.frames import r_ned_from_frd
from autopilot.core.markers import MarkerMap
from autopilot.core.messages import NavHealth
from autopilot.core.samples import CameraFrame, FrameVerdict, MarkerSighting
from autopilot.estimator.frame_filter import FrameFilter, quantile
from autopilot.estimator.markers_pose import MarkerSolver
from autopilot.estimator.pnp import solve_pose
from autopilot.estimator.vision import Hint, MarkerDetector
from autopilot.estimator.vision_worker import VisionWorker
from autopilot.sitl.camera_sensor import SimCamera
from autopilot.sitl.floor import Floor
from autopilot.sitl.sensor_tables import ImageModel

POS, RPY = np.array([0.5, -0.2, 0.6]), np.array([0.01, -0.01, 0.4])
HINT = Hint(pos_ned_m=POS + 0.004, rpy_rad=RPY)


@pytest.fixture(scope="module")
def pictures(tank: Floor) -> list[np.ndarray]:
    """Of one place, and of one 6 cm further north."""
    renderer = SimCamera(CAMERA, tank, ImageModel(), 1)
    return [renderer.render(truth_at(POS + np.array([step, 0.0, 0.0]), RPY), k) for k, step in enumerate((0.0, 0.06))]


def verdicts(*images: object) -> list[FrameVerdict]:
    frame_filter = FrameFilter(CAMERA.width_px, CAMERA.height_px)
    return [frame_filter.judge(CameraFrame(t_us=k, image_bgr=image)) for k, image in enumerate(images)]


def test_each_kind_of_bad_picture_has_a_name(pictures: list[np.ndarray]) -> None:
    good, other = pictures
    cut = other.copy()
    cut[300:] = cut[299, 0]
    half_black = other.copy()
    half_black[240:] = 0
    assert verdicts(good, other) == [FrameVerdict.OK] * 2
    assert verdicts(good[:240]) == verdicts(good[:, :, 0]) == verdicts(None) == [FrameVerdict.WRONG_SIZE]
    assert verdicts(good.astype(np.float32)) == verdicts(good.astype(np.uint16)) == [FrameVerdict.WRONG_TYPE]
    assert verdicts(np.zeros_like(good)) == [FrameVerdict.DARK]
    assert verdicts(np.full_like(good, 255)) == [FrameVerdict.BRIGHT]
    assert verdicts(np.full_like(good, 120)) == [FrameVerdict.FLAT]
    assert verdicts(cut) == verdicts(half_black) == [FrameVerdict.TORN]
    assert verdicts(good, good.copy(), other) == [FrameVerdict.OK, FrameVerdict.FROZEN, FrameVerdict.OK]


def test_thick_haze_and_a_dark_tank_are_no_faults(tank: Floor) -> None:
    for look in (ImageModel(turbidity_1_m=4.0), ImageModel(light=0.3), ImageModel(noise_levels=0.5, turbidity_1_m=3.0)):
        image = SimCamera(CAMERA, tank, look, 1).render(truth_at(POS, RPY), 0)
        assert verdicts(image) == [FrameVerdict.OK]


@settings(max_examples=25, deadline=None)
@given(
    shape=st.lists(st.integers(0, 12), min_size=1, max_size=4).map(tuple),
    kind=st.sampled_from(["uint8", "int32", "float64", "bool"]),
    level=st.integers(0, 255),
)
def test_the_door_survives_any_array(shape: tuple[int, ...], kind: str, level: int) -> None:
    assert verdicts(np.full(shape, level).astype(kind)) == [FrameVerdict.WRONG_SIZE]


def test_refused_pictures_are_counted_and_never_searched(pictures: list[np.ndarray]) -> None:
    searched = []

    class Counting:
        def detect(self, frame: CameraFrame, hint: Hint | None) -> MarkerSighting:
            searched.append(frame.t_us)
            return MarkerSighting(t_us=frame.t_us, ids=(), corners_px=np.empty((0, 4, 2)), laser_px=None)

    worker = VisionWorker(Counting(), delay_s=0.0, frame_filter=FrameFilter(CAMERA.width_px, CAMERA.height_px))
    images = [pictures[0], pictures[0], np.zeros_like(pictures[0]), pictures[0][:100], pictures[1]]
    for k, image in enumerate(images):
        worker.submit(k, CameraFrame(t_us=k, image_bgr=image), None)
        worker.collect(k)
    worker.close()
    assert searched == [0]  # the next one that may be searched without a hint is the sixth
    counts = worker.counters()
    assert counts["frames.ok"] == 2
    assert counts["frames.frozen"] == counts["frames.dark"] == counts["frames.wrong_size"] == 1
    assert counts["frames.torn"] == counts["frames.dropped"] == 0


@pytest.mark.parametrize("seam", [120, 240, 360])
def test_a_picture_of_two_moments_gives_no_pose_in_between(
    tank: Floor,
    detector: MarkerDetector,
    pictures: list[np.ndarray],
    seam: int,
) -> None:
    """The parts are 6 cm apart: the fix is that of one of them or there is none."""
    mixed = pictures[0].copy()
    mixed[seam:] = pictures[1][seam:]
    sighting = detector.detect(CameraFrame(t_us=0, image_bgr=mixed), HINT)
    fix = MarkerSolver(CAMERA, tank.markers).track(sighting, HINT.pos_ned_m, HINT.rpy_rad)
    if fix is not None:
        steps = [np.linalg.norm(fix.z[:3] - POS - np.array([step, 0.0, 0.0])) for step in (0.0, 0.06)]
        assert min(steps) < 0.005


def test_markers_that_are_not_in_the_map_are_passed_over(floor: MarkerMap) -> None:
    rng = np.random.default_rng(4)
    solver = MarkerSolver(CAMERA, floor)
    good = sight(floor, POS, RPY, rng)
    strange = replace(good, ids=(*([999_999] * (len(good.ids) - 4)), *good.ids[-4:]))
    fix = solver.track(strange, POS, RPY)
    assert fix is not None
    assert np.abs(fix.z[:3] - POS).max() < 0.006
    all_strange = replace(good, ids=(999_999,) * len(good.ids))
    assert solver.track(all_strange, POS, RPY) is None
    assert solver.locate(all_strange, 0.0, 0.0) is None


def other_camera(camera: CameraModel, focal: float, distortion: float, shift_px: float) -> CameraModel:
    k1, k2, p1, p2, k3 = camera.distortion
    return replace(
        camera,
        focal_px=(focal * camera.focal_px[0], focal * camera.focal_px[1]),
        distortion=(distortion * k1, distortion * k2, distortion * p1, distortion * p2, distortion * k3),
        center_px=(camera.center_px[0] + shift_px, camera.center_px[1]),
    )


@pytest.mark.parametrize(
    ("focal", "distortion", "shift_px"),
    [(1.0, 0.0, 0.0), (0.7, 1.0, 0.0), (1.0, 1.0, 120.0), (1.33, 0.0, 40.0), (0.75, 0.0, -30.0)],
)
@pytest.mark.parametrize("height_m", [0.45, 0.8])
def test_intrinsics_of_another_camera_are_counted(
    floor: MarkerMap, focal: float, distortion: float, shift_px: float, height_m: float
) -> None:
    """Nearly every sighting is a misfit or leans; with the right file none is."""
    rng = np.random.default_rng(6)
    wrong = MarkerSolver(other_camera(CAMERA, focal, distortion, shift_px), floor)
    right = MarkerSolver(CAMERA, floor)
    none = 0
    for _ in range(12):
        pos = np.array([*rng.uniform(-0.8, 0.8, 2), 1.4 - height_m])
        sighting = sight(floor, pos, RPY, rng)
        none += wrong.track(sighting, pos, RPY) is None
        assert right.track(sighting, pos, RPY) is not None
    assert max(wrong.counts["misfit"], wrong.counts["leaning"]) + none >= 9
    assert right.counts == {"unknown": 0, "misfit": 0, "leaning": 0}


def test_the_filter_counts_what_is_wrong_and_says_that_it_is_blind(make_ekf: Make, floor: MarkerMap) -> None:
    """Flying on with sightings of nothing but strangers: dead reckoning after 1 s, invalid after 5 s, never NaN."""
    world = World(no_current, Faults(vision=False))
    engine = make_ekf(markers=floor)
    rng = np.random.default_rng(2)
    health: dict[int, NavHealth] = {}
    for tick, (truth, samples, thrust_n) in enumerate(world.run(8.0)):
        if tick % 3 == 0:
            good = sight(floor, truth.pos, np.array([0.0, 0.0, truth.yaw]), rng, t_us=truth.t_us)
            strange = replace(good, ids=(999_999,) * len(good.ids), laser_px=None)
            samples = [*samples, good if truth.t_us < 2_000_000 else strange]
        nav = engine.step(truth.t_us, samples, thrust_n)
        if nav is not None:
            assert np.isfinite(nav.pos_ned_m).all() and np.isfinite(nav.variance).all()
            health[tick] = nav.health
    assert health[190] is NavHealth.GOOD
    assert health[340] is NavHealth.DEAD_RECKONING
    assert health[780] is NavHealth.INVALID
    assert engine.counters()["markers.unknown"] > 1000


def test_the_mirrored_pose_of_a_single_marker_is_not_taken(floor: MarkerMap) -> None:
    """A flat square allows two poses (both of IPPE's); the fit ends at the one that the AHRS is close to."""
    rng = np.random.default_rng(8)
    ambiguous = 0
    for _ in range(40):
        pos = np.array([*rng.uniform(-1.0, 1.0, 2), rng.uniform(0.3, 0.7)])
        rpy = np.array([*(rng.choice([-1.0, 1.0], 2) * rng.uniform(0.08, 0.15, 2)), rng.uniform(-3.0, 3.0)])
        one = sight(floor, pos, rpy, rng, sigma_px=0.05, most=1)
        r = r_ned_from_frd(rpy)
        place = min(
            np.flatnonzero(floor.ids == one.ids[0]),
            key=lambda j: float(np.linalg.norm(floor.centers_ned_m[j, :2] - pos[:2])),
        )
        points, pixels = floor.corners_ned_m[place], one.corners_px[0]
        fit = solve_pose(CAMERA, points, pixels, pos + 0.01, rpy + np.array([0.008, -0.008, 0.02]), 3.0, shrink_px=0.0)
        assert fit is not None
        assert np.degrees(np.abs(fit.rpy_rad[:2] - rpy[:2])).max() < 1.2
        half = 0.5 * floor.size_m
        square = half * np.array([[-1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [1.0, -1.0, 0.0], [-1.0, -1.0, 0.0]])
        _, turns, _, _ = cv2.solvePnPGeneric(
            square, pixels, CAMERA.matrix, CAMERA.distortion_coefficients, flags=cv2.SOLVEPNP_IPPE_SQUARE
        )
        up = r.T[:, 2]  # the floor's normal in the body frame, as it is and as the two solutions say
        leans = [
            math.degrees(math.acos(min(1.0, abs(float((CAMERA.r_frd_from_cam @ cv2.Rodrigues(turn)[0])[:, 2] @ up)))))
            for turn in turns
        ]
        ambiguous += min(leans) < 5.0 and max(leans) > 8.0
    assert ambiguous >= 20


def test_a_single_marker_that_contradicts_the_ahrs_gives_no_fix(floor: MarkerMap) -> None:
    rng = np.random.default_rng(9)
    pos, rpy = np.array([0.3, -0.2, 1.1]), np.array([0.2, -0.2, 0.5])
    one = sight(floor, pos, rpy, rng, sigma_px=0.05, most=1)
    assert MarkerSolver(CAMERA, floor).track(one, pos, rpy) is not None
    assert MarkerSolver(CAMERA, floor).track(one, pos, np.array([-0.2, 0.2, 0.5])) is None


def test_the_levels_of_a_picture_are_ranked_as_numpy_ranks_its_pixels() -> None:
    rng = np.random.default_rng(2)
    for _ in range(200):
        pixels = rng.integers(0, int(rng.integers(1, 257)), int(rng.integers(1, 5000))).astype(np.uint8)
        levels = np.bincount(pixels, minlength=256)
        for share in (0.1, 0.5, 0.9, 1.0):
            assert quantile(levels, share) == pytest.approx(float(np.percentile(pixels, 100.0 * share)), abs=1e-9)
