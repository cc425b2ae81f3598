"""Pose from a marker sighting: association of detections with the map, and pose estimation.

Ids repeat over the floor. With a pose prior, a detection is associated with the nearest marker of its id
(:meth:`MarkerSolver.track`); without, every detection votes for all poses that would explain it
(:meth:`MarkerSolver.locate`). Both end in the same least squares over all corners (:mod:`.estimator.pnp`). Markers may
have any position and attitude: association is at each marker's own depth, and votes use its square.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from autopilot.core.camera import CameraModel
from autopilot.core.frames import FloatArray, r_ned_from_frd
from autopilot.core.laser_dot import dot_range
from autopilot.core.map_errors import STATES
from autopilot.core.markers import IntArray, MarkerMap
from autopilot.core.messages import MarkerFit
from autopilot.core.samples import MarkerSighting
from autopilot.estimator.camera_monitor import focal_estimate
from autopilot.estimator.compiled_fit import LONG, compiled_fit
from autopilot.estimator.estimator_tuning import CAMERA_MONITOR, MARKERS_POSE, PNP
from autopilot.estimator.ground import SheetTies, estimated_offsets
from autopilot.estimator.measure_pose import MarkerOutlier, PoseFix, SheetDependence
from autopilot.estimator.measurement import CHI2_999
from autopilot.estimator.pnp import Pose, inward_of, linearise_corners, solve_pose
from autopilot.estimator.sheet_fit import SheetCorners, SheetPose, fit_on_sheets
from autopilot.estimator.states import SheetStates

LEVEL_RAD = math.radians(15.0)
"""Markers that lean less are taken as level when they vote."""
LEANING_RAD = math.radians(1.5)
"""Three standard deviations of the AHRS's tilt: if the image shows a larger difference, principal point, focal length
or mounting are wrong, or the AHRS."""


class _Match(NamedTuple):
    """Which marker of the map each marker of an image is, near a predicted pose."""

    known: IntArray
    """(n,) markers of the image whose id the map has,"""
    taken: IntArray
    """(n,) the marker of the map that each is taken for, -1 = none,"""
    shift_m: np.ndarray
    """(n,) complex, from where it seems to lie to where that one lies,"""
    rays_cam: FloatArray
    """(n, 3) and its ray in the camera frame, z = 1."""


class _Laid(NamedTuple):
    corners: SheetCorners
    which: tuple[int, ...]
    """Sheets of the picture."""
    sigma: FloatArray
    """(n, 4) of their offsets."""


class _Solved(NamedTuple):
    fix: PoseFix
    worst_px: float
    """How far the worst of all the corners lies from its projection; infinite when a marker was left out."""


class MarkerSolver:
    """Poses from sightings for one camera over one floor. Functions of their arguments, which are counted."""

    def __init__(self, camera: CameraModel, markers: MarkerMap) -> None:
        self._camera = self._given_camera = camera
        self._given_corners_m = markers.corners_ned_m
        self.set_print(0.0)
        self._depth_m = markers.centers_ned_m[:, 2]
        self.counts = {"unknown": 0, "misfit": 0, "leaning": 0}
        """Markers that the map does not have; fits that are bad, or that lean off the AHRS's tilt."""
        self._errors = markers.errors
        self._centers_m = markers.centers_ned_m[:, :2]
        self._formed: MarkerSighting | None = None
        """The newest one that is: it is asked for its pose, and for its laser dot."""
        self._focal_us, self._focal_looks = -CAMERA_MONITOR.focal_every_us, 0
        self._level = markers.level
        self._floor_m = markers.floor_m
        lean_m = np.ptp(markers.corners_ned_m[..., 2], axis=1)
        self._leaning = lean_m > math.sin(LEVEL_RAD) * np.maximum(markers.sizes_m, 1e-9)
        self._centers: list[complex] = self._plane_m.mean(axis=1).tolist()
        self._by_id: dict[int, list[int]] = {}
        for j, i in enumerate(markers.ids.tolist()):
            self._by_id.setdefault(i, []).append(j)
        self._row = {i: row for row, i in enumerate(self._by_id)}
        most = max(map(len, self._by_id.values()), default=1)
        self._candidates = np.full((len(self._by_id), most), -1, dtype=LONG)
        """(ids, most) markers of each id, -1 = no more,"""
        self._candidate_centers = np.full(self._candidates.shape, complex(math.inf, 0.0))
        """and where they lie, north + i east [m]."""
        for row, of_id in enumerate(self._by_id.values()):
            self._candidates[row, : len(of_id)] = of_id
            self._candidate_centers[row, : len(of_id)] = [self._centers[j] for j in of_id]

    def set_lens(self, focal_error: float, distortion_error: float) -> None:
        """Set the relative excess of focal length and distortion to be corrected."""
        given = self._given_camera
        fx, fy = (f / (1.0 + focal_error) for f in given.focal_px)
        k1, k2, k3, k4, k5 = (k / (1.0 + distortion_error) for k in given.distortion)
        self._camera = replace(given, focal_px=(fx, fy), distortion=(k1, k2, k3, k4, k5))

    def set_print(self, error: float) -> None:
        """Set the share by which the printed markers are larger than the map has them."""
        middles_m = self._given_corners_m.mean(axis=1, keepdims=True)
        self._corners_ned_m = middles_m + (1.0 + error) * (self._given_corners_m - middles_m)
        self._plane_m = self._corners_ned_m[..., 0] + 1j * self._corners_ned_m[..., 1]

    def well_formed(self, sighting: MarkerSighting) -> bool:
        """Whether the arrays have the right shapes and hold pixels that an image can have."""
        if sighting is self._formed:
            return True
        corners = np.asarray(sighting.corners_px)
        # Comparisons with NaN are false.
        if corners.shape != (len(sighting.ids), 4, 2) or not (np.abs(corners) < MARKERS_POSE.max_pixel).all():
            return False
        sigma = sighting.sigma_px
        if sigma is not None and (
            np.shape(sigma) != (len(sighting.ids),) or not ((sigma > 0.0) & (sigma < MARKERS_POSE.max_pixel)).all()
        ):
            return False
        laser = sighting.laser_px
        if laser is not None and (np.shape(laser) != (2,) or not (np.abs(laser) < MARKERS_POSE.max_pixel).all()):
            return False
        self._formed = sighting
        return True

    def known_in(self, sighting: MarkerSighting) -> int:
        """Number of its markers whose ids are on the map."""
        return sum(i in self._by_id for i in sighting.ids)

    def track(
        self,
        sighting: MarkerSighting,
        pos_ned_m: FloatArray,
        rpy_rad: FloatArray,
        sheets: SheetStates | None = None,
    ) -> PoseFix | None:
        """Fix near a predicted pose, None if the markers do not fit. ``sheets``: their estimated offsets."""
        match = self._match(sighting, pos_ned_m, rpy_rad)
        if match is None:
            return None
        found = match.taken >= 0
        shifts = match.shift_m[found]
        common = complex(_median(shifts.real.tolist()), _median(shifts.imag.tolist()))
        alike = np.abs(shifts - common) <= MARKERS_POSE.common_shift_m
        count = int(alike.sum())
        if 2 * count < len(alike) or not count:
            return None
        start = pos_ned_m + np.array([common.real, common.imag, 0.0])
        seen, placed = match.known[found][alike], match.taken[found][alike]
        solved = self._refine(sighting, seen, placed, start, rpy_rad, sheets)
        if solved is None:
            return None
        away_m = self._floor_m - float(pos_ned_m[2])
        if len(match.known) < MARKERS_POSE.outliers_from or (
            count == len(match.known)
            and solved.worst_px * away_m < 0.5 * MARKERS_POSE.outlier_m * self._camera.focal_water_px
        ):
            return solved.fix
        return replace(solved.fix, outliers=self._outliers(sighting, match, solved.fix))

    def _match(self, sighting: MarkerSighting, pos_ned_m: FloatArray, rpy_rad: FloatArray) -> _Match | None:
        """The nearest marker of its id to where each marker of the image seems to lie; None if there is none at all."""
        rows = [self._row.get(i, -1) for i in sighting.ids]
        known = np.array([k for k, row in enumerate(rows) if row >= 0], dtype=np.intp)
        self.counts["unknown"] += len(rows) - len(known)
        if not len(known):
            return None
        r_ned = r_ned_from_frd(rpy_rad)
        eye = pos_ned_m + r_ned @ self._camera.position_frd_m
        compiled = compiled_fit(self._camera) if self._level else None
        if compiled is not None:
            row, turn = np.array(rows)[known], r_ned @ self._camera.r_frd_from_cam
            candidates = self._candidates, self._candidate_centers
            taken, shift, rays_cam = compiled.nearest(
                sighting.corners_px[known], row, candidates, eye, turn, self._floor_m
            )
            taken = np.where(np.abs(shift) <= MARKERS_POSE.nearest_m, taken, -1)
            return _Match(known, taken, shift, rays_cam) if (taken >= 0).any() else None
        rays_cam = np.ones((len(known), 3))
        rays_cam[:, :2] = self._camera.normalized(0.25 * sighting.corners_px[known].sum(axis=1))
        rays_ned = rays_cam @ (r_ned @ self._camera.r_frd_from_cam).T
        if self._level:
            scale = (self._floor_m - eye[2]) / np.maximum(rays_ned[:, 2], 0.1)
            place = complex(eye[0], eye[1]) + scale * (rays_ned[:, 0] + 1j * rays_ned[:, 1])
            row = np.array(rows)[known]
            shifts = self._candidate_centers[row] - place[:, None]
            off_m = np.abs(shifts)
            best = off_m.argmin(axis=1)
            each = np.arange(len(known))
            off_m, shift, taken = off_m[each, best], shifts[each, best], self._candidates[row, best]
        else:
            nearest = [
                min(self._miss(j, eye, ray) for j in self._by_id[sighting.ids[k]])
                for k, ray in zip(known.tolist(), rays_ned, strict=True)
            ]
            off_m, taken, shift = (np.array(column) for column in zip(*nearest, strict=True))
        taken = np.where(off_m <= MARKERS_POSE.nearest_m, taken, -1)
        return _Match(known, taken, shift, rays_cam) if (taken >= 0).any() else None

    def _outliers(self, sighting: MarkerSighting, match: _Match, fix: PoseFix) -> tuple[MarkerOutlier, ...]:
        """Markers of the image that do not lie at their places, seen from the pose that the others ask for."""
        assert fix.tilt_rad is not None
        taken = match.taken
        r_ned = r_ned_from_frd(np.array([*fix.tilt_rad, fix.z[3]]))
        eye = fix.z[:3] + r_ned @ self._camera.position_frd_m
        rays_ned = match.rays_cam @ (r_ned @ self._camera.r_frd_from_cam).T
        depth_m = np.where(taken >= 0, self._depth_m[taken], self._floor_m)
        along = (depth_m - eye[2]) / np.maximum(rays_ned[:, 2], 0.1)
        seen = eye[:2] + along[:, None] * rays_ned[:, :2]
        moved = np.zeros((len(taken), 2))
        if self._errors is not None and fix.ground is not None:
            offset = fix.ground.at.reshape(-1, STATES)
            for k, sheet in enumerate(fix.ground.sheets):
                mine = (taken >= 0) & (self._errors.sheet[taken] == sheet)
                arm = self._centers_m[taken[mine]] - self._errors.pivot_ned_m[sheet, :2]
                moved[mine] = offset[k, :2] + offset[k, 3] * np.column_stack((-arm[:, 1], arm[:, 0]))
        seen = seen - moved
        off = np.where(taken >= 0, np.hypot(*(seen - self._centers_m[taken]).T), np.inf)
        far = off > MARKERS_POSE.outlier_m
        if self._errors is not None:
            far &= self._is_the_marker(taken, off, np.hypot(*moved.T), () if fix.ground is None else fix.ground.sheets)
        quarters = np.where(far | (taken < 0), 0, self._quarters(sighting.corners_px[match.known], taken, fix.z, r_ned))
        ids, place = sighting.ids, seen.tolist()
        return tuple(
            MarkerOutlier(ids[int(match.known[n])], int(taken[n]), place[n][0], place[n][1], int(quarters[n]))
            for n in np.flatnonzero(far | (quarters > 0))
        )

    def _quarters(self, pixels: FloatArray, taken: IntArray, z: FloatArray, r_ned: FloatArray) -> IntArray:
        """(n,) quarters of a turn by which markers (n, 4, 2) are seen turned against the map."""
        drawn = self._camera.project(self._camera.cam_from_ned(self._corners_ned_m[taken], z[:3], r_ned))
        order = (np.arange(4)[:, None] + np.arange(4)) % 4
        turns = np.square(drawn[:, order] - pixels[:, None]).sum(axis=(2, 3)).argmin(axis=1)
        result: IntArray = np.minimum(turns, 4 - turns)
        return result

    def _is_the_marker(
        self, taken: IntArray, off_m: FloatArray, moved_m: FloatArray, sheets: tuple[int, ...]
    ) -> np.ndarray:
        """(n,) whether the marker is off by ``off_m``, and not its sheet, which was found ``moved_m`` from the map (by
        another marker that is off, perhaps).
        """
        assert self._errors is not None
        sheet = np.where(taken >= 0, self._errors.sheet[taken], -1)
        alike = ((sheet[:, None] == sheet) & (off_m <= MARKERS_POSE.outlier_m)).sum(axis=1)
        in_pose = (alike >= 2) | (moved_m < 0.25 * off_m)
        beyond = off_m > MARKERS_POSE.outlier_m + 3.0 * self._errors.sigma[sheet, 0]
        result: np.ndarray = (sheet < 0) | np.where(np.isin(sheet, sheets), in_pose, (alike >= 1) & beyond)
        return result

    def _miss(self, j: int, eye_ned_m: FloatArray, ray_ned: FloatArray) -> tuple[float, int, complex]:
        """Distance of a camera ray from the centre of marker j: distance, j, north + i east."""
        to_marker = np.array([self._centers[j].real, self._centers[j].imag, self._depth_m[j]]) - eye_ned_m
        if to_marker @ ray_ned <= 0.0:
            return math.inf, j, 0j
        unit = ray_ned / np.linalg.norm(ray_ned)
        along = to_marker[2] / unit[2] if unit[2] > MARKERS_POSE.steep else to_marker @ unit
        miss = to_marker - along * unit
        return float(np.linalg.norm(miss)), j, complex(miss[0], miss[1])

    def locate(
        self, sighting: MarkerSighting, roll_rad: float, pitch_rad: float, sheets: SheetStates | None = None
    ) -> PoseFix | None:
        """Fix from nothing but the tilt: every marker of the image votes, None without a clear winner."""
        q = self._level_rays(sighting.corners_px, roll_rad, pitch_rad)
        pairs = [(k, j) for k, i in enumerate(sighting.ids) for j in self._by_id.get(i, ())]
        if not pairs:
            return None
        seen, placed = np.array(pairs).T
        a, b, square = self._votes(q, seen, placed)
        if not square.any():
            return None
        seen, placed, a, b = seen[square], placed[square], a[square], b[square]
        eye_depth = self._depth_m[placed] - np.abs(a)
        chosen = _winner(seen, a, b, eye_depth)
        if chosen is None:
            return None
        a_mean, b_mean = a[chosen].mean(), b[chosen].mean()
        rpy = np.array([roll_rad, pitch_rad, math.atan2(a_mean.imag, a_mean.real)])
        eye = np.array([b_mean.real, b_mean.imag, eye_depth[chosen].mean()])
        pos = eye - r_ned_from_frd(rpy) @ self._camera.position_frd_m
        solved = self._refine(sighting, seen[chosen], placed[chosen], pos, rpy, sheets)
        return None if solved is None else solved.fix

    def _votes(self, q: np.ndarray, seen: IntArray, placed: IntArray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Camera pose for which quadrilateral ``seen`` is marker ``placed`` (both (n,)): height over the marker and
        heading as one number (n,), position (n,), and whether the quadrilateral fits the marker's square.
        """
        # Best similarity w = a q + b between level image plane and floor: |a| height, arg a the heading, b place.
        qc = q - q.mean(axis=1, keepdims=True)
        w = self._plane_m[placed]
        wc = w - w.mean(axis=1, keepdims=True)
        power = np.maximum((np.abs(qc) ** 2).sum(axis=1), 1e-12)
        a = (qc[seen].conj() * wc).sum(axis=1) / power[seen]
        misfit = np.abs(wc - a[:, None] * qc[seen]).max(axis=1)
        b = w.mean(axis=1) - a * q.mean(axis=1)[seen]
        square = misfit <= MARKERS_POSE.similar * np.abs(w[:, 1] - w[:, 0])
        for n in np.flatnonzero(self._leaning[placed]):
            vote = self._leaning_vote(q[seen[n]], int(placed[n]))
            square[n] = vote is not None
            if vote is not None:
                a[n], b[n] = vote
        return a, b, square

    def _leaning_vote(self, q: np.ndarray, j: int) -> tuple[complex, complex] | None:
        """The vote of one inclined marker: with known tilt its corners are linear in heading and position."""
        offsets = self._corners_ned_m[j] - self._corners_ned_m[j].mean(axis=0)
        north, east, down = offsets.T
        rows = np.zeros((8, 5))
        # Corner in the level frame: (c n + s e + tx, c e - s n + ty, d + tz), seen at (q.real, q.imag) on z = 1.
        rows[0::2] = np.column_stack((north, east, np.ones(4), np.zeros(4), -q.real))
        rows[1::2] = np.column_stack((east, -north, np.zeros(4), np.ones(4), -q.imag))
        right = np.empty(8)
        right[0::2], right[1::2] = q.real * down, q.imag * down
        (c, s, tx, ty, tz), _, rank, _ = np.linalg.lstsq(rows, right, rcond=None)
        length = math.hypot(c, s)
        if rank < 5 or tz <= 0.0 or abs(length - 1.0) > MARKERS_POSE.unit:
            return None
        turn = complex(c, s) / length
        return tz * turn, self._centers[j] - turn * complex(tx, ty)

    def laser_range(self, sighting: MarkerSighting) -> tuple[float, float] | None:
        """Range along the beam and its sigma [m] from the dot's pixel, None without a dot or one off its line."""
        return None if sighting.laser_px is None else dot_range(self._camera, sighting.laser_px)

    def _level_rays(self, corners_px: FloatArray, roll_rad: float, pitch_rad: float) -> np.ndarray:
        """(n, 4) complex forward + i right of the corners on a level plane one metre below the camera."""
        rays = self._camera.normalized(corners_px)
        level = r_ned_from_frd(np.array([roll_rad, pitch_rad, 0.0])) @ self._camera.r_frd_from_cam
        full = np.concatenate((rays, np.ones((*rays.shape[:-1], 1))), axis=-1) @ level.T
        down = np.maximum(full[..., 2], 0.1)
        return (full[..., 0] + 1j * full[..., 1]) / down

    def _refine(
        self,
        sighting: MarkerSighting,
        seen: IntArray,
        placed: IntArray,
        pos: FloatArray,
        rpy: FloatArray,
        sheets: SheetStates | None,
    ) -> _Solved | None:
        """Least squares over the corners; markers and sheets that do not fit are left out and it is done again."""
        good = np.ones(len(seen), dtype=bool)
        best: Pose | SheetPose | None = None
        laid: _Laid | None = None
        strained: list[int] = []

        def fit(
            some: np.ndarray, start_ned_m: FloatArray, max_rms_px: float, laid: _Laid | None = None
        ) -> Pose | SheetPose | None:
            laid = self._laid(sighting, seen[some], placed[some]) if laid is None else laid
            if laid is not None:
                prior = estimated_offsets(sheets, laid.which, laid.sigma)
                return fit_on_sheets(self._camera, laid.corners, prior, start_ned_m, rpy, max_rms_px=max_rms_px)
            return solve_pose(
                self._camera,
                self._corners_ned_m[placed[some]].reshape(-1, 3),
                sighting.corners_px[seen[some]].reshape(-1, 2),
                start_ned_m,
                rpy,
                max_rms_px=max_rms_px,
                sigma_px=None if sighting.sigma_px is None else np.repeat(sighting.sigma_px[seen[some]], 4),
            )

        for round_left in reversed(range(MARKERS_POSE.reject_rounds)):
            before, laid = laid, self._laid(sighting, seen[good], placed[good])
            if before is not None and laid is None:  # all sheets have been left out
                solved = self._refine(sighting, seen[good], placed[good], pos, rpy, sheets)
                return None if solved is None else _Solved(replace(solved.fix, strained=tuple(strained)), math.inf)
            best = fit(good, pos if best is None else best.pos_ned_m, _max_rms_px(round_left), laid)
            if best is None:
                odd = _odd_one(good, np.arange(int(good.sum())), partial(fit, start_ned_m=pos)) if round_left else None
                if odd is None:
                    self.counts["misfit"] += 1
                    return None
                good[np.flatnonzero(good)[odd]] = False
                continue
            off_px = _worst_px(best.residual_px.reshape(-1, 4, 2))
            fits = _fitting(off_px)
            if round_left:
                sheet = np.full(len(fits), -1) if laid is None else laid.corners.sheet
                odd = _odd_one(good, _suspects(fits, off_px, sheet), partial(fit, start_ned_m=best.pos_ned_m))
                if odd is not None:
                    fits = np.arange(len(fits)) != odd
            if laid is not None and isinstance(best, SheetPose):
                k = int(best.strain.argmax())
                mine = laid.corners.sheet == k
                # The filter would reject the whole picture for the sake of such a sheet.
                if fits.all() and best.strain[k] > CHI2_999[STATES] and int((~mine).sum()) >= 2:
                    strained.append(laid.which[k])
                    fits = ~mine
            if fits.all() or round_left == 0:
                break
            good[np.flatnonzero(good)[~fits]] = False
        if best is None or not self._good(best.rms_px, best.rpy_rad, rpy):
            return None
        pixels = sighting.corners_px[seen[good]]
        due = self._focal_due(sighting.t_us, len(pixels))
        fix = PoseFix(
            sensor="markers",
            t_us=sighting.t_us,
            stamp_sigma_s=sighting.stamp_sigma_s,
            focal=self._focal(best, self._corners_ned_m[placed[good]], pixels) if due else None,
            z=best.z if isinstance(best, SheetPose) else np.append(best.pos_ned_m, best.rpy_rad[2]),
            noise=best.noise,
            tilt_rad=(float(best.rpy_rad[0]), float(best.rpy_rad[1])),
            sigma_tilt_rad=best.sigma_tilt_rad,
            strained=tuple(strained),
            print_error=_print_error(pixels, best),
            fit=_fit(len(seen), best.rms_px, off_px),
        )
        if laid is not None and isinstance(best, SheetPose):
            ground = SheetDependence(laid.which, laid.sigma, best.by_offsets, best.at)
            fix = replace(fix, ground=ground, ties=partial(_ties, best, sighting.t_us, laid.which, laid.sigma))
        return _Solved(fix, float(off_px.max()) if good.all() else math.inf)

    def _laid(self, sighting: MarkerSighting, seen: IntArray, placed: IntArray) -> _Laid | None:
        """Markers of a picture with the sheets that they lie on; None if they are on none."""
        errors = self._errors
        numbers = [] if errors is None else errors.sheet[placed].tolist()
        which = tuple(sorted({number for number in numbers if number >= 0}))
        if errors is None or not which:
            return None
        place = {number: k for k, number in enumerate(which)}
        corners = SheetCorners(
            corners_ned_m=self._corners_ned_m[placed],
            pixels=sighting.corners_px[seen],
            sheet=np.array([place.get(number, -1) for number in numbers]),
            pivot_ned_m=errors.pivot_ned_m[list(which)],
            sigma_m=errors.marker_sigma_m[placed],
            sigma_px=None if sighting.sigma_px is None else sighting.sigma_px[seen],
        )
        return _Laid(corners, which, errors.sigma[list(which)])

    def _focal(
        self, best: Pose | SheetPose, corners_ned_m: FloatArray, pixels: FloatArray
    ) -> tuple[float, float] | None:
        """:attr:`PoseFix.focal` of the markers (n, 4, 3) of a fit, at pixels (n, 4, 2)."""
        corners, at = pixels.reshape(-1, 2), corners_ned_m.reshape(-1, 3)
        if isinstance(best, SheetPose):
            jacobian = best.jacobian()
        else:
            linear = linearise_corners(self._camera, at, corners, best.pos_ned_m, r_ned_from_frd(best.rpy_rad))
            if linear is None:
                return None
            jacobian = np.column_stack((linear[1], inward_of(corners)))
        return focal_estimate(self._camera, corners, best.residual_px.reshape(-1), jacobian)

    def _good(self, rms_px: float, found_rpy_rad: FloatArray, rpy_rad: FloatArray) -> bool:
        """Whether a fit is acceptable as a fix; the reason for a rejection is counted. ``rpy_rad``: the initial
        attitude.
        """
        if rms_px > MARKERS_POSE.final_rms_px:
            self.counts["misfit"] += 1
            return False
        self.counts["misfit"] += rms_px > MARKERS_POSE.misfit_rms_px
        self.counts["leaning"] += float(np.abs(found_rpy_rad[:2] - rpy_rad[:2]).max()) > LEANING_RAD
        return True

    def _focal_due(self, t_us: int, markers: int) -> bool:
        """Whether this picture is to be asked for the focal length."""
        every_us = CAMERA_MONITOR.focal_every_us if self._focal_looks >= CAMERA_MONITOR.focal_soon else 0
        if markers < CAMERA_MONITOR.least_markers or abs(t_us - self._focal_us) < every_us:
            return False
        self._focal_us, self._focal_looks = t_us, self._focal_looks + 1
        return True


def _ties(best: SheetPose, t_us: int, which: tuple[int, ...], sigma: FloatArray) -> SheetTies | None:
    """Measurement of the relative sheet offsets from a fit."""
    rows, z, noise = best.ties()
    if not len(rows):
        return None
    ground = SheetDependence(which, sigma, rows, np.zeros(len(best.at)), learns=True)
    return SheetTies(sensor="sheets", t_us=t_us, z=z, noise=noise, ground=ground)


def _print_error(pixels: FloatArray, fitted: Pose | SheetPose) -> tuple[float, float] | None:
    """See :attr:`PoseFix.print_error`, of markers (n, 4, 2): what blur does not explain of their corners' displacement
    towards their centres, which is told from height by the distances between three markers or more."""
    if 4 * len(pixels) <= PNP.few_points:
        return None
    inward = pixels.mean(axis=1, keepdims=True) - pixels
    length_px = np.maximum(np.sqrt(np.einsum("ijk,ijk->ij", inward, inward)), 1e-6)
    half_px = float(length_px.mean())
    # A fit that is far off its prior of blur takes itself for noisy and stays near it: the rest is in the residuals.
    residual = fitted.residual_px.reshape(inward.shape)
    left_px = float(np.einsum("ijk,ijk,ij->", residual, inward, 1.0 / length_px)) / length_px.size
    return (PNP.shrink_px - fitted.shrink_px - left_px) / half_px, PNP.shrink_sigma_px / half_px


def _fit(known: int, rms_px: float, worst_px: FloatArray) -> MarkerFit:
    """Fit record of ``known`` markers from the RMS residual per axis and each used marker's worst corner (n,)."""
    worst = float(worst_px.max())
    return MarkerFit(known=known, used=len(worst_px), rms_px=math.sqrt(2.0) * rms_px, worst_px=worst)


def _worst_px(residual_px: FloatArray) -> FloatArray:
    """(n,) the worst of each marker's corners' residuals (n, 4, 2)."""
    x, y = residual_px[..., 0], residual_px[..., 1]
    result: FloatArray = np.sqrt((x * x + y * y).max(axis=1))
    return result


def _fitting(worst_px: FloatArray) -> np.ndarray:
    """(n,) which markers fit to the others, by the worst of their corners (n,)."""
    return worst_px <= max(MARKERS_POSE.reject_floor_px, MARKERS_POSE.reject_sigmas * _median(worst_px.tolist()))


def _max_rms_px(round_left: int) -> float:
    return MARKERS_POSE.first_rms_px if round_left else MARKERS_POSE.final_rms_px


def _suspects(fits: np.ndarray, worst_px: FloatArray, sheet: IntArray) -> IntArray:
    """Markers of which one may be wrong and have dragged the pose, or the sheet that no marker fits, along."""
    if fits.all():
        return np.arange(len(fits) if float(worst_px.max()) > MARKERS_POSE.reject_floor_px else 0)
    for k in np.unique(sheet[~fits]).tolist():
        mine = sheet == k
        if k >= 0 and not fits[mine].any():
            return np.flatnonzero(mine)
    return np.arange(0)


def _odd_one(good: np.ndarray, suspects: IntArray, fit: Callable[..., Pose | SheetPose | None]) -> int | None:
    """The one of the ``suspects`` among the markers ``good`` without which, and only without which, the others fit."""
    if not 3 <= len(suspects) <= MARKERS_POSE.few:
        return None
    left_px = np.full(len(suspects), math.inf)
    for k, marker in enumerate(np.flatnonzero(good)[suspects]):
        some = good.copy()
        some[marker] = False
        found = fit(some, max_rms_px=MARKERS_POSE.first_rms_px)
        if found is not None:
            left_px[k] = _worst_px(found.residual_px.reshape(-1, 4, 2)).max()
    odd, (first_px, second_px) = int(left_px.argmin()), np.sort(left_px)[:2].tolist()
    clear = first_px <= MARKERS_POSE.reject_floor_px and second_px > MARKERS_POSE.reject_sigmas * first_px
    return int(suspects[odd]) if clear else None


def _median(values: list[float]) -> float:
    """The upper median: good enough here and cheaper than numpy's for a few dozen."""
    return sorted(values)[len(values) // 2]


def _winner(seen: IntArray, a: np.ndarray, b: np.ndarray, eye_depth_m: np.ndarray) -> IntArray | None:
    """Indices of the votes (one per marker) that agree on the most popular place, None if it is not clear."""
    height, direction = np.abs(a), a / np.abs(a)
    agree = (
        (np.abs(b[:, None] - b[None, :]) < MARKERS_POSE.vote_m)
        & (np.abs(direction[:, None] - direction[None, :]) < MARKERS_POSE.vote_rad)
        & (np.abs(eye_depth_m[:, None] - eye_depth_m[None, :]) < MARKERS_POSE.vote_scale * height[:, None])
    )
    count = agree.sum(axis=1)
    best = int(count.argmax())
    # Votes that share no supporter with the winner are other places.
    elsewhere = count[~(agree[best] | (np.abs(b - b[best]) < 3.0 * MARKERS_POSE.vote_m))]
    rival = int(elsewhere.max()) if len(elsewhere) else 0
    if 2 * rival > count[best]:
        return None
    chosen = np.flatnonzero(agree[best])
    _, once = np.unique(seen[chosen], return_index=True)
    return chosen[once]
