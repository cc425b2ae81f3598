"""In-flight check of the camera calibration: latency of the stamps and focal length.

Latency: :mod:`.estimator.stamp_monitor`. Focal length: in a level image an error is equivalent to another height and
unobservable; the lens distortion separates the two, because it scales with the focal length and not with the height.
Every image gives the scale factor that fits its residuals best, and the average of hundreds is significant. A wrong
distortion looks the same: what is found is divided between both by how well each is known.
"""

import math

import numpy as np

from autopilot.core import operator_messages as notices
from autopilot.core.camera import CameraModel
from autopilot.core.frames import FloatArray
from autopilot.core.messages import NavDoubt
from autopilot.core.vehicle import Camera
from autopilot.estimator.estimator_tuning import CAMERA_MONITOR, STAMP_MONITOR
from autopilot.estimator.history import Node
from autopilot.estimator.monitor import NOTHING, Monitor
from autopilot.estimator.stamp_monitor import StampMonitor
from autopilot.estimator.states import DOWN, VEL, YAW

NO_CAMERA = Camera(
    width_px=1,
    height_px=1,
    rate_hz=1.0,
    focal_px=(1.0, 1.0),
    center_px=(0.0, 0.0),
    distortion=(0.0,) * 5,
    position_frd_m=(0.0,) * 3,
    latency_s=0.0,
)
"""Stands for the camera of a vehicle that has none: no picture of it will come."""


def focal_estimate(
    camera: CameraModel, pixels: FloatArray, residual_px: FloatArray, jacobian: FloatArray
) -> tuple[float, float] | None:
    """Relative excess of the focal length, and its standard deviation, from one image.

    ``pixels`` (m, 2) of the detected corners, ``residual_px`` (2m,) measured minus fitted, and its ``jacobian`` (2m,
    k) with respect to all fitted parameters. None for a lens without distortion, which makes it unobservable.
    """
    # At the fitted corners: measured ones contain the noise of the residuals, the only pattern without distortion.
    fitted = (pixels - np.array(camera.center_px)).reshape(-1) - residual_px
    both = np.column_stack((fitted, residual_px))
    across, *_ = np.linalg.lstsq(jacobian, both, rcond=None)
    pattern, rest = (both - jacobian @ across).T
    power = float(pattern @ pattern)
    if power < CAMERA_MONITOR.least_power_px * CAMERA_MONITOR.least_power_px:
        return None
    focal_error = float(pattern @ rest) / power
    noise = rest - focal_error * pattern
    sigma = math.sqrt(float(noise @ noise) / max(len(noise) - jacobian.shape[1] - 1, 1) / power)
    return -focal_error, CAMERA_MONITOR.pattern_noise * sigma


def _of_mounting(camera: Camera) -> tuple[float, float, float, float] | None:
    """Variances forward, right, down [m^2] and of the heading that the mounting's uncertainty is worth; None = none.

    A picture shows where the camera is and how it is turned; the vehicle is the lever arm away from it."""
    x, y, z = camera.position_frd_m
    by_x, by_y, by_z = (sigma * sigma for sigma in camera.position_sigma_m)
    roll, pitch, yaw = (sigma * sigma for sigma in camera.mounting_sigma_rad)
    forward = by_x + pitch * z * z + yaw * y * y
    right = by_y + roll * z * z + yaw * x * x
    down = by_z + roll * y * y + pitch * x * x
    return (forward, right, down, yaw) if forward + right + down + yaw > 0.0 else None


