"""Sensor samples, as drivers and the simulator deliver them.

Conventions as in :mod:`autopilot.core.messages`. ``t_us`` is the time of validity [us].
"""

from dataclasses import dataclass
from enum import Enum, IntEnum
from typing import Any, TypeAlias

from autopilot.core.frames import FloatArray


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class AhrsSample:
    """One AHRS frame. ``t_us``: arrival minus the declared latency."""

    t_us: int
    rpy_rad: FloatArray
    """(3,) roll, pitch, yaw (yaw magnetic, with an unknown slow offset)."""
    rate_frd_rad_s: FloatArray
    """(3,)"""
    accel_frd_m_s2: FloatArray
    """(3,) specific force: at rest about (0, 0, -9.81)."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ImuSample:
    """One frame of an IMU without attitude output."""

    t_us: int
    rate_frd_rad_s: FloatArray
    """(3,)"""
    accel_frd_m_s2: FloatArray
    """(3,) specific force: at rest about (0, 0, -9.81)."""
    mag_frd: FloatArray | None = None
    """(3,) magnetic field in any unit, None without a (new) reading."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class CameraFrame:
    """One image. ``t_us`` is the time of exposure; pixels are BGR uint8 (rows, columns, 3).

    Detection and log read it on threads of their own: the producer must not write to it any more.
    """

    t_us: int
    image_bgr: Any
    stamp_sigma_s: float = 0.0
    """Standard deviation of ``t_us`` from picture to picture; an error that all have in common is not in it."""


