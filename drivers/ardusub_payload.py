"""Payload driven by ArduSub: DO_SET_SERVO and DO_SET_RELAY, one at a time until each is acknowledged.

Only changes are sent: outputs that were never commanded stay as the flight controller has them.
"""

from collections.abc import Sequence
from typing import Any

from autopilot.core.vehicle import Vehicle

SET_RELAY, SET_SERVO = 181, 183
"""MAV_CMD_DO_SET_RELAY, MAV_CMD_DO_SET_SERVO."""
AGAIN_US = 500_000
"""What has not been acknowledged is sent again after this time."""


class Passing:
    def __init__(self, vehicle: Vehicle) -> None:
        self._outputs = vehicle.payload
        self._done = [output.start_us for output in self._outputs]
        """What it has acknowledged (or refused)."""
        self._wanted = list(self._done)
        self._pending: tuple[int, int, int] | None = None
        """Which one is under way, its pulse, and when it was sent."""

    def want(self, pulses_us: Sequence[int]) -> None:
        """Set the wanted state of all outputs."""
        self._wanted[:] = pulses_us[: len(self._wanted)]

    def forget(self) -> None:
        self._done = [output.start_us for output in self._outputs]
        self._pending = None

    def due(self, t_us: int) -> tuple[int, float, float] | None:
        """The command that is to be sent now: its number and two parameters."""
        if self._pending is not None and t_us - self._pending[2] < AGAIN_US:
            return None
        index = next((n for n, (a, b) in enumerate(zip(self._wanted, self._done, strict=True)) if a != b), None)
        if index is None:
            self._pending = None
            return None
        output, pulse_us = self._outputs[index], self._wanted[index]
        self._pending = (index, pulse_us, t_us)
        if output.channel is not None:
            return SET_SERVO, float(output.channel), float(pulse_us)
        on = 2 * pulse_us > output.min_us + output.max_us
        return SET_RELAY, float(output.relay or 0), float(on)

    def acknowledge(self, message: Any) -> str:
        """Process a COMMAND_ACK; returns a notice to operators, "" = none."""
        if self._pending is None:
            return ""
        index, pulse_us, _ = self._pending
        output = self._outputs[index]
        if message.command != (SET_RELAY if output.channel is None else SET_SERVO):
            return ""
        self._pending, self._done[index] = None, pulse_us
        if message.result == 0:
            return ""
        place = f"relay {output.relay}" if output.channel is None else f"SERVO{output.channel}_FUNCTION"
        return f"{output.name}: flight controller refuses, see {place}"
