"""Interface of the MAVLink server to payload outputs, implemented by :mod:`autopilot.command.equipment`."""

from collections.abc import Mapping
from typing import Protocol

from autopilot.mavlink.api import CommandReply


class EquipmentOrders(Protocol):
    """Implemented by :mod:`autopilot.command.equipment`. Every order answers at once."""

    @property
    def thruster_channels(self) -> tuple[int, ...]:
        """Output of each thruster, in the order of the vehicle file."""
        ...

    def pulses_us(self) -> Mapping[int, int]:
        """Channel -> pulse [us] of the payload outputs, as of the last tick."""
        ...

    def light_levels(self) -> tuple[float, ...]:
        """How bright the lights are that can be used, 0 to 1, in the order of the vehicle file."""
        ...

    def set_servo(self, channel: int, pulse_us: float) -> CommandReply: ...

    def repeat_servo(self, channel: int, pulse_us: float, count: int, cycle_s: float) -> CommandReply:
        """Move to a pulse and back, repeatedly."""
        ...

    def set_relay(self, number: int, *, on: bool) -> CommandReply: ...

    def toggle_relay(self, number: int) -> CommandReply: ...

    def repeat_relay(self, number: int, count: int, cycle_s: float) -> CommandReply:
        """Toggle a relay and back, repeatedly."""
        ...

    def grip(self, number: int, *, close: bool) -> CommandReply: ...

    def refuse_actuator(self, number: int) -> str:
        """Why an actuator cannot be moved, "" when it can."""
        ...

    def set_actuators(self, values: Mapping[int, float]) -> CommandReply:
        """Number -> -1 to 1. All or none."""
        ...

    def refuse_tilt(self, angle_rad: float | None = None) -> str:
        """Why the camera cannot be tilted, or not to an angle; "" when it can."""
        ...

    @property
    def tilt_rad(self) -> float | None:
        """Angle of the camera's tilt, upwards positive; None without one, and while nobody knows it."""
        ...

    @property
    def tilt_range_rad(self) -> tuple[float, float] | None:
        """Ends of the tilt, lower and upper; None without one."""
        ...

    def tilt(self, angle_rad: float) -> CommandReply:
        """Tilt the camera to an angle against the body, upwards positive."""
        ...

    def tilt_by(self, step_rad: float | None) -> CommandReply:
        """Tilt the camera up or down by a step; None = to its start, its middle as a rule."""
        ...

    def lights(self, change: float | None) -> CommandReply:
        """Change the brightness of all lights by a share; None = toggle."""
        ...
