"""Pose of the vehicle from marker corners and their pixels: Gauss-Newton over position and rotation, with covariance.

All six degrees of freedom are estimated. The AHRS's roll and pitch are two weak prior residuals, which decide when one
or two markers leave the tilt undetermined and are negligible with many markers.

A seventh unknown is the displacement of all corners towards their markers' centres by blur. Corner refinement finds
the corner of a blurred black square inside the true one, by 0.2 to 0.5 px depending on optics, motion and window:
taken for scale, that is a bias of the height that no residual shows and every frame repeats. Many markers separate it
from height (the distances between markers do not shrink); with one marker the prior decides. The remaining errors of
single corners are nearly independent, so that their size gives the covariance: expected per marker from the image, and
scaled by the residuals, with more weight the more there are. From rendered images the mean squared distance of the pose
is 3.5 (clear water) to 5 (turbidity 2) of 4.
"""

import math
from abc import ABC, abstractmethod
from typing import NamedTuple

import numpy as np

from autopilot.core.camera import CameraModel
from autopilot.core.frames import FloatArray, r_ned_from_frd, rpy_from_r
from autopilot.core.robust import PLANAR_MEDIAN
from autopilot.estimator.compiled_fit import CompiledFit, Fitted, compiled_fit
from autopilot.estimator.estimator_tuning import PNP
from autopilot.estimator.measure_pose import MIN_SIGMA_POS_M, MIN_SIGMA_YAW_RAD

LEAN_MAX_RAD = math.radians(3.0)
"""With few markers a fit that leans further from the AHRS's vertical is the mirrored solution of a flat target (the
other one of IPPE's two), or the AHRS is wrong: no fix."""


class Pose(NamedTuple):
    pos_ned_m: FloatArray
    """(3,)"""
    rpy_rad: FloatArray
    """(3,)"""
    noise: FloatArray
    """(4, 4) of north, east, down, yaw; floors included."""
    sigma_tilt_rad: float
    """Larger one of the standard deviations of the two tilts."""
    residual_px: FloatArray
    """(m, 2)"""
    rms_px: float
    shrink_px: float
    """Displacement of corners towards the markers' centres."""


def solve_pose(
    camera: CameraModel,
    points_ned_m: FloatArray,
    pixels: FloatArray,
    pos_ned_m: FloatArray,
    rpy_rad: FloatArray,
    max_rms_px: float,
    *,
    sigma_px: FloatArray | None = None,
    shrink_px: float = PNP.shrink_px,
) -> Pose | None:
    """Pose from the corners of markers, by Gauss-Newton.

    Corners (4n, 3) of n markers in NED [m] and their pixels (4n, 2), starting at an approximate pose. ``sigma_px``
    (4n,): expected standard deviation of each corner along one axis; None: that of clear water. ``shrink_px``: mean of
    the prior of the corners' displacement towards the markers' centres.

    None if it does not converge, if the RMS residual is above ``max_rms_px``, or if few markers require another tilt
    than the initial one, which is the AHRS's.
    """
    fit = _PoseFit(camera, points_ned_m, pixels, sigma_px, pos_ned_m, rpy_rad, shrink_px)
    return fit.pose(max_rms_px) if fit.converges() else None


