"""Hardware drivers with emulated devices in the loop: a serial line, a network camera, an I2C board.

The interfaces between plant and service are those of a real vehicle. Transfers take the operating system's time, so
that this runs in real time only.
"""

import threading
from collections.abc import Sequence
from queue import SimpleQueue
from time import sleep
from typing import Literal

from autopilot.core.samples import AhrsSample, CameraFrame, ImuSample
from autopilot.core.vehicle import Vehicle
from autopilot.drivers.base import Closing
from autopilot.drivers.frame_clock import LoopTime, machine_us
from autopilot.drivers.ig500 import Ig500
from autopilot.drivers.ig500_device import Ig500Device, Ig500Options
from autopilot.drivers.opencv_camera import OpenCvCamera, OpenCvCameraOptions
from autopilot.drivers.pca9685 import Pca9685, Pca9685Options
from autopilot.drivers.retry import SteadySensor
from autopilot.sitl.ahrs import Ig500Emulator
from autopilot.sitl.camera_feed import CameraFeed
from autopilot.sitl.i2c_bus import EmulatedI2c, Pca9685Chip
from autopilot.sitl.mjpeg import MjpegServer
from autopilot.sitl.pty_line import PtyLine
from autopilot.sitl.sitl_tuning import CAMERA_FEED

Wire = Literal["serial", "camera", "pwm"]
"""AHRS on a pseudo-terminal, pictures as a network stream, pulses through a PCA9685 on an emulated bus."""
WIRES: tuple[Wire, ...] = ("serial", "camera", "pwm")

STREAM_US = 50_000
"""What encoder and network of an IP camera add at least. Within it a simulation may be late."""
OSCILLATOR_HZ = 25.6e6
"""Of the board's own clock, which nobody asks: Navigator's is fed from outside."""


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
    """Rendered pictures as they come over a network."""

    def __init__(self, feed: CameraFeed, vehicle: Vehicle) -> None:
        self._feed, self._vehicle = feed, vehicle
        self.server = MjpegServer()
        """The camera's end: may be closed and opened again."""
        self._transport_us = round(1e6 * CAMERA_FEED.transport_fraction * vehicle.eye.latency_s) + STREAM_US
        self._time = LoopTime()
        self._due: SimpleQueue[tuple[int, CameraFrame] | None] = SimpleQueue()
        self._steady: SteadySensor | None = None

    def open(self) -> None:
        self._feed.open()
        self.server.open()
        threading.Thread(target=self._send, name="stream", daemon=True).start()
        options = OpenCvCameraOptions(source=self.server.url, latency_s=1e-6 * self._transport_us)
        self._steady = SteadySensor(OpenCvCamera(self._vehicle, options), "Camera")

    def close(self) -> None:
        self._due.put(None)
        self.server.close()
        if self._steady is not None:
            self._steady.close()
        self._feed.close()

    def poll(self, t_us: int) -> list[CameraFrame]:
        self._time.observe(t_us, machine_us())
        for frame in self._feed.poll(t_us):
            self._due.put((self._time.clock_at(frame.t_us + self._transport_us), frame))
        return [] if self._steady is None else self._steady.poll(t_us)

    def _send(self) -> None:
        """Serve each image at the end of its latency, however late the loop that rendered it."""
        while (due := self._due.get()) is not None:
            due_us, frame = due
            sleep(max(0.0, 1e-6 * (due_us - machine_us())))
            self.server.show(frame)


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
