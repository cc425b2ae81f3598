"""A serial line through the operating system's terminal interface (POSIX termios), without a further library."""

import contextlib
import os
import sys
from types import ModuleType

from autopilot.core.clients import EVERYONE
from autopilot.core.errors import DriverError
from autopilot.drivers.base import Closing
from autopilot.drivers.framing import FrameCutter
from autopilot.drivers.numbering import Numbering
from autopilot.drivers.protocols import Received

CHUNK = 4096
"""Bytes per system call; 115200 baud brings 115 per tick."""
REOPEN_US = 1_000_000
"""Between attempts to open a device that has gone."""


def _termios() -> ModuleType:
    """The standard library's termios; DriverError where the system has none."""
    if sys.platform == "win32":
        raise DriverError("serial lines need a POSIX system; connect by UDP or TCP instead")
    import termios

    return termios


def _others() -> str:
    """Available lines, for an error message; empty without pyserial, which lists them by manufacturer."""
    try:
        from serial.tools.list_ports import comports
    except ModuleNotFoundError:
        return ""
    found = sorted(f"{port.device} ({port.description})" for port in comports())
    return f"; there is {', '.join(found)}" if found else "; there is no serial line"


class SerialPort(Closing):
    """8 data bits, no parity, 1 stop bit, no flow control, no translation."""

    def __init__(self, device: str, baud: int) -> None:
        self._device = device
        self._baud = baud
        self.fd: int | None = None
        """File descriptor, None when closed."""
        self.lost = False
        """Whether the device has gone since it was opened; it may be opened again."""

    def open(self) -> None:
        """Open and configure the line. DriverError with the reason."""
        if self.fd is not None:
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
                f"serial line {self._device} cannot be opened ({error.strerror});"
                f" check cable, name and rights{_others()}"
            ) from error
        try:
            control = termios.CS8 | termios.CREAD | termios.CLOCAL
            special: list[bytes | int] = [b"\0"] * termios.NCCS
            special[termios.VMIN] = 1  # an empty read means that the line is gone, not that nothing has come
            termios.tcsetattr(fd, termios.TCSANOW, [0, 0, control, 0, speed, speed, special])
        except termios.error as error:
            os.close(fd)
            raise DriverError(f"{self._device} is not a serial line; check the name") from error
        self.fd, self.lost = fd, False

    def read(self, t_us: int) -> list[tuple[int, bytes]]:
        """Content of the system's receive buffer, stamped with ``t_us``."""
        if self.fd is None:
            return []
        try:
            data = os.read(self.fd, CHUNK)
        except BlockingIOError:
            return []
        except OSError:  # unplugged
            data = b""
        if not data:
            self._lose()
            return []
        return [(t_us, data)]

    def write(self, data: bytes) -> None:
        """Send; data that do not fit into the system's buffer are lost (senders repeat their commands)."""
        if self.fd is None:
            raise DriverError(f"serial line {self._device} is closed; open it before writing")
        try:
            os.write(self.fd, data)
        except BlockingIOError:
            return
        except OSError as error:
            self._lose()
            raise DriverError(f"serial line {self._device} failed ({error.strerror}); check the cable") from error

    def _lose(self) -> None:
        """The device has gone: nothing may hold on to it, or it could not come back under its name."""
        self.close()
        self.lost = True

    def close(self) -> None:
        self.lost = False
        fd, self.fd = self.fd, None
        if fd is not None:
            with contextlib.suppress(OSError):  # a line that is unplugged may complain; its number is free all the same
                os.close(fd)


class SerialLink:
    """MAVLink on a serial line. A device that goes is opened again when it comes back under its name."""

    def __init__(self, name: str, device: str, baud: int) -> None:
        self.name, self._device = name, device
        self._cutter = FrameCutter()
        self._attempt_us = 0
        self._numbering = Numbering()
        self._port = SerialPort(device, baud)
        self._port.open()
        self.dropped_tx = 0
        """Frames that the line did not take."""

    @property
    def problem(self) -> str | None:
        return "device gone, check the cable" if self._port.lost else None

    def filenos(self) -> list[int]:
        return [] if self._port.fd is None else [self._port.fd]

    def recv(self, t_us: int) -> list[Received]:
        if self._port.lost and t_us - self._attempt_us >= REOPEN_US:
            self._attempt_us = t_us
            with contextlib.suppress(DriverError):
                self._port.open()
                self._cutter = FrameCutter()
        return [
            Received(frame, EVERYONE, self._device)
            for _, data in self._port.read(t_us)
            for frame in self._cutter.feed(data)
        ]

    def send(self, data: bytes, client: int = EVERYONE, beside: frozenset[int] = frozenset()) -> None:
        try:
            self._port.write(self._numbering(data))
        except DriverError:
            self.dropped_tx += 1

    def close(self) -> None:
        self._port.close()
