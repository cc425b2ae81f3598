"""A serial line through the operating system's terminal interface (POSIX termios), without a further library."""

import os
import sys
from types import ModuleType

from autopilot.core.errors import DriverError
from drivers.base import Closing
from drivers.framing import FrameCutter

CHUNK = 4096
"""Bytes per system call; 115200 baud brings 115 per tick."""


def _termios() -> ModuleType:
    """The standard library's termios; DriverError where the system has none."""
    if sys.platform == "win32":
        raise DriverError("serial lines need a POSIX system; connect by UDP or TCP instead")
    import termios

    return termios


class SerialPort(Closing):
    """8 data bits, no parity, 1 stop bit, no flow control, no translation."""

    def __init__(self, device: str, baud: int) -> None:
        self._device = device
        self._baud = baud
        self._fd: int | None = None

    def open(self) -> None:
        """Open and configure the line; DriverError says why that fails."""
        if self._fd is not None:
            return
        termios = _termios()
        speed = getattr(termios, f"B{self._baud}", None)
        if speed is None:
            raise DriverError(
                f"serial line {self._device}: {self._baud} baud is not offered here; use e.g. 57600, 115200"
            )
        try:
            fd = os.open(self._device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        except OSError as error:
            raise DriverError(
                f"serial line {self._device} cannot be opened ({error.strerror}); check cable, name and rights"
            ) from error
        try:
            control = termios.CS8 | termios.CREAD | termios.CLOCAL
            termios.tcsetattr(fd, termios.TCSANOW, [0, 0, control, 0, speed, speed, [b"\0"] * termios.NCCS])
        except termios.error as error:
            os.close(fd)
            raise DriverError(f"{self._device} is not a serial line; check the name") from error
        self._fd = fd

    def read(self, t_us: int) -> list[tuple[int, bytes]]:
        """What is in the system's buffer, stamped with ``t_us``."""
        if self._fd is None:
            return []
        try:
            data = os.read(self._fd, CHUNK)
        except BlockingIOError:
            return []
        except OSError:  # unplugged: the silence is noticed by whoever waits for data
            return []
        return [(t_us, data)] if data else []

    def write(self, data: bytes) -> None:
        """Send; what the system's buffer does not take is lost (commands are repeated by their senders)."""
        if self._fd is None:
            raise DriverError(f"serial line {self._device} is closed; open it before writing")
        try:
            os.write(self._fd, data)
        except BlockingIOError:
            return
        except OSError as error:
            raise DriverError(f"serial line {self._device} failed ({error.strerror}); check the cable") from error

    def close(self) -> None:
        """Close the line."""
        if self._fd is not None:
            os.close(self._fd)
            self._fd = None


class SerialLink:
    """MAVLink on a serial line."""

    def __init__(self, name: str, device: str, baud: int) -> None:
        self._name = name
        self._cutter = FrameCutter()
        self._port = SerialPort(device, baud)
        self._port.open()
        self.dropped_tx = 0
        """Frames that the line did not take."""

    @property
    def name(self) -> str:
        """The connection string."""
        return self._name

    def recv(self) -> list[bytes]:
        """Frames since the last call."""
        return [frame for _, data in self._port.read(0) for frame in self._cutter.feed(data)]

    def send(self, data: bytes) -> None:
        """Send one frame."""
        try:
            self._port.write(data)
        except DriverError:
            self.dropped_tx += 1

    def close(self) -> None:
        """Close the line."""
        self._port.close()
