"""The vehicle file: geometry, coefficients and sensor mounting of one vehicle, read from TOML and validated.

Vehicles ship in ``autopilot/data/vehicles``; every value there has its origin in ``[sources]``.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Annotated, Literal

import msgspec
import numpy as np

from autopilot.core.control_allocator import lacking_thrust
from autopilot.core.errors import ConfigError
from autopilot.core.flat_port import FlatPort
from autopilot.core.lens import BrownLens
from autopilot.core.model4 import Model4
from autopilot.core.names import unknown
from autopilot.core.payload import MAX_PAYLOAD
from autopilot.core.thrusters import (
    MAX_THRUSTERS,
    MIN_THRUSTERS,
    Thruster,
    ThrusterDrive,
    ThrusterTable,
    allocation,
    thrusters_of,
)
from autopilot.core.toml_table import (
    Angles3,
    Delay,
    NonNegative,
    NonNegative3,
    NonNegative4,
    Place3,
    Positive,
    Positive3,
    Positive4,
    Rate,
    Sigma,
    Sigma3,
    Table,
    Vec2,
    Vec3,
    convert,
    read_toml,
)

Radius = Annotated[float, msgspec.Meta(gt=0.0, le=10.0)]
"""Metres of a small vehicle; millimetres are beyond."""


class Body(Table, frozen=True, kw_only=True):
    """Rigid body and hydrodynamics in 6 DoF, for the simulated plant only. Drag positive."""

    mass_kg: Positive
    weight_n: Positive
    buoyancy_excess_n: float
    inertia_kg_m2: Positive3
    center_of_buoyancy_frd_m: Place3
    added_mass_kg: NonNegative3
    added_inertia_kg_m2: NonNegative3
    linear_drag_n_s_m: NonNegative3
    angular_linear_drag_n_m_s: NonNegative3
    quadratic_drag_n_s2_m2: NonNegative3
    angular_quadratic_drag_n_m_s2: NonNegative3
    thruster_offset_frd_m: dict[str, Place3] = msgspec.field(default_factory=dict)
    """Name of a thruster -> how far from the place told it really sits, which the autopilot does not know."""


class Model4Table(Table, frozen=True, kw_only=True):
    """Coefficients of the controller's 4-DoF model (order surge, sway, heave, yaw). Its allocation comes from the
    thrusters: :meth:`Vehicle.to_model`."""

    mass_kg: Positive4
    """Water that it moves included."""
    dry_mass_kg: Positive
    """Of the vehicle alone: a change of the current takes along only what is added to it."""
    linear_drag: NonNegative4
    quadratic_drag: NonNegative4
    buoyancy_excess_n: float


class LevellingTable(Table, frozen=True, kw_only=True):
    """Roll and pitch held level by the thrusters, where these can push them."""

    inertia_kg_m2: tuple[Positive, Positive]
    """About roll and pitch as the autopilot is told, water that turns with the hull included."""
    natural_rad_s: Annotated[float, msgspec.Meta(gt=0.0, le=10.0)] = 2.0
    """How quickly it levels; a third of what the thrusters' lag allows, 1 / (3 lag), is quick."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BatteryLimits:
    """What is known of a battery's voltage at its terminals."""

    min_v: float
    max_v: float
    """Readings beyond these are not this battery's."""
    low_v: float
    critical_v: float
    """Under load, for some seconds."""

    def can_be(self, voltage_v: float) -> bool:
        """Whether it can have this voltage."""
        return self.min_v <= voltage_v <= self.max_v


LOW, CRITICAL = 0.9, 0.85
"""Of the voltage of an empty battery: where the file gives no ``low_v``, ``critical_v``."""
LEAST, MOST = 0.5, 1.15
"""Of the voltage of an empty and of a full one: where the file gives no ``plausible_v``. A battery that is asked for
more than it can give sags to half of what it has."""


