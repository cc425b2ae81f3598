"""The IG-500A as a device of ``[devices]``: the driver on the configured serial line."""

from typing import Annotated

import msgspec

from autopilot.core.toml_table import Table
from autopilot.core.vehicle import Vehicle
from autopilot.drivers.ig500 import Ig500
from autopilot.drivers.serial_port import SerialPort


class Ig500Options(Table, frozen=True, kw_only=True):
    """``[devices.ahrs]`` with ``driver = "ig500"``."""

    port: str
    """Serial device, e.g. /dev/ttyUSB0 (a name under /dev/serial/by-id stays the same when cables move)."""
    baud: Annotated[int, msgspec.Meta(gt=0)] = 115200
    divider: Annotated[int, msgspec.Meta(ge=1, le=255)] = 1
    """The device sends every n-th result of its filter."""
    attitude: bool = True
    """False: raw sensors only, the attitude is made on board."""


class Ig500Device(Ig500):
    """The driver on the line that the configuration names."""

    Options = Ig500Options

    def __init__(self, vehicle: Vehicle, options: Ig500Options) -> None:
        port = SerialPort(options.port, options.baud)
        super().__init__(port, vehicle.ahrs.latency_s, options.divider, attitude=options.attitude)
