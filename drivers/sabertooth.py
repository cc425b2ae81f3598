"""Dimension Engineering Sabertooth amplifiers for brushed thrusters, in packetized serial mode: two motors each.

Packet: ``address | command | data | (address + command + data) & 0x7F``, address 128 to 135. The amplifier's own
timeout (command 14, in 0.1 s) stops the motors when packets stop, whatever the state of this program; it is set again
periodically, because the amplifier loses it with its power.
"""

from collections.abc import Mapping
from typing import Annotated

import msgspec

from autopilot.core.errors import ConfigError
from autopilot.core.toml_table import Table
from autopilot.core.vehicle import Vehicle
from autopilot.drivers.protocols import BytePort
from autopilot.drivers.serial_port import SerialPort
from autopilot.drivers.thruster_output import SafeThrusterOutput, check_names

FIRST_ADDRESS = 128
AUTOBAUD = bytes([0xAA])
"""First byte after power-up, by which models without a switch learn the speed of the line; others ignore it."""
FORWARD, BACKWARD = {1: 0, 2: 4}, {1: 1, 2: 5}
"""Motor -> command."""
TIMEOUT = 14
FULL = 127
TIMEOUT_EVERY = 50
"""Commands between two transmissions of the timeout."""
TICKS_HZ, BITS = 100, 10
"""Commands per second, and bits per byte on the line."""

Motor = tuple[Annotated[int, msgspec.Meta(ge=128, le=135)], Annotated[int, msgspec.Meta(ge=1, le=2)]]


class SabertoothOptions(Table, frozen=True, kw_only=True):
    """``[devices.thrusters]`` of driver "sabertooth"."""

    port: str
    """Serial device."""
    baud: Annotated[int, msgspec.Meta(gt=0)] = 38400
    motors: Mapping[str, Motor] = msgspec.field(default_factory=dict)
    """Name of a thruster -> [address, motor]; absent = in the order of the channels from [128, 1]."""


def packet(address: int, command: int, data: int) -> bytes:
    return bytes([address, command, data, (address + command + data) & 0x7F])


class Sabertooth(SafeThrusterOutput):
    """The driver: a pulse becomes the duty that a servo amplifier would make of it."""

    Options = SabertoothOptions

    def __init__(self, vehicle: Vehicle, options: SabertoothOptions, *, port: BytePort | None = None) -> None:
        super().__init__(vehicle)
        self._port = SerialPort(options.port, options.baud) if port is None else port
        self._puts = 0
        names = [thruster.name for thruster in vehicle.thrusters]
        check_names("motors", options.motors, names)
        self._motors: dict[int, tuple[int, int]] = {}
        """Channel -> address, motor."""
        for thruster in vehicle.thrusters:
            place = thruster.channel - 1
            motor = options.motors.get(thruster.name, (FIRST_ADDRESS + place // 2, 1 + place % 2))
            if motor in self._motors.values():
                raise ConfigError(f"`motors`: two thrusters on motor {list(motor)}; give each one of its own")
            self._motors[thruster.channel] = motor
        self._drives = {
            thruster.channel: (thruster.drive.neutral_us, thruster.drive.span_us) for thruster in vehicle.thrusters
        }
        self._tenths = min(FULL, max(1, self._timeout_us // 100_000))
        bits = len(self._motors) * 4 * BITS * TICKS_HZ
        if bits > options.baud:
            raise ConfigError(f"`baud` = {options.baud}: {len(names)} motors need {bits}; set 38400 at the amplifiers")

    def _acquire(self) -> None:
        self._port.open()
        self._port.write(AUTOBAUD)
        self._port.write(self._timeouts())

    def _put(self, pwm_us: tuple[int, ...]) -> None:
        self._puts += 1
        data = b"".join(self._speed(channel, pwm_us[channel - 1]) for channel in self._motors)
        if self._puts % TIMEOUT_EVERY == 0:
            data += self._timeouts()
        self._port.write(data)

    def _speed(self, channel: int, pulse_us: int) -> bytes:
        address, motor = self._motors[channel]
        neutral_us, span_us = self._drives[channel]
        speed = round(FULL * (pulse_us - neutral_us) / span_us)
        return packet(address, (FORWARD if speed >= 0 else BACKWARD)[motor], min(FULL, abs(speed)))

    def _timeouts(self) -> bytes:
        addresses = sorted({address for address, _ in self._motors.values()})
        return b"".join(packet(address, TIMEOUT, self._tenths) for address in addresses)

    def _release(self) -> None:
        self._port.close()
