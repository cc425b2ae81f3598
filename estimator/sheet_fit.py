"""Pose from the corners of markers whose sheets may lie off: pose, tilt, blur and the sheets' offsets in one fit.

A free fit of six degrees of freedom would tilt where two sheets do not fit together: a millimetre between them passes
for half a degree, and that for 7 mm of the pose. Here sheets may move as far as they are believed to be off, and the
tilt as far as the AHRS's is. Of the result the filter gets two independent pieces: the pose with how it depends on the
offsets, and what the picture says of the offsets among each other.
"""

import math
from typing import NamedTuple

import numpy as np

from autopilot.core.camera import CameraModel
from autopilot.core.frames import FloatArray, r_ned_from_frd, rpy_from_r
from autopilot.core.map_errors import STATES
from autopilot.core.markers import IntArray
from autopilot.estimator.estimator_tuning import PNP
from autopilot.estimator.pnp import (
    add_priors,
    corners_that_fit,
    expected_px,
    floored,
    inward_of,
    linearise_corners,
    rms_of,
    turn_matrix,
)

TILT_INFORMATION = 0.009**-2
"""0.5 degrees: the AHRS's tilt as a prior, however many markers are seen."""
TIE_FLOOR = (2e-4, 2e-4, 2e-4, 3e-4)
"""m, rad: what one picture says of a sheet among others is never taken as better. Tilt and lens are off in the same way
in the next one."""
LEAST_SHARE = 1e-7
"""Directions of which the picture knows less than this share of the best known one are left out."""
BELIEF_FLOOR = 1e-5
"""Of the offsets in the fit [m, rad]: keeps the inverse of their covariance finite."""
PRINT_COUNT = 6.0
"""What the map says of its markers' print counts as so many residuals of markers."""
LEAST_PRINT = 1e-6
"""Of the print's variance over the corners': keeps shares finite."""
KEPT = [0, 1, 2, 5]
NUISANCE = [3, 4, 6]


class SheetPose(NamedTuple):
    """A solved pose over sheets."""

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
    """(n,) squared distance of each sheet's offset from the belief, of 4."""
    sigma_tilt_rad: float
    jacobian: FloatArray
    """(8m, 7 + 4n) of the pixels by pose, blur and offsets."""
    residual_px: FloatArray
    """(m, 4, 2)"""
    rms_px: float

    def ties(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """What the picture says of the offsets alone: rows (r, 4n), what it says of them (r,), and how well (r, r)."""
        alone, toward = self.alone
        share, rows = np.linalg.eigh(0.5 * (alone + alone.T))
        known = share > LEAST_SHARE * max(float(share[-1]), 1.0)
        ties = np.sqrt(share[known])[:, None] * rows[:, known].T
        z = ties @ self.at + rows[:, known].T @ toward / np.sqrt(share[known])
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
    belief: tuple[FloatArray, FloatArray],
    pos_ned_m: FloatArray,
    rpy_rad: FloatArray,
    max_rms_px: float,
) -> SheetPose | None:
    """Pose of the corners ``seen``, the sheets' offsets being ``belief`` (4n,), (4n, 4n), near a rough pose.

    None if it does not converge or the residuals' root mean square is above ``max_rms_px``."""
    pos = np.array(pos_ned_m, dtype=float)
    rotation = r_ned_from_frd(rpy_rad)
    up_prior = rotation.T[:, 2].copy()
    believed, covariance = belief
    size = len(believed)
    prior = np.linalg.inv(covariance + np.eye(size) * BELIEF_FLOOR**2)
    offset = believed.copy()
    pixels = seen.pixels.reshape(-1, 2)
    inward, expected = inward_of(pixels), _expected(seen)
    shrink = PNP.shrink_px
    keep = np.ones(2 * len(pixels), dtype=bool)
    places = _places(seen, 7 + size)
    jac = np.zeros((2 * len(pixels), 7 + size))
    jac[:, 6] = inward
    linear = None
    for step in range(PNP.steps):
        if linear is None:
            points, arm = _points(seen, offset)
            linear = linearise_corners(camera, points.reshape(-1, 3), pixels, pos, rotation)
            if linear is None:
                return None
            jac[:, :6] = linear[1]
            jac.reshape(-1)[places] = _by_offsets(linear[1], arm)[seen.sheet >= 0]
            residual = linear[0] - shrink * inward
            left = residual
        weighted = jac.T * (_weights(camera, seen, left, expected, keep, pos, points, 7 + size) * keep)
        information, gradient = weighted @ jac, weighted @ residual
        add_priors(information, gradient, rotation @ up_prior, TILT_INFORMATION, PNP.shrink_px - shrink)
        full, toward = information.copy(), gradient
        full[7:, 7:] += prior
        toward[7:] += prior @ (believed - offset)
        delta: FloatArray = np.asarray(np.linalg.solve(full, toward), dtype=np.float64)
        left = residual - jac @ delta
        settled = max(float(np.abs(delta[:6]).max()), float(np.abs(delta[7:]).max())) < PNP.converged
        if settled:
            fits = corners_that_fit(left / expected)
            if not ((fits == keep).all() or step == PNP.steps - 1):
                keep = fits  # so near, the derivatives are what they were
                continue
        pos = pos + delta[:3]
        rotation = turn_matrix(delta[3:6]) @ rotation
        shrink += float(delta[6])
        offset = offset + delta[7:]
        if settled:
            break
        linear = None
    else:
        return None
    rms = rms_of(left)
    if not rms <= max_rms_px:
        return None
    gradient = weighted @ left
    add_priors(None, gradient, rotation @ up_prior, TILT_INFORMATION, PNP.shrink_px - shrink)
    posterior: FloatArray = np.asarray(np.linalg.inv(full), dtype=np.float64)
    return _pieces(information, gradient, posterior, pos, rotation, offset, (believed, covariance), left, rms, jac)


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
    result: IntArray = rows * width + columns
    return result


