"""The sensors of a scenario file as immutable structs: ``[sensors.*]`` and ``[camera]``.

Where a sensor sits, and its rate and latency unless said otherwise here, is in the vehicle file.
"""

from typing import Annotated, Literal

import msgspec

from autopilot.core.flat_port import FlatPort
from autopilot.core.toml_table import NonNegative, Positive, Table, Vec2, Vec3

OptionalName = Literal["depth", "dvl", "altimeter", "gps"]
"""Sensors that a scenario may have or not."""

Probability = Annotated[float, msgspec.Meta(ge=0.0, le=1.0)]


class AhrsSensor(Table, frozen=True, kw_only=True):
    """``[sensors.ahrs]``. Defaults: an attitude reference of the SBG IG-500 class in a steel tank, all assumed."""

    attitude: bool = True
    """False: gyros, accelerometers and magnetometer only, the attitude is made on board."""
    rate_hz: Positive | None = None
    """None = as the vehicle file."""
    latency_s: NonNegative | None = None
    """None = as the vehicle file."""
    latency_jitter_s: NonNegative = 0.002
    """Standard deviation."""
    gyro_noise_rad_s_rthz: NonNegative = 8.7e-4
    gyro_bias_rad_s: NonNegative = 0.01
    """Standard deviation of the bias at start."""
    gyro_bias_walk_rad_s_rts: NonNegative = 2e-5
    accel_noise_m_s2_rthz: NonNegative = 2.5e-3
    accel_bias_m_s2: NonNegative = 0.05
    accel_bias_walk_m_s2_rts: NonNegative = 2e-4
    tilt_error_rad: NonNegative = 0.0087
    """Standard deviation of the slow (Gauss-Markov) roll and pitch error."""
    tilt_error_time_s: Positive = 20.0
    yaw_error_rad: NonNegative = 0.0175
    """Standard deviation of the slow (Gauss-Markov) yaw error."""
    yaw_error_time_s: Positive = 20.0
    yaw_offset_rad: NonNegative = 0.05
    """Standard deviation of the constant magnetic offset, drawn once per run."""
    yaw_bias_rad: float = 0.0
    """A further constant heading error, the same in every run."""
    yaw_field_rad: NonNegative = 0.035
    """Amplitude of the magnetic offset that changes from place to place (steel in the tank's walls)."""
    yaw_field_length_m: Positive = 3.0
    """Wave length of that change."""
    drop_probability: Probability = 0.0
    """Per frame, lost on the serial line."""
    corrupt_probability: Probability = 0.0
    """Per frame, one byte damaged."""


class Outages(Table, frozen=True, kw_only=True):
    """Gaps in a sensor's output, beginning at random."""

    per_minute: NonNegative = 0.0
    min_s: NonNegative = 0.1
    max_s: NonNegative = 2.0

    def __post_init__(self) -> None:
        if self.max_s < self.min_s:
            raise ValueError(f"`max_s` = {self.max_s:g} is below `min_s` = {self.min_s:g}")


class SampledSensor(Table, frozen=True, kw_only=True):
    """When a sensor samples, and which samples are lost."""

    rate_hz: Positive | None = None
    """None = as the vehicle file (of ``[sensors.pose]``: the camera's)."""
    latency_s: NonNegative | None = None
    """As ``rate_hz``."""
    latency_jitter_s: NonNegative = 0.01
    """Standard deviation."""
    drop_probability: Probability = 0.0
    """Per sample."""
    outages: Outages = Outages()


class CameraSensor(SampledSensor, frozen=True, kw_only=True):
    """``[sensors.camera]``: when pictures come. How they look is ``[camera]``."""

    stamp_error_s: float = 0.0
    """Pictures are stamped so much later than they were exposed: latency that the vehicle file does not know of."""
    drop_probability: Probability = 0.01


class PoseSensor(SampledSensor, frozen=True, kw_only=True):
    """``[sensors.pose]``: stands for camera and marker processing in fast studies."""

    sigma_xy_m: NonNegative = 0.0015
    """At 1 m above the floor; grows with the height. Measured on rendered pictures: 0.3 to 1.5 mm, z 0.7 mm."""
    sigma_z_m: NonNegative = 0.0007
    sigma_yaw_rad: NonNegative = 0.00035
    outlier_probability: Probability = 0.0
    """Per sample."""
    outlier_m: NonNegative = 0.5
    """Size of a wrong fix."""
    drop_probability: Probability = 0.01


class LaserSensor(Table, frozen=True, kw_only=True):
    """``[sensors.laser]``: the dot in the picture, or a range beside the pose sensor."""

    enabled: bool = True
    tilt_error_rad: Vec2 = (0.0, 0.0)
    """True direction of the beam against the vehicle file's: turned about the body's forward and starboard axes."""
    position_error_m: Vec3 = (0.0, 0.0, 0.0)
    """True place of the laser minus the vehicle file's, body frame."""
    sigma_m: NonNegative = 0.005
    """Of the range, when no picture is rendered."""
    outlier_probability: Probability = 0.0
    outlier_m: NonNegative = 0.3


class ObstacleSensor(Table, frozen=True, kw_only=True):
    """``[sensors.obstacles]``: reports moving obstacles, and standing ones that are a surprise, as tracks."""

    range_m: NonNegative = 1.0
    """From the vehicle's centre to the obstacle's surface."""
    rate_hz: Positive = 5.0
    sigma_m: NonNegative = 0.01
    """Standard deviation of a reported position, each axis."""
    sigma_velocity_m_s: NonNegative = 0.01
    """Standard deviation of a reported velocity, each axis; what stands is known to stand."""
    latency_s: NonNegative = 0.1


