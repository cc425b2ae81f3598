"""TI ADS1115 converter on I2C behind an analogue power module: battery voltage and current.

Defaults: Blue Robotics Navigator with its Power Sense Module.
"""

from typing import Annotated

import msgspec

from autopilot.core.samples import PowerSample
from autopilot.core.toml_table import Positive, Table
from autopilot.core.vehicle import Vehicle
from autopilot.drivers.battery_meter import BatteryMonitor
from autopilot.drivers.i2c import I2cBus, register

CONVERSION, CONFIG = 0x00, 0x01
SINGLE_SHOT = 0xC1E3
"""Start one conversion against ground at 860 per second, comparator off; channel and range are added."""
RANGE_4V = 0x0200
"""+-4.096 V."""
COUNT_V = 4.096 / 32768
READY = 0x8000
CONVERSION_US = 2_000
PERIOD_US = 100_000

Channel = Annotated[int, msgspec.Meta(ge=0, le=3)]


class Ads1115Options(Table, frozen=True, kw_only=True):
    """``[devices.battery]`` of driver "ads1115"."""

    bus: Annotated[int, msgspec.Meta(ge=0)] = 1
    address: Annotated[int, msgspec.Meta(ge=0x48, le=0x4B)] = 0x48
    voltage_channel: Channel = 3
    current_channel: Channel = 2
    volt_per_volt: Positive = 11.0
    ampere_per_volt: Positive = 37.8788
    current_offset_v: float = 0.33

    def __post_init__(self) -> None:
        if self.voltage_channel == self.current_channel:
            raise ValueError(f"`voltage_channel` and `current_channel` are both {self.voltage_channel}; one each")


class Ads1115(BatteryMonitor):
    """The driver: the two channels in turn, a conversion asked for in one poll and read in a later one."""

    Options = Ads1115Options

    def __init__(self, vehicle: Vehicle, options: Ads1115Options, *, bus: I2cBus | None = None) -> None:
        super().__init__(vehicle, options.bus, bus)
        self._options = options
        self._channels = (options.voltage_channel, options.current_channel)
        self._values_v = [0.0, 0.0]
        self._pending: tuple[int, int] | None = None

    def open(self) -> None:
        """Set the device up. DriverError or OSError if it is not there."""
        self._bus.open()
        self._pending = None
        register(self._bus, self._options.address, CONFIG, 2)

    def poll(self, t_us: int) -> list[PowerSample]:
        if self._pending is None:
            if t_us >= self._next_us:
                self._next_us = t_us + PERIOD_US
                self._start_conversion(0, t_us)
            return []
        index, since_us = self._pending
        if t_us - since_us < CONVERSION_US:
            return []
        config = register(self._bus, self._options.address, CONFIG, 2)
        if not config & READY:
            return []
        if config & ~READY != self._setting(index) & ~READY:  # it has been without power meanwhile
            self.bad_samples += 1
            self._pending = None
            return []
        count = register(self._bus, self._options.address, CONVERSION, 2)
        self._values_v[index] = (count - ((count & 0x8000) << 1)) * COUNT_V
        if index == 0:
            self._start_conversion(1, t_us)
            return []
        self._pending = None
        options = self._options
        volt = max(0.0, self._values_v[0]) * options.volt_per_volt
        ampere = (self._values_v[1] - options.current_offset_v) * options.ampere_per_volt
        return self._samples(t_us, volt, ampere)

    def _setting(self, index: int) -> int:
        return SINGLE_SHOT | RANGE_4V | self._channels[index] << 12

    def _start_conversion(self, index: int, t_us: int) -> None:
        setting = self._setting(index).to_bytes(2, "big")
        self._bus.write(self._options.address, bytes([CONFIG]) + setting)
        self._pending = index, t_us