class Battery(Table, frozen=True, kw_only=True):
    """Supply voltage falls linearly with the energy used and with the current drawn."""

    open_circuit_v: Positive
    """Full, at rest."""
    empty_v: Positive
    """Empty, at rest."""
    capacity_j: Positive
    internal_resistance_ohm: Annotated[float, msgspec.Meta(ge=0.0, le=5.0)]
    plausible_v: tuple[NonNegative, Positive] | None = None
    """Readings below and above are refused; absent: :data:`LEAST`, :data:`MOST`."""
    low_v: Positive | None = None
    """Of a low battery, at its terminals under load; absent: :data:`LOW`."""
    critical_v: Positive | None = None
    """The same of a critical one; absent: :data:`CRITICAL`."""

    def __post_init__(self) -> None:
        limits = self.limits
        if not limits.min_v < limits.critical_v <= limits.low_v < self.open_circuit_v <= limits.max_v:
            found = f"{limits.min_v:g} < {limits.critical_v:g} <= {limits.low_v:g} < {self.open_circuit_v:g}"
            raise ValueError(
                "`battery`: give least of `plausible_v` < `critical_v` <= `low_v` < `open_circuit_v` <= most of"
                f" `plausible_v`, not {found} <= {limits.max_v:g}"
            )

    @property
    def limits(self) -> BatteryLimits:
        """As failsafes and monitors go by them."""
        least_v, most_v = self.plausible_v or (LEAST * self.empty_v, MOST * self.open_circuit_v)
        return BatteryLimits(
            min_v=least_v,
            max_v=most_v,
            low_v=self.low_v or LOW * self.empty_v,
            critical_v=self.critical_v or CRITICAL * self.empty_v,
        )


class Tether(Table, frozen=True, kw_only=True):
    """Quasi-static tether."""

    diameter_m: Annotated[float, msgspec.Meta(ge=0.0, le=0.2)]
    drag_coefficient: NonNegative
    length_in_flow_m: NonNegative
    pull_n: NonNegative


FOCAL = 0.1, 20.0
"""Of the picture's width and height: fields of view of 157 to 3 degrees."""
FOLD_PX = 1.0
"""A pixel that does not come back to itself within this is one of several rays, or of none."""
FOLD_RIM = 0.1
"""Share of the picture at each side that may fold: polynomials do so where no calibration had corners."""
LEAST_BASE_M = 0.005
"""Of a laser beside the camera: nearer its dot stays where it is at any range."""
RULER_SIGMA_M = 0.005
HAND_SIGMA_RAD = 0.0175
FOCAL_SIGMA, DISTORTION_SIGMA = 0.01, 0.1
STAMP_SIGMA_S = 0.01
LOG_SCALE_SIGMA, LOG_BIAS_SIGMA_M_S = 0.005, 0.002
"""Of a camera that nobody has calibrated: its place by a ruler, its turn by eye (1 deg), its lens as that of another
one of the same kind, its stamps to a third of a picture at 30 Hz. A Doppler log has its usual specification. Smaller
ones are written by ``autopilot calibrate``."""