class DepthSensor(SampledSensor, frozen=True, kw_only=True):
    """``[sensors.depth]``: a pressure sensor; without the table there is none."""

    latency_jitter_s: NonNegative = 0.005
    sigma_m: NonNegative = 0.003
    """White noise: a 30 bar sensor at full oversampling resolves 2 mm."""
    bias_m: NonNegative = 0.05
    """Standard deviation of the constant offset, drawn once per run (air pressure changes by 5 hPa)."""
    drift_m_rts: NonNegative = 2e-4
    """Random walk of the offset."""
    outlier_probability: Probability = 0.0
    outlier_m: NonNegative = 0.5


class DvlSensor(SampledSensor, frozen=True, kw_only=True):
    """``[sensors.dvl]``: a Doppler velocity log; without the table there is none."""

    lock: Literal["bottom", "water"] = "bottom"
    """What it measures against."""
    sigma_m_s: NonNegative = 0.005
    """White noise, each axis."""
    bias_m_s: NonNegative = 0.001
    """Standard deviation of a constant error of each axis, drawn once per run."""
    scale_error: NonNegative = 0.003
    """Standard deviation of the relative error, drawn once per run."""
    heading_error_rad: float = 0.0
    """By which it is turned to starboard of the body's axes."""
    outlier_probability: Probability = 0.0
    outlier_m_s: NonNegative = 0.5
    drop_probability: Probability = 0.02
    least_altitude_m: NonNegative = 0.05
    """Closer to the floor there is no bottom lock."""
    most_altitude_m: Positive = 50.0


class AltimeterSensor(SampledSensor, frozen=True, kw_only=True):
    """``[sensors.altimeter]``: a sonar that looks down; without the table there is none. Defaults: a Ping Sonar."""

    latency_jitter_s: NonNegative = 0.005
    sigma_m: NonNegative = 0.01
    """White noise close by,"""
    sigma_share: NonNegative = 0.005
    """and that which grows with the range."""
    scale_error: NonNegative = 0.01
    """Standard deviation of the relative error, drawn once per run: the speed of sound is not known to the percent."""
    multiple_probability: Probability = 0.0
    """Per sample: the echo that has come back twice is taken for the first."""
    drop_probability: Probability = 0.02
    least_range_m: NonNegative = 0.3
    """Closer nothing is heard: it still rings."""
    most_range_m: Positive = 100.0


class GpsSensor(SampledSensor, frozen=True, kw_only=True):
    """``[sensors.gps]``: a satellite receiver, for the surface; without the table there is none. Defaults: a single
    frequency receiver without corrections, all assumed."""

    latency_jitter_s: NonNegative = 0.02
    sigma_m: NonNegative = 1.5
    """Standard deviation of the slow (Gauss-Markov) error, each axis."""
    error_time_s: Positive = 60.0
    noise_m: NonNegative = 0.2
    """White, each axis."""
    acquire_s: NonNegative = 3.0
    """From surfacing to the first fix."""
    drop_probability: Probability = 0.02


class HullSensor(Table, frozen=True, kw_only=True):
    """``[sensors.hull]``: leak probe, pressure and temperature inside the hull, twice per second."""

    enabled: bool = True
    pressure_pa: Positive = 101325.0
    temperature_c: float = 25.0


class Sensors(Table, frozen=True, kw_only=True):
    """``[sensors]``"""

    position: Literal["camera", "pose"] = "camera"
    """What the vehicle is localised by unless the command line says otherwise."""
    ahrs: AhrsSensor = AhrsSensor()
    camera: CameraSensor = CameraSensor()
    pose: PoseSensor = PoseSensor()
    laser: LaserSensor = LaserSensor()
    obstacles: ObstacleSensor = ObstacleSensor()
    hull: HullSensor = HullSensor()
    depth: DepthSensor | None = None
    dvl: DvlSensor | None = None
    altimeter: AltimeterSensor | None = None
    gps: GpsSensor | None = None


class ImageModel(Table, frozen=True, kw_only=True):
    """``[camera]``: how pictures look. Defaults: a lit tank with clear water."""

    focal_factor: Positive = 1.0
    """True focal length over the calibrated one of the vehicle file."""
    principal_error_px: Vec2 = (0.0, 0.0)
    """True principal point minus the calibrated one."""
    mounting_error_rad: Vec3 = (0.0, 0.0, 0.0)
    """True mounting of the camera against the vehicle file's: roll, pitch, yaw about the body's axes."""
    position_error_m: Vec3 = (0.0, 0.0, 0.0)
    """True place of the camera minus the vehicle file's, body frame."""
    port: FlatPort | None = None
    """``[camera.port]``: the true camera stands behind this flat pane; None = as the vehicle file says."""
    turbidity_1_m: NonNegative = 0.3
    """Contrast decays as exp(-turbidity * distance)."""
    blur_px: NonNegative = 0.8
    """Standard deviation of the optical blur."""
    exposure_s: NonNegative = 0.004
    """For motion blur."""
    noise_levels: NonNegative = 3.0
    """Standard deviation in grey levels of 0..255."""
    light: Positive = 1.0
    """Brightness of the scene, 1 = well exposed."""
    vignetting: Probability = 0.3
    """Loss of brightness in the corners."""
    caustics: Probability = 0.1
    """Relative amplitude of moving light patterns."""
    laser_brightness: NonNegative = 1.0
