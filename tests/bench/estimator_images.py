"""How well poses come out of whole pictures: rendered floors at many heights in clear to turbid water.

Each cell is a number of random places, headings and tilts; the vehicle is under way (motion blur). Poses are solved
from what the detector finds, near a prediction that is off by centimetres as the filter's may be; nothing is filtered.
"""

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from autopilot.core.camera import CameraModel
from autopilot.core.frames import FloatArray, r_ned_from_frd, wrap_pi
from autopilot.core.samples import CameraFrame, MarkerSighting
from autopilot.core.vehicle import load_vehicle
from autopilot.estimator.markers_pose import MarkerSolver
from autopilot.estimator.measure_pose import PoseFix
from autopilot.estimator.measure_range import LASER_MIN_SIGMA_M
from autopilot.estimator.measurement import CHI2_999
from autopilot.estimator.vision import Hint, MarkerDetector
from autopilot.sitl.camera_sensor import SimCamera
from autopilot.sitl.floor import Floor, build_floor
from autopilot.sitl.plant import Truth, build_plant
from autopilot.sitl.scenario import load_scenario
from autopilot.sitl.sensor_tables import ImageModel
from tests.bench.estimator_figures import Limit, rms

SCENARIO, VEHICLE = "paper-tank", "lbv150"
HEIGHTS_M = (0.2, 0.3, 0.45, 0.6, 0.8, 1.0, 1.2, 1.3)
"""Of the camera over the floor."""
TURBIDITIES_1_M = (0.0, 0.5, 1.0, 2.0, 3.0)
SHORT_HEIGHTS_M, SHORT_TURBIDITIES_1_M = (0.3, 0.6, 0.8, 1.2), (0.3, 1.0, 2.0)
PLACES, SHORT_PLACES = 40, 10
SPEED_M_S = 0.3
TILT_SIGMA_RAD = 0.02
GUESS_SIGMA_M, GUESS_SIGMA_RAD = 0.02, 0.01
"""How far the prediction is off."""
FALSE_MARGIN_PX = 5.0
"""A marker this far outside of the image cannot have been found there."""
WHOLE_MARGIN_PX = 10.0
"""A marker is in view when its corners are this far inside of the image: its outline needs some white around it."""
FAR_FIX_M = 0.05

