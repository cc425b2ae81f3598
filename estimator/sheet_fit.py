"""Pose from the corners of markers on displaced sheets: pose, tilt, blur and sheet offsets in one fit.

A free fit of six degrees of freedom would tilt where two sheets do not match: a millimetre between them has the effect
of half a degree, and that of 7 mm in position. Here sheets may move within their uncertainty, and the tilt within that
of the AHRS. The filter gets two independent results: the pose with its dependence on the offsets, and the relative
offsets.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from autopilot.core.camera import CameraModel
from autopilot.core.frames import FloatArray, rpy_from_r
from autopilot.core.map_errors import STATES
from autopilot.core.markers import IntArray
from autopilot.estimator.compiled_fit import LEAST_PRINT, POSE, PRINT_COUNT, PRIOR_FLOOR, CompiledFit, Fitted, OnSheets
from autopilot.estimator.estimator_tuning import PNP
from autopilot.estimator.pnp import CornerFit, add_priors, floored, rms_of

TILT_INFORMATION = 0.009**-2
"""0.5 degrees: the AHRS's tilt as a prior, however many markers are seen."""
TIE_FLOOR = (2e-4, 2e-4, 2e-4, 3e-4)
"""m, rad: what one picture says of a sheet among others is never taken as better. Tilt and lens are off in the same way
in the next one."""
LEAST_EIGENVALUE = 1e-7
"""Directions of which the picture knows less than this share of the best known one are left out."""
KEPT = [0, 1, 2, 5]
NUISANCE = [3, 4, 6]


