"""Configuration of a real vehicle (``autopilot run --config``): vehicle file, site, and devices. TOML.

Wiring and site are set here, tuning and limits are parameters; ``[parameters]`` overrides their defaults. Paths are
relative to the file. Unknown keys are errors that name the key.
"""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec

from autopilot.core.errors import ConfigError
from autopilot.core.names import unknown
from autopilot.core.origin_params import set_origin_deg
from autopilot.core.params import ParamSet
from autopilot.core.toml_table import NonNegative, Positive, Table, convert, read_toml
from autopilot.core.vehicle import Vehicle, load_vehicle, vehicle_names
from autopilot.drivers.devices import CAMERA, FLIGHT_CONTROLLER, DeviceSetup, read_devices
from autopilot.drivers.links import parse_connection

Latitude = Annotated[float, msgspec.Meta(ge=-90.0, le=90.0)]
Longitude = Annotated[float, msgspec.Meta(ge=-180.0, le=180.0)]


class SiteTable(Table, frozen=True, kw_only=True):
    """``[place]``: site of operation and its known properties."""

    name: str = "unnamed place"
    """For logs."""
    origin_lat_deg: Latitude | None = None
    origin_lon_deg: Longitude | None = None
    """Of the local frame; absent = as saved, or ORIGIN_LAT and ORIGIN_LON."""
    origin_alt_m: float | None = None
    markers: str | None = None
    """Marker map (TOML) of the floor that the camera sees."""
    floor_depth_m: Positive | None = None
    """Depth of the floor that the laser points at."""
    currents: Literal["estimate", "none", "uniform"] = "estimate"
    basin: Literal["closed", "open", "unknown"] = "unknown"
    """Whether what flows comes back within the fence."""

    def __post_init__(self) -> None:
        if (self.origin_lat_deg is None) != (self.origin_lon_deg is None):
            raise ValueError("`origin_lat_deg` and `origin_lon_deg` go together; give both or neither")


class ServiceTable(Table, frozen=True, kw_only=True):
    """``[service]``: settings that the command line and the environment have as well, and may overrule."""

    connect: tuple[str, ...] | None = None
    profile: Literal["generic", "px4", "ardusub"] | None = None
    controller: str | None = None
    estimator: str | None = None
    log_dir: str | None = None
    log_quota_mb: NonNegative | None = None
    log_camera_hz: NonNegative | None = None
    state_dir: str | None = None

    def __post_init__(self) -> None:
        if self.connect == ():
            raise ValueError("`connect` is empty: nobody would reach the vehicle; name a link, or remove the key")

    def given(self, folder: Path) -> dict[str, Any]:
        """Keys set in the file, by name; folders relative to ``folder``."""
        values = {name: value for name, value in msgspec.structs.asdict(self).items() if value is not None}
        for name in ("log_dir", "state_dir"):
            if name in values:
                values[name] = str(folder / Path(values[name]).expanduser())
        return values


class ConfigFile(Table, frozen=True, kw_only=True):
    vehicle: str
    """A shipped vehicle's name, or a vehicle file."""
    place: SiteTable = SiteTable()
    service: ServiceTable = ServiceTable()
    parameters: dict[str, float] = msgspec.field(default_factory=dict)
    devices: dict[str, dict[str, Any]]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class VehicleConfig:
    path: Path
    file: ConfigFile
    vehicle: Vehicle
    devices: Mapping[str, DeviceSetup]
    """By kind."""
    markers: Path | None

    @property
    def has_camera(self) -> bool:
        return CAMERA in self.devices


def config_names() -> list[str]:
    """The configurations that ship with the autopilot."""
    folder = resources.files("autopilot") / "data" / "configs"
    return sorted(entry.name.removesuffix(".toml") for entry in folder.iterdir() if entry.name.endswith(".toml"))