GOOD_HEIGHTS_M = (0.45, 1.2)
"""Within these the accuracy is asked for."""
CLEAR_1_M, TURBID_1_M = 1.0, 2.0
CLEAR_BAR_M, TURBID_BAR_M, YAW_BAR_RAD = 0.002, 0.005, math.radians(0.05)
DEPTH_BAR = 2.0
"""No frame with a whole marker may be lost where turbidity times height is at most this."""
LASER_HEIGHT_M, LASER_BAR_M = 0.8, 0.010
TIME_BAR_S, TIME_HEIGHT_M = 0.008, 0.8
"""Median CPU time of detection, up to this height."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ImageRow:
    """One height in one water. Root mean squares over the places with a fix; NaN without any."""

    turbidity_1_m: float
    height_m: float
    markers: float
    """Markers found per picture."""
    xy_mm: float
    z_mm: float
    yaw_deg: float
    lost_pct: float
    """Share of the pictures with at least one whole marker in view that gave no fix."""
    empty_pct: float
    """Share of the places from where no whole marker can be seen."""
    false_ids: int
    """Ids found that were not there."""
    false_fixes: int
    """Fixes further than 50 mm from the truth."""
    nees: float
    """Mean squared distance of the fixes over their covariance, 4 = as sure as it should be."""
    laser_mm: float
    """Of the ranges that meet the filter's gate."""
    laser_pct: float
    """Share of the pictures with such a range."""
    laser_bad_pct: float
    """Share of the pictures with a range that does not meet it: a false dot."""
    found_pct: float
    """Share of the pictures that gave the right place without a prediction (start-up)."""
    cpu_ms: float
    """Median CPU time of detection with a prediction."""
    search_ms: float
    """The same without."""
    missed: str
    """The bars that are not kept, empty if all are."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Shot:
    error: FloatArray | None
    """(4,) north, east, down [m], yaw [rad]; None = lost."""
    nees: float
    visible: int
    markers: int
    false_ids: int
    laser_error_m: float | None
    laser_ok: bool
    found: bool
    cpu_s: float
    search_s: float


class ImageBench:
    """One floor, one camera, one detector for all cells."""

    def __init__(self) -> None:
        scenario, vehicle = load_scenario(SCENARIO), load_vehicle(VEHICLE)
        floor = build_floor(scenario)
        assert floor is not None, "the scenario has a printed floor"
        self._floor: Floor = floor
        self._camera = CameraModel.of_vehicle(vehicle)
        assert vehicle.laser is not None, "the vehicle has a laser"
        self._laser_frd_m = np.array(vehicle.laser.position_frd_m)
        self._detector = MarkerDetector(self._camera, floor.markers)
        self._solver = MarkerSolver(self._camera, floor.markers)
        some = build_plant(scenario, vehicle).truth
        self._truth: Truth = replace(some, vel_frd_m_s=np.array([SPEED_M_S, 0.0, 0.0]), rate_frd_rad_s=np.zeros(3))

    def cell(self, turbidity_1_m: float, height_m: float, places: int) -> ImageRow:
        """All places of one height in one water."""
        seed = round(1000 * height_m)
        renderer = SimCamera(self._camera, self._floor, ImageModel(turbidity_1_m=turbidity_1_m), seed)
        rng = np.random.default_rng(seed)
        return _row(turbidity_1_m, height_m, [self._shot(renderer, height_m, k, rng) for k in range(places)])

    def _shot(self, renderer: SimCamera, height_m: float, index: int, rng: np.random.Generator) -> _Shot:
        below_m = float(self._camera.position_frd_m[2])
        pos = np.array([*(rng.uniform(-1.0, 1.0, 2) * [1.9, 1.0]), self._floor.depth_m - below_m - height_m])
        rpy = np.array([*rng.normal(0.0, TILT_SIGMA_RAD, 2), rng.uniform(-math.pi, math.pi)])
        frame = CameraFrame(t_us=0, image_bgr=renderer.render(replace(self._truth, pos_ned_m=pos, rpy_rad=rpy), index))
        guess = pos + rng.normal(0.0, GUESS_SIGMA_M, 3), rpy + rng.normal(0.0, GUESS_SIGMA_RAD, 3)
        hint = Hint(pos_ned_m=guess[0], rpy_rad=guess[1])
        sighting, cpu_s = _timed(lambda: self._detector.detect(frame, hint))
        unguided, search_s = _timed(lambda: self._detector.detect(frame, None))
        fix = self._solver.track(sighting, *guess)
        anywhere = self._solver.locate(unguided, float(guess[1][0]), float(guess[1][1]))
        r = r_ned_from_frd(rpy)
        markers = self._floor.markers
        possible = markers.ids[markers.visible(self._camera, pos, r, -FALSE_MARGIN_PX)].tolist()
        error = None if fix is None else _error(fix, pos, rpy)
        laser = self._laser_error_m(sighting, pos, r)
        return _Shot(
            error=error,
            nees=0.0 if fix is None or error is None else float(error @ np.linalg.solve(fix.noise, error)),
            visible=len(markers.visible(self._camera, pos, r, WHOLE_MARGIN_PX)),
            markers=len(sighting.ids),
            false_ids=len(set(sighting.ids) - set(possible)),
            laser_error_m=laser[0],
            laser_ok=laser[1],
            found=anywhere is not None and float(np.linalg.norm(anywhere.z[:3] - pos)) < FAR_FIX_M,
            cpu_s=cpu_s,
            search_s=search_s,
        )

    def _laser_error_m(
        self, sighting: MarkerSighting, pos_ned_m: FloatArray, r: FloatArray
    ) -> tuple[float | None, bool]:
        """Measured minus true range along the beam, and whether the filter's gate lets it in."""
        found = self._solver.laser_range(sighting)
        if found is None:
            return None, False
        true_m = (self._floor.depth_m - float((pos_ned_m + r @ self._laser_frd_m)[2])) / float(r[2, 2])
        error_m = found[0] - true_m
        return error_m, error_m**2 <= CHI2_999[1] * max(found[1], LASER_MIN_SIGMA_M) ** 2


