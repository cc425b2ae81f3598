"""A made-up flight: what camera, gyros, accelerometers and laser see of a smooth motion, with known errors."""

import numpy as np
from scipy.spatial.transform import Rotation

from autopilot.calibrate.recorded_flight import CameraFlight, RecordedAhrs
from autopilot.core.camera import CameraModel
from autopilot.core.frames import FloatArray, r_ned_from_frd
from autopilot.core.vehicle import Vehicle, load_vehicle

GRAVITY = np.array([0.0, 0.0, 9.81])
FLOOR_M = 1.5


class Motion:
    """Position and attitude as sums of sines; derivatives by differences of 0.1 ms."""

    def __init__(self, *, yaw: float = 0.8, tilt: float = 0.12) -> None:
        self.yaw, self.tilt = yaw, tilt

    def rpy(self, t: FloatArray) -> FloatArray:
        roll = self.tilt * np.sin(1.7 * t) + 0.5 * self.tilt * np.sin(0.6 * t + 1.0)
        pitch = self.tilt * np.sin(1.3 * t + 0.5)
        yaw = self.yaw * np.sin(0.9 * t) + 0.5 * self.yaw * np.sin(0.37 * t + 2.0)
        return np.column_stack((roll, pitch, yaw))

    def pos(self, t: FloatArray) -> FloatArray:
        return np.column_stack((0.4 * np.sin(0.5 * t), 0.3 * np.sin(0.7 * t + 1.0), 0.6 + 0.25 * np.sin(0.3 * t)))

    def attitude(self, t: FloatArray) -> Rotation:
        return Rotation.from_euler("ZYX", self.rpy(t)[:, ::-1])

    def rate(self, t: FloatArray) -> FloatArray:
        h = 1e-4
        return (self.attitude(t - h).inv() * self.attitude(t + h)).as_rotvec() / (2.0 * h)

    def force(self, t: FloatArray) -> FloatArray:
        h = 1e-3
        accel = (self.pos(t + h) - 2.0 * self.pos(t) + self.pos(t - h)) / h**2
        return self.attitude(t).inv().apply(accel - GRAVITY)


def make_flight(
    motion: Motion,
    *,
    mounting_rpy: tuple[float, float, float] = (0.0, 0.0, 0.0),
    late_s: float = 0.0,
    arm_m: tuple[float, float, float] = (0.0, 0.0, 0.1),
    seed: int = 1,
    duration_s: float = 60.0,
    noise: float = 1.0,
) -> CameraFlight:
    """The flight as a log would give it; the vehicle file knows nothing of the errors."""
    rng = np.random.default_rng(seed)
    vehicle: Vehicle = load_vehicle("lbv150")
    camera = CameraModel.of_vehicle(vehicle)
    ahrs_t = np.arange(-1.0, duration_s + 1.0, 0.01)
    gyro_noise, accel_noise = 8.7e-3 * noise, 0.025 * noise
    ahrs = RecordedAhrs(
        t_s=ahrs_t,
        rpy_rad=motion.rpy(ahrs_t) + np.array([0.004, -0.003, 0.2]),
        rate_frd_rad_s=motion.rate(ahrs_t) + [0.004, 0.008, -0.01] + gyro_noise * rng.standard_normal((len(ahrs_t), 3)),
        accel_frd_m_s2=motion.force(ahrs_t) + [0.05, -0.04, 0.02] + accel_noise * rng.standard_normal((len(ahrs_t), 3)),
    )
    t = np.arange(0.0, duration_s, 1.0 / 30.0)
    t = t[rng.random(len(t)) > 0.02]
    attitude = motion.attitude(t)
    mounting = Rotation.from_matrix(r_ned_from_frd(np.array(mounting_rpy)) @ camera.r_frd_from_cam)
    turned = Rotation.from_rotvec(noise * np.array([4e-4, 3e-4, 1e-4]) * rng.standard_normal((len(t), 3)))
    return CameraFlight(
        vehicle=vehicle,
        camera=camera,
        t_s=t + late_s,
        eye_ned_m=motion.pos(t) + attitude.apply(arm_m) + noise * 3e-4 * rng.standard_normal((len(t), 3)),
        r_ned_from_cam=(attitude * mounting * turned).as_matrix(),
        rms_px=np.full(len(t), 0.15),
        laser_px=np.full((len(t), 2), np.nan),
        ahrs=ahrs,
        floor_m=FLOOR_M,
        sightings=len(t),
    )