def load_config(name_or_path: str) -> VehicleConfig:
    """A configuration by path, or a shipped one by name. ConfigError names file, key, value and remedy."""
    path = Path(name_or_path)
    shipped = name_or_path.removesuffix(".toml")
    if not path.exists() and shipped in config_names():
        path = Path(str(resources.files("autopilot") / "data" / "configs" / f"{shipped}.toml"))
    elif not path.exists():
        raise unknown("configuration", name_or_path, config_names(), more=" or a file that is there")
    file: ConfigFile = convert(read_toml(path), ConfigFile, str(path))
    vehicle = load_vehicle(file.vehicle if file.vehicle in vehicle_names() else str(path.parent / file.vehicle))
    config = VehicleConfig(
        path=path,
        file=file,
        vehicle=vehicle,
        devices=read_devices(file.devices, str(path)),
        markers=None if file.place.markers is None else path.parent / file.place.markers,
    )
    _check(config)
    return config


def _check(config: VehicleConfig) -> None:
    """Checks between tables. ConfigError."""
    origin = str(config.path)
    apply_parameters(config, ParamSet())
    if config.has_camera and config.vehicle.camera is None:
        raise ConfigError(
            f"{origin}: `$.devices.camera`: vehicle {config.vehicle.name!r} has no [camera]; add one to the vehicle"
            " file, or remove the device"
        )
    if config.has_camera and config.markers is None:
        raise ConfigError(
            f"{origin}: `$.devices.camera` without `$.place.markers`: name the marker map of the floor, or remove the"
            " camera"
        )
    if config.markers is not None and not config.has_camera:
        raise ConfigError(
            f"{origin}: `$.place.markers` = {config.file.place.markers!r} without `$.devices.camera`: nothing would see"
            " them; add a camera, or remove the map"
        )
    for kind, setup in config.devices.items():
        try:
            setup.make(config.vehicle)
        except ConfigError as error:
            raise ConfigError(f"{origin}: `$.devices.{kind}`: {error}") from error
    _check_ports(config)


def _check_ports(config: VehicleConfig) -> None:
    """Two on one serial line would take each other's bytes, and two that listen on one UDP port would only be found
    when the second is opened. ConfigError.
    """
    taken: dict[str, str] = {}
    for kind, setup in config.devices.items():
        port = getattr(setup.options, "port", None)
        other = taken.setdefault(os.path.realpath(port), kind) if isinstance(port, str) else kind
        if other != kind:
            raise ConfigError(
                f"{config.path}: `$.devices.{other}.port` and `$.devices.{kind}.port` = {port!r} are one line; give"
                " each its own"
            )
    below = config.devices.get(FLIGHT_CONTROLLER)
    theirs = None if below is None else getattr(below.options, "connect", None)
    ours = config.file.service.connect or ()
    for text in ours if isinstance(theirs, str) else ():
        try:
            links = parse_connection(text), parse_connection(str(theirs))
        except ConfigError as error:
            raise ConfigError(f"{config.path}: `$.service.connect`: {error}") from error
        hosts = {link.address for link in links}
        meet = len(hosts) == 1 or "0.0.0.0" in hosts
        if {link.kind for link in links} == {"udpin"} and len({link.number for link in links}) == 1 and meet:
            raise ConfigError(
                f"{config.path}: `$.service.connect` and `$.devices.{FLIGHT_CONTROLLER}.connect` both listen on"
                f" UDP port {links[0].number}; give one of them another"
            )


def apply_parameters(config: VehicleConfig, params: ParamSet) -> None:
    """Origin, basin and ``[parameters]`` of the file as defaults. ConfigError names file and key."""
    place = config.file.place
    if place.basin == "closed":
        params.set("FENCE_REQUIRED", 1)
    values = {"ORIGIN_LAT": place.origin_lat_deg, "ORIGIN_LON": place.origin_lon_deg, "ORIGIN_ALT": place.origin_alt_m}
    for name, value in ({k: v for k, v in values.items() if v is not None} | config.file.parameters).items():
        try:
            if name in ("ORIGIN_LAT", "ORIGIN_LON"):
                set_origin_deg(params, name, value)
            else:
                params.set(name, value)
        except ConfigError as error:
            raise ConfigError(f"{config.path}: `$.parameters.{name}`: {error}") from error
