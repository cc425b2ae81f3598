"""A camera over a floor in the light truth simulator: sightings by geometry, of markers that lie where they lie."""

import dataclasses
import math

import numpy as np
from truth import Faults, Track, World, no_current

from autopilot.core.camera import CameraModel
from autopilot.core.frames import FloatArray, r_ned_from_frd
from autopilot.core.map_errors import Laid, map_errors
from autopilot.core.markers import MarkerMap
from autopilot.core.samples import MarkerSighting
from autopilot.estimator.engine import AidedEstimator
from tests.bench.calibrations import calibrated

VEHICLE = calibrated()
CAMERA = CameraModel.of_vehicle(VEHICLE)
CORNER_PX, SHRINK_PX = 0.12, 0.25
LATENCY_US = 60_000
REST_US = 1_000_000
"""So long the vehicle holds still first."""
SHEET_M = 0.6


def sheets_of(plan: MarkerMap, sigma: tuple[float, float] | None) -> MarkerMap:
    """The plan with its sheets of 0.6 m by name, laid so well (None: nothing is said)."""
    cells = np.floor(plan.centers_ned_m[:, :2] / SHEET_M).astype(int).tolist()
    place_m, turn_rad = (None, None) if sigma is None else sigma
    laid = [Laid(sheet=f"{i} {j}", sigma_m=place_m, sigma_rad=turn_rad) for i, j in cells]
    errors = map_errors(plan.centers_ned_m, np.zeros(len(cells)), laid)
    return dataclasses.replace(plan, errors=errors)


def turned(corners: FloatArray, turn_rad: float, shift_m: FloatArray) -> FloatArray:
    """Markers (n, 4, 3) of one sheet that was laid otherwise."""
    middle = corners.mean(axis=(0, 1))
    turn = r_ned_from_frd(np.array([0.0, 0.0, turn_rad]))
    result: FloatArray = middle + (corners - middle) @ turn.T + shift_m
    return result


def laid(remarks: MarkerMap, rng: np.random.Generator, place_m: float, turn_rad: float) -> MarkerMap:
    """Where the markers of the plan lie after somebody has laid its sheets."""
    assert remarks.errors is not None
    corners = remarks.corners_ned_m.copy()
    for k in range(len(remarks.errors.names)):
        mine = remarks.errors.sheet == k
        shift = np.append(rng.normal(0.0, place_m, 2), 0.0)
        corners[mine] = turned(corners[mine], rng.normal(0.0, turn_rad), shift)
    return dataclasses.replace(remarks, corners_ned_m=corners, errors=None)


def off_mm(a: MarkerMap, b: MarkerMap, some: FloatArray | None = None) -> float:
    """Root mean square distance of the markers' places."""
    apart = (a.centers_ned_m - b.centers_ned_m)[:, :2]
    apart = apart if some is None else apart[some]
    return 1e3 * float(np.sqrt((apart**2).sum(axis=1).mean()))


def see(
    camera: CameraModel, true: MarkerMap, t_us: int, pos: FloatArray, rpy: FloatArray, rng: np.random.Generator
) -> MarkerSighting | None:
    """What the camera shows: corners drawn inwards by blur, with noise."""
    r = r_ned_from_frd(rpy)
    seen = true.visible(camera, pos, r)
    corners = camera.project(camera.cam_from_ned(true.corners_ned_m[seen], pos, r))
    away = corners.mean(axis=1, keepdims=True) - corners
    corners = corners + SHRINK_PX * away / np.linalg.norm(away, axis=2, keepdims=True)
    corners = corners + rng.normal(0.0, CORNER_PX, corners.shape)
    return MarkerSighting(t_us=t_us, ids=tuple(true.ids[seen].tolist()), corners_px=corners, laser_px=None)


class LaidWorld(World):
    """The vehicle of :class:`truth.World` with a camera instead of a pose sensor.

    ``camera`` is the true one, ``stamped_late_us`` what stamps are later than exposures; sightings come so much later
    as well, as from a driver that stamps by arrival, unless ``ahead``: then they may come before their stamps.
    ``scatter_s``: standard deviation of the stamps from picture to picture."""

    def __init__(
        self,
        true: MarkerMap,
        seed: int,
        *,
        camera: CameraModel = CAMERA,
        stamped_late_us: int = 0,
        ahead: bool = False,
        rest_us: int = REST_US,
        scatter_s: float = 0.0,
    ) -> None:
        super().__init__(no_current, Faults(seed=seed, tilt_error=math.radians(0.3)))
        self._true = true
        self._camera = camera
        self._late_us = stamped_late_us
        self._latency_us = LATENCY_US + (0 if ahead else max(0, stamped_late_us))
        self._rest_us = rest_us
        self._noise = np.random.default_rng((seed, 7))
        self._scatter_s, self._stamps = scatter_s, np.random.default_rng((seed, 8))

    def _command(self) -> FloatArray:
        return super()._command() if self.t_us >= self._rest_us else np.array([0.0, 0.0, 0.6, 0.0])

    def _look(self, t: float) -> None:
        pos, rpy = np.array([self.n, self.e, self.d]), np.array([*self.tilt_angles(), self.yaw])
        off_us = round(1e6 * self._scatter_s * float(np.clip(self._stamps.standard_normal(), -3.0, 3.0)))
        stamp_us = self.t_us + self._late_us + off_us
        sighting = see(self._camera, self._true, stamp_us, pos, rpy, self._noise)
        if sighting is not None and sighting.ids:
            sighting = dataclasses.replace(sighting, stamp_sigma_s=self._scatter_s)
            self.pending.append((self.t_us + self._latency_us + off_us, sighting))


def flown(estimator: AidedEstimator, world: World, seconds: float) -> tuple[Track, list[str]]:
    """A flight, and what the operator was told."""
    track, remarks = Track([], [], []), []
    for truth, samples, command in world.run(seconds):
        nav = estimator.step(truth.t_us, samples, command)
        remarks += estimator.take_remarks()
        if nav is not None:
            track.truth.append(truth)
            track.nav.append(nav)
    return track, remarks


__all__ = ["CAMERA", "LaidWorld", "flown", "laid", "off_mm", "see", "sheets_of", "turned"]
