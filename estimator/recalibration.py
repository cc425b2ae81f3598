"""Application of the calibration errors found in flight, and correction of the estimate that they have biased."""

import math

import numpy as np

from autopilot.core.frames import FloatArray
from autopilot.estimator.estimator_tuning import CAMERA_MONITOR
from autopilot.estimator.fusion import Fusion
from autopilot.estimator.intake import SampleBuffer
from autopilot.estimator.monitors import Monitors
from autopilot.estimator.sources import Sources
from autopilot.estimator.states import ACCEL_BIAS, GYRO_BIAS, POS, VEL, YAW, one

CARRIED_US = 3_000
"""Smaller changes of what is known of the stamps leave the estimate as it is."""
CARRIED_SIGMA = np.array([0.005, 0.005, 0.005, 0.01])
"""m, rad; besides all of what it was carried forward."""


class Recalibration:
    def __init__(self, fusion: Fusion, sources: Sources, intake: SampleBuffer, monitors: Monitors) -> None:
        self._fusion, self._sources, self._intake = fusion, sources, intake
        self._evidence, self._imu, self._camera, self._map, *_ = monitors
        self._lens = 0.0, 0.0
        """Focal and distortion error that pictures are read with,"""
        self._print = 0.0
        """and error of the printed size."""
        self.inertial_late_us = 0
        """What is to be taken off the stamps of the inertial sensors."""
        self.counts = dict.fromkeys(("stamps.retimed", "focal.rescaled", "print.rescaled"), 0)

    def retime(self) -> None:
        """If images are found to be stamped late, correct later stamps and carry the estimate, which has followed
        delayed images, forward. If inertial sensors are, images have led the estimate to the right place, and only what
        was found with their old stamps is forgotten.
        """
        inertial_late_us = round(1e6 * self._camera.stamps.inertial_late_s)
        if inertial_late_us != self.inertial_late_us:
            self.inertial_late_us = inertial_late_us
            self._carry(np.zeros(4), np.zeros(3))
        pictures = self._sources.pictures
        late_us = round(1e6 * self._camera.stamps.late_s)
        more_us = late_us - pictures.late_us
        if more_us == 0:
            return
        pictures.late_us = late_us
        self._intake.retime_pictures(-more_us)
        if self._fusion.past is None or abs(more_us) < CARRIED_US:
            return
        newest, more_s = self._fusion.history.newest, 1e-6 * more_us
        x, inertial = newest.state.x, newest.moment.inertial
        c, s = math.cos(x.item(YAW)), math.sin(x.item(YAW))
        forward, right, down = (a - x.item(ACCEL_BIAS.start + i) for i, a in enumerate(inertial.accel_level_m_s2))
        velocity = more_s * np.array([c * forward - s * right, s * forward + c * right, down])
        turn = inertial.yaw_rate_rad_s - x.item(GYRO_BIAS)
        self._carry(more_s * np.append(x[VEL], turn), velocity)
        self.counts["stamps.retimed"] += 1

    def rescale(self) -> None:
        """If the lens is another than was thought: pictures and the estimate come nearer to the markers, or go away
        from them."""
        focal_error, distortion_error = lens = self._camera.focal_error, self._camera.distortion_error
        if lens == self._lens:
            return
        focal_before, distortion_before = self._lens
        self._lens = lens
        self._sources.pictures.set_lens(focal_error, distortion_error)
        more = (1.0 + focal_error) / (1.0 + focal_before) - 1.0
        bent = distortion_error - distortion_before
        height_m = self._camera.height_m(self._fusion.history.newest.state.x)
        self._carry(
            np.array([0.0, 0.0, height_m * more, 0.0]), np.zeros(3), CAMERA_MONITOR.bent_share * height_m * bent
        )
        self.counts["focal.rescaled"] += 1

    def resize(self) -> None:
        """If the markers are printed larger or smaller than was thought: pictures of few of them were off by that."""
        error = 0.0 if self._map is None else self._map.print_error
        if error == self._print:
            return
        more, self._print = error - self._print, error
        self._sources.pictures.set_print(error)
        height_m = self._camera.height_m(self._fusion.history.newest.state.x)
        self._carry(np.zeros(4), np.zeros(3), abs(more) * height_m)
        self.counts["print.rescaled"] += 1

    def _carry(self, along: FloatArray, velocity: FloatArray, aside_m: float = 0.0) -> None:
        """Move the estimate by ``along`` (4,) [m, rad], change its velocity by ``velocity`` (3,), and reset everything
        derived from it: inertial biases, findings, history. It is unsure by ``aside_m`` besides.
        """
        x = self._fusion.history.newest.state.x
        aside = np.array([aside_m, aside_m, aside_m, 0.0])
        noise = np.diag(CARRIED_SIGMA**2 + along**2 + aside**2)
        pose = np.append(x[POS], x[YAW]) + along
        self._fusion.move(pose, noise, x[VEL] + velocity, (one(GYRO_BIAS), ACCEL_BIAS))
        self._imu.forgive()
        self._sources.restart()
        for aid in self._sources.fixes:
            aid.trust.reinstate(None if aid.trust.trusted else self._fusion.now_us)
        self._evidence.forgive()
