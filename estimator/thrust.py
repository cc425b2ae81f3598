"""Thrust that acts, from thrust that was commanded: a first-order lag, remembered for a short while."""

import math
from collections import deque

from autopilot.core.frames import FloatArray

Four = tuple[float, float, float, float]
ZERO: Four = (0.0, 0.0, 0.0, 0.0)


class ThrustLag:
    """F' = (command - F) / tau, sampled at every tick."""

    def __init__(self, time_constant_s: float, limit_n: float) -> None:
        self._time_constant_s = time_constant_s
        self._limit_n = limit_n
        self._track: deque[tuple[int, Four]] = deque([(-1, ZERO)], maxlen=64)
        self.malformed = 0

    def advance(self, t_us: int, command_n: FloatArray) -> None:
        """The command held since the last call until ``t_us``. A malformed one counts as zero thrust."""
        last_us, (a, b, c, d) = self._track[-1]
        limit = self._limit_n
        # Comparisons with NaN are false.
        values = command_n.tolist()[:4]
        if len(values) != 4 or not all(-math.inf < value < math.inf for value in values):
            self.malformed += 1
            values = [0.0] * 4
        p, s, v, w = values
        share = 1.0 - math.exp(1e-6 * (last_us - t_us) / self._time_constant_s)
        self._track.append(
            (
                t_us,
                (
                    a + share * (min(limit, max(-limit, p)) - a),
                    b + share * (min(limit, max(-limit, s)) - b),
                    c + share * (min(limit, max(-limit, v)) - c),
                    d + share * (min(limit, max(-limit, w)) - d),
                ),
            )
        )

    def at(self, t_us: int) -> Four:
        """Acting thrust at a time of the last half second (the nearest known outside of it), interpolated."""
        later_us, later = self._track[-1]
        if t_us >= later_us:
            return later
        for earlier_us, earlier in reversed(self._track):
            if earlier_us <= t_us:
                w = (t_us - earlier_us) / max(1, later_us - earlier_us)
                (a, b, c, d), (p, q, r, s) = earlier, later
                return (a + w * (p - a), b + w * (q - b), c + w * (r - c), d + w * (s - d))
            later_us, later = earlier_us, earlier
        return later