class CameraMonitor(Monitor):
    def __init__(
        self, camera: Camera, stamps_every_s: float = STAMP_MONITOR.evaluate_s, floor_m: float | None = None
    ) -> None:
        """``floor_m``: depth of the floor with the markers, None = there is none."""
        super().__init__()
        self._floor_m, self._camera_down_m = floor_m, camera.position_frd_m[2]
        self.stamps = StampMonitor(stamps_every_s)
        self._focal_sigma, self._bend_sigma = camera.focal_sigma, CAMERA_MONITOR.bend * camera.distortion_sigma
        self._stamp_sigma_s = camera.time_offset_sigma_s
        self._mounting = _of_mounting(camera)
        mounting_rad = max(camera.mounting_sigma_rad[:2])
        self._tilt_most_rad = CAMERA_MONITOR.doubted * math.hypot(mounting_rad, CAMERA_MONITOR.ahrs_tilt_rad)
        self._tilted_us: int | None = None
        self._tilt_reported = False
        self._late_reported_s: float | None = None
        self._lens_reported = self._lens_doubted = False
        self._pictures = False
        self._weight = self._sum = 0.0
        self._estimates = 0
        self.focal_error = self.distortion_error = 0.0
        """Shares by which focal length and distortion are taken to be too large, 0 = they fit as far as is known."""
        self._found_focal_sigma = 0.0
        self._focal_pending = 0.0
        """What else it seems to be off, not yet surely or not worth correcting."""

    def height_m(self, x: FloatArray) -> float:
        """Height of the camera over the floor with the markers [m], 0 = no such floor."""
        return 0.0 if self._floor_m is None else max(self._floor_m - x.item(DOWN) - self._camera_down_m, 0.0)

    def systematic_variance(self, t_us: int, newest: Node) -> FloatArray:
        """See :class:`Monitor`: position variance by the calibration's uncertainty at this height above the markers."""
        if not self._pictures:
            return NOTHING
        x, yaw_rate_rad_s = newest.state.x, newest.moment.inertial.yaw_rate_rad_s
        focal_error = math.hypot(self._found_focal_sigma or self._focal_sigma, self._focal_pending)
        across = focal_error * CAMERA_MONITOR.aside_m
        late_s = math.hypot(self.stamps.sigma_s or self._stamp_sigma_s, self.stamps.unsure_s)
        if focal_error == late_s == 0.0 and self._mounting is None:
            return NOTHING
        north, east, down = x[VEL].tolist()
        more = np.array(
            [
                across * across + (late_s * north) ** 2,
                across * across + (late_s * east) ** 2,
                (focal_error * self.height_m(x)) ** 2 + (late_s * down) ** 2,
                (late_s * yaw_rate_rad_s) ** 2,
            ]
        )
        if self._mounting is not None:
            forward, right, down, yaw = self._mounting
            c2 = math.cos(x.item(YAW)) ** 2
            more += forward * c2 + right * (1.0 - c2), forward * (1.0 - c2) + right * c2, down, yaw
        return more

    def doubts(self, t_us: int, newest: Node) -> tuple[NavDoubt, ...]:
        """See :class:`Monitor`: that the calibration is wrong, as has been reported to the operator."""
        self._check_tilt(t_us, newest)
        least_s = max(CAMERA_MONITOR.late_still_s, CAMERA_MONITOR.doubted * self._stamp_sigma_s)
        still_late = self._late_reported_s is not None and abs(self.stamps.late_s) >= least_s
        return (NavDoubt.CALIBRATION,) if self._lens_doubted or still_late else ()

    def _check_tilt(self, t_us: int, newest: Node) -> None:
        """Report a tilt of the camera against the AHRS that neither explains: what vision trims the AHRS by."""
        inertial = newest.moment.inertial
        roll_rad, pitch_rad = inertial.raw_tilt_rad
        off_rad = math.hypot(roll_rad - inertial.roll_rad, pitch_rad - inertial.pitch_rad)
        if not self._pictures or off_rad <= self._tilt_most_rad:
            self._tilted_us = None
        elif self._tilted_us is None:
            self._tilted_us = t_us
        elif not self._tilt_reported and t_us - self._tilted_us >= CAMERA_MONITOR.tilted_us:
            self._tilt_reported = True
            self._texts.append(notices.CAMERA_TILTED(off_deg=math.degrees(off_rad)).text)

    def check_stamps(self) -> bool:
        """Whether a latency of the stamps has been detected, or has changed."""
        changed = self.stamps.evaluate()
        late_s = self.stamps.late_s
        jumped_s, reported_s = self.stamps.jumped_s, self._late_reported_s
        sure = 0.0 < self.stamps.sigma_s < CAMERA_MONITOR.late_fraction * max(abs(late_s), 2.0 * CAMERA_MONITOR.late_s)
        if jumped_s:
            if abs(jumped_s) >= max(CAMERA_MONITOR.late_s, CAMERA_MONITOR.jump_sigmas * self.stamps.sigma_s):
                self.stamps.jumped_s, self._late_reported_s = 0.0, late_s
                self._texts.append(notices.STAMPS_JUMPED(name=self._name, jump_ms=1e3 * jumped_s).text)
        elif reported_s is None and abs(late_s) >= CAMERA_MONITOR.late_s and sure:
            self._late_reported_s = late_s
            what = "late" if late_s > 0.0 else "early"
            self._texts.append(notices.STAMPS_OFF(name=self._name, off_ms=1e3 * abs(late_s), what=what).text)
        return changed

    @property
    def _name(self) -> str:
        """Source of the stamps for messages: the camera only if there are images."""
        return "Picture" if self._pictures else "Pose"

    def note_picture(self) -> None:
        self._pictures = True

    def update_focal(self, focal_error: float, sigma: float) -> bool:
        """One more picture's opinion of the focal length. True if :attr:`focal_error` has changed."""
        weight = sigma**-2
        keep = 1.0 - 1.0 / CAMERA_MONITOR.forget_estimates
        applied = self.focal_error - CAMERA_MONITOR.bend * self.distortion_error
        self._weight, self._sum = keep * self._weight + weight, keep * self._sum + weight * (applied + focal_error)
        self._estimates += 1
        mean, spread = self._sum / self._weight, self._weight**-0.5
        prior, bend = self._focal_sigma**2, self._bend_sigma**2 + spread**2
        of_focal = prior / (prior + bend)
        self._focal_pending = (
            of_focal * mean - self.focal_error if abs(mean) > CAMERA_MONITOR.focal_seems * spread else 0.0
        )
        if self._estimates < CAMERA_MONITOR.focal_estimates or abs(mean) <= CAMERA_MONITOR.focal_sigmas * spread:
            return False
        known = CAMERA_MONITOR.doubted * math.sqrt(prior + bend)
        self._lens_doubted = abs(mean) > max(CAMERA_MONITOR.focal_named, known)
        if abs(mean) >= CAMERA_MONITOR.focal_named and not self._lens_reported:
            self._lens_reported = True
            what = "long" if mean > 0.0 else "short"
            percent = 100.0 * abs(mean)
            focal = notices.FOCAL_LENGTH_OFF(percent=percent, what=what)
            self._texts.append((focal if of_focal > 0.5 else notices.LENS_OFF(percent=percent)).text)
        if abs(mean - applied) < (CAMERA_MONITOR.focal_step if applied else CAMERA_MONITOR.focal_threshold):
            return False
        self.focal_error, self._focal_pending = of_focal * mean, 0.0
        self.distortion_error = (self.focal_error - mean) / CAMERA_MONITOR.bend
        self._found_focal_sigma = math.sqrt(of_focal * bend)
        return True
