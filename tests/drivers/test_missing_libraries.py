"""Without the extra [hardware] a driver that needs it says so; everything else works."""

import sys

import pytest

from autopilot.core.errors import DriverError
from autopilot.core.vehicle import load_vehicle
from autopilot.drivers.gpio import LinuxGpio
from autopilot.drivers.i2c import LinuxI2c
from autopilot.drivers.pca9685 import Pca9685, Pca9685Options
from autopilot.drivers.serial_port import SerialPort

HINT = r"install it with pip install 'underwater-autopilot\[hardware\]'"


def test_what_is_missing_is_named_when_it_is_needed(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("smbus2", "gpiod", "gpiod.line", "serial", "serial.tools", "serial.tools.list_ports"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(DriverError, match=f"'smbus2'; {HINT}"):
        LinuxI2c(1).open()
    with pytest.raises(DriverError, match=f"'gpiod'; {HINT}"):
        LinuxGpio("/dev/gpiochip0", 27).open()
    output = Pca9685(load_vehicle("lbv150"), Pca9685Options())
    with pytest.raises(DriverError, match="'smbus2'"):
        output.open()
    with pytest.raises(DriverError, match=r"check cable, name and rights$"):
        SerialPort("/dev/not-there", 115200).open()
