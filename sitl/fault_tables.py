"""``[[fault]]`` tables of sensors that go wrong without saying so: they go on sending well-formed, wrong values."""

from typing import Annotated, Literal, TypeAlias

import msgspec

from autopilot.core.toml_table import NonNegative, Positive, Table, Vec3

Angle = Annotated[float, msgspec.Meta(ge=-3.15, le=3.15)]


class _Fault(Table, frozen=True, kw_only=True):
    """When it holds."""

    at_s: NonNegative
    duration_s: Positive | None = None
    """None = to the end."""

    def holds(self, t_us: int) -> bool:
        """Whether it is there at that time."""
        t_s = 1e-6 * t_us
        return self.at_s <= t_s and (self.duration_s is None or t_s < self.at_s + self.duration_s)


class ImuOffset(_Fault, frozen=True, kw_only=True, tag_field="kind", tag="imu_offset"):
    """Accelerometer or gyro with an offset."""

    sensor: Literal["accel", "gyro"]
    offset: Vec3
    """Added to the reading, body axes [m/s^2 or rad/s]."""


class ImuScale(_Fault, frozen=True, kw_only=True, tag_field="kind", tag="imu_scale"):
    """Accelerometer or gyro with a wrong scale."""

    sensor: Literal["accel", "gyro"]
    factor: Vec3
    """Reading over true value, body axes."""


class ImuStuck(_Fault, frozen=True, kw_only=True, tag_field="kind", tag="imu_stuck"):
    """One axis keeps the value that it had at the beginning; all others go on."""

    sensor: Literal["accel", "gyro"]
    axis: Literal["x", "y", "z"]


class ImuClip(_Fault, frozen=True, kw_only=True, tag_field="kind", tag="imu_clip"):
    """Accelerometer or gyro set to a range that is too small."""

    sensor: Literal["accel", "gyro"]
    limit: Positive
    """Readings end at plus and minus this [m/s^2 or rad/s]."""


class AhrsAttitude(_Fault, frozen=True, kw_only=True, tag_field="kind", tag="ahrs_attitude"):
    """The AHRS's attitude is off: wrong tilt, wrong heading. Its gyros and accelerometers are right."""

    roll_rad: Angle = 0.0
    pitch_rad: Angle = 0.0
    yaw_rad: Angle = 0.0


class Lens(_Fault, frozen=True, kw_only=True, tag_field="kind", tag="lens"):
    """The camera's focal length is not the calibrated one. The pose sensor's heights are off as a picture's."""

    focal_factor: Positive
    """True over calibrated."""


class Mounting(_Fault, frozen=True, kw_only=True, tag_field="kind", tag="mounting"):
    """The camera is not where and not as it was calibrated."""

    rpy_rad: tuple[Angle, Angle, Angle] = (0.0, 0.0, 0.0)
    """True mounting against the vehicle file's, about the body's axes."""
    position_m: Vec3 = (0.0, 0.0, 0.0)
    """True place minus the vehicle file's, body frame."""


class MarkersMoved(_Fault, frozen=True, kw_only=True, tag_field="kind", tag="markers_moved"):
    """All markers lie elsewhere than the map says: turned about the origin, then shifted."""

    offset_m: Vec3 = (0.0, 0.0, 0.0)
    """North, east, down."""
    yaw_rad: Angle = 0.0


SensorFault: TypeAlias = ImuOffset | ImuScale | ImuStuck | ImuClip | AhrsAttitude | Lens | Mounting | MarkersMoved