class FrameVerdict(Enum):
    """Reason why an image is rejected; ``OK`` = accepted."""

    OK = "ok"
    WRONG_SIZE = "wrong_size"
    """Not (rows, columns, 3) of the camera: another camera, or another camera's intrinsics."""
    WRONG_TYPE = "wrong_type"
    """Not 8 bits per channel."""
    DARK = "dark"
    BRIGHT = "bright"
    FLAT = "flat"
    """One grey level all over."""
    TORN = "torn"
    """The lower part is missing."""
    FROZEN = "frozen"
    """The same picture as before under a new time: noise never repeats, so the camera hangs."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PictureReport:
    """Statistics of an image, computed before marker detection."""

    t_us: int
    verdict: FrameVerdict
    contrast: float = 0.0
    """Standard deviation of the steps between neighbours on a coarse grid, over the root of 2 [grey levels]."""
    white_fraction: float = 0.0
    black_fraction: float = 0.0
    """Shares of the pixels that are white, black."""


MAX_SIGHTED = 64
"""Largest number of markers of one sighting, as in the log: a replay has the flight's data."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class MarkerSighting:
    """Markers and laser dot detected in one image. ``t_us`` is the time of exposure."""

    t_us: int
    ids: tuple[int, ...]
    """Dictionary ids, one per marker (ids may repeat on the floor)."""
    corners_px: FloatArray
    """(n, 4, 2) image points in OpenCV's corner order, as seen (distorted)."""
    laser_px: FloatArray | None
    """(2,) the laser dot, None if not found."""
    sigma_px: FloatArray | None = None
    """(n,) standard deviation of each marker's corners per axis, from the image; None = unknown."""
    decode_us: int = 0
    """Time that detection took, for the log."""
    stamp_sigma_s: float = 0.0
    """As that of the image."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PoseSample:
    """A measured pose of the vehicle (marker-pose sensor, external vision)."""

    t_us: int
    pos_ned_m: FloatArray
    """(3,)"""
    yaw_rad: float
    sigma_pos_m: FloatArray
    """(3,) standard deviations."""
    sigma_yaw_rad: float


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LaserSample:
    """Range along the laser beam to the floor, of sensors that deliver a range instead of an image."""

    t_us: int
    range_m: float
    sigma_m: float


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class AltimeterSample:
    """Range of a sonar altimeter's first echo."""

    t_us: int
    range_m: float
    """Distance of the nearest echo within the beam."""
    sigma_m: float
    confidence: float = 1.0
    """0..1, the device's confidence in the echo."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class DepthSample:
    t_us: int
    depth_m: float
    """Depth of the sensor below the surface, positive down."""
    sigma_m: float


class VelocityLock(IntEnum):
    """Reference of a velocity measurement."""

    WATER = 0
    BOTTOM = 1


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class VelocitySample:
    """Velocity of a DVL at its mounting position, in the body frame."""

    t_us: int
    vel_frd_m_s: FloatArray
    """(3,)"""
    sigma_m_s: FloatArray
    """(3,) standard deviations."""
    lock: VelocityLock = VelocityLock.BOTTOM


class ExternalFrame(IntEnum):
    """Local frame of an external pose."""

    NED = 0
    """North, east, down from the local origin at the surface."""
    FRD = 1
    """Level (z down), with origin and direction of the x axis defined by the source."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ExternalPoseSample:
    """A pose from a source outside of the vehicle (motion capture, acoustic positioning)."""

    t_us: int
    pos_m: FloatArray
    """(3,) of the tracked point, in ``frame``."""
    yaw_rad: float
    covariance: FloatArray | None
    """(4, 4) of position and yaw, None = unknown."""
    frame: ExternalFrame = ExternalFrame.NED
    reset_counter: int = 0
    """Changes when the source's pose has jumped."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PowerSample:
    """Voltage and current at the battery terminals, and energy used."""

    t_us: int
    voltage_v: float
    current_a: float
    energy_used_j: float
    remaining: float
    """0..1"""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LeakSample:
    """State of a leak probe inside the hull."""

    t_us: int
    wet: bool


MAX_VOLTAGE_V, MAX_CURRENT_A, MAX_ENERGY_J = 1e3, 1e4, 1e12
"""Readings beyond these are a wiring fault."""


def plausible(power: PowerSample) -> bool:
    """Whether the values are physically possible for a battery."""
    return (
        0.0 <= power.voltage_v <= MAX_VOLTAGE_V
        and abs(power.current_a) <= MAX_CURRENT_A
        and abs(power.energy_used_j) <= MAX_ENERGY_J
        and 0.0 <= power.remaining <= 1.0
    )


DEEPEST_M, HIGHEST_M = 12_000.0, -10.0
"""Outside of these no vehicle has ever been."""
MAX_SPEED_M_S = 20.0


def possible_depth(depth_m: float) -> bool:
    """Whether a pressure sensor can show this; NaN it cannot."""
    return HIGHEST_M <= depth_m <= DEEPEST_M


def possible_velocity(vel_frd_m_s: FloatArray) -> bool:
    """Whether a DVL can show this (3,); NaN it cannot."""
    return bool((abs(vel_frd_m_s) <= MAX_SPEED_M_S).all())


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class HullSample:
    """Pressure and temperature of the air inside the hull."""

    t_us: int
    pressure_pa: float | None
    """Absolute, None = not measured."""
    temperature_c: float | None
    """None = not measured."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class GpsSample:
    """Three-dimensional fix of a satellite receiver, of its antenna. There is none under water."""

    t_us: int
    lat_deg: float
    lon_deg: float
    alt_m: float
    """Above mean sea level."""
    sigma_m: float
    """Standard deviation of the horizontal position, each axis, as the receiver says."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PlanarFixSample:
    """A :class:`GpsSample` in the local frame, made by the service, which knows its origin."""

    t_us: int
    pos_ned_m: FloatArray
    """(2,) north, east of the antenna."""
    sigma_m: float


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class CameraTiltSample:
    """Angle of the tilt that carries a camera, by the pulse at its servo: on its way it is elsewhere."""

    t_us: int
    angle_rad: float
    """Against the body, upwards positive."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PilotSample:
    """Input from the pilot's sticks was received by the flight controller or a receiver."""

    t_us: int


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ObstacleTrack:
    """A detected obstacle as a vertical cylinder."""

    t_us: int
    track_id: int
    """Identifies the obstacle."""
    pos_ned_m: FloatArray
    """(2,) north, east of its axis."""
    vel_ned_m_s: FloatArray
    """(2,) over ground; zero for one that stands."""
    radius_m: float


Sample: TypeAlias = (
    AhrsSample
    | ImuSample
    | MarkerSighting
    | PoseSample
    | LaserSample
    | AltimeterSample
    | DepthSample
    | VelocitySample
    | ExternalPoseSample
    | PowerSample
    | LeakSample
    | HullSample
    | GpsSample
    | PlanarFixSample
    | CameraTiltSample
    | PilotSample
    | ObstacleTrack
)
