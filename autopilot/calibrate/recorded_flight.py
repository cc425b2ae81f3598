"""Calibration data from a log: camera poses from the recorded corners alone, AHRS samples, laser dots."""

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from autopilot.calibrate.calibrate_tuning import FLIGHT, POSE_FIT
from autopilot.core.camera import CameraModel
from autopilot.core.errors import LogError
from autopilot.core.frames import FloatArray, r_ned_from_frd
from autopilot.core.marker_files import load_marker_map
from autopilot.core.markers import MarkerMap
from autopilot.core.robust import PLANAR_MEDIAN
from autopilot.core.vehicle import Vehicle, load_vehicle
from autopilot.log.reader import Log, MessageTable, open_log
from autopilot.record.estimator_setup import read_markers, read_vehicle


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class CameraPose:
    """Pose of the camera from one sighting, by itself: no attitude prior, no filter.

    Least squares over position, rotation and the distance by which blur draws corners into their markers (see
    :mod:`.estimator.pnp`, which leans on the AHRS where it has to; a calibration of the AHRS against the camera must
    not)."""

    eye_ned_m: FloatArray
    """(3,)"""
    r_ned_from_cam: FloatArray
    """(3, 3)"""
    rms_px: float
    corners: int


def fit_pose(
    camera: CameraModel, points_ned_m: FloatArray, pixels: FloatArray, eye_ned_m: FloatArray, r_ned_from_cam: FloatArray
) -> CameraPose | None:
    """Pose from corners (4n, 3) of n markers and their pixels (4n, 2) from a rough pose; None without a good fit."""
    squares = pixels.reshape(-1, 4, 2)
    inward = squares.mean(axis=1, keepdims=True) - squares
    inward /= np.maximum(np.linalg.norm(inward, axis=2, keepdims=True), 1e-9)
    inward = inward.reshape(-1, 2)
    keep = np.ones(len(pixels), dtype=bool)
    eye, r = np.array(eye_ned_m, dtype=float), np.array(r_ned_from_cam, dtype=float)
    shrink = POSE_FIT.shrink_px
    weight = (POSE_FIT.corner_sigma_px / POSE_FIT.shrink_sigma_px) ** 2
    off = np.zeros(len(pixels))
    for step in range(POSE_FIT.steps):
        cam = (points_ned_m - eye) @ r
        seen, slopes = camera.linearise(cam)
        residual = pixels - shrink * inward - seen
        if not np.isfinite(residual).all():
            return None
        off = np.linalg.norm(residual, axis=1)
        if step >= 3:
            keep = off <= max(POSE_FIT.corner_floor_px, POSE_FIT.corner_sigmas * float(np.median(off)) / PLANAR_MEDIAN)
        jac = np.empty((len(pixels), 2, 7))
        jac[:, :, :3] = -slopes @ r.T
        jac[:, :, 3:6] = np.cross(slopes, cam[:, None, :])
        jac[:, :, 6] = inward
        flat, error = jac[keep].reshape(-1, 7), residual[keep].reshape(-1)
        normal, gradient = flat.T @ flat, flat.T @ error
        normal[6, 6] += weight
        gradient[6] += weight * (POSE_FIT.shrink_px - shrink)
        try:
            delta = np.linalg.solve(normal, gradient)
        except np.linalg.LinAlgError:
            return None
        eye, shrink = eye + delta[:3], shrink + float(delta[6])
        r = r @ Rotation.from_rotvec(delta[3:6]).as_matrix()
        if step > 3 and float(np.abs(delta[:6]).max()) < POSE_FIT.converged:
            break
    rms_px = math.sqrt(float((off[keep] ** 2).mean()))
    if (
        not rms_px < POSE_FIT.max_rms_px
        or 4 * int(keep.sum()) < 3 * len(keep)
        or int(keep.sum()) < POSE_FIT.min_corners
    ):
        return None
    return CameraPose(eye_ned_m=eye, r_ned_from_cam=r, rms_px=rms_px, corners=int(keep.sum()))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class RecordedAhrs:
    t_s: FloatArray
    """(m,) rising."""
    rpy_rad: FloatArray
    """(m, 3)"""
    rate_frd_rad_s: FloatArray
    """(m, 3)"""
    accel_frd_m_s2: FloatArray
    """(m, 3) specific force"""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class CameraFlight:
    """A log's camera poses and AHRS samples."""

    vehicle: Vehicle
    """Vehicle file of the service, or the one given instead."""
    camera: CameraModel
    t_s: FloatArray
    """(n,) rising; the stamps of the sightings with the vehicle file's ``camera.time_offset_s`` added."""
    eye_ned_m: FloatArray
    """(n, 3)"""
    r_ned_from_cam: FloatArray
    """(n, 3, 3)"""
    rms_px: FloatArray
    """(n,) of the corners."""
    laser_px: FloatArray
    """(n, 2), NaN where no dot was found."""
    ahrs: RecordedAhrs
    floor_m: float
    """Depth of the floor on which the markers lie."""
    sightings: int
    """In the log, usable or not."""

    def with_vehicle(self, vehicle: Vehicle) -> "CameraFlight":
        """The same flight for another vehicle file; its poses come from the corners alone."""
        later_s = vehicle.eye.time_offset_s - self.vehicle.eye.time_offset_s
        return replace(self, vehicle=vehicle, camera=CameraModel.of_vehicle(vehicle), t_s=self.t_s + later_s)