def bench_images(short: bool = False) -> Iterator[ImageRow]:
    """The table, row by row as it is measured."""
    heights, waters = (SHORT_HEIGHTS_M, SHORT_TURBIDITIES_1_M) if short else (HEIGHTS_M, TURBIDITIES_1_M)
    bench = ImageBench()
    for turbidity in waters:
        for height in heights:
            yield bench.cell(turbidity, height, SHORT_PLACES if short else PLACES)


def _timed(detect: Callable[[], MarkerSighting]) -> tuple[MarkerSighting, float]:
    begin_s = time.thread_time()
    sighting = detect()
    return sighting, time.thread_time() - begin_s


def _error(fix: PoseFix, pos: FloatArray, rpy: FloatArray) -> FloatArray:
    """(4,) fix minus truth."""
    return np.append(fix.z[:3] - pos, wrap_pi(float(fix.z[3] - rpy[2])))


def _row(turbidity_1_m: float, height_m: float, shots: Sequence[_Shot]) -> ImageRow:
    seen = [shot for shot in shots if shot.visible]
    fixed = [shot for shot in shots if shot.error is not None]
    errors = np.array([shot.error for shot in fixed]).reshape(-1, 4)
    good = errors[np.linalg.norm(errors[:, :3], axis=1) <= FAR_FIX_M]
    ranges = np.array([shot.laser_error_m for shot in shots if shot.laser_ok])
    dots = sum(shot.laser_error_m is not None for shot in shots)
    some = len(good) > 0
    row = ImageRow(
        turbidity_1_m=turbidity_1_m,
        height_m=height_m,
        markers=float(np.mean([shot.markers for shot in shots])),
        xy_mm=1e3 * rms(good[:, :2]) if some else math.nan,
        z_mm=1e3 * rms(good[:, 2]) if some else math.nan,
        yaw_deg=math.degrees(rms(good[:, 3])) if some else math.nan,
        lost_pct=100.0 * sum(shot.error is None for shot in seen) / max(len(seen), 1),
        empty_pct=100.0 * (1.0 - len(seen) / len(shots)),
        false_ids=sum(shot.false_ids for shot in shots),
        false_fixes=len(errors) - len(good),
        nees=float(np.mean([shot.nees for shot in fixed])) if fixed else math.nan,
        laser_mm=1e3 * rms(ranges) if len(ranges) else math.nan,
        laser_pct=100.0 * len(ranges) / len(shots),
        laser_bad_pct=100.0 * (dots - len(ranges)) / len(shots),
        found_pct=100.0 * sum(shot.found for shot in shots) / len(shots),
        cpu_ms=1e3 * float(np.median([shot.cpu_s for shot in shots])),
        search_ms=1e3 * float(np.median([shot.search_s for shot in shots])),
        missed="",
    )
    return replace(row, missed=", ".join(missed(row)))


def missed(row: ImageRow) -> list[str]:
    """Names of the bars that a row does not keep."""
    near, far = GOOD_HEIGHTS_M
    limit_m = math.inf
    if near <= row.height_m <= far and row.turbidity_1_m <= TURBID_1_M:
        limit_m = CLEAR_BAR_M if row.turbidity_1_m <= CLEAR_1_M else TURBID_BAR_M
    clear = near <= row.height_m <= far and row.turbidity_1_m <= CLEAR_1_M
    at_laser = row.height_m == LASER_HEIGHT_M and row.turbidity_1_m <= CLEAR_1_M
    limits = (
        ("xy", row.xy_mm, Limit(high=1e3 * limit_m), math.isfinite(limit_m)),
        ("z", row.z_mm, Limit(high=1e3 * limit_m), math.isfinite(limit_m)),
        ("yaw", row.yaw_deg, Limit(high=math.degrees(YAW_BAR_RAD)), clear),
        ("lost", row.lost_pct, Limit(high=0.0), row.turbidity_1_m * row.height_m <= DEPTH_BAR),
        ("false fixes", row.false_fixes, Limit(high=0.0), True),
        ("laser", row.laser_mm, Limit(high=1e3 * LASER_BAR_M), at_laser),
        ("time", row.cpu_ms, Limit(high=1e3 * TIME_BAR_S), row.height_m <= TIME_HEIGHT_M),
    )
    return [name for name, value, bar, applies in limits if applies and not bar.holds(value)]
