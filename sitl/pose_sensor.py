"""A simulated marker-pose sensor and laser range without images, for fast studies.

It has the characteristics of camera and marker processing: position and heading with errors that grow with the height
above the floor, wrong fixes, gaps and the camera's latency; and the range along the laser beam.
"""

from collections.abc import Iterable

import numpy as np

from autopilot.core.frames import FloatArray, r_ned_from_frd, wrap_pi
from autopilot.core.samples import LaserSample, PoseSample
from autopilot.core.vehicle import Laser, Vehicle
from autopilot.sitl.delayed import LossySensor
from autopilot.sitl.picture_faults import PictureFaults
from autopilot.sitl.plant import Truth
from autopilot.sitl.scenario_tables import Fault
from autopilot.sitl.sensor_faults import OpticalFaults
from autopilot.sitl.sensor_tables import LaserSensor, PoseSensor
from autopilot.sitl.sitl_tuning import POSE_SENSOR


class SimPoseSensor(LossySensor[PoseSample | LaserSample]):
    """Takes samples of the truth and delivers them after their latency."""

    def __init__(
        self,
        pose: PoseSensor,
        laser: LaserSensor,
        vehicle: Vehicle,
        floor_depth_m: float | None,
        faults: Iterable[Fault],
        seed: int,
    ) -> None:
        """``floor_depth_m`` None: open water, the position comes from outside and there is no laser range."""
        faults, camera = list(faults), vehicle.camera
        usual = POSE_SENSOR.usual if camera is None else (camera.rate_hz, camera.latency_s)
        super().__init__(pose, usual, faults, (seed, 20), sensor="camera")
        self._pose = pose
        self._laser = laser
        self._floor_depth_m = floor_depth_m
        self._camera_frd_m = np.array((0.0, 0.0, 0.0) if camera is None else camera.position_frd_m)
        self._ranges = laser.enabled and vehicle.laser is not None
        beam = vehicle.laser or Laser(position_frd_m=(0.0, 0.0, 0.0))
        self._laser_frd_m, beam_frd = np.array(beam.position_frd_m), np.array(beam.direction_frd)
        self._beam_frd = beam_frd / np.linalg.norm(beam_frd)
        self._sigma_pos_m = np.array([pose.sigma_xy_m, pose.sigma_xy_m, pose.sigma_z_m])
        self._faults = OpticalFaults(faults)
        self._pictures = PictureFaults(faults)

    def tilt(self, off_rad: float) -> None:
        """How far the camera is tilted upwards from where it was calibrated, from now on."""
        self._faults.tilt(off_rad)

    def add(self, fault: Fault) -> bool:
        """A fault that begins while the simulation runs; whether it is one of this sensor."""
        return self._pictures.add(fault) or super().add(fault)

    def observe(self, truth: Truth) -> None:
        self._taken()
        noise = self._rng.standard_normal(6).tolist()
        chance = self._rng.random(6).tolist()
        shown = self._pictures.pose_shown(truth, self._count)
        if self._lost(truth.t_us, chance[0]) or shown is None:
            return
        r = r_ned_from_frd(shown.rpy_rad)
        laser = self._range(shown, r, noise[4], chance)
        self._send(truth.t_us, noise[5], self._measured(shown, r, noise, chance), *([] if laser is None else [laser]))

    def _measured(self, truth: Truth, r: FloatArray, noise: list[float], chance: list[float]) -> PoseSample:
        scale = self._scale(truth, r)
        sigma_pos = scale * self._sigma_pos_m
        sigma_yaw = scale * self._pose.sigma_yaw_rad
        seen_ned_m, seen_yaw_rad = self._faults.pose(truth, self._camera_frd_m, self._floor_depth_m)
        position = seen_ned_m + sigma_pos * noise[0:3]
        if chance[1] < self._pose.outlier_probability:
            angle = 2.0 * np.pi * chance[2]
            position = position + self._pose.outlier_m * np.array([np.cos(angle), np.sin(angle), 0.0])
        return PoseSample(
            t_us=truth.t_us,
            pos_ned_m=position,
            yaw_rad=wrap_pi(float(seen_yaw_rad + sigma_yaw * noise[3])),
            sigma_pos_m=sigma_pos,
            sigma_yaw_rad=sigma_yaw,
        )

    def _scale(self, truth: Truth, r: FloatArray) -> float:
        """Ratio of the errors to those at the reference height."""
        if self._floor_depth_m is None:
            return 1.0
        camera_m = float(truth.pos_ned_m[2] + r[2] @ self._camera_frd_m)
        return max(POSE_SENSOR.least_scale, (self._floor_depth_m - camera_m) / POSE_SENSOR.reference_height_m)

    def _range(self, truth: Truth, r: FloatArray, noise: float, chance: list[float]) -> LaserSample | None:
        if self._floor_depth_m is None or not self._ranges:
            return None
        down = float(r[2] @ self._beam_frd)
        if down <= 0.0:
            return None
        range_m = (self._floor_depth_m - float(truth.pos_ned_m[2] + r[2] @ self._laser_frd_m)) / down
        if not POSE_SENSOR.laser_least_range_m <= range_m <= POSE_SENSOR.laser_most_range_m:
            return None
        sigma_m = self._laser.sigma_m * max(POSE_SENSOR.least_scale, range_m / POSE_SENSOR.reference_height_m) ** 2
        range_m += sigma_m * noise
        if chance[3] < self._laser.outlier_probability:
            range_m += self._laser.outlier_m * (2.0 * chance[4] - 1.0)
        return LaserSample(t_us=truth.t_us, range_m=range_m, sigma_m=sigma_m) if range_m > 0.0 else None
