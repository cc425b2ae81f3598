"""Every thruster driver on its emulator: what the amplifiers see, and the ways to break the wire."""

import shutil
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from concurrent.futures import wait
from pathlib import Path

from autopilot.core.vehicle import load_vehicle
from autopilot.drivers.pca9685 import Pca9685, Pca9685Options
from autopilot.drivers.retry import SteadyOutput
from autopilot.drivers.sabertooth import Sabertooth, SabertoothOptions
from autopilot.drivers.sysfs_pwm import SysfsPwm, SysfsPwmOptions
from autopilot.drivers.thruster_output import SafeThrusterOutput
from autopilot.sitl.hil import PtyLine
from autopilot.sitl.i2c_bus import EmulatedI2c, Pca9685Chip
from tests.drivers.sabertooth_emulator import SabertoothEmulator

VEHICLE = load_vehicle("lbv150")
TICK_US = 10_000
CLOCK_HZ = 24.576e6


class OutputRig(ABC):
    """One thruster driver and its emulator."""

    resolution_us = 1.0
    """How exactly a pulse gets through."""

    def __init__(self, make: Callable[[], SafeThrusterOutput]) -> None:
        self.make = make
        self.device = make()
        self.steady = SteadyOutput(self.device, "thrusters")
        self.t_us = 0

    @abstractmethod
    def pulses_us(self) -> tuple[float, ...]:
        """What the four amplifiers see, 0 = no pulse."""

    @abstractmethod
    def unplug(self) -> None:
        """Cut the wire."""

    @abstractmethod
    def plug(self) -> None:
        """Mend it; the amplifiers' board has been without power."""

    def see(self, expected_us: tuple[float, ...]) -> bool:
        """Whether the amplifiers see that, soon: bytes take their time."""
        for _ in range(200):
            seen = self.pulses_us()
            if all(abs(a - b) <= self.resolution_us for a, b in zip(seen, expected_us, strict=True)):
                return True
            time.sleep(0.002)
        raise AssertionError(f"{seen} and not {expected_us}")

    def tick(self, pulses_us: tuple[int, ...] | None) -> None:
        """10 ms of a vehicle: a command, or none."""
        self.t_us += TICK_US
        try:
            if pulses_us is not None:
                self.steady.write(self.t_us, pulses_us)
        finally:
            self.steady.check(self.t_us)
            if self.steady._opening is not None:
                wait([self.steady._opening], 10.0)

    def close(self) -> None:
        self.steady.close()


class Pca9685Rig(OutputRig):
    """Navigator's board: clock from outside."""

    resolution_us = 0.7

    def __init__(self, folder: Path) -> None:
        self.bus = EmulatedI2c()
        self.chip = Pca9685Chip(25e6, external_hz=CLOCK_HZ)
        self.bus.chips[0x40] = self.chip
        super().__init__(lambda: Pca9685(VEHICLE, Pca9685Options(), bus=self.bus))

    def pulses_us(self) -> tuple[float, ...]:
        return self.chip.pulses_us[:4]

    def unplug(self) -> None:
        self.bus.chips.clear()

    def plug(self) -> None:
        self.chip.power_up()
        self.bus.chips[0x40] = self.chip


class SabertoothRig(OutputRig):
    """Two amplifiers of two motors each."""

    resolution_us = 400 / 127

    def __init__(self, folder: Path) -> None:
        self.amplifiers = SabertoothEmulator()
        self.line = PtyLine(self.amplifiers)
        self.line.open()
        super().__init__(lambda: Sabertooth(VEHICLE, SabertoothOptions(port=str(self.line.path))))

    def pulses_us(self) -> tuple[float, ...]:
        self.line.pump(self.t_us)
        return tuple(1500 + 400 * duty for duty in self.amplifiers.duty.values())

    def unplug(self) -> None:
        self.line.unplug()

    def plug(self) -> None:
        self.amplifiers.power_up()
        self.line.open()

    def close(self) -> None:
        super().close()
        self.line.close()


class SysfsPwmRig(OutputRig):
    """A folder as Linux shows it."""

    resolution_us = 0.0

    def __init__(self, folder: Path) -> None:
        self.chip = folder / "pwmchip0"
        self.plug()
        super().__init__(lambda: SysfsPwm(VEHICLE, SysfsPwmOptions(chip=str(self.chip)), kept=False))

    def pulses_us(self) -> tuple[float, ...]:
        def pulse(number: int) -> float:
            folder = self.chip / f"pwm{number}"
            on = (folder / "enable").read_text().strip() == "1"
            return int((folder / "duty_cycle").read_text().split()[0]) / 1000 if on else 0.0

        return tuple(pulse(number) for number in range(4))

    def unplug(self) -> None:
        self.chip.rename(self.chip.with_name("gone"))

    def plug(self) -> None:
        shutil.rmtree(self.chip.with_name("gone"), ignore_errors=True)
        for number in range(4):
            folder = self.chip / f"pwm{number}"
            folder.mkdir(parents=True)
            for name in ("period", "duty_cycle", "enable"):
                (folder / name).write_text("0")


RIGS: dict[str, Callable[[Path], OutputRig]] = {
    "pca9685": Pca9685Rig,
    "sabertooth": SabertoothRig,
    "sysfs_pwm": SysfsPwmRig,
}
"""Name of the registry -> rig."""
