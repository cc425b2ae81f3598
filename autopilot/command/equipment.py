"""Payload outputs that clients may move: ``[[payload]]`` of the vehicle file.

The state is the pulse of each output. Drivers get all of them on every tick, so that a device that reconnects is up
to date. Repetitions count ticks. A relay is at its highest pulse when it is on and its lowest when off, a gripper
at its highest when open and its lowest when closed.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from autopilot.core.payload import PayloadState
from autopilot.core.vehicle import PayloadTable, Vehicle
from autopilot.mavlink.api import ACCEPTED, CommandReply, CommandResult

MIN_CYCLE_S = 0.1
"""Nothing that is made for it wears out by a repetition."""
MAX_REPEATS = 10_000
NO_TILT = "There is no gimbal: the camera is fixed"


@dataclass(slots=True)
class _Repeat:
    """An output that alternates."""

    pulses_us: tuple[int, int]
    """The next change, and the one after it."""
    left: int
    """Changes left."""
    half_us: int
    next_us: int


class Equipment:
    """Orders to outputs. Every one answers at once."""

    def __init__(self, vehicle: Vehicle) -> None:
        self.outputs = vehicle.payload
        self._thrusters = {thruster.channel: thruster.name for thruster in vehicle.thrusters}
        self._unwired: Mapping[str, str] = {}
        self._pulses_us = [0 if output.kind == "tilt" else output.start_us for output in self.outputs]
        self._tilt_rad: float | None = None
        """As it is reported."""
        self._repeats: dict[int, _Repeat] = {}
        self._t_us = 0

    # State

    def leave_out(self, unwired: Mapping[str, str]) -> None:
        """Outputs that nothing here drives, by name, and why."""
        self._unwired = dict(unwired)

    def refuse_servo(self, channel: int) -> str:
        """Why a servo output cannot be moved, "" when it can."""
        if channel in self._thrusters:
            return f"Servo {channel} drives thruster {self._thrusters[channel]}"
        index = self._of_channel(channel)
        return f"There is no servo {channel}: {self._known('channel')}" if index is None else self._problem(index)

    def refuse_pulse(self, channel: int, pulse_us: float) -> str:
        """Why an output cannot have that pulse, "" when it can."""
        index = self._of_channel(channel)
        return "" if index is None else self._pulse_refusal(index, pulse_us)

    def refuse_relay(self, number: int) -> str:
        """Why a relay cannot be switched, "" when it can."""
        index = self._of_relay(number)
        return f"There is no relay {number}: {self._known('relay')}" if index is None else self._problem(index)

    def refuse_gripper(self, number: int) -> str:
        """Why a gripper cannot be moved, "" when it can. Grippers count from 1, 0 = the first."""
        index = self._of_gripper(number)
        if index is None:
            return "There is no gripper on this vehicle" if number < 2 else f"There is no gripper {number}"
        return self._problem(index)

    def refuse_actuator(self, number: int) -> str:
        """Why an actuator cannot be moved, "" when it can. They count from 1, in the order of the vehicle file."""
        index = self._of_actuator(number)
        return f"There is no actuator {number} on this vehicle" if index is None else self._problem(index)

    def refuse_tilt(self, angle_rad: float | None = None) -> str:
        """Why the camera cannot be tilted, or not to an angle [rad, upwards positive]; "" when it can."""
        index = self._of_tilt()
        if index is None:
            return NO_TILT
        output = self.outputs[index]
        if angle_rad is not None and not output.reaches(angle_rad):
            low_deg, high_deg = sorted((output.min_deg, output.max_deg))
            return f"{output.name}: {math.degrees(angle_rad):.1f} deg, use {low_deg:g} to {high_deg:g}"
        return self._problem(index)

    @property
    def tilt_rad(self) -> float | None:
        """Angle of the camera's tilt, upwards positive; None without one, and while nobody knows it."""
        index = self._of_tilt()
        if index is None or self._problem(index):
            return None
        pulse_us = self._pulses_us[index]
        ordered_rad = self.outputs[index].angle_rad(pulse_us) if pulse_us else None
        return ordered_rad if self._tilt_rad is None else self._tilt_rad

    @property
    def tilt_range_rad(self) -> tuple[float, float] | None:
        """Ends of the tilt, lower and upper; None without one."""
        index = self._of_tilt()
        if index is None:
            return None
        low_deg, high_deg = sorted((self.outputs[index].min_deg, self.outputs[index].max_deg))
        return math.radians(low_deg), math.radians(high_deg)

    def note_tilt(self, angle_rad: float | None) -> None:
        """What the tilt has been reported to be; None = nothing."""
        self._tilt_rad = angle_rad

    @property
    def thruster_channels(self) -> tuple[int, ...]:
        """Output of each thruster, in the order of the vehicle file."""
        return tuple(self._thrusters)

    def pulses_us(self) -> dict[int, int]:
        """Channel -> pulse [us] of the payload outputs, as of the last tick."""
        return {
            output.channel: pulse_us
            for output, pulse_us in zip(self.outputs, self._pulses_us, strict=True)
            if output.channel is not None and output.name not in self._unwired
        }

    def light_levels(self) -> tuple[float, ...]:
        """How bright the lights are that can be used, 0 to 1, in the order of the vehicle file."""
        lights = (index for index, output in enumerate(self.outputs) if output.kind == "light")
        return tuple(self._level(index) for index in lights if not self._problem(index))

    # Orders

    def set_servo(self, channel: int, pulse_us: float) -> CommandReply:
        refusal = self.refuse_servo(channel)
        index = self._of_channel(channel)
        if refusal or index is None:
            return _denied(refusal)
        refusal = self._pulse_refusal(index, pulse_us)
        return _denied(refusal) if refusal else self._put(index, round(pulse_us))

    def repeat_servo(self, channel: int, pulse_us: float, count: int, cycle_s: float) -> CommandReply:
        """Move to a pulse and back, repeatedly."""
        refusal = self.refuse_servo(channel)
        index = self._of_channel(channel)
        if refusal or index is None:
            return _denied(refusal)
        refusal = self._pulse_refusal(index, pulse_us) or _cycle_refusal(count, cycle_s)
        if refusal:
            return _denied(refusal)
        back_us = self._pulses_us[index] or self.outputs[index].start_us
        return self._repeat(index, (round(pulse_us), back_us), count, cycle_s)

    def set_relay(self, number: int, *, on: bool) -> CommandReply:
        refusal = self.refuse_relay(number)
        index = self._of_relay(number)
        if refusal or index is None:
            return _denied(refusal)
        return self._put(index, self._end_us(index, high=on))

    def toggle_relay(self, number: int) -> CommandReply:
        index = self._of_relay(number)
        return self.set_relay(number, on=index is None or not self._is_on(index))

    def repeat_relay(self, number: int, count: int, cycle_s: float) -> CommandReply:
        """Toggle a relay and back, repeatedly."""
        refusal = self.refuse_relay(number) or _cycle_refusal(count, cycle_s)
        index = self._of_relay(number)
        if refusal or index is None:
            return _denied(refusal)
        on = self._is_on(index)
        pulses = self._end_us(index, high=not on), self._end_us(index, high=on)
        return self._repeat(index, pulses, count, cycle_s)

    def grip(self, number: int, *, close: bool) -> CommandReply:
        refusal = self.refuse_gripper(number)
        index = self._of_gripper(number)
        if refusal or index is None:
            return _denied(refusal)
        return self._put(index, self._end_us(index, high=not close))

    def set_actuators(self, values: Mapping[int, float]) -> CommandReply:
        """Number -> -1 to 1. All or none."""
        if not values:
            return _denied("Actuator refused: no value is given")
        for number, value in values.items():
            refusal = self.refuse_actuator(number)
            if not refusal and not -1.0 <= value <= 1.0:
                refusal = f"Actuator {number} refused: {value:g}, use -1 to 1"
            if refusal:
                return _denied(refusal)
        for number, value in values.items():
            index = self._of_actuator(number)
            if index is not None:
                self._put(index, self._pulse_us(index, 0.5 + 0.5 * value))
        return ACCEPTED

    def lights(self, change: float | None) -> CommandReply:
        """All lights brighter or darker by a share; None = on when they are off, off when they are on."""
        lights = [index for index, output in enumerate(self.outputs) if output.kind == "light"]
        usable = [index for index in lights if not self._problem(index)]
        if not usable:
            return _denied(self._problem(lights[0]) if lights else "There are no lights on this vehicle")
        on = any(self._is_on(index) for index in usable)
        for index in usable:
            level = (0.0 if on else 1.0) if change is None else self._level(index) + change
            self._put(index, self._pulse_us(index, level))
        return ACCEPTED

    def tilt(self, angle_rad: float) -> CommandReply:
        """Tilt the camera to an angle against the body, upwards positive."""
        refusal = self.refuse_tilt(angle_rad)
        index = self._of_tilt()
        if refusal or index is None:
            return _denied(refusal)
        return self._put(index, self.outputs[index].tilt_us(angle_rad))

    def tilt_by(self, step_rad: float | None) -> CommandReply:
        """Tilt the camera up or down by a step, at most to its end; None = to its start, its middle as a rule."""
        index = self._of_tilt()
        if index is None:
            return _denied(NO_TILT)
        output = self.outputs[index]
        start_rad = output.angle_rad(output.start_us)
        if step_rad is None:
            return self.tilt(start_rad)
        pulse_us = self._pulses_us[index]
        ordered_rad = output.angle_rad(pulse_us) if pulse_us else self.tilt_rad
        low_deg, high_deg = sorted((output.min_deg, output.max_deg))
        wanted_rad = (start_rad if ordered_rad is None else ordered_rad) + step_rad
        return self.tilt(min(max(wanted_rad, math.radians(low_deg)), math.radians(high_deg)))

    # One tick

    def step(self, t_us: int) -> PayloadState | None:
        """Pulses of all outputs; None on a vehicle without any."""
        self._t_us = t_us
        for index, repeat in tuple(self._repeats.items()):
            if t_us < repeat.next_us:
                continue
            self._pulses_us[index] = repeat.pulses_us[0]
            repeat.pulses_us = (repeat.pulses_us[1], repeat.pulses_us[0])
            repeat.left -= 1
            repeat.next_us += repeat.half_us
            if repeat.left <= 0:
                del self._repeats[index]
        return PayloadState(t_us=t_us, pulses_us=tuple(self._pulses_us)) if self.outputs else None

    # Inside

    def _put(self, index: int, pulse_us: int) -> CommandReply:
        self._repeats.pop(index, None)
        self._pulses_us[index] = pulse_us
        return ACCEPTED

    def _repeat(self, index: int, pulses_us: tuple[int, int], count: int, cycle_s: float) -> CommandReply:
        half_us = round(0.5e6 * cycle_s)
        self._repeats[index] = _Repeat(pulses_us=pulses_us, left=2 * count, half_us=half_us, next_us=self._t_us)
        return ACCEPTED

    def _problem(self, index: int) -> str:
        name = self.outputs[index].name
        why = self._unwired.get(name)
        return "" if why is None else f"{name}: {why}"

    def _pulse_refusal(self, index: int, pulse_us: float) -> str:
        output = self.outputs[index]
        if math.isfinite(pulse_us) and output.min_us <= round(pulse_us) <= output.max_us:
            return ""
        return f"{output.name}: {pulse_us:g} us, use {output.min_us} to {output.max_us}"

    def _end_us(self, index: int, *, high: bool) -> int:
        output = self.outputs[index]
        return output.max_us if high else output.min_us

    def _pulse_us(self, index: int, level: float) -> int:
        output = self.outputs[index]
        return round(output.min_us + min(max(level, 0.0), 1.0) * (output.max_us - output.min_us))

    def _level(self, index: int) -> float:
        output = self.outputs[index]
        pulse_us = self._pulses_us[index] or output.start_us
        return (pulse_us - output.min_us) / (output.max_us - output.min_us)

    def _is_on(self, index: int) -> bool:
        output = self.outputs[index]
        threshold = 0.5 if output.kind == "relay" else 0.0
        return self._level(index) > threshold

    def _of_channel(self, channel: int) -> int | None:
        return _first(self.outputs, lambda output: output.channel == channel)

    def _of_relay(self, number: int) -> int | None:
        return _first(self.outputs, lambda output: output.relay == number)

    def _of_gripper(self, number: int) -> int | None:
        return _nth(self.outputs, max(number, 1), ("gripper",))

    def _of_actuator(self, number: int) -> int | None:
        return _nth(self.outputs, number, ("servo", "gripper", "light", "tilt"))

    def _of_tilt(self) -> int | None:
        return _nth(self.outputs, 1, ("tilt",))

    def _known(self, key: str) -> str:
        known = [str(value) for output in self.outputs if (value := getattr(output, key)) is not None]
        return f"use {', '.join(known)}" if known else "the vehicle file has none"


def _first(outputs: Sequence[PayloadTable], fits: Callable[[PayloadTable], bool]) -> int | None:
    return next((index for index, output in enumerate(outputs) if fits(output)), None)


def _nth(outputs: Sequence[PayloadTable], number: int, kinds: tuple[str, ...]) -> int | None:
    found = [index for index, output in enumerate(outputs) if output.kind in kinds]
    return found[number - 1] if 1 <= number <= len(found) else None


def _cycle_refusal(count: int, cycle_s: float) -> str:
    if not 1 <= count <= MAX_REPEATS:
        return f"Repetition refused: {count} times, use 1 to {MAX_REPEATS}"
    if not MIN_CYCLE_S <= cycle_s <= 3600.0:
        return f"Repetition refused: cycle {cycle_s:g} s, use {MIN_CYCLE_S:g} to 3600"
    return ""


def _denied(reason: str) -> CommandReply:
    return CommandReply(result=CommandResult.DENIED, reason=reason)
