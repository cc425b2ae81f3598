"""The estimator over floors that a person has laid: a recorded flight again, over sheets that lie elsewhere.

The flight's sensors and thrusts are the recorded ones; what the camera would have shown is made by geometry for
markers of sheets that are off, each as a whole. So one flight serves for any number of maps, and what differs between
them is the map alone. The vehicle has the plan. (Flights with rendered pictures over such floors, which the estimate
flies itself: the scenario ``hand-laid``.)
"""

import dataclasses
import math
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from autopilot.core.camera import CameraModel
from autopilot.core.frames import FloatArray, r_ned_from_frd, wrap_pi
from autopilot.core.map_errors import PRINT_SIGMA_M, SHEET_SIGMA_DOWN_M, Laid, map_errors
from autopilot.core.markers import ID_SPAN, MarkerMap
from autopilot.core.messages import NavState
from autopilot.core.samples import LaserSample, MarkerSighting, PoseSample, Sample
from autopilot.core.vehicle import Vehicle
from autopilot.estimator.create import create_estimator
from autopilot.log.analysis import VehicleTrack, load_flight
from autopilot.log.reader import open_log
from autopilot.sitl.floor import given_markers, sheets_moved, sheets_of
from autopilot.sitl.scenario import load_scenario
from tests.bench.calibrations import calibrated, exact_map
from tests.bench.estimator_figures import GAUSS_3_SIGMA
from tests.bench.estimator_flights import BASE, FlightSpec, open_flight, watch

RECORDED_S = 32.0
"""The first lap of the paper's tour and some of the second."""
SHEET_M = 0.6
TURN_RAD_M = 3.5
"""Heading error of a sheet per metre that its place is off, as a person lays them (scenario ``hand-laid``)."""
CORNER_PX, SHRINK_PX = 0.12, 0.25
"""Noise of a corner per axis, and how far blur draws corners inwards."""
FROM_S = 5.0
"""The estimate is judged from here on."""
EVERY_TICKS = 10
MOVED_M, TURNED_RAD = 0.03, math.radians(5.0)
SEEN_OFTEN = 40
"""Pictures that show a marker which is to be found wrong."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Recording:
    """One flight: what the estimator got, and the truth."""

    ticks: Sequence[tuple[int, tuple[Sample, ...], FloatArray]]
    """Time, samples that arrived, thrusts."""
    truth: VehicleTrack
    vehicle: Vehicle
    plan: MarkerMap
    """The floor as it was meant to be, without errors, as is the vehicle's calibration."""
    floor_depth_m: float


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class OverFloor:
    """What the estimator made of one floor."""

    t_s: FloatArray
    error: FloatArray
    """(n, 4) estimate minus truth: north, east, down [m], yaw [rad]."""
    variance: FloatArray
    """(n, 4) that it claims."""
    place_m: FloatArray
    """(n, 2) where that was: north, east."""
    resets: int
    refined: MarkerMap
    """The map as it has it at the end."""
    remarks: tuple[str, ...]
    """What the operator was told."""

    def xy_mm(self) -> float:
        """Root mean square of the horizontal error."""
        return 1e3 * float(np.sqrt((self.error[:, :2] ** 2).sum(axis=1).mean()))

    def form_mm(self) -> float:
        """The same without what one shift and one turn of the whole map explain: no picture shows those."""
        north, east = (self.place_m - self.place_m.mean(axis=0)).T
        ones, none = np.ones(len(north)), np.zeros(len(north))
        together = np.concatenate((np.column_stack((ones, none, -east)), np.column_stack((none, ones, north))))
        error = self.error[:, :2].T.reshape(-1)
        rest = error - together @ np.linalg.lstsq(together, error, rcond=None)[0]
        return 1e3 * math.sqrt(2.0 * float(np.square(rest).mean()))

    def worst_mm(self) -> float:
        """The largest horizontal error."""
        return 1e3 * float(np.hypot(self.error[:, 0], self.error[:, 1]).max())

    def nees(self, columns: slice) -> float:
        """Mean squared error over variance, summed over ``columns``."""
        return float((self.error[:, columns] ** 2 / self.variance[:, columns]).sum(axis=1).mean())

    def inside_pct(self) -> float:
        """Share of the time within three standard deviations in all of position and heading [%]."""
        return 100.0 * float((np.abs(self.error) <= GAUSS_3_SIGMA * np.sqrt(self.variance)).all(axis=1).mean())


