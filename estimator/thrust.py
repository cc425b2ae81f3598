"""Actual thrust from commanded thrust: a first-order lag, with a short history."""

import math
from collections import deque
from collections.abc import Sequence

from autopilot.core.frames import FloatArray
from autopilot.core.thrusters import Thruster


class ThrustLag:
    """F' = (command - F) / tau of every thruster, sampled at every tick."""

    def __init__(self, thrusters: Sequence[Thruster]) -> None:
        self._time_constants_s = [thruster.drive.time_constant_s for thruster in thrusters]
        self._limits_n = [thruster.limit_n for thruster in thrusters]
        self._none = (0.0,) * len(thrusters)
        self._held_us = 0
        self._gains = [0.0] * len(thrusters)
        """By which a force comes nearer to its command within ``_held_us``, per thruster."""
        self._track: deque[tuple[int, tuple[float, ...]]] = deque([(-1, self._none)], maxlen=64)
        self.malformed = 0

    def advance(self, t_us: int, command_n: FloatArray) -> None:
        """The command (n,) held since the last call until ``t_us``; entries after the n thrusters are ignored. A
        malformed one counts as zero thrust.
        """
        last_us, before = self._track[-1]
        values: Sequence[float] = command_n.tolist()[: len(before)]
        if len(values) != len(before) or not all(map(math.isfinite, values)):
            self.malformed += 1
            values = self._none
        if t_us - last_us != self._held_us:
            self._held_us = t_us - last_us
            self._gains = [1.0 - math.exp(-1e-6 * self._held_us / tau) for tau in self._time_constants_s]
        acting = tuple(
            [
                a + gain * (min(limit, max(-limit, value)) - a)
                for a, value, gain, limit in zip(before, values, self._gains, self._limits_n, strict=True)
            ]
        )
        self._track.append((t_us, acting))

    def at(self, t_us: int) -> tuple[float, ...]:
        """Acting thrust at a time of the last half second, interpolated; clamped outside of it."""
        later_us, later = self._track[-1]
        if t_us >= later_us:
            return later
        for earlier_us, earlier in reversed(self._track):
            if earlier_us <= t_us:
                w = (t_us - earlier_us) / max(1, later_us - earlier_us)
                return tuple([a + w * (b - a) for a, b in zip(earlier, later, strict=True)])
            later_us, later = earlier_us, earlier
        return later
