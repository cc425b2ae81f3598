"""Emulated Sabertooth amplifiers on one serial line: packets in, duty out, with their own timeout."""

from autopilot.drivers.base import AlwaysOpen
from autopilot.drivers.sabertooth import TIMEOUT

COMMANDS = {0: (1, 1), 1: (1, -1), 4: (2, 1), 5: (2, -1)}
"""Command -> motor, direction."""


class SabertoothEmulator(AlwaysOpen):
    """A :class:`autopilot.drivers.protocols.BytePort`. Time passes by :meth:`read`, as with every emulated line."""

    def __init__(self, addresses: tuple[int, ...] = (128, 129)) -> None:
        self._addresses = addresses
        self._t_us = 0
        self.bad_packets = 0
        """Packets with a wrong checksum, and bytes outside of any."""
        self.power_up()

    def power_up(self) -> None:
        """Reset all settings, as a power cycle does."""
        self.duty: dict[tuple[int, int], float] = {(a, m): 0.0 for a in self._addresses for m in (1, 2)}
        """(address, motor) -> duty now, -1 to 1."""
        self.timeout_s: dict[int, float] = dict.fromkeys(self._addresses, 0.0)
        """Address -> after so long without a packet the motors stop; 0 = never."""
        self._last_received_us: dict[int, int] = dict.fromkeys(self._addresses, self._t_us)
        self._buffer = b""

    def write(self, data: bytes) -> None:
        self._buffer += data
        while self._buffer:
            address = self._buffer[0]
            if not 128 <= address <= 135:
                self.bad_packets += address != 0xAA
                self._buffer = self._buffer[1:]
                continue
            if len(self._buffer) < 4:
                return
            packet, self._buffer = self._buffer[:4], self._buffer[4:]
            if packet[3] != sum(packet[:3]) & 0x7F or packet[1] > 127 or packet[2] > 127:
                self.bad_packets += 1
                self._buffer = packet[1:] + self._buffer
                continue
            self._obey(address, packet[1], packet[2])

    def read(self, t_us: int) -> list[tuple[int, bytes]]:
        """No data; stops motors after the timeout."""
        self._t_us = t_us
        for address, timeout_s in self.timeout_s.items():
            if timeout_s > 0.0 and t_us - self._last_received_us[address] > 1e6 * timeout_s:
                self.duty[address, 1] = self.duty[address, 2] = 0.0
        return []

    def _obey(self, address: int, command: int, data: int) -> None:
        if address not in self._addresses:
            return
        self._last_received_us[address] = self._t_us
        if command == TIMEOUT:
            self.timeout_s[address] = 0.1 * data
        elif command in COMMANDS:
            motor, direction = COMMANDS[command]
            self.duty[address, motor] = direction * data / 127
