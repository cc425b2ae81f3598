"""``[[fault]]`` tables: sensors that go on sending well-formed, wrong values, and what happens to hull, battery, links
and the machine."""

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


class Leak(_Fault, frozen=True, kw_only=True, tag_field="kind", tag="leak"):
    """Water at the leak probe."""


class HullClimate(_Fault, frozen=True, kw_only=True, tag_field="kind", tag="hull_climate"):
    """Pressure or temperature inside the hull."""

    pressure_pa: Positive | None = None
    """None = as ever."""
    temperature_c: float | None = None
    """The same."""


class BatterySag(_Fault, frozen=True, kw_only=True, tag_field="kind", tag="battery_sag"):
    """The battery has less left than it had, once and for all: its voltage falls with it."""

    remaining: Annotated[float, msgspec.Meta(ge=0.0, le=1.0)]
    """Share of the capacity that is left at that moment."""


class SensorFrozen(_Fault, frozen=True, kw_only=True, tag_field="kind", tag="sensor_frozen"):
    """A pressure sensor or Doppler log repeats its last reading under new times."""

    sensor: Literal["depth", "dvl"]


class LinkLoss(_Fault, frozen=True, kw_only=True, tag_field="kind", tag="link_loss"):
    """The operator is neither heard nor reached."""


class Pilot(_Fault, frozen=True, kw_only=True, tag_field="kind", tag="pilot"):
    """The operator holds the sticks (MANUAL_CONTROL at 10 Hz) for that time, and then no more."""


class Shove(_Fault, frozen=True, kw_only=True, tag_field="kind", tag="shove"):
    """A force on the hull that nobody commanded."""

    force_ned_n: Vec3 = (0.0, 0.0, 0.0)
    moment_frd_n_m: Vec3 = (0.0, 0.0, 0.0)


class Snag(_Fault, frozen=True, kw_only=True, tag_field="kind", tag="snag"):
    """Something holds the hull where it is then, as a spring and a damper do."""

    stiffness_n_m: Positive = 150.0
    damping_n_s_m: Positive = 150.0


class LateCommands(_Fault, frozen=True, kw_only=True, tag_field="kind", tag="late_commands"):
    """Commands take so long from the service to the amplifiers, beyond what the vehicle's table says."""

    latency_s: Positive


class SlowLoop(_Fault, frozen=True, kw_only=True, tag_field="kind", tag="slow_loop"):
    """The machine is so busy that ticks begin late."""

    share: Annotated[float, msgspec.Meta(gt=0.0, le=1.0)] = 0.5


class DiskFull(_Fault, frozen=True, kw_only=True, tag_field="kind", tag="disk_full"):
    """The recorder says that nothing can be written."""


class ClockJump(_Fault, frozen=True, kw_only=True, tag_field="kind", tag="clock_jump"):
    """The machine's clock of day is set to another time."""

    jump_s: float


MachineFault: TypeAlias = SlowLoop | DiskFull | ClockJump | LateCommands
HullFault: TypeAlias = Leak | HullClimate
Mishap: TypeAlias = Shove | Snag | BatterySag
OperatorFault: TypeAlias = LinkLoss | Pilot
SensorFault: TypeAlias = ImuOffset | ImuScale | ImuStuck | ImuClip | AhrsAttitude | Lens | Mounting | MarkersMoved
