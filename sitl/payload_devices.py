"""Simulated payload: each device moves to its pulse at a finite rate."""

import math
from collections.abc import Sequence

from autopilot.core.vehicle import Vehicle

LEVEL_PER_S = {"servo": 4.0, "tilt": 4.0, "gripper": 0.5, "relay": 1e6, "light": 1e6}
"""Of the whole way: a servo takes 0.25 s for it, a gripper 2 s; relays and lights need no time."""


class SimPayload:
    """Gripper, lights, relays, servos and tilt of ``[[payload]]``. They do not push the vehicle."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._outputs = vehicle.payload
        self._wanted = [self._level(index, output.start_us) for index, output in enumerate(self._outputs)]
        self._levels = list(self._wanted)
        self.pulses_us: tuple[int, ...] = tuple(output.start_us for output in self._outputs)
        """As they are commanded."""
        self._tilt = vehicle.tilt
        self._t_us = 0

    @property
    def levels(self) -> tuple[float, ...]:
        """Positions of all devices: 0 dark, off, closed; 1 bright, on, open."""
        return tuple(self._levels)

    @property
    def camera_off_rad(self) -> float:
        """How far the camera is tilted from where it was calibrated, upwards positive; 0 for one that does not tilt."""
        tilt = self._tilt
        if tilt is None or tilt.camera_deg is None:
            return 0.0
        level = self._levels[self._outputs.index(tilt)]
        return tilt.angle_rad(tilt.min_us + level * (tilt.max_us - tilt.min_us)) - math.radians(tilt.camera_deg)

    def set(self, pulses_us: Sequence[int]) -> None:
        """The commanded pulses from now on [us]; a relay switches by threshold."""
        commanded_us = tuple(
            pulse_us or output.start_us for pulse_us, output in zip(pulses_us, self._outputs, strict=False)
        )
        if commanded_us == self.pulses_us:
            return
        self.pulses_us = commanded_us
        for index, pulse_us in enumerate(commanded_us):
            level = self._level(index, pulse_us)
            self._wanted[index] = float(level > 0.5) if self._outputs[index].kind == "relay" else level

    def advance(self, t_us: int) -> None:
        passed_s, self._t_us = (t_us - self._t_us) * 1e-6, t_us
        if self._levels == self._wanted:
            return
        for index, output in enumerate(self._outputs):
            step = LEVEL_PER_S[output.kind] * passed_s
            left = self._wanted[index] - self._levels[index]
            self._levels[index] += min(max(left, -step), step)

    def _level(self, index: int, pulse_us: int) -> float:
        output = self._outputs[index]
        return (min(max(pulse_us, output.min_us), output.max_us) - output.min_us) / (output.max_us - output.min_us)
