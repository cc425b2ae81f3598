"""TI INA219 on I2C: battery voltage, and current through a shunt."""

from typing import Annotated

import msgspec

from autopilot.core.errors import DriverError
from autopilot.core.samples import PowerSample
from autopilot.core.toml_table import Positive, Table
from autopilot.core.vehicle import Vehicle
from autopilot.drivers.battery_meter import BatteryMonitor
from autopilot.drivers.i2c import I2cBus, register

CONFIG, SHUNT, BUS = 0x00, 0x01, 0x02
SETTING = 0x3FFF
"""32 V, +-320 mV, both averaged over 128 readings (68 ms each), continuous."""
SHUNT_V, BUS_V = 10e-6, 4e-3
"""Of one count."""
OVERFLOW = 1 << 0
PERIOD_US = 200_000
CHECK_EVERY = 10
"""Samples between two checks of its setting: it forgets it when its power fails."""


class Ina219Options(Table, frozen=True, kw_only=True):
    """``[devices.battery]`` of driver "ina219"."""

    bus: Annotated[int, msgspec.Meta(ge=0)] = 1
    address: Annotated[int, msgspec.Meta(ge=0x40, le=0x4F)] = 0x41
    """0x40 is where a PCA9685 sits."""
    shunt_ohm: Positive = 0.01


class Ina219(BatteryMonitor):
    Options = Ina219Options

    def __init__(self, vehicle: Vehicle, options: Ina219Options, *, bus: I2cBus | None = None) -> None:
        super().__init__(vehicle, options.bus, bus)
        self._options = options
        self._count = 0

    def open(self) -> None:
        """Set the device up. DriverError or OSError if it is not there."""
        self._bus.open()
        self._bus.write(self._options.address, bytes([CONFIG]) + SETTING.to_bytes(2, "big"))
        self._check()

    def _check(self) -> None:
        found = register(self._bus, self._options.address, CONFIG, 2)
        if found != SETTING:
            raise DriverError(f"setting 0x{found:04x} instead of 0x{SETTING:04x}")

    def poll(self, t_us: int) -> list[PowerSample]:
        if t_us < self._next_us:
            return []
        self._next_us = t_us + PERIOD_US
        self._count += 1
        if self._count % CHECK_EVERY == 0:
            self._check()
        shunt = register(self._bus, self._options.address, SHUNT, 2)
        bus = register(self._bus, self._options.address, BUS, 2)
        if bus & OVERFLOW:
            self.bad_samples += 1
            return []
        shunt -= (shunt & 0x8000) << 1
        return self._samples(t_us, (bus >> 3) * BUS_V, shunt * SHUNT_V / self._options.shunt_ohm)
