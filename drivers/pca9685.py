"""NXP PCA9685 on I2C: servo pulses for up to 16 amplifiers, as on the Blue Robotics Navigator.

Pulses are counted in clock cycles and have the error of the assumed clock frequency. Navigator has an external clock
of 24.576 MHz; the internal clock of other boards is off by several percent, which ``clock_hz`` corrects (measure a
pulse of a known command). The chip has no watchdog: it repeats its last pulse when the program is killed, so a
watchdog process runs beside it (:mod:`autopilot.drivers.watchdog`).
"""

import contextlib
import itertools
from collections.abc import Mapping
from typing import Annotated

import msgspec

from autopilot.core.errors import DriverError
from autopilot.core.toml_table import Table
from autopilot.core.vehicle import Vehicle
from autopilot.drivers.gpio import GpioLine, LinuxGpio
from autopilot.drivers.i2c import I2cBus, LinuxI2c, register
from autopilot.drivers.thruster_output import check_names
from autopilot.drivers.watchdog import KeptOutput

MODE1, MODE2, LED0, ALL_OFF_HIGH, PRESCALE = 0x00, 0x01, 0x06, 0xFD, 0xFE
RESTART, EXTERNAL, INCREMENT, SLEEP = 0x80, 0x40, 0x20, 0x10
TOTEM_POLE = 0x04
"""MODE2: push-pull outputs, changed at the stop of a transaction."""
FULL_OFF = 0x10
COUNTS = 4096
CHANNELS = 16


class Pca9685Options(Table, frozen=True, kw_only=True):
    """``[devices.thrusters]`` of driver "pca9685"; defaults: Navigator."""

    bus: Annotated[int, msgspec.Meta(ge=0)] = 1
    address: Annotated[int, msgspec.Meta(ge=0x40, le=0x7F)] = 0x40
    rate_hz: Annotated[float, msgspec.Meta(ge=40.0, le=400.0)] = 200.0
    """Pulses per second."""
    external_clock: bool = True
    clock_hz: Annotated[float, msgspec.Meta(ge=15e6, le=50e6)] = 24.576e6
    """True frequency: 25e6 nominal when ``external_clock`` is false, trimmed by measurement."""
    trim_us: Mapping[str, Annotated[float, msgspec.Meta(ge=-100.0, le=100.0)]] = msgspec.field(default_factory=dict)
    """Name of a thruster -> what is added to its pulses."""
    enable_chip: str = "/dev/gpiochip0"
    enable_line: Annotated[int, msgspec.Meta(ge=0)] | None = None
    """Line of the chip's output enable (active low; Navigator 26); absent = wired to be on."""


class Pca9685(KeptOutput):
    Options = Pca9685Options
    driver = "pca9685"

    def __init__(
        self,
        vehicle: Vehicle,
        options: Pca9685Options,
        *,
        bus: I2cBus | None = None,
        enable: GpioLine | None = None,
        kept: bool | None = None,
    ) -> None:
        """``kept``: whether a watchdog process is used; None = on a real bus."""
        # The output enable line stays with its owner: the watchdog has the bus only.
        bus_options = msgspec.structs.replace(options, enable_line=None)
        spare = {
            output.channel: index
            for index, output in enumerate(vehicle.payload)
            if output.channel is not None and output.channel <= CHANNELS
        }
        super().__init__(vehicle, bus_options, kept=bus is None if kept is None else kept, spare=spare)
        self._bus = LinuxI2c(options.bus) if bus is None else bus
        if enable is None and options.enable_line is not None:
            enable = LinuxGpio(options.enable_chip, options.enable_line, output=True, active_low=True)
        self._enable = enable
        self._address = options.address
        self._mode = INCREMENT | (EXTERNAL if options.external_clock else 0)
        self._prescale = min(255, max(3, round(options.clock_hz / (COUNTS * options.rate_hz)) - 1))
        self._count_us = (self._prescale + 1) / options.clock_hz * 1e6
        longest_us = self._longest_us + max(options.trim_us.values(), default=0.0)
        self._check_rate(options.rate_hz, longest_us, (COUNTS - 1) * self._count_us)
        names = {thruster.name: thruster.channel for thruster in vehicle.thrusters}
        check_names("trim_us", options.trim_us, names)
        self._trim_us = {names[name]: trim_us for name, trim_us in options.trim_us.items()}
        self._runs = _runs(sorted((*names.values(), *spare)))

    def _acquire(self) -> None:
        self._bus.open()
        if not self._configured():
            self._send(ALL_OFF_HIGH, FULL_OFF)
            self._send(MODE1, SLEEP | INCREMENT)
            self._send(MODE1, SLEEP | self._mode)  # the clock can be chosen only while it sleeps
            self._send(PRESCALE, self._prescale)
            self._send(MODE2, TOTEM_POLE)
            self._send(MODE1, self._mode)
            if not self._configured():
                raise DriverError(f"PCA9685 0x{self._address:02x} does not take its settings; check address and clock")
        if self._enable is not None:
            self._put(self._neutral_us)
            self._enable.open()
            self._enable.set(True)

    def _put(self, pwm_us: tuple[int, ...]) -> None:
        for first, count in self._runs:
            data = bytearray([LED0 + 4 * (first - 1)])
            for channel in range(first, first + count):
                pulse_us = pwm_us[channel - 1]
                counts = round((pulse_us + self._trim_us.get(channel, 0.0)) / self._count_us)
                data += bytes([0, 0]) + (counts.to_bytes(2, "little") if pulse_us else bytes([0, FULL_OFF]))
            self._bus.write(self._address, bytes(data))

    def _inspect(self) -> None:
        """It forgets its settings when its power fails, and acknowledges all the same."""
        if not self._configured():
            raise DriverError(f"PCA9685 0x{self._address:02x} has lost its settings")

    def _release(self) -> None:
        """Amplifiers go on hearing neutral, or nothing where the outputs can be switched off."""
        if self._enable is not None:
            with contextlib.suppress(DriverError, OSError):
                self._enable.set(False)
            self._enable.close()
        self._bus.close()

    def _configured(self) -> bool:
        mode = register(self._bus, self._address, MODE1)
        return mode & ~RESTART == self._mode and register(self._bus, self._address, PRESCALE) == self._prescale

    def _send(self, number: int, value: int) -> None:
        self._bus.write(self._address, bytes([number, value]))


def _runs(channels: list[int]) -> list[tuple[int, int]]:
    """Consecutive channels as (first, count); channels between them are not ours."""
    groups = itertools.groupby(enumerate(channels), key=lambda pair: pair[1] - pair[0])
    runs = [[channel for _, channel in group] for _, group in groups]
    return [(run[0], len(run)) for run in runs]