class CornerFit(ABC):
    """Gauss-Newton over position, rotation, blur, and in a subclass more, from corners (k, 3) seen at pixels (k, 2)."""

    def __init__(
        self,
        camera: CameraModel,
        pixels: FloatArray,
        sigma_px: FloatArray | None,
        pos_ned_m: FloatArray,
        rpy_rad: FloatArray,
        shrink_px: float,
        unknowns: int,
    ) -> None:
        self._camera, self._pixels = camera, pixels
        self._pos = np.array(pos_ned_m, dtype=float)
        self._rotation = r_ned_from_frd(rpy_rad)
        self._up_prior = self._rotation.T[:, 2].copy()
        self._expected, self._unknowns = expected_px(sigma_px, len(pixels)), unknowns
        self._shrink = self._shrink_prior = shrink_px

    def _begin(self) -> None:
        """Before the first step."""
        self._inward = inward_of(self._pixels)
        self._keep = np.ones(2 * len(self._pixels), dtype=bool)
        """Pixel coordinates that are no outliers."""
        self._jac = np.zeros((2 * len(self._pixels), self._unknowns))
        self._jac[:, 6] = self._inward
        self._left = self._inward
        """(2k,) residuals after the last step."""

    @abstractmethod
    def _compiled(self, steps: CompiledFit) -> Fitted | None:
        """All steps in C."""

    @abstractmethod
    def _points_ned_m(self) -> FloatArray:
        """(k, 3) the corners as the unknowns are now."""

    @abstractmethod
    def _normal_equations(self, residual: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Information and gradient of all unknowns, priors included."""

    def _linearised(self, jac: FloatArray) -> None:
        """Take in the derivatives (2k, 6) by the pose."""
        self._jac[:, :6] = jac

    def _move(self, delta: FloatArray) -> None:
        self._pos = self._pos + delta[:3]
        self._rotation = turn_matrix(delta[3:6]) @ self._rotation
        self._shrink += float(delta[6])

    @property
    def _lean(self) -> FloatArray:
        """(3,) the vertical of the tilt's prior seen through the rotation."""
        return self._rotation @ self._up_prior

    def converges(self) -> bool:
        """Step until nothing moves and the outliers stay the same; False if it does not come to that."""
        compiled = compiled_fit(self._camera)
        if compiled is None:
            self._begin()
            return self._steps()
        fitted = self._compiled(compiled)
        if fitted is None:
            return False
        self._pos, self._rotation = fitted.pos_ned_m, fitted.rotation
        self._left, self._keep = fitted.left, fitted.keep > 0.0
        self._shrink = fitted.shrink_px
        return True

    def _steps(self) -> bool:
        linear = None
        for step in range(PNP.steps):
            if linear is None:
                linear = linearise_corners(self._camera, self._points_ned_m(), self._pixels, self._pos, self._rotation)
                if linear is None:
                    return False
                self._linearised(linear[1])
                residual = self._left = linear[0] - self._shrink * self._inward
            delta: FloatArray = np.asarray(np.linalg.solve(*self._normal_equations(residual)), dtype=np.float64)
            self._left = residual - self._jac @ delta
            moved = np.abs(delta)
            moved[6] = 0.0  # blur may go on
            settled = float(moved.max()) < PNP.converged
            if settled:
                fits = corners_that_fit(self._left / self._expected)
                if not ((fits == self._keep).all() or step == PNP.steps - 1):
                    self._keep = fits  # converged: the derivatives have not changed
                    continue
            self._move(delta)
            if settled:
                return True
            linear = None
        return False


class _PoseFit(CornerFit):
    """Fit of the pose alone, with known corner positions."""

    def __init__(
        self,
        camera: CameraModel,
        points_ned_m: FloatArray,
        pixels: FloatArray,
        sigma_px: FloatArray | None,
        pos_ned_m: FloatArray,
        rpy_rad: FloatArray,
        shrink_px: float,
    ) -> None:
        super().__init__(camera, pixels, sigma_px, pos_ned_m, rpy_rad, shrink_px, 7)
        self._points = points_ned_m
        self._few = len(points_ned_m) <= PNP.few_points
        self._tilt = (PNP.tilt_sigma_few_rad if self._few else PNP.tilt_sigma_many_rad) ** -2

    def _compiled(self, steps: CompiledFit) -> Fitted | None:
        pose = self._pos, self._rotation
        fitted = steps.converged(self._points, self._pixels, self._expected, pose, self._tilt, self._shrink)
        if fitted is not None:
            self._seen = fitted.information
        return fitted

    def _points_ned_m(self) -> FloatArray:
        return self._points

    def _normal_equations(self, residual: FloatArray) -> tuple[FloatArray, FloatArray]:
        weighted = self._jac.T * (self._keep / (self._expected * self._expected))
        self._seen = weighted @ self._jac
        return self._with_priors(weighted @ residual, self._shrink_prior - self._shrink)

    def _with_priors(self, toward: FloatArray, shrink_off_px: float) -> tuple[FloatArray, FloatArray]:
        """Information (7, 7) and gradient (7,) of pixels whose errors are as the residuals show, and of the priors."""
        scale = corner_scale((self._left / self._expected)[self._keep])
        information, gradient = self._seen / (scale * scale), toward / (scale * scale)
        add_priors(information, gradient, self._lean, self._tilt, shrink_off_px)
        return information, gradient

    def pose(self, max_rms_px: float) -> Pose | None:
        """The pose that it has converged to, if it is good enough."""
        rms = rms_of(self._left)
        if not rms <= max_rms_px or (
            self._few and math.acos(min(1.0, float(self._rotation[2] @ self._up_prior))) > LEAN_MAX_RAD
        ):
            return None
        information, _ = self._with_priors(np.zeros(7), 0.0)
        covariance: FloatArray = np.asarray(np.linalg.inv(information), dtype=np.float64)
        noise = floored(covariance[_POSE])
        sigma_tilt_rad = float(np.sqrt(max(covariance[3, 3], covariance[4, 4])))
        residual_px = self._left.reshape(-1, 2)
        return Pose(self._pos, rpy_from_r(self._rotation), noise, sigma_tilt_rad, residual_px, rms, self._shrink)


_POSE = np.ix_([0, 1, 2, 5], [0, 1, 2, 5])
_DIAGONAL = np.arange(4), np.arange(4)
_FLOOR = np.array([MIN_SIGMA_POS_M] * 3 + [MIN_SIGMA_YAW_RAD]) ** 2


def floored(noise: FloatArray) -> FloatArray:
    """The covariance (4, 4) of a pose with a floor for errors that are correlated from frame to frame; changed in
    place.
    """
    noise[_DIAGONAL] += _FLOOR
    return noise


def inward_of(pixels: FloatArray) -> FloatArray:
    """Unit vectors (8n,) from each corner towards the centre of its marker."""
    corners = pixels.reshape(-1, 4, 2)
    away: FloatArray = corners.mean(axis=1, keepdims=True) - corners
    away /= np.maximum(np.sqrt((away * away).sum(axis=2, keepdims=True)), 1e-6)
    return away.reshape(-1)


def expected_px(sigma_px: FloatArray | None, corners: int) -> FloatArray:
    """(2n,) standard deviations of pixel coordinates from those of corners (n,), or of clear water for so many."""
    return np.full(2 * corners, PNP.prior_sigma_px) if sigma_px is None else np.repeat(sigma_px, 2)


def corners_that_fit(residual: FloatArray) -> np.ndarray:
    """Inliers among the normalised residuals (8n,); all, if less than three corners would remain."""
    x, y = residual[0::2], residual[1::2]
    off = np.sqrt(x * x + y * y)
    half = len(off) // 2
    middle = np.partition(off, (half - 1, half))  # an even number: four of each marker
    median = 0.5 * float(middle[half - 1] + middle[half])
    fits = off <= max(PNP.corner_floor, PNP.corner_sigmas * median / PLANAR_MEDIAN)
    if 4 * int(fits.sum()) < 3 * len(fits):
        fits[:] = True
    return np.repeat(fits, 2)


def corner_scale(residual: FloatArray) -> float:
    """Ratio of measured to expected standard deviation of corners, from normalised residuals (k,), corrected for seven
    unknowns.
    """
    squares = float(residual @ residual) + PNP.prior_count
    return max(PNP.min_scale, math.sqrt(squares / max(len(residual) - 7.0 + PNP.prior_count, 1.0)))


def linearise_corners(
    camera: CameraModel, points: FloatArray, pixels: FloatArray, pos: FloatArray, rotation: FloatArray
) -> tuple[FloatArray, FloatArray] | None:
    """Residual (2m,) pixels minus projection, and d projection / d (position, small rotation in NED) (2m, 6)."""
    r_cam_from_ned = (rotation @ camera.r_frd_from_cam).T
    arm = points - pos
    cam = arm @ r_cam_from_ned.T - camera.r_frd_from_cam.T @ camera.position_frd_m
    if not float(cam[:, 2].min()) > camera.near_m:
        return None
    # d pixel / d camera coordinates, (m, 2, 3), then to NED by the chain rule: cam = C (point - pos) - const.
    seen, by_cam = camera.linearise(cam)
    residual = pixels - seen
    by_point = by_cam.reshape(-1, 3) @ r_cam_from_ned
    jac = np.empty((2 * len(cam), 6))
    jac[:, :3] = -by_point
    arm2 = np.repeat(arm, 2, axis=0)
    # A rotation by t in NED moves a point as seen from the vehicle by -t x arm; g . (arm x t) = (g x arm) . t
    jac[:, 3] = by_point[:, 1] * arm2[:, 2] - by_point[:, 2] * arm2[:, 1]
    jac[:, 4] = by_point[:, 2] * arm2[:, 0] - by_point[:, 0] * arm2[:, 2]
    jac[:, 5] = by_point[:, 0] * arm2[:, 1] - by_point[:, 1] * arm2[:, 0]
    return residual.reshape(-1), jac


def add_priors(
    information: FloatArray | None, gradient: FloatArray, lean: FloatArray, tilt: float, shrink_off_px: float
) -> None:
    """Add the priors of tilt, of information ``tilt``, and of blur to the normal equations; changed in place.

    ``lean`` (3,): the vertical of the tilt prior in the present rotation. A rotation by (-lean_e, lean_n) aligns it.
    """
    if information is not None:
        information[3, 3] += tilt
        information[4, 4] += tilt
        information[6, 6] += PNP.shrink_sigma_px**-2
    gradient[3] += tilt * float(lean[1])
    gradient[4] -= tilt * float(lean[0])
    gradient[6] += PNP.shrink_sigma_px**-2 * shrink_off_px


def rms_of(residual: FloatArray) -> float:
    return math.sqrt(float(residual @ residual) / len(residual))


def turn_matrix(vector: FloatArray) -> FloatArray:
    """Rotation matrix (3, 3) of a rotation vector (Rodrigues)."""
    a, b, c = vector.tolist()
    angle = math.sqrt(a * a + b * b + c * c)
    if angle < 1e-12:
        return np.eye(3)
    x, y, z = a / angle, b / angle, c / angle
    s, v = math.sin(angle), 1.0 - math.cos(angle)
    return np.array(
        [
            [1.0 - v * (y * y + z * z), v * x * y - s * z, v * x * z + s * y],
            [v * x * y + s * z, 1.0 - v * (x * x + z * z), v * y * z - s * x],
            [v * x * z - s * y, v * y * z + s * x, 1.0 - v * (x * x + y * y)],
        ]
    )
