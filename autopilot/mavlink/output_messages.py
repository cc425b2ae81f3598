"""Messages for a pilot's display: gain, lights, tilt, tether turns, and the pulse of every output."""

import math
from collections.abc import Callable, Mapping

from autopilot.mavlink.api import EquipmentOrders
from autopilot.mavlink.context import Context, f32, u16
from autopilot.mavlink.dialect import mav
from autopilot.mavlink.telemetry import Builder, NavigationMessages
from autopilot.mavlink.wire import Message

PORT_OUTPUTS = 16
"""Of one SERVO_OUTPUT_RAW: the first 16 outputs are port 0, the others port 1."""
STATUS_OUTPUTS = 32
"""Of ACTUATOR_OUTPUT_STATUS."""
LIGHTS = 2
"""Lights1 and Lights2: ground stations show two."""


class OutputMessages:
    """Builders of these messages. Outputs are counted by their channel in the vehicle file."""

    def __init__(
        self, ctx: Context, telemetry: NavigationMessages, gain: Callable[[], float], equipment: EquipmentOrders | None
    ) -> None:
        """``gain``: share of full sticks that a pilot gets."""
        self._ctx, self._telemetry, self._gain, self._equipment = ctx, telemetry, gain, equipment
        self._yaw_rad: float | None = None
        self._turned_rad = 0.0

    def builders(self) -> Mapping[int, Builder]:
        return {
            mav.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW: self.servo_output_raw,
            mav.MAVLINK_MSG_ID_ACTUATOR_OUTPUT_STATUS: self.actuator_output_status,
            mav.MAVLINK_MSG_ID_NAMED_VALUE_FLOAT: self.named_values,
        }

    def tick(self) -> None:
        """Count the turns that the vehicle has made since the start, whatever it was doing."""
        motion = self._telemetry.motion()
        if motion is None:
            return
        if self._yaw_rad is not None:
            self._turned_rad += math.remainder(motion.yaw - self._yaw_rad, 2.0 * math.pi)
        self._yaw_rad = motion.yaw

    def _pulses_us(self) -> dict[int, int]:
        """Channel -> pulse of all that is driven; nothing before the first command."""
        command, equipment = self._ctx.view.command, self._equipment
        if command is None:
            return {}
        thrusters = range(1, len(command.pwm_us) + 1) if equipment is None else equipment.thruster_channels
        pulses = {channel: u16(pulse) for channel, pulse in zip(thrusters, command.pwm_us, strict=False)}
        return pulses if equipment is None else {**pulses, **equipment.pulses_us()}

    def servo_output_raw(self) -> tuple[Message, ...]:
        """SERVO_OUTPUT_RAW: pulses of thrusters and payload outputs [us]; 0 = no such output."""
        pulses = self._pulses_us()
        t_us = self._ctx.t_us & 0xFFFF_FFFF
        return tuple(
            mav.MAVLink_servo_output_raw_message(
                t_us, port, *(pulses.get(PORT_OUTPUTS * port + n, 0) for n in range(1, PORT_OUTPUTS + 1))
            )
            for port in sorted({(channel - 1) // PORT_OUTPUTS for channel in pulses})
        )

    def actuator_output_status(self) -> Message | None:
        """ACTUATOR_OUTPUT_STATUS: the same pulses, with a bit for each existing output."""
        pulses = self._pulses_us()
        if not pulses:
            return None
        widths = [float(pulses.get(n + 1, 0)) for n in range(STATUS_OUTPUTS)]
        active = sum(1 << n for n, width in enumerate(widths) if width)
        return mav.MAVLink_actuator_output_status_message(self._ctx.t_us, active, widths)

    def named_values(self) -> tuple[Message, ...]:
        """NAMED_VALUE_FLOAT with ArduSub's names, as QGroundControl's submarine panel shows them; missing equipment
        is left out. CamTilt is 1 at the upper end.
        """
        values = {"PilotGain": self._gain()}
        if self._equipment is not None:
            levels = self._equipment.light_levels()[:LIGHTS]
            values |= {f"Lights{n}": level for n, level in enumerate(levels, 1)}
            tilt_rad, ends = self._equipment.tilt_rad, self._equipment.tilt_range_rad
            if tilt_rad is not None and ends is not None:
                values["CamTilt"] = (tilt_rad - ends[0]) / (ends[1] - ends[0])
        if self._yaw_rad is not None:
            values["TetherTrn"] = self._turned_rad / (2.0 * math.pi)
        return tuple(
            mav.MAVLink_named_value_float_message(self._ctx.boot_ms, name.encode("ascii"), f32(value))
            for name, value in values.items()
        )
