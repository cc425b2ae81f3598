"""Every sensor driver on its emulator, with the ways to spoil what is between them: what the contract suite drives."""

import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from concurrent.futures import wait
from pathlib import Path
from typing import Any

import numpy as np
from emulators import (
    ACCEL_M_S2,
    CURRENT_A,
    DEPTH_M,
    RANGE_M,
    RATE_RAD_S,
    RPY_RAD,
    VELOCITY_M_S,
    VOLTAGE_V,
    A50Server,
    Ads1115Chip,
    EllipseEmulator,
    GpioEmulator,
    Ina219Chip,
    Ms5837Chip,
    PingEmulator,
    close_to,
)

from autopilot.core.frames import quat_from_rpy
from autopilot.core.samples import AhrsSample, AltimeterSample, DepthSample, LeakSample, PowerSample, VelocitySample
from autopilot.core.vehicle import load_vehicle
from autopilot.drivers.ads1115 import Ads1115, Ads1115Options
from autopilot.drivers.base import AlwaysOpen
from autopilot.drivers.ellipse import Ellipse, EllipseOptions
from autopilot.drivers.ig500_device import Ig500Device, Ig500Options
from autopilot.drivers.ina219 import Ina219, Ina219Options
from autopilot.drivers.leak_gpio import GpioLeak, GpioLeakOptions
from autopilot.drivers.ms5837 import Ms5837, Ms5837Options
from autopilot.drivers.ping1d import Ping1d, Ping1dOptions
from autopilot.drivers.protocols import BytePort
from autopilot.drivers.retry import SteadySensor
from autopilot.drivers.waterlinked_a50 import WaterLinkedA50, WaterLinkedA50Options
from autopilot.sitl.ahrs import Ig500Emulator
from autopilot.sitl.hil import PtyLine
from autopilot.sitl.i2c_bus import EmulatedI2c, I2cChip
from autopilot.sitl.plant import Truth
from autopilot.sitl.sensor_tables import AhrsSensor

TICK_US = 10_000
VEHICLE = load_vehicle("lbv150")


class Rig(ABC):
    """One driver, steadied, and its emulator. Time is the rig's own."""

    least_hz = 4.0
    """Samples per second that are expected at least while all is well."""
    checked = True
    """Whether its protocol shows that bytes were damaged: no wrong value may come out then."""
    wait_s = 0.0
    """Real time that bytes take from one end to the other."""

    def __init__(self, device: Any) -> None:
        self.device = device
        self.steady = SteadySensor(device, "device")
        self.t_us = 0
        self.silent = False
        self.polls = 1

    @abstractmethod
    def emit(self) -> None:
        """Let the emulator say what is due at ``t_us``, unless it is silent."""

    @abstractmethod
    def right(self, sample: Any) -> bool:
        """Whether a sample is what the emulator shows."""

    @abstractmethod
    def garbage(self, data: bytes) -> None:
        """Put these bytes where the device's bytes come from; empty = no longer."""

    @abstractmethod
    def halve(self, on: bool) -> None:
        """Lose parts of what the device says."""

    @abstractmethod
    def hurry(self, factor: int) -> None:
        """So many times as fast as it is meant to be; 1 = normal."""

    @abstractmethod
    def unplug(self) -> None:
        """Pull the device out."""

    @abstractmethod
    def plug(self) -> None:
        """Plug it in again, its power gone meanwhile."""

    def run(self, seconds: float, each: Callable[[], None] = lambda: None) -> list[Any]:
        """What the driver gives in that time."""
        samples: list[Any] = []
        for _ in range(round(seconds * 1e6 / TICK_US)):
            self.t_us += TICK_US
            each()
            self.emit()
            if self.wait_s:
                time.sleep(self.wait_s)
            for _ in range(self.polls):
                samples += self.steady.poll(self.t_us)
            opening = self.steady._opening
            if opening is not None:
                wait([opening], 10.0)
        return samples

    def close(self) -> None:
        self.steady.close()
        self.unplug()


