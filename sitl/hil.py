"""Hardware drivers with emulated devices in the loop: a serial line, a network camera, an I2C board.

The interfaces between plant and service are those of a real vehicle. Transfers take the operating system's time, so
that this runs in real time only.
"""

import contextlib
import os
import pty
import tempfile
import tty
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from autopilot.core.samples import AhrsSample, CameraFrame, ImuSample
from autopilot.core.vehicle import Vehicle
from autopilot.drivers.base import Closing
from autopilot.drivers.ig500 import Ig500
from autopilot.drivers.ig500_device import Ig500Device, Ig500Options
from autopilot.drivers.opencv_camera import OpenCvCamera, OpenCvCameraOptions
from autopilot.drivers.pca9685 import Pca9685, Pca9685Options
from autopilot.drivers.protocols import BytePort
from autopilot.drivers.retry import SteadySensor
from autopilot.sitl.ahrs import Ig500Emulator
from autopilot.sitl.camera_process import CameraProcess
from autopilot.sitl.i2c_bus import EmulatedI2c, Pca9685Chip

Wire = Literal["serial", "camera", "pwm"]
"""AHRS on a pseudo-terminal, pictures as a network stream, pulses through a PCA9685 on an emulated bus."""
WIRES: tuple[Wire, ...] = ("serial", "camera", "pwm")

OSCILLATOR_HZ = 25.6e6
"""Of the board's own clock, which nobody asks: Navigator's is fed from outside."""
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


class SerialAhrs(Closing):
    """The AHRS with its emulator at the end of a pseudo-terminal."""

    def __init__(self, emulator: Ig500Emulator, vehicle: Vehicle, *, attitude: bool) -> None:
        self.line = PtyLine(emulator, "ttyAHRS")
        """The cable: may be pulled."""
        self._device = Ig500Device(vehicle, Ig500Options(port=str(self.line.path), attitude=attitude))
        self._steady = SteadySensor(self._device, "AHRS")

    @property
    def driver(self) -> Ig500:
        return self._device

    def open(self) -> None:
        self.line.open()

    def close(self) -> None:
        self._steady.close()
        self.line.close()

    def poll(self, t_us: int) -> list[AhrsSample | ImuSample]:
        self.line.pump(t_us)
        return self._steady.poll(t_us)


class NetworkCamera(Closing):
    """Pictures as they come over a network."""

    def __init__(self, camera: CameraProcess, vehicle: Vehicle) -> None:
        self._camera, self._vehicle = camera, vehicle
        self._steady: SteadySensor | None = None

    def open(self) -> None:
        self._camera.open()
        options = OpenCvCameraOptions(source=self._camera.url, latency_s=self._camera.latency_s)
        self._steady = SteadySensor(OpenCvCamera(self._vehicle, options), "Camera")

    def close(self) -> None:
        if self._steady is not None:
            self._steady.close()
        self._camera.close()

    def poll(self, t_us: int) -> list[CameraFrame]:
        return [] if self._steady is None else self._steady.poll(t_us)


class BoardOutput(Pca9685):
    """Thruster output through the real driver and an emulated board: the pulses are read at its pins."""

    def __init__(self, vehicle: Vehicle) -> None:
        self.bus = EmulatedI2c()
        self.chip = Pca9685Chip(OSCILLATOR_HZ, external_hz=Pca9685Options().clock_hz)
        self.bus.chips[Pca9685Options().address] = self.chip
        super().__init__(vehicle, Pca9685Options(), bus=self.bus)
        self._count = max(thruster.channel for thruster in vehicle.thrusters)

    @property
    def pwm_us(self) -> tuple[int, ...]:
        """Pulses at the pins, to the microsecond."""
        return tuple(round(pulse) for pulse in self.chip.pulses_us[: self._count])


def wires(names: Sequence[str]) -> frozenset[Wire]:
    """The emulated interfaces of these names."""
    return frozenset(wire for wire in WIRES if wire in names)
