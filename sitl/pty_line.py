"""An emulated serial line: a pseudo-terminal with a device model at its other end (POSIX)."""

import contextlib
import os
import pty
import tempfile
import tty
from pathlib import Path

from autopilot.drivers.base import Closing
from autopilot.drivers.protocols import BytePort

CHUNK = 4096


class PtyLine(Closing):
    """A cable between an emulator and the process that opens :attr:`path`. Unplugging removes the path, as with a USB
    adapter.
    """

    def __init__(self, device: BytePort, name: str = "ttyEmulated") -> None:
        self._device = device
        self._folder = tempfile.TemporaryDirectory(prefix="line-")
        self.path = Path(self._folder.name) / name
        """What a driver opens; there while the line is plugged in."""
        self._far: int | None = None
        self._near: int | None = None

    def open(self) -> None:
        if self._far is None:
            self._far, self._near = pty.openpty()  # the near end stays open: it has to outlive drivers that come and go
            tty.setraw(self._near)
            os.set_blocking(self._far, False)
            self.path.symlink_to(os.ttyname(self._near))

    def unplug(self) -> None:
        """Pull the device out; :meth:`open` plugs it in again."""
        self.path.unlink(missing_ok=True)
        for end in (self._far, self._near):
            if end is not None:
                os.close(end)
        self._far = self._near = None

    def close(self) -> None:
        self.unplug()
        self._folder.cleanup()

    def pump(self, t_us: int) -> None:
        """Transfer the bytes of both directions up to ``t_us``."""
        for _, data in self._device.read(t_us):
            self.send(data)
        if self._far is not None:
            with contextlib.suppress(OSError):  # nothing there
                while data := os.read(self._far, CHUNK):
                    self._device.write(data)
            for _, data in self._device.read(t_us):
                self.send(data)

    def send(self, data: bytes) -> None:
        """Put bytes on the line as if the device had sent them; a line that is unplugged or full loses them."""
        if self._far is not None:
            with contextlib.suppress(OSError):
                os.write(self._far, data)
