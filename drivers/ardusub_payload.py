"""Payload driven by ArduSub: DO_SET_SERVO, DO_SET_RELAY, and DO_MOUNT_CONTROL for the camera's tilt, which is an output
that only its mount library drives; one at a time until each is acknowledged.

Only changes are sent: outputs that were never commanded stay as the flight controller has them.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from autopilot.core.vehicle import PayloadTable, Vehicle

SET_RELAY, SET_SERVO, MOUNT_CONTROL = 181, 183, 205
"""MAV_CMD_DO_SET_RELAY, MAV_CMD_DO_SET_SERVO, MAV_CMD_DO_MOUNT_CONTROL."""
BY_ANGLE = 2.0
"""MAV_MOUNT_MODE_MAVLINK_TARGETING."""
AGAIN_US = 500_000
"""What has not been acknowledged is sent again after this time."""


END_WITHIN = 0.5
"""Ends agree within this [us, deg]."""
NO_FUNCTION, BY_COMMAND, RC_PASSED, MOUNT_PITCH = 0, 1, range(51, 67), 7
"""SERVOn_FUNCTION: disabled, manual, RCIN1 to RCIN16 (lights are RCIN9 and RCIN10), the pitch of mount 1."""


class Passing:
    def __init__(self, vehicle: Vehicle) -> None:
        self._outputs = vehicle.payload
        self._done = [_start_us(output) for output in self._outputs]
        """What it has acknowledged (or refused)."""
        self._wanted = list(self._done)
        self._pending: tuple[int, int, int] | None = None
        """Which one is under way, its pulse, and when it was sent."""

    def parameters(self) -> tuple[str, ...]:
        """Its parameters that :meth:`advice` reads."""
        names = [f"SERVO{output.channel}_FUNCTION" for output in self._outputs if output.channel is not None]
        tilts = [output.channel for output in self._outputs if output.kind == "tilt"]
        ends = [name for n in tilts for name in (f"SERVO{n}_MIN", f"SERVO{n}_MAX", "MNT1_PITCH_MIN", "MNT1_PITCH_MAX")]
        return (*names, *ends)

    def advice(self, values: Mapping[str, float]) -> tuple[tuple[str, str], ...]:
        """Settings with which an output would not move as the vehicle file says, and how to correct them."""
        found: list[tuple[str, str]] = []
        for output in self._outputs:
            function = values.get(f"SERVO{output.channel}_FUNCTION")
            if output.channel is None or function is None:
                continue
            tilts, what = output.kind == "tilt", f"SERVO{output.channel}_FUNCTION = {function:g}"
            if tilts and round(function) != MOUNT_PITCH:
                found.append((f"{what}: {output.name} does not move", f"set {MOUNT_PITCH}"))
            elif not tilts and round(function) not in (NO_FUNCTION, BY_COMMAND, *RC_PASSED):
                found.append((f"{what}: {output.name} does not move", "set 0, or 59 or 60 for lights"))
            elif tilts and (wrong := _other_ends(output, values)):
                found.append((f"{wrong}: {output.name} gets another angle", "correct it, or [[payload]]"))
        return tuple(found)

    def want(self, pulses_us: Sequence[int]) -> None:
        """Set the wanted state of all outputs."""
        self._wanted[:] = pulses_us[: len(self._wanted)]

    def forget(self) -> None:
        self._done = [_start_us(output) for output in self._outputs]
        self._pending = None

    def due(self, t_us: int) -> tuple[float, ...] | None:
        """The command that is to be sent now: its number and parameters."""
        if self._pending is not None and t_us - self._pending[2] < AGAIN_US:
            return None
        index = next((n for n, (a, b) in enumerate(zip(self._wanted, self._done, strict=True)) if a != b), None)
        if index is None:
            self._pending = None
            return None
        output, pulse_us = self._outputs[index], self._wanted[index]
        self._pending = (index, pulse_us, t_us)
        if output.kind == "tilt":
            angle_deg = math.degrees(output.angle_rad(pulse_us))
            return MOUNT_CONTROL, angle_deg, 0.0, 0.0, 0.0, 0.0, 0.0, BY_ANGLE
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
        if message.command != _command_of(output):
            return ""
        self._pending, self._done[index] = None, pulse_us
        if message.result == 0:
            return ""
        place = f"relay {output.relay}" if output.channel is None else f"SERVO{output.channel}_FUNCTION"
        return f"{output.name}: flight controller refuses, see {place}"


def _command_of(output: PayloadTable) -> int:
    if output.kind == "tilt":
        return MOUNT_CONTROL
    return SET_RELAY if output.channel is None else SET_SERVO


def _start_us(output: PayloadTable) -> int:
    """Pulse before the first command; 0 of a tilt, which stays as it is."""
    return 0 if output.kind == "tilt" else output.start_us


def _other_ends(output: PayloadTable, values: Mapping[str, float]) -> str:
    """The first of its parameters that is not an end of the tilt as the vehicle file has it, "" = none."""
    low_deg, high_deg = sorted((output.min_deg, output.max_deg))
    ends = {
        f"SERVO{output.channel}_MIN": float(output.min_us),
        f"SERVO{output.channel}_MAX": float(output.max_us),
        "MNT1_PITCH_MIN": low_deg,
        "MNT1_PITCH_MAX": high_deg,
    }
    differ = [name for name, end in ends.items() if abs(values.get(name, end) - end) > END_WITHIN]
    return f"{differ[0]} = {values[differ[0]]:g}" if differ else ""
