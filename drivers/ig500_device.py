"""The IG-500A as a device of ``[devices]``: the driver on the serial line that the configuration names."""

from typing import Annotated

import msgspec

from autopilot.core.errors import DriverError
from autopilot.core.messages import Severity
from autopilot.core.samples import AhrsSample, ImuSample
from autopilot.core.toml_table import Table
from autopilot.core.vehicle import Vehicle
from autopilot.drivers.base import Closing
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


class Ig500Device(Closing):
    """A :class:`autopilot.drivers.protocols.Sensor`."""

    Options = Ig500Options

    def __init__(self, vehicle: Vehicle, options: Ig500Options) -> None:
        self._port = SerialPort(options.port, options.baud)
        self._driver = Ig500(self._port, vehicle.ahrs.latency_s, options.divider, attitude=options.attitude)

    @property
    def driver(self) -> Ig500:
        return self._driver

    @property
    def bad_frames(self) -> int:
        return self._driver.bad_frames

    @property
    def bad_samples(self) -> int:
        return self._driver.bad_samples

    def take_notices(self) -> list[tuple[Severity, str]]:
        return self._driver.take_notices()

    def open(self) -> None:
        self._driver.open()

    def close(self) -> None:
        self._driver.close()

    def poll(self, t_us: int) -> list[AhrsSample | ImuSample]:
        samples = self._driver.poll(t_us)
        if self._port.lost:
            raise DriverError("serial line gone, check the cable")
        return samples
