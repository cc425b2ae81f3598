"""Images of the tank floor as the vehicle's camera would take them.

The geometry is exact: one ray per pixel (inverse lens distortion, computed once), intersected with the floor on a grid
of every eighth pixel and interpolated between (error below 0.02 px); the floor texture is sampled once. Then, in the
order of light propagation: caustics and vignetting, blur of optics and motion, turbidity (contrast exp(-c d), red
attenuated fastest; Jaffe-McGlamery without forward scattering), noise and the laser dot. Obstacles are not drawn. An
image is a function of truth, frame number and seed alone.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from autopilot.core.camera import NEAR_M, CameraModel
from autopilot.core.frames import FloatArray, r_ned_from_frd
from autopilot.core.toml_table import Vec3
from autopilot.sitl.fault_tables import LensFault, Mounting
from autopilot.sitl.floor import Floor, Image
from autopilot.sitl.plant import Truth
from autopilot.sitl.sensor_tables import ImageModel, LaserSensor
from autopilot.sitl.sitl_tuning import CAMERA_TUNED


class SimCamera:
    """Renderer for one camera, one floor and one appearance."""

    def __init__(self, camera: CameraModel, floor: Floor, imaging: ImageModel, seed: int, laser: bool = True) -> None:
        """``camera`` is the true one; ``seed`` chooses the noise. Sets OpenCV to one thread (others only spin)."""
        cv2.setNumThreads(1)
        self.camera = camera
        self._floor = floor
        self._imaging = imaging
        self._seed = seed
        self._laser = laser and imaging.laser_brightness > 0.0
        columns = (
            np.arange(-1, camera.width_px // CAMERA_TUNED.step_px + 1) * CAMERA_TUNED.step_px
            + (CAMERA_TUNED.step_px - 1) / 2
        )
        rows = (
            np.arange(-1, camera.height_px // CAMERA_TUNED.step_px + 1) * CAMERA_TUNED.step_px
            + (CAMERA_TUNED.step_px - 1) / 2
        )
        grid_px = np.stack(np.meshgrid(columns, rows), axis=-1)
        self._grid_shape: tuple[int, int] = grid_px.shape[:2]
        starts, directions = camera.rays(grid_px)
        self._rays_cam = np.ascontiguousarray(directions.reshape(-1, 3).T)
        self._starts_cam_m = np.ascontiguousarray(starts.reshape(-1, 3).T)
        corner_px = math.hypot(camera.width_px, camera.height_px) / 2
        off_centre = (grid_px - [camera.width_px / 2, camera.height_px / 2]) / corner_px
        self._vignette = (1.0 - imaging.vignetting * (off_centre**2).sum(axis=-1)).astype(np.float32)
        rng = np.random.default_rng((seed, 0))
        shape = (3, camera.height_px + CAMERA_TUNED.noise_pad, camera.width_px + CAMERA_TUNED.noise_pad)
        noise = np.rint(rng.standard_normal(shape, dtype=np.float32) * np.float32(imaging.noise_levels))
        self._noise = np.clip(noise + CAMERA_TUNED.noise_zero, 0, 255).astype(np.uint8)
        self._caustic_phases = rng.uniform(0.0, 2.0 * math.pi, len(CAMERA_TUNED.caustic_waves_1_m))

    def with_faults(self, faults: Sequence[LensFault | Mounting]) -> "SimCamera":
        """A copy with these additional faults."""
        return SimCamera(faulty(self.camera, faults), self._floor, self._imaging, self._seed, self._laser)

    def render(self, truth: Truth, index: int) -> Image:
        """The picture number ``index``, BGR (rows, columns, 3), exposed around ``truth.t_us``."""
        r = r_ned_from_frd(truth.rpy_rad)
        eye_ned_m = truth.pos_ned_m + r @ self.camera.position_frd_m
        height_m = max(0.01, self._floor.depth_m - float(eye_ned_m[2]))
        north_m, east_m = self._floor_points(eye_ned_m, r, height_m)
        grey = self._sampled(north_m, east_m, height_m)
        mask = self._brightness(north_m, east_m, truth.t_us * 1e-6)
        grey = cv2.multiply(grey, self._enlarged(mask), scale=1.0 / CAMERA_TUNED.mask_unit)
        grey = self._blurred(grey, truth, height_m)
        picture = self._through_water(grey, height_m, index)
        if self._laser:
            self._add_laser(picture, eye_ned_m, r)
        return picture

    def _floor_points(self, eye_ned_m: FloatArray, r: FloatArray, height_m: float) -> tuple[FloatArray, FloatArray]:
        """North and east of the floor points that the grid's rays meet."""
        r_ned_from_cam = r @ self.camera.r_frd_from_cam
        north, east, down = r_ned_from_cam @ self._rays_cam
        if self.camera.port is None:
            reach = height_m / np.maximum(down, CAMERA_TUNED.horizon)
            north_m, east_m = eye_ned_m[0] + north * reach, eye_ned_m[1] + east * reach
        else:  # rays start where they enter the water
            starts_m = r_ned_from_cam @ self._starts_cam_m
            reach = np.maximum(height_m - starts_m[2], 0.01) / np.maximum(down, CAMERA_TUNED.horizon)
            north_m, east_m = eye_ned_m[0] + starts_m[0] + north * reach, eye_ned_m[1] + starts_m[1] + east * reach
        return north_m.reshape(self._grid_shape), east_m.reshape(self._grid_shape)

    def _sampled(self, north_m: FloatArray, east_m: FloatArray, height_m: float) -> Image:
        """The floor texture at every pixel, from a small copy of the visible part (for the processor's cache)."""
        level = self._floor.level_for(self.camera.focal_water_px / height_m)
        picture = self._floor.levels[level]
        where = self._floor.pixel_map(north_m, east_m, level)
        left, right = _span(where[..., 0], picture.shape[1])
        top, bottom = _span(where[..., 1], picture.shape[0])
        view = picture[top:bottom, left:right].copy()
        where -= np.array([left, top], dtype=np.float32)
        sampled: Image = cv2.remap(
            view,
            self._enlarged(where),
            None,
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=(CAMERA_TUNED.wall_level,),
        )
        return sampled

    def _enlarged(self, grid: Any) -> Any:
        """A value per pixel from a value per grid ray (its nodes lie at the centres of STEP_PX x STEP_PX blocks)."""
        height, width = grid.shape[0] * CAMERA_TUNED.step_px, grid.shape[1] * CAMERA_TUNED.step_px
        full = cv2.resize(grid, (width, height), interpolation=cv2.INTER_LINEAR)
        return full[
            CAMERA_TUNED.step_px : CAMERA_TUNED.step_px + self.camera.height_px,
            CAMERA_TUNED.step_px : CAMERA_TUNED.step_px + self.camera.width_px,
        ]

    def _brightness(self, north_m: FloatArray, east_m: FloatArray, t_s: float) -> Image:
        """Light on the grid's rays: lamp, vignetting and caustics, in units of 1 / MASK_UNIT."""
        mask = np.float32(CAMERA_TUNED.mask_unit * self._imaging.light) * self._vignette
        if self._imaging.caustics > 0.0:
            shift = np.array(CAMERA_TUNED.caustic_rates_1_s) * t_s + self._caustic_phases
            wave = np.array(CAMERA_TUNED.caustic_waves_1_m, dtype=np.float32) @ np.stack(
                (north_m.ravel(), east_m.ravel())
            ).astype(np.float32)
            wave += np.fmod(shift, 2.0 * math.pi).astype(np.float32)[:, None]
            crest = np.exp(np.sin(wave, out=wave).sum(axis=0)) - np.float32(
                CAMERA_TUNED.mean_exp_sin ** len(CAMERA_TUNED.caustic_waves_1_m)
            )
            gain = np.clip(
                crest * np.float32(self._imaging.caustics / 3.0), -self._imaging.caustics, 3.0 * self._imaging.caustics
            )
            mask = mask * (1.0 + gain.reshape(self._grid_shape))
        result: Image = np.clip(np.rint(mask), 0, 255).astype(np.uint8)
        return result

    def _blurred(self, grey: Image, truth: Truth, height_m: float) -> Image:
        """Optical blur, and motion during the exposure by its variance along its direction."""
        vx, vy, _ = self.camera.r_frd_from_cam.T @ truth.vel_frd_m_s
        wx, wy, _ = self.camera.r_frd_from_cam.T @ truth.rate_frd_rad_s
        scale = self.camera.focal_water_px * self._imaging.exposure_s
        mx, my = scale * (vx / height_m + wy), scale * (vy / height_m - wx)
        xx, yy, xy = (
            self._imaging.blur_px**2 + mx * mx / 12.0,
            self._imaging.blur_px**2 + my * my / 12.0,
            mx * my / 12.0,
        )
        if max(xx, yy) < CAMERA_TUNED.min_blur_px2:
            return grey
        if max(xx, yy) < CAMERA_TUNED.small_blur_px2 and abs(xy) < CAMERA_TUNED.min_skew_px2:
            blurred: Image = cv2.sepFilter2D(grey, -1, _three(xx), _three(yy))
        else:
            blurred = cv2.filter2D(grey, -1, _blur_kernel(xx, yy, xy))
        return blurred

    def _through_water(self, grey: Image, height_m: float, index: int) -> Image:
        """Colour: contrast lost to backscatter over the distance to the floor. Noise: another section of a stored
        pattern for every frame number, in the same pass.
        """
        down, right = np.random.default_rng((self._seed, 1, index)).integers(0, CAMERA_TUNED.noise_pad, 2)
        noise = self._noise[:, down : down + self.camera.height_px, right : right + self.camera.width_px]
        planes = []
        for channel, (veil, fade, tint) in enumerate(
            zip(CAMERA_TUNED.veil_bgr, CAMERA_TUNED.fade_bgr, CAMERA_TUNED.tint_bgr, strict=True)
        ):
            kept = math.exp(-fade * self._imaging.turbidity_1_m * height_m)
            scattered = veil * min(1.0, self._imaging.light) * (1.0 - kept)
            planes.append(cv2.addWeighted(grey, tint * kept, noise[channel], 1.0, scattered - CAMERA_TUNED.noise_zero))
        picture: Image = cv2.merge(planes)
        return picture

    def _add_laser(self, picture: Image, eye_ned_m: FloatArray, r: FloatArray) -> None:
        """The dot where the beam meets the floor, in place."""
        r_ned_from_cam = r @ self.camera.r_frd_from_cam
        origin_ned_m = eye_ned_m + r_ned_from_cam @ self.camera.laser_offset_cam_m
        down = float(r_ned_from_cam[2] @ self.camera.laser_direction_cam)
        if down < CAMERA_TUNED.horizon:
            return
        range_m = (self._floor.depth_m - float(origin_ned_m[2])) / down
        if range_m <= NEAR_M:
            return
        x, y = self.camera.laser_pixel(range_m)
        sigma = math.hypot(CAMERA_TUNED.laser_glow_px, self.camera.focal_water_px * CAMERA_TUNED.laser_spot_m / range_m)
        radius = math.ceil(3.5 * sigma)
        left, right = max(0, round(x) - radius), min(self.camera.width_px, round(x) + radius + 1)
        top, bottom = max(0, round(y) - radius), min(self.camera.height_px, round(y) + radius + 1)
        if left >= right or top >= bottom:
            return
        strength = self._imaging.laser_brightness * math.exp(-2.0 * self._imaging.turbidity_1_m * range_m)
        across = np.exp(-0.5 * ((np.arange(left, right) - x) / sigma) ** 2)
        along = np.exp(-0.5 * ((np.arange(top, bottom) - y) / sigma) ** 2)
        glow = strength * along[:, None, None] * across[None, :, None] * np.array(CAMERA_TUNED.laser_bgr)
        patch = picture[top:bottom, left:right]
        patch[:] = np.clip(patch + np.rint(glow), 0, 255).astype(np.uint8)