class Camera(Table, frozen=True, kw_only=True):
    """Down-looking camera. Image x = starboard, image y = aft."""

    width_px: Annotated[int, msgspec.Meta(gt=0)]
    height_px: Annotated[int, msgspec.Meta(gt=0)]
    rate_hz: Rate
    focal_px: tuple[Positive, Positive]
    center_px: Vec2
    distortion: tuple[float, float, float, float, float]
    """k1 k2 p1 p2 k3 (OpenCV); of a fisheye k1 k2 k3 k4 and 0."""
    position_frd_m: Place3
    latency_s: Delay
    """Exposure to the arrival of the detection."""
    time_offset_s: Annotated[float, msgspec.Meta(ge=-10.0, le=10.0)] = 0.0
    """Added to the times that pictures come with: negative when these are too late."""
    time_offset_sigma_s: Sigma = STAMP_SIGMA_S
    """Standard deviation of that: positions are off by so much times the velocity."""
    focal_sigma: Sigma = FOCAL_SIGMA
    """Standard deviation of the focal length, as a share of it: heights are off by that share."""
    distortion_sigma: Sigma = DISTORTION_SIGMA
    """The same of the distortion. A level picture shows both together only."""
    mounting_rpy_rad: Angles3 = (0.0, 0.0, 0.0)
    """How the camera is turned from looking straight down: roll, pitch, yaw about the body's axes."""
    position_sigma_m: Sigma3 = (RULER_SIGMA_M,) * 3
    mounting_sigma_rad: Sigma3 = (HAND_SIGMA_RAD,) * 3
    """Standard deviations of place and turn: positions and headings are off by them."""
    model: Literal["pinhole", "fisheye", "flat_port"] = "pinhole"
    """What focal length, centre and distortion belong to: a calibration in water, or with "flat_port" one in air."""
    port: FlatPort | None = None
    """``[camera.port]``, needed by the model "flat_port"."""

    def __post_init__(self) -> None:
        if (self.model == "flat_port") != (self.port is not None):
            raise ValueError(f'`model` = "{self.model}": "flat_port" and the table `port` go together')
        if self.model == "fisheye" and self.distortion[4] != 0.0:
            raise ValueError(f"`distortion[4]` = {self.distortion[4]:g} must be 0 for a fisheye (k1 k2 k3 k4 and 0)")
        size = f"{self.width_px} x {self.height_px} pixels"
        for key, given, least, most in (("center_px", self.center_px, 0.0, 1.0), ("focal_px", self.focal_px, *FOCAL)):
            for i, side_px in enumerate((self.width_px, self.height_px)):
                if not least * side_px <= given[i] <= most * side_px:
                    raise ValueError(
                        f"`{key}[{i}]` = {given[i]:g} does not fit pictures of {size}; use {least * side_px:g} to "
                        f"{most * side_px:g}: right, then down, calibrated with pictures of that size"
                    )
        if self.model != "fisheye" and not self._lens_is_unique():
            raise ValueError(
                f"`distortion` = {list(self.distortion)} folds the picture over: its order is k1 k2 p1 p2 k3; calibrate"
                ' with corners all over the picture, or give `model` = "fisheye" with k1 k2 k3 k4 and 0'
            )

    def _lens_is_unique(self) -> bool:
        """Whether each pixel within the rim is of one ray, which the way back finds."""
        lens, share = BrownLens(self.distortion), np.linspace(FOLD_RIM, 1.0 - FOLD_RIM, 9)
        pixels = np.stack(np.meshgrid(share, share), axis=-1) * (self.width_px, self.height_px)
        bent = (pixels - self.center_px) / self.focal_px
        with np.errstate(all="ignore"):
            back = lens.bend(lens.unbend(bent)) - bent
        return bool(np.all(np.abs(back) * self.focal_px < FOLD_PX))


def _goes_down(direction_frd: Vec3) -> None:
    """ValueError if it does not."""
    x, y, z = direction_frd
    if not z > abs(x) + abs(y):
        raise ValueError(f"`direction_frd` = [{x:g}, {y:g}, {z:g}] does not go down; its third number is largest")


class Laser(Table, frozen=True, kw_only=True):
    """Laser pointer beside the camera."""

    position_frd_m: Place3
    direction_frd: Vec3 = (0.0, 0.0, 1.0)
    """Where the beam goes, of any length; straight down by default."""
    direction_sigma_rad: Sigma = HAND_SIGMA_RAD
    """Standard deviation of its direction against the camera: ranges are off by range^2 / offset times that."""

    def __post_init__(self) -> None:
        _goes_down(self.direction_frd)


class SensorMount(Table, frozen=True, kw_only=True):
    """Where a sensor sits, and its clock."""

    position_frd_m: Place3 = (0.0, 0.0, 0.0)
    time_offset_s: Annotated[float, msgspec.Meta(ge=-10.0, le=10.0)] = 0.0
    """Added to the times of samples: negative when these are too late."""


