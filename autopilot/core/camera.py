"""The down-looking camera and its mounting. Three models (``[camera] model`` of the vehicle file):

``pinhole``    Brown's distortion (k1 k2 p1 p2 k3), calibrated in water: the default
``fisheye``    OpenCV's fisheye polynomial (k1 k2 k3 k4), calibrated in water
``flat_port``  pinhole with Brown's distortion calibrated in air, behind a flat port (:mod:`autopilot.core.flat_port`)

Numpy only: projecting a few hundred points takes tens of microseconds. Pixel centres are at integers, as in OpenCV.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from autopilot.core.flat_port import FlatPort, lens_in_air
from autopilot.core.frames import FloatArray, r_ned_from_frd
from autopilot.core.lens import BrownLens, FisheyeLens, LensDistortion
from autopilot.core.vehicle import Camera, Laser, Vehicle

R_FRD_FROM_CAM: FloatArray = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""(3, 3) a camera that looks straight down: image x points to starboard, image y to aft, the optical axis down."""
R_FRD_FROM_CAM.flags.writeable = False

_STRAIGHT: FloatArray = np.array([0.0, 0.0, 1.0])
_STRAIGHT.flags.writeable = False

NEAR_M = 0.02
"""Points closer to the lens than this (along the optical axis), or behind it, have no image."""


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
    """k1 k2 p1 p2 k3; of a fisheye k1 k2 k3 k4 and 0. Of the lens in air if there is a port."""
    position_frd_m: FloatArray
    """(3,) projection centre in the body frame (lever arm)."""
    laser_offset_cam_m: FloatArray
    """(3,) where the laser beam starts, in the camera frame."""
    laser_direction_cam: FloatArray = field(default_factory=lambda: _STRAIGHT)
    """(3,) unit vector along the beam, in the camera frame."""
    laser_sigma_rad: float = 0.0
    """Standard deviation of that direction."""
    r_frd_from_cam: FloatArray = field(default_factory=lambda: R_FRD_FROM_CAM)
    """(3, 3) mounting."""
    fisheye: bool = False
    has_laser: bool = True
    """Whether there is a laser at all."""
    port: FlatPort | None = None
    """The flat pane before the lens; None when the intrinsics are those of a calibration in water."""
    view_slope: float = field(init=False)
    """Tangent of the angle between the optical axis and the farthest point of the image, in the water."""
    view_offset_m: float = field(init=False)
    """By how much a ray may miss the projection centre sideways (0 without a port)."""
    near_m: float = field(init=False)
    """Points closer than this have no image."""
    _lens: LensDistortion = field(init=False, repr=False)

    def __post_init__(self) -> None:
        k1, k2, k3, k4, _ = self.distortion
        lens: LensDistortion = FisheyeLens((k1, k2, k3, k4)) if self.fisheye else BrownLens(self.distortion)
        object.__setattr__(self, "_lens", lens)
        object.__setattr__(self, "near_m", NEAR_M if self.port is None else self.port.outside_m + NEAR_M)
        w, h = float(self.width_px), float(self.height_px)
        rim = np.array([[0, 0], [w / 2, 0], [w, 0], [w, h / 2], [w, h], [w / 2, h], [0, h], [0, h / 2]])
        origins, directions = self.rays(rim)
        object.__setattr__(self, "view_slope", float(np.hypot(directions[:, 0], directions[:, 1]).max()))
        missed = origins[:, :2] - origins[:, 2:] * directions[:, :2]
        object.__setattr__(self, "view_offset_m", float(np.hypot(missed[:, 0], missed[:, 1]).max()))

    @staticmethod
    def of_vehicle(vehicle: Vehicle) -> "CameraModel":
        """The camera of a vehicle. ConfigError if it has none."""
        return CameraModel.of(vehicle.eye, vehicle.laser)

    @staticmethod
    def of(camera: Camera, laser: Laser | None) -> "CameraModel":
        """The model of a vehicle file's ``[camera]`` and ``[laser]``."""
        position = np.array(camera.position_frd_m)
        has_laser = laser is not None
        laser = laser or Laser(position_frd_m=camera.position_frd_m)
        direction = np.array(laser.direction_frd)
        r_frd_from_cam = r_ned_from_frd(np.array(camera.mounting_rpy_rad)) @ R_FRD_FROM_CAM
        return CameraModel(
            width_px=camera.width_px,
            height_px=camera.height_px,
            focal_px=camera.focal_px,
            center_px=camera.center_px,
            distortion=camera.distortion,
            position_frd_m=position,
            laser_offset_cam_m=r_frd_from_cam.T @ (np.array(laser.position_frd_m) - position),
            laser_direction_cam=r_frd_from_cam.T @ (direction / np.linalg.norm(direction)),
            laser_sigma_rad=laser.direction_sigma_rad,
            r_frd_from_cam=r_frd_from_cam,
            fisheye=camera.model == "fisheye",
            has_laser=has_laser,
            port=camera.port,
        )

    def behind(self, port: FlatPort) -> "CameraModel":
        """The same lens behind that flat port, with exact refraction.

        For a pinhole calibrated in water the bare lens is computed to fourth order (:func:`lens_in_air`), with the
        projection centre of the calibration.
        """
        if self.port is not None or self.fisheye:
            return replace(self, port=port)
        fx, fy = self.focal_px
        return replace(
            self,
            focal_px=(fx / port.water_index, fy / port.water_index),
            distortion=lens_in_air(self.distortion, port.water_index),
            port=port,
        )

    @property
    def matrix(self) -> FloatArray:
        """(3, 3) camera matrix as OpenCV takes it."""
        (fx, fy), (cx, cy) = self.focal_px, self.center_px
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])

    @property
    def distortion_coefficients(self) -> FloatArray:
        """(5,) as OpenCV takes them; for a fisheye leave the last one out."""
        return np.array(self.distortion)

    @property
    def focal_water_px(self) -> float:
        """Pixels per radian in the water near the axis, mean of x and y."""
        return 0.5 * (self.focal_px[0] + self.focal_px[1]) * (1.0 if self.port is None else self.port.water_index)

    def cam_from_ned(self, points_ned_m: FloatArray, pos_ned_m: FloatArray, r_ned_from_frd: FloatArray) -> FloatArray:
        """World points (..., 3) in the camera frame for a vehicle at ``pos_ned_m`` (3,) with that attitude (3, 3)."""
        r_ned_from_cam = r_ned_from_frd @ self.r_frd_from_cam
        eye_ned_m = pos_ned_m + r_ned_from_frd @ self.position_frd_m
        return (points_ned_m - eye_ned_m) @ r_ned_from_cam

    def project(self, points_cam_m: FloatArray) -> FloatArray:
        """Pixels (..., 2) of points (..., 3) in the camera frame; NaN for those nearer than :attr:`near_m`."""
        z = np.where(points_cam_m[..., 2] < self.near_m, np.nan, points_cam_m[..., 2])
        if self.port is None:
            return self._pixels(points_cam_m[..., :2] / z[..., None])
        radius_m = np.hypot(points_cam_m[..., 0], points_cam_m[..., 1])
        u, du_dradius, _ = self.port.solve(radius_m, z)
        per_m = np.where(radius_m > 1e-9, u / np.maximum(radius_m, 1e-9), du_dradius)
        return self._pixels(points_cam_m[..., :2] * per_m[..., None])

    def linearise(self, points_cam_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Pixels (..., 2) of points (..., 3) in the camera frame, and their derivatives (..., 2, 3) by the point."""
        z = np.where(points_cam_m[..., 2] < self.near_m, np.nan, points_cam_m[..., 2])
        flat = points_cam_m[..., :2]
        result = np.empty((*flat.shape, 3))
        if self.port is None:
            ideal = flat / z[..., None]
            slopes = self._slopes(ideal)
            result[..., :2] = slopes / z[..., None, None]
            result[..., 2] = -(result[..., 0] * ideal[..., :1] + result[..., 1] * ideal[..., 1:])
            return self._pixels(ideal), result
        radius_m = np.hypot(flat[..., 0], flat[..., 1])
        u, du_dradius, du_dz = self.port.solve(radius_m, z)
        safe_m = np.maximum(radius_m, 1e-9)
        per_m = np.where(radius_m > 1e-9, u / safe_m, du_dradius)
        ideal = flat * per_m[..., None]
        unit = flat / safe_m[..., None]
        result[..., :2] = (du_dradius - per_m)[..., None, None] * unit[..., :, None] * unit[..., None, :]
        result[..., 0, 0] += per_m
        result[..., 1, 1] += per_m
        result[..., 2] = du_dz[..., None] * unit
        return self._pixels(ideal), self._slopes(ideal) @ result

    def _slopes(self, ideal: FloatArray) -> FloatArray:
        """(..., 2, 2) derivatives of :meth:`_pixels`."""
        result = self._lens.slopes(ideal)
        result[..., 0, :] *= self.focal_px[0]
        result[..., 1, :] *= self.focal_px[1]
        return result

    def _pixels(self, ideal: FloatArray) -> FloatArray:
        """Pixels (..., 2) of ideal image points (..., 2) before the lens."""
        result = self._lens.bend(ideal)
        result[..., 0] = self.focal_px[0] * result[..., 0] + self.center_px[0]
        result[..., 1] = self.focal_px[1] * result[..., 1] + self.center_px[1]
        return result

    def _ideal(self, pixels: FloatArray) -> FloatArray:
        """The inverse of :meth:`_pixels`."""
        return self._lens.unbend((pixels - np.array(self.center_px)) / np.array(self.focal_px))

    def distort(self, normalized: FloatArray) -> FloatArray:
        """Pixels (..., 2) of ideal image points (..., 2): x/z and y/z of distant points in the camera frame."""
        if self.port is None:
            return self._pixels(normalized)
        slope = np.hypot(normalized[..., 0], normalized[..., 1])
        scale = np.where(slope > 1e-9, self.port.air_slope(slope) / np.maximum(slope, 1e-9), self.port.water_index)
        return self._pixels(normalized * scale[..., None])

    def normalized(self, pixels: FloatArray) -> FloatArray:
        """Ideal image points (..., 2) of pixels (..., 2): the inverse of :meth:`distort`.

        x/z and y/z of the ray in the water. Behind a port such rays miss the projection centre by some millimetres:
        :meth:`rays` gives them whole.
        """
        ideal = self._ideal(pixels)
        if self.port is None:
            return ideal
        slope = np.hypot(ideal[..., 0], ideal[..., 1])
        scale = np.where(
            slope > 1e-9, self.port.water_slope(slope) / np.maximum(slope, 1e-9), 1.0 / self.port.water_index
        )
        return ideal * scale[..., None]

    def rays(self, pixels: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Origins of the rays of pixels (..., 2) at the water (..., 3) [m] and their directions (..., 3), with z = 1;
        camera frame. Without a port all start at the projection centre.
        """
        directions = np.ones((*pixels.shape[:-1], 3))
        origins = np.zeros_like(directions)
        directions[..., :2] = self.normalized(pixels)
        if self.port is not None:
            ideal = self._ideal(pixels)
            slope = np.hypot(ideal[..., 0], ideal[..., 1])
            radius_m = self.port.exit_radius(slope)
            origins[..., :2] = ideal * (radius_m / np.maximum(slope, 1e-12))[..., None]
            origins[..., 2] = self.port.outside_m
        return origins, directions

    def laser_pixel(self, range_m: float) -> FloatArray:
        """Pixel (2,) of the laser dot at ``range_m`` along the beam from where it starts."""
        return self.project(self.laser_offset_cam_m + range_m * self.laser_direction_cam)

    def laser_pixels(self, ranges_m: FloatArray) -> FloatArray:
        """Pixels (n, 2) at ranges (n,)."""
        return self.project(self.laser_offset_cam_m + ranges_m[:, None] * self.laser_direction_cam)

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
