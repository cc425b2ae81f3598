"""The vehicle file: geometry, coefficients and sensor mounting of one vehicle, read from TOML and validated.

Vehicles ship in ``autopilot/data/vehicles``; every value there has its origin in ``[sources]``.
"""

import math
import tomllib
from collections.abc import Iterator
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

import msgspec

from autopilot.core.errors import ConfigError
from autopilot.core.flat_port import FlatPort
from autopilot.core.model4 import Model4

Positive = Annotated[float, msgspec.Meta(gt=0.0)]
NonNegative = Annotated[float, msgspec.Meta(ge=0.0)]
Vec2: TypeAlias = tuple[float, float]
Vec3: TypeAlias = tuple[float, float, float]
Positive3: TypeAlias = tuple[Positive, Positive, Positive]
Positive4: TypeAlias = tuple[Positive, Positive, Positive, Positive]
NonNegative3: TypeAlias = tuple[NonNegative, NonNegative, NonNegative]
Row: TypeAlias = Annotated[tuple[float, ...], msgspec.Meta(min_length=3, max_length=8)]
NonNegative4: TypeAlias = tuple[NonNegative, NonNegative, NonNegative, NonNegative]


class _Table(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A TOML table: immutable, unknown keys are errors."""


class Body(_Table, frozen=True, kw_only=True):
    """Rigid body and hydrodynamics in 6 DoF, for the simulated plant only. Drag positive."""

    mass_kg: Positive
    weight_n: Positive
    buoyancy_excess_n: float
    inertia_kg_m2: Positive3
    center_of_buoyancy_frd_m: Vec3
    added_mass_kg: NonNegative3
    added_inertia_kg_m2: NonNegative3
    linear_drag_n_s_m: NonNegative3
    angular_linear_drag_n_m_s: NonNegative3
    quadratic_drag_n_s2_m2: NonNegative3
    angular_quadratic_drag_n_m_s2: NonNegative3


class Model4Table(_Table, frozen=True, kw_only=True):
    """The controller's 4-DoF model (order surge, sway, heave, yaw)."""

    mass_kg: Positive4
    linear_drag: NonNegative4
    quadratic_drag: NonNegative4
    buoyancy_excess_n: float
    allocation: tuple[Row, Row, Row, Row]
    """Rows surge, sway, heave [N], yaw [N m]; one column per thruster, in the order of the file."""

    def to_model(self) -> Model4:
        """The same as the plain dataclass that the equations take."""
        return Model4(
            mass_kg=self.mass_kg,
            linear_drag=self.linear_drag,
            quadratic_drag=self.quadratic_drag,
            buoyancy_excess_n=self.buoyancy_excess_n,
            allocation=self.allocation,
        )


class Thruster(_Table, frozen=True, kw_only=True):
    """Where one thruster sits and where it pushes."""

    name: str
    position_frd_m: Vec3
    direction_frd: Vec3


class Drive(_Table, frozen=True, kw_only=True):
    """Thruster and amplifier: pulse -> duty -> voltage -> thrust F = c V |V|."""

    neutral_us: Annotated[int, msgspec.Meta(gt=0)]
    span_us: Annotated[int, msgspec.Meta(gt=0)]
    """Pulse difference between neutral and full duty."""
    deadband_duty: Annotated[float, msgspec.Meta(ge=0.0, lt=0.5)]
    forward_n_v2: Positive
    reverse_n_v2: Positive
    nominal_supply_v: Positive
    time_constant_s: Positive
    power_w_n15: Positive
    """Electrical power P = this * |F|^1.5."""
    limit_n: Positive
    """Bound on every thrust command."""
    command_timeout_s: Positive
    """Outputs go to neutral when no command came for so long."""


class Battery(_Table, frozen=True, kw_only=True):
    """Supply voltage falls linearly with the energy used and with the current drawn."""

    open_circuit_v: Positive
    empty_v: Positive
    capacity_j: Positive
    internal_resistance_ohm: NonNegative


class Tether(_Table, frozen=True, kw_only=True):
    """Quasi-static tether."""

    diameter_m: NonNegative
    drag_coefficient: NonNegative
    length_in_flow_m: NonNegative
    pull_n: NonNegative


class Port(_Table, frozen=True, kw_only=True):
    """A flat pane before the camera's lens (:class:`autopilot.core.flat_port.FlatPort`)."""

    distance_m: NonNegative
    """From the lens's centre of projection to the pane."""
    thickness_m: NonNegative = 0.0
    glass_index: Annotated[float, msgspec.Meta(ge=1.0, le=2.5)] = 1.49
    """Of refraction, relative to air; default acrylic."""
    water_index: Annotated[float, msgspec.Meta(ge=1.0, le=2.0)] = 1.333
    """Relative to air; default fresh water at 20 degC in green light."""

    def to_port(self) -> FlatPort:
        """The same as the plain dataclass that the equations take."""
        return FlatPort(
            distance_m=self.distance_m,
            thickness_m=self.thickness_m,
            glass_index=self.glass_index,
            water_index=self.water_index,
        )


class Camera(_Table, frozen=True, kw_only=True):
    """Down-looking camera. Image x = starboard, image y = aft."""

    width_px: Annotated[int, msgspec.Meta(gt=0)]
    height_px: Annotated[int, msgspec.Meta(gt=0)]
    rate_hz: Positive
    focal_px: tuple[Positive, Positive]
    center_px: Vec2
    distortion: tuple[float, float, float, float, float]
    """k1 k2 p1 p2 k3 (OpenCV); of a fisheye k1 k2 k3 k4 and 0."""
    position_frd_m: Vec3
    latency_s: NonNegative
    """Exposure to the arrival of the detection."""
    time_offset_s: float = 0.0
    """Added to the times that pictures come with: negative when these are too late."""
    mounting_rpy_rad: Vec3 = (0.0, 0.0, 0.0)
    """How the camera is turned from looking straight down: roll, pitch, yaw about the body's axes."""
    model: Literal["pinhole", "fisheye", "flat_port"] = "pinhole"
    """What focal length, centre and distortion belong to: a calibration in water, or with "flat_port" one in air."""
    port: Port | None = None
    """``[camera.port]``, needed by the model "flat_port"."""

    def __post_init__(self) -> None:
        if (self.model == "flat_port") != (self.port is not None):
            raise ValueError(f'`model` = "{self.model}": "flat_port" and the table `port` go together')
        if self.model == "fisheye" and self.distortion[4] != 0.0:
            raise ValueError(f"`distortion[4]` = {self.distortion[4]:g} must be 0 for a fisheye (k1 k2 k3 k4 and 0)")


class Laser(_Table, frozen=True, kw_only=True):
    """Laser pointer beside the camera."""

    position_frd_m: Vec3
    direction_frd: Vec3 = (0.0, 0.0, 1.0)
    """Where the beam goes, of any length; straight down by default."""

    def __post_init__(self) -> None:
        x, y, z = self.direction_frd
        if not z > abs(x) + abs(y):
            raise ValueError(f"`direction_frd` = [{x:g}, {y:g}, {z:g}] does not go down; its third number is largest")


class Ahrs(_Table, frozen=True, kw_only=True):
    """Attitude and heading reference system."""

    rate_hz: Positive
    latency_s: NonNegative
    position_frd_m: Vec3
    time_offset_s: float = 0.0
    """Added to the times of samples: negative when these are too late."""


class DepthMount(_Table, frozen=True, kw_only=True):
    """Pressure sensor."""

    position_frd_m: Vec3 = (0.0, 0.0, 0.0)
    rate_hz: Positive = 10.0
    latency_s: NonNegative = 0.02
    time_offset_s: float = 0.0
    """Added to the times of samples: negative when these are too late."""


class DvlMount(_Table, frozen=True, kw_only=True):
    """Doppler velocity log; its axes are the body's."""

    position_frd_m: Vec3 = (0.0, 0.0, 0.0)
    rate_hz: Positive = 8.0
    latency_s: NonNegative = 0.1
    time_offset_s: float = 0.0
    """Added to the times of samples: negative when these are too late."""


class ExternalMount(_Table, frozen=True, kw_only=True):
    """What an outside positioning system tracks."""

    position_frd_m: Vec3 = (0.0, 0.0, 0.0)
    time_offset_s: float = 0.0
    """Added to the times of poses: negative when these are too late."""


class Vehicle(_Table, frozen=True, kw_only=True):
    """One vehicle file."""

    name: str
    description: str
    hotel_power_w: NonNegative
    radius_m: Positive
    """Ball round the centre of gravity that covers the hull."""
    hull_radius_m: Positive = 0.27
    """What touches things in the simulator: upright cylinder round the centre of gravity."""
    hull_half_height_m: Positive = 0.13
    body: Body
    model4: Model4Table
    thruster: Annotated[list[Thruster], msgspec.Meta(min_length=1, max_length=8)]
    drive: Drive
    battery: Battery
    tether: Tether
    camera: Camera
    laser: Laser
    ahrs: Ahrs
    depth_sensor: DepthMount = DepthMount()
    dvl: DvlMount = DvlMount()
    external_pose: ExternalMount = ExternalMount()
    sources: dict[str, str]


def read_toml(path: Path) -> dict[str, Any]:
    """The tables of a TOML file; ConfigError names the file and the line when it is not one."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror}); check the name") from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: is not UTF-8 text; save it as UTF-8") from error
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{path}: is not valid TOML: {error}; correct it there") from error


def convert(tables: dict[str, Any], kind: type, origin: str) -> Any:
    """``tables`` as ``kind``; ConfigError names the path of the key, what is wrong with it, and the file."""
    for place, value in _leaves(tables, "$"):
        if isinstance(value, float) and not math.isfinite(value):
            raise ConfigError(f"{origin}: `{place}` = {value} is not a finite number; correct or remove that key")
    try:
        return msgspec.convert(tables, kind, strict=True)
    except msgspec.ValidationError as error:
        raise ConfigError(f"{origin}: {error}; correct or remove that key") from error


def _leaves(value: Any, place: str) -> Iterator[tuple[str, Any]]:
    """Every value of nested tables and arrays with the path of its key."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from _leaves(inner, f"{place}.{key}")
    elif isinstance(value, list):
        for index, inner in enumerate(value):
            yield from _leaves(inner, f"{place}[{index}]")
    else:
        yield place, value


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
            raise ConfigError(
                f"vehicle {name_or_path!r} is not known; use one of {', '.join(vehicle_names())} or a .toml file"
            )
    vehicle: Vehicle = convert(read_toml(path), Vehicle, str(path))
    return vehicle