class Ahrs(SensorMount, frozen=True, kw_only=True):
    """Attitude and heading reference system."""

    position_frd_m: Place3
    rate_hz: Rate
    latency_s: Delay


class DepthMount(SensorMount, frozen=True, kw_only=True):
    """Pressure sensor."""

    rate_hz: Rate = 10.0
    latency_s: Delay = 0.02


class DvlMount(SensorMount, frozen=True, kw_only=True):
    """Doppler velocity log; its axes are the body's."""

    rate_hz: Rate = 8.0
    latency_s: Delay = 0.1
    heading_sigma_rad: Sigma = HAND_SIGMA_RAD
    """Standard deviation of its heading, roll and pitch against the body's,"""
    scale_sigma: Sigma = LOG_SCALE_SIGMA
    """of its velocities, as a share of them (speed of sound, beam angles),"""
    bias_sigma_m_s: Sigma = LOG_BIAS_SIGMA_M_S
    """and of a constant error of each axis."""


class AltimeterMount(SensorMount, frozen=True, kw_only=True):
    """Sonar altimeter that looks at the floor."""

    direction_frd: Vec3 = (0.0, 0.0, 1.0)
    """Axis of its beam, of any length; straight down by default."""
    beam_width_rad: Annotated[float, msgspec.Meta(ge=0.0, le=1.6)] = 0.436
    """From edge to edge: 25 deg of a Ping Sonar."""
    rate_hz: Rate = 10.0
    latency_s: Delay = 0.05

    def __post_init__(self) -> None:
        _goes_down(self.direction_frd)


class GpsMount(SensorMount, frozen=True, kw_only=True):
    """Antenna of a satellite receiver, above the water when the vehicle has surfaced."""

    position_frd_m: Place3 = (0.0, 0.0, -0.15)
    rate_hz: Rate = 5.0
    latency_s: Delay = 0.2


class ExternalMount(SensorMount, frozen=True, kw_only=True):
    """What an outside positioning system tracks."""


class PayloadTable(Table, frozen=True, kw_only=True):
    """``[[payload]]``: something that is carried and moved by pulses, beside the thrusters."""

    name: str
    kind: Literal["servo", "gripper", "relay", "light", "tilt"]
    channel: Annotated[int, msgspec.Meta(ge=1, le=32)] | None = None
    """Servo output that it is on, counted as the thrusters' channels."""
    relay: Annotated[int, msgspec.Meta(ge=0, le=15)] | None = None
    """Number of a relay, from 0, as clients know it; without a ``channel`` that of the flight controller below."""
    min_us: Annotated[int, msgspec.Meta(ge=500, le=2500)] = 1100
    """Shortest pulse: dark, off, closed."""
    max_us: Annotated[int, msgspec.Meta(ge=500, le=2500)] = 1900
    """Longest pulse: bright, on, open."""
    rest_us: Annotated[int, msgspec.Meta(ge=500, le=2500)] | None = None
    """At the start; absent = dark, off, open, a servo in its middle, a tilt as it is."""
    min_deg: Annotated[float, msgspec.Meta(ge=-180.0, le=180.0)] = -45.0
    """Of a camera's tilt: angle at ``min_us`` against the body, upwards positive."""
    max_deg: Annotated[float, msgspec.Meta(ge=-180.0, le=180.0)] = 45.0
    """At ``max_us``."""
    camera_deg: Annotated[float, msgspec.Meta(ge=-180.0, le=180.0)] | None = None
    """Where ``[camera]`` was calibrated, if it tilts with this; absent = it does not."""

    def __post_init__(self) -> None:
        if self.min_us >= self.max_us:
            raise ValueError(f"`min_us` = {self.min_us} has to be below `max_us` = {self.max_us}")
        if self.rest_us is not None and not self.min_us <= self.rest_us <= self.max_us:
            raise ValueError(f"`rest_us` = {self.rest_us} is not within {self.min_us} to {self.max_us}")
        if (self.kind == "relay") != (self.relay is not None):
            raise ValueError('`relay` and `kind` = "relay" go together')
        if self.kind != "relay" and self.channel is None:
            raise ValueError(f"`channel` is missing: which output is {self.name!r} on")
        if self.min_deg == self.max_deg:
            raise ValueError("`min_deg` and `max_deg` are equal: an angle at each end is needed")
        if self.camera_deg is not None and (self.kind != "tilt" or not self.reaches(math.radians(self.camera_deg))):
            raise ValueError(f"`camera_deg` = {self.camera_deg:g} is no angle of a `tilt` with these ends")

    def reaches(self, angle_rad: float) -> bool:
        """Whether a tilt has this angle."""
        low_deg, high_deg = sorted((self.min_deg, self.max_deg))
        return low_deg - 1e-6 <= math.degrees(angle_rad) <= high_deg + 1e-6

    def angle_rad(self, pulse_us: float) -> float:
        """Angle of a tilt at a pulse, upwards positive."""
        level = (pulse_us - self.min_us) / (self.max_us - self.min_us)
        return math.radians(self.min_deg + level * (self.max_deg - self.min_deg))

    def tilt_us(self, angle_rad: float) -> int:
        """Pulse of a tilt for an angle that it reaches."""
        level = (math.degrees(angle_rad) - self.min_deg) / (self.max_deg - self.min_deg)
        return round(self.min_us + level * (self.max_us - self.min_us))

    @property
    def start_us(self) -> int:
        """The pulse at the start."""
        if self.rest_us is not None:
            return self.rest_us
        middle_us = (self.min_us + self.max_us) // 2
        if self.camera_deg is not None:
            return self.tilt_us(math.radians(self.camera_deg))
        return {"servo": middle_us, "tilt": middle_us, "gripper": self.max_us}.get(self.kind, self.min_us)


