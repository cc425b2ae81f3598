"""Dead band at thrust reversal: small thrust against a thruster's last direction of rotation is set to zero."""

import math

import numpy as np

from autopilot.core.frames import FloatArray

LEAST_SHARE = 0.035
"""Thrust against the way a thruster turned last, as a share of its limit, for which it is turned round: 0.4 N of 12 N,
less than half of the force that margins take for unmodelled anyway. What an estimate's noise asks for is less."""

BETWEEN = 2.0
"""Between control steps so many times that: the feedback of the inner loop carries the noise of single ticks, of which
one in a few hundred would turn a thruster round that has nothing to do. The next control step is 50 ms away."""


class Reversals:
    """Last direction of rotation of every thruster."""

    def __init__(self, limit_n: FloatArray) -> None:
        self._least_n: list[float] = (LEAST_SHARE * limit_n).tolist()
        self._way = [0.0] * len(limit_n)

    def reset(self) -> None:
        """Thrusters at rest: either direction of rotation is allowed."""
        self._way = [0.0] * len(self._way)

    def worth(self, thrust_n: FloatArray, *, between: bool = False) -> FloatArray:
        """Thrust (n,) [N] after the dead band, which is wider ``between`` control steps (factor BETWEEN)."""
        worth: list[float] = thrust_n.tolist()
        share = BETWEEN if between else 1.0
        for i, (thrust, least) in enumerate(zip(worth, self._least_n, strict=True)):
            if thrust * self._way[i] < 0.0 and abs(thrust) < share * least:
                worth[i] = 0.0
            elif thrust != 0.0:
                self._way[i] = math.copysign(1.0, thrust)
        return np.array(worth)
