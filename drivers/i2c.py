"""An I2C bus: transactions with a device at an address, over Linux's ``/dev/i2c-N``."""

import fcntl
from typing import Any, Protocol

from autopilot.core.errors import DriverError
from autopilot.drivers.base import Closing
from autopilot.drivers.protocols import Device

_I2C_RETRIES, _I2C_TIMEOUT = 0x0701, 0x0702
"""Requests of linux/i2c-dev.h."""
BUS_TIMEOUT_10MS = 1
"""A bus that hangs costs the loop one tick per attempt, not the kernel's second."""


class I2cBus(Device, Protocol):
    """Transactions on a bus. OSError without acknowledgement or on a hanging bus."""

    def write(self, address: int, data: bytes) -> None: ...

    def read(self, address: int, count: int) -> bytes: ...

    def exchange(self, address: int, data: bytes, count: int) -> bytes:
        """Send, then read after a repeated start: how registers are read."""
        ...


class LinuxI2c(Closing):
    """``/dev/i2c-N`` through smbus2. Several drivers may each have one of the same number."""

    def __init__(self, number: int) -> None:
        self._number = number
        self._bus: Any = None
        self._message: Any = None

    def open(self) -> None:
        if self._bus is not None:
            return
        try:
            from smbus2 import SMBus, i2c_msg
        except ModuleNotFoundError as error:
            raise DriverError(
                "I2C needs the Python module 'smbus2'; install it with pip install 'underwater-autopilot[hardware]'"
            ) from error
        try:
            self._bus, self._message = SMBus(self._number), i2c_msg
            fcntl.ioctl(self._bus.fd, _I2C_TIMEOUT, BUS_TIMEOUT_10MS)
            fcntl.ioctl(self._bus.fd, _I2C_RETRIES, 0)
        except OSError as error:
            self.close()
            raise DriverError(
                f"/dev/i2c-{self._number} cannot be opened ({error.strerror}); enable I2C, check number and rights"
            ) from error

    def close(self) -> None:
        bus, self._bus = self._bus, None
        if bus is not None:
            bus.close()

    def write(self, address: int, data: bytes) -> None:
        bus, message = self._parts()
        bus.i2c_rdwr(message.write(address, data))

    def read(self, address: int, count: int) -> bytes:
        bus, message = self._parts()
        reply = message.read(address, count)
        bus.i2c_rdwr(reply)
        return bytes(reply)

    def exchange(self, address: int, data: bytes, count: int) -> bytes:
        bus, message = self._parts()
        reply = message.read(address, count)
        bus.i2c_rdwr(message.write(address, data), reply)
        return bytes(reply)

    def _parts(self) -> tuple[Any, Any]:
        if self._bus is None:
            raise DriverError(f"/dev/i2c-{self._number} is closed; open it before use")
        return self._bus, self._message


class I2cSensor(Closing):
    """A sensor on a bus, which it opens and closes."""

    def __init__(self, number: int, bus: I2cBus | None) -> None:
        """``bus``: instead of Linux's of that number."""
        self._bus = LinuxI2c(number) if bus is None else bus

    def close(self) -> None:
        self._bus.close()


def register(bus: I2cBus, address: int, number: int, count: int = 1) -> int:
    """A register, high byte first. OSError also when the answer is cut short."""
    data = bus.exchange(address, bytes([number]), count)
    if len(data) != count:
        raise OSError(f"{len(data)} of {count} bytes from 0x{address:02x}")
    return int.from_bytes(data, "big")