def camera_of(model: CameraModel, focal_factor: float) -> CameraModel:
    """The true camera: the calibrated one with its focal length off by a factor."""
    fx, fy = model.focal_px
    return replace(model, focal_px=(fx * focal_factor, fy * focal_factor))


def faulty(camera: CameraModel, faults: Sequence[LensFault | Mounting]) -> CameraModel:
    """The camera with another lens or mounting; the laser stays where it is on the body."""
    for fault in faults:
        if isinstance(fault, LensFault):
            camera = camera_of(camera, fault.focal_factor)
            continue
        laser_frd_m = camera.position_frd_m + camera.r_frd_from_cam @ camera.laser_offset_cam_m
        beam_frd = camera.r_frd_from_cam @ camera.laser_direction_cam
        camera = _moved(camera, fault.position_m, fault.rpy_rad, laser_frd_m, beam_frd)
    return camera


def _moved(
    camera: CameraModel, by_m: Vec3, by_rpy_rad: Vec3, laser_frd_m: FloatArray, beam_frd: FloatArray
) -> CameraModel:
    """Displaced and turned in its mounting; the laser's place and beam are given in the body frame."""
    r_frd_from_cam = r_ned_from_frd(np.array(by_rpy_rad)) @ camera.r_frd_from_cam
    position_frd_m = camera.position_frd_m + np.array(by_m)
    return replace(
        camera,
        position_frd_m=position_frd_m,
        r_frd_from_cam=r_frd_from_cam,
        laser_offset_cam_m=r_frd_from_cam.T @ (laser_frd_m - position_frd_m),
        laser_direction_cam=r_frd_from_cam.T @ beam_frd,
    )