class Vehicle(Table, frozen=True, kw_only=True):
    """One vehicle file."""

    name: str
    description: str
    hotel_power_w: NonNegative
    radius_m: Radius
    """Ball round the centre of gravity that covers the hull."""
    hull_radius_m: Radius = 0.27
    """What touches things in the simulator: upright cylinder round the centre of gravity."""
    hull_half_height_m: Radius = 0.13
    body: Body
    model4: Model4Table
    thruster_tables: Annotated[
        tuple[ThrusterTable, ...], msgspec.Meta(min_length=MIN_THRUSTERS, max_length=MAX_THRUSTERS)
    ] = msgspec.field(name="thruster")
    """As in the file; use :attr:`thrusters`."""
    drive: ThrusterDrive
    """Of every thruster without one of its own."""
    levelling: LevellingTable | None = None
    """Absent: roll and pitch are left to the buoyancy."""
    battery: Battery
    tether: Tether
    camera: Camera | None = None
    """Absent: it finds its position otherwise."""
    laser: Laser | None = None
    """Absent: the altitude comes from markers, depth sensor or DVL."""
    ahrs: Ahrs
    depth_sensor: DepthMount = DepthMount()
    dvl: DvlMount = DvlMount()
    altimeter: AltimeterMount = AltimeterMount()
    gps: GpsMount = GpsMount()
    external_pose: ExternalMount = ExternalMount()
    payload: Annotated[tuple[PayloadTable, ...], msgspec.Meta(max_length=MAX_PAYLOAD)] = ()
    """What it carries beside."""
    sources: dict[str, str]

    def __post_init__(self) -> None:
        thrusters = self.thrusters
        _once("name", [thruster.name for thruster in thrusters], thrusters)
        _once("channel", [thruster.channel for thruster in thrusters], thrusters)
        names = {thruster.name for thruster in thrusters}
        for name in self.body.thruster_offset_frd_m:
            if name not in names:
                raise ValueError(f"`body.thruster_offset_frd_m` names {name!r}, which is no `thruster`")
        if self.camera is not None and self.laser is not None:
            beam = np.array(self.laser.direction_frd)
            apart_m = np.subtract(self.laser.position_frd_m, self.camera.position_frd_m)
            base_m = float(np.linalg.norm(np.cross(apart_m, beam)) / np.linalg.norm(beam))
            if base_m < LEAST_BASE_M:
                raise ValueError(
                    f"`laser.position_frd_m` = {list(self.laser.position_frd_m)} is {base_m:g} m beside the camera: its"
                    f" dot does not show the range; give {LEAST_BASE_M:g} m at least, or leave [laser] out"
                )
        self._check_payload()

    def _check_payload(self) -> None:
        """ValueError for two that share a name, a channel or a relay, and for a channel of a thruster."""
        taken: dict[tuple[str, object], str] = {
            ("channel", thruster.channel): f"thruster {thruster.name!r}" for thruster in self.thrusters
        }
        for index, output in enumerate(self.payload):
            for key in ("name", "channel", "relay"):
                value = getattr(output, key)
                if value is None:
                    continue
                before = taken.get((key, value))
                if before is not None:
                    raise ValueError(f"`payload[{index}]` ({output.name}): `{key}` = {value!r} is that of {before}")
                taken[key, value] = f"`payload[{index}]`"
        if sum(output.kind == "tilt" for output in self.payload) > 1:
            raise ValueError('`payload` has more than one `kind` = "tilt": one camera is tilted')

    @property
    def tilt(self) -> PayloadTable | None:
        """What tilts a camera, None without it."""
        return next((output for output in self.payload if output.kind == "tilt"), None)

    @property
    def thrusters(self) -> tuple[Thruster, ...]:
        """All thrusters with their drives and limits, in the file's order."""
        return thrusters_of(self.thruster_tables, self.drive)

    @property
    def eye(self) -> Camera:
        """The camera. ConfigError without one."""
        if self.camera is None:
            raise ConfigError(f"vehicle {self.name!r} has no [camera]; add one, or use --sensors pose")
        return self.camera

    def to_model(self) -> Model4:
        """What controller and estimator believe of it, allocation (4, N) included."""
        table = self.model4
        return Model4(
            mass_kg=table.mass_kg,
            linear_drag=table.linear_drag,
            quadratic_drag=table.quadratic_drag,
            buoyancy_excess_n=table.buoyancy_excess_n,
            allocation=allocation(self.thrusters),
        )