def record(seed: int, duration_s: float = RECORDED_S) -> Recording:
    """Fly the paper's tour with the pose sensor."""
    ticks: list[tuple[int, tuple[Sample, ...], FloatArray]] = []

    class Recorder:
        nav: NavState | None = None

        def step(self, t_us: int, samples: Sequence[Sample], thrust_n: FloatArray, *, keep: bool) -> None:
            ticks.append((t_us, tuple(samples), thrust_n.copy()))

    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "flight.mcap"
        spec = FlightSpec(name="recorded", changes={}, duration_s=duration_s, seed=seed)
        session = open_flight(spec, Path(folder), log)
        watch(session, [Recorder()], {}, None)
        session.run()
        truth = load_flight(open_log(log)).truth
    scenario = load_scenario(BASE)
    plan = given_markers(scenario)
    assert truth is not None
    assert plan is not None
    assert scenario.tank is not None
    return Recording(
        ticks=ticks,
        truth=truth,
        vehicle=calibrated(),
        plan=exact_map(plan),
        floor_depth_m=scenario.tank.depth_m,
    )


def plan_with_errors(plan: MarkerMap, sigma: tuple[float, float] | None) -> MarkerMap:
    """The plan with its sheets by name, said to be laid so well (place, heading); None: nothing is said."""
    place_m, turn_rad = (None, None) if sigma is None else sigma
    laid = [Laid(sheet=f"{k + 1}", sigma_m=place_m, sigma_rad=turn_rad) for k in sheets_of(plan, SHEET_M).tolist()]
    return dataclasses.replace(plan, errors=map_errors(plan.centers_ned_m, np.zeros(len(laid)), laid))


def sigma_of(rms_m: float) -> tuple[float, float]:
    """Standard deviations of sheets' places (per axis) and headings that move markers by so much, rms."""
    arm2 = SHEET_M**2 / 6.0
    place_m = rms_m / math.sqrt(2.0 + TURN_RAD_M**2 * arm2)
    return place_m, TURN_RAD_M * place_m


def laid_floor(
    plan: MarkerMap, rng: np.random.Generator, sigma: tuple[float, float], *, printed: bool = False
) -> MarkerMap:
    """Where markers lie after somebody has laid the sheets of the plan, rigid and flat.

    ``printed``: the floor has waves and the printer its errors, as maps take them for granted."""
    sheet = sheets_of(plan, SHEET_M)
    count = int(sheet.max()) + 1
    shift_m = np.zeros((count, 3))
    shift_m[:, :2] = rng.normal(0.0, sigma[0], (count, 2))
    turn_rad = rng.normal(0.0, sigma[1], count)
    if not printed:
        return sheets_moved(plan, sheet, shift_m, turn_rad)
    shift_m[:, 2] = rng.normal(0.0, min(sigma[0], SHEET_SIGMA_DOWN_M), count)
    floor = sheets_moved(plan, sheet, shift_m, turn_rad)
    off_m = np.zeros((len(plan.ids), 1, 3))
    off_m[:, 0, :2] = rng.normal(0.0, PRINT_SIGMA_M, (len(plan.ids), 2))
    return dataclasses.replace(floor, corners_ned_m=floor.corners_ned_m + off_m)


class Camera:
    """What the vehicle's camera shows of a floor during a recording."""

    def __init__(self, recording: Recording, model: CameraModel | None = None) -> None:
        """``model``: the true one, None = the vehicle file's."""
        self._camera = CameraModel.of_vehicle(recording.vehicle) if model is None else model
        truth = recording.truth
        times = [sample.t_us for _, samples, _ in recording.ticks for sample in samples if _is_pose(sample)]
        t_s = 1e-6 * np.array(times)
        rpy = np.unwrap(truth.rpy_rad, axis=0)
        pos = np.column_stack([np.interp(t_s, truth.t_s, truth.pos_ned_m[:, axis]) for axis in range(3)])
        turn = np.column_stack([np.interp(t_s, truth.t_s, rpy[:, axis]) for axis in range(3)])
        self.poses = {t_us: (p, r_ned_from_frd(r)) for t_us, p, r in zip(times, pos, turn, strict=True)}
        """By time [us]: position, rotation."""

    def shown(self, floor: MarkerMap, t_us: int) -> NDArray[np.int64]:
        """Markers that are wholly in a picture."""
        return floor.visible(self._camera, *self.poses[t_us])

    def sighting(self, floor: MarkerMap, t_us: int, rng: np.random.Generator) -> MarkerSighting | None:
        """Corners drawn inwards by blur, with noise; None = an empty picture."""
        pos, r = self.poses[t_us]
        seen = self.shown(floor, t_us)
        if not len(seen):
            return None
        corners = self._camera.project(self._camera.cam_from_ned(floor.corners_ned_m[seen], pos, r))
        inward = corners.mean(axis=1, keepdims=True) - corners
        corners = corners + SHRINK_PX * inward / np.linalg.norm(inward, axis=2, keepdims=True)
        corners = corners + rng.normal(0.0, CORNER_PX, corners.shape)
        return MarkerSighting(t_us=t_us, ids=tuple(floor.ids[seen].tolist()), corners_px=corners, laser_px=None)