def true_camera(model: CameraModel, imaging: ImageModel, laser: LaserSensor) -> CameraModel:
    """The camera and the beam of a scenario that differ from ``model``, the vehicle file's, by its errors."""
    laser_frd_m = model.position_frd_m + model.r_frd_from_cam @ model.laser_offset_cam_m + laser.position_error_m
    beam_frd = r_ned_from_frd(np.array([*laser.tilt_error_rad, 0.0])) @ model.r_frd_from_cam @ model.laser_direction_cam
    (cx, cy), (dx, dy) = model.center_px, imaging.principal_error_px
    lens = replace(camera_of(model, imaging.focal_factor), center_px=(cx + dx, cy + dy))
    camera = lens if imaging.port is None else lens.behind(imaging.port)
    return _moved(camera, imaging.position_error_m, imaging.mounting_error_rad, laser_frd_m, beam_frd)


def _span(where_px: NDArray[np.float32], limit: int) -> tuple[int, int]:
    """First and one past the last pixel that is needed along one axis of a picture with ``limit`` pixels."""
    first = min(max(0, math.floor(float(where_px.min())) - 2), limit - 1)
    last = min(max(first + 1, math.ceil(float(where_px.max())) + 3), limit)
    return first, last


def _three(variance_px2: float) -> NDArray[np.float32]:
    """Three weights with this second moment."""
    return np.array([variance_px2 / 2, 1.0 - variance_px2, variance_px2 / 2], dtype=np.float32)


def _blur_kernel(xx: float, yy: float, xy: float) -> NDArray[np.float32]:
    """Kernel with these second moments [px^2]: 3 x 3 while that is possible, else a Gaussian."""
    if max(xx, yy) < CAMERA_TUNED.small_blur_px2:
        skew = np.array([[1.0, 0.0, -1.0], [0.0, 0.0, 0.0], [-1.0, 0.0, 1.0]])
        return (np.outer(_three(yy), _three(xx)) + xy / 4.0 * skew).astype(np.float32)
    xx, yy = xx + 0.05, yy + 0.05  # never singular
    radius = min(8, math.ceil(2.2 * math.sqrt(max(xx, yy))))
    x, y = np.meshgrid(np.arange(-radius, radius + 1), np.arange(-radius, radius + 1))
    weight = np.exp(-0.5 * (yy * x * x - 2.0 * xy * x * y + xx * y * y) / (xx * yy - xy * xy))
    large: NDArray[np.float32] = (weight / weight.sum()).astype(np.float32)
    return large
