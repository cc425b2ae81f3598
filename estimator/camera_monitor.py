"""In-flight check of the camera calibration: latency of the stamps and focal length.

Latency: :mod:`.estimator.stamp_monitor`. Focal length: in a level image an error is equivalent to another height and
unobservable; the lens distortion separates the two, because it scales with the focal length and not with the height.
Every image gives the scale factor that fits its residuals best, and the average of hundreds is significant. A wrong
distortion looks the same: what is found is divided between both by how well each is known.
"""

import math
from dataclasses import dataclass, replace

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


@dataclass(slots=True)
class _Average:
    """Weighted mean of numbers that forgets old ones."""

    keep: float
    """Share of its weight that an older number has at each new one."""
    weight: float = 0.0
    total: float = 0.0
    count: int = 0

    def add(self, value: float, sigma: float) -> None:
        weight = sigma**-2
        self.weight, self.total = self.keep * self.weight + weight, self.keep * self.total + weight * value
        self.count += 1

    @property
    def mean(self) -> float:
        return self.total / self.weight

    @property
    def sigma(self) -> float:
        """Standard deviation of the mean."""
        return float(self.weight**-0.5)


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
        self.tilt_off_rad = 0.0
        """Tilt of the camera against the AHRS."""
        self._tilted_us: int | None = None
        self._tilt_reported = False
        self._late_reported_s: float | None = None
        self._inertial_reported_s = 0.0
        self._lens_reported = self._lens_doubted = False
        self._pictures = False
        self._lens = _Average(keep=1.0 - 1.0 / CAMERA_MONITOR.forget_estimates)
        self._lens_lately = _Average(keep=1.0 - 1.0 / CAMERA_MONITOR.lately_estimates)
        """What pictures say of focal length and distortion together, since the start and lately."""
        self._lens_before: float | None = None
        """What they said until it changed in flight, None = it has not."""
        self.focal_error = self.distortion_error = 0.0
        """Shares by which focal length and distortion are taken to be too large, 0 = they fit as far as is known."""
        self._found_focal_sigma = 0.0
        self._focal_pending = 0.0
        """What else it seems to be off, not yet surely or not worth correcting."""

    @property
    def stamp_sigma_s(self) -> float:
        """Standard deviation of what all stamps are off alike."""
        return self.stamps.sigma_s or self._stamp_sigma_s

    def height_m(self, x: FloatArray) -> float:
        """Height of the camera over the floor with the markers [m], 0 = no such floor."""
        return 0.0 if self._floor_m is None else max(self._floor_m - x.item(DOWN) - self._camera_down_m, 0.0)

    def systematic_variance(self, t_us: int, newest: Node) -> FloatArray:
        """See :class:`Monitor`: position variance by the calibration's uncertainty at this height above the markers."""
        x, yaw_rate_rad_s = newest.state.x, newest.moment.inertial.yaw_rate_rad_s
        focal_error, stamp_sigma_s, mounting = 0.0, self.stamps.sigma_s, None
        if self._pictures:  # poses from elsewhere know nothing of the camera but that they may be late as well
            focal_error = math.hypot(self._found_focal_sigma or self._focal_sigma, self._focal_pending)
            stamp_sigma_s, mounting = self.stamp_sigma_s, self._mounting
        across = focal_error * CAMERA_MONITOR.aside_m
        late_s = math.hypot(stamp_sigma_s, self.stamps.unsure_s)
        if focal_error == late_s == 0.0 and mounting is None:
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
        if mounting is not None:
            forward, right, down, yaw = mounting
            c2 = math.cos(x.item(YAW)) ** 2
            more += forward * c2 + right * (1.0 - c2), forward * (1.0 - c2) + right * c2, down, yaw
        return more

    def doubts(self, t_us: int, newest: Node) -> tuple[NavDoubt, ...]:
        """See :class:`Monitor`: that the calibration is wrong, as has been reported to the operator."""
        self._check_tilt(t_us)
        least_s = max(CAMERA_MONITOR.late_still_s, CAMERA_MONITOR.doubted * self._stamp_sigma_s)
        still_late = self._late_reported_s is not None and abs(self.stamps.late_s) >= least_s
        return (NavDoubt.CALIBRATION,) if self._lens_doubted or still_late else ()

    def _check_tilt(self, t_us: int) -> None:
        """Report a tilt of the camera against the AHRS that neither explains."""
        if not self._pictures or self.tilt_off_rad <= self._tilt_most_rad:
            self._tilted_us = None
        elif self._tilted_us is None:
            self._tilted_us = t_us
        elif not self._tilt_reported and t_us - self._tilted_us >= CAMERA_MONITOR.tilted_us:
            self._tilt_reported = True
            self._texts.append(notices.CAMERA_TILTED(off_deg=math.degrees(self.tilt_off_rad)).text)

    def check_stamps(self) -> bool:
        """Whether a latency of the stamps has been detected, or has changed."""
        changed = self.stamps.evaluate()
        late_s = self.stamps.late_s
        jumped_s, reported_s = self.stamps.jumped_s, self._late_reported_s
        sure = 0.0 < self.stamps.sigma_s < CAMERA_MONITOR.late_fraction * max(abs(late_s), 2.0 * CAMERA_MONITOR.late_s)
        inertial_s = self.stamps.inertial_late_s
        if abs(inertial_s - self._inertial_reported_s) >= CAMERA_MONITOR.late_s:
            self._inertial_reported_s = inertial_s
            self._texts.append(notices.AHRS_LATE(late_ms=1e3 * inertial_s).text)
        if jumped_s:
            if abs(jumped_s) >= max(CAMERA_MONITOR.late_s, CAMERA_MONITOR.jump_sigmas * self.stamps.sigma_s):
                self.stamps.jumped_s, self._late_reported_s = 0.0, late_s
                jumped = notices.STAMPS_JUMPED if jumped_s > 0.0 else notices.STAMPS_JUMPED_BACK
                self._texts.append(jumped(name=self._name, jump_ms=1e3 * jumped_s).text)
        elif reported_s is None and abs(late_s) >= CAMERA_MONITOR.late_s and sure:
            self._late_reported_s = late_s
            late_ms = 1e3 * late_s
            self._texts.append(
                notices.STAMPS_LATE(name=self._name, late_ms=late_ms).text
                if late_ms > 0.0
                else notices.STAMPS_EARLY(name=self._name, early_ms=-late_ms).text
            )
        return changed

    @property
    def _name(self) -> str:
        """Source of the stamps for messages: the camera only if there are images."""
        return "Picture" if self._pictures else "Pose"

    def note_picture(self) -> None:
        self._pictures = True

    @property
    def lens_fits(self) -> bool:
        """Whether pictures fit the lens as it is taken to be: what they say of the tilt is off otherwise."""
        return not self._lens.count or abs(self._lens.mean - self._lens_applied) < CAMERA_MONITOR.focal_named

    def lens_variance(self, x: FloatArray) -> tuple[float, float, float, float]:
        """Variance (4,) of a picture's pose by a distortion that is not known yet: which of its markers fit changes
        from picture to picture, and with them the pose."""
        if self.lens_fits and self._lens.count >= CAMERA_MONITOR.focal_soon:
            return 0.0, 0.0, 0.0, 0.0
        aside_m = CAMERA_MONITOR.bent_share * self._bend_sigma / CAMERA_MONITOR.bend * self.height_m(x)
        return aside_m**2, aside_m**2, aside_m**2, 0.0

    @property
    def _lens_applied(self) -> float:
        """What of their opinion is applied."""
        return self.focal_error - CAMERA_MONITOR.bend * self.distortion_error

    def update_focal(self, focal_error: float, sigma: float) -> bool:
        """One more picture's opinion of the focal length. True if :attr:`focal_error` has changed."""
        applied = self._lens_applied
        for mean in (self._lens, self._lens_lately):
            mean.add(applied + focal_error, sigma)
        self._note_change()
        found, spread = self._lens.mean, self._lens.sigma
        prior, bend = self._focal_sigma**2, self._bend_sigma**2 + spread**2
        of_focal = prior / (prior + bend)
        change = 0.0 if self._lens_before is None else found - self._lens_before
        focal = change + of_focal * (found - change)
        self._focal_pending = focal - self.focal_error if abs(found) > CAMERA_MONITOR.focal_seems * spread else 0.0
        if self._lens.count < CAMERA_MONITOR.focal_estimates or abs(found) <= CAMERA_MONITOR.focal_sigmas * spread:
            return False
        known = CAMERA_MONITOR.doubted * math.sqrt(prior + bend)
        self._lens_doubted = change != 0.0 or abs(found) > max(CAMERA_MONITOR.focal_named, known)
        if abs(found) >= CAMERA_MONITOR.focal_named and not self._lens_reported:
            self._lens_reported = True
            percent, what = 100.0 * abs(found), "long" if found > 0.0 else "short"
            by_focal = change != 0.0 or of_focal > 0.5
            text = (
                notices.FOCAL_LENGTH_OFF(percent=percent, what=what) if by_focal else notices.LENS_OFF(percent=percent)
            )
            self._texts.append(text.text)
        if abs(found - applied) < (CAMERA_MONITOR.focal_step if applied else CAMERA_MONITOR.focal_threshold):
            return False
        self.focal_error, self._focal_pending = focal, 0.0
        self.distortion_error = (focal - found) / CAMERA_MONITOR.bend
        self._found_focal_sigma = math.sqrt(of_focal * bend)
        return True

    def _note_change(self) -> None:
        """A lens that is another one than before: no calibration was wrong, its focal length has changed."""
        change, lately = self._lens_lately.mean - self._lens.mean, self._lens_lately
        least = max(
            CAMERA_MONITOR.focal_named,
            CAMERA_MONITOR.changed_share * abs(self._lens.mean),
            CAMERA_MONITOR.focal_sigmas * lately.sigma,
        )
        if lately.count >= 2 * CAMERA_MONITOR.focal_soon and abs(change) > least:
            if self._lens_before is None:
                self._lens_before, self._lens_reported = self._lens.mean, False
            self._lens = replace(lately, keep=self._lens.keep)
