"""The down-looking camera: pinhole with Brown's distortion (k1 k2 p1 p2 k3), calibrated in water, and where it sits.

The formulas are OpenCV's (calib3d: pinhole model with radial and tangential distortion), written in numpy so that
projecting a few hundred points costs tens of microseconds and needs no heavy import. Pixel centres lie at whole
numbers, as everywhere in OpenCV.
"""

from dataclasses import dataclass, field

import numpy as np

from autopilot.core.frames import FloatArray
from autopilot.core.vehicle import Camera, Laser

R_FRD_FROM_CAM: FloatArray = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""(3, 3) mounting: image x points to starboard, image y to aft, the optical axis down."""
R_FRD_FROM_CAM.flags.writeable = False

NEAR_M = 0.02
"""Points closer to the lens than this (along the optical axis), or behind it, have no image."""

_NEWTON_STEPS = 4
"""Of :meth:`CameraModel.normalized`: the error is at rounding after 4 anywhere in the LBV150's image."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class CameraModel:
    """Intrinsics and mounting of one camera."""

    width_px: int
    height_px: int
    focal_px: tuple[float, float]
    """Along image x and y."""
    center_px: tuple[float, float]
    """Principal point, x and y."""
    distortion: tuple[float, float, float, float, float]
    """k1 k2 p1 p2 k3."""
    position_frd_m: FloatArray
    """(3,) projection centre in the body frame (lever arm)."""
    laser_offset_cam_m: FloatArray
    """(3,) where the laser beam, parallel to the optical axis, starts, in the camera frame."""
    view_slope: float = field(init=False)
    """Tangent of the angle between the optical axis and the farthest point of the image."""

    def __post_init__(self) -> None:
        w, h = float(self.width_px), float(self.height_px)
        rim = self.normalized(
            np.array([[0, 0], [w / 2, 0], [w, 0], [w, h / 2], [w, h], [w / 2, h], [0, h], [0, h / 2]])
        )
        object.__setattr__(self, "view_slope", float(np.hypot(rim[:, 0], rim[:, 1]).max()))

    @staticmethod
    def of(camera: Camera, laser: Laser) -> "CameraModel":
        """The model of a vehicle file's ``[camera]`` and ``[laser]``."""
        position = np.array(camera.position_frd_m)
        return CameraModel(
            width_px=camera.width_px,
            height_px=camera.height_px,
            focal_px=camera.focal_px,
            center_px=camera.center_px,
            distortion=camera.distortion,
            position_frd_m=position,
            laser_offset_cam_m=R_FRD_FROM_CAM.T @ (np.array(laser.position_frd_m) - position),
        )

    @property
    def matrix(self) -> FloatArray:
        """(3, 3) camera matrix as OpenCV takes it."""
        (fx, fy), (cx, cy) = self.focal_px, self.center_px
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])

    @property
    def distortion_coefficients(self) -> FloatArray:
        """(5,) k1 k2 p1 p2 k3 as OpenCV takes them."""
        return np.array(self.distortion)

    def cam_from_ned(self, points_ned_m: FloatArray, pos_ned_m: FloatArray, r_ned_from_frd: FloatArray) -> FloatArray:
        """World points (..., 3) in the camera frame for a vehicle at ``pos_ned_m`` (3,) with that attitude (3, 3)."""
        r_ned_from_cam = r_ned_from_frd @ R_FRD_FROM_CAM
        eye_ned_m = pos_ned_m + r_ned_from_frd @ self.position_frd_m
        result: FloatArray = (points_ned_m - eye_ned_m) @ r_ned_from_cam
        return result

    def project(self, points_cam_m: FloatArray) -> FloatArray:
        """Pixels (..., 2) of points (..., 3) in the camera frame; NaN for those nearer than :data:`NEAR_M`."""
        z = np.where(points_cam_m[..., 2] < NEAR_M, np.nan, points_cam_m[..., 2])
        return self.distort(points_cam_m[..., :2] / z[..., None])

    def distort(self, normalized: FloatArray) -> FloatArray:
        """Pixels (..., 2) of ideal image points (..., 2), that is x/z and y/z in the camera frame."""
        k1, k2, p1, p2, k3 = self.distortion
        x, y = normalized[..., 0], normalized[..., 1]
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        xy = 2.0 * x * y
        result = np.empty_like(normalized)
        result[..., 0] = self.focal_px[0] * (x * radial + p1 * xy + p2 * (r2 + 2.0 * x * x)) + self.center_px[0]
        result[..., 1] = self.focal_px[1] * (y * radial + p1 * (r2 + 2.0 * y * y) + p2 * xy) + self.center_px[1]
        return result

    def normalized(self, pixels: FloatArray) -> FloatArray:
        """Ideal image points (..., 2) of pixels (..., 2): the inverse of :meth:`distort`, by Newton's method."""
        k1, k2, p1, p2, k3 = self.distortion
        target_x = (pixels[..., 0] - self.center_px[0]) / self.focal_px[0]
        target_y = (pixels[..., 1] - self.center_px[1]) / self.focal_px[1]
        x, y = target_x, target_y
        for _ in range(_NEWTON_STEPS):
            r2 = x * x + y * y
            radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
            slope = 2.0 * (k1 + r2 * (2.0 * k2 + 3.0 * k3 * r2))
            xy = x * y
            error_x = x * radial + 2.0 * p1 * xy + p2 * (r2 + 2.0 * x * x) - target_x
            error_y = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * xy - target_y
            dxx = radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x
            dyy = radial + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x
            dxy = slope * xy + 2.0 * (p1 * x + p2 * y)
            determinant = dxx * dyy - dxy * dxy
            x, y = (
                x - (dyy * error_x - dxy * error_y) / determinant,
                y - (dxx * error_y - dxy * error_x) / determinant,
            )
        return np.stack([x, y], axis=-1)

    def laser_pixel(self, range_m: float) -> FloatArray:
        """Pixel (2,) of the laser dot at ``range_m`` along the beam from where it starts."""
        return self.project(self.laser_offset_cam_m + np.array([0.0, 0.0, range_m]))

    def inside(self, pixels: FloatArray, margin_px: float = 0.0) -> np.ndarray:
        """Whether pixels (..., 2) lie in the image and at least ``margin_px`` from its border; False for NaN."""
        x, y = pixels[..., 0], pixels[..., 1]
        result: np.ndarray = (
            (x >= margin_px)
            & (x <= self.width_px - 1 - margin_px)
            & (y >= margin_px)
            & (y <= self.height_px - 1 - margin_px)
        )
        return result
