"""From a marker sighting to a pose: which marker on the floor is which, and where the vehicle must be.

Ids repeat over the floor. While the pose is roughly known, a marker is the nearest one of its id to where it seems to
lie (:meth:`MarkerSolver.track`); without a pose, every marker votes for all places where it could be seen like this
(:meth:`MarkerSolver.locate`). Both end in the same least squares over all corners (:mod:`estimator.pnp`).
"""

import math

import numpy as np

from autopilot.core.camera import CameraModel
from autopilot.core.frames import FloatArray, r_ned_from_frd
from autopilot.core.markers import IntArray, MarkerMap
from autopilot.core.messages import MarkerSighting
from estimator.measure_pose import PoseFix
from estimator.pnp import solve_pose

NEAREST_M = 0.45
"""A marker is not looked for further from where it seems to lie: markers of one id are a metre and more apart."""
COMMON_SHIFT_M = 0.06
"""All markers of one image must be displaced alike, within this, or are wrong."""
VOTE_M = 0.08
VOTE_RAD = 0.15
VOTE_SCALE = 0.1
"""Votes for the camera's place agree within these (position, heading, share of the height)."""
SIMILAR = 0.15
"""A quadrilateral may differ from the marker's square by this share of its side, else it is not a marker."""
REJECT_SIGMAS = 3.0
REJECT_FLOOR_PX = 1.0
"""A marker with a corner further than this from its projection is left out."""
REJECT_ROUNDS = 4
FIRST_RMS_PX, FINAL_RMS_PX = 40.0, 3.0
"""A fit may be this bad before and after markers have been left out."""
LASER_SIGMA_PX = 0.7
"""Measured on rendered images: 0.2 px in clear water, 0.6 px in haze."""
LASER_OFF_LINE_PX = 6.0
"""How far the dot may lie off the line on which it must lie."""
LASER_MIN_RANGE_M = 0.1
MAX_PIXEL = 1e5
"""Pixels farther out than any image is large are garbage."""


