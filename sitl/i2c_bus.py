"""An emulated I2C bus and the chips on it, byte by byte, behind :class:`autopilot.drivers.i2c.I2cBus`."""

import errno
from typing import Protocol

from autopilot.drivers.base import AlwaysOpen


class I2cChip(Protocol):
    """A device on the bus: bytes written to it, bytes read from it."""

    def write(self, data: bytes) -> None:
        """A write transaction."""
        ...

    def read(self, count: int) -> bytes: ...


class EmulatedI2c(AlwaysOpen):
    """A bus. Chips may be pulled off; transfers may be damaged or refused."""

    def __init__(self) -> None:
        self.chips: dict[int, I2cChip] = {}
        """Address -> chip."""
        self.refused = 0
        """The next so many transactions are not acknowledged."""
        self.noise: bytes | None = None
        """What reads give instead of the chip's bytes, repeated; None = the truth."""
        self.cut = 0
        """Bytes that are missing at the end of every read."""

    def write(self, address: int, data: bytes) -> None:
        """A write transaction. OSError (EREMOTEIO, as from Linux) without acknowledgement."""
        self._chip(address).write(data)

    def read(self, address: int, count: int) -> bytes:
        data = self._chip(address).read(count)
        if self.noise is not None:
            data = (self.noise * (count // len(self.noise) + 1))[:count]
        return data[: max(0, count - self.cut)]

    def exchange(self, address: int, data: bytes, count: int) -> bytes:
        self._chip(address).write(data)
        return self.read(address, count)

    def _chip(self, address: int) -> I2cChip:
        if self.refused > 0:
            self.refused -= 1
        elif address in self.chips:
            return self.chips[address]
        raise OSError(errno.EREMOTEIO, "Remote I/O error")


class Pca9685Chip:
    """NXP PCA9685 after its data sheet: registers, sleep, clock, prescale, and the pulses that come out."""

    MODE1, MODE2, LED0, ALL, PRESCALE = 0x00, 0x01, 0x06, 0xFA, 0xFE
    RESTART, EXTERNAL, INCREMENT, SLEEP = 0x80, 0x40, 0x20, 0x10

    def __init__(self, clock_hz: float, external_hz: float | None = None) -> None:
        """``clock_hz``: true frequency of the internal oscillator; ``external_hz``: that of an external clock."""
        self._internal_hz, self._external_hz = clock_hz, external_hz
        self.enabled = True
        """Level of the output enable pin."""
        self.power_up()

    def power_up(self) -> None:
        """All that was set is forgotten."""
        self._registers = bytearray(256)
        self._registers[self.MODE1], self._registers[self.MODE2] = 0x11, 0x04
        self._registers[self.PRESCALE] = 0x1E
        for channel in range(16):
            self._registers[self.LED0 + 4 * channel + 3] = 0x10
        self._pointer = 0

    def write(self, data: bytes) -> None:
        """Register number, then values."""
        self._pointer = data[0]
        for value in data[1:]:
            self._set(self._pointer, value)
            self._step()

    def read(self, count: int) -> bytes:
        values = bytearray()
        for _ in range(count):
            values.append(self._registers[self._pointer])
            self._step()
        return bytes(values)

    def _step(self) -> None:
        if self._registers[self.MODE1] & self.INCREMENT:
            self._pointer = (self._pointer + 1) % 256

    def _set(self, number: int, value: int) -> None:
        mode = self._registers[self.MODE1]
        if number == self.MODE1:
            if mode & self.EXTERNAL or (value & self.EXTERNAL and not (mode & self.SLEEP and value & self.SLEEP)):
                # Once external it stays so until the power fails; it is taken only while asleep.
                value = value & ~self.EXTERNAL | mode & self.EXTERNAL
            self._registers[number] = value & ~self.RESTART
        elif number == self.PRESCALE:
            if mode & self.SLEEP:
                self._registers[number] = max(3, value)
        elif self.ALL <= number < self.PRESCALE:
            for channel in range(16):
                self._registers[self.LED0 + 4 * channel + number - self.ALL] = value
        elif number < self.LED0 + 64:
            self._registers[number] = value

    @property
    def period_us(self) -> float:
        """From pulse to pulse; 0 while it does not run."""
        mode = self._registers[self.MODE1]
        clock_hz = (self._external_hz or 0.0) if mode & self.EXTERNAL else self._internal_hz
        if mode & self.SLEEP or clock_hz == 0.0:
            return 0.0
        return 4096 * (self._registers[self.PRESCALE] + 1) / clock_hz * 1e6

    @property
    def pulses_us(self) -> tuple[float, ...]:
        """Length of the pulses at the 16 outputs, 0 = none."""
        if not self.enabled:
            return (0.0,) * 16
        result = []
        for channel in range(16):
            at = self.LED0 + 4 * channel
            begin = int.from_bytes(self._registers[at : at + 2], "little")
            end = int.from_bytes(self._registers[at + 2 : at + 4], "little")
            counts = 0 if end & 0x1000 else ((end & 0xFFF) - (begin & 0xFFF)) % 4096
            result.append(counts * self.period_us / 4096)
        return tuple(result)
