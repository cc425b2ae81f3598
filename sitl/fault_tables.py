"""``[[fault]]`` tables: sensors that go on sending well-formed, wrong values, and what happens to hull, battery, links
and the machine."""

from typing import Annotated, Literal, TypeAlias

import msgspec

from autopilot.core.toml_table import NonNegative, Positive, Table, Vec3
from autopilot.sitl.sensor_tables import OptionalName

Angle = Annotated[float, msgspec.Meta(ge=-3.15, le=3.15)]
MOST_DELAY_S = 10.0
MOST_PICTURES = 300
"""As much of the past is kept for pictures that are shown late or again."""


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


class LensFault(_Fault, frozen=True, kw_only=True, tag_field="kind", tag="lens"):
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


class NearFrozen(_Fault, frozen=True, kw_only=True, tag_field="kind", tag="camera_near_frozen"):
    """The picture of the beginning again and again, under new stamps and with other noise each time."""

    noise_levels: NonNegative = 2.0
    """Standard deviation of the noise [grey levels]."""


class Repeated(_Fault, frozen=True, kw_only=True, tag_field="kind", tag="camera_repeated"):
    """The last pictures before the beginning in a loop, under new stamps."""

    pictures: Annotated[int, msgspec.Meta(ge=1, le=MOST_PICTURES)] = 15


class Delayed(_Fault, frozen=True, kw_only=True, tag_field="kind", tag="camera_delayed"):
    """Pictures are older than their stamps say."""

    delay_s: Annotated[float, msgspec.Meta(gt=0.0, le=MOST_DELAY_S)]


class Mirrored(_Fault, frozen=True, kw_only=True, tag_field="kind", tag="camera_mirrored"):
    """Pictures are mirrored or turned upside down (a wrong setting of the camera)."""

    across: Literal["columns", "rows", "both"] = "columns"
    """What is exchanged: left and right, top and bottom, or both."""


class HalfFrozen(_Fault, frozen=True, kw_only=True, tag_field="kind", tag="camera_half_frozen"):
    """A part of the picture stays as it was at the beginning, with other noise each time."""

    part: Literal["top", "bottom", "left", "right"] = "bottom"
    share: Annotated[float, msgspec.Meta(gt=0.0, lt=1.0)] = 0.5
    """Of the height or width of the picture."""
    noise_levels: NonNegative = 2.0


class Elsewhere(_Fault, frozen=True, kw_only=True, tag_field="kind", tag="camera_elsewhere"):
    """Pictures of another place over the same floor: another camera's, or an old recording."""

    offset_m: Vec3 = (0.0, 0.0, 0.0)
    """From the vehicle to that place at the beginning, north, east, down."""
    yaw_rad: Angle = 0.0
    follows: bool = False
    """Whether the place moves on as the vehicle does; else it stays where it was at the beginning."""


class Reflection(_Fault, frozen=True, kw_only=True, tag_field="kind", tag="camera_reflection"):
    """The floor's image in the water surface shines into the picture: mirrored, and as far away as its way is long."""

    strength: Annotated[float, msgspec.Meta(gt=0.0, le=1.0)] = 0.5
    """Share of the light that comes by way of the surface."""


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
    """A pressure sensor, Doppler log or altimeter repeats its last reading under new times."""

    sensor: OptionalName


class LinkLoss(_Fault, frozen=True, kw_only=True, tag_field="kind", tag="link_loss"):
    """The operator is neither heard nor reached."""


class PilotFault(_Fault, frozen=True, kw_only=True, tag_field="kind", tag="pilot"):
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


class SecondSender(_Fault, frozen=True, kw_only=True, tag_field="kind", tag="second_sender"):
    """Somebody else commands the thrusters, by turns with the service."""

    push_us: Annotated[float, msgspec.Meta(ge=-400.0, le=400.0)] = 120.0
    """Its pulses beside the service's, up and down by turns from thruster to thruster."""
    rate_hz: Annotated[float, msgspec.Meta(ge=1.0, le=50.0)] = 20.0
    """So often it speaks."""


class SlowLoop(_Fault, frozen=True, kw_only=True, tag_field="kind", tag="slow_loop"):
    """The machine is so busy that ticks begin late."""

    share: Annotated[float, msgspec.Meta(gt=0.0, le=1.0)] = 0.5


class DiskFull(_Fault, frozen=True, kw_only=True, tag_field="kind", tag="disk_full"):
    """The recorder says that nothing can be written."""


class ClockJump(_Fault, frozen=True, kw_only=True, tag_field="kind", tag="clock_jump"):
    """The machine's clock of day is set to another time."""

    jump_s: float


class WatchdogEnded(_Fault, frozen=True, kw_only=True, tag_field="kind", tag="watchdog_ended"):
    """The process that stops the thrusters when the service cannot has ended."""


MachineFault: TypeAlias = SlowLoop | DiskFull | ClockJump | WatchdogEnded | LateCommands | SecondSender
HullFault: TypeAlias = Leak | HullClimate
Mishap: TypeAlias = Shove | Snag | BatterySag
OperatorFault: TypeAlias = LinkLoss | PilotFault
PictureFault: TypeAlias = NearFrozen | Repeated | Delayed | Mirrored | HalfFrozen | Elsewhere | Reflection
"""Pictures that look right and are not of here and now."""
SensorFault: TypeAlias = ImuOffset | ImuScale | ImuStuck | ImuClip | AhrsAttitude | LensFault | Mounting | MarkersMoved