def _by_offsets(jac: FloatArray, arm: FloatArray) -> FloatArray:
    """(m, 8, 4) d projection / d offset of the marker's sheet from that by the pose (8m, 6): a point that moves is a
    vehicle that moves the other way."""
    by_pos = jac[:, :3].reshape(-1, 4, 2, 3)
    result = np.empty((len(arm), 4, 2, STATES))
    np.negative(by_pos, out=result[..., :3])
    result[..., 3] = by_pos[..., 0] * arm[..., 1:] - by_pos[..., 1] * arm[..., :1]
    return result.reshape(-1, 8, STATES)


def _expected(seen: SheetCorners) -> FloatArray:
    """(8m,) standard deviations of pixel coordinates by the image."""
    return expected_px(None if seen.sigma_px is None else np.repeat(seen.sigma_px, 4), 4 * len(seen.sheet))


def _weights(
    camera: CameraModel,
    seen: SheetCorners,
    residual: FloatArray,
    expected: FloatArray,
    keep: FloatArray,
    pos: FloatArray,
    points: FloatArray,
    unknowns: int,
) -> FloatArray:
    """(8m,) inverse variance of each pixel coordinate: of corners, and of markers on their sheets, which all four
    corners share."""
    away_m = np.maximum(points[:, 0, 2] - pos[2], 0.05)
    print_px = seen.sigma_m * camera.focal_water_px / away_m
    scale, share = scatter(residual / expected, keep, print_px / expected[::8], unknowns)
    result: FloatArray = np.repeat(1.0 / ((scale * expected[::8]) ** 2 + 4.0 * share * print_px**2), 8)
    return result


def scatter(residual: FloatArray, keep: FloatArray, print_sigma: FloatArray, unknowns: int) -> tuple[float, float]:
    """Standard deviation of corners over what is expected, and variance of markers on their sheets over what the map
    says: by how corners scatter within markers (8m,), and how these do. ``print_sigma`` (m,): in the same unit.

    What image and map say counts as a few residuals each."""
    whole = keep.reshape(-1, 8).all(axis=1)
    by_marker = residual.reshape(-1, 4, 2)[whole]
    shared = by_marker.mean(axis=1)
    within = float(((by_marker - shared[:, None]) ** 2).sum())
    corner2 = max(PNP.min_scale**2, (within + PNP.prior_count) / (6 * len(by_marker) + PNP.prior_count))
    freedom = 2 * len(by_marker) - unknowns
    if freedom <= 0:
        return math.sqrt(corner2), 1.0
    excess = float((shared**2).sum()) - 0.25 * corner2 * freedom
    said = float((print_sigma[whole] ** 2).mean())
    share = (PRINT_COUNT + excess / max(said, LEAST_PRINT)) / (PRINT_COUNT + freedom)
    return math.sqrt(corner2), max(share, 0.0)


def _pieces(
    information: FloatArray,
    gradient: FloatArray,
    posterior: FloatArray,
    pos: FloatArray,
    rotation: FloatArray,
    offset: FloatArray,
    belief: tuple[FloatArray, FloatArray],
    residual: FloatArray,
    rms: float,
    jacobian: FloatArray,
) -> SheetPose:
    """The two independent pieces: pose given the offsets, and the offsets alone."""
    size = len(offset)
    rest = np.array([*KEPT, *range(7, 7 + size)])
    # Tilt and blur are nobody's: taken out with their priors.
    mixed = information[np.array(NUISANCE)[:, None], rest]
    held = np.linalg.solve(information[_NUISANCE], mixed)
    less = information[rest[:, None], rest] - mixed.T @ held
    toward = gradient[rest] - held.T @ gradient[NUISANCE]
    noise: FloatArray = np.asarray(np.linalg.inv(less[:4, :4]), dtype=np.float64)
    rpy = rpy_from_r(rotation)
    by_offsets = noise @ less[:4, 4:]
    z = np.append(pos, rpy[2]) + noise @ toward[:4]
    alone = less[4:, 4:] - less[4:, :4] @ by_offsets
    alone_toward = toward[4:] - by_offsets.T @ toward[:4]
    floored(noise)
    believed, covariance = belief
    off = (offset - believed).reshape(-1, STATES)
    blocks = covariance.reshape(-1, STATES, len(off), STATES)[range(len(off)), :, range(len(off))]
    held_by = np.linalg.solve(blocks + np.eye(STATES) * BELIEF_FLOOR**2, off[..., None])[..., 0]
    return SheetPose(
        pos_ned_m=pos,
        rpy_rad=rpy,
        z=z,
        noise=noise,
        by_offsets=by_offsets,
        at=offset,
        alone=(alone, alone_toward),
        strain=(off * held_by).sum(axis=1),
        sigma_tilt_rad=float(np.sqrt(max(posterior[3, 3], posterior[4, 4]))),
        jacobian=jacobian,
        residual_px=residual.reshape(-1, 4, 2),
        rms_px=rms,
    )


_NUISANCE = np.ix_(NUISANCE, NUISANCE)