class FaultyPort(AlwaysOpen):
    """Between an emulator and the line: what it says may be cut, or lost."""

    def __init__(self, port: BytePort) -> None:
        self._port = port
        self._count = 0
        self.silent = self.half = False

    def read(self, t_us: int) -> list[tuple[int, bytes]]:
        received = self._port.read(t_us)
        if self.half:
            self._count += len(received)
            received = [
                (at_us, data[: len(data) // (1 + (self._count + n) % 3)]) for n, (at_us, data) in enumerate(received)
            ]
        return [] if self.silent else received

    def write(self, data: bytes) -> None:
        self._port.write(data)


class SerialRig(Rig):
    """A device on a pseudo-terminal."""

    wait_s = 0.0003
    least_hz = 50.0

    def __init__(self, emulator: Any, make: Callable[[str], Any]) -> None:
        self.emulator = emulator
        self._faulty = FaultyPort(emulator)
        self.line = PtyLine(self._faulty)
        self.line.open()
        super().__init__(make(str(self.line.path)))

    def emit(self) -> None:
        self._faulty.silent = self.silent
        self.observe()
        self.line.pump(self.t_us)

    def observe(self) -> None:
        """Let the device measure."""

    def right(self, sample: Any) -> bool:
        return (
            isinstance(sample, AhrsSample)
            and close_to(sample.rpy_rad, RPY_RAD, 1e-3)
            and close_to(sample.rate_frd_rad_s, RATE_RAD_S, 1e-3)
            and close_to(sample.accel_frd_m_s2, ACCEL_M_S2, 1e-3)
        )

    def garbage(self, data: bytes) -> None:
        self.line.send(data)

    def halve(self, on: bool) -> None:
        self._faulty.half = on

    def close(self) -> None:
        super().close()
        self.line.close()

    def unplug(self) -> None:
        self.line.unplug()

    def plug(self) -> None:
        self.line.open()


class Ig500Rig(SerialRig):
    """SBG IG-500A."""

    def __init__(self, folder: Path) -> None:
        exact = {name: 0.0 for name in AhrsSensor.__struct_fields__ if "noise" in name or "bias" in name}
        slow = {"tilt_error_rad": 0.0, "yaw_error_rad": 0.0, "yaw_offset_rad": 0.0, "yaw_field_rad": 0.0}
        self._settings = AhrsSensor(latency_jitter_s=0.0, latency_s=0.0, **exact, **slow)
        self._times = 1
        super().__init__(self.fresh(), lambda path: Ig500Device(VEHICLE, Ig500Options(port=path)))

    def fresh(self) -> Ig500Emulator:
        return Ig500Emulator(self._settings, VEHICLE.ahrs, [], 0)

    def observe(self) -> None:
        for n in range(self._times):
            self.emulator.observe(truth(self.t_us - TICK_US + (n + 1) * TICK_US // self._times))

    def hurry(self, factor: int) -> None:
        self._times = factor

    def plug(self) -> None:
        self.emulator = self._faulty._port = self.fresh()
        super().plug()


class EllipseRig(SerialRig):
    """SBG Ellipse."""

    def __init__(self, folder: Path) -> None:
        super().__init__(EllipseEmulator(), lambda path: Ellipse(VEHICLE, EllipseOptions(port=path)))

    def hurry(self, factor: int) -> None:
        self.emulator.step_us = 5000 // factor

    def plug(self) -> None:
        self.emulator.power_up()
        super().plug()


class PingRig(SerialRig):
    """Blue Robotics Ping Sonar."""

    least_hz = 8.0

    def __init__(self, folder: Path) -> None:
        super().__init__(PingEmulator(), lambda path: Ping1d(VEHICLE, Ping1dOptions(port=path)))

    def right(self, sample: Any) -> bool:
        return isinstance(sample, AltimeterSample) and abs(sample.range_m - RANGE_M) < 1e-3

    def hurry(self, factor: int) -> None:
        self.emulator.times = factor

    def plug(self) -> None:
        self.emulator.power_up()
        super().plug()


class A50Rig(Rig):
    """Water Linked A50."""

    def __init__(self, folder: Path) -> None:
        self._server = A50Server()
        self._every, self._half = 5, False
        super().__init__(WaterLinkedA50(VEHICLE, WaterLinkedA50Options(host="127.0.0.1", port=self._server.port)))

    def emit(self) -> None:
        tick = self.t_us // TICK_US
        if tick % self._every or self.silent:
            return
        for n in range(1 if self._every > 1 else 2):
            data = self._server.report(self.t_us + 1000 * n)
            self._server.send(data[: len(data) // (1 + tick % 3)] if self._half else data)

    def right(self, sample: Any) -> bool:
        return isinstance(sample, VelocitySample) and close_to(sample.vel_frd_m_s, VELOCITY_M_S, 1e-6)

    def garbage(self, data: bytes) -> None:
        self._server.send(data + b"\n")  # a line is what it costs: the stream has no other mark

    def halve(self, on: bool) -> None:
        self._half = on

    def hurry(self, factor: int) -> None:
        self._every = max(1, 5 // factor)

    def unplug(self) -> None:
        self._server.unplug()

    def plug(self) -> None:
        self._server.plug()


class I2cRig(Rig):
    """A chip on an emulated bus. The bus has no checksum: a damaged reading may look like another reading."""

    checked = False

    def __init__(self, address: int, chip: I2cChip, make: Callable[[EmulatedI2c], Any]) -> None:
        self.bus = EmulatedI2c()
        self._address, self._chip = address, chip
        self.bus.chips[address] = chip
        super().__init__(make(self.bus))

    def emit(self) -> None:
        self.bus.refused = 1 << 30 if self.silent else 0

    def garbage(self, data: bytes) -> None:
        self.bus.noise = data or None

    def halve(self, on: bool) -> None:
        self.bus.cut = int(on)

    def hurry(self, factor: int) -> None:
        self.polls = factor

    def unplug(self) -> None:
        self.bus.chips.clear()

    def plug(self) -> None:
        if not isinstance(self._chip, Ms5837Chip):
            self._chip.power_up()  # type: ignore[attr-defined]
        self.bus.chips[self._address] = self._chip


class Ms5837Rig(I2cRig):
    """Bar30."""

    def __init__(self, folder: Path) -> None:
        super().__init__(0x76, Ms5837Chip("30ba"), lambda bus: Ms5837(VEHICLE, Ms5837Options(), bus=bus))

    def right(self, sample: Any) -> bool:
        return isinstance(sample, DepthSample) and abs(sample.depth_m - DEPTH_M) < 0.005


class BatteryRig(I2cRig):
    """A battery monitor."""

    def right(self, sample: Any) -> bool:
        return (
            isinstance(sample, PowerSample)
            and abs(sample.voltage_v - VOLTAGE_V) < 0.01
            and abs(sample.current_a - CURRENT_A) < 0.02
        )


class Ina219Rig(BatteryRig):
    """INA219."""

    def __init__(self, folder: Path) -> None:
        super().__init__(0x41, Ina219Chip(), lambda bus: Ina219(VEHICLE, Ina219Options(), bus=bus))


class Ads1115Rig(BatteryRig):
    """ADS1115."""

    def __init__(self, folder: Path) -> None:
        super().__init__(0x48, Ads1115Chip(), lambda bus: Ads1115(VEHICLE, Ads1115Options(), bus=bus))


class LeakRig(Rig):
    """A leak probe: one bit, of which no garbage and no half can be told from the truth."""

    checked = False

    def __init__(self, folder: Path) -> None:
        self.line = GpioEmulator()
        super().__init__(GpioLeak(VEHICLE, GpioLeakOptions(), line=self.line))

    def emit(self) -> None:
        self.line.gone = self.line.gone or self.silent

    def right(self, sample: Any) -> bool:
        return isinstance(sample, LeakSample) and sample.wet is self.line.level

    def garbage(self, data: bytes) -> None:
        self.line.level = bool(data and data[0] & 1)

    def halve(self, on: bool) -> None:
        self.line.gone = on

    def hurry(self, factor: int) -> None:
        self.polls = factor

    def unplug(self) -> None:
        self.line.gone = True

    def plug(self) -> None:
        self.line.gone = False


def truth(t_us: int) -> Truth:
    """A vehicle that stands where the emulators say that it stands."""
    zero = np.zeros(3)
    return Truth(
        t_us=t_us, pos_ned_m=zero, rpy_rad=np.array(RPY_RAD), quat=quat_from_rpy(np.array(RPY_RAD)), vel_frd_m_s=zero,
        vel_water_frd_m_s=zero, rate_frd_rad_s=np.array(RATE_RAD_S), accel_frd_m_s2=np.array(ACCEL_M_S2),
        current_ned_m_s=zero, thrust_n=np.zeros(8), power_w=0.0, voltage_v=0.0, current_a=0.0, energy_used_j=0.0,
        energy_remaining=1.0, contact_depth_m=0.0, contact_count=0, max_penetration_m=0.0, emerged_m=0.0,
    )  # fmt: skip


RIGS: dict[str, Callable[[Path], Rig]] = {
    "ahrs/ig500": Ig500Rig,
    "ahrs/ellipse": EllipseRig,
    "depth/ms5837": Ms5837Rig,
    "dvl/waterlinked_a50": A50Rig,
    "altimeter/ping1d": PingRig,
    "battery/ina219": Ina219Rig,
    "battery/ads1115": Ads1115Rig,
    "leak/gpio": LeakRig,
}
"""Kind and name of the registry -> rig."""
