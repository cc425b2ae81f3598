"""``[devices]`` of a vehicle configuration: driver and options of every device.

One table per kind (:data:`.drivers.registry.DEVICE_KINDS`). ``driver`` names the back end, every other key is one of
its options: fields of the class's ``Options``. A flight controller supplies measurements and drives the thrusters, and
excludes ``thrusters``; a separate sensor of the same kind replaces the flight controller's.
"""

from collections.abc import Mapping
from typing import Any

import msgspec

from autopilot.core.errors import ConfigError
from autopilot.core.toml_table import Table
from autopilot.core.vehicle import Vehicle
from autopilot.drivers.registry import DEVICE_KINDS, backend_names, load_backend

FLIGHT_CONTROLLER, THRUSTERS, CAMERA = "flight_controller", "thrusters", "camera"

DeviceTable = dict[str, Any]
"""``driver`` and the back end's options, as read."""


class DeviceSetup(msgspec.Struct, frozen=True, kw_only=True):
    """Validated configuration of one device: class and arguments."""

    kind: str
    driver: str
    options: Any
    """Of the back end's class ``Options``."""

    def make(self, vehicle: Vehicle) -> Any:
        """The device, not opened yet: sensor, thruster output or flight controller (:mod:`.drivers.protocols`)."""
        return load_backend(self.kind, self.driver)(vehicle, self.options)


def read_devices(tables: Mapping[str, DeviceTable], origin: str) -> dict[str, DeviceSetup]:
    """Configured devices by kind. ConfigError begins with ``origin`` and names key, value and remedy."""
    devices = {kind: _device(kind, table, origin) for kind, table in tables.items()}
    if THRUSTERS in devices and FLIGHT_CONTROLLER in devices:
        raise ConfigError(
            f"{origin}: `$.devices` has both `{THRUSTERS}` and `{FLIGHT_CONTROLLER}`, two that would drive the same"
            " thrusters; remove one"
        )
    if THRUSTERS not in devices and FLIGHT_CONTROLLER not in devices:
        raise ConfigError(
            f"{origin}: `$.devices` has neither `{THRUSTERS}` nor `{FLIGHT_CONTROLLER}`: nothing would drive the"
            " thrusters; add one"
        )
    if "ahrs" not in devices and FLIGHT_CONTROLLER not in devices:
        raise ConfigError(f"{origin}: `$.devices` has no `ahrs`: nothing would know which way is up; add one")
    return devices


def _device(kind: str, table: DeviceTable, origin: str) -> DeviceSetup:
    place = f"$.devices.{kind}"
    if kind not in DEVICE_KINDS:
        raise ConfigError(f"{origin}: `{place}`: no such kind of device; use {', '.join(DEVICE_KINDS)}")
    driver = table.get("driver")
    if not isinstance(driver, str):
        names = ", ".join(backend_names(kind))
        raise ConfigError(f'{origin}: `{place}` names no `driver`; write driver = "NAME" with one of {names}')
    try:
        back_end = load_backend(kind, driver)
    except ConfigError as error:
        raise ConfigError(f"{origin}: `{place}.driver`: {error}") from error
    options: type[Table] = back_end.Options
    values = {key: value for key, value in table.items() if key != "driver"}
    try:
        return DeviceSetup(kind=kind, driver=driver, options=msgspec.convert(values, options, strict=True))
    except msgspec.ValidationError as error:
        text = str(error).replace("`$", f"`{place}")
        where = "" if f"`{place}" in text else f" - at `{place}`"
        known = ", ".join(field.encode_name for field in msgspec.structs.fields(options))
        raise ConfigError(f"{origin}: {text}{where}; {driver} takes {known or 'no options'}") from error