def _once(key: str, values: Sequence[object], thrusters: Sequence[Thruster]) -> None:
    """ValueError if two thrusters share a value."""
    for index, value in enumerate(values):
        first = values.index(value)
        if first != index:
            pair = f"`thruster[{first}]` and `thruster[{index}]`"
            named = "" if key == "name" else f" ({thrusters[first].name}, {thrusters[index].name})"
            raise ValueError(f"{pair}{named}: both have `{key}` = {value!r}; each needs one of its own")


def vehicle_names() -> list[str]:
    """Names of the vehicles that ship with the autopilot."""
    folder = resources.files("autopilot") / "data" / "vehicles"
    return sorted(entry.name.removesuffix(".toml") for entry in folder.iterdir() if entry.name.endswith(".toml"))


def load_vehicle(name_or_path: str) -> Vehicle:
    """A shipped vehicle by name, or a vehicle file by path. ConfigError if unknown or wrong."""
    if name_or_path in vehicle_names():
        path = Path(str(resources.files("autopilot") / "data" / "vehicles" / f"{name_or_path}.toml"))
    else:
        path = Path(name_or_path)
        if path.suffix != ".toml":
            raise unknown("vehicle", name_or_path, vehicle_names(), more=" or a .toml file")
    return checked(convert(read_toml(path), Vehicle, str(path)), str(path))


def checked(vehicle: Vehicle, origin: str) -> Vehicle:
    """The vehicle, if it can be flown. ConfigError, beginning with ``origin``, names the axis that lacks thrust."""
    lack = lacking_thrust(vehicle.to_model(), np.array([thruster.limit_n for thruster in vehicle.thrusters]))
    if lack:
        raise ConfigError(f"{origin}: {lack}")
    return vehicle