def read_flight(path: Path, vehicle: str | None = None, markers: Path | None = None) -> CameraFlight:
    """Poses of all sightings in a log. LogError if there are too few; ConfigError for a wrong vehicle or map file.

    ``vehicle``: another vehicle file than the one attached to the log; ``markers``: another marker map."""
    log = open_log(path)
    known = load_vehicle(vehicle) if vehicle is not None else read_vehicle(log)
    camera = CameraModel.of_vehicle(known)
    floor = marker_map(log, markers)
    sightings = _table(log, "/in/markers", "it needs a camera: fly with --sensors camera")
    poses, used = [], []
    finder = _Finder(camera, floor, log.get("/nav/state"))
    for n, row in enumerate(sightings):
        pose = finder.pose(row)
        if pose is not None:
            poses.append(pose)
            used.append(n)
    if len(poses) < FLIGHT.min_frames:
        raise LogError(
            f"{path}: {len(poses)} of {len(sightings)} sightings give a pose, at least"
            f" {FLIGHT.min_frames} are needed; fly"
            f" where {FLIGHT.min_markers} markers and more are in view, and check the marker map"
        )
    rows = sightings[used]
    laser_px = np.where(rows["laser_found"][:, None] == 1, rows["laser_px"], np.nan)
    t_s = rows["t_us"] * 1e-6 + known.eye.time_offset_s
    order = np.argsort(t_s, kind="stable")
    order = order[np.diff(t_s[order], prepend=-math.inf) > 0.0]
    return CameraFlight(
        vehicle=known,
        camera=camera,
        t_s=t_s[order],
        eye_ned_m=np.array([pose.eye_ned_m for pose in poses])[order],
        r_ned_from_cam=np.array([pose.r_ned_from_cam for pose in poses])[order],
        rms_px=np.array([pose.rms_px for pose in poses])[order],
        laser_px=laser_px[order],
        ahrs=_ahrs(log, known),
        floor_m=floor.floor_m,
        sightings=len(sightings),
    )


def marker_map(log: Log, file: Path | None) -> MarkerMap:
    """Markers of the flight: a map file, else the service's own. LogError without either."""
    markers = load_marker_map(file) if file is not None else read_markers(log.attachments)
    if markers is None:
        raise LogError(f"{log.path}: does not tell where the markers lie; give the marker map with --map")
    return markers


def _table(log: Log, topic: str, remedy: str) -> MessageTable:
    table = log.get(topic)
    if table is None:
        raise LogError(f"{log.path}: holds no {topic}; {remedy}")
    return table


def _ahrs(log: Log, vehicle: Vehicle) -> RecordedAhrs:
    rows = _table(log, "/in/ahrs_raw", "it needs an AHRS")
    good = np.isfinite(rows["rpy_rad"]).all(axis=1) & np.isfinite(rows["rate_frd_rad_s"]).all(axis=1)
    good &= np.isfinite(rows["accel_frd_m_s2"]).all(axis=1)
    rows = rows[good]
    t_s = rows["t_us"] * 1e-6 + vehicle.ahrs.time_offset_s
    rising = np.diff(np.maximum.accumulate(t_s), prepend=-math.inf) > 0.0
    if int(rising.sum()) < 2 * FLIGHT.min_frames:
        raise LogError(
            f"{log.path}: holds {int(rising.sum())} good AHRS samples; at least {2 * FLIGHT.min_frames} are needed"
        )
    rows, t_s = rows[rising], t_s[rising]
    return RecordedAhrs(
        t_s=t_s,
        rpy_rad=np.array(rows["rpy_rad"]),
        rate_frd_rad_s=np.array(rows["rate_frd_rad_s"]),
        accel_frd_m_s2=np.array(rows["accel_frd_m_s2"]),
    )


class _Finder:
    """Which marker is which, from the logged estimate, and the pose that the corners give."""

    def __init__(self, camera: CameraModel, markers: MarkerMap, states: MessageTable | None) -> None:
        self._camera, self._markers, self._states = camera, markers, states
        self._by_id: dict[int, list[int]] = {}
        for place, code in enumerate(markers.ids.tolist()):
            self._by_id.setdefault(code, []).append(place)

    def pose(self, row: np.void) -> CameraPose | None:
        """The camera's pose of one logged sighting, None without a good one."""
        count = int(row["count"])
        guess = self._guess(int(row["t_us"]))
        if count < FLIGHT.min_markers or guess is None:
            return None
        corners = np.asarray(row["corners_px"], dtype=float).reshape(-1, 4, 2)[:count]
        if not np.isfinite(corners).all():
            return None
        eye, r = guess
        rays = np.ones((count, 3))
        rays[:, :2] = self._camera.normalized(corners.mean(axis=1))
        rays_ned = rays @ r.T
        seen, placed = [], []
        for k, code in enumerate(row["ids"][:count].tolist()):
            for place in self._by_id.get(code, ()):
                centre = self._markers.centers_ned_m[place]
                reach = (centre[2] - eye[2]) / max(float(rays_ned[k, 2]), 0.1)
                if float(np.hypot(*(eye + reach * rays_ned[k] - centre)[:2])) < FLIGHT.nearest_m:
                    seen.append(k)
                    placed.append(place)
                    break
        if len(seen) < FLIGHT.min_markers:
            return None
        points = self._markers.corners_ned_m[placed].reshape(-1, 3)
        return fit_pose(self._camera, points, corners[seen].reshape(-1, 2), eye, r)

    def _guess(self, t_us: int) -> tuple[FloatArray, FloatArray] | None:
        """Rough camera pose from the logged estimate."""
        if self._states is None:
            return None
        n = int(np.clip(np.searchsorted(self._states["t_us"], t_us), 0, len(self._states) - 1))
        state = self._states[n]
        if abs(int(state["t_us"]) - t_us) > FLIGHT.max_state_age_us:
            return None
        r = r_ned_from_frd(np.asarray(state["rpy_rad"], dtype=float))
        eye = np.asarray(state["pos_ned_m"], dtype=float) + r @ self._camera.position_frd_m
        return eye, r @ self._camera.r_frd_from_cam
