"""Hardware PWM of the computer, by Linux's ``/sys/class/pwm``: one file per output.

Like the PCA9685 it repeats its last pulse when the program is killed; a watchdog process runs beside it
(:mod:`autopilot.drivers.watchdog`).
"""

import contextlib
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import msgspec

from autopilot.core.errors import ConfigError, DriverError
from autopilot.core.toml_table import Table
from autopilot.core.vehicle import Vehicle
from autopilot.drivers.thruster_output import check_names
from autopilot.drivers.watchdog import KeptOutput


class SysfsPwmOptions(Table, frozen=True, kw_only=True):
    """``[devices.thrusters]`` of driver "sysfs_pwm"."""

    chip: str = "/sys/class/pwm/pwmchip0"
    rate_hz: Annotated[float, msgspec.Meta(ge=40.0, le=400.0)] = 200.0
    """Pulses per second."""
    outputs: Mapping[str, Annotated[int, msgspec.Meta(ge=0)]] = msgspec.field(default_factory=dict)
    """Name of a thruster -> number of the chip's output; absent = its channel less 1. What the vehicle carries is
    driven if it is named."""


class SysfsPwm(KeptOutput):
    Options = SysfsPwmOptions
    driver = "sysfs_pwm"

    def __init__(self, vehicle: Vehicle, options: SysfsPwmOptions, *, kept: bool = True) -> None:
        """``kept``: whether a watchdog process is used."""
        spare = {
            output.channel: index
            for index, output in enumerate(vehicle.payload)
            if output.channel is not None and output.name in options.outputs
        }
        super().__init__(vehicle, options, kept=kept, spare=spare)
        self._chip = Path(options.chip)
        self._period_ns = round(1e9 / options.rate_hz)
        self._check_rate(options.rate_hz, self._longest_us, self._period_ns / 1000)
        names = [*(thruster.name for thruster in vehicle.thrusters), *(output.name for output in vehicle.payload)]
        check_names("outputs", options.outputs, names)
        carried = [(vehicle.payload[index].name, channel) for channel, index in spare.items()]
        self._outputs: dict[int, int] = {}
        """Channel -> number of the output."""
        for name, channel in (*((thruster.name, thruster.channel) for thruster in vehicle.thrusters), *carried):
            number = options.outputs.get(name, channel - 1)
            if number in self._outputs.values():
                raise ConfigError(f"`outputs`: two thrusters on output {number}; give each one of its own")
            self._outputs[channel] = number
        self._files: dict[int, int] = {}

    def _acquire(self) -> None:
        if not self._chip.is_dir():
            raise DriverError(f"{self._chip} is not there; switch hardware PWM on in the computer's set-up")
        for channel, number in self._outputs.items():
            folder = self._chip / f"pwm{number}"
            if not folder.is_dir():
                (self._chip / "export").write_text(str(number), encoding="ascii")
            period = folder / "period"
            if int(period.read_text(encoding="ascii") or 0) != self._period_ns:
                duty = folder / "duty_cycle"
                if int(duty.read_text(encoding="ascii") or 0) > self._period_ns:
                    duty.write_text("0", encoding="ascii")  # the system refuses a period below the pulse
                period.write_text(str(self._period_ns), encoding="ascii")
            if channel not in self._files:
                self._files[channel] = os.open(folder / "duty_cycle", os.O_WRONLY)
            self._pulse(channel, self._neutral_us[channel - 1])
            (folder / "enable").write_text("1", encoding="ascii")

    def _put(self, pwm_us: tuple[int, ...]) -> None:
        for channel in self._outputs:
            self._pulse(channel, pwm_us[channel - 1])

    def _inspect(self) -> None:
        for number in self._outputs.values():
            enable = self._chip / f"pwm{number}" / "enable"
            if enable.read_text(encoding="ascii").strip() != "1":
                raise DriverError(f"{enable} is off; find out who switched it off")

    def _pulse(self, channel: int, pulse_us: int) -> None:
        os.pwrite(self._files[channel], b"%d\n" % (1000 * pulse_us), 0)

    def _release(self) -> None:
        files, self._files = self._files, {}
        for file in files.values():
            with contextlib.suppress(OSError):
                os.close(file)
