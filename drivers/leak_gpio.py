"""A leak probe on a GPIO line: wet or dry."""

from typing import Annotated

import msgspec

from autopilot.core.samples import LeakSample
from autopilot.core.toml_table import Table
from autopilot.core.vehicle import Vehicle
from autopilot.drivers.base import Closing
from autopilot.drivers.gpio import GpioLine, LinuxGpio

PERIOD_US = 200_000
"""Between samples while nothing changes; a change is reported at once."""


class GpioLeakOptions(Table, frozen=True, kw_only=True):
    """``[devices.leak]`` with ``driver = "gpio"``; default line: Blue Robotics Navigator."""

    chip: str = "/dev/gpiochip0"
    line: Annotated[int, msgspec.Meta(ge=0)] = 27
    active_low: bool = False
    """Wet when the line is low."""


class GpioLeak(Closing):
    """A :class:`autopilot.drivers.protocols.Sensor`."""

    Options = GpioLeakOptions

    def __init__(self, vehicle: Vehicle, options: GpioLeakOptions, *, line: GpioLine | None = None) -> None:
        self._line = LinuxGpio(options.chip, options.line, active_low=options.active_low) if line is None else line
        self._next_us: int | None = None
        self._wet = False

    def open(self) -> None:
        """Ask for the line. DriverError if it cannot be had."""
        self._line.open()
        self._next_us = None

    def close(self) -> None:
        self._line.close()

    def poll(self, t_us: int) -> list[LeakSample]:
        """A sample when one is due or the probe has changed. DriverError or OSError when the chip is gone."""
        wet = self._line.get()
        if wet == self._wet and self._next_us is not None and t_us < self._next_us:
            return []
        self._wet, self._next_us = wet, t_us + PERIOD_US
        return [LeakSample(t_us=t_us, wet=wet)]