class SheetPose(NamedTuple):
    pos_ned_m: FloatArray
    """(3,)"""
    rpy_rad: FloatArray
    """(3,)"""
    z: FloatArray
    """(4,) north, east, down, yaw that the corners ask for with the offsets ``at``."""
    noise: FloatArray
    """(4, 4) of z; floors included."""
    by_offsets: FloatArray
    """(4, 4n) d z / d offsets."""
    at: FloatArray
    """(4n,)"""
    alone: tuple[FloatArray, FloatArray]
    """(4n, 4n), (4n,) information and gradient of the offsets alone, about ``at``; see :meth:`ties`."""
    strain: FloatArray
    """(n,) squared distance of each sheet's offset from the prior, of 4."""
    sigma_tilt_rad: float
    jacobian: Callable[[], FloatArray]
    """(8m, 7 + 4n) of the pixels by pose, blur and offsets; seldom asked for."""
    residual_px: FloatArray
    """(m, 4, 2)"""
    rms_px: float
    shrink_px: float

    def ties(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Measurement of the offsets alone: rows (r, 4n), values (r,), covariance (r, r)."""
        alone, toward = self.alone
        eigenvalues, rows = np.linalg.eigh(0.5 * (alone + alone.T))
        known = eigenvalues > LEAST_EIGENVALUE * max(float(eigenvalues[-1]), 1.0)
        ties = np.sqrt(eigenvalues[known])[:, None] * rows[:, known].T
        z = ties @ self.at + rows[:, known].T @ toward / np.sqrt(eigenvalues[known])
        floor = np.tile(np.array(TIE_FLOOR) ** 2, len(self.at) // STATES)
        return ties, z, np.eye(len(ties)) + (ties * floor) @ ties.T


class SheetCorners(NamedTuple):
    """Markers of a picture by the map, and the sheets that they lie on."""

    corners_ned_m: FloatArray
    """(m, 4, 3) as the map has them."""
    pixels: FloatArray
    """(m, 4, 2)"""
    sheet: IntArray
    """(m,) place of each marker's sheet among the n of the picture, -1 = none."""
    pivot_ned_m: FloatArray
    """(n, 3)"""
    sigma_m: FloatArray
    """(m,) of each marker on its sheet."""
    sigma_px: FloatArray | None = None
    """(m,) what to expect of each marker's corners along an axis; None: of all what clear water gives."""

    def only(self, good: FloatArray) -> "SheetCorners":
        """Some of the markers; the sheets stay."""
        return self._replace(
            corners_ned_m=self.corners_ned_m[good],
            pixels=self.pixels[good],
            sheet=self.sheet[good],
            sigma_m=self.sigma_m[good],
            sigma_px=None if self.sigma_px is None else self.sigma_px[good],
        )


def fit_on_sheets(
    camera: CameraModel,
    seen: SheetCorners,
    prior: tuple[FloatArray, FloatArray],
    pos_ned_m: FloatArray,
    rpy_rad: FloatArray,
    max_rms_px: float,
) -> SheetPose | None:
    """Pose of the corners ``seen``, the sheets' offsets being ``prior`` (4n,), (4n, 4n), near a rough pose.

    None if it does not converge or the residuals' root mean square is above ``max_rms_px``."""
    fit = _SheetFit(camera, seen, prior, pos_ned_m, rpy_rad)
    return fit.pose(max_rms_px) if fit.converges() else None


class _SheetFit(CornerFit):
    """The pose and the sheets' offsets."""

    def __init__(
        self,
        camera: CameraModel,
        seen: SheetCorners,
        prior: tuple[FloatArray, FloatArray],
        pos_ned_m: FloatArray,
        rpy_rad: FloatArray,
    ) -> None:
        size = len(prior[0])
        sigma_px = None if seen.sigma_px is None else np.repeat(seen.sigma_px, 4)
        pixels = seen.pixels.reshape(-1, 2)
        super().__init__(camera, pixels, sigma_px, pos_ned_m, rpy_rad, PNP.shrink_px, 7 + size)
        self._sheets, self._prior_offsets = seen, prior
        self._fitted: Fitted | None = None

    def _begin(self) -> None:
        super()._begin()
        offset, covariance = self._prior_offsets
        self._prior = np.linalg.inv(covariance + np.eye(len(offset)) * PRIOR_FLOOR**2)
        self._offset = offset.copy()
        self._places = _places(self._sheets, self._unknowns)

    def _compiled(self, steps: CompiledFit) -> Fitted | None:
        seen = self._sheets
        on = OnSheets(seen.sheet, seen.pivot_ned_m, seen.sigma_m, *self._prior_offsets)
        corners, pose = seen.corners_ned_m, (self._pos, self._rotation)
        self._fitted = steps.converged(corners, self._pixels, self._expected, pose, TILT_INFORMATION, self._shrink, on)
        return self._fitted

    def _points_ned_m(self) -> FloatArray:
        self._points, self._arm = _points(self._sheets, self._offset)
        return self._points.reshape(-1, 3)

    def _linearised(self, jac: FloatArray) -> None:
        super()._linearised(jac)
        self._jac.reshape(-1)[self._places] = _by_offsets(jac, self._arm)[self._sheets.sheet >= 0]

    def _normal_equations(self, residual: FloatArray) -> tuple[FloatArray, FloatArray]:
        self._weight = self._weights() * self._keep
        weighted = self._jac.T * self._weight
        self._information, gradient = weighted @ self._jac, weighted @ residual
        add_priors(self._information, gradient, self._lean, TILT_INFORMATION, self._shrink_prior - self._shrink)
        self._full = self._information.copy()
        self._full[7:, 7:] += self._prior
        gradient[7:] += self._prior @ (self._prior_offsets[0] - self._offset)
        return self._full, gradient

    def _move(self, delta: FloatArray) -> None:
        super()._move(delta)
        self._offset = self._offset + delta[7:]

    def _weights(self) -> FloatArray:
        """(8m,) inverse variance of each pixel coordinate: of corners, and of markers on their sheets, which all four
        corners share."""
        away_m = np.maximum(self._points[:, 0, 2] - self._pos[2], 0.05)
        print_px = self._sheets.sigma_m * self._camera.focal_water_px / away_m
        expected = self._expected[::8]
        scale, ratio = scatter(self._left / self._expected, self._keep, print_px / expected, self._jac.shape[1])
        return np.repeat(1.0 / ((scale * expected) ** 2 + 4.0 * ratio * print_px**2), 8)

    def pose(self, max_rms_px: float) -> SheetPose | None:
        """The converged result, if it is acceptable."""
        left, rotation = self._left, self._rotation
        rms = rms_of(left)
        if not rms <= max_rms_px:
            return None
        found = self._pieces() if self._fitted is None else self._fitted
        rpy = rpy_from_r(rotation)
        return SheetPose(
            pos_ned_m=self._pos,
            rpy_rad=rpy,
            z=np.append(self._pos, rpy[2]) + found.z,
            noise=floored(found.noise),
            by_offsets=found.by_offsets,
            at=found.offset,
            alone=(found.alone, found.toward),
            strain=found.strain,
            sigma_tilt_rad=math.sqrt(found.tilt_variance),
            jacobian=self._jacobian,
            residual_px=left.reshape(-1, 4, 2),
            rms_px=rms,
            shrink_px=found.shrink_px,
        )

    def _jacobian(self) -> FloatArray:
        if self._fitted is None:
            return self._jac
        rows, seen = self._fitted.rows, self._sheets
        jac = np.zeros((len(rows), self._unknowns))
        jac[:, :POSE] = rows[:, :POSE]
        jac.reshape(-1)[_places(seen, self._unknowns)] = rows.reshape(-1, 8, 12)[
            seen.sheet >= 0, :, POSE : POSE + STATES
        ]
        return jac

    def _pieces(self) -> Fitted:
        """The two independent pieces: pose given the offsets, and the offsets alone."""
        information, offset, (expected, covariance) = self._information, self._offset, self._prior_offsets
        gradient = (self._weight * self._left) @ self._jac
        add_priors(None, gradient, self._lean, TILT_INFORMATION, self._shrink_prior - self._shrink)
        posterior: FloatArray = np.asarray(np.linalg.inv(self._full), dtype=np.float64)
        rest = np.array([*KEPT, *range(7, len(information))])
        # Tilt and blur are nuisance parameters: marginalised with their priors.
        mixed = information[np.array(NUISANCE)[:, None], rest]
        held = np.linalg.solve(information[_NUISANCE], mixed)
        less = information[rest[:, None], rest] - mixed.T @ held
        toward = gradient[rest] - held.T @ gradient[NUISANCE]
        noise: FloatArray = np.asarray(np.linalg.inv(less[:4, :4]), dtype=np.float64)
        by_offsets = noise @ less[:4, 4:]
        off = (offset - expected).reshape(-1, STATES)
        blocks = covariance.reshape(-1, STATES, len(off), STATES)[range(len(off)), :, range(len(off))]
        held_by = np.linalg.solve(blocks + np.eye(STATES) * PRIOR_FLOOR**2, off[..., None])[..., 0]
        return Fitted(
            pos_ned_m=self._pos,
            rotation=self._rotation,
            rows=self._jac,
            information=information,
            left=self._left,
            keep=self._keep,
            offset=offset,
            z=noise @ toward[:4],
            noise=noise,
            by_offsets=by_offsets,
            alone=less[4:, 4:] - less[4:, :4] @ by_offsets,
            toward=toward[4:] - by_offsets.T @ toward[:4],
            strain=(off * held_by).sum(axis=1),
            tilt_variance=max(posterior[3, 3], posterior[4, 4]),
            shrink_px=self._shrink,
        )


def _points(seen: SheetCorners, offset: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Corners (m, 4, 3) with the sheets moved, and (m, 4, 2) from the pivot of their sheet, north and east."""
    by_sheet = np.vstack((offset.reshape(-1, STATES), np.zeros(STATES)))  # the last one: on none
    pivot = np.vstack((seen.pivot_ned_m[:, :2], np.zeros(2)))
    move = by_sheet[seen.sheet]
    arm = seen.corners_ned_m[..., :2] - pivot[seen.sheet][:, None]
    c, s = np.cos(move[:, 3])[:, None], np.sin(move[:, 3])[:, None]
    turned = np.empty_like(arm)
    turned[..., 0] = c * arm[..., 0] - s * arm[..., 1]
    turned[..., 1] = s * arm[..., 0] + c * arm[..., 1]
    points = seen.corners_ned_m + move[:, None, :3]
    points[..., :2] += turned - arm
    return points, turned


def _places(seen: SheetCorners, width: int) -> IntArray:
    """(k, 8, 4) where the derivatives by the offsets stand in the flat Jacobian; k markers lie on sheets."""
    on = np.flatnonzero(seen.sheet >= 0)
    rows = 8 * on[:, None, None] + np.arange(8)[:, None]
    columns = 7 + STATES * seen.sheet[on][:, None, None] + np.arange(STATES)
    return rows * width + columns


def _by_offsets(jac: FloatArray, arm: FloatArray) -> FloatArray:
    """(m, 8, 4) d projection / d offset of the marker's sheet from that by the pose (8m, 6): moving a point is
    equivalent to the opposite motion of the vehicle.
    """
    by_pos = jac[:, :3].reshape(-1, 4, 2, 3)
    result = np.empty((len(arm), 4, 2, STATES))
    np.negative(by_pos, out=result[..., :3])
    result[..., 3] = by_pos[..., 0] * arm[..., 1:] - by_pos[..., 1] * arm[..., :1]
    return result.reshape(-1, 8, STATES)


def scatter(residual: FloatArray, keep: FloatArray, print_sigma: FloatArray, unknowns: int) -> tuple[float, float]:
    """Ratio of measured to expected standard deviation of corners, and ratio of the variances of markers on their
    sheets: from the scatter of corners within markers (8m,) and that of markers. ``print_sigma`` (m,): in the same
    unit.

    The expectation from image and map has the weight of a few residuals each.
    """
    whole = keep.reshape(-1, 8).all(axis=1)
    by_marker = residual.reshape(-1, 4, 2)[whole]
    shared = by_marker.mean(axis=1)
    within = float(((by_marker - shared[:, None]) ** 2).sum())
    corner2 = max(PNP.min_scale**2, (within + PNP.prior_count) / (6 * len(by_marker) + PNP.prior_count))
    freedom = 2 * len(by_marker) - unknowns
    if freedom <= 0:
        return math.sqrt(corner2), 1.0
    excess = float((shared**2).sum()) - 0.25 * corner2 * freedom
    stated_m2 = float((print_sigma[whole] ** 2).mean())
    ratio = (PRINT_COUNT + excess / max(stated_m2, LEAST_PRINT)) / (PRINT_COUNT + freedom)
    return math.sqrt(corner2), max(ratio, 0.0)


_NUISANCE = np.ix_(NUISANCE, NUISANCE)