def over(recording: Recording, camera: Camera, floor: MarkerMap, known: MarkerMap, seed: int) -> OverFloor:
    """The recorded flight over another floor, by an estimator that is told a map."""
    rng = np.random.default_rng((seed, 3))
    estimator = create_estimator("ekf", recording.vehicle, known, floor_depth_m=recording.floor_depth_m)
    truth = recording.truth
    rows: list[list[float]] = []
    remarks: list[str] = []
    for n, (t_us, samples, thrust_n) in enumerate(recording.ticks):
        given: list[Sample] = []
        for sample in samples:
            made = camera.sighting(floor, sample.t_us, rng) if _is_pose(sample) else sample
            if made is not None and not isinstance(made, LaserSample):
                given.append(made)
        nav = estimator.step(t_us, given, thrust_n)
        estimator.take_aids()
        remarks += estimator.take_remarks()
        if nav is not None and n % EVERY_TICKS == 0 and t_us >= 1e6 * FROM_S:
            k = int(np.searchsorted(truth.t_s, 1e-6 * t_us - 1e-6))
            yaw = wrap_pi(float(nav.rpy_rad[2] - truth.rpy_rad[k, 2]))
            off = nav.pos_ned_m - truth.pos_ned_m[k]
            rows.append([1e-6 * t_us, *off, yaw, *nav.variance[[0, 1, 2, 5]], *nav.pos_ned_m[:2]])
    table = np.array(rows).reshape(-1, 11)
    refined = estimator.refined_map
    assert refined is not None
    return OverFloor(
        t_s=table[:, 0],
        error=table[:, 1:5],
        variance=table[:, 5:9],
        place_m=table[:, 9:],
        resets=estimator.counters()["resets"],
        refined=refined,
        remarks=tuple(remarks),
    )


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FaultyFloor:
    """A floor on which three things are not where the plan has them, and what has to be told of each."""

    floor: MarkerMap
    expected: Mapping[str, tuple[str, ...]]
    """What is wrong -> beginnings of texts of which one has to come."""
    true: tuple[str, ...]
    """Beginnings of all texts that are true."""


def faulty_floor(recording: Recording, camera: Camera, plan: MarkerMap, floor: MarkerMap, seed: int) -> FaultyFloor:
    """A marker moved by 3 cm, a sheet turned by 5 degrees, two ids swapped: on sheets that lie apart."""
    rng = np.random.default_rng((seed, 4))
    sheet = sheets_of(plan, SHEET_M)
    pictures = np.zeros(len(plan.ids), dtype=int)
    for t_us in camera.poses:
        if t_us >= 1e6 * FROM_S:
            pictures[camera.shown(floor, t_us)] += 1
    often = pictures >= SEEN_OFTEN
    by_sheet = np.array([int(often[sheet == k].sum()) for k in range(int(sheet.max()) + 1)])
    middle = np.array([plan.centers_ned_m[sheet == k].mean(axis=0) for k in range(len(by_sheet))])
    eligible = np.flatnonzero(by_sheet >= 12)
    if len(eligible) < 3:
        raise ValueError("the flight does not show three sheets; record a longer one")
    chosen = [int(rng.choice(eligible))]
    while len(chosen) < 3:  # the one that lies farthest from those
        apart = np.linalg.norm(middle[eligible][:, None] - middle[chosen], axis=2).min(axis=1)
        chosen.append(int(eligible[apart.argmax()]))
    corners, ids = floor.corners_ned_m.copy(), floor.ids.copy()
    moved = int(rng.choice(np.flatnonzero(often & (sheet == chosen[0]))))
    direction = rng.uniform(0.0, 2.0 * math.pi)
    corners[moved, :, :2] += MOVED_M * np.array([math.cos(direction), math.sin(direction)])
    turned = sheet == chosen[1]
    turn = r_ned_from_frd(np.array([0.0, 0.0, TURNED_RAD * rng.choice([-1.0, 1.0])]))
    pivot = corners[turned].mean(axis=(0, 1))
    corners[turned] = pivot + (corners[turned] - pivot) @ turn.T
    pair = rng.choice(np.flatnonzero(often & (sheet == chosen[2])), 2, replace=False)
    ids[pair] = ids[pair[::-1]]
    a, b = (int(code) % ID_SPAN for code in ids[pair])
    expected = {
        "marker moved": (f"Marker {int(ids[moved]) % ID_SPAN} lies ",),
        "sheet turned": (f"Sheet {chosen[1] + 1} lies ",),
        "ids swapped": (f"Markers {a} and {b} are swapped", f"Markers {b} and {a} are swapped"),
    }
    each = tuple(f"Marker {one} lies where the map has {other}" for one, other in ((a, b), (b, a)))
    return FaultyFloor(
        floor=dataclasses.replace(floor, corners_ned_m=corners, ids=ids),
        expected=expected,
        true=(*(text for texts in expected.values() for text in texts), *each),
    )


def _is_pose(sample: Sample) -> bool:
    return isinstance(sample, PoseSample)