class MarkerSolver:
    """Poses from sightings for one camera over one floor. Pure functions of their arguments."""

    def __init__(self, camera: CameraModel, markers: MarkerMap) -> None:
        self._camera = camera
        self._corners_ned_m = markers.corners_ned_m
        self._plane_m = markers.corners_ned_m[..., 0] + 1j * markers.corners_ned_m[..., 1]
        self._floor_m = float(markers.corners_ned_m[..., 2].mean())
        self._centers: list[complex] = self._plane_m.mean(axis=1).tolist()
        self._by_id: dict[int, list[tuple[int, complex]]] = {}
        for j, (i, center) in enumerate(zip(markers.ids.tolist(), self._centers, strict=True)):
            self._by_id.setdefault(i, []).append((j, center))

    def well_formed(self, sighting: MarkerSighting) -> bool:
        """Whether the arrays have the right shapes and hold pixels that an image can have."""
        corners = np.asarray(sighting.corners_px)
        # Comparisons with NaN are false.
        if corners.shape != (len(sighting.ids), 4, 2) or not (np.abs(corners) < MAX_PIXEL).all():
            return False
        laser = sighting.laser_px
        return laser is None or (np.shape(laser) == (2,) and bool((np.abs(laser) < MAX_PIXEL).all()))

    def track(self, sighting: MarkerSighting, pos_ned_m: FloatArray, rpy_rad: FloatArray) -> PoseFix | None:
        """Fix near a predicted pose, None if the markers do not fit to it."""
        known = [k for k, i in enumerate(sighting.ids) if i in self._by_id]
        if not known:
            return None
        r_ned = r_ned_from_frd(rpy_rad)
        eye = pos_ned_m + r_ned @ self._camera.position_frd_m
        rays = self._camera.normalized(0.25 * sighting.corners_px[known].sum(axis=1))
        rays_ned = np.column_stack((rays, np.ones(len(rays)))) @ (r_ned @ self._camera.r_frd_from_cam).T
        scale = (self._floor_m - eye[2]) / np.maximum(rays_ned[:, 2], 0.1)
        seen = eye[0] + 1j * eye[1] + scale * (rays_ned[:, 0] + 1j * rays_ned[:, 1])
        matched, which, shifts = [], [], []
        for k, place in zip(known, seen.tolist(), strict=True):
            offset, best = min((abs(center - place), j) for j, center in self._by_id[sighting.ids[k]])
            if offset <= NEAREST_M:
                matched.append(k)
                which.append(best)
                shifts.append(self._centers[best] - place)
        if not matched:
            return None
        common = complex(_median([s.real for s in shifts]), _median([s.imag for s in shifts]))
        alike = [k for k, shift in enumerate(shifts) if abs(shift - common) <= COMMON_SHIFT_M]
        if 2 * len(alike) < len(matched) or not alike:
            return None
        start = pos_ned_m + np.array([common.real, common.imag, 0.0])
        return self._refine(sighting, np.array(matched)[alike], np.array(which)[alike], start, rpy_rad)

    def locate(self, sighting: MarkerSighting, roll_rad: float, pitch_rad: float) -> PoseFix | None:
        """Fix from nothing but the tilt: every marker of the image votes, None without a clear winner."""
        q = self._level_rays(sighting.corners_px, roll_rad, pitch_rad)
        pairs = [(k, j) for k, i in enumerate(sighting.ids) for j, _ in self._by_id.get(i, ())]
        if not pairs:
            return None
        seen, placed = np.array(pairs).T
        # Best similarity w = a q + b between level image plane and floor: |a| height, arg a heading, b place.
        qc = q - q.mean(axis=1, keepdims=True)
        w = self._plane_m[placed]
        wc = w - w.mean(axis=1, keepdims=True)
        power = np.maximum((np.abs(qc) ** 2).sum(axis=1), 1e-12)
        a = (qc[seen].conj() * wc).sum(axis=1) / power[seen]
        misfit = np.abs(wc - a[:, None] * qc[seen]).max(axis=1)
        b = w.mean(axis=1) - a * q.mean(axis=1)[seen]
        square = misfit <= SIMILAR * np.abs(w[:, 1] - w[:, 0])
        if not square.any():
            return None
        seen, placed, a, b = seen[square], placed[square], a[square], b[square]
        chosen = _winner(seen, a, b)
        if chosen is None:
            return None
        a_mean, b_mean = a[chosen].mean(), b[chosen].mean()
        rpy = np.array([roll_rad, pitch_rad, math.atan2(a_mean.imag, a_mean.real)])
        eye = np.array([b_mean.real, b_mean.imag, self._floor_m - abs(a_mean)])
        pos = eye - r_ned_from_frd(rpy) @ self._camera.position_frd_m
        return self._refine(sighting, seen[chosen], placed[chosen], pos, rpy)

    def laser_range(self, sighting: MarkerSighting) -> tuple[float, float] | None:
        """Range along the beam and its sigma [m] from the dot's pixel, None without a dot or one off its line."""
        if sighting.laser_px is None:
            return None
        dx, dy, dz = self._camera.laser_direction_cam.tolist()
        ox, oy, oz = self._camera.laser_offset_cam_m.tolist()
        # A dot at depth Z is seen at (dx, dy) / dz, the beam's vanishing point, plus (ox, oy) / Z, where the beam passes
        # (ox, oy) beside the lens.
        ox, oy = ox - oz * dx / dz, oy - oz * dy / dz
        x, y = self._camera.normalized(np.asarray(sighting.laser_px, dtype=float)).tolist()
        x, y = x - dx / dz, y - dy / dz
        focal = 0.5 * sum(self._camera.focal_px)
        base2 = ox * ox + oy * oy
        along = ox * x + oy * y
        if base2 == 0.0 or along <= 0.0 or abs(ox * y - oy * x) / math.sqrt(base2) * focal > LASER_OFF_LINE_PX:
            return None
        depth = base2 / along
        if (depth - oz) / dz < LASER_MIN_RANGE_M:
            return None
        return (depth - oz) / dz, depth * depth * LASER_SIGMA_PX / (focal * math.sqrt(base2) * dz)

    def _level_rays(self, corners_px: FloatArray, roll_rad: float, pitch_rad: float) -> np.ndarray:
        """(n, 4) complex forward + i right of the corners on a level plane one metre below the camera."""
        rays = self._camera.normalized(corners_px)
        level = r_ned_from_frd(np.array([roll_rad, pitch_rad, 0.0])) @ self._camera.r_frd_from_cam
        full = np.concatenate((rays, np.ones((*rays.shape[:-1], 1))), axis=-1) @ level.T
        down = np.maximum(full[..., 2], 0.1)
        result: np.ndarray = (full[..., 0] + 1j * full[..., 1]) / down
        return result

    def _refine(
        self, sighting: MarkerSighting, seen: IntArray, placed: IntArray, pos: FloatArray, rpy: FloatArray
    ) -> PoseFix | None:
        """Least squares over the corners; markers that do not fit are left out and it is done again."""
        pixels, points = sighting.corners_px[seen], self._corners_ned_m[placed]
        good = np.ones(len(seen), dtype=bool)
        best = None
        for round_left in reversed(range(REJECT_ROUNDS)):
            best = solve_pose(
                self._camera,
                points[good].reshape(-1, 3),
                pixels[good].reshape(-1, 2),
                pos if best is None else best.pos_ned_m,
                rpy if best is None else best.rpy_rad,
                max_rms_px=FINAL_RMS_PX if round_left == 0 else FIRST_RMS_PX,
            )
            if best is None:
                return None
            worst = np.sqrt((best.residual_px.reshape(-1, 4, 2) ** 2).sum(axis=2)).max(axis=1)
            fits = worst <= max(REJECT_FLOOR_PX, REJECT_SIGMAS * _median(worst.tolist()))
            if fits.all():
                break
            good[np.flatnonzero(good)[~fits]] = False
        if best is None or best.rms_px > FINAL_RMS_PX:
            return None
        z = np.append(best.pos_ned_m, best.rpy_rad[2])
        return PoseFix(
            sensor="markers",
            t_us=sighting.t_us,
            z=z,
            noise=best.covariance,
            tilt_rad=(float(best.rpy_rad[0]), float(best.rpy_rad[1])),
            sigma_tilt_rad=best.sigma_tilt_rad,
        )


def _median(values: list[float]) -> float:
    """The upper median: good enough here and cheaper than numpy's for a few dozen."""
    return sorted(values)[len(values) // 2]


def _winner(seen: IntArray, a: np.ndarray, b: np.ndarray) -> IntArray | None:
    """Indices of the votes (one per marker) that agree on the most popular place, None if it is not clear."""
    height, direction = np.abs(a), a / np.abs(a)
    agree = (
        (np.abs(b[:, None] - b[None, :]) < VOTE_M)
        & (np.abs(direction[:, None] - direction[None, :]) < VOTE_RAD)
        & (np.abs(height[:, None] - height[None, :]) < VOTE_SCALE * height[:, None])
    )
    count = agree.sum(axis=1)
    best = int(count.argmax())
    # Votes that share no supporter with the winner are other places.
    elsewhere = count[~(agree[best] | (np.abs(b - b[best]) < 3.0 * VOTE_M))]
    rival = int(elsewhere.max()) if len(elsewhere) else 0
    if 2 * rival > count[best]:
        return None
    chosen = np.flatnonzero(agree[best])
    _, once = np.unique(seen[chosen], return_index=True)
    result: IntArray = chosen[once]
    return result
